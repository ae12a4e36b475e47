//! Dense symmetric matrices by tiles of their lower triangle, in single precision or less.
//!
//! A tile whose entries are small beside the diagonal of the matrix is in 16-bit integers times a scale: exact to as much of
//! the diagonal as single precision is, and half the memory and the reading per product. Of an inverse, which only
//! preconditions, all tiles but those on the diagonal are.
//!
//! The algorithms from a Cholesky factor L to L Lᵀ and to (L Lᵀ)⁻¹ go tile row by tile row (LAPACK's `trtri` and `lauum`), and
//! each row of the result is packed as soon as it is known. The work is cut by the size of the matrix alone, so results do not
//! depend on the number of threads.

use std::collections::VecDeque;
use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use crate::buffer::Buffer;

/// Rows of a tile: three fit into a cache of the second level.
const TILE: usize = 128;
/// A tile with no entry above this part of the largest on the diagonal is packed, with errors of 5e-7 of that.
const SMALL: f32 = 0.03;
/// Columns of a tile that a product handles together.
const GROUP: usize = 4;
/// A product is cut into at most so many parts, of at least so many tiles.
const PARTS: usize = 8;
const TILES_PER_PART: usize = 16;

/// Rows of a tile of a matrix: a power of 2.
fn tile_rows(len: usize) -> usize {
    len.clamp(GROUP, TILE).next_power_of_two()
}

/// A dense symmetric matrix for products.
///
/// Made from a factor by [`Cholesky::schur`](crate::Cholesky::schur): S is exact to about single precision of the largest entry
/// on the diagonal, S⁻¹ to 1.5e-5 of the largest of a tile.
#[derive(Clone, Debug)]
pub struct DenseSymmetric {
    len: usize,
    /// Rows of a tile.
    tile: usize,
    /// Tiles (i, j ≤ i) by rows, each by columns; one on the diagonal is whole. The last row and column of tiles are filled up
    /// with the identity.
    tiles: Vec<Tile>,
    /// Their values; few large arrays leave fewer gaps in memory than many small ones.
    single: Vec<f32>,
    packed: Vec<i16>,
}

/// Where the values of a tile start.
#[derive(Clone, Copy, Debug)]
enum Tile {
    Single { start: usize },
    Packed { start: usize, scale: f32 },
}

impl DenseSymmetric {
    /// The symmetric matrix with `entry(i, j)` for i ≥ j.
    pub fn from_fn(len: usize, entry: impl Fn(usize, usize) -> f32) -> Self {
        let mut result = Self::with_capacity(len, [true, false]);
        let t = result.tile;
        let padded = |i: usize, j: usize| if i < len { entry(i, j) } else { f32::from(i == j) };
        for i in 0..len.div_ceil(t) {
            for j in 0..=i {
                let places = (0..t * t).map(|k| (i * t + k % t, j * t + k / t));
                let values: Vec<f32> = places.map(|(i, j)| padded(i.max(j), i.min(j))).collect();
                result.set_tile((i, j), &values, 0.0);
            }
        }
        result
    }

    /// To be filled. `tiles` tells whether those off the diagonal may be single, and packed.
    fn with_capacity(len: usize, tiles: [bool; 2]) -> Self {
        let tile = tile_rows(len);
        let (rows, size) = (len.div_ceil(tile), tile * tile);
        let off_diagonal = first(rows) - rows;
        let [single, packed] = tiles.map(|possible| if possible { off_diagonal * size } else { 0 });
        Self {
            len,
            tile,
            tiles: vec![Tile::Single { start: 0 }; first(rows)],
            single: Vec::with_capacity(rows * size + single),
            packed: Vec::with_capacity(packed),
        }
    }

    /// Sets tile (i, j); one off the diagonal without an entry above `limit` is packed.
    fn set_tile(&mut self, (i, j): (usize, usize), values: &[f32], limit: f32) {
        const LARGEST: f32 = i16::MAX as f32;
        let largest = values.iter().fold(0.0f32, |largest, v| largest.max(v.abs()));
        self.tiles[first(i) + j] = if i == j || largest > limit {
            self.single.extend_from_slice(values);
            Tile::Single { start: self.single.len() - values.len() }
        } else {
            let by = if largest > 0.0 { LARGEST / largest } else { 0.0 };
            self.packed.extend(values.iter().map(|v| (v * by).round() as i16));
            Tile::Packed { start: self.packed.len() - values.len(), scale: largest / LARGEST }
        };
    }

    /// Sets the tiles of row `i` from what `compute` adds to zeros for tile (i, j), several at a time.
    fn set_row(&mut self, i: usize, limit: f32, compute: impl Fn(usize, &mut [f32]) + Sync) {
        let size = self.tile * self.tile;
        let group = at_a_time();
        let mut tiles = vec![0.0; size * group.min(i + 1)];
        for start in (0..=i).step_by(group) {
            let tiles = &mut tiles[..size * group.min(i + 1 - start)];
            tiles.fill(0.0);
            tiles.par_chunks_exact_mut(size).enumerate().for_each(|(k, tile)| compute(start + k, tile));
            let numbered = tiles.chunks_exact(size).zip(start..);
            numbered.for_each(|(tile, j)| self.set_tile((i, j), tile, limit));
        }
    }

    fn shrink(&mut self) {
        self.single.shrink_to_fit();
        self.packed.shrink_to_fit();
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
        let (i, j) = (i.max(j), i.min(j));
        let inside = j % self.tile * self.tile + i % self.tile;
        match self.tiles[first(i / self.tile) + j / self.tile] {
            Tile::Single { start } => self.single[start + inside],
            Tile::Packed { start, scale } => scale * f32::from(self.packed[start + inside]),
        }
    }

    /// Adds to an entry of the diagonal.
    ///
    /// # Panics
    /// If there is no such entry.
    pub fn add_to_diagonal(&mut self, i: usize, value: f32) {
        let (row, inside) = (i / self.tile, i % self.tile * (self.tile + 1));
        match self.tiles[first(row) + row] {
            Tile::Single { start } => self.single[start + inside] += value,
            Tile::Packed { .. } => unreachable!("tiles on the diagonal are not packed"),
        }
    }

    /// y ← A x, both of length `len()`. Tiles where x is zero are not read.
    ///
    /// # Panics
    /// If a length is wrong.
    pub fn mul(&self, x: &[f32], y: &mut [f32]) {
        assert!(x.len() == self.len && y.len() == self.len, "vectors of {} and {} for {}", x.len(), y.len(), self.len);
        let (t, rows) = (self.tile, self.len.div_ceil(self.tile));
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
                let rows = cuts[p]..cuts[p + 1];
                pulp::Arch::new().dispatch(TileRows { matrix: self, rows, x: &padded, zero: &zero, sum: &mut sum });
                sum
            })
            .collect();
        y.fill(0.0);
        for sum in sums {
            y.iter_mut().zip(sum).for_each(|(y, s)| *y += s);
        }
    }
}

/// Number of tiles that are computed before they are packed: results do not depend on it.
fn at_a_time() -> usize {
    2 * rayon::current_num_threads()
}

/// Number of the first tile in tile row `i`.
fn first(i: usize) -> usize {
    i * (i + 1) / 2
}

/// A lower triangle in single precision: rows of tiles (i, j ≤ i), those on the diagonal whole. The last row and column of
/// tiles are filled up with the identity. A row that is done with is dropped.
#[derive(Debug)]
pub(crate) struct Triangle {
    len: usize,
    tile: usize,
    rows: VecDeque<Buffer<f32>>,
}

impl Triangle {
    /// To be filled by [`set`](Self::set).
    pub(crate) fn identity_border(len: usize) -> Self {
        let tile = tile_rows(len);
        let rows = len.div_ceil(tile);
        let mut result = Self { len, tile, rows: (0..rows).map(|i| Buffer::zeros((i + 1) * tile * tile)).collect() };
        (len..rows * tile).for_each(|i| result.set(i, i, 1.0));
        result
    }

    /// Sets an entry with `i` ≥ `j`, or any entry of a tile on the diagonal.
    pub(crate) fn set(&mut self, i: usize, j: usize, value: f32) {
        let t = self.tile;
        if i / t >= j / t {
            self.rows[i / t][j / t * t * t + j % t * t + i % t] = value;
        }
    }

    /// Sets the entries of column `j` from its diagonal down.
    pub(crate) fn set_column(&mut self, j: usize, values: &[f64]) {
        let t = self.tile;
        let mut i = j;
        let mut rest = values;
        while !rest.is_empty() {
            let (own, below) = rest.split_at(rest.len().min(t - i % t));
            let start = j / t * t * t + j % t * t + i % t;
            let places = &mut self.rows[i / t][start..start + own.len()];
            places.iter_mut().zip(own).for_each(|(place, &v)| *place = v as f32);
            (i, rest) = (i + own.len(), below);
        }
    }

    /// L Lᵀ, L being this triangle.
    pub(crate) fn square(mut self) -> DenseSymmetric {
        let (t, size) = (self.tile, self.tile * self.tile);
        let diagonal =
            (0..self.len).map(|i| self.rows[i / t].iter().skip(i % t).step_by(t).map(|v| v * v).sum::<f32>());
        let limit = SMALL * diagonal.fold(0.0, f32::max);
        let mut result = DenseSymmetric::with_capacity(self.len, [true, true]);
        // Row i of L Lᵀ needs the rows up to i of L: from the last on, L makes room for it.
        while let Some(own) = self.rows.pop_back() {
            result.set_row(self.rows.len(), limit, |j, out| {
                let mut out = view_mut(out);
                let other = self.rows.get(j).unwrap_or(&own);
                for (a, b) in own.chunks_exact(size).zip(other.chunks_exact(size)) {
                    matmul(out.as_mut(), Accum::Add, view(a), view(b).transpose(), 1.0, Par::Seq);
                }
            });
        }
        result.shrink();
        result
    }

    /// L becomes L⁻¹.
    fn invert_triangle(&mut self) {
        let (t, size) = (self.tile, self.tile * self.tile);
        let group = at_a_time();
        let mut tiles = vec![0.0; size * group];
        for i in 0..self.rows.len() {
            // Tile (i, j) of L⁻¹ needs the tiles from j on of row i of L, and the earlier rows of L⁻¹.
            for start in (0..=i).step_by(group) {
                let tiles = &mut tiles[..size * group.min(i + 1 - start)];
                let own = &self.rows[i];
                tiles.par_chunks_exact_mut(size).enumerate().for_each(|(j, out)| {
                    let j = start + j;
                    let mut out = view_mut(out);
                    if j == i {
                        out.copy_from(Mat::<f32>::identity(t, t));
                    } else {
                        out.fill(0.0);
                        for k in j..i {
                            let (a, b) = (&own[k * size..][..size], &self.rows[k][j * size..][..size]);
                            matmul(out.as_mut(), Accum::Add, view(a), view(b), -1.0, Par::Seq);
                        }
                    }
                    solve_lower_triangular_in_place(view(&own[i * size..]), out, Par::Seq);
                });
                self.rows[i][start * size..][..tiles.len()].copy_from_slice(tiles);
            }
        }
    }

    /// (L Lᵀ)⁻¹, L being this triangle.
    pub(crate) fn inverse(mut self) -> DenseSymmetric {
        self.invert_triangle();
        let size = self.tile * self.tile;
        let mut result = DenseSymmetric::with_capacity(self.len, [false, true]);
        let mut i = 0;
        // Row i of NᵀN, N = L⁻¹, needs the rows from i on of N, which makes room for it.
        while let Some(own) = self.rows.pop_front() {
            result.set_row(i, f32::INFINITY, |j, out| {
                let mut out = view_mut(out);
                for factor in std::iter::once(&own).chain(&self.rows) {
                    let [a, b] = [i, j].map(|column| &factor[column * size..][..size]);
                    matmul(out.as_mut(), Accum::Add, view(a).transpose(), view(b), 1.0, Par::Seq);
                }
            });
            i += 1;
        }
        result
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

/// What some rows of tiles, and their transposes, add to a product.
struct TileRows<'a> {
    matrix: &'a DenseSymmetric,
    rows: Range<usize>,
    x: &'a [f32],
    zero: &'a [bool],
    sum: &'a mut [f32],
}

impl WithSimd for TileRows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { matrix, rows, x, zero, sum } = self;
        let (t, size) = (matrix.tile, matrix.tile * matrix.tile);
        for i in rows {
            let (before, own) = sum.split_at_mut(i * t);
            let (own, xi) = (&mut own[..t], &x[i * t..][..t]);
            for (j, tile) in matrix.tiles[first(i)..first(i + 1)].iter().enumerate() {
                if zero[i] && zero[j] {
                    continue;
                }
                let xj = &x[j * t..][..t];
                match *tile {
                    Tile::Single { start } if j == i => add_product(simd, &matrix.single[start..][..size], xi, own),
                    Tile::Single { start } => {
                        let values = &matrix.single[start..][..size];
                        let yj = &mut before[j * t..][..t];
                        for ((columns, xj), yj) in groups(values, xj, yj) {
                            add_products(simd, columns, 1.0, (xi, xj), own, yj);
                        }
                    }
                    Tile::Packed { start, scale } => {
                        let values = &matrix.packed[start..][..size];
                        let mut buffer = [0.0f32; GROUP * TILE];
                        let yj = &mut before[j * t..][..t];
                        for ((packed, xj), yj) in groups(values, xj, yj) {
                            let columns = &mut buffer[..packed.len()];
                            columns.iter_mut().zip(packed).for_each(|(c, &p)| *c = f32::from(p));
                            add_products(simd, columns, scale, (xi, xj), own, yj);
                        }
                    }
                }
            }
        }
    }
}

/// Groups of columns with the entries of x and y that go with them.
#[inline(always)]
fn groups<'a, T>(
    tile: &'a [T],
    x: &'a [f32],
    y: &'a mut [f32],
) -> impl Iterator<Item = ((&'a [T], &'a [f32]), &'a mut [f32])> {
    tile.chunks_exact(GROUP * x.len()).zip(x.chunks_exact(GROUP)).zip(y.chunks_exact_mut(GROUP))
}

/// y += A x.
#[inline(always)]
fn add_product<S: Simd>(simd: S, tile: &[f32], x: &[f32], y: &mut [f32]) {
    for (column, &x) in tile.chunks_exact(x.len()).zip(x) {
        let ((a, a_rest), (y, y_rest)) = (S::as_simd_f32s(column), S::as_mut_simd_f32s(y));
        let factor = simd.splat_f32s(x);
        for (y, &a) in y.iter_mut().zip(a) {
            *y = simd.mul_add_e_f32s(a, factor, *y);
        }
        for (y, &a) in y_rest.iter_mut().zip(a_rest) {
            *y += a * x;
        }
    }
}

/// yi += A xj and yj += Aᵀ xi, A being a group of columns times a scale, which are read once.
#[inline(always)]
fn add_products<S: Simd>(
    simd: S,
    columns: &[f32],
    scale: f32,
    (xi, xj): (&[f32], &[f32]),
    yi: &mut [f32],
    yj: &mut [f32],
) {
    let (x, x_rest) = S::as_simd_f32s(xi);
    let (y, y_rest) = S::as_mut_simd_f32s(yi);
    let mut a: [(&[S::f32s], &[f32]); GROUP] = [(&[], &[]); GROUP];
    let (mut factors, mut sums) = ([simd.splat_f32s(0.0); GROUP], [simd.splat_f32s(0.0); GROUP]);
    for (c, column) in columns.chunks_exact(xi.len()).enumerate() {
        a[c] = S::as_simd_f32s(column);
        factors[c] = simd.splat_f32s(scale * xj[c]);
    }
    for (r, (y, &x)) in y.iter_mut().zip(x).enumerate() {
        for c in 0..GROUP {
            *y = simd.mul_add_e_f32s(a[c].0[r], factors[c], *y);
            sums[c] = simd.mul_add_e_f32s(a[c].0[r], x, sums[c]);
        }
    }
    for c in 0..GROUP {
        let mut sum = simd.reduce_sum_f32s(sums[c]);
        for ((y, &x), &a) in y_rest.iter_mut().zip(x_rest).zip(a[c].1) {
            *y += a * scale * xj[c];
            sum += a * x;
        }
        yj[c] += scale * sum;
    }
}

#[cfg(test)]
mod tests {
    use faer::linalg::solvers::Solve;

    use super::*;

    /// A diagonally dominant matrix of several tiles, its factor, and a vector.
    fn example(n: usize) -> (Mat<f64>, impl Fn() -> Triangle, Vec<f32>) {
        let a = Mat::from_fn(n, n, |i, j| {
            let distance = i.abs_diff(j) as f64;
            if i == j { 4.0 } else { ((i + j) as f64).sin() / (1.0 + distance * distance) }
        });
        let llt = a.llt(faer::Side::Lower).unwrap();
        let factor = move || {
            let mut factor = Triangle::identity_border(n);
            (0..n).for_each(|j| (j..n).for_each(|i| factor.set(i, j, llt.L()[(i, j)] as f32)));
            factor
        };
        (a, factor, (0..n).map(|i| (0.7 * i as f32).cos()).collect())
    }

    #[test]
    fn from_a_factor_to_the_matrix_and_its_inverse() {
        for n in [1, 3, 5, TILE, 2 * TILE + 37, 11 * TILE] {
            let (a, factor, x) = example(n);
            let (square, inverse) = (factor().square(), factor().inverse());
            let identity = Mat::<f64>::identity(n, n);
            let exact = a.llt(faer::Side::Lower).unwrap().solve(&identity);
            for (matrix, exact) in [(&square, &a), (&inverse, &exact)] {
                for k in 0..n {
                    let (i, j) = (k * k % n, k);
                    assert!((f64::from(matrix.get(i, j)) - exact[(i, j)]).abs() < 1e-5, "{n}: {i} {j}");
                    assert_eq!(matrix.get(i, j), matrix.get(j, i));
                }
                let mut y = vec![0.0; n];
                matrix.mul(&x, &mut y);
                for i in 0..n {
                    let expected: f64 = (0..n).map(|j| f64::from(matrix.get(i, j)) * f64::from(x[j])).sum();
                    assert!((f64::from(y[i]) - expected).abs() < 1e-5, "{n}: {} not {expected}", y[i]);
                }
            }
        }
    }

    #[test]
    fn products_do_not_depend_on_threads_and_skip_zeros() {
        let (_, factor, mut x) = example(11 * TILE);
        let s = factor().square();
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
