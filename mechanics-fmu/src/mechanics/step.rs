//! Time steps.

use std::fmt;
use std::time::{Duration, Instant};

use mesh::Vec3;

use super::{Energy, History, Mechanics, Partner, State, count, on_the_pool};
use crate::contact::{ContactState, Face};
use crate::error::MechanicsError;
use crate::newton::{Ending, FractureData, FractureSolution, NewtonReport};

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
    /// It was not, or is none that may be used.
    Discarded(Discard, StepReport),
}

/// Why there is no equilibrium to go on from; its text is a sentence without time.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Discard {
    /// Newton's method gave up.
    NotConverged {
        /// Newton iterations, all together.
        iterations: usize,
        /// Those of them that cycled.
        cycles: usize,
        /// Largest violation of a contact law (Pa) at the end.
        violation: f64,
    },
    /// Each way to solve the contact problem came to contact states at which it has no unique solution.
    Singular {
        /// Newton iterations, all together.
        iterations: usize,
        /// Open faces at the end.
        open: usize,
        /// Slipping faces at the end.
        slipping: usize,
    },
    /// A fracture without residual aperture closes by more than its contact aperture.
    Closed {
        /// Its name.
        fracture: String,
        /// Number of such faces, on all fractures.
        faces: usize,
        /// Centre of the one with the least aperture (m).
        at: Vec3,
        /// Its contact aperture (m).
        contact_aperture: f64,
        /// Its aperture (m), ≤ 0.
        aperture: f64,
        /// Its normal multiplier λ_n (Pa).
        pressed: f64,
    },
}

impl fmt::Display for Discard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotConverged { iterations, cycles, violation } => write!(
                f,
                "no equilibrium was found: after {iterations} Newton iterations, {cycles} of them cycling, a contact law is violated by \
                 {violation:.3e} Pa; a shorter time step may help"
            ),
            Self::Singular { iterations, open, slipping } => write!(
                f,
                "no equilibrium was found: after {iterations} Newton iterations the linearised contact problem is singular ({open} faces \
                 open, {slipping} slipping); a piece of the body may be free to move: hold it, or take a shorter time step"
            ),
            Self::Closed { fracture, faces, at: Vec3 { x, y, z }, contact_aperture, aperture, pressed } => write!(
                f,
                "fracture \"{fracture}\" closes to an aperture of {aperture:.3e} m at ({x:.4e}, {y:.4e}, {z:.4e}) m, where its sides are \
                 pressed by {pressed:.3e} Pa and its contact aperture is {contact_aperture:.3e} m ({faces} such face{}): its \
                 normal_stiffness is too small for a linear law; give it a largest_closure, which makes the law hyperbolic, or a \
                 residual_aperture above 0",
                if *faces == 1 { "" } else { "s" }
            ),
        }
    }
}

impl Mechanics {
    /// The equilibrium at `time` (s), after `previous`. The result depends on nothing else, to the last bit.
    ///
    /// # Errors
    /// Arrays of the wrong length, as in a state of another mesh, values that are not finite, boundary functions that give such,
    /// a stiffness that cannot be factorised.
    pub fn step(&mut self, previous: &State, time: f64, partner: &Partner) -> Result<Outcome, MechanicsError> {
        self.advance(previous, time, partner, true)
    }

    /// The equilibrium at `time` (s) that the body comes to from rest, without dilation. It is an initial state: porosity changes
    /// and the slip of dilation count from it.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn initial_equilibrium(&mut self, time: f64, partner: &Partner) -> Result<Outcome, MechanicsError> {
        let mut outcome = self.advance(&self.rest(time), time, partner, false)?;
        if let Outcome::Converged(state, _) = &mut outcome {
            self.make_initial(state);
        }
        Ok(outcome)
    }

    /// A step in which slip opens fractures by dilation or does not.
    fn advance(
        &mut self,
        previous: &State,
        time: f64,
        partner: &Partner,
        dilates: bool,
    ) -> Result<Outcome, MechanicsError> {
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
        let faces = self.faces_by(None, dilates);
        let add_product = |x: &[f64], y: &mut [f64]| self.system.add_schur_product(x, y);
        let problem = self.fracture_problem(&faces, &add_product);
        let data = FractureData {
            rhs: self.buffers.forward.condensed(),
            largest_force: b.iter().fold(0.0, |m, f| f.abs().max(m)),
            previous: previous_jump,
            origin: &previous.initial_jump,
            partners: &partners,
            guess: previous.history.extrapolate(previous_jump, time - previous.time),
        };
        let solution = on_the_pool(|| problem.solve(&data));
        let discard = self.discard(&faces, &solution, &previous.initial_jump);
        drop(faces);
        let mut report = StepReport {
            newton: solution.report,
            violation: solution.violation,
            change: solution.change,
            energy: Energy::default(),
            times,
        };
        lap(&mut report.times.newton);
        self.system.work.newton += report.times.newton;
        if let Some(discard) = discard {
            return Ok(Outcome::Discarded(discard, report));
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
            history: History {
                previous_jump: previous_jump.to_vec(),
                time_step: time - previous.time,
                partners,
                fading: solution.fading,
                dilates,
            },
        };
        report.energy = self.energy(previous, &state, &loads, &rhs)?;
        lap(&mut report.times.energy);
        Ok(Outcome::Converged(state, report))
    }

    /// Why what Newton's method found may not be used, if so.
    fn discard(&self, faces: &[Face], solution: &FractureSolution, origin: &[f64]) -> Option<Discard> {
        let NewtonReport { iterations, cycles, .. } = solution.report;
        match solution.ending {
            Ending::Unsettled => {
                return Some(Discard::NotConverged { iterations, cycles, violation: solution.violation });
            }
            Ending::Singular => {
                let [open, slipping] =
                    [ContactState::Open, ContactState::Slip].map(|wanted| count(&solution.states, wanted));
                return Some(Discard::Singular { iterations, open, slipping });
            }
            Ending::Converged => {}
        }
        let aperture = |i: usize| faces[i].aperture(&self.local(&solution.jump, i), &self.local(origin, i));
        let closed = (0..faces.len()).map(|i| (i, aperture(i))).filter(|&(_, aperture)| aperture <= 0.0);
        let (i, aperture) = closed.clone().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let network = self.mesh.network();
        Some(Discard::Closed {
            fracture: self.mesh.data().fractures[network.fracture[i]].clone(),
            faces: closed.count(),
            at: self.mesh.geometry().face_center[network.faces[i]],
            contact_aperture: faces[i].contact_aperture,
            aperture,
            pressed: solution.lambda[i * self.mesh.dim()],
        })
    }
}
