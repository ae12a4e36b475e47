//! Units that cannot go back, made to: their time steps are done again from the start in a new instance.

use std::collections::BTreeMap;

use coupling::Work;
use serde::{Deserialize, Serialize};

use super::unit::FmuUnit;
use crate::unit::{Calls, StepOutcome, Unit, UnitError};

/// Inputs that were set, by name.
type Inputs = BTreeMap<String, Vec<f64>>;

/// A time step that was done, and what was set before it.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Step {
    time: f64,
    step: f64,
    inputs: Inputs,
}

/// What a state is where there is none: how the unit got there.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Past {
    steps: Vec<Step>,
    /// Set since the last time step.
    inputs: Inputs,
}

/// A unit that lacks rollback or serialisation. What it lacks is replaced by replaying: the cost of a run grows with the
/// square of the number of its time steps. The unit must repeat itself.
#[derive(Debug)]
pub struct Replay {
    unit: FmuUnit,
    past: Past,
    /// Number of time steps and inputs at the kept state.
    kept: Option<(usize, Inputs)>,
}

impl Replay {
    /// Of a unit that is initialised.
    pub fn new(unit: FmuUnit) -> Self {
        Self { unit, past: Past::default(), kept: None }
    }

    fn replay(&mut self) -> Result<(), UnitError> {
        self.unit.renew()?;
        for Step { time, step, inputs } in &self.past.steps {
            inputs.iter().try_for_each(|(variable, values)| self.unit.set(variable, values))?;
            if let StepOutcome::Discarded { reason } = self.unit.step(*time, *step)? {
                let message =
                    format!("it does not repeat itself: from t = {time} s it now discards {step} s: {reason}");
                return Err(UnitError::Refused { message });
            }
        }
        self.past.inputs.iter().try_for_each(|(variable, values)| self.unit.set(variable, values))
    }
}

impl Unit for Replay {
    fn name(&self) -> &str {
        self.unit.name()
    }

    fn has(&self, variable: &str) -> bool {
        self.unit.has(variable)
    }

    fn set(&mut self, variable: &str, values: &[f64]) -> Result<(), UnitError> {
        self.unit.set(variable, values)?;
        self.past.inputs.insert(variable.to_owned(), values.to_vec());
        Ok(())
    }

    fn get(&mut self, variable: &str, values: &mut Vec<f64>) -> Result<(), UnitError> {
        self.unit.get(variable, values)
    }

    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        let outcome = self.unit.step(time, step)?;
        if outcome == StepOutcome::Done {
            let inputs = std::mem::take(&mut self.past.inputs);
            self.past.steps.push(Step { time, step, inputs });
        }
        Ok(outcome)
    }

    fn can_roll_back(&self) -> bool {
        true
    }

    fn save(&mut self) -> Result<(), UnitError> {
        self.kept = Some((self.past.steps.len(), self.past.inputs.clone()));
        if self.unit.can_roll_back() { self.unit.save() } else { Ok(()) }
    }

    fn restore(&mut self) -> Result<(), UnitError> {
        let unsupported = UnitError::Unsupported { what: "going back where no state was kept" };
        let (steps, inputs) = self.kept.clone().ok_or(unsupported)?;
        self.past.steps.truncate(steps);
        self.past.inputs = inputs;
        if self.unit.can_roll_back() { self.unit.restore() } else { self.replay() }
    }

    fn can_serialise(&self) -> bool {
        true
    }

    fn serialise(&mut self) -> Result<Vec<u8>, UnitError> {
        postcard::to_stdvec(&self.past).map_err(|error| UnitError::Refused { message: error.to_string() })
    }

    fn deserialise(&mut self, bytes: &[u8]) -> Result<(), UnitError> {
        self.past = postcard::from_bytes(bytes).map_err(|error| UnitError::Refused { message: error.to_string() })?;
        self.replay()
    }

    fn newton_iterations(&mut self) -> Option<u64> {
        self.unit.newton_iterations()
    }

    fn calls(&self) -> Calls {
        self.unit.calls()
    }

    fn work(&mut self) -> Option<Work> {
        self.unit.work()
    }

    fn take_messages(&mut self) -> Vec<String> {
        self.unit.take_messages()
    }

    fn derivative(&mut self, outputs: &[&str], inputs: &[(&str, &[f64])]) -> Result<Option<Vec<Vec<f64>>>, UnitError> {
        self.unit.derivative(outputs, inputs)
    }
}
