//! Time steps.

use std::time::{Duration, Instant};

use super::{Energy, History, Mechanics, Partner, State, on_the_pool, singular};
use crate::error::MechanicsError;
use crate::newton::{FractureData, NewtonReport};

/// What a step took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Work of Newton's method.
    pub newton: NewtonReport,
    /// Largest violation of a contact law (Pa).
    pub violation: f64,
    /// Largest change of a jump in the last Newton iteration (m).
    pub change: f64,
    /// Terms of the energy balance.
    pub energy: Energy,
    /// Wall time of its parts.
    pub times: StepTimes,
}

/// Wall time of the parts of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepTimes {
    /// Right-hand side.
    pub loads: Duration,
    /// Elimination of the bulk from the right-hand side: the first half of a triangular solve.
    pub forward: Duration,
    /// Newton's method on the fracture.
    pub newton: Duration,
    /// Displacements from the jumps: the second half of the triangular solve.
    pub backward: Duration,
    /// Energy terms.
    pub energy: Duration,
}

/// The result of a step.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// The equilibrium was found.
    Converged(State, StepReport),
    /// Newton's method gave up; nothing of it may be used.
    NotConverged(StepReport),
}

impl Mechanics {
    /// The equilibrium at `time` (s), after `previous`. The result depends on nothing else, to the last bit.
    ///
    /// # Errors
    /// Arrays of the wrong length, as in a state of another mesh, values that are not finite, boundary functions that give such,
    /// a singular contact problem.
    pub fn step(&mut self, previous: &State, time: f64, partner: &Partner) -> Result<Outcome, MechanicsError> {
        if !time.is_finite() {
            return Err(MechanicsError::Value { field: "time", index: 0, value: time, allowed: "finite" });
        }
        self.check_state(previous)?;
        self.check_partner(partner)?;
        let stiffness = partner.response.as_ref().map_or(&[][..], |r| &r.matrix_pressure_stiffness);
        self.follow(stiffness)?;
        let mut times = StepTimes::default();
        let mut clock = Instant::now();
        let mut lap = |part: &mut Duration| {
            *part = clock.elapsed();
            clock = Instant::now();
        };
        let loads = self.loads(time)?;
        let mut rhs = loads.clone();
        self.add_pressures(partner, previous, &mut rhs)?;

        let mut unknowns = vec![0.0; rhs.len()];
        for (f, value) in self.system.fixed.iter().zip(self.prescribed(time)?) {
            unknowns[f.unknown] = value;
        }
        let fixed: Vec<f64> = self.system.fixed.iter().map(|f| unknowns[f.unknown]).collect();
        let mut full = rhs.clone();
        self.system.fixed_rows.mul_transpose_add(-1.0, &fixed, &mut full)?;
        let b: Vec<f64> = self.system.free.iter().map(|&u| full[u as usize]).collect();
        lap(&mut times.loads);
        self.system.cholesky.forward(&b, &mut self.buffers.forward, &mut self.buffers.scratch)?;
        lap(&mut times.forward);

        let partners = self.face_partners(partner);
        let previous_jump = previous.jump(&self.system.space);
        let add_product = |x: &[f64], y: &mut [f64]| self.system.add_schur_product(x, y);
        let problem = self.fracture_problem(&add_product);
        let data = FractureData {
            rhs: self.buffers.forward.condensed(),
            largest_force: b.iter().fold(0.0, |m, f| f.abs().max(m)),
            previous: previous_jump,
            origin: &previous.initial_jump,
            partners: &partners,
            guess: previous.history.extrapolate(previous_jump, time - previous.time),
        };
        let solution = on_the_pool(|| problem.solve(&data)).map_err(singular)?;
        let mut report = StepReport {
            newton: solution.report,
            violation: solution.violation,
            change: solution.change,
            energy: Energy::default(),
            times,
        };
        lap(&mut report.times.newton);
        self.system.work.newton += report.times.newton;
        if !solution.converged {
            return Ok(Outcome::NotConverged(report));
        }
        let mut x = vec![0.0; b.len()];
        self.system.cholesky.backward(&self.buffers.forward, &solution.jump, &mut x, &mut self.buffers.scratch)?;
        for (&u, x) in self.system.free.iter().zip(x) {
            unknowns[u as usize] = x;
        }
        lap(&mut report.times.backward);
        self.system.work.solving += report.times.forward + report.times.backward;
        self.system.work.solves += 1;
        let state = State {
            time,
            unknowns,
            multiplier: solution.lambda,
            contact: solution.states,
            initial_divergence: previous.initial_divergence.clone(),
            initial_jump: previous.initial_jump.clone(),
            history: History { previous_jump: previous_jump.to_vec(), time_step: time - previous.time, partners },
        };
        report.energy = self.energy(previous, &state, &loads, &rhs)?;
        lap(&mut report.times.energy);
        Ok(Outcome::Converged(state, report))
    }
}
