//! Linearised responses of a state.

use std::time::Instant;

use mesh::Vec3;

use super::{Mechanics, Partner, State, on_the_pool, singular};
use crate::error::MechanicsError;
use crate::newton::FractureData;

/// A change of the jump and of what follows from it, to first order.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Porosity (1): cells.
    pub porosity_change: Vec<f64>,
    /// Aperture (m): fracture faces.
    pub aperture: Vec<f64>,
    /// Jump (m) in the basis of each face: fracture faces × d.
    pub jump: Vec<f64>,
    /// All unknowns (m).
    unknowns: Vec<f64>,
    /// What the bulk exerts on the faces if the jumps stay (N): fracture faces × d.
    force: Vec<f64>,
}

impl Mechanics {
    /// How jump, aperture and porosity at a state answer to a change of the pressures (Pa; matrix: cells, fracture: fracture
    /// faces), at fixed contact states: the product of the Jacobian with this change, by one linearised solve. Where the
    /// partner's pressures followed the deformation in the step to this state, they follow here, and the changes are those of
    /// p_m* and p_f*.
    ///
    /// # Errors
    /// Arrays of the wrong length; no factorisation; a singular contact problem.
    pub fn response(
        &mut self,
        state: &State,
        matrix_pressure: &[f64],
        fracture_pressure: &[f64],
    ) -> Result<Response, MechanicsError> {
        let change = Partner {
            matrix_pressure: matrix_pressure.to_vec(),
            fracture_pressure: fracture_pressure.to_vec(),
            response: None,
        };
        self.check_state(state)?;
        self.check_partner(&change)?;
        self.check_factor()?;
        let mut full = vec![0.0; state.unknowns.len()];
        self.add_pressures(&change, state, &mut full)?;
        let b: Vec<f64> = self.system.free.iter().map(|&u| full[u as usize]).collect();
        let clock = Instant::now();
        self.system.cholesky.forward(&b, &mut self.buffers.forward, &mut self.buffers.scratch)?;
        let forward = clock.elapsed();
        let force = self.buffers.forward.condensed().to_vec();
        let jump = self.jump_response(state, &force)?;
        let both = clock.elapsed();
        let mut x = vec![0.0; b.len()];
        self.system.cholesky.backward(&self.buffers.forward, &jump, &mut x, &mut self.buffers.scratch)?;
        self.system.work.newton += both - forward;
        self.system.work.solving += forward + (clock.elapsed() - both);
        self.system.work.solves += 1;
        full.fill(0.0);
        for (&u, x) in self.system.free.iter().zip(x) {
            full[u as usize] = x;
        }
        let mut porosity_change = vec![0.0; self.mesh.cell_count()];
        self.system.divergence.mul_add(1.0, &full, &mut porosity_change)?;
        porosity_change.iter_mut().enumerate().for_each(|(k, p)| *p *= self.material(k).biot);
        let aperture = self.aperture_response(state, &jump);
        Ok(Response { porosity_change, aperture, jump, unknowns: full, force })
    }

    /// ∂d_f/∂p_f (m/Pa) of each face as a uniform change of fracture pressure shows it, at fixed contact states: a solve
    /// on the fracture only. Closed rigid faces give 0; negative values are possible.
    ///
    /// # Errors
    /// A state of another mesh; no factorisation; a singular contact problem.
    pub fn aperture_compliance(&self, state: &State) -> Result<Vec<f64>, MechanicsError> {
        self.check_state(state)?;
        self.check_factor()?;
        let d = self.mesh.dim();
        let mut change = vec![0.0; self.faces.len() * d];
        for (i, face) in self.faces.iter().enumerate() {
            change[i * d] = -face.measure;
        }
        let jump = self.jump_response(state, &change)?;
        Ok(self.aperture_response(state, &jump))
    }

    fn aperture_response(&self, state: &State, change: &[f64]) -> Vec<f64> {
        let jump = state.jump(&self.system.space);
        (self.faces_of(state).iter().enumerate())
            .map(|(i, face)| {
                let (jump, origin) = (self.local(jump, i), self.local(&state.initial_jump, i));
                let gradient = face.aperture_gradient(&jump, &origin, [0.0; 2]);
                gradient.iter().zip(self.local(change, i)).map(|(g, c)| g * c).sum()
            })
            .collect()
    }

    /// The multiplier λ (Pa), fracture faces × d, of a response at a state.
    pub fn multiplier_response(&self, state: &State, response: &Response) -> Vec<f64> {
        let d = self.mesh.dim();
        // |σ| (λ + c n) = r − S δ, with the part c = −S_f d_f of the fracture pressure that follows.
        let mut bulk: Vec<f64> = response.force.iter().map(|f| -f).collect();
        self.system.add_schur_product(&response.jump, &mut bulk);
        let mut lambda: Vec<f64> = bulk.iter().map(|f| -f).collect();
        for (i, face) in self.faces.iter().enumerate() {
            lambda[i * d..][..d].iter_mut().for_each(|l| *l /= face.measure);
            lambda[i * d] += state.history.partners[i].stiffness * response.aperture[i];
        }
        lambda
    }

    /// Mean displacement (m) of each cell, of a response.
    pub fn cell_displacement_response(&self, response: &Response) -> Vec<Vec3> {
        self.cell_means(&response.unknowns)
    }

    /// ∇^K u (1) of each cell, of a response; as [`displacement_gradient`](Self::displacement_gradient).
    pub fn displacement_gradient_response(&self, response: &Response) -> Vec<[Vec3; 3]> {
        self.gradients(&response.unknowns)
    }

    /// The change of the jump for a change of the condensed right-hand side.
    fn jump_response(&self, state: &State, change: &[f64]) -> Result<Vec<f64>, MechanicsError> {
        let faces = self.faces_of(state);
        let add_product = |x: &[f64], y: &mut [f64]| self.system.add_schur_product(x, y);
        let problem = self.fracture_problem(&faces, &add_product);
        let data = FractureData {
            rhs: change,
            largest_force: 0.0,
            previous: &state.history.previous_jump,
            origin: &state.initial_jump,
            partners: &state.history.partners,
            guess: None,
        };
        let jump = state.jump(&self.system.space);
        on_the_pool(|| problem.response(&data, jump, &state.multiplier, &state.contact, change)).map_err(singular)
    }
}
