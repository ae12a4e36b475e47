//! A coupled time step as one system of equations, to hold the iterations between the units against.
//!
//! With M(p) the porosity change and the aperture at the mechanical equilibrium under pressures p, and P the pressures that
//! flow finds for them, P(M(p)) − p = 0 is solved by a semi-smooth Newton method. Its matrix, P′M′ − I, is dense and made
//! column by column from both libraries' linearised responses: for a few hundred unknowns.

use faer::linalg::solvers::Solve;
use flow_fmu::{Inputs, Perturbation};
use mechanics_fmu::{Outcome, Partner};

use crate::six_fractures::Coupled;

/// Does a time step of `dt` (s); gives the number of Newton iterations.
///
/// # Panics
/// If a library fails, or Newton's method does not converge.
pub fn step(coupled: &mut Coupled, dt: f64) -> usize {
    /// Part of the largest pressure.
    const TOLERANCE: f64 = 1e-10;
    const MAX_ITERATIONS: usize = 40;
    let Coupled { mechanics, flow, state } = coupled;
    let (start, start_flow) = (state.clone(), flow.state().clone());
    let cells = start_flow.matrix_pressure.len();
    let mut p: Vec<f64> = start_flow.matrix_pressure.iter().chain(flow.fracture_pressure()).copied().collect();
    for iteration in 1..=MAX_ITERATIONS {
        let (matrix, fracture) = p.split_at(cells);
        let partner =
            Partner { matrix_pressure: matrix.to_vec(), fracture_pressure: fracture.to_vec(), response: None };
        let outcome = mechanics.step(&start, start.time + dt, &partner).unwrap_or_else(|e| panic!("{e}"));
        let Outcome::Converged(at, _) = outcome else { panic!("mechanics does not converge") };
        flow.set_state(start_flow.clone()).unwrap_or_else(|e| panic!("{e}"));
        let (porosity_change, aperture) = (mechanics.porosity_change(&at), mechanics.aperture(&at));
        let inputs = Inputs { porosity_change, aperture, ..flow.inputs() };
        flow.step(dt, &inputs).unwrap_or_else(|e| panic!("{e}"));
        let image: Vec<f64> = flow.state().matrix_pressure.iter().chain(flow.fracture_pressure()).copied().collect();
        let mut jacobian = faer::Mat::<f64>::zeros(p.len(), p.len());
        for column in 0..p.len() {
            let mut unit = vec![0.0; p.len()];
            unit[column] = 1.0;
            let change = mechanics.response(&at, &unit[..cells], &unit[cells..]).unwrap_or_else(|e| panic!("{e}"));
            let direction = Perturbation {
                porosity_change: change.porosity_change,
                aperture: change.aperture,
                matrix_pressure_reference: vec![0.0; cells],
                fracture_pressure_reference: vec![0.0; p.len() - cells],
            };
            let response = flow.linearised_response(&direction).unwrap_or_else(|e| panic!("{e}"));
            for (row, value) in response.matrix_pressure.iter().chain(&response.fracture_pressure).enumerate() {
                jacobian[(row, column)] = *value - unit[row];
            }
        }
        let residual = faer::Mat::from_fn(p.len(), 1, |i, _| p[i] - image[i]);
        let update = jacobian.partial_piv_lu().solve(&residual);
        let change = (0..p.len()).fold(0.0f64, |m, i| m.max(update[(i, 0)].abs()));
        let size = p.iter().fold(0.0f64, |m, p| m.max(p.abs()));
        if change <= TOLERANCE * size {
            *state = at;
            return iteration;
        }
        p.iter_mut().enumerate().for_each(|(i, p)| *p += update[(i, 0)]);
    }
    panic!("{MAX_ITERATIONS} Newton iterations did not do")
}
