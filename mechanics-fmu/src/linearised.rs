//! The linearised contact problem on the fracture.
//!
//! With the laws of [`crate::contact`] linearised, the correction v of the jumps is zero in the components that are given,
//! and for the others
//!
//! ```text
//! T S v + H v = b
//! ```
//!
//! T and H acting face by face. It is solved by GMRES, preconditioned by an inverse in single precision that is exact but
//! for round-off, so that one or two iterations do. There are two ways to it:
//!
//! - *primal*: T S + H on the unknown components, factorised;
//! - *dual*: what contact adds to an open fracture is few forces λ, each acting along w on a face, and given by a component
//!   u of its jump: S v + W λ = T⁻¹ b and Uᵀ v = D λ, with D = 0 where u·v is given. With S⁻¹ known, which is made once,
//!   only Uᵀ S⁻¹ W + D need be factorised (Woodbury).
//!
//! The smaller of the two is taken: few components are factorised where most faces are open or most stick, two of three
//! where all slip.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::solve::{solve_in_place, solve_in_place_scratch};
use faer::linalg::solvers::PartialPivLu;
use faer::{MatMut, MatRef, Par};
use linear::{DenseSymmetric, Krylov};
use rayon::prelude::*;

use crate::contact::{Linearised, Local};
use crate::newton::NewtonReport;

/// Limit of GMRES.
const KRYLOV: usize = 40;
/// An inverse is used for other laws that leave the same components unknown as long as GMRES needs no more iterations.
const REUSE: usize = 2;
/// A stiffness of a law below this part of that of the bulk is left to GMRES by the dual inverse.
const SOFT: f64 = 1e-3;

/// The Schur complement of the bulk on the jumps.
#[derive(Clone, Copy)]
pub(crate) struct Schur<'a> {
    pub(crate) single: &'a DenseSymmetric,
    /// S⁻¹, where there is one; made when asked for.
    pub(crate) inverse: &'a (dyn Fn() -> Option<&'a DenseSymmetric> + Sync),
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

/// An approximate inverse.
pub(crate) struct Inverse<'a> {
    dim: usize,
    given: Vec<[bool; 3]>,
    way: Way<'a>,
    /// GMRES iterations of the last solve with it.
    iterations: usize,
}

enum Way<'a> {
    Primal { unknowns: Vec<usize>, lu: PartialPivLu<f32> },
    Dual { inverse: &'a DenseSymmetric, lower: Vec<Local>, links: Vec<Link>, lu: PartialPivLu<f32> },
}

impl Way<'_> {
    /// Unknowns that are factorised.
    fn len(&self) -> usize {
        match self {
            Self::Primal { unknowns, .. } => unknowns.len(),
            Self::Dual { links, .. } => links.len(),
        }
    }
}

/// A force λ that a face exerts along w, with u·v = λ · compliance.
struct Link {
    face: usize,
    w: Local,
    u: Local,
    compliance: f64,
}

impl<'a> LinearisedProblem<'a, '_> {
    /// The solution to a relative residual, by an inverse that is kept for the next time; `None` where the problem is
    /// singular. Counts its work.
    pub(crate) fn solve(
        &self,
        b: &[f64],
        target: f64,
        kept: &mut Option<Inverse<'a>>,
        report: &mut NewtonReport,
    ) -> Option<Vec<f64>> {
        let given = self.given();
        let size = b.iter().map(|b| b * b).sum::<f64>().sqrt();
        let attempt = |inverse: &mut Inverse<'a>| {
            let mut x = vec![0.0; b.len()];
            let apply = |v: &[f64], y: &mut [f64]| self.apply(v, y);
            let done = linear::gmres(&apply, &|v: &mut [f64]| inverse.apply(v), b, &mut x, target, KRYLOV);
            inverse.iterations = done.iterations;
            (x, done)
        };
        if let Some(inverse) = kept.as_mut().filter(|inverse| inverse.given == given && inverse.iterations <= REUSE) {
            let (x, Krylov { iterations, residual }) = attempt(inverse);
            report.linear_iterations += iterations;
            if residual <= target {
                return Some(x);
            }
        }
        for allow_dual in [true, false] {
            let Some(way) = self.way(allow_dual) else { continue };
            report.face_factorisations += 1;
            report.largest_factorisation = report.largest_factorisation.max(way.len());
            let inverse = kept.insert(Inverse { dim: self.dim, given: given.clone(), way, iterations: 0 });
            let (x, Krylov { iterations, residual }) = attempt(inverse);
            report.linear_iterations += iterations;
            // Single precision limits what is reached; Newton's method only needs a reduction.
            if residual <= target.max(0.1 * size) {
                return Some(x);
            }
        }
        None
    }

    /// The dual way, if wanted and the smaller one, or the primal way, if wanted or the smaller one.
    fn way(&self, dual: bool) -> Option<Way<'a>> {
        let unknowns = unknowns(self.laws, self.dim);
        let links = self.links();
        let inverse = if links.len() < unknowns.len() { (self.schur.inverse)() } else { None };
        match (dual, inverse) {
            (true, Some(inverse)) => {
                let n = links.len();
                let lu = factorise(n, |i, j| {
                    let (a, b) = (&links[i], &links[j]);
                    let mut sum = if i == j { a.compliance as f32 } else { 0.0 };
                    for p in (0..self.dim).filter(|&p| a.u[p] != 0.0) {
                        for q in (0..self.dim).filter(|&q| b.w[q] != 0.0) {
                            let entry = inverse.get(a.face * self.dim + p, b.face * self.dim + q);
                            sum += a.u[p] as f32 * entry * b.w[q] as f32;
                        }
                    }
                    sum
                });
                let lower = self.laws.iter().map(|law| self.lower(law)).collect();
                Some(Way::Dual { inverse, lower, links, lu })
            }
            (true, None) | (false, Some(_)) => {
                let lu = factorise(unknowns.len(), |p, q| self.entry(unknowns[p], unknowns[q]));
                Some(Way::Primal { unknowns, lu })
            }
            (false, None) => None,
        }
    }

    fn given(&self) -> Vec<[bool; 3]> {
        self.laws.iter().map(|law| law.given.map(|value| value.is_some())).collect()
    }

    /// An entry of T S + H; the rows of T reach the normal component and their own.
    fn entry(&self, row: usize, column: usize) -> f32 {
        let (i, c) = (row / self.dim, row % self.dim);
        let law = &self.laws[i];
        let mut v = law.t[c][c] * f64::from(self.schur.single.get(row, column));
        if c > 0 && law.t[c][0] != 0.0 {
            v += law.t[c][0] * f64::from(self.schur.single.get(row - c, column));
        }
        if column / self.dim == i {
            v += law.h[c][column % self.dim];
        }
        v as f32
    }

    /// The column of T_ii⁻¹ T_i0 below the diagonal, which T consists of but for a unit diagonal.
    fn lower(&self, law: &Linearised) -> Local {
        std::array::from_fn(|c| if c > 0 && law.given[c].is_none() { law.t[c][0] } else { 0.0 })
    }

    fn links(&self) -> Vec<Link> {
        let d = self.dim;
        let mut links = Vec::new();
        for (face, law) in self.laws.iter().enumerate() {
            let lower = self.lower(law);
            for c in (0..d).filter(|&c| law.given[c].is_some()) {
                let mut u = [0.0; 3];
                u[c] = 1.0;
                let mut w = u;
                if c == 0 {
                    (1..d).for_each(|i| w[i] = -lower[i]);
                }
                links.push(Link { face, w, u, compliance: 0.0 });
            }
            // T⁻¹ H on the unknown components as a sum of w uᵀ / compliance, by its largest entries.
            let known = |c: usize| law.given[c].is_some();
            let mut a = [[0.0; 3]; 3];
            for i in (0..d).filter(|&i| !known(i)) {
                for j in (0..d).filter(|&j| !known(j)) {
                    let normal = if known(0) { 0.0 } else { lower[i] * law.h[0][j] };
                    a[i][j] = law.h[i][j] - normal;
                }
            }
            let bulk = (0..d).map(|c| f64::from(self.schur.single.get(face * d + c, face * d + c))).sum::<f64>();
            let mut largest = SOFT * bulk / d as f64;
            loop {
                let places = (0..d * d).map(|k| (k / d, k % d));
                let (p, q) = places
                    .fold((0, 0), |best, at| if a[at.0][at.1].abs() > a[best.0][best.1].abs() { at } else { best });
                let pivot = a[p][q];
                // What the first pivots leave is round-off of them.
                largest = f64::max(largest, 1e-9 * pivot.abs());
                if pivot.abs() <= largest || !pivot.is_finite() {
                    break;
                }
                let w: Local = std::array::from_fn(|i| a[i][q] / pivot);
                let u: Local = std::array::from_fn(|j| a[p][j] / pivot);
                for i in 0..d {
                    for j in 0..d {
                        a[i][j] -= pivot * w[i] * u[j];
                    }
                }
                links.push(Link { face, w, u, compliance: 1.0 / pivot });
            }
        }
        links
    }

    /// y = T S v + H v, zero where the jump is given.
    fn apply(&self, v: &[f64], y: &mut [f64]) {
        let d = self.dim;
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

impl Inverse<'_> {
    /// v ← approximately (T S + H)⁻¹ v.
    fn apply(&self, v: &mut [f64]) {
        let d = self.dim;
        match &self.way {
            Way::Primal { unknowns, lu } => {
                let mut x: Vec<f32> = unknowns.iter().map(|&at| v[at] as f32).collect();
                solve_lu(lu, &mut x);
                unknowns.iter().zip(x).for_each(|(&at, x)| v[at] = f64::from(x));
            }
            Way::Dual { inverse, lower, links, lu } => {
                for ((v, lower), given) in v.chunks_exact_mut(d).zip(lower).zip(&self.given) {
                    if !given[0] {
                        (1..d).for_each(|c| v[c] -= lower[c] * v[0]);
                    }
                }
                let y = single_product(inverse, v);
                let along = |link: &Link| (0..d).map(|c| link.u[c] as f32 * y[link.face * d + c]).sum();
                let mut force: Vec<f32> = links.iter().map(along).collect();
                solve_lu(lu, &mut force);
                for (link, force) in links.iter().zip(&force) {
                    (0..d).for_each(|c| v[link.face * d + c] -= link.w[c] * f64::from(*force));
                }
                let x = single_product(inverse, v);
                for (at, v) in v.iter_mut().enumerate() {
                    *v = if self.given[at / d][at % d] { 0.0 } else { f64::from(x[at]) };
                }
            }
        }
    }
}

/// A v in single precision.
fn single_product(a: &DenseSymmetric, v: &[f64]) -> Vec<f32> {
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

/// The components of the jump that laws leave unknown.
fn unknowns(laws: &[Linearised], d: usize) -> Vec<usize> {
    (0..laws.len() * d).filter(|&at| laws[at / d].given[at % d].is_none()).collect()
}
