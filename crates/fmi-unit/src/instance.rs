//! One instance: every function of the C interface on safe types.
//!
//! Here are the checks of mode, reference, type, length and settability, the saved states, and the guard
//! that stops panics of the unit. Nothing here knows a raw pointer.

use std::any::Any;
use std::collections::HashMap;
use std::ffi::CString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::description::Description;
use crate::error::{Error, UnitError};
use crate::modes::{Function, Mode, Next, is_settable};
use crate::state::{Header, decode, encode};
use crate::token::token;
use crate::unit::{Environment, Experiment, Message, StepOutcome, Unit, Value, Values, ValuesMut};
use crate::variables::{Reference, TIME, Table, Type, Variable};

/// By how much, relative to the time itself, a host's time may differ from the unit's: hosts add up
/// step sizes, and the commonest ones compare with a relative 1e-9.
const TIME_TOLERANCE: f64 = 1e-8;

/// Names shown in a message about several variables.
const NAMES_SHOWN: usize = 4;

/// What the host is told when a call returns.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) severity: Severity,
    pub(crate) messages: Vec<LogEntry>,
}

/// `fmi3Status` without `fmi3Fatal`, which would condemn the other instances too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Severity {
    Ok,
    Warning,
    Discard,
    Error,
}

/// A message that passed the filter of categories.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LogEntry {
    pub(crate) severity: Severity,
    pub(crate) category: String,
    pub(crate) text: String,
}

/// What a function comes to when it is no error.
pub(crate) enum Reply {
    Done,
    Discard(String),
}

impl From<()> for Reply {
    fn from((): ()) -> Self {
        Reply::Done
    }
}

/// Number of a saved state; the host holds it as an opaque pointer.
pub(crate) type StateKey = usize;

/// Keys are never used twice in a process, so that a stale or foreign one is noticed.
static NEXT_STATE: AtomicUsize = AtomicUsize::new(1);

struct SavedState {
    header: Header,
    unit: Box<dyn Any + Send>,
    /// Kept from the question for the size to the copy.
    bytes: Option<Vec<u8>>,
}

/// [`Unit`] without its associated type.
pub(crate) trait AnyUnit: Send {
    fn description(&self) -> Description;
    fn get(&mut self, variable: Reference, values: ValuesMut<'_>) -> Result<(), UnitError>;
    fn set(&mut self, variable: Reference, values: Values<'_>) -> Result<(), UnitError>;
    fn initialize(&mut self, experiment: &Experiment) -> Result<(), UnitError>;
    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError>;
    fn terminate(&mut self) -> Result<(), UnitError>;
    fn save(&mut self) -> Result<Box<dyn Any + Send>, UnitError>;
    fn restore(&mut self, state: &dyn Any) -> Result<(), UnitError>;
    fn serialize(&self, state: &dyn Any) -> Result<Vec<u8>, UnitError>;
    fn deserialize(&self, bytes: &[u8]) -> Result<Box<dyn Any + Send>, UnitError>;
    fn derivative(&mut self, direction: Direction, product: Product<'_>) -> Result<(), UnitError>;
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    Forward,
    Adjoint,
}

/// A product of the Jacobian with a vector.
pub(crate) struct Product<'a> {
    pub(crate) unknowns: &'a [Reference],
    pub(crate) knowns: &'a [Reference],
    pub(crate) seed: &'a [f64],
    pub(crate) sensitivity: &'a mut [f64],
}

struct Adapter<U>(U);

impl<U: Unit> Adapter<U> {
    fn state(state: &dyn Any) -> Result<&U::State, UnitError> {
        state.downcast_ref().ok_or_else(|| "the state is of another type".into())
    }
}

impl<U: Unit> AnyUnit for Adapter<U> {
    fn description(&self) -> Description {
        self.0.description()
    }
    fn get(&mut self, variable: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        self.0.get(variable, values)
    }
    fn set(&mut self, variable: Reference, values: Values<'_>) -> Result<(), UnitError> {
        self.0.set(variable, values)
    }
    fn initialize(&mut self, experiment: &Experiment) -> Result<(), UnitError> {
        self.0.initialize(experiment)
    }
    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        self.0.step(time, step)
    }
    fn terminate(&mut self) -> Result<(), UnitError> {
        self.0.terminate()
    }
    fn save(&mut self) -> Result<Box<dyn Any + Send>, UnitError> {
        Ok(Box::new(self.0.save()?))
    }
    fn restore(&mut self, state: &dyn Any) -> Result<(), UnitError> {
        self.0.restore(Self::state(state)?)
    }
    fn serialize(&self, state: &dyn Any) -> Result<Vec<u8>, UnitError> {
        self.0.serialize(Self::state(state)?)
    }
    fn deserialize(&self, bytes: &[u8]) -> Result<Box<dyn Any + Send>, UnitError> {
        Ok(Box::new(self.0.deserialize(bytes)?))
    }
    fn derivative(&mut self, direction: Direction, p: Product<'_>) -> Result<(), UnitError> {
        match direction {
            Direction::Forward => self.0.directional_derivative(p.unknowns, p.knowns, p.seed, p.sensitivity),
            Direction::Adjoint => self.0.adjoint_derivative(p.unknowns, p.knowns, p.seed, p.sensitivity),
        }
    }
}

/// Makes a unit of one type.
pub(crate) type Factory = fn(&Environment) -> Result<Box<dyn AnyUnit>, UnitError>;

pub(crate) fn factory<U: Unit>(environment: &Environment) -> Result<Box<dyn AnyUnit>, UnitError> {
    Ok(Box::new(Adapter(U::instantiate(environment)?)))
}

/// Runs code of the unit and turns a panic into an error. Whoever calls it must not use what the code
/// was working on afterwards: it may be half changed.
pub(crate) fn guard<T>(code: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    catch_unwind(AssertUnwindSafe(code)).unwrap_or_else(|panic| {
        let text = match (panic.downcast_ref::<&str>(), panic.downcast_ref::<String>()) {
            (Some(text), _) => (*text).to_owned(),
            (_, Some(text)) => text.clone(),
            _ => "without a message".to_owned(),
        };
        // The payload is the unit's too, and dropping it could panic again.
        if let Err(second) = catch_unwind(AssertUnwindSafe(|| drop(panic))) {
            std::mem::forget(second);
        }
        Err(Error::Panic(text))
    })
}

/// Which messages the host wants.
#[derive(Debug)]
struct Filter(HashMap<String, bool>);

impl Filter {
    fn new(description: &Description, on: bool) -> Self {
        Filter(description.all_categories().map(|(name, _)| (name.to_owned(), on)).collect())
    }

    fn pass(&self, message: Message) -> Option<LogEntry> {
        let severity = if message.warning { Severity::Warning } else { Severity::Ok };
        let on = self.0.get(&message.category).copied().unwrap_or(false);
        on.then_some(LogEntry { severity, category: message.category, text: message.text })
    }
}

pub(crate) struct Instance {
    environment: Environment,
    factory: Factory,
    unit: Box<dyn AnyUnit>,
    description: Description,
    token: String,
    table: Table,
    filter: Filter,
    mode: Mode,
    time: f64,
    experiment: Experiment,
    /// The initial equations are to be evaluated before the next result.
    uninitialized: bool,
    states: HashMap<StateKey, SavedState>,
    /// What the last `fmi3GetString` and `fmi3GetBinary` pointed to.
    pub(crate) strings: Vec<CString>,
    pub(crate) binaries: Vec<Vec<u8>>,
}

/// Builds a unit, and its checked description with the token that belongs to it.
pub(crate) fn build(
    factory: Factory,
    environment: &Environment,
) -> Result<(Box<dyn AnyUnit>, Description, String), Error> {
    guard(|| {
        let unit = factory(environment).map_err(Error::Unit)?;
        let description = unit.description();
        description.check()?;
        let token = token(&description, environment.resources.as_deref())?;
        Ok((unit, description, token))
    })
}

impl Instance {
    pub(crate) fn new(
        factory: Factory,
        environment: Environment,
        given_token: &str,
        logging: bool,
    ) -> Result<Self, Error> {
        let (unit, description, token) = build(factory, &environment)?;
        if token != given_token {
            return Err(Error::Token { given: given_token.to_owned(), expected: token });
        }
        Ok(Instance {
            table: Table::new(&description),
            filter: Filter::new(&description, logging),
            environment,
            factory,
            unit,
            description,
            token,
            mode: Mode::Instantiated,
            time: 0.0,
            experiment: Experiment::default(),
            uninitialized: false,
            states: HashMap::new(),
            strings: Vec::new(),
            binaries: Vec::new(),
        })
    }

    /// Runs one function of the interface: is it legal, what does it do, where does it lead.
    pub(crate) fn call<T: Into<Reply>>(
        &mut self,
        function: Function,
        body: impl FnOnce(&mut Self) -> Result<T, Error>,
    ) -> Answer {
        let rule = function.rule();
        let result = if let Some(reason) = rule.unsupported {
            Err(Error::Unsupported { function: rule.name, reason })
        } else if !function.is_legal_in(self.mode) {
            Err(Error::IllegalCall { function: rule.name, mode: self.mode })
        } else {
            guard(|| body(self).map(Into::into))
        };
        let (mut messages, warned) = self.drain();
        let severity = match result {
            Ok(Reply::Done) => {
                if let (Next::To(mode), true) = (rule.next, self.mode != Mode::Failed) {
                    self.mode = mode;
                }
                if warned { Severity::Warning } else { Severity::Ok }
            }
            Ok(Reply::Discard(reason)) => {
                let category = "logStatusDiscard".to_owned();
                if self.filter.0.get(&category) == Some(&true) {
                    messages.push(LogEntry { severity: Severity::Discard, category, text: reason });
                }
                Severity::Discard
            }
            Err(error) => {
                if matches!(error, Error::Panic(_)) || self.mode == Mode::Failed {
                    self.mode = Mode::Failed;
                } else {
                    self.mode = Mode::Terminated;
                }
                messages.push(LogEntry::error(&format!("{}: {error}", rule.name)));
                Severity::Error
            }
        };
        Answer { severity, messages }
    }

    /// What the unit has said and the host wants to hear, and whether there was a warning.
    fn drain(&mut self) -> (Vec<LogEntry>, bool) {
        let queue = self.environment.log.drain();
        let warned = queue.iter().any(|m| m.warning);
        (queue.into_iter().filter_map(|m| self.filter.pass(m)).collect(), warned)
    }

    /// What the unit has said outside a call.
    pub(crate) fn take_messages(&mut self) -> Vec<LogEntry> {
        self.drain().0
    }

    pub(crate) fn set_debug_logging(&mut self, on: bool, categories: &[String]) -> Result<(), Error> {
        if let Some(unknown) = categories.iter().find(|c| !self.filter.0.contains_key(*c)) {
            return Err(Error::Argument {
                argument: "categories",
                problem: format!("contains `{unknown}`, which is no category of this unit"),
            });
        }
        if categories.is_empty() {
            self.filter.0.values_mut().for_each(|switch| *switch = on);
        }
        for category in categories {
            self.filter.0.insert(category.clone(), on);
        }
        Ok(())
    }

    pub(crate) fn enter_initialization(&mut self, experiment: Experiment) -> Result<(), Error> {
        let Experiment { start, stop, tolerance } = experiment;
        if !start.is_finite() {
            return Err(argument("startTime", format!("is {start}")));
        }
        if let Some(stop) = stop.filter(|stop| stop.is_nan() || *stop < start) {
            return Err(argument("stopTime", format!("is {stop}, before the start at {start}")));
        }
        if let Some(tolerance) = tolerance.filter(|t| !t.is_finite() || *t < 0.0) {
            return Err(argument("tolerance", format!("is {tolerance}")));
        }
        self.experiment = experiment;
        self.time = start;
        self.uninitialized = true;
        Ok(())
    }

    pub(crate) fn exit_initialization(&mut self) -> Result<(), Error> {
        self.evaluate_initial()
    }

    fn evaluate_initial(&mut self) -> Result<(), Error> {
        if self.uninitialized {
            self.unit.initialize(&self.experiment).map_err(Error::Unit)?;
            self.uninitialized = false;
        }
        Ok(())
    }

    pub(crate) fn terminate(&mut self) -> Result<(), Error> {
        if self.mode == Mode::Failed {
            return Ok(());
        }
        self.unit.terminate().map_err(Error::Unit)
    }

    pub(crate) fn reset(&mut self) -> Result<(), Error> {
        let (unit, description, token) = build(self.factory, &self.environment)?;
        if token != self.token {
            return Err(Error::Token { given: self.token.clone(), expected: token });
        }
        self.table = Table::new(&description);
        self.description = description;
        self.unit = unit;
        self.time = 0.0;
        self.experiment = Experiment::default();
        self.uninitialized = false;
        Ok(())
    }

    /// Advances. Returns whether the unit wants to stop, or why it did not step.
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Result<Result<bool, String>, Error> {
        let end = time + step;
        let tolerance = TIME_TOLERANCE * time.abs().max(end.abs());
        if !(step > 0.0 && end.is_finite()) {
            return Err(argument("communicationStepSize", format!("is {step} at time {time}")));
        }
        if (time - self.time).abs() > tolerance {
            let problem = format!("is {time}, but the unit is at {}", self.time);
            return Err(argument("currentCommunicationPoint", problem));
        }
        if let Some(stop) = self.experiment.stop.filter(|stop| end > stop + tolerance) {
            return Err(argument("communicationStepSize", format!("leads to {end}, past the stop time {stop}")));
        }
        let finished = match self.unit.step(time, step).map_err(Error::Unit)? {
            StepOutcome::Discarded(reason) => return Ok(Err(reason)),
            StepOutcome::Completed => false,
            StepOutcome::Finished => true,
        };
        self.time = end;
        Ok(Ok(finished))
    }

    pub(crate) fn time(&self) -> f64 {
        self.time
    }

    fn variable(&self, reference: Reference) -> Result<&Variable, Error> {
        self.table.get(reference).ok_or(Error::UnknownReference(reference))
    }

    fn variable_of_type(&self, reference: Reference, asked: Type) -> Result<&Variable, Error> {
        let variable = self.variable(reference)?;
        if variable.ty.carrier() != asked {
            return Err(Error::WrongType { name: variable.name.clone(), is: variable.ty, asked });
        }
        Ok(variable)
    }

    /// Checks type and total size of variables before anything is done with them.
    pub(crate) fn expect(&self, references: &[Reference], ty: Type, given: usize) -> Result<(), Error> {
        let mut expected = 0usize;
        for &reference in references {
            expected = expected.saturating_add(self.variable_of_type(reference, ty)?.size());
        }
        if given == expected {
            return Ok(());
        }
        let mut names: Vec<_> = references
            .iter()
            .take(NAMES_SHOWN)
            .map(|r| self.variable(*r).map(|v| format!("`{}`", v.name)))
            .collect::<Result<_, _>>()?;
        if references.len() > NAMES_SHOWN {
            names.push(format!("and {} more", references.len() - NAMES_SHOWN));
        }
        Err(Error::WrongLength { expected, given, names: names.join(", ") })
    }

    /// Gets variables; lengths have been checked by [`Instance::expect`].
    pub(crate) fn get<T: Value>(&mut self, references: &[Reference], values: &mut [T]) -> Result<(), Error> {
        if self.mode == Mode::Initialization && references.iter().any(|r| self.is_result(*r)) {
            self.evaluate_initial()?;
        }
        let mut rest = values;
        for &reference in references {
            let variable = self.table.get(reference).ok_or(Error::UnknownReference(reference))?;
            let (part, tail) = rest.split_at_mut(variable.size());
            rest = tail;
            if reference == TIME {
                T::wrap_mut(part).write(&[self.time]).map_err(Error::Unit)?;
            } else {
                self.unit.get(reference, T::wrap_mut(part)).map_err(Error::Unit)?;
            }
        }
        Ok(())
    }

    /// Whether the initial equations compute the variable.
    fn is_result(&self, reference: Reference) -> bool {
        reference != TIME && self.table.get(reference).is_none_or(|v| !is_settable(v, Mode::Initialization))
    }

    /// Sets variables; lengths have been checked by [`Instance::expect`]. All or none.
    pub(crate) fn set<T: Value>(&mut self, references: &[Reference], values: &[T]) -> Result<(), Error> {
        let mut rest = values;
        let mut parts = Vec::with_capacity(references.len());
        for &reference in references {
            let variable = self.variable(reference)?;
            if !is_settable(variable, self.mode) {
                return Err(Error::NotSettable {
                    name: variable.name.clone(),
                    causality: format!("{} {}", variable.variability.name(), variable.causality.name()),
                    mode: self.mode,
                });
            }
            let (part, tail) = rest.split_at(variable.size());
            rest = tail;
            if let (Type::Enumeration, Values::Int64(items)) = (variable.ty, T::wrap(part))
                && let Some(&value) = items.iter().find(|v| !self.table.has_item(variable, **v))
            {
                return Err(Error::NoItem { name: variable.name.clone(), value });
            }
            parts.push((reference, part));
        }
        for (reference, part) in parts {
            self.unit.set(reference, T::wrap(part)).map_err(Error::Unit)?;
        }
        self.uninitialized |= self.mode == Mode::Initialization;
        Ok(())
    }

    fn require(&self, capability: bool, function: Function, reason: &'static str) -> Result<(), Error> {
        if capability { Ok(()) } else { Err(Error::Unsupported { function: function.rule().name, reason }) }
    }

    fn require_state(&self, function: Function) -> Result<(), Error> {
        self.require(self.description.capabilities.state, function, "the unit cannot save its state")
    }

    fn require_serialize(&self, function: Function) -> Result<(), Error> {
        self.require(self.description.capabilities.serialize, function, "the unit cannot serialise its state")
    }

    /// Saves the state, in place of state `old` if there is one.
    pub(crate) fn save(&mut self, old: StateKey) -> Result<StateKey, Error> {
        self.require_state(Function::GetFMUState)?;
        if old != 0 && !self.states.contains_key(&old) {
            return Err(Error::UnknownState);
        }
        let unit = self.unit.save().map_err(Error::Unit)?;
        Ok(self.keep(old, SavedState { header: self.header(), unit, bytes: None }))
    }

    fn header(&self) -> Header {
        Header { mode: self.mode, uninitialized: self.uninitialized, time: self.time, experiment: self.experiment }
    }

    fn keep(&mut self, old: StateKey, state: SavedState) -> StateKey {
        let key = if old == 0 { NEXT_STATE.fetch_add(1, Ordering::Relaxed) } else { old };
        self.states.insert(key, state);
        key
    }

    pub(crate) fn restore(&mut self, key: StateKey) -> Result<(), Error> {
        self.require_state(Function::SetFMUState)?;
        let state = self.states.get(&key).ok_or(Error::UnknownState)?;
        self.unit.restore(state.unit.as_ref()).map_err(Error::Unit)?;
        self.mode = state.header.mode;
        self.uninitialized = state.header.uninitialized;
        self.time = state.header.time;
        self.experiment = state.header.experiment;
        Ok(())
    }

    pub(crate) fn free_state(&mut self, key: StateKey) -> Result<(), Error> {
        if key != 0 {
            self.states.remove(&key).ok_or(Error::UnknownState)?;
        }
        Ok(())
    }

    pub(crate) fn serialized_size(&mut self, key: StateKey) -> Result<usize, Error> {
        self.require_serialize(Function::SerializedFMUStateSize)?;
        let bytes = self.serialized(key)?;
        let size = bytes.len();
        if let Some(state) = self.states.get_mut(&key) {
            state.bytes = Some(bytes);
        }
        Ok(size)
    }

    /// The state as bytes, which must be `size` many.
    pub(crate) fn serialize(&mut self, key: StateKey, size: usize) -> Result<Vec<u8>, Error> {
        self.require_serialize(Function::SerializeFMUState)?;
        let bytes = self.serialized(key)?;
        if bytes.len() != size {
            return Err(argument("size", format!("is {size}, but the state has {} bytes", bytes.len())));
        }
        Ok(bytes)
    }

    fn serialized(&mut self, key: StateKey) -> Result<Vec<u8>, Error> {
        let state = self.states.get_mut(&key).ok_or(Error::UnknownState)?;
        if let Some(bytes) = state.bytes.take() {
            return Ok(bytes);
        }
        let unit = self.unit.serialize(state.unit.as_ref()).map_err(Error::Unit)?;
        Ok(encode(&self.token, &state.header, &unit))
    }

    pub(crate) fn deserialize(&mut self, bytes: &[u8], old: StateKey) -> Result<StateKey, Error> {
        self.require_serialize(Function::DeserializeFMUState)?;
        if old != 0 && !self.states.contains_key(&old) {
            return Err(Error::UnknownState);
        }
        let (header, unit) = decode(&self.token, bytes)?;
        let unit = self.unit.deserialize(unit).map_err(Error::Unit)?;
        Ok(self.keep(old, SavedState { header, unit, bytes: None }))
    }

    /// Checks the sizes of a derivative's vectors.
    pub(crate) fn expect_derivative(
        &self,
        direction: Direction,
        unknowns: &[Reference],
        knowns: &[Reference],
        seed: usize,
        sensitivity: usize,
    ) -> Result<(), Error> {
        let capabilities = self.description.capabilities;
        let (unknown_values, known_values) = match direction {
            Direction::Forward => {
                let function = Function::GetDirectionalDerivative;
                self.require(capabilities.directional_derivative, function, "the unit has no such derivatives")?;
                (sensitivity, seed)
            }
            Direction::Adjoint => {
                let function = Function::GetAdjointDerivative;
                self.require(capabilities.adjoint_derivative, function, "the unit has no such derivatives")?;
                (seed, sensitivity)
            }
        };
        self.expect(unknowns, Type::Float64, unknown_values)?;
        self.expect(knowns, Type::Float64, known_values)
    }

    pub(crate) fn derivative(&mut self, direction: Direction, product: Product<'_>) -> Result<(), Error> {
        if self.mode == Mode::Initialization {
            self.evaluate_initial()?;
        }
        self.unit.derivative(direction, product).map_err(Error::Unit)
    }
}

impl LogEntry {
    pub(crate) fn error(text: &str) -> Self {
        LogEntry { severity: Severity::Error, category: "logStatusError".to_owned(), text: text.to_owned() }
    }
}

pub(crate) fn argument(argument: &'static str, problem: impl Into<String>) -> Error {
    Error::Argument { argument, problem: problem.into() }
}
