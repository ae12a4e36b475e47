//! Porosity, storage, and the fluid in place.

use super::Flow;
use crate::report::Inflow;

impl Flow {
    /// S = −∂p/∂(porosity change) as the flow sees it, 1/(1/M + φ c_f) (Pa), cells; at most the cap of the model.
    pub fn matrix_pressure_stiffness(&self) -> Vec<f64> {
        let cap = self.model.stiffness_cap.matrix;
        (0..self.state.matrix_pressure.len()).map(|cell| cap.min(self.storage(cell).recip())).collect()
    }

    /// φ of each cell in the present state, never below 0.
    pub fn porosity(&self) -> Vec<f64> {
        (0..self.state.matrix_pressure.len()).map(|cell| self.porosity_of(cell)).collect()
    }

    /// Volume of the fluid in place, in the rock and in fractures (m³, 2D: m²), at the reference density.
    pub fn fluid_in_place(&self) -> Inflow {
        let geometry = self.scheme.mesh.geometry();
        let faces = &self.scheme.mesh.network().faces;
        Inflow {
            matrix: geometry.cell_measure.iter().enumerate().map(|(k, v)| v * self.porosity_of(k)).sum(),
            fracture: faces.iter().zip(&self.state.aperture).map(|(&f, d)| geometry.face_measure[f] * d).sum(),
        }
    }

    pub(super) fn porosity_of(&self, cell: usize) -> f64 {
        let rock = &self.rocks[self.scheme.mesh.data().cell_region[cell]];
        let elastic = rock.storage() * (self.state.matrix_pressure[cell] - self.initial_pressure[cell]);
        (rock.porosity + self.state.porosity_change[cell] + elastic).max(0.0)
    }

    /// 1/M + φ c_f.
    pub(super) fn storage(&self, cell: usize) -> f64 {
        let rock = &self.rocks[self.scheme.mesh.data().cell_region[cell]];
        match self.model.fluid.compressibility() {
            0.0 => rock.storage(),
            c_f => rock.storage() + self.porosity_of(cell) * c_f,
        }
    }
}
