//! Factorisation, solves, and partial elimination.

use std::sync::Arc;

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::sparse::linalg::SymbolicSupernodalParams;
use faer::sparse::linalg::cholesky::{simplicial, supernodal};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{MatMut, Par};

use crate::buffer::Buffer;
use crate::error::{Error, check_len};
use crate::panels::{Panels, Work};
use crate::pattern::{Pattern, SparseSymmetric, bucket_starts};
use crate::tiles::DenseSymmetric;

/// Largest scaled residual ‖Ax − b‖ / (‖A‖ ‖x‖ + ‖b‖), in maximum norms, of the test solve after a
/// factorisation. Cholesky is backward stable, so a sound factor leaves some 1e-16 to 1e-15
/// whatever the condition number; a wrong one leaves 1e-8 and more.
pub const MAX_RESIDUAL: f64 = 1e-12;

/// Memory of a factorisation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// Stored entries of the factor. Supernodes are stored as rectangles, so this counts some
    /// zeros and the unused upper triangles of their diagonal blocks.
    pub factor_entries: usize,
    /// Bytes of the factor's values.
    pub factor_bytes: usize,
    /// Bytes of everything that is kept: values and index structure.
    pub total_bytes: usize,
}

/// The analysis of a pattern: all that does not depend on values.
#[derive(Debug)]
pub struct Symbolic {
    pattern: Arc<Pattern>,
    panels: Panels,
}

impl Symbolic {
    /// Analyses a pattern.
    ///
    /// # Errors
    /// [`Error::TooLarge`] if the factor would have 2³¹ entries or more, [`Error::OutOfMemory`].
    pub fn new(pattern: &Arc<Pattern>) -> Result<Self, Error> {
        let n = pattern.len();
        let (upper_ptr, upper_row) = transpose(pattern);
        let upper = SymbolicSparseColMatRef::new_checked(n, n, &upper_ptr, None, &upper_row);
        let scratch = StackReq::any_of(&[
            simplicial::prefactorize_symbolic_cholesky_scratch::<u32>(n, upper_row.len()),
            supernodal::factorize_supernodal_symbolic_cholesky_scratch::<u32>(n),
        ]);
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| Error::OutOfMemory)?;
        let stack = MemStack::new(&mut memory);
        let mut parents = vec![0i32; n];
        let mut counts = vec![0u32; n];
        let tree = simplicial::prefactorize_symbolic_cholesky(&mut parents, &mut counts, upper, stack);
        let supernodes = supernodal::factorize_supernodal_symbolic_cholesky(
            upper,
            tree,
            &counts,
            stack,
            SymbolicSupernodalParams::default(),
        )?;
        Ok(Self { pattern: Arc::clone(pattern), panels: Panels::new(supernodes, pattern.leading()) })
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.pattern.len()
    }

    /// Whether there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.pattern.is_empty()
    }

    /// The pattern.
    pub fn pattern(&self) -> &Arc<Pattern> {
        &self.pattern
    }

    /// Stored entries of a factor. See [`Memory::factor_entries`].
    pub fn factor_entries(&self) -> usize {
        self.panels.supernodes().len_val()
    }
}

/// The upper triangle of a pattern by columns.
fn transpose(pattern: &Pattern) -> (Vec<u32>, Buffer<u32>) {
    let (col_ptr, rows) = pattern.lower();
    let ptr = bucket_starts(pattern.len(), rows.iter().map(|&i| i as usize));
    let mut next = ptr.clone();
    let mut columns = Buffer::zeros(rows.len());
    for (j, range) in col_ptr.windows(2).enumerate() {
        for &i in &rows[range[0] as usize..range[1] as usize] {
            columns[next[i as usize] as usize] = j as u32;
            next[i as usize] += 1;
        }
    }
    (ptr, columns)
}

/// Work space of solves: one per thread that solves. Grows on first use, then stays.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    permuted: Vec<f64>,
    work: Work,
}

/// A right-hand side after [`Cholesky::forward`].
#[derive(Clone, Debug, Default)]
pub struct Forward {
    /// In elimination order: L11⁻¹ b_u, then the condensed right-hand side.
    values: Vec<f64>,
    leading: usize,
}

impl Forward {
    /// The condensed right-hand side b_g − A_gu A_uu⁻¹ b_u, in the order of the trailing list.
    pub fn condensed(&self) -> &[f64] {
        &self.values[self.leading..]
    }
}

/// A Cholesky factorisation P A Pᵀ = L Lᵀ.
///
/// Vectors are in the caller's numbering of unknowns, those of trailing unknowns in the order of
/// the trailing list. Solves take `&self` and a [`Scratch`], so several threads can solve at once;
/// a single solve also uses the threads of the [`Par`] given to the factorisation, and its result
/// does not depend on their number.
pub struct Cholesky {
    symbolic: Arc<Symbolic>,
    factor: Vec<f64>,
    par: Par,
    valid: bool,
}

impl std::fmt::Debug for Cholesky {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        (f.debug_struct("Cholesky"))
            .field("len", &self.len())
            .field("memory", &self.memory())
            .field("par", &self.par)
            .field("valid", &self.valid)
            .finish_non_exhaustive()
    }
}

impl Cholesky {
    /// Factorises `a`, whose pattern must be the one analysed.
    ///
    /// The factorisation uses the threads of `par` only where the supernodes are large enough for
    /// them to pay, as in 3D; solves always do. A fixed system is solved with the result. If its residual exceeds [`MAX_RESIDUAL`] the
    /// factorisation is repeated once without threads.
    ///
    /// # Errors
    /// [`Error::PatternMismatch`], [`Error::NonFinite`], [`Error::NotPositiveDefinite`],
    /// [`Error::Inaccurate`], [`Error::OutOfMemory`].
    pub fn new(symbolic: &Arc<Symbolic>, a: &SparseSymmetric, par: Par) -> Result<Self, Error> {
        let mut result =
            Self { factor: vec![0.0; symbolic.factor_entries()], symbolic: Arc::clone(symbolic), par, valid: false };
        result.refactorise(a)?;
        Ok(result)
    }

    /// Factorises new values on the same pattern, in the same storage and with the same threads.
    ///
    /// # Errors
    /// Those of [`Cholesky::new`]. After an error there is no factor until a later call succeeds.
    pub fn refactorise(&mut self, a: &SparseSymmetric) -> Result<(), Error> {
        self.valid = false;
        if !Arc::ptr_eq(a.pattern(), &self.symbolic.pattern) && **a.pattern() != *self.symbolic.pattern {
            return Err(Error::PatternMismatch);
        }
        a.check_finite()?;
        let par = self.symbolic.panels.factor_par(self.par);
        self.factorise(a, par)?;
        let mut residual = self.test_residual(a);
        // NaN is not accurate either.
        let accurate = |residual: f64| residual <= MAX_RESIDUAL;
        if !accurate(residual) && par.degree() > 1 {
            self.factorise(a, Par::Seq)?;
            residual = self.test_residual(a);
        }
        if !accurate(residual) {
            return Err(Error::Inaccurate { residual, tolerance: MAX_RESIDUAL });
        }
        self.valid = true;
        Ok(())
    }

    fn factorise(&mut self, a: &SparseSymmetric, par: Par) -> Result<(), Error> {
        let Symbolic { pattern, panels } = &*self.symbolic;
        let (n, supernodes) = (pattern.len(), panels.supernodes());
        let (col_ptr, rows) = pattern.lower();
        let lower = SymbolicSparseColMatRef::new_checked(n, n, col_ptr, None, &rows);
        let scratch =
            supernodal::factorize_supernodal_numeric_llt_scratch::<u32, f64>(supernodes, par, Default::default());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| Error::OutOfMemory)?;
        supernodal::factorize_supernodal_numeric_llt(
            &mut self.factor,
            SparseColMatRef::new(lower, a.values()),
            LltRegularization::default(),
            supernodes,
            par,
            MemStack::new(&mut memory),
            Default::default(),
        )
        .map(|_| ())
        .map_err(|LltError::NonPositivePivot { index }| Error::NotPositiveDefinite {
            unknown: pattern.unknowns()[index] as usize,
        })
    }

    /// The scaled residual of a solve with a fixed right-hand side.
    fn test_residual(&self, a: &SparseSymmetric) -> f64 {
        let n = self.len();
        let mut state = 1u64;
        let b: Vec<f64> = (0..n)
            .map(|_| {
                // A 64-bit linear congruential generator (Knuth); the top bits are good enough.
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
            })
            .collect();
        let mut x = b.clone();
        self.solve_ordered(&mut x, &mut Work::default());
        let mut r = vec![0.0; n];
        a.mul_ordered(&x, &mut r);
        // Unlike f64::max, keeps NaN.
        let norm = |v: &mut dyn Iterator<Item = f64>| v.fold(0.0f64, |m, e| if e.abs() <= m { m } else { e.abs() });
        let residual = norm(&mut r.iter().zip(&b).map(|(r, b)| r - b));
        let scale = a.norm() * norm(&mut x.iter().copied()) + norm(&mut b.iter().copied());
        if n == 0 { 0.0 } else { residual / scale }
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.symbolic.len()
    }

    /// Whether there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.symbolic.is_empty()
    }

    /// The analysis.
    pub fn symbolic(&self) -> &Arc<Symbolic> {
        &self.symbolic
    }

    /// What the factorisation occupies.
    pub fn memory(&self) -> Memory {
        let factor_bytes = size_of_val(&self.factor[..]);
        Memory {
            factor_entries: self.factor.len(),
            factor_bytes,
            total_bytes: factor_bytes + self.symbolic.pattern.bytes() + self.symbolic.panels.bytes(),
        }
    }

    /// x ← A⁻¹ x, of length `len()`.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::NotFactorised`].
    pub fn solve(&self, x: &mut [f64], scratch: &mut Scratch) -> Result<(), Error> {
        self.check(x.len())?;
        let Scratch { permuted, work } = scratch;
        permuted.resize(x.len(), 0.0);
        self.symbolic.pattern.gather(x, permuted);
        self.solve_ordered(permuted, work);
        self.symbolic.pattern.spread(permuted, x);
        Ok(())
    }

    /// x ← A⁻¹ x by positions.
    fn solve_ordered(&self, x: &mut [f64], work: &mut Work) {
        let panels = &self.symbolic.panels;
        panels.forward(&self.factor, x, false, self.par, work);
        panels.backward(&self.factor, x, false, self.par, work);
    }

    /// X ← A⁻¹ X, for a `len()` × k matrix.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::NotFactorised`].
    pub fn solve_many(&self, mut x: MatMut<'_, f64>, scratch: &mut Scratch) -> Result<(), Error> {
        self.check(x.nrows())?;
        let (n, k) = (x.nrows(), x.ncols());
        let Scratch { permuted, work } = scratch;
        permuted.resize(n * k, 0.0);
        let order = self.symbolic.pattern.unknowns();
        for (j, column) in permuted.chunks_exact_mut(n.max(1)).enumerate() {
            for (p, &u) in column.iter_mut().zip(order) {
                *p = x[(u as usize, j)];
            }
        }
        let y = MatMut::from_column_major_slice_mut(&mut permuted[..], n, k);
        let panels = &self.symbolic.panels;
        panels.solve_many(&self.factor, y, self.par, work);
        for (j, column) in permuted.chunks_exact(n.max(1)).enumerate() {
            for (p, &u) in column.iter().zip(order) {
                x[(u as usize, j)] = *p;
            }
        }
        Ok(())
    }

    /// Eliminates the leading unknowns from a right-hand side of length `len()`: afterwards
    /// [`Forward::condensed`] is b_g − A_gu A_uu⁻¹ b_u.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::NotFactorised`].
    pub fn forward(&self, b: &[f64], forward: &mut Forward, scratch: &mut Scratch) -> Result<(), Error> {
        self.check(b.len())?;
        forward.leading = self.symbolic.pattern.leading();
        forward.values.resize(b.len(), 0.0);
        self.symbolic.pattern.gather(b, &mut forward.values);
        (self.symbolic.panels).forward(&self.factor, &mut forward.values, true, self.par, &mut scratch.work);
        Ok(())
    }

    /// Recovers the leading unknowns A_uu⁻¹ (b_u − A_ug x_g) from `trailing` = x_g (in the order of
    /// the trailing list) and the b given to [`Cholesky::forward`]. Both parts are written to `x`,
    /// of length `len()`. `forward` can be used again with other trailing values.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::NotFactorised`].
    pub fn backward(
        &self,
        forward: &Forward,
        trailing: &[f64],
        x: &mut [f64],
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        self.check(x.len())?;
        check_len("forward", x.len(), forward.values.len())?;
        let leading = self.symbolic.pattern.leading();
        check_len("trailing values", x.len() - leading, trailing.len())?;
        let Scratch { permuted, work } = scratch;
        permuted.clear();
        permuted.extend_from_slice(&forward.values[..leading]);
        permuted.extend_from_slice(trailing);
        let panels = &self.symbolic.panels;
        panels.backward(&self.factor, permuted, true, self.par, work);
        self.symbolic.pattern.spread(permuted, x);
        Ok(())
    }

    /// The Schur complement S = A_gg − A_gu A_uu⁻¹ A_ug, m × m, in the order of the trailing list, and S⁻¹. Costs about m³
    /// multiplications; while S⁻¹ and then S are made, L22 gives way to them, m²/2 numbers of single precision.
    ///
    /// # Errors
    /// [`Error::NotFactorised`].
    pub fn schur(&self) -> Result<(DenseSymmetric, DenseSymmetric), Error> {
        self.check(self.len())?;
        let lower = || self.symbolic.panels.trailing_factor(&self.factor);
        let inverse = lower().inverse();
        Ok((lower().square(), inverse))
    }

    /// y += S x in double precision, with the Schur complement S as the factor holds it: reads m²/2 numbers.
    ///
    /// # Errors
    /// [`Error::Dimension`], [`Error::NotFactorised`].
    pub fn add_schur_product(&self, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        self.check(self.len())?;
        let m = self.symbolic.pattern.trailing();
        check_len("trailing values", m, x.len())?;
        check_len("product", m, y.len())?;
        self.symbolic.panels.trailing_product(&self.factor, x, y);
        Ok(())
    }

    fn check(&self, len: usize) -> Result<(), Error> {
        if !self.valid {
            return Err(Error::NotFactorised);
        }
        check_len("vector", self.len(), len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BlockGraph, Method, Ordering};

    /// A grid of `n` × `n` blocks of `size`, diagonally dominant.
    fn grid(n: u32, size: usize, trailing: &[u32]) -> SparseSymmetric {
        let cells: Vec<[u32; 4]> = (0..(n - 1) * (n - 1))
            .map(|k| k / (n - 1) * n + k % (n - 1))
            .map(|corner| [corner, corner + 1, corner + n, corner + n + 1])
            .collect();
        let graph = BlockGraph::uniform((n * n) as usize, size, &cells).unwrap();
        let ordering = Ordering::new(&graph, Method::Metis, trailing).unwrap();
        let pattern = Arc::new(Pattern::new(&graph, &ordering).unwrap());
        let mut a = SparseSymmetric::zeros(pattern);
        let width = 4 * size;
        let local: Vec<f64> = (0..width * width)
            .map(|k| (k / width, k % width))
            .map(|(i, j)| if i == j { width as f64 } else { -1.0 / (1 + i + j) as f64 })
            .collect();
        for cell in &cells {
            a.add(cell, &local).unwrap();
        }
        a
    }

    #[test]
    fn solves_do_not_depend_on_threads() {
        // Many subtrees; and one panel tall enough to be split.
        let many: Vec<u32> = (0..50).map(|k| 3 * k + 5).collect();
        for (a, subtrees, trailing) in [(grid(60, 2, &many), true, &many[..]), (grid(2, 400, &[3]), false, &[3])] {
            let size = if subtrees { 2 } else { 400 };
            let trailing: Vec<u32> = trailing.iter().flat_map(|b| b * size..(b + 1) * size).collect();
            let symbolic = Arc::new(Symbolic::new(a.pattern()).unwrap());
            assert_eq!(symbolic.panels.subtrees() > 4, subtrees);
            let mut cholesky = Cholesky::new(&symbolic, &a, Par::Seq).unwrap();
            let b: Vec<f64> = (0..a.len()).map(|i| (i % 17) as f64 - 7.3).collect();
            let mut results = Vec::new();
            for par in [Par::Seq, Par::rayon(2), Par::rayon(3)] {
                cholesky.par = par;
                let mut scratch = Scratch::default();
                let mut forward = Forward::default();
                let (mut x, mut y) = (b.clone(), b.clone());
                cholesky.solve(&mut x, &mut scratch).unwrap();
                cholesky.forward(&b, &mut forward, &mut scratch).unwrap();
                let x_g: Vec<f64> = trailing.iter().map(|&u| x[u as usize]).collect();
                (cholesky.backward(&forward, &x_g, &mut y, &mut scratch)).unwrap();
                let mut r = vec![0.0; b.len()];
                a.mul(&x, &mut r).unwrap();
                for i in 0..b.len() {
                    assert!((r[i] - b[i]).abs() < 1e-10 && (x[i] - y[i]).abs() < 1e-10);
                }
                results.push((x, y, forward.values));
            }
            assert!(results[0] == results[1] && results[0] == results[2]);
        }
    }
}
