//! Why coupling stops.

use crate::record::Failure;
use crate::unit::{Unit, UnitError};

/// Why a run cannot start or go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CouplingError {
    /// A unit failed for good, or was used wrongly.
    #[error("{unit}: {error}")]
    Unit {
        /// Name of the unit.
        unit: String,
        /// What went wrong.
        error: UnitError,
    },
    /// The interface couples or connects more units than there are.
    #[error("the interface is between {expected} units, not {found}")]
    Units {
        /// How many it speaks of.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// Iterating needs units that roll back.
    #[error("{unit} cannot roll back: only loose coupling is possible with it")]
    RollBack {
        /// Name of the unit.
        unit: String,
    },
    /// One unit has a field that the other lacks.
    #[error("{unit} has no variable \"{field}\", but its partner has")]
    Field {
        /// Name of the unit that lacks it.
        unit: String,
        /// The field.
        field: String,
    },
    /// The units are on different meshes.
    #[error("the units are on different meshes: {} and {}", fingerprints[0], fingerprints[1])]
    Mesh {
        /// Fingerprint of each.
        fingerprints: [String; 2],
    },
    /// An output has changed its length.
    #[error("\"{field}\" has {found} entries, but had {expected}")]
    Length {
        /// Name of the field.
        field: String,
        /// Its length now.
        found: usize,
        /// Its length before.
        expected: usize,
    },
    /// No time step that is allowed could be done.
    #[error("{0}")]
    Failed(Box<Failure>),
    /// A checkpoint cannot be used.
    #[error("the checkpoint cannot be used: {reason}")]
    Checkpoint {
        /// Why.
        reason: &'static str,
    },
}

impl CouplingError {
    pub(crate) fn unit(unit: &dyn Unit, error: UnitError) -> Self {
        Self::Unit { unit: unit.name().to_owned(), error }
    }
}

impl From<Failure> for CouplingError {
    fn from(failure: Failure) -> Self {
        Self::Failed(Box::new(failure))
    }
}
