#![doc = include_str!("../README.md")]

mod description;
mod error;
#[doc(hidden)]
pub mod ffi;
mod functions;
mod instance;
mod modes;
mod pack;
mod state;
mod token;
mod unit;
mod variables;
mod xml;

pub use description::{Capabilities, DefaultExperiment, Description, Enumeration, Terminal, UnitDefinition};
pub use error::{Error, UnitError};
pub use modes::Mode;
pub use pack::{Contents, pack};
pub use state::StateError;
pub use token::token;
pub use unit::{Environment, Experiment, Log, StepOutcome, Unit, Value, Values, ValuesMut};
pub use variables::{Causality, Initial, Problem, Reference, Start, TIME, Type, Variability, Variable};
pub use xml::{model_description, terminals_and_icons};
