//! States, and whether they belong to a mesh.

use serde::{Deserialize, Serialize};

use super::{Mechanics, count};
use crate::contact::{ContactState, FacePartner};
use crate::error::MechanicsError;
use crate::space::Space;

/// A mechanical equilibrium at a time. It is all that the next one depends on.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct State {
    /// Time (s).
    pub time: f64,
    /// All unknowns in the numbering of [`Space`] (m).
    pub unknowns: Vec<f64>,
    /// Multiplier λ = −T⁺ (Pa) in the basis of each face: fracture faces × d.
    pub multiplier: Vec<f64>,
    /// State of each fracture face.
    pub contact: Vec<ContactState>,
    /// div u at the initial state, from which porosity changes count: cells.
    pub initial_divergence: Vec<f64>,
    /// Jump at the initial state (m), from which the slip of dilation counts: fracture faces × d.
    pub initial_jump: Vec<f64>,
    pub(crate) history: History,
}

/// What is remembered of the step that led to a state, for the linearised response and the first guess of the next.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct History {
    pub(super) previous_jump: Vec<f64>,
    pub(super) time_step: f64,
    pub(super) partners: Vec<FacePartner>,
    /// λ_0 as a part of Tresca's bound or cohesion, where these faded.
    pub(super) fading: Option<f64>,
    /// Whether slip opened fractures by dilation; not so at the initial equilibrium.
    pub(super) dilates: bool,
}

impl History {
    /// The increment of the jump if it goes on at the same rate.
    pub(super) fn extrapolate(&self, jump: &[f64], time_step: f64) -> Option<Vec<f64>> {
        let factor = time_step / self.time_step;
        let increment = jump.iter().zip(&self.previous_jump).map(|(g, p)| factor * (g - p));
        (self.time_step > 0.0 && factor.is_finite()).then(|| increment.collect())
    }
}

impl State {
    /// Jump ⟦u⟧ (m) in the basis (n⁺, t₁[, t₂]) of each face: fracture faces × d.
    pub fn jump(&self, space: &Space) -> &[f64] {
        &self.unknowns[space.first_jump_unknown()..]
    }

    /// S_f (Pa/m) of each fracture face in the time step to this state; 0 where pressures were given.
    pub fn fracture_stiffness(&self) -> Vec<f64> {
        self.history.partners.iter().map(|partner| partner.stiffness).collect()
    }

    /// Number of faces in a contact state.
    pub fn count(&self, wanted: ContactState) -> usize {
        count(&self.contact, wanted)
    }
}

impl Mechanics {
    /// The body at rest: no displacement, no traction, all fractures in contact. It is an initial state.
    pub fn rest(&self, time: f64) -> State {
        let jumps = self.faces.len() * self.mesh.dim();
        State {
            time,
            unknowns: vec![0.0; self.system.space.unknown_count()],
            multiplier: vec![0.0; jumps],
            contact: vec![ContactState::Stick; self.faces.len()],
            initial_divergence: vec![0.0; self.mesh.cell_count()],
            initial_jump: vec![0.0; jumps],
            history: History {
                previous_jump: vec![0.0; jumps],
                time_step: 0.0,
                partners: vec![FacePartner::default(); self.faces.len()],
                fading: None,
                dilates: true,
            },
        }
    }

    /// Declares a state the initial one, from which porosity changes and slip count. It must have been found without dilation.
    pub(super) fn make_initial(&self, state: &mut State) {
        state.initial_jump = state.jump(&self.system.space).to_vec();
        state.initial_divergence = self.divergence(state);
    }

    /// A state that was written and read again; what follows it has the same bits.
    ///
    /// # Errors
    /// [`MechanicsError::Length`] if it is that of another mesh; [`MechanicsError::Value`] if a number of it is none that a time
    /// step leaves: one that is not finite, a negative stiffness of a partner.
    pub fn load(&self, read: State) -> Result<State, MechanicsError> {
        self.check_state(&read)?;
        let history = &read.history;
        let partners = |of: fn(&FacePartner) -> f64| history.partners.iter().map(of).collect::<Vec<_>>();
        let (offsets, stiffnesses) = (partners(|p| p.offset), partners(|p| p.stiffness));
        let fading = history.fading.as_slice();
        let finite = |v: f64| v.is_finite();
        let not_negative = |v: f64| v.is_finite() && v >= 0.0;
        let positive = |v: f64| v.is_finite() && v > 0.0;
        check_values("time", &[read.time], finite, "finite")?;
        check_values("displacement", &read.unknowns, finite, "finite")?;
        check_values("multiplier", &read.multiplier, finite, "finite")?;
        check_values("initial divergence", &read.initial_divergence, finite, "finite")?;
        check_values("initial jump", &read.initial_jump, finite, "finite")?;
        check_values("previous jump", &history.previous_jump, finite, "finite")?;
        check_values("time step", &[history.time_step], finite, "finite")?;
        check_values("pressure of a partner", &offsets, finite, "finite")?;
        check_values("fracture pressure stiffness", &stiffnesses, not_negative, "finite and ≥ 0")?;
        check_values("fading of bounds", fading, positive, "finite and > 0")?;
        Ok(read)
    }

    /// Whether a state has the lengths of this mesh.
    pub(super) fn check_state(&self, state: &State) -> Result<(), MechanicsError> {
        let (d, faces) = (self.mesh.dim(), self.faces.len());
        for (field, found, expected) in [
            ("displacement", state.unknowns.len(), self.system.space.unknown_count()),
            ("multiplier", state.multiplier.len(), d * faces),
            ("contact state", state.contact.len(), faces),
            ("initial divergence", state.initial_divergence.len(), self.mesh.cell_count()),
            ("initial jump", state.initial_jump.len(), d * faces),
            ("previous jump", state.history.previous_jump.len(), d * faces),
            ("partner of a fracture face", state.history.partners.len(), faces),
        ] {
            if found != expected {
                return Err(MechanicsError::Length { field, found, expected });
            }
        }
        Ok(())
    }
}

/// Whether all values hold what is `allowed`.
pub(super) fn check_values(
    field: &'static str,
    values: &[f64],
    is_allowed: impl Fn(f64) -> bool,
    allowed: &'static str,
) -> Result<(), MechanicsError> {
    match values.iter().position(|&v| !is_allowed(v)) {
        Some(index) => Err(MechanicsError::Value { field, index, value: values[index], allowed }),
        None => Ok(()),
    }
}
