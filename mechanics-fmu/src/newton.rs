//! Semi-smooth Newton's method for the contact problem, condensed to the fracture.
//!
//! With all unknowns but the jumps eliminated, the balance of forces on fracture face σ reads
//!
//! ```text
//! (S δ)_σ + |σ| (λ_σ + c_σ n) = r_σ
//! ```
//!
//! for the increments δ of the jumps during the time step; r is what the bulk exerts if all fractures stick, and c is the
//! part of the fracture pressure that follows the aperture. S is dense, symmetric positive definite and constant, and the
//! last block of the one factorisation is its factor.
//!
//! A Newton iteration decides the contact states from δ and λ, linearises the laws (see [`crate::contact`]), and solves for
//! the correction of δ by GMRES. The forces are computed in double precision, from the factor; the corrections with a copy
//! of S in single precision, which is reading and storing half as much. The preconditioner is a dense LU factorisation
//! at earlier states, bordered for the components that have become known or unknown since, and kept as long as few
//! iterations do. It belongs to the state: a step repeated from the same state repeats bit for bit.
//!
//! The laws of different faces meet only through S, so where Newton's method cycles, sweeps of a nonlinear block
//! Gauss–Seidel method (Jean, CMAME 1999), which solves the law of one face after the other exactly, move it on. If
//! it goes on cycling, it starts again with a larger β. Where a bound that opening ends leaves no equilibrium, it is made to
//! fade (see [`crate::contact`]).

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, OnceLock};

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::solve::{solve_in_place, solve_in_place_scratch};
use faer::linalg::solvers::PartialPivLu;
use faer::{Mat, MatMut, MatRef, Par};
use rayon::prelude::*;

use crate::contact::{ContactState, Face, FacePartner, Linearised, Local};
use crate::model::NewtonSettings;

/// A linear solve reduces the residual by this much: Newton's method needs no more, and where a preconditioner is exact
/// it does far better.
const FORCING: f64 = 1e-3;
/// Residuals below this part of the largest force on a face are round-off.
const NEGLIGIBLE: f64 = 1e-15;
/// Limit of GMRES.
const KRYLOV: usize = 40;
/// The preconditioner is renewed, not bordered, when more than one in this many components of the jump have become
/// known or unknown: bordering k of n takes 2 k n² operations, renewing ⅔ n³.
const BORDER: usize = 4;
/// A step leaves the next one a new factor if the border has become wider than one in this many components.
const STALE: usize = 20;
/// The preconditioner is renewed when a solve needed more iterations than this.
const RENEW_ABOVE: usize = 8;
/// What round-off leaves of a force, as part of the largest given force and of the forces that cancel in S δ. Where nothing
/// presses on the fracture, tractions are nothing else.
const ROUND_OFF: f64 = 1e-14;
/// Gauss–Seidel sweeps after a cycle.
const SWEEPS: usize = 5;
/// Cycles after which another β is tried.
const CYCLES: usize = 3;
/// After β as set, these multiples of it are tried.
const BETAS: [f64; 2] = [10.0, 100.0];
/// λ_0 as a part of Tresca's bound or cohesion, where these must fade: step by step, each solved from the one before.
const FADING: [f64; 3] = [1.0, 0.3, 0.1];

/// The contact problem on all fracture faces.
pub(crate) struct FractureProblem<'a> {
    pub(crate) dim: usize,
    pub(crate) schur: Schur<'a>,
    pub(crate) faces: &'a [Face],
    pub(crate) settings: NewtonSettings,
}

/// The Schur complement of the bulk on the jumps.
#[derive(Clone, Copy)]
pub(crate) struct Schur<'a> {
    /// In single precision.
    pub(crate) single: MatRef<'a, f32>,
    /// y += S x in double precision.
    pub(crate) add_product: &'a (dyn Fn(&[f64], &mut [f64]) + Sync),
}

/// The data of a time step.
pub(crate) struct FractureData<'a> {
    /// Condensed right-hand side (N): faces × d.
    pub(crate) rhs: &'a [f64],
    /// Largest force given on an unknown of the body (N), which tells how large round-off is.
    pub(crate) largest_force: f64,
    /// Jump at the previous time (m): faces × d.
    pub(crate) previous: &'a [f64],
    /// Slip is counted from here (m): faces × d.
    pub(crate) origin: &'a [f64],
    pub(crate) partners: &'a [FacePartner],
    /// A first guess of the increment (m), taken if it is better than none.
    pub(crate) guess: Option<Vec<f64>>,
}

/// Jumps, the forces that the bulk exerts on the faces, and what follows from both.
#[derive(Clone)]
struct Iterate {
    /// δ (m): faces × d.
    increment: Vec<f64>,
    /// S δ − r (N): faces × d.
    force: Vec<f64>,
    /// λ (Pa): faces × d.
    lambda: Vec<f64>,
    states: Vec<ContactState>,
    /// Largest violation of a contact law (Pa).
    violation: f64,
    /// The same beyond round-off.
    excess: f64,
}

/// A dense LU factorisation of the linearised problem at some earlier states.
pub(crate) struct FaceFactor {
    laws: Vec<Linearised>,
    unknowns: Vec<usize>,
    /// Made on first use, so that states which nothing follows cost nothing.
    lu: OnceLock<PartialPivLu<f32>>,
}

/// A [`FaceFactor`] used for other laws. Exact where these differ only in which components are given: a component that
/// has become known is held by a Lagrange multiplier, one that has become unknown is appended.
struct Preconditioner {
    factor: Arc<FaceFactor>,
    /// Components that have become unknown.
    added: Vec<usize>,
    /// Places in `factor.unknowns` of those that have become known.
    removed: Vec<usize>,
    /// Rows of the added components over the factor's unknowns.
    added_rows: Mat<f32>,
    /// Factor's inverse times the columns of the border.
    columns: Mat<f32>,
    corner: PartialPivLu<f32>,
}

impl FaceFactor {
    /// The laws that were factorised, from which [`FractureProblem::face_factor`] makes the same factor.
    pub(crate) fn laws(&self) -> &[Linearised] {
        &self.laws
    }
}

/// The factor that the next linear solve starts from, and the columns of borders that were needed with it: for each
/// component, the factor's inverse times its column.
#[derive(Default)]
struct Workshop {
    factor: Option<Arc<FaceFactor>>,
    columns: HashMap<usize, Vec<f32>>,
}

impl std::fmt::Debug for FaceFactor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FaceFactor").field("faces", &self.laws.len()).finish_non_exhaustive()
    }
}

/// What Newton's method did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NewtonReport {
    /// Newton iterations.
    pub iterations: usize,
    /// GMRES iterations, all together.
    pub linear_iterations: usize,
    /// Dense factorisations on the fracture, counting one that is left to the next step.
    pub face_factorisations: usize,
    /// Times that the contact states cycled and Gauss–Seidel sweeps were made.
    pub cycles: usize,
    /// Times that Tresca's bound or cohesion was made to fade (further); 0 where there is an equilibrium without.
    pub fadings: usize,
}

pub(crate) struct FractureSolution {
    pub(crate) jump: Vec<f64>,
    pub(crate) lambda: Vec<f64>,
    pub(crate) states: Vec<ContactState>,
    pub(crate) factor: Option<Arc<FaceFactor>>,
    pub(crate) report: NewtonReport,
    pub(crate) converged: bool,
    /// Largest violation of a contact law (Pa) and largest change of the jump (m) in the last iteration.
    pub(crate) violation: f64,
    pub(crate) change: f64,
}

/// The linearised problem cannot be solved at these contact states.
#[derive(Debug)]
pub(crate) struct SingularFracture(pub(crate) Vec<ContactState>);

impl FractureProblem<'_> {
    fn local(&self, v: &[f64], face: usize) -> Local {
        let mut out = [0.0; 3];
        out[..self.dim].copy_from_slice(&v[face * self.dim..][..self.dim]);
        out
    }

    fn jump(&self, data: &FractureData<'_>, increment: &[f64], face: usize) -> Local {
        let (mut jump, step) = (self.local(data.previous, face), self.local(increment, face));
        (0..3).for_each(|c| jump[c] += step[c]);
        jump
    }

    /// All that follows from increments and the forces that go with them.
    fn iterate(&self, data: &FractureData<'_>, increment: Vec<f64>, force: Vec<f64>) -> Iterate {
        let d = self.dim;
        let mut lambda: Vec<f64> = force.iter().map(|f| -f).collect();
        let mut states = Vec::with_capacity(self.faces.len());
        let (mut violation, mut excess): (f64, f64) = (0.0, 0.0);
        for (i, face) in self.faces.iter().enumerate() {
            let jump = self.jump(data, &increment, i);
            let previous = self.local(data.previous, i);
            for c in 0..d {
                lambda[i * d + c] /= face.measure;
            }
            lambda[i * d] += data.partners[i].stiffness * face.aperture(&jump, &self.local(data.origin, i));
            let own = self.local(&lambda, i);
            states.push(face.state(&jump, &own, &previous));
            let own = face.violation(&jump, &own, &previous);
            violation = larger(violation, own);
            excess = larger(excess, own - face.stiffness * self.round_off(data, i, &jump));
        }
        Iterate { increment, force, lambda, states, violation, excess }
    }

    /// Round-off of a face's jump (m).
    fn round_off(&self, data: &FractureData<'_>, i: usize, jump: &Local) -> f64 {
        let face = &self.faces[i];
        ROUND_OFF * (data.largest_force / (face.measure * face.stiffness) + max_abs(jump))
    }

    fn linearise(&self, data: &FractureData<'_>, at: &Iterate) -> Vec<Linearised> {
        (0..self.faces.len())
            .map(|i| {
                self.faces[i].linearise(
                    self.dim,
                    at.states[i],
                    &self.jump(data, &at.increment, i),
                    &self.local(&at.lambda, i),
                    &self.local(data.previous, i),
                    &data.partners[i],
                    &self.local(data.origin, i),
                )
            })
            .collect()
    }

    /// Solves the contact problem of a time step, starting from stick everywhere or from the guess.
    pub(crate) fn solve(
        &self,
        data: &FractureData<'_>,
        factor: Option<Arc<FaceFactor>>,
    ) -> Result<FractureSolution, SingularFracture> {
        let mut solution = self.attempts(data, data.guess.as_deref(), factor, NewtonReport::default())?;
        if solution.converged || !self.faces.iter().any(Face::drops) {
            return Ok(solution);
        }
        let mut guess = data.guess.clone();
        for part in FADING {
            let faces: Vec<Face> = self.faces.iter().map(|face| Face { fading: Some(part), ..face.clone() }).collect();
            let problem = FractureProblem { faces: &faces, ..*self };
            solution.report.fadings += 1;
            solution = problem.attempts(data, guess.as_deref(), solution.factor, solution.report)?;
            if !solution.converged {
                break;
            }
            guess = Some(solution.jump.iter().zip(data.previous).map(|(g, p)| g - p).collect());
        }
        Ok(solution)
    }

    /// Newton's method with one β after the other until it converges: a solution does not depend on β, but the path to it
    /// does, most where pressures that follow make the laws curved.
    fn attempts(
        &self,
        data: &FractureData<'_>,
        guess: Option<&[f64]>,
        factor: Option<Arc<FaceFactor>>,
        report: NewtonReport,
    ) -> Result<FractureSolution, SingularFracture> {
        let mut solution = self.attempt(data, guess, factor, report)?;
        for larger in BETAS {
            if solution.converged {
                break;
            }
            let faces: Vec<Face> = self.faces.iter().map(|face| face.with_larger_beta(larger)).collect();
            let problem = FractureProblem { faces: &faces, ..*self };
            solution = problem.attempt(data, guess, solution.factor, solution.report)?;
        }
        Ok(solution)
    }

    /// Newton's method from a guess of the increment (m); the report adds to an earlier one.
    fn attempt(
        &self,
        data: &FractureData<'_>,
        guess: Option<&[f64]>,
        factor: Option<Arc<FaceFactor>>,
        mut report: NewtonReport,
    ) -> Result<FractureSolution, SingularFracture> {
        let limit = report.iterations + self.settings.max_iterations;
        let most_cycles = report.cycles + CYCLES;
        let mut workshop = Workshop { factor, ..Workshop::default() };
        let mut force: Vec<f64> = data.rhs.iter().map(|r| -r).collect();
        (self.schur.add_product)(data.previous, &mut force);
        let mut at = self.iterate(data, vec![0.0; data.rhs.len()], force);
        if let Some(guess) = guess {
            let guessed = self.corrected(data, &at, guess);
            if guessed.violation < at.violation {
                at = guessed;
            }
        }
        let mut seen = HashSet::new();
        let mut change = 0.0;
        let mut converged = self.faces.is_empty();
        while !converged && report.iterations < limit && report.cycles < most_cycles {
            report.iterations += 1;
            let laws = self.linearise(data, &at);
            let correction = self.solve_linear(&laws, &at.force, &mut workshop, &mut report);
            let correction = correction.ok_or_else(|| SingularFracture(at.states.clone()))?;
            let next = self.corrected(data, &at, &correction);
            change = max_abs(&correction);
            let (mut size, mut noise) = (0.0, 0.0);
            for i in 0..self.faces.len() {
                let jump = self.jump(data, &next.increment, i);
                size = larger(size, max_abs(&jump));
                noise = larger(noise, self.round_off(data, i, &jump));
            }
            let traction = max_abs(&next.lambda);
            let tolerance = self.settings.tolerance;
            converged = change <= larger(noise, tolerance * size) && next.excess <= tolerance * traction;
            let repeats = next.states == at.states;
            at = next;
            if !converged && !repeats && !seen.insert(at.states.clone()) {
                report.cycles += 1;
                seen.clear();
                at = self.sweep(data, at);
            }
        }
        self.leave_factor(data, &at, &mut workshop, &mut report);
        let jump = data.previous.iter().zip(&at.increment).map(|(g, d)| g + d).collect();
        let Iterate { lambda, states, violation, .. } = at;
        Ok(FractureSolution { jump, lambda, states, factor: workshop.factor, report, converged, violation, change })
    }

    /// Leaves the next step a factor for the states it will start from, where the present one has a wide border.
    fn leave_factor(&self, data: &FractureData<'_>, at: &Iterate, workshop: &mut Workshop, report: &mut NewtonReport) {
        let laws = self.linearise(data, at);
        let stale = workshop.factor.as_ref().is_none_or(|factor| {
            let is_given = |laws: &[Linearised], k: usize| laws[k / self.dim].given[k % self.dim].is_some();
            let components = 0..laws.len() * self.dim;
            let border = components.filter(|&k| is_given(&laws, k) != is_given(&factor.laws, k)).count();
            border * STALE > factor.unknowns.len()
        });
        if stale {
            report.face_factorisations += 1;
            workshop.factor = Some(Arc::new(self.face_factor(laws)));
        }
    }

    fn corrected(&self, data: &FractureData<'_>, at: &Iterate, correction: &[f64]) -> Iterate {
        let increment = at.increment.iter().zip(correction).map(|(x, c)| x + c).collect();
        let mut force = at.force.clone();
        (self.schur.add_product)(correction, &mut force);
        self.iterate(data, increment, force)
    }

    /// The correction of the jumps that satisfies the linearised laws, where the bulk exerts `force` without it.
    fn solve_linear(
        &self,
        laws: &[Linearised],
        force: &[f64],
        workshop: &mut Workshop,
        report: &mut NewtonReport,
    ) -> Option<Vec<f64>> {
        let d = self.dim;
        let mut correction = vec![0.0; force.len()];
        for (i, law) in laws.iter().enumerate() {
            for c in 0..d {
                correction[i * d + c] = law.given[c].unwrap_or(0.0);
            }
        }
        if laws.iter().all(|law| law.given[..d].iter().all(Option::is_some)) {
            return Some(correction);
        }
        let mut force = force.to_vec();
        if correction.iter().any(|&c| c != 0.0) {
            (self.schur.add_product)(&correction, &mut force);
        }
        let mut b = vec![0.0; force.len()];
        for (i, law) in laws.iter().enumerate() {
            let (own, known) = (self.local(&force, i), self.local(&correction, i));
            for c in (0..d).filter(|&c| law.given[c].is_none()) {
                b[i * d + c] =
                    -law.constant[c] - (0..d).map(|j| law.t[c][j] * own[j] + law.h[c][j] * known[j]).sum::<f64>();
            }
        }
        let negligible = NEGLIGIBLE * max_abs(&force);
        let size = b.iter().map(|b| b * b).sum::<f64>().sqrt();
        let target = (FORCING * size).max(negligible);
        let operator = |v: &[f64], out: &mut [f64]| self.apply_rows(laws, v, out);
        let mut fresh = false;
        loop {
            let preconditioner = match self.preconditioner(workshop, laws) {
                Some(preconditioner) => preconditioner,
                None => {
                    report.face_factorisations += 1;
                    fresh = true;
                    let factor = Some(Arc::new(self.face_factor(laws.to_vec())));
                    *workshop = Workshop { factor, ..Workshop::default() };
                    self.preconditioner(workshop, laws)?
                }
            };
            let mut x = vec![0.0; b.len()];
            let done = linear::gmres(&operator, &|v: &mut [f64]| preconditioner.apply(v), &b, &mut x, target, KRYLOV);
            report.linear_iterations += done.iterations;
            // Single precision limits what a fresh factor reaches; Newton's method only needs a reduction.
            let solved = done.residual <= target || fresh && done.residual <= 0.5 * size;
            if !fresh && (!solved || done.iterations > RENEW_ABOVE) {
                *workshop = Workshop::default();
            }
            if solved {
                correction.iter_mut().zip(&x).for_each(|(c, x)| *c += x);
                return Some(correction);
            }
            if fresh {
                return None;
            }
        }
    }

    /// The change of the jump for a change of the right-hand side (N) at a solution, at its contact states.
    pub(crate) fn response(
        &self,
        data: &FractureData<'_>,
        jump: &[f64],
        lambda: &[f64],
        states: &[ContactState],
        factor: Option<Arc<FaceFactor>>,
        change: &[f64],
    ) -> Result<Vec<f64>, SingularFracture> {
        let at = Iterate {
            increment: jump.iter().zip(data.previous).map(|(g, p)| g - p).collect(),
            force: Vec::new(),
            lambda: lambda.to_vec(),
            states: states.to_vec(),
            violation: 0.0,
            excess: 0.0,
        };
        let mut laws = self.linearise(data, &at);
        for law in &mut laws {
            law.constant = [0.0; 3];
            law.given = law.given.map(|value| value.map(|_| 0.0));
        }
        let force: Vec<f64> = change.iter().map(|f| -f).collect();
        // Each solve gains at least a factor of `FORCING`; what an exact derivative needs is well below finite differences.
        const REFINEMENTS: usize = 4;
        let mut workshop = Workshop { factor, ..Workshop::default() };
        let mut total = vec![0.0; change.len()];
        for _ in 0..REFINEMENTS {
            let mut rest = force.clone();
            (self.schur.add_product)(&total, &mut rest);
            for (i, law) in laws.iter_mut().enumerate() {
                let own = self.local(&total, i);
                law.constant = std::array::from_fn(|c| (0..self.dim).map(|j| law.h[c][j] * own[j]).sum());
            }
            let correction = self.solve_linear(&laws, &rest, &mut workshop, &mut NewtonReport::default());
            let correction = correction.ok_or_else(|| SingularFracture(states.to_vec()))?;
            total.iter_mut().zip(&correction).for_each(|(t, c)| *t += c);
        }
        Ok(total)
    }

    /// The rows of the linearised laws, T S v + H v, zero where the jump is given; v is zero there.
    fn apply_rows(&self, laws: &[Linearised], v: &[f64], out: &mut [f64]) {
        let d = self.dim;
        let x = Mat::from_fn(v.len(), 1, |i, _| v[i] as f32);
        // By the rows of the symmetric matrix, so that the cores share the reading of it.
        const ROWS: usize = 256;
        let mut y = Mat::<f32>::zeros(v.len(), 1);
        let chunks = y.col_as_slice_mut(0).par_chunks_mut(ROWS).enumerate();
        chunks.for_each(|(k, y)| {
            let rows = self.schur.single.subcols(k * ROWS, y.len()).transpose();
            let y = MatMut::from_column_major_slice_mut(y, rows.nrows(), 1);
            faer::linalg::matmul::matmul(y, faer::Accum::Replace, rows, &x, 1.0, Par::Seq);
        });
        for (i, law) in laws.iter().enumerate() {
            let at = i * d;
            let own = self.local(v, i);
            for c in 0..d {
                out[at + c] = match law.given[c] {
                    Some(_) => 0.0,
                    None => (0..d).map(|j| law.t[c][j] * f64::from(y[(at + j, 0)]) + law.h[c][j] * own[j]).sum(),
                };
            }
        }
    }

    /// The same rows as a matrix over some components; the rows of T reach the normal component and their own.
    fn rows(&self, laws: &[Linearised], rows: &[usize], columns: &[usize]) -> Mat<f32> {
        let d = self.dim;
        let mut a = Mat::zeros(rows.len(), columns.len());
        for (q, &column) in columns.iter().enumerate() {
            let s = self.schur.single.col(column);
            for (p, &row) in rows.iter().enumerate() {
                let (i, c) = (row / d, row % d);
                let law = &laws[i];
                let mut v = law.t[c][c] * f64::from(s[row]);
                if c > 0 && law.t[c][0] != 0.0 {
                    v += law.t[c][0] * f64::from(s[i * d]);
                }
                if column / d == i {
                    v += law.h[c][column % d];
                }
                a[(p, q)] = v as f32;
            }
        }
        a
    }

    /// The dense factorisation for given laws, to be made on first use; the same laws give the same bits.
    pub(crate) fn face_factor(&self, laws: Vec<Linearised>) -> FaceFactor {
        FaceFactor { unknowns: unknowns(&laws, self.dim), laws, lu: OnceLock::new() }
    }

    /// The use of the present factor for given laws; `None` where there is none or renewing it is cheaper.
    fn preconditioner(&self, workshop: &mut Workshop, laws: &[Linearised]) -> Option<Preconditioner> {
        let d = self.dim;
        let factor = Arc::clone(workshop.factor.as_ref()?);
        let old = &factor.unknowns;
        let is_known = |laws: &[Linearised], at: usize| laws[at / d].given[at % d].is_some();
        let removed: Vec<usize> = (0..old.len()).filter(|&p| is_known(laws, old[p])).collect();
        let added: Vec<usize> = unknowns(laws, d).into_iter().filter(|&at| is_known(&factor.laws, at)).collect();
        let border = added.len() + removed.len();
        if border * BORDER > old.len() {
            return None;
        }
        let components: Vec<usize> = added.iter().copied().chain(removed.iter().map(|&p| old[p])).collect();
        let missing: Vec<usize> = (0..border).filter(|&k| !workshop.columns.contains_key(&components[k])).collect();
        let new: Vec<usize> = missing.iter().filter(|&&k| k < added.len()).map(|&k| components[k]).collect();
        let mut solved = Mat::zeros(old.len(), missing.len());
        solved.as_mut().subcols_mut(0, new.len()).copy_from(self.rows(&factor.laws, old, &new));
        for q in new.len()..missing.len() {
            solved[(removed[missing[q] - added.len()], q)] = 1.0;
        }
        let lu = factor.lu.get_or_init(|| self.rows(&factor.laws, old, old).partial_piv_lu());
        solve_lu(lu, solved.as_mut());
        for (q, &k) in missing.iter().enumerate() {
            workshop.columns.insert(components[k], solved.col(q).iter().copied().collect());
        }
        let columns = Mat::from_fn(old.len(), border, |p, k| workshop.columns[&components[k]][p]);
        let added_rows = self.rows(laws, &added, old);
        let mut corner = Mat::zeros(border, border);
        corner.as_mut().submatrix_mut(0, 0, added.len(), added.len()).copy_from(self.rows(laws, &added, &added));
        let reached = &added_rows * &columns;
        for q in 0..border {
            for p in 0..added.len() {
                corner[(p, q)] -= reached[(p, q)];
            }
            for (k, &p) in removed.iter().enumerate() {
                corner[(added.len() + k, q)] -= columns[(p, q)];
            }
        }
        Some(Preconditioner { factor, added, removed, added_rows, columns, corner: corner.partial_piv_lu() })
    }

    /// Nonlinear block Gauss–Seidel sweeps over the faces.
    fn sweep(&self, data: &FractureData<'_>, from: Iterate) -> Iterate {
        let d = self.dim;
        let Iterate { mut increment, mut force, .. } = from.clone();
        for _ in 0..SWEEPS {
            for i in 0..self.faces.len() {
                let correction = self.solve_face(data, i, &increment, &force);
                for c in 0..d {
                    if correction[c] != 0.0 {
                        increment[i * d + c] += correction[c];
                        let column = self.schur.single.col(i * d + c);
                        force.iter_mut().zip(column.iter()).for_each(|(f, s)| *f += correction[c] * f64::from(*s));
                    }
                }
            }
        }
        let correction: Vec<f64> = increment.iter().zip(&from.increment).map(|(new, old)| new - old).collect();
        self.corrected(data, &from, &correction)
    }

    /// The correction of one face's jump that satisfies its law, all others being given.
    fn solve_face(&self, data: &FractureData<'_>, i: usize, increment: &[f64], force: &[f64]) -> Local {
        // A handful of states and a smooth curve of slip directions: more than enough.
        const LOCAL_ITERATIONS: usize = 30;
        let own = i * self.dim..(i + 1) * self.dim;
        let single = self.schur.single.submatrix(own.start, own.start, self.dim, self.dim);
        let add_product = |x: &[f64], y: &mut [f64]| {
            for (j, x) in x.iter().enumerate() {
                y.iter_mut().enumerate().for_each(|(i, y)| *y += f64::from(single[(i, j)]) * x);
            }
        };
        let one = FractureProblem {
            dim: self.dim,
            schur: Schur { single, add_product: &add_product },
            faces: &self.faces[i..=i],
            settings: self.settings,
        };
        let data = FractureData {
            rhs: &data.rhs[own.clone()],
            largest_force: data.largest_force,
            previous: &data.previous[own.clone()],
            origin: &data.origin[own.clone()],
            partners: &data.partners[i..=i],
            guess: None,
        };
        let mut at = one.iterate(&data, increment[own.clone()].to_vec(), force[own.clone()].to_vec());
        for _ in 0..LOCAL_ITERATIONS {
            if at.excess <= self.settings.tolerance * max_abs(&at.lambda) {
                break;
            }
            let laws = one.linearise(&data, &at);
            match one.solve_linear(&laws, &at.force, &mut Workshop::default(), &mut NewtonReport::default()) {
                Some(correction) => at = one.corrected(&data, &at, &correction),
                None => break,
            }
        }
        let (old, new) = (self.local(increment, i), one.local(&at.increment, 0));
        std::array::from_fn(|c| new[c] - old[c])
    }
}

impl Preconditioner {
    /// v ← M⁻¹ v, over all components; zero where the jump is given.
    fn apply(&self, v: &mut [f64]) {
        let old = &self.factor.unknowns;
        let mut x = Mat::from_fn(old.len(), 1, |p, _| v[old[p]] as f32);
        // The row of a component that has become known is free to take the multiplier that holds it.
        self.removed.iter().for_each(|&p| x[(p, 0)] = 0.0);
        // Made when the border was.
        if let Some(lu) = self.factor.lu.get() {
            solve_lu(lu, x.as_mut());
        }
        let n = self.added.len();
        if n + self.removed.len() > 0 {
            let reached = &self.added_rows * &x;
            let mut z = Mat::from_fn(n + self.removed.len(), 1, |k, _| {
                if k < n { v[self.added[k]] as f32 - reached[(k, 0)] } else { -x[(self.removed[k - n], 0)] }
            });
            solve_lu(&self.corner, z.as_mut());
            x -= &self.columns * &z;
            for (k, &at) in self.added.iter().enumerate() {
                v[at] = f64::from(z[(k, 0)]);
            }
        }
        for (p, &at) in old.iter().enumerate() {
            v[at] = f64::from(x[(p, 0)]);
        }
        self.removed.iter().for_each(|&p| v[old[p]] = 0.0);
    }
}

/// x ← A⁻¹ x. One right-hand side is bound by reading the factor, and threads only slow that down.
fn solve_lu(lu: &PartialPivLu<f32>, x: MatMut<'_, f32>) {
    let par = if x.ncols() > 1 { faer::get_global_parallelism() } else { Par::Seq };
    let mut memory = MemBuffer::new(solve_in_place_scratch::<usize, f32>(x.nrows(), x.ncols(), par));
    solve_in_place(lu.L(), lu.U(), lu.P(), x, par, MemStack::new(&mut memory));
}

/// The components of the jump that laws leave unknown.
fn unknowns(laws: &[Linearised], d: usize) -> Vec<usize> {
    (0..laws.len() * d).filter(|&at| laws[at / d].given[at % d].is_none()).collect()
}

/// The larger of two numbers, or NaN.
fn larger(a: f64, b: f64) -> f64 {
    if b <= a { a } else { b }
}

fn max_abs(v: &[f64]) -> f64 {
    v.iter().fold(0.0, |m, x| larger(m, x.abs()))
}
