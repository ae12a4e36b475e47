//! What one implements: [`Unit`], and what the layer hands to it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::description::Description;
use crate::error::UnitError;
use crate::variables::{Reference, Type};

/// A co-simulation unit. [`export_unit!`](crate::export_unit) makes a library of it.
///
/// The layer calls a method only when the standard allows it, with references that the description
/// declares, of the declared type and size. An error returned from a method becomes `fmi3Error` with
/// its text, and a host may go on from a saved state; a panic becomes `fmi3Error` too, but then the unit
/// is never called again.
pub trait Unit: Send + Sized + 'static {
    /// All that [`restore`](Unit::restore) needs to bring a unit back; `()` if it cannot.
    type State: Send + 'static;

    /// Builds the unit with its start values.
    ///
    /// # Errors
    /// Missing or corrupt resources: the host gets no instance, and the text.
    fn instantiate(environment: &Environment) -> Result<Self, UnitError>;

    /// What the unit is. Must depend on the resources alone.
    fn description(&self) -> Description;

    /// Writes the present values of a variable, computing them if need be.
    ///
    /// # Errors
    /// The values cannot be computed.
    fn get(&mut self, variable: Reference, values: ValuesMut<'_>) -> Result<(), UnitError>;

    /// Takes new values of an input or a parameter, or a new start value.
    ///
    /// # Errors
    /// The values make no sense.
    fn set(&mut self, _variable: Reference, _values: Values<'_>) -> Result<(), UnitError> {
        Err("the unit takes no values".into())
    }

    /// Computes the initial state from parameters, inputs and start values. Called when initialisation
    /// ends, and before that if the host asks for results, so it may be called several times. Nothing to do
    /// if [`instantiate`](Unit::instantiate) leaves the unit in its initial state.
    ///
    /// # Errors
    /// There is no initial state.
    fn initialize(&mut self, _experiment: &Experiment) -> Result<(), UnitError> {
        Ok(())
    }

    /// Advances from `time` by `step` > 0. A step that is [discarded](StepOutcome::Discarded) must leave
    /// the unit as it was.
    ///
    /// # Errors
    /// The unit cannot go on.
    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError>;

    /// The simulation is over; values can still be read.
    ///
    /// # Errors
    /// Results could not be written, for example.
    fn terminate(&mut self) -> Result<(), UnitError> {
        Ok(())
    }

    /// Copies the state, inputs and parameters included.
    ///
    /// # Errors
    /// The unit cannot be copied now.
    fn save(&mut self) -> Result<Self::State, UnitError> {
        Err("the unit has no states".into())
    }

    /// Goes back to a state of this unit: whatever follows must have the same bits.
    ///
    /// # Errors
    /// The state cannot be used.
    fn restore(&mut self, _state: &Self::State) -> Result<(), UnitError> {
        Err("the unit has no states".into())
    }

    /// The state as bytes. The layer adds token, version and checksum.
    ///
    /// # Errors
    /// The state cannot be written.
    fn serialize(&self, _state: &Self::State) -> Result<Vec<u8>, UnitError> {
        Err("the unit has no serialised states".into())
    }

    /// The inverse of [`serialize`](Unit::serialize), in any process, of an equal unit.
    ///
    /// # Errors
    /// The bytes are no state of this unit.
    fn deserialize(&self, _bytes: &[u8]) -> Result<Self::State, UnitError> {
        Err("the unit has no serialised states".into())
    }

    /// Writes ∂unknowns/∂knowns · seed into `sensitivity`, both in the order of the variables.
    ///
    /// # Errors
    /// There is no such derivative.
    fn directional_derivative(
        &mut self,
        _unknowns: &[Reference],
        _knowns: &[Reference],
        _seed: &[f64],
        _sensitivity: &mut [f64],
    ) -> Result<(), UnitError> {
        Err("the unit has no directional derivatives".into())
    }

    /// Writes (∂unknowns/∂knowns)ᵀ · seed into `sensitivity`.
    ///
    /// # Errors
    /// There is no such derivative.
    fn adjoint_derivative(
        &mut self,
        _unknowns: &[Reference],
        _knowns: &[Reference],
        _seed: &[f64],
        _sensitivity: &mut [f64],
    ) -> Result<(), UnitError> {
        Err("the unit has no adjoint derivatives".into())
    }
}

/// Where an instance lives.
#[derive(Clone, Debug)]
pub struct Environment {
    /// Name that the host gave to the instance.
    pub instance_name: String,
    /// The unpacked `resources` folder, if the host has it.
    pub resources: Option<PathBuf>,
    /// Messages to the host.
    pub log: Log,
}

impl Environment {
    /// The path of a file in the resources.
    ///
    /// # Errors
    /// The host gave no resources.
    pub fn resource(&self, name: impl AsRef<Path>) -> Result<PathBuf, UnitError> {
        match &self.resources {
            Some(folder) => Ok(folder.join(name)),
            None => Err("the unit needs its resources, but the host gave no path to them".into()),
        }
    }
}

/// What the host says about the simulation at its beginning.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Experiment {
    /// Start time.
    pub start: f64,
    /// Stop time; steps beyond it are refused by the layer.
    pub stop: Option<f64>,
    /// Relative tolerance wished for.
    pub tolerance: Option<f64>,
}

/// How a time step ended.
#[derive(Clone, Debug, PartialEq)]
pub enum StepOutcome {
    /// At the end of the step.
    Completed,
    /// At the end of the step, and the simulation should stop here.
    Finished,
    /// Not at all, for this reason (no convergence, say); nothing has changed, so the host may try a
    /// smaller step or other inputs.
    Discarded(String),
}

/// Messages from unit to host, under the categories of the description. They are passed on when the
/// call that caused them returns, if the host has their category switched on.
#[derive(Clone, Debug, Default)]
pub struct Log(Arc<Mutex<Vec<Message>>>);

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Message {
    pub(crate) warning: bool,
    pub(crate) category: String,
    pub(crate) text: String,
}

/// More messages than these in one call are dropped: nobody reads them, and they take memory.
const MOST_MESSAGES: usize = 1000;

impl Log {
    /// Informs.
    pub fn info(&self, category: &str, text: impl Into<String>) {
        self.push(Message { warning: false, category: category.to_owned(), text: text.into() });
    }

    /// Warns: the call in progress will return `fmi3Warning`.
    pub fn warn(&self, text: impl Into<String>) {
        let category = "logStatusWarning".to_owned();
        self.push(Message { warning: true, category, text: text.into() });
    }

    fn push(&self, message: Message) {
        let mut queue = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if queue.len() < MOST_MESSAGES {
            queue.push(message);
        }
    }

    pub(crate) fn drain(&self) -> Vec<Message> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// A type that values of variables have. Enumerations are `i64`.
pub trait Value: Clone + Default + sealed::Sealed {
    #[doc(hidden)]
    const TYPE: Type;
    #[doc(hidden)]
    fn wrap(values: &[Self]) -> Values<'_>;
    #[doc(hidden)]
    fn wrap_mut(values: &mut [Self]) -> ValuesMut<'_>;
    #[doc(hidden)]
    fn unwrap(values: Values<'_>) -> Option<&[Self]>;
    #[doc(hidden)]
    fn unwrap_mut(values: ValuesMut<'_>) -> Option<&mut [Self]>;
}

mod sealed {
    pub trait Sealed {}
}

macro_rules! values {
    ($($variant:ident $ty:ty;)*) => {
        /// Values that the host sets, in row-major order.
        #[derive(Clone, Copy, Debug)]
        #[allow(missing_docs, reason = "the names of the standard")]
        pub enum Values<'a> { $($variant(&'a [$ty]),)* }

        /// Room for the values that the host gets, in row-major order.
        #[derive(Debug)]
        #[allow(missing_docs, reason = "the names of the standard")]
        pub enum ValuesMut<'a> { $($variant(&'a mut [$ty]),)* }

        impl Values<'_> {
            fn ty(&self) -> Type {
                match self { $(Values::$variant(_) => Type::$variant,)* }
            }
        }

        impl ValuesMut<'_> {
            fn ty(&self) -> Type {
                match self { $(ValuesMut::$variant(_) => Type::$variant,)* }
            }
        }

        $(
            impl sealed::Sealed for $ty {}
            impl Value for $ty {
                const TYPE: Type = Type::$variant;
                fn wrap(values: &[Self]) -> Values<'_> { Values::$variant(values) }
                fn wrap_mut(values: &mut [Self]) -> ValuesMut<'_> { ValuesMut::$variant(values) }
                fn unwrap(values: Values<'_>) -> Option<&[Self]> {
                    if let Values::$variant(v) = values { Some(v) } else { None }
                }
                fn unwrap_mut(values: ValuesMut<'_>) -> Option<&mut [Self]> {
                    if let ValuesMut::$variant(v) = values { Some(v) } else { None }
                }
            }
        )*
    };
}

values! {
    Float32 f32; Float64 f64;
    Int8 i8; UInt8 u8; Int16 i16; UInt16 u16; Int32 i32; UInt32 u32; Int64 i64; UInt64 u64;
    Boolean bool; String String; Binary Vec<u8>;
}

impl<'a> Values<'a> {
    /// The values as a slice of the variable's type.
    ///
    /// # Errors
    /// The variable was declared with another type.
    pub fn slice<T: Value>(self) -> Result<&'a [T], UnitError> {
        let is = self.ty();
        T::unwrap(self).ok_or_else(|| mismatch(is, T::TYPE))
    }

    /// The value of a scalar.
    ///
    /// # Errors
    /// The variable was declared with another type, or as an array.
    pub fn scalar<T: Value>(self) -> Result<T, UnitError> {
        match self.slice::<T>()? {
            [value] => Ok(value.clone()),
            values => Err(format!("an array of {} is no scalar", values.len()).into()),
        }
    }

    /// Copies the values into `target`.
    ///
    /// # Errors
    /// The variable was declared with another type or size.
    pub fn read<T: Value>(self, target: &mut [T]) -> Result<(), UnitError> {
        copy(self.slice()?, target)
    }
}

impl<'a> ValuesMut<'a> {
    /// The room as a slice of the variable's type.
    ///
    /// # Errors
    /// The variable was declared with another type.
    pub fn slice<T: Value>(self) -> Result<&'a mut [T], UnitError> {
        let is = self.ty();
        T::unwrap_mut(self).ok_or_else(|| mismatch(is, T::TYPE))
    }

    /// Copies `source` into the room; a scalar is a slice of one.
    ///
    /// # Errors
    /// The variable was declared with another type or size.
    pub fn write<T: Value>(self, source: &[T]) -> Result<(), UnitError> {
        copy(source, self.slice()?)
    }
}

fn copy<T: Clone>(source: &[T], target: &mut [T]) -> Result<(), UnitError> {
    if source.len() != target.len() {
        return Err(format!("{} values do not fit {}", source.len(), target.len()).into());
    }
    target.clone_from_slice(source);
    Ok(())
}

fn mismatch(is: Type, asked: Type) -> UnitError {
    format!("the values are of type {is:?}, not {asked:?}").into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_and_written_by_type_and_size() {
        let mut room = [0.0; 2];
        f64::wrap_mut(&mut room).write(&[1.0, 2.0]).unwrap();
        assert_eq!(room, [1.0, 2.0]);
        assert!(f64::wrap_mut(&mut room).write(&[1.0]).is_err());
        assert!(f64::wrap_mut(&mut room).write(&[1i64, 2]).is_err());
        assert_eq!(f64::wrap(&room).slice::<f64>().unwrap(), room);
        assert!(f64::wrap(&room).slice::<bool>().is_err());
        assert!(f64::wrap(&room).scalar::<f64>().is_err());
        assert!(bool::wrap(&[true]).scalar::<bool>().unwrap());
    }

    #[test]
    fn the_log_is_bounded() {
        let log = Log::default();
        (0..2 * MOST_MESSAGES).for_each(|i| log.info("solver", i.to_string()));
        assert_eq!(log.drain().len(), MOST_MESSAGES);
        assert!(log.drain().is_empty());
    }
}
