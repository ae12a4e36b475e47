//! The C boundary, and the only module with `unsafe` code.
//!
//! Instances and states are numbers dressed up as pointers: a registry finds the instance, so a stale,
//! foreign or random pointer is an error and nothing is ever dereferenced. What cannot be checked is what
//! no C library can check: that an array of the host is as long as the host says. Its length is compared
//! with the table of variables before the array is touched.
//!
//! Log messages are delivered after the instance has been released, so a callback may call back.
//!
//! Items are public for [`export_unit!`](crate::export_unit) only.
#![allow(unsafe_code, reason = "arrays, strings and callbacks of the host are raw pointers")]
#![allow(non_snake_case, missing_docs, clippy::missing_safety_doc, reason = "functions of the standard")]

use std::collections::HashMap;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock, TryLockError};

use crate::error::Error;
use crate::instance::{Direction, Instance, LogEntry, Product, Reply, Severity, argument, factory, guard};
use crate::modes::Function;
use crate::unit::{Environment, Experiment, Log, Unit, Value};
use crate::variables::Type;

/// `fmi3Instance`, `fmi3InstanceEnvironment`, `fmi3FMUState`.
pub type Handle = *mut c_void;

/// `fmi3Status`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    OK,
    Warning,
    Discard,
    Error,
    Fatal,
}

/// `fmi3Boolean` and `fmi3Clock`: a C `bool` of which nothing is assumed.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flag(pub u8);

impl Flag {
    fn is_set(self) -> bool {
        self.0 != 0
    }
}

impl From<bool> for Flag {
    fn from(value: bool) -> Self {
        Flag(value.into())
    }
}

/// `fmi3Char`.
#[repr(transparent)]
#[derive(Clone, Copy, Debug)]
pub struct Char(pub c_char);

/// `fmi3DependencyKind`.
#[repr(transparent)]
pub struct DependencyKind(pub c_int);

/// `fmi3IntervalQualifier`.
#[repr(transparent)]
pub struct IntervalQualifier(pub c_int);

pub type LogMessage = Option<unsafe extern "C" fn(Handle, Status, *const Char, *const Char)>;
pub type ClockUpdate = Option<unsafe extern "C" fn(Handle)>;
pub type Preemption = Option<unsafe extern "C" fn()>;
pub type IntermediateUpdate = Option<unsafe extern "C" fn(Handle, f64, Flag, Flag, Flag, Flag, *mut Flag, *mut f64)>;

/// The host's side of an instance.
#[derive(Clone, Copy)]
struct Host {
    environment: Handle,
    log: LogMessage,
}

// SAFETY: the environment is never dereferenced here, only handed back to the host's own callback, which
// the standard lets be called from whatever thread calls the instance.
unsafe impl Send for Host {}
// SAFETY: as above; there is nothing to change.
unsafe impl Sync for Host {}

impl Host {
    /// Calls the host's callback. Must not be called while an instance is locked.
    fn tell(self, entry: &LogEntry) {
        let Some(log) = self.log else { return };
        // `#` marks value references in messages and is escaped by doubling it.
        let text = entry.text.replace('#', "##").replace('\0', "\u{fffd}");
        let (Ok(category), Ok(text)) = (CString::new(entry.category.as_str()), CString::new(text)) else {
            return;
        };
        let (category, text) = (category.as_ptr().cast(), text.as_ptr().cast());
        // SAFETY: the host promises that its callback can be called with its environment, and the
        // strings live until it returns.
        unsafe { log(self.environment, status(entry.severity), category, text) }
    }

    fn tell_error(self, function: &str, error: &Error) {
        self.tell(&LogEntry::error(&format!("{function}: {error}")));
    }
}

fn status(severity: Severity) -> Status {
    match severity {
        Severity::Ok => Status::OK,
        Severity::Warning => Status::Warning,
        Severity::Discard => Status::Discard,
        Severity::Error => Status::Error,
    }
}

struct Slot {
    host: Host,
    instance: Mutex<Instance>,
}

type Registry = HashMap<usize, Arc<Slot>>;

static REGISTRY: RwLock<Option<Registry>> = RwLock::new(None);
/// Numbers are never used twice, so that a freed instance is never mistaken for a later one.
static NEXT: AtomicUsize = AtomicUsize::new(1);
/// Handles look like aligned pointers, in case a host looks at them.
const STRIDE: usize = 16;

fn handle(key: usize) -> Handle {
    ptr::without_provenance_mut(key.wrapping_mul(STRIDE))
}

fn key(handle: Handle) -> Option<usize> {
    let address = handle.addr();
    address.is_multiple_of(STRIDE).then_some(address / STRIDE)
}

fn find(handle: Handle) -> Option<Arc<Slot>> {
    let registry = REGISTRY.read().unwrap_or_else(PoisonError::into_inner);
    registry.as_ref()?.get(&key(handle)?).cloned()
}

fn register(slot: Slot) -> Handle {
    let key = NEXT.fetch_add(1, Ordering::Relaxed);
    let mut registry = REGISTRY.write().unwrap_or_else(PoisonError::into_inner);
    registry.get_or_insert_default().insert(key, Arc::new(slot));
    handle(key)
}

/// Finds the instance, runs `body` on it under the rules of `function`, then delivers the messages.
fn call<T: Into<Reply>>(
    handle: Handle,
    function: Function,
    body: impl FnOnce(&mut Instance) -> Result<T, Error>,
) -> Status {
    // Without an instance there is no callback either: the status is all that can be said.
    let Some(slot) = find(handle) else {
        return Status::Error;
    };
    let host = slot.host;
    // `Instance::call` has its own guard around the unit; this one is for the drop of an instance that
    // another thread has freed meanwhile.
    let answer = guard(move || {
        let instance = slot.instance.try_lock();
        match instance {
            Ok(mut instance) => Ok(instance.call(function, body)),
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner().call(function, body)),
            Err(TryLockError::WouldBlock) => Err(Error::Busy),
        }
    });
    match answer {
        Ok(answer) => {
            answer.messages.iter().for_each(|entry| host.tell(entry));
            status(answer.severity)
        }
        Err(error) => {
            host.tell_error(function.rule().name, &error);
            Status::Error
        }
    }
}

/// A function that these units do not have.
pub fn unsupported(instance: Handle, name: &str) -> Status {
    match Function::named(name) {
        Some(function) => call(instance, function, |_| Ok(())),
        None => Status::Error,
    }
}

/// The host's array as a slice.
///
/// # Safety
/// If `pointer` is not null and aligned, it points to `count` values that live as long as `'a`.
unsafe fn slice<'a, T>(pointer: *const T, count: usize, name: &'static str) -> Result<&'a [T], Error> {
    if count == 0 {
        return Ok(&[]);
    }
    check(pointer, count, name)?;
    // SAFETY: not null, aligned and not too long by the check; the rest is the caller's promise.
    Ok(unsafe { std::slice::from_raw_parts(pointer, count) })
}

/// The host's array as a slice to write to.
///
/// # Safety
/// As for [`slice`], and nothing else refers to the array.
unsafe fn slice_mut<'a, T>(pointer: *mut T, count: usize, name: &'static str) -> Result<&'a mut [T], Error> {
    if count == 0 {
        return Ok(&mut []);
    }
    check(pointer, count, name)?;
    // SAFETY: as above; the types used here are numbers and pointers, for which all bits are values.
    Ok(unsafe { std::slice::from_raw_parts_mut(pointer, count) })
}

/// One value of the host to write to.
///
/// # Safety
/// As for [`slice_mut`] with one value.
unsafe fn place<'a, T>(pointer: *mut T, name: &'static str) -> Result<&'a mut T, Error> {
    check(pointer, 1, name)?;
    // SAFETY: as above.
    Ok(unsafe { &mut *pointer })
}

fn check<T>(pointer: *const T, count: usize, name: &'static str) -> Result<(), Error> {
    if pointer.is_null() {
        return Err(argument(name, "is NULL"));
    }
    if !pointer.is_aligned() {
        return Err(argument(name, "is not aligned"));
    }
    if count.checked_mul(size_of::<T>()).is_none_or(|bytes| bytes > isize::MAX as usize) {
        return Err(argument(name, format!("has the impossible length {count}")));
    }
    Ok(())
}

/// The host's string.
///
/// # Safety
/// If `pointer` is not null, it points to characters that end with NUL.
unsafe fn string(pointer: *const Char, name: &'static str) -> Result<String, Error> {
    check(pointer, 1, name)?;
    // SAFETY: not null by the check; the rest is the caller's promise.
    let text = unsafe { CStr::from_ptr(pointer.cast()) };
    text.to_str().map(str::to_owned).map_err(|_| argument(name, "is not valid UTF-8"))
}

pub unsafe fn fmi3GetVersion() -> *const Char {
    c"3.0".as_ptr().cast()
}

pub unsafe fn fmi3InstantiateCoSimulation<U: Unit>(
    name: *const Char,
    token: *const Char,
    resources: *const Char,
    _visible: Flag,
    logging: Flag,
    event_mode: Flag,
    _early_return: Flag,
    _intermediate: *const u32,
    intermediate_count: usize,
    environment: Handle,
    log: LogMessage,
    _intermediate_update: IntermediateUpdate,
) -> Handle {
    let host = Host { environment, log };
    let instance = guard(|| {
        // SAFETY: strings of the host.
        let (name, token) = unsafe { (string(name, "instanceName")?, string(token, "instantiationToken")?) };
        if name.trim().is_empty() {
            return Err(argument("instanceName", "is empty"));
        }
        if event_mode.is_set() {
            return Err(argument("eventModeUsed", "is true, but the unit has no event mode"));
        }
        if intermediate_count > 0 {
            return Err(argument(
                "nRequiredIntermediateVariables",
                "is not 0, but the unit has no intermediate update",
            ));
        }
        let resources = if resources.is_null() {
            None
        } else {
            // SAFETY: a string of the host.
            Some(unsafe { string(resources, "resourcePath") }?.into())
        };
        let environment = Environment { instance_name: name, resources, log: Log::default() };
        Instance::new(factory::<U>, environment, &token, logging.is_set())
    });
    match instance {
        Ok(mut instance) => {
            let messages = instance.take_messages();
            let handle = register(Slot { host, instance: Mutex::new(instance) });
            messages.iter().for_each(|entry| host.tell(entry));
            handle
        }
        Err(error) => {
            host.tell_error("fmi3InstantiateCoSimulation", &error);
            ptr::null_mut()
        }
    }
}

fn refuse(environment: Handle, log: LogMessage, function: &'static str, reason: &'static str) -> Handle {
    Host { environment, log }.tell_error(function, &Error::Unsupported { function, reason });
    ptr::null_mut()
}

pub unsafe fn fmi3InstantiateModelExchange(
    _name: *const Char,
    _token: *const Char,
    _resources: *const Char,
    _visible: Flag,
    _logging: Flag,
    environment: Handle,
    log: LogMessage,
) -> Handle {
    refuse(environment, log, "fmi3InstantiateModelExchange", "the unit is for co-simulation")
}

pub unsafe fn fmi3InstantiateScheduledExecution(
    _name: *const Char,
    _token: *const Char,
    _resources: *const Char,
    _visible: Flag,
    _logging: Flag,
    environment: Handle,
    log: LogMessage,
    _clock_update: ClockUpdate,
    _lock: Preemption,
    _unlock: Preemption,
) -> Handle {
    refuse(environment, log, "fmi3InstantiateScheduledExecution", "the unit is for co-simulation")
}

pub unsafe fn fmi3FreeInstance(instance: Handle) {
    let Some(key) = key(instance) else { return };
    let mut registry = REGISTRY.write().unwrap_or_else(PoisonError::into_inner);
    let slot = registry.as_mut().and_then(|map| map.remove(&key));
    drop(registry);
    if let Some(slot) = slot {
        let host = slot.host;
        let dropped = guard(|| {
            drop(slot);
            Ok(())
        });
        if let Err(error) = dropped {
            host.tell_error("fmi3FreeInstance", &error);
        }
    }
}

pub unsafe fn fmi3SetDebugLogging(instance: Handle, on: Flag, count: usize, categories: *const *const Char) -> Status {
    call(instance, Function::SetDebugLogging, |i| {
        // SAFETY: an array of the host.
        let categories = unsafe { slice(categories, count, "categories") }?;
        // SAFETY: strings of the host.
        let names = categories.iter().map(|c| unsafe { string(*c, "categories") });
        i.set_debug_logging(on.is_set(), &names.collect::<Result<Vec<_>, _>>()?)
    })
}

pub unsafe fn fmi3EnterInitializationMode(
    instance: Handle,
    tolerance_defined: Flag,
    tolerance: f64,
    start: f64,
    stop_defined: Flag,
    stop: f64,
) -> Status {
    call(instance, Function::EnterInitializationMode, |i| {
        i.enter_initialization(Experiment {
            start,
            stop: stop_defined.is_set().then_some(stop),
            tolerance: tolerance_defined.is_set().then_some(tolerance),
        })
    })
}

pub unsafe fn fmi3ExitInitializationMode(instance: Handle) -> Status {
    call(instance, Function::ExitInitializationMode, Instance::exit_initialization)
}

pub unsafe fn fmi3Terminate(instance: Handle) -> Status {
    call(instance, Function::Terminate, Instance::terminate)
}

pub unsafe fn fmi3Reset(instance: Handle) -> Status {
    call(instance, Function::Reset, Instance::reset)
}

pub unsafe fn fmi3DoStep(
    instance: Handle,
    time: f64,
    step: f64,
    _no_earlier_state: Flag,
    event: *mut Flag,
    terminate: *mut Flag,
    early_return: *mut Flag,
    last_time: *mut f64,
) -> Status {
    call(instance, Function::DoStep, |i| {
        check(event, 1, "eventHandlingNeeded")?;
        check(terminate, 1, "terminateSimulation")?;
        check(early_return, 1, "earlyReturn")?;
        check(last_time, 1, "lastSuccessfulTime")?;
        let outcome = i.step(time, step)?;
        // SAFETY: four values of the host, not null and aligned by the checks.
        unsafe {
            event.write(false.into());
            early_return.write(false.into());
            terminate.write(outcome.as_ref().is_ok_and(|finished| *finished).into());
            last_time.write(i.time());
        }
        Ok(outcome.map_or_else(Reply::Discard, |_| Reply::Done))
    })
}

macro_rules! numbers {
    ($($get:ident $get_row:ident $set:ident $set_row:ident $ty:ty;)*) => {$(
        pub unsafe fn $get(
            instance: Handle, references: *const u32, count: usize, values: *mut $ty, size: usize,
        ) -> Status {
            call(instance, Function::$get_row, |i| {
                // SAFETY: an array of the host.
                let references = unsafe { slice(references, count, "valueReferences") }?;
                i.expect(references, <$ty as Value>::TYPE, size)?;
                // SAFETY: an array of the host, of the expected size.
                let values = unsafe { slice_mut(values, size, "values") }?;
                i.get(references, values)
            })
        }

        pub unsafe fn $set(
            instance: Handle, references: *const u32, count: usize, values: *const $ty, size: usize,
        ) -> Status {
            call(instance, Function::$set_row, |i| {
                // SAFETY: an array of the host.
                let references = unsafe { slice(references, count, "valueReferences") }?;
                i.expect(references, <$ty as Value>::TYPE, size)?;
                // SAFETY: an array of the host, of the expected size.
                let values = unsafe { slice(values, size, "values") }?;
                i.set(references, values)
            })
        }
    )*};
}

numbers! {
    fmi3GetFloat32 GetFloat32 fmi3SetFloat32 SetFloat32 f32;
    fmi3GetFloat64 GetFloat64 fmi3SetFloat64 SetFloat64 f64;
    fmi3GetInt8 GetInt8 fmi3SetInt8 SetInt8 i8;
    fmi3GetUInt8 GetUInt8 fmi3SetUInt8 SetUInt8 u8;
    fmi3GetInt16 GetInt16 fmi3SetInt16 SetInt16 i16;
    fmi3GetUInt16 GetUInt16 fmi3SetUInt16 SetUInt16 u16;
    fmi3GetInt32 GetInt32 fmi3SetInt32 SetInt32 i32;
    fmi3GetUInt32 GetUInt32 fmi3SetUInt32 SetUInt32 u32;
    fmi3GetInt64 GetInt64 fmi3SetInt64 SetInt64 i64;
    fmi3GetUInt64 GetUInt64 fmi3SetUInt64 SetUInt64 u64;
}

pub unsafe fn fmi3GetBoolean(
    instance: Handle,
    references: *const u32,
    count: usize,
    values: *mut Flag,
    size: usize,
) -> Status {
    call(instance, Function::GetBoolean, |i| {
        // SAFETY: an array of the host.
        let references = unsafe { slice(references, count, "valueReferences") }?;
        i.expect(references, Type::Boolean, size)?;
        // SAFETY: an array of the host, of the expected size.
        let values = unsafe { slice_mut(values, size, "values") }?;
        let mut booleans = vec![false; size];
        i.get(references, &mut booleans)?;
        values.iter_mut().zip(booleans).for_each(|(flag, value)| *flag = value.into());
        Ok(())
    })
}

pub unsafe fn fmi3SetBoolean(
    instance: Handle,
    references: *const u32,
    count: usize,
    values: *const Flag,
    size: usize,
) -> Status {
    call(instance, Function::SetBoolean, |i| {
        // SAFETY: an array of the host.
        let references = unsafe { slice(references, count, "valueReferences") }?;
        i.expect(references, Type::Boolean, size)?;
        // SAFETY: an array of the host, of the expected size.
        let values = unsafe { slice(values, size, "values") }?;
        i.set(references, &values.iter().map(|flag| flag.is_set()).collect::<Vec<_>>())
    })
}

pub unsafe fn fmi3GetString(
    instance: Handle,
    references: *const u32,
    count: usize,
    values: *mut *const Char,
    size: usize,
) -> Status {
    call(instance, Function::GetString, |i| {
        // SAFETY: an array of the host.
        let references = unsafe { slice(references, count, "valueReferences") }?;
        i.expect(references, Type::String, size)?;
        // SAFETY: an array of the host, of the expected size.
        let values = unsafe { slice_mut(values, size, "values") }?;
        let mut strings = vec![String::new(); size];
        i.get(references, &mut strings)?;
        let strings = strings.into_iter().map(CString::new).collect::<Result<Vec<_>, _>>();
        i.strings = strings.map_err(|e| Error::Contract(format!("a string contains NUL: {e}")))?;
        values.iter_mut().zip(&i.strings).for_each(|(place, string)| *place = string.as_ptr().cast());
        Ok(())
    })
}

pub unsafe fn fmi3SetString(
    instance: Handle,
    references: *const u32,
    count: usize,
    values: *const *const Char,
    size: usize,
) -> Status {
    call(instance, Function::SetString, |i| {
        // SAFETY: an array of the host.
        let references = unsafe { slice(references, count, "valueReferences") }?;
        i.expect(references, Type::String, size)?;
        // SAFETY: an array of the host, of the expected size.
        let values = unsafe { slice(values, size, "values") }?;
        // SAFETY: strings of the host.
        let strings = values.iter().map(|value| unsafe { string(*value, "values") });
        i.set(references, &strings.collect::<Result<Vec<_>, _>>()?)
    })
}

pub unsafe fn fmi3GetBinary(
    instance: Handle,
    references: *const u32,
    count: usize,
    sizes: *mut usize,
    values: *mut *const u8,
    size: usize,
) -> Status {
    call(instance, Function::GetBinary, |i| {
        // SAFETY: an array of the host.
        let references = unsafe { slice(references, count, "valueReferences") }?;
        i.expect(references, Type::Binary, size)?;
        // SAFETY: two different arrays of the host, of the expected size.
        let (sizes, values) = unsafe { (slice_mut(sizes, size, "valueSizes")?, slice_mut(values, size, "values")?) };
        let mut binaries = vec![Vec::new(); size];
        i.get(references, &mut binaries)?;
        i.binaries = binaries;
        for ((size, value), bytes) in sizes.iter_mut().zip(values).zip(&i.binaries) {
            *size = bytes.len();
            *value = bytes.as_ptr();
        }
        Ok(())
    })
}

pub unsafe fn fmi3SetBinary(
    instance: Handle,
    references: *const u32,
    count: usize,
    sizes: *const usize,
    values: *const *const u8,
    size: usize,
) -> Status {
    call(instance, Function::SetBinary, |i| {
        // SAFETY: an array of the host.
        let references = unsafe { slice(references, count, "valueReferences") }?;
        i.expect(references, Type::Binary, size)?;
        // SAFETY: two arrays of the host, of the expected size.
        let (sizes, values) = unsafe { (slice(sizes, size, "valueSizes")?, slice(values, size, "values")?) };
        let binaries = sizes.iter().zip(values).map(|(&size, &value)| {
            // SAFETY: bytes of the host, of the size that the host says.
            unsafe { slice(value, size, "values") }.map(<[u8]>::to_vec)
        });
        i.set(references, &binaries.collect::<Result<Vec<_>, _>>()?)
    })
}

/// The key of a state; one that cannot be a key becomes 0 < `usize::MAX`, which no state has.
fn state_key(state: Handle) -> usize {
    key(state).unwrap_or(usize::MAX)
}

pub unsafe fn fmi3GetFMUState(instance: Handle, state: *mut Handle) -> Status {
    call(instance, Function::GetFMUState, |i| {
        // SAFETY: a value of the host.
        let state = unsafe { place(state, "FMUState") }?;
        *state = handle(i.save(state_key(*state))?);
        Ok(())
    })
}

pub unsafe fn fmi3SetFMUState(instance: Handle, state: Handle) -> Status {
    call(instance, Function::SetFMUState, |i| i.restore(state_key(state)))
}

pub unsafe fn fmi3FreeFMUState(instance: Handle, state: *mut Handle) -> Status {
    call(instance, Function::FreeFMUState, |i| {
        // SAFETY: a value of the host.
        let state = unsafe { place(state, "FMUState") }?;
        i.free_state(state_key(*state))?;
        *state = ptr::null_mut();
        Ok(())
    })
}

pub unsafe fn fmi3SerializedFMUStateSize(instance: Handle, state: Handle, size: *mut usize) -> Status {
    call(instance, Function::SerializedFMUStateSize, |i| {
        // SAFETY: a value of the host.
        let size = unsafe { place(size, "size") }?;
        *size = i.serialized_size(state_key(state))?;
        Ok(())
    })
}

pub unsafe fn fmi3SerializeFMUState(instance: Handle, state: Handle, bytes: *mut u8, size: usize) -> Status {
    call(instance, Function::SerializeFMUState, |i| {
        let serialized = i.serialize(state_key(state), size)?;
        // SAFETY: an array of the host, of the size that the state has.
        unsafe { slice_mut(bytes, size, "serializedState") }?.copy_from_slice(&serialized);
        Ok(())
    })
}

pub unsafe fn fmi3DeserializeFMUState(instance: Handle, bytes: *const u8, size: usize, state: *mut Handle) -> Status {
    call(instance, Function::DeserializeFMUState, |i| {
        // SAFETY: an array and a value of the host.
        let (bytes, state) = unsafe { (slice(bytes, size, "serializedState")?, place(state, "FMUState")?) };
        *state = handle(i.deserialize(bytes, state_key(*state))?);
        Ok(())
    })
}

macro_rules! derivatives {
    ($($name:ident $row:ident $direction:ident;)*) => {$(
        pub unsafe fn $name(
            instance: Handle, unknowns: *const u32, unknown_count: usize, knowns: *const u32,
            known_count: usize, seed: *const f64, seed_size: usize, sensitivity: *mut f64, size: usize,
        ) -> Status {
            call(instance, Function::$row, |i| {
                // SAFETY: two arrays of the host.
                let (unknowns, knowns) = unsafe {
                    (slice(unknowns, unknown_count, "unknowns")?, slice(knowns, known_count, "knowns")?)
                };
                i.expect_derivative(Direction::$direction, unknowns, knowns, seed_size, size)?;
                // SAFETY: two different arrays of the host, of the expected sizes.
                let (seed, sensitivity) = unsafe {
                    (slice(seed, seed_size, "seed")?, slice_mut(sensitivity, size, "sensitivity")?)
                };
                i.derivative(Direction::$direction, Product { unknowns, knowns, seed, sensitivity })
            })
        }
    )*};
}

derivatives! {
    fmi3GetDirectionalDerivative GetDirectionalDerivative Forward;
    fmi3GetAdjointDerivative GetAdjointDerivative Adjoint;
}

/// How C writes a type.
trait CType {
    fn c() -> String;
}

macro_rules! c_types {
    ($($ty:ty => $c:literal;)*) => {$(
        impl CType for $ty {
            fn c() -> String { $c.to_owned() }
        }
    )*};
}

c_types! {
    () => "void"; c_void => "void"; Char => "char"; Flag => "bool"; usize => "size_t";
    f32 => "float"; f64 => "double";
    i8 => "int8_t"; u8 => "uint8_t"; i16 => "int16_t"; u16 => "uint16_t";
    i32 => "int32_t"; u32 => "uint32_t"; i64 => "int64_t"; u64 => "uint64_t";
    Status => "fmi3Status"; DependencyKind => "fmi3DependencyKind";
    IntervalQualifier => "fmi3IntervalQualifier";
}

impl<T: CType> CType for *const T {
    fn c() -> String {
        format!("{} const*", T::c())
    }
}

impl<T: CType> CType for *mut T {
    fn c() -> String {
        format!("{}*", T::c())
    }
}

macro_rules! c_callbacks {
    ($(($($arg:ident)*))*) => {$(
        impl<$($arg: CType),*> CType for Option<unsafe extern "C" fn($($arg),*)> {
            fn c() -> String {
                let arguments: Vec<String> = vec![$($arg::c()),*];
                let arguments = if arguments.is_empty() { "void".to_owned() } else { arguments.join(", ") };
                format!("void (*)({arguments})")
            }
        }
    )*};
}

c_callbacks! { () (A) (A B C D) (A B C D E F G H) }

/// One declaration for each exported function, in C, made of the signatures that are exported. The
/// types `fmi3Status`, `fmi3DependencyKind` and `fmi3IntervalQualifier` must have been declared.
pub fn c_header() -> String {
    macro_rules! declare {
        ($(fn $name:ident($($arg:ident: $ty:ty),* $(,)?) -> $ret:ty;)*) => {
            [$({
                let arguments: Vec<String> = vec![$(<$ty as CType>::c()),*];
                let arguments = if arguments.is_empty() { "void".to_owned() } else { arguments.join(", ") };
                format!("{} {}({arguments});\n", <$ret as CType>::c(), stringify!($name))
            }),*].concat()
        };
    }
    macro_rules! header {
        ($(($($list:tt)*))*) => { [$(declare! { $($list)* }),*].concat() };
    }
    crate::__fmi3_functions! { __fmi3_groups header }
}

#[doc(hidden)]
#[macro_export]
macro_rules! __fmi3_groups {
    ([$then:ident] unit { $($a:tt)* } supported { $($b:tt)* } unsupported { $($c:tt)* }) => {
        $then! { ($($a)*) ($($b)*) ($($c)*) }
    };
}
