//! What is reported of a solved time step.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

/// The state of the flow: all that the next time step depends on. Cheap to clone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// t (s).
    pub time: f64,
    /// p_K (Pa), cells.
    pub matrix_pressure: Vec<f64>,
    /// All other pressures (Pa), in the order of [`Space`](crate::Space).
    pub traces: Vec<f64>,
    /// Porosity change by deformation that the flow has accounted for, cells: φ* + C (p − p*).
    pub porosity_change: Vec<f64>,
    /// d_f (m) that the flow has accounted for, fracture faces: d* + C_f (p_f − p_f*).
    pub aperture: Vec<f64>,
    /// Whether each well is held at its limit.
    pub limited: Vec<bool>,
}

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

/// How well volume is conserved (m³/s, 2D: m²/s), with one flux for both sides of each facet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Balance {
    /// Largest error of a cell.
    pub cell: f64,
    /// Largest error of a fracture face.
    pub fracture_face: f64,
    /// Largest sum of outflows into a fracture edge.
    pub edge: f64,
    /// Storage − sources − wells − inflow of the whole.
    pub total: f64,
    /// Largest volume rate through a cell or fracture face.
    pub throughput: f64,
    /// What one unit of round-off in a pressure can make of a balance: the errors are some of these. It is far below
    /// the throughput unless pressures are large and differ little.
    pub round_off: f64,
}

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

/// Work done since the flow was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Work {
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
    pub work: Work,
}

/// Volume rates of the last time step, m³/s (2D: m²/s).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fluxes {
    /// Each mesh face, out of its first cell; on a fracture face out of the plus cell into the fracture.
    pub face: Vec<f64>,
    /// Each fracture face, from plus and from minus cell into it.
    pub exchange: Vec<[f64; 2]>,
    /// Out of each fracture face through its edges, aligned with the network's lists of edges of faces.
    pub fracture_edge: Vec<f64>,
    /// (1/|K|) ∫ V over each cell (m/s), for plots: Σ_i F_Ki (x_i − x_K)/|K|, exact for a uniform flux.
    pub cell_velocity: Vec<mesh::Vec3>,
    /// The same over each fracture face, times its aperture (m²/s).
    pub fracture_velocity: Vec<mesh::Vec3>,
}
