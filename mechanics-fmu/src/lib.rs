//! Static contact mechanics of a fractured rock, in two and three dimensions.
//!
//! Continuous problem (method: Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024, arXiv 2312.09319): find the
//! displacement u, discontinuous across the fractures Γ, with
//!
//! ```text
//! −div σ_T = f,   σ_T = 2μ ε(u) + λ (div u) I − b p_m I
//! T± = σ_T± n± + p_f n±,  T⁺ + T⁻ = 0        on Γ, n⁺ outward from the plus side, ⟦u⟧ = u⁺ − u⁻
//! T_n ≤ 0, ⟦u⟧_n ≤ 0, T_n ⟦u⟧_n = 0          non-penetration
//! |T_τ| ≤ cohesion − F T_n, and slip only at the bound, along the traction on the minus side    Coulomb
//! ```
//!
//! - [`space`]: the bubble virtual element space and its local operators; it knows no model.
//! - [`model`]: materials, friction laws, boundary data.
//! - `system`: assembly and the one factorisation.
//! - [`contact`], `newton`: the contact laws, and the semi-smooth Newton method on the fracture.
//! - [`mechanics`]: states, steps, and what they give, a file for each concern.
//! - [`mod@unit`]: all this as an FMI 3.0 unit; the modules above know neither FMI nor files.
//!
//! Deviation from the literature: the jumps are unknowns in place of the plus side's bubbles, which is the same
//! discrete problem (see [`space`]).

pub mod contact;
pub mod elasticity;
pub mod error;
mod joint;
mod linearised;
pub mod mechanics;
pub mod model;
mod newton;
pub mod space;
mod system;
pub mod unit;

pub use contact::ContactState;
pub use elasticity::Elasticity;
pub use error::{MechanicsError, ModelProblem};
pub use mechanics::{
    Discard, Energy, Mechanics, Outcome, Partner, PartnerResponse, Response, Scalars, State, StepReport, StepTimes,
};
pub use model::{
    BoundaryPoint, Bubbles, DEFAULT_RESIDUAL, Dilation, Dirichlet, FractureLaw, Friction, Material, Model, Neumann,
    NewtonSettings, NormalBubbles, Place, Stabilisation, UndrainedFunction,
};
pub use newton::NewtonReport;
pub use space::Space;
pub use system::{SetupReport, Stage, Work};
