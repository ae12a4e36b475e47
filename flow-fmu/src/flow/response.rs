//! Derivatives of the pressures of a time step.

use super::Flow;
use super::Inputs;
use super::inputs::check_array;
use crate::error::FlowError;
use crate::model::fail_on;
use crate::report::timed;
use crate::scheme::Coefficients;

/// A direction in the space of the coupling inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Perturbation {
    /// δφ*, cells.
    pub porosity_change: Vec<f64>,
    /// δd* (m), fracture faces.
    pub aperture: Vec<f64>,
    /// δp* (Pa), cells.
    pub matrix_pressure_reference: Vec<f64>,
    /// δp_f* (Pa), fracture faces.
    pub fracture_pressure_reference: Vec<f64>,
}

/// The derivative of the pressures in a direction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PressureResponse {
    /// δp_K (Pa), cells.
    pub matrix_pressure: Vec<f64>,
    /// δp_f (Pa), fracture faces.
    pub fracture_pressure: Vec<f64>,
}

impl Flow {
    /// S_f = −∂p_f/∂d_f (Pa/m), fracture faces, as an increase of all apertures alike shows it in a time step of `dt` (s)
    /// from the present state: one solve. It counts the fluid that leaks off, and is finite for an incompressible one; for a
    /// sealed fracture it is 1/(c_f d_f). At most the cap of the model.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn fracture_pressure_stiffness(&mut self, dt: f64) -> Result<Vec<f64>, FlowError> {
        // A part that nothing holds is as stiff as what stands for its partner.
        let inputs = Inputs { references_follow: true, ..self.inputs() };
        let (inputs, mut problems) = (self.held(dt.recip(), &inputs).into_owned(), Vec::new());
        let mut c = self.coefficients(self.state.time, dt.recip(), &inputs, &mut problems);
        fail_on(problems)?;
        self.add_wells(&mut c, &inputs, &self.state.limited);
        let geometry = self.scheme.mesh.geometry();
        let faces = &self.scheme.mesh.network().faces;
        let taken: Vec<f64> = faces.iter().map(|&f| geometry.face_measure[f] / dt).collect();
        let cells = vec![0.0; geometry.cell_measure.len()];
        let cap = self.model.stiffness_cap.fracture;
        let response = self.respond(&c, &cells, &taken)?;
        Ok(response.fracture_pressure.into_iter().map(|p| p.clamp(0.0, cap)).collect())
    }

    /// The derivative of the pressures of the last time step in a direction of the inputs: one solve.
    ///
    /// # Errors
    /// [`FlowError::NothingSolved`], [`FlowError::Invalid`] for wrong lengths, [`FlowError::Linear`].
    pub fn linearised_response(&mut self, direction: &Perturbation) -> Result<PressureResponse, FlowError> {
        let Some(solved) = self.linearisation() else { return Err(FlowError::NothingSolved) };
        let mut problems = Vec::new();
        let (cells, faces) = (self.state.matrix_pressure.len(), self.state.aperture.len());
        for (array, values, expected) in [
            ("the direction of porosity change", &direction.porosity_change, cells),
            ("the direction of aperture", &direction.aperture, faces),
            ("the direction of matrix pressure reference", &direction.matrix_pressure_reference, cells),
            ("the direction of fracture pressure reference", &direction.fracture_pressure_reference, faces),
        ] {
            check_array(array, values, expected, "finite", f64::is_finite, &mut problems);
        }
        fail_on(problems)?;
        let geometry = self.scheme.mesh.geometry();
        let matrix: Vec<f64> = (0..cells)
            .map(|k| {
                let change = solved.porosity_compliance[k] * direction.matrix_pressure_reference[k];
                -geometry.cell_measure[k] * solved.rate * (direction.porosity_change[k] - change)
            })
            .collect();
        let fracture: Vec<f64> = (0..faces)
            .map(|i| {
                let change = solved.aperture_compliance[i] * direction.fracture_pressure_reference[i];
                let measure = geometry.face_measure[self.scheme.mesh.network().faces[i]];
                -measure * solved.rate * (direction.aperture[i] - change)
            })
            .collect();
        // A time step that failed, or another state, may have left the factor of other equations.
        self.respond(&solved.coefficients, &matrix, &fracture)
    }

    /// The change of the pressures for sources (m³/s, 2D: m²/s) in cells and fracture faces.
    pub(super) fn respond(
        &mut self,
        c: &Coefficients,
        matrix: &[f64],
        fracture: &[f64],
    ) -> Result<PressureResponse, FlowError> {
        let load = self.scheme.load(c, matrix, fracture);
        let mut x = Vec::new();
        self.scheme.gather(&load, &mut x);
        self.factorise(c)?;
        let Some(factor) = &self.factor else { return Err(FlowError::NothingSolved) };
        timed(&mut self.work.solving, || factor.cholesky.solve(&mut x, &mut self.scratch))?;
        self.work.solves += 1;
        let mut traces = vec![0.0; load.len()];
        self.scheme.correct(&mut traces, &x);
        let first = self.scheme.space.fracture_trace(0);
        Ok(PressureResponse {
            matrix_pressure: self.scheme.cell_response(c, matrix, &traces),
            fracture_pressure: traces[first..first + fracture.len()].to_vec(),
        })
    }
}
