//! Loads and prescribed displacements.

use mesh::Vec3;

use super::Mechanics;
use crate::error::{MechanicsError, ModelProblem};
use crate::system::boundary_nodes;

impl Mechanics {
    /// Tractions and body forces at a time, over all unknowns (N).
    pub(super) fn loads(&self, time: f64) -> Result<Vec<f64>, MechanicsError> {
        let d = self.mesh.dim();
        let geometry = self.mesh.geometry();
        let mut f = vec![0.0; self.system.space.unknown_count()];
        let finite = |what: &str, p: Vec3, value: Vec3| {
            if value.is_finite() {
                return Ok(());
            }
            let (x, y, z) = (p.x, p.y, p.z);
            let value = value.to_array().into_iter().find(|v| !v.is_finite()).unwrap_or(f64::NAN);
            let problem = ModelProblem::Function { what: what.into(), x, y, z, time, value, allowed: "finite" };
            Err(MechanicsError::Model(vec![problem]))
        };
        if let Some(force) = &self.model.body_force {
            for cell in 0..self.mesh.cell_count() {
                let p = geometry.cell_center[cell];
                let value = force(p, time);
                finite("the body force", p, value)?;
                let weights = &geometry.cell_weight[self.mesh.cell_vertex_lists().range(cell)];
                for (&node, w) in self.mesh.nodes().of_cell(cell).iter().zip(weights) {
                    for c in 0..d {
                        f[node * d + c] += geometry.cell_measure[cell] * w * value[c];
                    }
                }
                // As the pressure −f·(x_σ − x_K), so that a column at rest under its weight has no bubbles.
                let space = &self.system.space;
                for (entity, face, sign) in space.normal_bubbles(&self.mesh, cell) {
                    let potential = value.dot(geometry.face_center[face] - p);
                    f[space.unknowns_of(entity).start] += sign * geometry.face_vector[face].length() * potential;
                }
            }
        }
        for condition in &self.model.neumann {
            for face in self.mesh.tagged_faces(&condition.tag) {
                let p = geometry.face_center[face];
                let value = (condition.traction)(p, time);
                finite(&format!("the traction on \"{}\"", condition.tag), p, value)?;
                let weights = &geometry.face_weight[self.mesh.data().faces.range(face)];
                for (node, w) in boundary_nodes(&self.mesh, face).zip(weights) {
                    for c in 0..d {
                        f[node * d + c] += geometry.face_measure[face] * w * value[c];
                    }
                }
            }
        }
        Ok(f)
    }

    pub(super) fn prescribed(&self, time: f64) -> Result<Vec<f64>, MechanicsError> {
        (self.system.fixed.iter())
            .map(|f| {
                let value = (f.value)(&f.point, time);
                if value.is_finite() {
                    return Ok(value);
                }
                let what = format!("the displacement on {}", f.place);
                let Vec3 { x, y, z } = f.point.at;
                let problem = ModelProblem::Function { what, x, y, z, time, value, allowed: "finite" };
                Err(MechanicsError::Model(vec![problem]))
            })
            .collect()
    }
}
