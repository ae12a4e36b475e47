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
//! the correction of δ (see [`crate::linearised`]). The forces are computed in double precision, from the factor; the
//! corrections with copies of S and S⁻¹ in less. Nothing is kept from one step to the next: a step repeated from the same state
//! repeats bit for bit.
//!
//! The laws of different faces meet only through S, so where Newton's method cycles, sweeps of a nonlinear block
//! Gauss–Seidel method (Jean, CMAME 1999), which solves the law of one face after the other exactly, move it on. If
//! it goes on cycling, or meets contact states at which the linearised problem is singular, it starts again by the next of
//! [`STRATEGIES`]: a larger β, and, where a bound that opening ends leaves no equilibrium, a bound that fades (see
//! [`crate::contact`]).

use std::collections::HashSet;

use linear::DenseSymmetric;

use crate::contact::{ContactState, Face, FacePartner, Linearised, Local};
use crate::linearised::{LinearisedProblem, Schur, single_product};
use crate::model::NewtonSettings;

/// A linear solve reduces the residual by this much, and by more once contact states repeat. With less, Newton's method takes
/// more iterations; with more, not fewer.
const FORCING: f64 = 1e-3;
const SETTLED: f64 = 1e-4;
/// Residuals below this part of the largest force on a face are round-off.
const NEGLIGIBLE: f64 = 1e-15;
/// What round-off leaves of a force, as part of the largest given force and of the forces that cancel in S δ. Where nothing
/// presses on the fracture, tractions are nothing else.
const ROUND_OFF: f64 = 1e-14;
/// Gauss–Seidel sweeps after a cycle.
const SWEEPS: usize = 5;
/// Cycles that an attempt may make.
const CYCLES: usize = 3;
/// A response is refined until what is left is this part of it, well below what differences of time steps tell; each solve
/// gains a factor of [`FORCING`] at least, and is repeated at most [`REFINEMENTS`] times.
const REFINED: f64 = 1e-9;
const REFINEMENTS: usize = 4;
/// How a time step is sought: the laws, and the multiples of β with which they are tried until Newton's method converges. A
/// solution does not depend on β, but the path to it does, most where pressures that follow make the laws curved.
struct Strategy {
    /// λ_0 as a part of Tresca's bound or cohesion; `None` where these do not fade.
    fading: Option<f64>,
    betas: [f64; 3],
}

/// The first row is all where it converges, or where no bound drops at opening. Else the others follow, each from the solution
/// of the one before (the second from the guess), and the last one's solution is that of the time step; where one does not
/// converge with any β, the time step is given up. At worst that takes 12 attempts, each of at most
/// [`NewtonSettings::max_iterations`] Newton iterations and [`CYCLES`] · [`SWEEPS`] sweeps: 720 iterations and 180 sweeps with
/// the defaults.
const STRATEGIES: [Strategy; 4] = [
    Strategy { fading: None, betas: [1.0, 10.0, 100.0] },
    Strategy { fading: Some(1.0), betas: [1.0, 10.0, 100.0] },
    Strategy { fading: Some(0.3), betas: [1.0, 10.0, 100.0] },
    Strategy { fading: Some(0.1), betas: [1.0, 10.0, 100.0] },
];

/// The contact problem on all fracture faces.
pub(crate) struct FractureProblem<'a, 'f> {
    pub(crate) dim: usize,
    pub(crate) schur: Schur<'a>,
    pub(crate) faces: &'f [Face],
    pub(crate) settings: NewtonSettings,
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

/// What Newton's method did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NewtonReport {
    /// Newton iterations.
    pub iterations: usize,
    /// GMRES iterations, all together.
    pub linear_iterations: usize,
    /// Dense factorisations on the fracture, where GMRES did not do without.
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
    pub(crate) report: NewtonReport,
    pub(crate) ending: Ending,
    /// λ_0 as a part of the bounds by which it was found; `None` where these do not fade.
    pub(crate) fading: Option<f64>,
    /// Largest violation of a contact law (Pa) and largest change of the jump (m) in the last iteration.
    pub(crate) violation: f64,
    pub(crate) change: f64,
}

/// How Newton's method ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    Converged,
    /// After the most iterations or cycles allowed.
    Unsettled,
    /// The linearised problem cannot be solved at the contact states.
    Singular,
}

/// The linearised problem cannot be solved at these contact states.
#[derive(Debug)]
pub(crate) struct SingularFracture(pub(crate) Vec<ContactState>);

impl FractureProblem<'_, '_> {
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
            let (previous, origin) = (self.local(data.previous, i), self.local(data.origin, i));
            for c in 0..d {
                lambda[i * d + c] /= face.measure;
            }
            lambda[i * d] += data.partners[i].stiffness * face.aperture(&jump, &origin);
            let own = self.local(&lambda, i);
            states.push(face.state(&jump, &own, &previous, &origin));
            let own = face.violation(&jump, &own, &previous, &origin);
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

    /// Solves the contact problem of a time step by one of [`STRATEGIES`] after the other, starting from stick everywhere or
    /// from the guess.
    pub(crate) fn solve(&self, data: &FractureData<'_>) -> FractureSolution {
        let [first, fading @ ..] = &STRATEGIES;
        let mut solution = self.attempts(first, data, data.guess.as_deref(), NewtonReport::default());
        if solution.ending == Ending::Converged || !self.faces.iter().any(Face::drops) {
            return solution;
        }
        let mut guess = data.guess.clone();
        for strategy in fading {
            solution.report.fadings += 1;
            solution = self.attempts(strategy, data, guess.as_deref(), solution.report);
            if solution.ending != Ending::Converged {
                break;
            }
            guess = Some(solution.jump.iter().zip(data.previous).map(|(g, p)| g - p).collect());
        }
        solution
    }

    /// Newton's method by a strategy, with one β after the other until it converges; the report adds to an earlier one.
    fn attempts(
        &self,
        strategy: &Strategy,
        data: &FractureData<'_>,
        guess: Option<&[f64]>,
        report: NewtonReport,
    ) -> FractureSolution {
        let [first, larger @ ..] = strategy.betas;
        let mut solution = self.attempt(strategy.fading, first, data, guess, report);
        for beta in larger {
            if solution.ending == Ending::Converged {
                break;
            }
            solution = self.attempt(strategy.fading, beta, data, guess, solution.report);
        }
        solution
    }

    /// Newton's method from a guess of the increment (m), with bounds that fade or not and a multiple of β.
    fn attempt(
        &self,
        fading: Option<f64>,
        beta: f64,
        data: &FractureData<'_>,
        guess: Option<&[f64]>,
        report: NewtonReport,
    ) -> FractureSolution {
        if fading.is_none() && beta == 1.0 {
            return self.newton(data, guess, report);
        }
        let faces: Vec<Face> = self.faces.iter().map(|face| face.altered(fading, beta)).collect();
        let solution = FractureProblem { faces: &faces, ..*self }.newton(data, guess, report);
        FractureSolution { fading, ..solution }
    }

    fn newton(&self, data: &FractureData<'_>, guess: Option<&[f64]>, mut report: NewtonReport) -> FractureSolution {
        let limit = report.iterations + self.settings.max_iterations;
        let most_cycles = report.cycles + CYCLES;
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
        let mut forcing = FORCING;
        let mut ending = if self.faces.is_empty() { Ending::Converged } else { Ending::Unsettled };
        while ending == Ending::Unsettled && report.iterations < limit && report.cycles < most_cycles {
            report.iterations += 1;
            let laws = self.linearise(data, &at);
            let Some(correction) = self.solve_linear(&laws, &at.force, forcing, &mut report) else {
                ending = Ending::Singular;
                break;
            };
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
            if change <= larger(noise, tolerance * size) && next.excess <= tolerance * traction {
                ending = Ending::Converged;
            }
            let repeats = next.states == at.states;
            forcing = if repeats { SETTLED } else { FORCING };
            at = next;
            if ending != Ending::Converged && !repeats && !seen.insert(at.states.clone()) {
                report.cycles += 1;
                seen.clear();
                at = self.sweep(data, at);
            }
        }
        let jump = data.previous.iter().zip(&at.increment).map(|(g, d)| g + d).collect();
        let Iterate { lambda, states, violation, .. } = at;
        FractureSolution { jump, lambda, states, report, ending, fading: None, violation, change }
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
        forcing: f64,
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
        // Most of what is given is round-off of what was given before.
        let negligible = NEGLIGIBLE * max_abs(&force);
        let force_of = |at: usize| correction[at] * self.faces[at / d].stiffness * self.faces[at / d].measure;
        let given: Vec<f64> =
            (0..force.len()).map(|at| if force_of(at).abs() > negligible { correction[at] } else { 0.0 }).collect();
        if given.iter().any(|&g| g != 0.0) {
            // What less than double precision leaves, the next iteration sees.
            force.iter_mut().zip(single_product(self.schur.single, &given)).for_each(|(f, g)| *f += f64::from(g));
        }
        let mut b = vec![0.0; force.len()];
        for (i, law) in laws.iter().enumerate() {
            let (own, known) = (self.local(&force, i), self.local(&correction, i));
            for c in (0..d).filter(|&c| law.given[c].is_none()) {
                b[i * d + c] =
                    -law.constant[c] - (0..d).map(|j| law.t[c][j] * own[j] + law.h[c][j] * known[j]).sum::<f64>();
            }
        }
        let size = b.iter().map(|b| b * b).sum::<f64>().sqrt();
        let target = (forcing * size).max(negligible);
        let problem = LinearisedProblem { dim: d, schur: self.schur, laws };
        let mut x = problem.solve(&b, target, report)?;
        problem.carry(&mut x);
        correction.iter_mut().zip(&x).for_each(|(c, x)| *c += x);
        Some(correction)
    }

    /// The change of the jump for a change of the right-hand side (N) at a solution, at its contact states.
    pub(crate) fn response(
        &self,
        data: &FractureData<'_>,
        jump: &[f64],
        lambda: &[f64],
        states: &[ContactState],
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
            law.given = law.given.map(|value| value.map(|_| 0.0));
        }
        let force: Vec<f64> = change.iter().map(|f| -f).collect();
        let mut total = vec![0.0; change.len()];
        for _ in 0..REFINEMENTS {
            let mut rest = force.clone();
            (self.schur.add_product)(&total, &mut rest);
            for (i, law) in laws.iter_mut().enumerate() {
                let own = self.local(&total, i);
                law.constant = std::array::from_fn(|c| (0..self.dim).map(|j| law.h[c][j] * own[j]).sum());
            }
            let correction = self.solve_linear(&laws, &rest, FORCING, &mut NewtonReport::default());
            let correction = correction.ok_or_else(|| SingularFracture(states.to_vec()))?;
            total.iter_mut().zip(&correction).for_each(|(t, c)| *t += c);
            if FORCING * max_abs(&correction) <= REFINED * max_abs(&total) {
                break;
            }
        }
        Ok(total)
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
                        let entry = |k: usize| f64::from(self.schur.single.get(k, i * d + c));
                        force.iter_mut().enumerate().for_each(|(k, f)| *f += correction[c] * entry(k));
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
        let single = DenseSymmetric::from_fn(self.dim, |i, j| self.schur.single.get(own.start + i, own.start + j));
        let add_product = |x: &[f64], y: &mut [f64]| {
            for (j, x) in x.iter().enumerate() {
                y.iter_mut().enumerate().for_each(|(i, y)| *y += f64::from(single.get(i, j)) * x);
            }
        };
        let one = FractureProblem {
            dim: self.dim,
            schur: Schur { single: &single, inverse: None, add_product: &add_product },
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
            match one.solve_linear(&laws, &at.force, FORCING, &mut NewtonReport::default()) {
                Some(correction) => at = one.corrected(&data, &at, &correction),
                None => break,
            }
        }
        let (old, new) = (self.local(increment, i), one.local(&at.increment, 0));
        std::array::from_fn(|c| new[c] - old[c])
    }
}

/// The larger of two numbers, or NaN.
fn larger(a: f64, b: f64) -> f64 {
    if b <= a { a } else { b }
}

fn max_abs(v: &[f64]) -> f64 {
    v.iter().fold(0.0, |m, x| larger(m, x.abs()))
}
