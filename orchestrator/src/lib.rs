//! Couples two units that know nothing of each other, through what FMI offers.
//!
//! Words are those of preCICE and of the coupling literature: in a *time step* both units are run again and again from
//! the same state, the *coupling iterations*, until what they exchange repeats itself.
//!
//! ```text
//! for each time step [t, t + δt]:
//!     save both states; guess the fields at t + δt
//!     repeat: restore both; the first unit steps with the guess; pass on; the second unit steps
//!             residual = new fields − guess; converged, diverged, or accelerate the guess
//!     converged: accept; else: restore, halve δt, try again; too small: stop with a report
//! ```
//!
//! These are independent of one another and of the pair of units:
//! - the split, an order and a choice of sensitivities ([`Scheme`]): Kim, Tchelepi, Juanes, CMAME 200, 2011;
//! - the criterion of each field of the [`Interface`];
//! - the acceleration ([`model::Acceleration`]) and the extrapolation in time;
//! - the time steps.
//!
//! [`fmi`] makes units of FMUs. [`Run`] is the loop, [`StepRecord`] what it did, [`Failure`] why it stopped, [`Checkpoint`] how it goes on.

mod acceleration;
mod checkpoint;
pub mod comparison;
mod cost;
mod energy;
mod error;
pub mod fmi;
mod interface;
mod record;
pub mod results;
mod run;
pub mod ssp;
mod time;
mod unit;

pub use checkpoint::Checkpoint;
pub use cost::Cost;
pub use energy::EnergyEstimate;
pub use error::CouplingError;
pub use interface::{Connection, FLOW, Field, Interface, MECHANICS, Scheme, Sensitivity};
pub use record::{Attempt, AttemptOutcome, FailedField, Failure, FieldResidual, IterationRecord, StepRecord, counted};
pub use run::{Fields, Run, Settings};
pub use unit::{Calls, StepOutcome, Tally, Unit, UnitError};
