//! What the coupling needs of a unit: the part of FMI 3.0 co-simulation that it uses.

use std::fmt;
use std::time::Instant;

use coupling::Work;
use serde::{Deserialize, Serialize};

/// How a time step of a unit ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StepOutcome {
    /// It is done; the unit is at the end of the time step.
    Done,
    /// It could not be done, as where Newton's method failed; the state is as before. A smaller one may do.
    Discarded {
        /// What the unit says.
        reason: String,
    },
}

/// Why a call failed for good.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UnitError {
    /// There is no such variable.
    #[error("there is no variable \"{variable}\"")]
    UnknownVariable {
        /// Its name.
        variable: String,
    },
    /// An array has a wrong length.
    #[error("\"{variable}\" has {expected} entries, not {found}")]
    Length {
        /// Name of the variable.
        variable: String,
        /// What was given.
        found: usize,
        /// What is right.
        expected: usize,
    },
    /// The unit cannot do this.
    #[error("it does not support this: {what}")]
    Unsupported {
        /// What was asked for.
        what: &'static str,
    },
    /// The unit refused.
    #[error("{message}")]
    Refused {
        /// What it says.
        message: String,
    },
}

/// How often something was done, and the wall seconds of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// How often.
    pub count: u64,
    /// Seconds.
    pub seconds: f64,
}

impl Tally {
    /// Does it, and counts it.
    pub fn time<T>(&mut self, act: impl FnOnce() -> T) -> T {
        let clock = Instant::now();
        let result = act();
        self.count += 1;
        self.seconds += clock.elapsed().as_secs_f64();
        result
    }
}

/// Calls of a unit since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calls {
    /// Instantiation and initialisation.
    pub start: Tally,
    /// Seconds of computing in these, as the unit tells.
    pub start_computing: f64,
    /// Values given.
    pub set: Tally,
    /// Values asked for.
    pub get: Tally,
    /// Time steps.
    pub step: Tally,
    /// Directional derivatives.
    pub derivative: Tally,
    /// States kept, restored, and as bytes.
    pub state: Tally,
}

impl Calls {
    /// Those and others.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        let sum = |a: Tally, b: Tally| Tally { count: a.count + b.count, seconds: a.seconds + b.seconds };
        Self {
            start: sum(self.start, other.start),
            start_computing: self.start_computing + other.start_computing,
            set: sum(self.set, other.set),
            get: sum(self.get, other.get),
            step: sum(self.step, other.step),
            derivative: sum(self.derivative, other.derivative),
            state: sum(self.state, other.state),
        }
    }

    /// Seconds of all calls.
    pub fn seconds(&self) -> f64 {
        [self.start, self.set, self.get, self.step, self.derivative, self.state].iter().map(|t| t.seconds).sum()
    }
}

/// A unit in co-simulation. Variables are arrays, scalars have one entry.
pub trait Unit {
    /// What to call it in messages.
    fn name(&self) -> &str;

    /// Whether there is a variable of this name.
    fn has(&self, variable: &str) -> bool;

    /// Sets an input or a parameter.
    ///
    /// # Errors
    /// [`UnitError`].
    fn set(&mut self, variable: &str, values: &[f64]) -> Result<(), UnitError>;

    /// Gets a variable; `values` takes its length.
    ///
    /// # Errors
    /// [`UnitError`].
    fn get(&mut self, variable: &str, values: &mut Vec<f64>) -> Result<(), UnitError>;

    /// Goes from `time` to `time + step` (s).
    ///
    /// # Errors
    /// [`UnitError`], where the unit cannot be used any more.
    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError>;

    /// Whether [`save`](Self::save) and [`restore`](Self::restore) work.
    fn can_roll_back(&self) -> bool;

    /// Keeps the present state, inputs included, in place of one kept before.
    ///
    /// # Errors
    /// [`UnitError`].
    fn save(&mut self) -> Result<(), UnitError>;

    /// Goes back to the kept state, as often as wanted.
    ///
    /// # Errors
    /// [`UnitError`].
    fn restore(&mut self) -> Result<(), UnitError>;

    /// Whether [`serialise`](Self::serialise) and [`deserialise`](Self::deserialise) work.
    fn can_serialise(&self) -> bool {
        true
    }

    /// The present state as bytes.
    ///
    /// # Errors
    /// [`UnitError`].
    fn serialise(&mut self) -> Result<Vec<u8>, UnitError>;

    /// Takes a state from bytes.
    ///
    /// # Errors
    /// [`UnitError`].
    fn deserialise(&mut self, bytes: &[u8]) -> Result<(), UnitError>;

    /// Newton iterations of the last time step, where it tells.
    fn newton_iterations(&mut self) -> Option<u64> {
        None
    }

    /// The calls it has had, where they are counted.
    fn calls(&self) -> Calls {
        Calls::default()
    }

    /// What it tells of its computing, where it does.
    fn work(&mut self) -> Option<Work> {
        None
    }

    /// What it has said since the last call, where calls succeeded.
    fn take_messages(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// How each of `outputs` at the last time step answers to a change of inputs by the arrays given with their names:
    /// Σ ∂(output)/∂(input) · change; `None` where the unit has no derivatives.
    ///
    /// # Errors
    /// [`UnitError`].
    fn derivative(
        &mut self,
        _outputs: &[&str],
        _inputs: &[(&str, &[f64])],
    ) -> Result<Option<Vec<Vec<f64>>>, UnitError> {
        Ok(None)
    }
}

impl fmt::Debug for dyn Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Unit({})", self.name())
    }
}
