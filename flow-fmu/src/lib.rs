//! Darcy flow in a rock and its fractures by hybrid finite volumes, in two and three dimensions.
//!
//! ```text
//! ∂t φ + div V_m = h_m,                  V_m = −(K_m/η) (∇p_m − ρ g)
//! ∂t d_f + div_τ V_f − ⟦V_m⟧_n = h_f,    V_f = −(d_f³/12η) (∇_τ p_f − ρ g_τ)
//! V_m±·n± = T_f (p_m± − p_f),            T_f = 2 K_n/(η d_f)
//! ```
//!
//! with pressures that jump at the fractures (Brenner, Hennicker, Masson, Samier, IMA J. Numer. Anal. 2016). [`Space`]
//! owns the unknowns and their geometry, [`Flow`] the scheme: implicit Euler with C_f and T_f of the last time level,
//! so that a time step is one linear, symmetric positive definite system.
//!
//! There is no maximum principle: on strongly distorted cells, as Kershaw's, a pressure may fall below all data, as after a well is
//! shut in. Balances hold all the same; rounder cells help.
//!
//! [`mod@unit`] is all this as an FMI 3.0 unit; the other modules know neither FMI nor files.
//!
//! Mechanics is not known here. What deforms the rock enters as the affine functions of [`Inputs`].
//!
//! A column that drains to its right end:
//!
//! ```
//! use std::sync::Arc;
//! use flow_fmu::{Boundary, Flow, FlowModel, Fluid, Rock};
//! use mesh::{Mesh, Vec3, generate::cartesian};
//!
//! let mesh = Arc::new(Mesh::new(cartesian(Vec3::ZERO, Vec3::new(10.0, 1.0, 0.0), [20, 1, 0]))?);
//! let mut model = FlowModel::new(Fluid::default());
//! model.rocks.push(("rock".into(), Rock::isotropic(1e-15, 0.2, Some(1e10))));
//! model.boundaries.push(("right".into(), Boundary::pressure(0.0)));
//! model.initial_pressure = 1e6.into();
//! let mut flow = Flow::new(mesh, model)?;
//! let inputs = flow.inputs();
//! let report = flow.step(1e4, &inputs)?;
//! assert!(report.stored.matrix < 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod flow;
mod local;
mod model;
mod report;
mod scheme;
mod space;
pub mod unit;
mod wells;

pub use error::{FlowError, Problem};
pub use flow::{Balance, Energy, Flow, FlowState, Fluxes, Inputs, Linearisation, Perturbation, PressureResponse};
pub use local::Tensor;
pub use model::{
    Boundary, Condition, Control, FlowModel, Fluid, Fracture, Rock, SpaceTimeFunction, StiffnessCap, Well, WellIndex,
    WellPlace,
};
pub use report::{FlowWork, Inflow, StepReport, WellReport};
pub use space::Space;
pub use wells::Spot;
