//! The energy balance of a time step.

use super::{Mechanics, State};
use crate::error::MechanicsError;

/// Terms of the energy balance of a step (J, per metre of thickness in 2D).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Elastic energy at the end of the step: ½ a(u,u), stabilisation included, and ∫₀^V λ_n dV of the fractures.
    pub elastic: f64,
    /// Work of tractions, body forces and prescribed displacements during the step, forces at their end values.
    pub external_work: f64,
    /// Work of the pressures during the step, pressures at their end values.
    pub pressure_work: f64,
    /// Dissipation on the fractures during the step: friction ∫ λ_τ·δ⟦u⟧_τ, less the work ∫ λ_n δD of mechanical dilation against
    /// compression; ≥ 0 up to the solver's tolerance (equation (7) of [`crate::contact`]).
    pub friction: f64,
}

impl Mechanics {
    /// The terms of the energy balance of a step. `loads` are the forces without, `rhs` with the pressures' given part.
    pub(super) fn energy(
        &self,
        previous: &State,
        state: &State,
        loads: &[f64],
        rhs: &[f64],
    ) -> Result<Energy, MechanicsError> {
        let d = self.mesh.dim();
        // The pressures' actual forces: those given, less what follows the deformation.
        let mut pressure: Vec<f64> = rhs.iter().zip(loads).map(|(r, l)| r - l).collect();
        let stiffness = self.matrix_stiffness();
        if !stiffness.is_empty() {
            let div = self.divergence(state);
            let weighted: Vec<f64> = (0..div.len())
                .map(|k| {
                    let biot = self.material(k).biot;
                    self.mesh.geometry().cell_measure[k] * biot * biot * stiffness[k] * div[k]
                })
                .collect();
            self.system.divergence.mul_transpose_add(-1.0, &weighted, &mut pressure)?;
        }
        for (i, aperture) in self.aperture(state).iter().enumerate() {
            let follows = state.history.partners[i].stiffness * aperture;
            pressure[self.normal_jump(i)] += self.faces[i].measure * follows;
        }
        // Where an unknown is free, A ũ = f − |σ| λ: no product with A is needed.
        let mut forces: Vec<f64> = loads.iter().zip(&pressure).map(|(l, p)| l + p).collect();
        let mut reactions = vec![0.0; self.system.fixed.len()];
        self.system.fixed_rows.mul_add(1.0, &state.unknowns, &mut reactions)?;
        let mut external = loads.to_vec();
        for (f, reaction) in self.system.fixed.iter().zip(reactions) {
            // The rows of A hold the stiffness that makes pressures follow; `rhs` has what balances it.
            let force = reaction - rhs[f.unknown];
            forces[f.unknown] += force;
            external[f.unknown] += force;
        }
        let first = self.system.space.first_jump_unknown();
        let (mut friction, mut joints) = (0.0, 0.0);
        let (now, before) = (state.jump(&self.system.space), previous.jump(&self.system.space));
        for (i, face) in self.faces_of(state).iter().enumerate() {
            for c in 0..d {
                let at = i * d + c;
                let force = face.measure * state.multiplier[at];
                forces[first + at] -= force;
                if c > 0 {
                    friction += force * (now[at] - before[at]);
                }
            }
            let lambda_n = state.multiplier[i * d];
            joints += face.measure * face.closure.energy(lambda_n);
            if face.opening.is_mechanical() {
                let opening = |jump| face.mechanical_opening(&self.local(jump, i), &self.local(&state.initial_jump, i));
                friction -= face.measure * lambda_n * (opening(now) - opening(before));
            }
        }
        let change = |f: &[f64]| -> f64 {
            (f.iter().zip(&state.unknowns).zip(&previous.unknowns)).map(|((f, u), v)| f * (u - v)).sum()
        };
        Ok(Energy {
            elastic: 0.5 * forces.iter().zip(&state.unknowns).map(|(f, u)| f * u).sum::<f64>() + joints,
            external_work: change(&external),
            pressure_work: change(&pressure),
            friction,
        })
    }
}
