//! Scalars that sum up a state, and their derivatives.

use super::{Mechanics, Response, State};
use crate::contact::ContactState;

/// Scalars that sum up the fractures of a state, or their derivatives along a [`Response`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scalars {
    /// Mean aperture (m), weighted with the faces' measures.
    pub mean_aperture: f64,
    /// Smallest aperture (m).
    pub smallest_aperture: f64,
    /// Largest aperture (m).
    pub largest_aperture: f64,
    /// Largest slip |⟦u − u⁰⟧_τ| since the initial state (m).
    pub largest_slip: f64,
    /// Largest [`slip_tendency`](Mechanics::slip_tendency) (1).
    pub largest_slip_tendency: f64,
    /// Σ μ |σ| slip (N m; in 2D N, per metre of thickness), μ on the plus side.
    pub seismic_moment: f64,
}

impl Scalars {
    /// Moment magnitude 2/3 (log₁₀ M − 9.1) of the seismic moment M (N m), in 2D of one metre; −∞ without slip.
    pub fn moment_magnitude(&self) -> f64 {
        2.0 / 3.0 * (self.seismic_moment.log10() - 9.1)
    }

    /// The derivative of the moment magnitude, where these scalars are those of the state; 0 where nothing moves.
    pub fn moment_magnitude_response(&self, response: &Self) -> f64 {
        if response.seismic_moment == 0.0 {
            return 0.0;
        }
        2.0 / 3.0 * std::f64::consts::LOG10_E * response.seismic_moment / self.seismic_moment
    }
}

impl Mechanics {
    /// The scalars of a state; all 0 without fractures.
    pub fn scalars(&self, state: &State) -> Scalars {
        let apertures = self.aperture(state);
        let (slips, tendencies) = (self.slips(state), self.slip_tendency(state));
        let at = |values: &[f64], face: Option<usize>| face.map_or(0.0, |i| values[i]);
        Scalars {
            mean_aperture: self.mean(&apertures),
            smallest_aperture: at(&apertures, smallest(&apertures)),
            largest_aperture: at(&apertures, largest(&apertures)),
            largest_slip: at(&slips, largest(&slips)),
            largest_slip_tendency: at(&tendencies, largest(&tendencies)),
            seismic_moment: self.moment(&slips),
        }
    }

    /// The derivatives of the scalars of a state along a response at it. Where the smallest or largest is that of several faces,
    /// that of the first; where there is no slip yet, that in the direction in which it begins.
    pub fn scalars_response(&self, state: &State, response: &Response) -> Scalars {
        let apertures = self.aperture(state);
        let (slips, tendencies) = (self.slips(state), self.slip_tendency(state));
        let slip_changes = self.slip_response(state, response);
        let at = |values: &[f64], face: Option<usize>| face.map_or(0.0, |i| values[i]);
        Scalars {
            mean_aperture: self.mean(&response.aperture),
            smallest_aperture: at(&response.aperture, smallest(&apertures)),
            largest_aperture: at(&response.aperture, largest(&apertures)),
            largest_slip: at(&slip_changes, largest(&slips)),
            largest_slip_tendency: largest(&tendencies).map_or(0.0, |i| self.tendency_response(state, response, i)),
            seismic_moment: self.moment(&slip_changes),
        }
    }

    /// |⟦u − u⁰⟧_τ| (m) of each fracture face.
    fn slips(&self, state: &State) -> Vec<f64> {
        let jump = state.jump(&self.system.space);
        (0..self.faces.len())
            .map(|i| {
                let (jump, origin) = (self.local(jump, i), self.local(&state.initial_jump, i));
                (jump[1] - origin[1]).hypot(jump[2] - origin[2])
            })
            .collect()
    }

    fn slip_response(&self, state: &State, response: &Response) -> Vec<f64> {
        let jump = state.jump(&self.system.space);
        (0..self.faces.len())
            .map(|i| {
                let (jump, origin) = (self.local(jump, i), self.local(&state.initial_jump, i));
                let change = self.local(&response.jump, i);
                let slip = [jump[1] - origin[1], jump[2] - origin[2]];
                match slip[0].hypot(slip[1]) {
                    0.0 => change[1].hypot(change[2]),
                    length => (slip[0] * change[1] + slip[1] * change[2]) / length,
                }
            })
            .collect()
    }

    /// The derivative of a face's slip tendency.
    fn tendency_response(&self, state: &State, response: &Response, i: usize) -> f64 {
        let lambda = self.local(&state.multiplier, i);
        let shear = lambda[1].hypot(lambda[2]);
        if state.contact[i] != ContactState::Stick || shear == 0.0 {
            return 0.0;
        }
        let change = self.local(&self.multiplier_response(state, response), i);
        let face = &self.faces_of(state)[i];
        let (bound, slope) = (face.bound(lambda[0]), face.bound_slope(lambda[0]));
        let shear_change = (lambda[1] * change[1] + lambda[2] * change[2]) / shear;
        (shear_change - shear / bound * slope * change[0]) / bound
    }

    /// The mean of values on the fracture faces.
    fn mean(&self, values: &[f64]) -> f64 {
        let measures = self.faces.iter().map(|face| face.measure);
        let (sum, size) =
            measures.zip(values).fold((0.0, 0.0), |(sum, size), (measure, v)| (sum + v * measure, size + measure));
        if size > 0.0 { sum / size } else { 0.0 }
    }

    /// Σ μ |σ| slip.
    fn moment(&self, slips: &[f64]) -> f64 {
        let rigidity = self.fracture_rigidity();
        slips.iter().zip(&self.faces).zip(rigidity).map(|((slip, face), mu)| mu * face.measure * slip).sum()
    }
}

fn largest(values: &[f64]) -> Option<usize> {
    (0..values.len()).reduce(|best, i| if values[i] > values[best] { i } else { best })
}

fn smallest(values: &[f64]) -> Option<usize> {
    (0..values.len()).reduce(|best, i| if values[i] < values[best] { i } else { best })
}
