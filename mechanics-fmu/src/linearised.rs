//! The linearised contact problem on the fracture.
//!
//! With the laws of [`crate::contact`] linearised, the correction v of the jumps is zero in the components that are given,
//! and for the others
//!
//! ```text
//! T S v + H v = b
//! ```
//!
//! T and H acting face by face. Where the normal component is given, v carries it with the slip as dilation wants it
//! ([`Linearised::carried`]). It is solved by GMRES, preconditioned with what is made once for all laws, S⁻¹: on the unknown
//! components, with s the mean of the diagonal of S on a face,
//!
//! ```text
//! (T S + H)⁻¹ ≈ [Θ S⁻¹ Θ + (1 − Θ) Θ / s] T⁻¹,   Θ = (1 + T⁻¹ H / s)⁻¹ face by face
//! ```
//!
//! which is S⁻¹, restricted to them, where the law is soft beside the bulk, and the inverse of the law where it is stiff. S is an
//! operator of order 1 on the fracture, as of a hypersingular integral, and S⁻¹ one of order −1. Restricted to a part of the
//! fracture they are inverse to each other but for a factor that grows with the logarithm of the number of faces (McLean,
//! Steinbach, Adv. Comput. Math. 1999; in 3D Hiptmair, Jerez-Hanckes, Urzúa-Torres, ETH SAM report 2016-09), so some ten
//! iterations gain three digits on any mesh.
//!
//! Where there is no S⁻¹, or where that takes too long, T S + H is factorised on the unknown components.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::solve::{solve_in_place, solve_in_place_scratch};
use faer::linalg::solvers::PartialPivLu;
use faer::{MatMut, MatRef, Par};
use linear::{DenseSymmetric, Krylov};
use mesh::Mat3;
use rayon::prelude::*;

use crate::contact::{Linearised, Local};
use crate::newton::NewtonReport;

/// Limit of GMRES.
const KRYLOV: usize = 40;

/// The Schur complement of the bulk on the jumps.
#[derive(Clone, Copy)]
pub(crate) struct Schur<'a> {
    /// Good to single precision.
    pub(crate) single: &'a DenseSymmetric,
    /// S⁻¹, where there is one.
    pub(crate) inverse: Option<&'a DenseSymmetric>,
    /// y += S x in double precision.
    pub(crate) add_product: &'a (dyn Fn(&[f64], &mut [f64]) + Sync),
}

/// T S + H in the components that `laws` leave unknown; vectors are over all components, and zero in the others.
#[derive(Clone, Copy)]
pub(crate) struct LinearisedProblem<'a, 'l> {
    pub(crate) dim: usize,
    pub(crate) schur: Schur<'a>,
    pub(crate) laws: &'l [Linearised],
}

/// What the preconditioner does on a face. What slip carries along is left to GMRES.
struct Weights {
    /// The column of T⁻¹ below the diagonal.
    lower: Local,
    /// Rows of Θ and (1 − Θ) Θ / s, zero in what is given.
    soft: [Local; 3],
    stiff: [Local; 3],
}

impl LinearisedProblem<'_, '_> {
    /// The solution to a residual of `target`; `None` where the problem is singular. Counts its work.
    pub(crate) fn solve(&self, b: &[f64], target: f64, report: &mut NewtonReport) -> Option<Vec<f64>> {
        if let Some(inverse) = self.schur.inverse {
            let weights: Vec<Weights> = (0..self.laws.len()).map(|face| self.weights(face)).collect();
            let (x, residual) = self.gmres(&|v| self.precondition(inverse, &weights, v), b, target, report);
            if residual <= target {
                return Some(x);
            }
        }
        let unknowns: Vec<usize> =
            (0..b.len()).filter(|&at| self.laws[at / self.dim].given[at % self.dim].is_none()).collect();
        let lu = factorise(unknowns.len(), |p, q| self.entry(unknowns[p], unknowns[q]));
        report.face_factorisations += 1;
        let solve = |v: &mut [f64]| {
            let mut x: Vec<f32> = unknowns.iter().map(|&at| v[at] as f32).collect();
            solve_lu(&lu, &mut x);
            unknowns.iter().zip(x).for_each(|(&at, x)| v[at] = f64::from(x));
        };
        let (x, residual) = self.gmres(&solve, b, target, report);
        // Single precision limits what is reached; Newton's method only needs a reduction.
        let size = b.iter().map(|b| b * b).sum::<f64>().sqrt();
        (residual <= target.max(0.1 * size)).then_some(x)
    }

    fn gmres(
        &self,
        precondition: &dyn Fn(&mut [f64]),
        b: &[f64],
        target: f64,
        report: &mut NewtonReport,
    ) -> (Vec<f64>, f64) {
        let mut x = vec![0.0; b.len()];
        let Krylov { iterations, residual } =
            linear::gmres(&|v, y| self.apply(v, y), precondition, b, &mut x, target, KRYLOV);
        report.linear_iterations += iterations;
        (x, residual)
    }

    /// An entry of T S + H in the unknown components, with what they carry; the rows of T reach the normal component and
    /// their own.
    fn entry(&self, row: usize, column: usize) -> f32 {
        let carried = self.laws[column / self.dim].carried[column % self.dim];
        let mut v = self.plain_entry(row, column);
        if carried != 0.0 {
            v += carried * self.plain_entry(row, column - column % self.dim);
        }
        v as f32
    }

    fn plain_entry(&self, row: usize, column: usize) -> f64 {
        let (i, c) = (row / self.dim, row % self.dim);
        let law = &self.laws[i];
        let mut v = law.t[c][c] * f64::from(self.schur.single.get(row, column));
        if c > 0 && law.t[c][0] != 0.0 {
            v += law.t[c][0] * f64::from(self.schur.single.get(row - c, column));
        }
        if column / self.dim == i {
            v += law.h[c][column % self.dim];
        }
        v
    }

    /// Adds to the given normal components what the unknown ones carry along.
    pub(crate) fn carry(&self, v: &mut [f64]) {
        for (own, law) in v.chunks_exact_mut(self.dim).zip(self.laws) {
            for c in 1..self.dim {
                if law.carried[c] != 0.0 {
                    own[0] += law.carried[c] * own[c];
                }
            }
        }
    }

    fn weights(&self, face: usize) -> Weights {
        let d = self.dim;
        let law = &self.laws[face];
        let unknown = |c: usize| c < d && law.given[c].is_none();
        // T has a unit diagonal. Where the normal component is given, its column is of no account.
        let lower: Local = std::array::from_fn(|c| if c > 0 && unknown(0) && unknown(c) { -law.t[c][0] } else { 0.0 });
        let diagonal = (0..d).map(|c| f64::from(self.schur.single.get(face * d + c, face * d + c)));
        let s = diagonal.sum::<f64>() / d as f64;
        let (mut one, mut law_over_s) = (Mat3::ZERO, Mat3::ZERO);
        for j in (0..d).filter(|&j| unknown(j)) {
            one.col_mut(j)[j] = 1.0;
            for i in (0..d).filter(|&i| unknown(i)) {
                law_over_s.col_mut(j)[i] = (law.h[i][j] + lower[i] * law.h[0][j]) / s;
            }
        }
        let theta = one * (Mat3::IDENTITY + law_over_s).inverse();
        let rows = |m: Mat3| m.transpose().to_cols_array_2d();
        Weights { lower, soft: rows(theta), stiff: rows((one - theta) * theta * s.recip()) }
    }

    /// v ← approximately (T S + H)⁻¹ v.
    fn precondition(&self, inverse: &DenseSymmetric, weights: &[Weights], v: &mut [f64]) {
        let d = self.dim;
        let product = |m: &[Local; 3], v: &[f64], c: usize| v.iter().zip(&m[c]).map(|(v, m)| m * v).sum::<f64>();
        let mut weighted = vec![0.0; v.len()];
        for ((v, out), weight) in v.chunks_exact_mut(d).zip(weighted.chunks_exact_mut(d)).zip(weights) {
            for c in 1..d {
                v[c] += weight.lower[c] * v[0];
            }
            for (c, out) in out.iter_mut().enumerate() {
                *out = product(&weight.soft, v, c);
            }
        }
        let spread = single_product(inverse, &weighted);
        for ((v, spread), weight) in v.chunks_exact_mut(d).zip(spread.chunks_exact(d)).zip(weights) {
            let (mut from, mut own) = ([0.0; 3], [0.0; 3]);
            for c in 0..d {
                (from[c], own[c]) = (f64::from(spread[c]), v[c]);
            }
            for (c, v) in v.iter_mut().enumerate() {
                *v = product(&weight.soft, &from, c) + product(&weight.stiff, &own, c);
            }
        }
    }

    /// y = T S v + H v, zero where the jump is given.
    fn apply(&self, v: &[f64], y: &mut [f64]) {
        let d = self.dim;
        let mut with_carried;
        let v = if self.laws.iter().any(|law| law.carried != [0.0; 3]) {
            with_carried = v.to_vec();
            self.carry(&mut with_carried);
            &with_carried
        } else {
            v
        };
        let force = single_product(self.schur.single, v);
        for (i, law) in self.laws.iter().enumerate() {
            let at = i * d;
            for c in 0..d {
                y[at + c] = match law.given[c] {
                    Some(_) => 0.0,
                    None => (0..d).map(|j| law.t[c][j] * f64::from(force[at + j]) + law.h[c][j] * v[at + j]).sum(),
                };
            }
        }
    }
}

/// A v, not in double precision.
pub(crate) fn single_product(a: &DenseSymmetric, v: &[f64]) -> Vec<f32> {
    let x: Vec<f32> = v.iter().map(|&v| v as f32).collect();
    let mut y = vec![0.0; x.len()];
    a.mul(&x, &mut y);
    y
}

fn factorise(n: usize, entry: impl Fn(usize, usize) -> f32 + Sync) -> PartialPivLu<f32> {
    let mut a = vec![0.0; n * n];
    let columns = a.par_chunks_mut(n.max(1)).enumerate();
    columns.for_each(|(j, column)| column.iter_mut().enumerate().for_each(|(i, a)| *a = entry(i, j)));
    MatRef::from_column_major_slice(&a, n, n).partial_piv_lu()
}

/// x ← A⁻¹ x. One right-hand side is bound by reading the factor, and threads only slow that down.
fn solve_lu(lu: &PartialPivLu<f32>, x: &mut [f32]) {
    let n = x.len();
    let mut memory = MemBuffer::new(solve_in_place_scratch::<usize, f32>(n, 1, Par::Seq));
    let x = MatMut::from_column_major_slice_mut(x, n, 1);
    solve_in_place(lu.L(), lu.U(), lu.P(), x, Par::Seq, MemStack::new(&mut memory));
}
