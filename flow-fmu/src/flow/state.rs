//! The state between time steps, and the equations that led to it.

use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Serialize};

use super::inputs::check_array;
use super::{Flow, Solved};
use crate::error::{FlowError, Problem};
use crate::model::fail_on;
use crate::scheme::Coefficients;

/// The state of the flow: all that the next time step depends on. Cheap to clone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlowState {
    /// t (s).
    pub time: f64,
    /// p_K (Pa), cells.
    pub matrix_pressure: Vec<f64>,
    /// All other pressures (Pa), in the order of [`Space`](crate::Space).
    pub traces: Vec<f64>,
    /// Porosity change by deformation that the flow has accounted for, cells: φ* + C (p − p*).
    pub porosity_change: Vec<f64>,
    /// d_f (m) that the flow has accounted for, fracture faces: d* + C_f (p_f − p_f*).
    pub aperture: Vec<f64>,
    /// Whether each well is held at its limit.
    pub limited: Vec<bool>,
}

/// The equations of a solved time step, to go back to its end with [`Flow::resume`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Linearisation {
    pub(super) coefficients: Coefficients,
    /// 1/δt, or 0.
    pub(super) rate: f64,
    pub(super) porosity_compliance: Vec<f64>,
    pub(super) aperture_compliance: Vec<f64>,
}

impl Linearisation {
    /// δt (s); infinite for a steady state.
    pub fn time_step(&self) -> f64 {
        self.rate.recip()
    }
}

impl Flow {
    /// Goes to a state, as one that was saved.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] if it does not fit; then nothing changes.
    pub fn set_state(&mut self, state: FlowState) -> Result<(), FlowError> {
        self.check_state(&state, None)?;
        self.state = state;
        self.solved = None;
        Ok(())
    }

    /// Whether a state and the equations that led to it fit.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] with all that does not.
    pub fn check_state(&self, state: &FlowState, linearisation: Option<&Linearisation>) -> Result<(), FlowError> {
        let (old, mut problems) = (&self.state, Vec::new());
        for (array, new, old) in [
            ("the matrix pressure", &state.matrix_pressure, &old.matrix_pressure),
            ("the traces", &state.traces, &old.traces),
            ("the porosity change", &state.porosity_change, &old.porosity_change),
            ("the aperture", &state.aperture, &old.aperture),
        ] {
            check_array(array, new, old.len(), "finite", |v| v.is_finite(), &mut problems);
        }
        check_array("the aperture", &state.aperture, old.aperture.len(), "positive", |v| v > 0.0, &mut problems);
        if state.limited.len() != self.wells.len() {
            let (found, expected) = (state.limited.len(), self.wells.len());
            problems.push(Problem::Length { array: "the wells", found, expected });
        }
        if let Some(l) = linearisation {
            let (cells, faces) = (self.state.matrix_pressure.len(), self.state.aperture.len());
            let c = &l.coefficients;
            for (array, values, expected) in [
                ("the diagonal of cells", &c.cell_diagonal, cells),
                ("the source of cells", &c.cell_source, cells),
                ("the diagonal of fracture faces", &c.fracture_diagonal, faces),
                ("the source of fracture faces", &c.fracture_source, faces),
                ("the conductivity", &c.conductivity, faces),
                ("the exchange", &c.exchange, faces),
                ("the porosity compliance", &l.porosity_compliance, cells),
                ("the aperture compliance", &l.aperture_compliance, faces),
            ] {
                check_array(array, values, expected, "finite", f64::is_finite, &mut problems);
            }
        }
        fail_on(problems)
    }

    /// The equations of the last time step, if there was one since the last [`set_state`](Self::set_state).
    pub fn linearisation(&self) -> Option<Arc<Linearisation>> {
        self.solved.as_ref().map(|s| Arc::clone(&s.linearisation))
    }

    /// Goes to a state, and makes [`linearised_response`](Self::linearised_response) that of the time step which led to
    /// it. The fluxes do not come back.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] if one of them does not fit; then nothing changes.
    pub fn resume(&mut self, state: FlowState, linearisation: Arc<Linearisation>) -> Result<(), FlowError> {
        self.check_state(&state, Some(&linearisation))?;
        self.state = state;
        self.solved = Some(Solved { linearisation, end: None, fluxes: OnceLock::new() });
        Ok(())
    }
}
