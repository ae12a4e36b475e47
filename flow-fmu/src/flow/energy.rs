//! The energy balance of a time step.

use serde::{Deserialize, Serialize};

use super::Flow;
use crate::model::SpaceTimeFunction;
use crate::report::StepReport;
use crate::scheme::{Coefficients, Evaluation};

/// The terms of the energy balance over one time step of δt, in J (2D: J/m; over 1 s in a steady state), the flow's
/// part of the discrete estimate (Droniou et al., CMAME 2024, theorem 4.2; project's method, section 5). With
/// p ∂t the balance of volume gives, to round-off,
///
/// `storage + damping + dissipation() + deformation = source + boundary + wells + gravity`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Energy {
    /// Increment of ½ (1/M + φ c_f) p_m² and ½ c_f d_f p_f².
    pub storage: f64,
    /// ½ (1/M + φ c_f) (p_mⁿ − p_mⁿ⁻¹)² and the same in fractures: what implicit Euler dissipates.
    pub damping: f64,
    /// δt Σ F·(ψ_K − ψ_σ) in the matrix.
    pub matrix_dissipation: f64,
    /// The same along the fractures, with C_f(d_f) at t^{n−1}.
    pub fracture_dissipation: f64,
    /// The same between matrix and fractures, with T_f(d_f) at t^{n−1}.
    pub exchange_dissipation: f64,
    /// ∫ p_m δ(porosity by deformation) + ∫_Γ p_f δd_f: what the fluid gives to the rock.
    pub deformation: f64,
    /// ∫ h p by sources.
    pub source: f64,
    /// ∫ p × inflow on the boundary.
    pub boundary: f64,
    /// Σ p × rate by wells, p that of the cell or fracture face.
    pub wells: f64,
    /// ∫ ρ g·V by gravity.
    pub gravity: f64,
}

impl Energy {
    /// All that is dissipated by flow.
    pub fn dissipation(&self) -> f64 {
        self.matrix_dissipation + self.fracture_dissipation + self.exchange_dissipation
    }

    /// Left side minus right side of the balance.
    pub fn defect(&self) -> f64 {
        self.storage + self.damping + self.dissipation() + self.deformation
            - self.source
            - self.boundary
            - self.wells
            - self.gravity
    }
}

impl Flow {
    pub(super) fn energy(
        &self,
        time: f64,
        rate: f64,
        c: &Coefficients,
        traces: &[f64],
        inflow: &[f64],
        evaluation: &Evaluation,
        porosity_change: &[f64],
        aperture: &[f64],
        report: &StepReport,
    ) -> Energy {
        let (mesh, space) = (&self.scheme.mesh, &self.scheme.space);
        let (geometry, network) = (mesh.geometry(), mesh.network());
        let dt = if rate > 0.0 { rate.recip() } else { 1.0 };
        let mut energy = Energy::default();
        let increment = |new: f64, old: f64| (0.5 * (new * new - old * old), 0.5 * (new - old).powi(2));
        let source = |function: &Option<SpaceTimeFunction>, x| function.as_ref().map_or(0.0, |h| h.at(x, time));
        for cell in 0..mesh.cell_count() {
            let p = evaluation.matrix_pressure[cell];
            let measure = geometry.cell_measure[cell];
            if rate > 0.0 {
                let (stored, damped) = increment(p, self.state.matrix_pressure[cell]);
                energy.storage += measure * self.storage(cell) * stored;
                energy.damping += measure * self.storage(cell) * damped;
                energy.deformation += measure * p * (porosity_change[cell] - self.state.porosity_change[cell]);
            }
            energy.source += dt * measure * p * source(&self.model.matrix_source, geometry.cell_center[cell]);
            for (&trace, k) in space.cell_traces.get(cell).iter().zip(space.cell_traces.range(cell)) {
                let flux = evaluation.cell_flux[k];
                energy.matrix_dissipation += dt * flux * (p - traces[trace] + self.scheme.cell_weight[k]);
                energy.gravity += dt * flux * self.scheme.cell_weight[k];
            }
        }
        let c_f = self.model.fluid.compressibility();
        for (i, &face) in network.faces.iter().enumerate() {
            let p = traces[space.fracture_trace(i)];
            let measure = geometry.face_measure[face];
            if rate > 0.0 {
                let d = self.state.aperture[i];
                let (stored, damped) = increment(p, self.fracture_pressure()[i]);
                energy.storage += measure * c_f * d * stored;
                energy.damping += measure * c_f * d * damped;
                energy.deformation += measure * p * (aperture[i] - d);
            }
            energy.source += dt * measure * p * source(&self.model.fracture_source, geometry.face_center[face]);
            for (&e, k) in network.face_edges.get(i).iter().zip(network.face_edges.range(i)) {
                let (flux, weight) = (evaluation.edge_flux[k], self.scheme.fracture_weight[k]);
                energy.fracture_dissipation += dt * flux * (p - traces[space.edge_trace(e)] + weight);
                energy.gravity += dt * flux * weight;
            }
            for q in evaluation.exchange[i] {
                if c.exchange[i] > 0.0 {
                    energy.exchange_dissipation += dt * q * q / c.exchange[i];
                }
                energy.gravity -= dt * q * self.scheme.side_weight[i];
            }
        }
        energy.boundary = dt
            * (self.pressures.iter().map(|d| -evaluation.residual[d.trace] * traces[d.trace]).sum::<f64>()
                + self.inflows.iter().map(|d| inflow[d.trace] * traces[d.trace]).sum::<f64>());
        for (well, done) in self.wells.iter().zip(&report.wells) {
            energy.wells += dt * done.rate * self.pressure_at(well.spot, evaluation, traces);
        }
        energy
    }
}
