//! What happened, as data.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How far a field was from convergence in a coupling iteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldResidual {
    /// Norm of the residual, in the unit of the field.
    pub norm: f64,
    /// What it must not exceed: tolerance × max(floor, range of what is left).
    pub limit: f64,
    /// Entry with the largest residual; `None` for a field without entries.
    pub worst: Option<usize>,
}

impl FieldResidual {
    /// Whether the criterion holds; not where the norm is not a number.
    pub fn holds(&self) -> bool {
        self.norm <= self.limit
    }

    /// norm/limit.
    pub fn ratio(&self) -> f64 {
        if self.norm == 0.0 { 0.0 } else { self.norm / self.limit }
    }
}

/// A coupling iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IterationRecord {
    /// For each field of the interface.
    pub residuals: Vec<FieldResidual>,
    /// Wall seconds in each unit: inputs, step, outputs. A unit that follows the coupled ones has its time step in the
    /// last iteration.
    pub seconds: Vec<f64>,
    /// Newton iterations of each unit, where it tells.
    pub newton: Vec<Option<u64>>,
    /// Directional derivatives taken of each coupled unit after it, for the next iterate.
    pub derivatives: usize,
}

impl IterationRecord {
    /// Largest norm/limit of all fields.
    pub fn ratio(&self) -> f64 {
        // NaN must not be lost.
        self.residuals.iter().map(FieldResidual::ratio).fold(0.0, |a, b| if a >= b { a } else { b })
    }
}

/// How an attempt at a time step ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum AttemptOutcome {
    /// All criteria hold; in loose mode, the pass is done.
    Converged,
    /// The limit of iterations was reached.
    NotConverged,
    /// The residual grew out of bounds.
    Diverged,
    /// A field is not finite.
    NotFinite,
    /// A unit discarded its time step.
    Discarded {
        /// Name of the unit.
        unit: String,
        /// What it says.
        reason: String,
    },
    /// Not all criteria hold, but what is left is round-off of the units: as good as it gets.
    RoundOff,
}

impl AttemptOutcome {
    /// Whether the time step is done.
    pub fn is_accepted(&self) -> bool {
        matches!(self, Self::Converged | Self::RoundOff)
    }
}

impl fmt::Display for AttemptOutcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Converged => f.write_str("converged"),
            Self::NotConverged => f.write_str("the coupling did not converge"),
            Self::Diverged => f.write_str("the coupling diverged"),
            Self::NotFinite => f.write_str("a field is not finite"),
            Self::Discarded { unit, reason } => write!(f, "{unit} discarded its time step: {reason}"),
            Self::RoundOff => f.write_str("as good as it gets: what is left is round-off"),
        }
    }
}

/// An attempt at a time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Attempt {
    /// Time step (s).
    pub step: f64,
    /// Its complete coupling iterations.
    pub iterations: Vec<IterationRecord>,
    /// How it ended.
    pub outcome: AttemptOutcome,
}

/// An accepted time step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Number of the time step, from 1.
    pub number: usize,
    /// Time (s) at its end.
    pub time: f64,
    /// All attempts; the last is the one that was accepted.
    pub attempts: Vec<Attempt>,
}

impl StepRecord {
    /// Coupling iterations of the accepted attempt.
    pub fn iterations(&self) -> &[IterationRecord] {
        self.attempts.last().map_or(&[], |a| &a.iterations)
    }
}

/// A field that had not converged when a time step was given up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedField {
    /// Its name.
    pub name: String,
    /// Its unit of measure.
    pub unit: String,
    /// The last residual.
    pub residual: FieldResidual,
    /// The entries with the largest residuals, and these; the largest first.
    pub entries: Vec<(usize, f64)>,
}

/// Why the run stopped: no time step that is allowed could be done. The units are back at `time`, if they can.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// Time (s) up to which the run got.
    pub time: f64,
    /// Smallest time step (s) allowed; `None` where the units cannot roll back, so that none could be tried again.
    pub minimum: Option<f64>,
    /// All attempts at the last time step.
    pub attempts: Vec<Attempt>,
    /// What had not converged in the last coupling iteration of the last attempt.
    pub fields: Vec<FailedField>,
}

/// How many of the first and of the last residuals a report spells out.
const SHOWN: usize = 5;

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "no time step could be done at t = {} s", self.time)?;
        match self.minimum {
            Some(minimum) => write!(f, " (smallest allowed: {minimum} s):")?,
            None => write!(f, " (a unit cannot roll back, so that no smaller one could be tried):")?,
        }
        for attempt in &self.attempts {
            write!(f, "\n  {} s: {}", attempt.step, attempt.outcome)?;
            if !attempt.iterations.is_empty() {
                write!(f, "; residual/limit of the coupling iterations:")?;
                let n = attempt.iterations.len();
                for (i, iteration) in attempt.iterations.iter().enumerate() {
                    if i < SHOWN || i + SHOWN >= n {
                        write!(f, " {:.1e}", iteration.ratio())?;
                    } else if i == SHOWN {
                        f.write_str(" …")?;
                    }
                }
                let last = attempt.iterations.last().map(IterationRecord::ratio);
                if attempt.outcome == AttemptOutcome::NotConverged && last.is_some_and(|ratio| ratio <= 1.0) {
                    f.write_str(" (but they shrink so slowly that the errors are above their limits)")?;
                }
            }
        }
        for field in &self.fields {
            let (norm, limit) = (field.residual.norm, field.residual.limit);
            let unit = if field.unit == "1" { String::new() } else { format!(" {}", field.unit) };
            write!(f, "\n  {}: residual {norm:.3e}{unit}, allowed {limit:.3e}{unit}; largest at", field.name)?;
            field.entries.iter().try_for_each(|(entry, value)| write!(f, " {entry} ({value:.3e})"))?;
        }
        Ok(())
    }
}

/// A word in the number that goes with a count.
pub(crate) fn plural(n: usize, word: &str) -> String {
    format!("{word}{}", if n == 1 { "" } else { "s" })
}

/// So many of them.
pub fn counted(n: usize, word: &str) -> String {
    format!("{n} {}", plural(n, word))
}
