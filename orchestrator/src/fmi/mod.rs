//! Importer of FMI 3.0 co-simulation units: the other side of [`Unit`](crate::Unit) is a C library.
//!
//! - [`Description`]: what `modelDescription.xml` says.
//! - `library`: the C functions that are used; the only unsafe code.
//! - [`Fmu`]: an unpacked unit; [`FmuUnit`]: an instance of it.
//!
//! It is our own because it is small: about 20 of the 75 functions. (fmi-rs 0.3.4 asks for all of them.)

mod description;
mod library;
mod unit;

pub use description::{Causality, Description, Variable, VariableType};
pub use unit::{Fmu, FmuUnit};

use std::path::PathBuf;

/// Why an FMU cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct FmuError {
    /// The FMU.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}
