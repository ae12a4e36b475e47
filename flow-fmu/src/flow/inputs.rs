//! What comes from outside in a time step, and what is wrong with it.

use serde::{Deserialize, Serialize};

use super::Flow;
use crate::error::{FlowError, Problem};
use crate::model::{Control, fail_on};

/// What comes from outside in a time step: the affine partner, and what the wells are to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Inputs {
    /// φ*, cells: b (div u − div u⁰).
    pub porosity_change: Vec<f64>,
    /// d* (m), fracture faces.
    pub aperture: Vec<f64>,
    /// C (1/Pa), cells; at least 0.
    pub porosity_compliance: Vec<f64>,
    /// C_f (m/Pa), fracture faces; at least 0.
    pub aperture_compliance: Vec<f64>,
    /// p* (Pa), cells.
    pub matrix_pressure_reference: Vec<f64>,
    /// p_f* (Pa), fracture faces.
    pub fracture_pressure_reference: Vec<f64>,
    /// Whether p* and p_f* follow the pressures, in time steps that are repeated until both agree: then they hold parts that
    /// nothing else does.
    pub references_follow: bool,
    /// In the order of the model.
    pub wells: Vec<Control>,
}

impl Flow {
    /// Inputs that leave porosity and aperture as they are in the present state, and the wells as in the model.
    pub fn inputs(&self) -> Inputs {
        let state = &self.state;
        Inputs {
            porosity_change: state.porosity_change.clone(),
            aperture: state.aperture.clone(),
            porosity_compliance: vec![0.0; state.porosity_change.len()],
            aperture_compliance: vec![0.0; state.aperture.len()],
            matrix_pressure_reference: state.matrix_pressure.clone(),
            fracture_pressure_reference: self.fracture_pressure().to_vec(),
            references_follow: false,
            wells: self.model.wells.iter().map(|w| w.control).collect(),
        }
    }

    /// Whether inputs are such that [`step`](Self::step) can take them.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] with all that is wrong.
    pub fn check_inputs(&self, inputs: &Inputs) -> Result<(), FlowError> {
        fail_on(self.problems_of(inputs))
    }

    pub(super) fn problems_of(&self, inputs: &Inputs) -> Vec<Problem> {
        let mut problems = Vec::new();
        let (cells, faces) = (self.state.matrix_pressure.len(), self.state.aperture.len());
        for (array, values, expected) in [
            ("the porosity change", &inputs.porosity_change, cells),
            ("the matrix pressure reference", &inputs.matrix_pressure_reference, cells),
            ("the fracture pressure reference", &inputs.fracture_pressure_reference, faces),
        ] {
            check_array(array, values, expected, "finite", f64::is_finite, &mut problems);
        }
        let positive = |v: f64| v > 0.0 && v.is_finite();
        check_array("the aperture", &inputs.aperture, faces, "positive and finite", positive, &mut problems);
        for (array, values, expected) in [
            ("the porosity compliance", &inputs.porosity_compliance, cells),
            ("the aperture compliance", &inputs.aperture_compliance, faces),
        ] {
            let right = |v: f64| v >= 0.0 && v.is_finite();
            check_array(array, values, expected, "at least 0 and finite", right, &mut problems);
        }
        if inputs.wells.len() == self.wells.len() {
            for ((well, placed), control) in self.model.wells.iter().zip(&self.wells).zip(&inputs.wells) {
                let (Control::Rate(value) | Control::Pressure(value)) = *control;
                if !value.is_finite() {
                    let of = format!("well \"{}\"", well.name);
                    problems.push(Problem::Value { of, quantity: "its control", value, must: "finite" });
                }
                if !placed.can_hold_pressure() && matches!(control, Control::Pressure(_)) {
                    problems.push(Problem::lacks_index(well));
                }
            }
        } else {
            let (found, expected) = (inputs.wells.len(), self.wells.len());
            problems.push(Problem::Length { array: "the list of wells", found, expected });
        }
        problems
    }
}

/// Reports the length of an array if it is wrong, or else its first wrong value.
pub(super) fn check_array(
    array: &'static str,
    values: &[f64],
    expected: usize,
    must: &'static str,
    right: impl Fn(f64) -> bool,
    problems: &mut Vec<Problem>,
) {
    if values.len() != expected {
        problems.push(Problem::Length { array, found: values.len(), expected });
    } else if let Some(place) = values.iter().position(|&v| !right(v)) {
        let of = format!("entry {place}");
        problems.push(Problem::Value { of, quantity: array, value: values[place], must });
    }
}
