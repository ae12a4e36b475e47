//! Semi-smooth Newton's method for the contact problem, condensed to the fracture.
//!
//! With all unknowns but the jumps g eliminated, the balance of forces on fracture face σ reads
//!
//! ```text
//! (S g)_σ + |σ| (λ_σ + c_σ(g) n) = r_σ
//! ```
//!
//! S is dense, symmetric positive definite and constant; its cost is that of the last block of the one factorisation.
//! A Newton iteration decides the contact states from g and λ, linearises the laws (see [`crate::contact`]), and solves
//! for the components of g that the states leave unknown, by GMRES with a dense LU factorisation as preconditioner that is
//! kept as long as few iterations do. It belongs to the state: a step repeated from the same state repeats bit for bit.
//!
//! The laws of different faces meet only through S, so where Newton's method cycles, sweeps of a nonlinear block
//! Gauss–Seidel method (Jean, CMAME 1999), which solves the law of one face after the other exactly, move it on.

use std::collections::HashSet;
use std::sync::Arc;

use faer::linalg::solvers::{PartialPivLu, Solve};
use faer::{Mat, Par};

use crate::contact::{ContactState, Face, FacePartner, Linearised, Local};
use crate::model::NewtonSettings;

/// Accuracy of the linear solves, a part of the largest force on a face: well below Newton's tolerance, above round-off.
const LINEAR_TOLERANCE: f64 = 1e-13;
/// A residual up to this many times the estimate of round-off is as good as none.
const ROUND_OFF_SLACK: f64 = 10.0;
/// Limit of GMRES.
const KRYLOV: usize = 60;
/// The preconditioner is renewed, not bordered, when more than one in this many components of the jump have become
/// known or unknown: bordering k of n takes 2 k n² operations, renewing ⅔ n³.
const BORDER: usize = 4;
/// The preconditioner is renewed when a solve needed more iterations than this: about what renewing it costs.
const RENEW_ABOVE: usize = 12;
/// Gauss–Seidel sweeps after a cycle.
const SWEEPS: usize = 5;

/// The contact problem on all fracture faces.
pub(crate) struct FractureProblem<'a> {
    pub(crate) dim: usize,
    pub(crate) schur: &'a Mat<f64>,
    pub(crate) faces: &'a [Face],
    pub(crate) settings: NewtonSettings,
}

/// Where Newton's method starts, and the data of the time step.
pub(crate) struct FractureData<'a> {
    /// Condensed right-hand side (N): faces × d.
    pub(crate) rhs: &'a [f64],
    /// Jump at the previous time (m): faces × d.
    pub(crate) previous: &'a [f64],
    /// Slip is counted from here (m): faces × d.
    pub(crate) origin: &'a [f64],
    pub(crate) partners: &'a [FacePartner],
}

/// A dense LU factorisation of the linearised problem at some earlier states.
pub(crate) struct FaceFactor {
    laws: Vec<Linearised>,
    unknowns: Vec<usize>,
    lu: PartialPivLu<f64>,
}

/// A [`FaceFactor`] used for other laws. Exact where these differ only in which components are given: a component that
/// has become known is held by a Lagrange multiplier, one that has become unknown is appended.
struct Preconditioner<'a> {
    factor: &'a FaceFactor,
    /// Components that have become unknown.
    added: Vec<usize>,
    /// Places in `factor.unknowns` of those that have become known.
    removed: Vec<usize>,
    /// Rows of the added components over the factor's unknowns.
    added_rows: Mat<f64>,
    /// Factor's inverse times the columns of the border.
    columns: Mat<f64>,
    corner: PartialPivLu<f64>,
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
    /// Dense factorisations on the fracture.
    pub face_factorisations: usize,
    /// Times that the contact states cycled and Gauss–Seidel sweeps were made.
    pub cycles: usize,
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

/// The linearised problem cannot be solved.
pub(crate) struct SingularFracture;

impl FractureProblem<'_> {
    fn local(&self, v: &[f64], face: usize) -> Local {
        let mut out = [0.0; 3];
        out[..self.dim].copy_from_slice(&v[face * self.dim..][..self.dim]);
        out
    }

    /// y = S x.
    fn apply_schur(&self, x: &[f64], y: &mut [f64]) {
        let m = x.len();
        // Below this the threads cost more than they bring.
        let par = if m > 400 { faer::get_global_parallelism() } else { Par::Seq };
        faer::linalg::matmul::matmul(
            faer::MatMut::from_column_major_slice_mut(y, m, 1),
            faer::Accum::Replace,
            self.schur,
            faer::MatRef::from_column_major_slice(x, m, 1),
            1.0,
            par,
        );
    }

    /// λ from the balance of forces at a jump.
    fn multiplier(&self, data: &FractureData<'_>, jump: &[f64]) -> Vec<f64> {
        let mut force = vec![0.0; jump.len()];
        self.apply_schur(jump, &mut force);
        for (f, r) in force.iter_mut().zip(data.rhs) {
            *f = r - *f;
        }
        for (i, face) in self.faces.iter().enumerate() {
            for c in 0..self.dim {
                force[i * self.dim + c] /= face.measure;
            }
            force[i * self.dim] += self.following_pressure(data, jump, i);
        }
        force
    }

    /// −c_σ(g) = S_f d_f.
    fn following_pressure(&self, data: &FractureData<'_>, jump: &[f64], i: usize) -> f64 {
        let aperture = self.faces[i].aperture(&self.local(jump, i), &self.local(data.origin, i));
        data.partners[i].stiffness * aperture
    }

    pub(crate) fn linearise(
        &self,
        data: &FractureData<'_>,
        states: &[ContactState],
        jump: &[f64],
        lambda: &[f64],
    ) -> Vec<Linearised> {
        (0..self.faces.len())
            .map(|i| {
                self.faces[i].linearise(
                    self.dim,
                    states[i],
                    &self.local(jump, i),
                    &self.local(lambda, i),
                    &self.local(data.previous, i),
                    &data.partners[i],
                    &self.local(data.origin, i),
                )
            })
            .collect()
    }

    fn states(&self, data: &FractureData<'_>, jump: &[f64], lambda: &[f64]) -> Vec<ContactState> {
        (0..self.faces.len())
            .map(|i| self.faces[i].state(&self.local(jump, i), &self.local(lambda, i), &self.local(data.previous, i)))
            .collect()
    }

    fn violation(&self, data: &FractureData<'_>, jump: &[f64], lambda: &[f64]) -> f64 {
        (0..self.faces.len())
            .map(|i| {
                self.faces[i].violation(&self.local(jump, i), &self.local(lambda, i), &self.local(data.previous, i))
            })
            .fold(0.0, f64::max)
    }

    /// Solves the contact problem of a time step, starting from the jump at the previous time: the first multiplier is
    /// that of sticking everywhere.
    pub(crate) fn solve(
        &self,
        data: &FractureData<'_>,
        mut factor: Option<Arc<FaceFactor>>,
    ) -> Result<FractureSolution, SingularFracture> {
        let mut report = NewtonReport::default();
        let mut jump = data.previous.to_vec();
        let mut lambda = self.multiplier(data, &jump);
        let mut states = self.states(data, &jump, &lambda);
        let mut seen = HashSet::new();
        let (mut violation, mut change) = (0.0, 0.0);
        let mut converged = self.faces.is_empty();
        while !converged && report.iterations < self.settings.max_iterations {
            report.iterations += 1;
            let laws = self.linearise(data, &states, &jump, &lambda);
            let mut next = jump.clone();
            self.solve_linear(&laws, data.rhs, true, &mut factor, &mut next, &mut report)?;
            change = max_abs(jump.iter().zip(&next).map(|(a, b)| a - b));
            jump = next;
            lambda = self.multiplier(data, &jump);
            let new_states = self.states(data, &jump, &lambda);
            violation = self.violation(data, &jump, &lambda);
            let repeats = new_states == states;
            let traction = max_abs(lambda.iter().copied());
            let size = max_abs(jump.iter().copied());
            let tolerance = self.settings.tolerance;
            // A jump that stays is measured by what the tractions could still move: their violation.
            converged = repeats && change <= tolerance * size && violation <= tolerance * traction
                || violation <= f64::EPSILON * traction;
            if !converged && !repeats && !seen.insert(new_states.clone()) {
                report.cycles += 1;
                seen.clear();
                self.sweep(data, &mut jump);
                lambda = self.multiplier(data, &jump);
                states = self.states(data, &jump, &lambda);
            } else {
                states = new_states;
            }
        }
        Ok(FractureSolution { jump, lambda, states, factor, report, converged, violation, change })
    }

    /// Solves the linearised problem for the jump `x`, which holds a first guess. Without `affine` the homogeneous laws are
    /// meant: given jumps and constants are zero.
    fn solve_linear(
        &self,
        laws: &[Linearised],
        rhs: &[f64],
        affine: bool,
        factor: &mut Option<Arc<FaceFactor>>,
        x: &mut [f64],
        report: &mut NewtonReport,
    ) -> Result<(), SingularFracture> {
        let d = self.dim;
        let mut given = vec![0.0; x.len()];
        for (i, law) in laws.iter().enumerate() {
            for c in 0..d {
                if let Some(value) = law.given[c] {
                    given[i * d + c] = if affine { value } else { 0.0 };
                    x[i * d + c] = 0.0;
                }
            }
        }
        if laws.iter().all(|law| law.given[..d].iter().all(Option::is_some)) {
            x.copy_from_slice(&given);
            return Ok(());
        }
        // Right-hand side of the rows: T (r − S g_given) − H g_given − h0.
        let mut b = vec![0.0; x.len()];
        let mut force = vec![0.0; x.len()];
        self.apply_schur(&given, &mut force);
        for (i, law) in laws.iter().enumerate() {
            for c in (0..d).filter(|&c| law.given[c].is_none()) {
                let at = |j: usize| i * d + j;
                let rows = (0..d).map(|j| law.t[c][j] * (rhs[at(j)] - force[at(j)]) - law.h[c][j] * given[at(j)]);
                b[at(c)] = rows.sum::<f64>() - if affine { law.h0[c] } else { 0.0 };
            }
        }
        // The forces that balance to give b set the scale: b itself may vanish.
        let scale = max_abs(rhs.iter().chain(&force).copied());
        let target = LINEAR_TOLERANCE * scale;
        let operator = |v: &[f64], out: &mut [f64]| self.apply_rows(laws, v, out);
        let mut fresh = false;
        loop {
            let preconditioner = match factor.as_deref().and_then(|f| self.preconditioner(f, laws)) {
                Some(preconditioner) => preconditioner,
                None => {
                    report.face_factorisations += 1;
                    fresh = true;
                    let new = factor.insert(Arc::new(self.face_factor(laws.to_vec())));
                    self.preconditioner(new, laws).ok_or(SingularFracture)?
                }
            };
            let apply = |v: &mut [f64]| preconditioner.apply(v);
            let done = linear::gmres(&operator, &apply, &b, x, target, KRYLOV);
            report.linear_iterations += done.iterations;
            let round_off = self.round_off(x).max(target);
            let solved = done.residual <= ROUND_OFF_SLACK * round_off;
            if !fresh && (!solved || done.iterations > RENEW_ABOVE) {
                *factor = None;
            }
            if solved {
                break;
            }
            if fresh {
                return Err(SingularFracture);
            }
        }
        x.iter_mut().zip(&given).for_each(|(x, g)| *x += g);
        Ok(())
    }

    /// What round-off leaves of S x (N).
    fn round_off(&self, x: &[f64]) -> f64 {
        let stiffest = max_abs((0..x.len()).map(|i| self.schur[(i, i)]));
        f64::EPSILON * (x.len() as f64).sqrt() * stiffest * max_abs(x.iter().copied())
    }

    /// The change of the jump for a change of the right-hand side (N), at fixed contact states.
    pub(crate) fn response(
        &self,
        laws: &[Linearised],
        factor: &mut Option<Arc<FaceFactor>>,
        change: &[f64],
    ) -> Result<Vec<f64>, SingularFracture> {
        let mut x = vec![0.0; change.len()];
        self.solve_linear(laws, change, false, factor, &mut x, &mut NewtonReport::default())?;
        Ok(x)
    }

    /// The rows of the linearised laws, T S v + H v, zero where the jump is given; v is zero there.
    fn apply_rows(&self, laws: &[Linearised], v: &[f64], out: &mut [f64]) {
        let d = self.dim;
        self.apply_schur(v, out);
        for (i, law) in laws.iter().enumerate() {
            let at = i * d;
            let (sv, gv) = (self.local(out, i), self.local(v, i));
            for c in 0..d {
                out[at + c] = match law.given[c] {
                    Some(_) => 0.0,
                    None => (0..d).map(|j| law.t[c][j] * sv[j] + law.h[c][j] * gv[j]).sum(),
                };
            }
        }
    }

    /// The same rows as a matrix over some components; the rows of T reach the normal component and their own.
    fn rows(&self, laws: &[Linearised], rows: &[usize], columns: &[usize]) -> Mat<f64> {
        let d = self.dim;
        let mut a = Mat::zeros(rows.len(), columns.len());
        for (q, &column) in columns.iter().enumerate() {
            let s = self.schur.col(column);
            for (p, &row) in rows.iter().enumerate() {
                let (i, c) = (row / d, row % d);
                let law = &laws[i];
                let mut v = law.t[c][c] * s[row];
                if c > 0 && law.t[c][0] != 0.0 {
                    v += law.t[c][0] * s[i * d];
                }
                if column / d == i {
                    v += law.h[c][column % d];
                }
                a[(p, q)] = v;
            }
        }
        a
    }

    /// The dense factorisation for given laws; the same laws give the same bits.
    fn face_factor(&self, laws: Vec<Linearised>) -> FaceFactor {
        let unknowns = unknowns(&laws, self.dim);
        let lu = self.rows(&laws, &unknowns, &unknowns).partial_piv_lu();
        FaceFactor { laws, unknowns, lu }
    }

    /// The use of a factor for given laws; `None` where renewing it is cheaper.
    fn preconditioner<'a>(&self, factor: &'a FaceFactor, laws: &[Linearised]) -> Option<Preconditioner<'a>> {
        let d = self.dim;
        let old = &factor.unknowns;
        let is_known = |laws: &[Linearised], at: usize| laws[at / d].given[at % d].is_some();
        let removed: Vec<usize> = (0..old.len()).filter(|&p| is_known(laws, old[p])).collect();
        let added: Vec<usize> = unknowns(laws, d).into_iter().filter(|&at| is_known(&factor.laws, at)).collect();
        let border = added.len() + removed.len();
        if border * BORDER > old.len() {
            return None;
        }
        let mut columns = Mat::zeros(old.len(), border);
        columns.as_mut().subcols_mut(0, added.len()).copy_from(self.rows(&factor.laws, old, &added));
        for (k, &p) in removed.iter().enumerate() {
            columns[(p, added.len() + k)] = 1.0;
        }
        factor.lu.solve_in_place(columns.as_mut());
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
    fn sweep(&self, data: &FractureData<'_>, jump: &mut [f64]) {
        let d = self.dim;
        let mut force = vec![0.0; jump.len()];
        self.apply_schur(jump, &mut force);
        for _ in 0..SWEEPS {
            for i in 0..self.faces.len() {
                let at = i * d;
                let old = self.local(jump, i);
                let new = self.solve_face(data, i, &old, &force);
                for c in 0..d {
                    let change = new[c] - old[c];
                    if change != 0.0 {
                        jump[at + c] = new[c];
                        for (f, s) in force.iter_mut().zip(self.schur.col(at + c).iter()) {
                            *f += change * s;
                        }
                    }
                }
            }
        }
    }

    /// The jump of one face that satisfies its law, all others being given; `force` is S g.
    fn solve_face(&self, data: &FractureData<'_>, i: usize, old: &Local, force: &[f64]) -> Local {
        // A handful of states and a smooth curve of slip directions: more than enough.
        const LOCAL_ITERATIONS: usize = 30;
        let d = self.dim;
        let at = i * d;
        let one = FractureProblem {
            dim: d,
            schur: &Mat::from_fn(d, d, |a, b| self.schur[(at + a, at + b)]),
            faces: &self.faces[i..=i],
            settings: self.settings,
        };
        let mut rhs = [0.0; 3];
        for a in 0..d {
            let own: f64 = (0..d).map(|b| self.schur[(at + a, at + b)] * old[b]).sum();
            rhs[a] = data.rhs[at + a] - force[at + a] + own;
        }
        let data = FractureData {
            rhs: &rhs[..d],
            previous: &data.previous[at..at + d],
            origin: &data.origin[at..at + d],
            partners: &data.partners[i..=i],
        };
        let mut jump = data.previous.to_vec();
        for _ in 0..LOCAL_ITERATIONS {
            let lambda = one.multiplier(&data, &jump);
            let states = one.states(&data, &jump, &lambda);
            if one.violation(&data, &jump, &lambda) <= 1e-13 * max_abs(lambda.iter().copied()) {
                break;
            }
            let laws = one.linearise(&data, &states, &jump, &lambda);
            let mut next = jump.clone();
            let mut factor = None;
            if one.solve_linear(&laws, data.rhs, true, &mut factor, &mut next, &mut NewtonReport::default()).is_err() {
                break;
            }
            jump = next;
        }
        self.local(&jump, 0)
    }
}

impl Preconditioner<'_> {
    /// v ← M⁻¹ v, over all components; zero where the jump is given.
    fn apply(&self, v: &mut [f64]) {
        let old = &self.factor.unknowns;
        let mut x = Mat::from_fn(old.len(), 1, |p, _| v[old[p]]);
        // The row of a component that has become known is free to take the multiplier that holds it.
        self.removed.iter().for_each(|&p| x[(p, 0)] = 0.0);
        self.factor.lu.solve_in_place(x.as_mut());
        let n = self.added.len();
        if n + self.removed.len() > 0 {
            let reached = &self.added_rows * &x;
            let mut z = Mat::from_fn(n + self.removed.len(), 1, |k, _| {
                if k < n { v[self.added[k]] - reached[(k, 0)] } else { -x[(self.removed[k - n], 0)] }
            });
            self.corner.solve_in_place(z.as_mut());
            x -= &self.columns * &z;
            for (k, &at) in self.added.iter().enumerate() {
                v[at] = z[(k, 0)];
            }
        }
        for (p, &at) in old.iter().enumerate() {
            v[at] = x[(p, 0)];
        }
        self.removed.iter().for_each(|&p| v[old[p]] = 0.0);
    }
}

/// The components of the jump that laws leave unknown.
fn unknowns(laws: &[Linearised], d: usize) -> Vec<usize> {
    (0..laws.len() * d).filter(|&at| laws[at / d].given[at % d].is_none()).collect()
}

fn max_abs(v: impl Iterator<Item = f64>) -> f64 {
    v.fold(0.0, |m, x| if x.abs() <= m { m } else { x.abs() })
}
