//! What is reported of a solved time step.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::flow::{Balance, Energy};

/// Volume rates in m³/s (2D: m²/s) through what a boundary tag names, positive into the domain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inflow {
    /// Into the matrix.
    pub matrix: f64,
    /// Into fractures, through their edges on the boundary.
    pub fracture: f64,
}

/// What a well does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WellReport {
    /// Injected, m³/s (2D: m²/s).
    pub rate: f64,
    /// In the well (Pa).
    pub pressure: f64,
    /// Whether it is held at its limit.
    pub limited: bool,
}

/// Work done since the flow was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FlowWork {
    /// Symbolic analyses.
    pub analyses: usize,
    /// Factorisations.
    pub factorisations: usize,
    /// Solves with a factor.
    pub solves: usize,
    /// Wall time of orders and symbolic analyses.
    pub analysis: Duration,
    /// Of assembly.
    pub assembly: Duration,
    /// Of factorisations, their checks included.
    pub factorisation: Duration,
    /// Of solves.
    pub solving: Duration,
}

/// Adds the wall time of what is done.
pub(crate) fn timed<T>(sum: &mut Duration, act: impl FnOnce() -> T) -> T {
    let clock = Instant::now();
    let result = act();
    *sum += clock.elapsed();
    result
}

/// A solved time step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepReport {
    /// Time at its end (s).
    pub time: f64,
    /// Conservation.
    pub balance: Balance,
    /// Inflow by boundary tag, in the order of the mesh's tags.
    pub inflow: Vec<Inflow>,
    /// What the wells do, in the order of the model.
    pub wells: Vec<WellReport>,
    /// Energy.
    pub energy: Energy,
    /// Volume of fluid taken up by the matrix and by the fractures in the time step (m³, 2D: m²; 0 in a steady state).
    pub stored: Inflow,
    /// Work since the flow was made.
    pub work: FlowWork,
}
