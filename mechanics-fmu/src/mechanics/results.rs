//! What follows from a state.

use mesh::Vec3;
use rayon::prelude::*;

use super::{Mechanics, State};
use crate::contact::ContactState;
use crate::error::MechanicsError;

impl Mechanics {
    /// div_K u (1) of each cell.
    pub fn divergence(&self, state: &State) -> Vec<f64> {
        let mut div = vec![0.0; self.mesh.cell_count()];
        // The lengths agree by construction of the state.
        let _ = self.system.divergence.mul_add(1.0, &state.unknowns, &mut div);
        div
    }

    /// Porosity change b (div u − div u at the initial state) (1) of each cell.
    pub fn porosity_change(&self, state: &State) -> Vec<f64> {
        let mut div = self.divergence(state);
        for (k, v) in div.iter_mut().enumerate() {
            *v = self.material(k).biot * (*v - state.initial_divergence[k]);
        }
        div
    }

    /// Aperture d_f (m) of each fracture face: d_c − ⟦u⟧_n, with hydraulic dilation + min(tan ψ |⟦u − u⁰⟧_τ|, D_m), and not less
    /// than the residual aperture; > 0 in a state of a time step.
    pub fn aperture(&self, state: &State) -> Vec<f64> {
        let jump = state.jump(&self.system.space);
        (self.faces_of(state).iter().enumerate())
            .map(|(i, face)| face.aperture(&self.local(jump, i), &self.local(&state.initial_jump, i)))
            .collect()
    }

    /// Which fracture faces are so closed that the residual aperture holds up theirs.
    pub fn is_residual(&self, state: &State) -> Vec<bool> {
        let jump = state.jump(&self.system.space);
        (self.faces_of(state).iter().enumerate())
            .map(|(i, face)| face.is_residual(&self.local(jump, i), &self.local(&state.initial_jump, i)))
            .collect()
    }

    /// |λ_τ|/bound of each fracture face, by the bound that held in the time step; 0 where open, 1 where slipping.
    pub fn slip_tendency(&self, state: &State) -> Vec<f64> {
        (self.faces_of(state).iter().enumerate())
            .map(|(i, face)| {
                let l = self.local(&state.multiplier, i);
                let (shear, bound) = (l[1].hypot(l[2]), face.bound(l[0]));
                // By the state: where the bound vanishes, both are round-off.
                match state.contact[i] {
                    ContactState::Open => 0.0,
                    ContactState::Slip => 1.0,
                    ContactState::Stick if shear == 0.0 => 0.0,
                    ContactState::Stick => shear / bound,
                }
            })
            .collect()
    }

    /// Shear modulus μ (Pa) on the plus side of each fracture face.
    pub fn fracture_rigidity(&self) -> Vec<f64> {
        let plus = |&face: &usize| self.material(self.mesh.face_cells(face).0).mu;
        self.mesh.network().faces.iter().map(plus).collect()
    }

    /// b²/K_dr of each cell (1/Pa): how the porosity of a free body answers to pressure.
    pub fn porosity_compliance(&self) -> Vec<f64> {
        let of = |k| self.material(k).biot.powi(2) / self.material(k).bulk_modulus;
        (0..self.mesh.cell_count()).map(of).collect()
    }

    /// Floor of the aperture compliance (m/Pa): L_f/E′, L_f the extent of the face's fracture.
    pub fn aperture_compliance_scale(&self) -> Vec<f64> {
        let network = self.mesh.network();
        let names = &self.mesh.data().fractures;
        let mut bounds = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); names.len()];
        for (&face, &fracture) in network.faces.iter().zip(&network.fracture) {
            for &v in self.mesh.face_vertices(face) {
                let (low, high) = &mut bounds[fracture];
                *low = low.min(self.mesh.vertices()[v]);
                *high = high.max(self.mesh.vertices()[v]);
            }
        }
        (network.faces.iter().zip(&network.fracture))
            .map(|(&face, &fracture)| {
                let (low, high) = bounds[fracture];
                let cell = self.mesh.face_cells(face).0;
                low.distance(high) / self.material(cell).plane_strain_modulus
            })
            .collect()
    }

    /// Stress σ(u) − b p_m I (Pa) of each cell as (xx, yy, zz, xy, yz, xz), for pressures p_m (Pa) of the cells; tension is
    /// positive, and 2D is plane strain.
    ///
    /// # Errors
    /// A pressure field of the wrong length.
    pub fn stress(&self, state: &State, matrix_pressure: &[f64]) -> Result<Vec<[f64; 6]>, MechanicsError> {
        let expected = self.mesh.cell_count();
        if matrix_pressure.len() != expected {
            return Err(MechanicsError::Length { field: "matrix pressure", found: matrix_pressure.len(), expected });
        }
        let gradients = self.displacement_gradient(state);
        Ok((gradients.iter().zip(matrix_pressure).enumerate())
            .map(|(k, (g, p))| {
                let m = self.material(k);
                let isotropic = m.lambda * (g[0][0] + g[1][1] + g[2][2]) - m.biot * p;
                let normal = |i: usize| 2.0 * m.mu * g[i][i] + isotropic;
                let shear = |i: usize, j: usize| m.mu * (g[i][j] + g[j][i]);
                [normal(0), normal(1), normal(2), shear(0, 1), shear(1, 2), shear(0, 2)]
            })
            .collect())
    }

    /// ∇^K u (1) of each cell, row i being the gradient of component i; zero in z in 2D.
    pub fn displacement_gradient(&self, state: &State) -> Vec<[Vec3; 3]> {
        self.gradients(&state.unknowns)
    }

    pub(super) fn gradients(&self, unknowns: &[f64]) -> Vec<[Vec3; 3]> {
        let d = self.mesh.dim();
        let space = &self.system.space;
        (0..self.mesh.cell_count())
            .into_par_iter()
            .map(|cell| {
                let operators = space.operators(&self.mesh, cell);
                let mut gradient = [Vec3::ZERO; 3];
                let values = self.function_values(unknowns, cell);
                let (vectors, normals) = values.split_at(d * operators.vector_count);
                let (of_vectors, of_normals) = operators.gradient.split_at(operators.vector_count);
                for (g, v) in of_vectors.iter().zip(vectors.chunks_exact(d)) {
                    for c in 0..d {
                        gradient[c] += v[c] * *g;
                    }
                }
                for ((g, n), w) in of_normals.iter().zip(&operators.direction).zip(normals) {
                    for c in 0..d {
                        gradient[c] += w * n[c] * *g;
                    }
                }
                gradient
            })
            .collect()
    }

    /// Mean displacement Π^K u(x_K) = Σ_s ω_s^K u_Ks (m) of each cell.
    pub fn cell_displacement(&self, state: &State) -> Vec<Vec3> {
        self.cell_means(&state.unknowns)
    }

    pub(super) fn cell_means(&self, unknowns: &[f64]) -> Vec<Vec3> {
        let d = self.mesh.dim();
        let weights = &self.mesh.geometry().cell_weight;
        (0..self.mesh.cell_count())
            .map(|cell| {
                let mut mean = [0.0; 3];
                let range = self.mesh.cell_vertex_lists().range(cell);
                for (&node, w) in self.mesh.nodes().of_cell(cell).iter().zip(&weights[range]) {
                    for c in 0..d {
                        mean[c] += w * unknowns[node * d + c];
                    }
                }
                Vec3::from_array(mean)
            })
            .collect()
    }

    /// The values of a cell's functions (m): d for each node and each vector bubble, then one for each normal bubble.
    fn function_values(&self, unknowns: &[f64], cell: usize) -> Vec<f64> {
        let space = &self.system.space;
        let of_cell = space.unknowns(&self.mesh, cell);
        let of = |&entity: &u32| unknowns[space.unknowns_of(entity as usize)].iter().copied();
        let own: Vec<f64> = of_cell.entities.iter().flat_map(of).collect();
        match &of_cell.bubbles {
            None => own,
            Some(p) => p.chunks_exact(own.len()).map(|row| row.iter().zip(&own).map(|(p, v)| p * v).sum()).collect(),
        }
    }
}
