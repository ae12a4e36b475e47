//! Pressures as the partner gives them: fixed, or such that they follow the deformation.

use mesh::Mesh;
use serde::{Deserialize, Serialize};

use super::state::check_values;
use super::{Mechanics, State};
use crate::contact::FacePartner;
use crate::error::MechanicsError;

/// How the partner's fields follow ours: p_m = p_m* − S (φ − φ*), p_f = p_f* − S_f (d_f − d_f*).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Partner {
    /// Matrix pressure p_m* (Pa): cells.
    pub matrix_pressure: Vec<f64>,
    /// Fracture pressure p_f* (Pa): fracture faces.
    pub fracture_pressure: Vec<f64>,
    /// How pressures answer to deformation; `None` where they are given.
    pub response: Option<PartnerResponse>,
}

/// The part of [`Partner`] that makes pressures follow the deformation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartnerResponse {
    /// S ≥ 0 (Pa): cells.
    pub matrix_pressure_stiffness: Vec<f64>,
    /// Porosity change φ* at which p_m* holds: cells.
    pub porosity_change: Vec<f64>,
    /// S_f ≥ 0 (Pa/m): fracture faces.
    pub fracture_pressure_stiffness: Vec<f64>,
    /// Aperture d_f* (m) at which p_f* holds: fracture faces.
    pub aperture: Vec<f64>,
}

impl Partner {
    /// The same pressure (Pa) in the matrix and in the fractures.
    pub fn uniform(mesh: &Mesh, pressure: f64) -> Self {
        Self {
            matrix_pressure: vec![pressure; mesh.cell_count()],
            fracture_pressure: vec![pressure; mesh.network().face_count()],
            response: None,
        }
    }
}

impl Mechanics {
    pub(super) fn check_partner(&self, partner: &Partner) -> Result<(), MechanicsError> {
        let (cells, faces) = (self.mesh.cell_count(), self.faces.len());
        let check = |field, values: &[f64], expected, not_negative: bool| {
            if values.len() != expected {
                return Err(MechanicsError::Length { field, found: values.len(), expected });
            }
            let allowed = if not_negative { "finite and ≥ 0" } else { "finite" };
            check_values(field, values, |v| v.is_finite() && (!not_negative || v >= 0.0), allowed)
        };
        check("matrix pressure", &partner.matrix_pressure, cells, false)?;
        check("fracture pressure", &partner.fracture_pressure, faces, false)?;
        if let Some(r) = &partner.response {
            check("matrix pressure stiffness", &r.matrix_pressure_stiffness, cells, true)?;
            check("porosity change reference", &r.porosity_change, cells, false)?;
            check("fracture pressure stiffness", &r.fracture_pressure_stiffness, faces, true)?;
            check("aperture reference", &r.aperture, faces, false)?;
        }
        Ok(())
    }

    /// Makes the factorisation that of a matrix stiffness of the partner (Pa, cells; empty for 0), as
    /// [`response`](Self::response) and [`aperture_compliance`](Self::aperture_compliance) need it at a state that was
    /// found with it, if other time steps have been made since.
    ///
    /// # Errors
    /// [`MechanicsError::Length`] or [`MechanicsError::Value`], and nothing is changed; [`MechanicsError::Linear`] if the system
    /// cannot be factorised: then there is no factorisation until a later call makes one.
    pub fn follow(&mut self, matrix_stiffness: &[f64]) -> Result<(), MechanicsError> {
        let (found, expected) = (matrix_stiffness.len(), self.mesh.cell_count());
        if found != 0 && found != expected {
            return Err(MechanicsError::Length { field: "matrix pressure stiffness", found, expected });
        }
        check_values("matrix pressure stiffness", matrix_stiffness, |v| v.is_finite() && v >= 0.0, "finite and ≥ 0")?;
        let wanted = if matrix_stiffness.iter().any(|&s| s != 0.0) { matrix_stiffness } else { &[] };
        if self.factorised_for.as_deref() != Some(wanted) {
            let extra: Vec<f64> = (0..self.mesh.cell_count())
                .map(|k| wanted.get(k).map_or(0.0, |s| s * self.material(k).biot.powi(2)))
                .collect();
            self.factorised_for = None;
            self.system.refactorise(&self.mesh, &extra)?;
            self.factorised_for = Some(wanted.to_vec());
        }
        Ok(())
    }

    /// The matrix stiffness of the partner (Pa, cells) that the factorisation is made for; empty for 0.
    pub fn matrix_stiffness(&self) -> &[f64] {
        self.factorised_for.as_deref().unwrap_or_default()
    }

    /// Whether there is a factorisation.
    pub(super) fn check_factor(&self) -> Result<(), MechanicsError> {
        self.factorised_for.as_ref().map(drop).ok_or(MechanicsError::Unfactorised)
    }

    pub(super) fn face_partners(&self, partner: &Partner) -> Vec<FacePartner> {
        match &partner.response {
            None => vec![FacePartner::default(); self.faces.len()],
            Some(r) => (r.fracture_pressure_stiffness.iter().zip(&r.aperture))
                .map(|(&stiffness, &aperture)| FacePartner { offset: stiffness * aperture, stiffness })
                .collect(),
        }
    }

    /// Adds the pressures' part to a right-hand side; where they follow the deformation, the part that does not depend
    /// on it.
    pub(super) fn add_pressures(
        &self,
        partner: &Partner,
        state: &State,
        rhs: &mut [f64],
    ) -> Result<(), MechanicsError> {
        let measures = &self.mesh.geometry().cell_measure;
        let mut weighted: Vec<f64> = partner.matrix_pressure.clone();
        if let Some(r) = &partner.response {
            for (k, p) in weighted.iter_mut().enumerate() {
                let initial = self.material(k).biot * state.initial_divergence[k];
                *p += r.matrix_pressure_stiffness[k] * (r.porosity_change[k] + initial);
            }
        }
        for (k, p) in weighted.iter_mut().enumerate() {
            *p *= measures[k] * self.material(k).biot;
        }
        self.system.divergence.mul_transpose_add(1.0, &weighted, rhs)?;
        let partners = self.face_partners(partner);
        for (i, face) in self.faces.iter().enumerate() {
            rhs[self.normal_jump(i)] -= face.measure * (partner.fracture_pressure[i] + partners[i].offset);
        }
        Ok(())
    }
}
