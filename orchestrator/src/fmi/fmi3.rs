//! The C functions of FMI 3.0 that are used (fmi3FunctionTypes.h).

#![allow(unsafe_code)]

use std::ffi::{CStr, c_char, c_int};
use std::path::{MAIN_SEPARATOR, Path};
use std::ptr;

use libloading::Library;

use super::description::VariableType;
use super::library::{Call, Common, Driver, Handle, Status, functions, keep, status, string};

type Log = Option<unsafe extern "C" fn(Handle, c_int, *const c_char, *const c_char)>;
type Intermediate = Option<unsafe extern "C" fn(Handle, f64, bool, bool, bool, bool, bool, *mut bool, *mut f64)>;
type Instantiate = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    bool,
    bool,
    *const u32,
    usize,
    Handle,
    Log,
    Intermediate,
) -> Handle;
type Get<T> = unsafe extern "C" fn(Handle, *const u32, usize, *mut T, usize) -> c_int;
type Set<T> = unsafe extern "C" fn(Handle, *const u32, usize, *const T, usize) -> c_int;
type Enter = unsafe extern "C" fn(Handle, bool, f64, f64, bool, f64) -> c_int;
type DoStep = unsafe extern "C" fn(Handle, f64, f64, bool, *mut bool, *mut bool, *mut bool, *mut f64) -> c_int;
type Derivative =
    unsafe extern "C" fn(Handle, *const u32, usize, *const u32, usize, *const f64, usize, *mut f64, usize) -> c_int;

functions! { Functions:
    instantiate: Instantiate;
    enter: Enter;
    exit: Call;
    get_f64: Get<f64>;
    set_f64: Set<f64>;
    get_i64: Get<i64>;
    set_i64: Set<i64>;
    get_u64: Get<u64>;
    set_u64: Set<u64>;
    get_i32: Get<i32>;
    set_i32: Set<i32>;
    get_boolean: Get<bool>;
    set_boolean: Set<bool>;
    get_string: Get<*const c_char>;
    set_string: Set<*const c_char>;
    do_step: DoStep;
    derivative: Derivative;
}

/// Keeps a message. Called by the unit, maybe from another thread.
unsafe extern "C" fn log(environment: Handle, code: c_int, _category: *const c_char, message: *const c_char) {
    // SAFETY: the environment is the box of messages, which outlives the instance; the message is a C string.
    unsafe { keep(environment, code, message) }
}

/// Makes an instance; its handle may be null.
pub(crate) fn open(
    library: &Library,
    name: &CStr,
    token: &CStr,
    resources: &Path,
    environment: Handle,
) -> Result<(Handle, Common, Box<dyn Driver>), String> {
    let common = Common::load(
        library,
        [
            c"fmi3FreeInstance",
            c"fmi3Terminate",
            c"fmi3GetFMUState",
            c"fmi3SetFMUState",
            c"fmi3FreeFMUState",
            c"fmi3SerializedFMUStateSize",
            c"fmi3SerializeFMUState",
            c"fmi3DeserializeFMUState",
        ],
    )?;
    let functions = Functions::load(
        library,
        [
            c"fmi3InstantiateCoSimulation",
            c"fmi3EnterInitializationMode",
            c"fmi3ExitInitializationMode",
            c"fmi3GetFloat64",
            c"fmi3SetFloat64",
            c"fmi3GetInt64",
            c"fmi3SetInt64",
            c"fmi3GetUInt64",
            c"fmi3SetUInt64",
            c"fmi3GetInt32",
            c"fmi3SetInt32",
            c"fmi3GetBoolean",
            c"fmi3SetBoolean",
            c"fmi3GetString",
            c"fmi3SetString",
            c"fmi3DoStep",
            c"fmi3GetDirectionalDerivative",
        ],
    )?;
    // The standard wants the path to end with a separator.
    let resources = string(&format!("{}{MAIN_SEPARATOR}", resources.display()))?;
    // Logging: the reasons of discarded steps are wanted.
    let (visible, logging, events, early) = (false, true, false, false);
    // SAFETY: strings and environment live through the call, the environment as long as the instance.
    let handle = unsafe {
        (functions.instantiate)(
            name.as_ptr(),
            token.as_ptr(),
            resources.as_ptr(),
            visible,
            logging,
            events,
            early,
            ptr::null(),
            0,
            environment,
            Some(log),
            None,
        )
    };
    Ok((handle, common, Box::new(functions)))
}

fn get<T: Copy + Default>(
    handle: Handle,
    function: Get<T>,
    references: &[u32],
    values: &mut [f64],
    number: fn(T) -> f64,
) -> Status {
    let mut list = vec![T::default(); values.len()];
    // SAFETY: as many references and values as is said.
    let code = unsafe { function(handle, references.as_ptr(), references.len(), list.as_mut_ptr(), list.len()) };
    values.iter_mut().zip(list).for_each(|(value, item)| *value = number(item));
    status(code)
}

fn set<T>(handle: Handle, function: Set<T>, references: &[u32], values: &[T]) -> Status {
    // SAFETY: as many references and values as is said.
    status(unsafe { function(handle, references.as_ptr(), references.len(), values.as_ptr(), values.len()) })
}

impl Driver for Functions {
    fn initialise(&self, handle: Handle, start: f64, stop: f64) -> Status {
        // SAFETY: no pointers but the handle.
        match status(unsafe { (self.enter)(handle, false, 0.0, start, true, stop) }) {
            Status::Ok => status(unsafe { (self.exit)(handle) }),
            failed => failed,
        }
    }

    fn get(&self, handle: Handle, ty: VariableType, references: &[u32], values: &mut [f64]) -> Status {
        match ty {
            VariableType::Float64 => get(handle, self.get_f64, references, values, |v| v),
            VariableType::Int64 => get(handle, self.get_i64, references, values, |v| v as f64),
            VariableType::UInt64 => get(handle, self.get_u64, references, values, |v| v as f64),
            VariableType::Int32 => get(handle, self.get_i32, references, values, f64::from),
            VariableType::Boolean => get(handle, self.get_boolean, references, values, |v| f64::from(u8::from(v))),
            VariableType::String | VariableType::Other => Status::Error,
        }
    }

    fn set(&self, handle: Handle, ty: VariableType, references: &[u32], values: &[f64]) -> Status {
        fn list<T>(values: &[f64], item: fn(f64) -> T) -> Vec<T> {
            values.iter().map(|&v| item(v)).collect()
        }
        match ty {
            VariableType::Float64 => set(handle, self.set_f64, references, values),
            VariableType::Int64 => set(handle, self.set_i64, references, &list(values, |v| v as i64)),
            VariableType::UInt64 => set(handle, self.set_u64, references, &list(values, |v| v as u64)),
            VariableType::Int32 => set(handle, self.set_i32, references, &list(values, |v| v as i32)),
            VariableType::Boolean => set(handle, self.set_boolean, references, &list(values, |v| v != 0.0)),
            VariableType::String | VariableType::Other => Status::Error,
        }
    }

    fn get_text(&self, handle: Handle, reference: u32, text: &mut *const c_char) -> Status {
        // SAFETY: one reference, one value.
        status(unsafe { (self.get_string)(handle, &raw const reference, 1, text, 1) })
    }

    fn set_text(&self, handle: Handle, reference: u32, text: &CStr) -> Status {
        set(handle, self.set_string, &[reference], &[text.as_ptr()])
    }

    fn step(&self, handle: Handle, time: f64, step: f64) -> (Status, bool) {
        let (mut event, mut terminate, mut early, mut last) = (false, false, false, time);
        // SAFETY: four places for results. Earlier states may be restored.
        let code =
            unsafe { (self.do_step)(handle, time, step, false, &mut event, &mut terminate, &mut early, &mut last) };
        (status(code), terminate)
    }

    fn derivative(&self, handle: Handle, unknown: &[u32], known: &[u32], seed: &[f64], result: &mut [f64]) -> Status {
        // SAFETY: references and arrays of the lengths that are said.
        status(unsafe {
            (self.derivative)(
                handle,
                unknown.as_ptr(),
                unknown.len(),
                known.as_ptr(),
                known.len(),
                seed.as_ptr(),
                seed.len(),
                result.as_mut_ptr(),
                result.len(),
            )
        })
    }
}
