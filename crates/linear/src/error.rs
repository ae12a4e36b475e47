/// What can go wrong in this crate.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An array has the wrong length.
    #[error("{what}: expected length {expected}, found {found}")]
    Dimension {
        /// The argument.
        what: &'static str,
        /// The length it must have.
        expected: usize,
        /// The length it has.
        found: usize,
    },
    /// An index is not below its bound.
    #[error("{what}: index {index} is not below {bound}")]
    OutOfRange {
        /// The argument.
        what: &'static str,
        /// The offending index.
        index: usize,
        /// The first index that does not exist.
        bound: usize,
    },
    /// An index occurs twice in a list that must not repeat one.
    #[error("{what}: index {index} occurs twice")]
    Repeated {
        /// The argument.
        what: &'static str,
        /// The offending index.
        index: usize,
    },
    /// Two blocks are added to a matrix whose pattern does not couple them.
    #[error("blocks {row} and {column} are not coupled by the pattern")]
    NotInPattern {
        /// The row block.
        row: usize,
        /// The column block.
        column: usize,
    },
    /// The matrix does not have the pattern that was analysed.
    #[error("the matrix does not have the pattern that was analysed")]
    PatternMismatch,
    /// The matrix has an infinite or undefined entry.
    #[error("entry ({row}, {column}) is not finite")]
    NonFinite {
        /// Its row.
        row: usize,
        /// Its column.
        column: usize,
    },
    /// A pivot is not positive: the matrix is singular or indefinite.
    #[error("not positive definite: non-positive pivot at unknown {unknown}")]
    NotPositiveDefinite {
        /// The unknown, in the caller's numbering, at which the elimination broke down.
        unknown: usize,
    },
    /// The factor does not solve a test system well enough, neither in parallel nor sequentially.
    #[error("inaccurate factor: scaled residual {residual:e} exceeds {tolerance:e}")]
    Inaccurate {
        /// ‖Ax − b‖ / (‖A‖ ‖x‖ + ‖b‖) in maximum norms.
        residual: f64,
        /// Its bound.
        tolerance: f64,
    },
    /// The last factorisation failed, so there is nothing to solve with.
    #[error("there is no valid factor, for the last factorisation failed")]
    NotFactorised,
    /// The problem exceeds 2³¹ − 1 unknowns, matrix entries, or factor entries.
    #[error("too large for 32-bit indices")]
    TooLarge,
    /// Memory could not be allocated.
    #[error("out of memory")]
    OutOfMemory,
    /// The nested dissection gave up.
    #[error("nested dissection failed: {0}")]
    Ordering(String),
}

impl From<faer::sparse::FaerError> for Error {
    fn from(error: faer::sparse::FaerError) -> Self {
        match error {
            faer::sparse::FaerError::IndexOverflow => Error::TooLarge,
            _ => Error::OutOfMemory,
        }
    }
}

/// `Ok` if `found` is `expected`.
pub(crate) fn check_len(what: &'static str, expected: usize, found: usize) -> Result<(), Error> {
    if expected == found {
        Ok(())
    } else {
        Err(Error::Dimension {
            what,
            expected,
            found,
        })
    }
}

/// `Ok` if `index < bound`.
pub(crate) fn check_index(what: &'static str, index: usize, bound: usize) -> Result<(), Error> {
    if index < bound {
        Ok(())
    } else {
        Err(Error::OutOfRange { what, index, bound })
    }
}

/// `value` as an index, which must be below 2³¹.
pub(crate) fn index(value: usize) -> Result<u32, Error> {
    i32::try_from(value)
        .map(|v| v as u32)
        .map_err(|_| Error::TooLarge)
}
