//! Dense symmetric matrices in single precision, stored by tiles of their lower triangle: half the memory, and half the
//! reading per product.
//!
//! The algorithms from a Cholesky factor L to L Lᵀ and to (L Lᵀ)⁻¹ work in place, tile row by tile row (LAPACK's `trtri`
//! and `lauum`). The work is cut by the size of the matrix alone, so results do not depend on the number of threads.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;

/// Rows of a tile: three fit into a cache of the second level.
const TILE: usize = 128;
/// Columns of a tile that a product handles together.
const GROUP: usize = 4;
/// Numbers that a product handles together, so that the compiler keeps them in vector registers.
const LANES: usize = 16;
/// A product is cut into at most so many parts, of at least so many tiles.
const PARTS: usize = 8;
const TILES_PER_PART: usize = 16;

/// A dense symmetric matrix in single precision.
///
/// Made from a factor by [`Cholesky::schur`](crate::Cholesky::schur) and
/// [`Cholesky::schur_inverse`](crate::Cholesky::schur_inverse).
#[derive(Clone, Debug)]
pub struct DenseSymmetric {
    len: usize,
    /// Rows of a tile, a power of 2, and which.
    tile: usize,
    shift: u32,
    /// Tiles (i, j ≤ i) by rows, each by columns; those on the diagonal are whole. The last row and column of tiles are
    /// filled up with the identity.
    values: Vec<f32>,
}

impl DenseSymmetric {
    /// The symmetric matrix with `entry(i, j)` for i ≥ j.
    pub fn from_fn(len: usize, entry: impl Fn(usize, usize) -> f32) -> Self {
        let mut result = Self::identity_border(len);
        for i in 0..len {
            for j in 0..=i {
                let value = entry(i, j);
                result.set(i, j, value);
                result.set(j, i, value);
            }
        }
        result
    }

    /// The lower triangle of a Cholesky factor, to be filled by [`set`](Self::set).
    pub(crate) fn identity_border(len: usize) -> Self {
        let tile = len.clamp(GROUP, TILE).next_power_of_two();
        let rows = len.div_ceil(tile);
        let mut result =
            Self { len, tile, shift: tile.trailing_zeros(), values: vec![0.0; rows * (rows + 1) / 2 * tile * tile] };
        for i in len..rows * tile {
            result.set(i, i, 1.0);
        }
        result
    }

    /// Number of rows and columns.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The entry in row `i` and column `j`.
    ///
    /// # Panics
    /// If there is no such entry.
    pub fn get(&self, i: usize, j: usize) -> f32 {
        self.values[self.place(i.max(j), i.min(j))]
    }

    /// Adds to an entry of the diagonal.
    ///
    /// # Panics
    /// If there is no such entry.
    pub fn add_to_diagonal(&mut self, i: usize, value: f32) {
        let place = self.place(i, i);
        self.values[place] += value;
    }

    /// Sets an entry with `i` ≥ `j`, or any entry of a tile on the diagonal.
    pub(crate) fn set(&mut self, i: usize, j: usize, value: f32) {
        if i / self.tile >= j / self.tile {
            let place = self.place(i, j);
            self.values[place] = value;
        }
    }

    fn place(&self, i: usize, j: usize) -> usize {
        let inside = self.tile - 1;
        self.start(i >> self.shift, j >> self.shift) + ((j & inside) << self.shift) + (i & inside)
    }

    /// Place of the first entry of a tile.
    fn start(&self, i: usize, j: usize) -> usize {
        (i * (i + 1) / 2 + j) << (2 * self.shift)
    }

    fn tile_rows(&self) -> usize {
        self.len.div_ceil(self.tile)
    }

    /// y ← A x, both of length `len()`. Tiles where x is zero are not read.
    ///
    /// # Panics
    /// If a length is wrong.
    pub fn mul(&self, x: &[f32], y: &mut [f32]) {
        assert!(x.len() == self.len && y.len() == self.len, "vectors of {} and {} for {}", x.len(), y.len(), self.len);
        let (t, rows) = (self.tile, self.tile_rows());
        let mut padded = x.to_vec();
        padded.resize(rows * t, 0.0);
        let zero: Vec<bool> = padded.chunks_exact(t).map(|x| x.iter().all(|&x| x == 0.0)).collect();
        // Parts of about as many tiles.
        let parts = (rows * (rows + 1) / 2 / TILES_PER_PART).clamp(1, PARTS);
        let cuts: Vec<usize> =
            (0..=parts).map(|p| (rows as f64 * (p as f64 / parts as f64).sqrt()).round() as usize).collect();
        let sums: Vec<Vec<f32>> = (0..parts)
            .into_par_iter()
            .map(|p| {
                let mut sum = vec![0.0; cuts[p + 1] * t];
                let tiles = (cuts[p]..cuts[p + 1]).flat_map(|i| (0..=i).map(move |j| (i, j)));
                pulp::Arch::new().dispatch(|| {
                    for (i, j) in tiles.filter(|&(i, j)| !(zero[i] && zero[j])) {
                        let (before, own) = sum.split_at_mut(i * t);
                        let tile = &self.values[self.start(i, j)..][..t * t];
                        let (xi, xj) = (&padded[i * t..][..t], &padded[j * t..][..t]);
                        if i == j {
                            add_product(tile, xj, &mut own[..t]);
                        } else {
                            add_products(tile, (xi, xj), &mut own[..t], &mut before[j * t..][..t]);
                        }
                    }
                });
                sum
            })
            .collect();
        y.fill(0.0);
        for sum in sums {
            y.iter_mut().zip(sum).for_each(|(y, s)| *y += s);
        }
    }

    /// A factor L becomes the symmetric L Lᵀ.
    pub(crate) fn square(&mut self) {
        let size = self.tile * self.tile;
        for i in (0..self.tile_rows()).rev() {
            // Row i of L Lᵀ needs the rows up to i of L.
            let start = self.start(i, 0);
            let (before, from) = self.values.split_at_mut(start);
            let row = &mut from[..(i + 1) * size];
            let own = row.to_vec();
            row.par_chunks_exact_mut(size).enumerate().for_each(|(j, out)| {
                let other = if j < i { &before[j * (j + 1) / 2 * size..][..(j + 1) * size] } else { &own[..] };
                let mut out = view_mut(out);
                out.fill(0.0);
                for (a, b) in own.chunks_exact(size).zip(other.chunks_exact(size)) {
                    matmul(out.as_mut(), Accum::Add, view(a), view(b).transpose(), 1.0, Par::Seq);
                }
            });
        }
    }

    /// A factor L becomes L⁻¹.
    fn invert_triangle(&mut self) {
        let (t, size) = (self.tile, self.tile * self.tile);
        for i in 0..self.tile_rows() {
            // Row i of L⁻¹ needs that of L and the earlier ones of L⁻¹.
            let start = self.start(i, 0);
            let (before, from) = self.values.split_at_mut(start);
            let row = &mut from[..(i + 1) * size];
            let own = row.to_vec();
            let diagonal = view(&own[i * size..]);
            row.par_chunks_exact_mut(size).enumerate().for_each(|(j, out)| {
                let mut out = view_mut(out);
                if j == i {
                    out.copy_from(Mat::<f32>::identity(t, t));
                } else {
                    out.fill(0.0);
                    for k in j..i {
                        let other = &before[(k * (k + 1) / 2 + j) * size..][..size];
                        matmul(out.as_mut(), Accum::Add, view(&own[k * size..][..size]), view(other), -1.0, Par::Seq);
                    }
                }
                solve_lower_triangular_in_place(diagonal, out, Par::Seq);
            });
        }
    }

    /// A factor L becomes the symmetric (L Lᵀ)⁻¹.
    pub(crate) fn invert(&mut self) {
        self.invert_triangle();
        let size = self.tile * self.tile;
        let rows = self.tile_rows();
        for i in 0..rows {
            // Row i of NᵀN, N = L⁻¹, needs the rows from i on of N.
            let start = self.start(i, 0);
            let (row, after) = self.values[start..].split_at_mut((i + 1) * size);
            let own = row.to_vec();
            // Tile (k, j), k > i.
            let tile = |k: usize, j: usize| &after[(k * (k + 1) / 2 - (i + 1) * (i + 2) / 2 + j) * size..][..size];
            row.par_chunks_exact_mut(size).enumerate().for_each(|(j, out)| {
                let mut out = view_mut(out);
                let (a, b) = (&own[i * size..], &own[j * size..][..size]);
                matmul(out.as_mut(), Accum::Replace, view(a).transpose(), view(b), 1.0, Par::Seq);
                for k in i + 1..rows {
                    let (a, b) = (tile(k, i), tile(k, j));
                    matmul(out.as_mut(), Accum::Add, view(a).transpose(), view(b), 1.0, Par::Seq);
                }
            });
        }
    }
}

fn view(tile: &[f32]) -> MatRef<'_, f32> {
    let t = tile.len().isqrt();
    MatRef::from_column_major_slice(tile, t, t)
}

fn view_mut(tile: &mut [f32]) -> MatMut<'_, f32> {
    let t = tile.len().isqrt();
    MatMut::from_column_major_slice_mut(tile, t, t)
}

/// y += A x.
#[inline(always)]
fn add_product(tile: &[f32], x: &[f32], y: &mut [f32]) {
    let t = x.len();
    for (columns, x) in tile.chunks_exact(GROUP * t).zip(x.chunks_exact(GROUP)) {
        for r in 0..t {
            y[r] += (0..GROUP).map(|c| columns[c * t + r] * x[c]).sum::<f32>();
        }
    }
}

/// yi += A xj and yj += Aᵀ xi, reading A once.
#[inline(always)]
fn add_products(tile: &[f32], (xi, xj): (&[f32], &[f32]), yi: &mut [f32], yj: &mut [f32]) {
    let t = xi.len();
    let whole = t - t % LANES;
    let groups = tile.chunks_exact(GROUP * t).zip(xj.chunks_exact(GROUP)).zip(yj.chunks_exact_mut(GROUP));
    for ((columns, xj), yj) in groups {
        let columns: [&[f32]; GROUP] = std::array::from_fn(|c| &columns[c * t..][..t]);
        let mut sums = [[0.0f32; LANES]; GROUP];
        for r in (0..whole).step_by(LANES) {
            let x: [f32; LANES] = std::array::from_fn(|l| xi[r + l]);
            let mut y: [f32; LANES] = std::array::from_fn(|l| yi[r + l]);
            for c in 0..GROUP {
                let a = &columns[c][r..r + LANES];
                for l in 0..LANES {
                    y[l] += a[l] * xj[c];
                    sums[c][l] += a[l] * x[l];
                }
            }
            yi[r..r + LANES].copy_from_slice(&y);
        }
        for c in 0..GROUP {
            yj[c] += sums[c].iter().sum::<f32>();
            for r in whole..t {
                yi[r] += columns[c][r] * xj[c];
                yj[c] += columns[c][r] * xi[r];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A diagonally dominant matrix of several tiles, its factor, and a vector.
    fn example(n: usize) -> (Mat<f64>, DenseSymmetric, Vec<f32>) {
        let a = Mat::from_fn(n, n, |i, j| {
            let distance = i.abs_diff(j) as f64;
            if i == j { 4.0 } else { ((i + j) as f64).sin() / (1.0 + distance * distance) }
        });
        let llt = a.llt(faer::Side::Lower).unwrap();
        let mut factor = DenseSymmetric::identity_border(n);
        (0..n).for_each(|j| (j..n).for_each(|i| factor.set(i, j, llt.L()[(i, j)] as f32)));
        (a, factor, (0..n).map(|i| (0.7 * i as f32).cos()).collect())
    }

    #[test]
    fn from_a_factor_to_the_matrix_and_its_inverse() {
        for n in [1, 3, 5, TILE, 2 * TILE + 37, 11 * TILE] {
            let (a, factor, x) = example(n);
            let mut square = factor.clone();
            square.square();
            let mut inverse = factor;
            inverse.invert();
            for k in 0..n {
                let (i, j) = (k * k % n, k);
                assert!((f64::from(square.get(i, j)) - a[(i, j)]).abs() < 1e-5, "{n}: {i} {j}");
                assert_eq!(square.get(i, j), square.get(j, i));
            }
            let mut y = vec![0.0; n];
            square.mul(&x, &mut y);
            for i in 0..n {
                let expected: f64 = (0..n).map(|j| a[(i, j)] * f64::from(x[j])).sum();
                assert!((f64::from(y[i]) - expected).abs() < 1e-4, "{n}: {} not {expected}", y[i]);
            }
            let mut back = vec![0.0; n];
            inverse.mul(&y, &mut back);
            assert!((0..n).all(|i| (back[i] - x[i]).abs() < 1e-4), "{n}");
        }
    }

    #[test]
    fn products_do_not_depend_on_threads_and_skip_zeros() {
        let (_, mut s, mut x) = example(11 * TILE);
        s.square();
        x[..7 * TILE].fill(0.0);
        let products = [1, 2, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut y = vec![0.0; x.len()];
            pool.install(|| s.mul(&x, &mut y));
            y
        });
        assert!(products[0] == products[1] && products[0] == products[2]);
        let expected: f32 = (0..x.len()).map(|j| s.get(8 * TILE, j) * x[j]).sum();
        assert!((products[0][8 * TILE] - expected).abs() < 1e-4);
    }
}
