//! The C functions of FMI 2.0 that are used (fmi2FunctionTypes.h). Arrays are lists of scalars.

#![allow(unsafe_code)]

use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::Path;

use libloading::Library;

use super::description::VariableType;
use super::library::{Call, Common, Driver, Handle, Status, functions, keep, status, string};

type Get<T> = unsafe extern "C" fn(Handle, *const u32, usize, *mut T) -> c_int;
type Set<T> = unsafe extern "C" fn(Handle, *const u32, usize, *const T) -> c_int;
type Instantiate =
    unsafe extern "C" fn(*const c_char, c_int, *const c_char, *const c_char, *const Callbacks, c_int, c_int) -> Handle;
type Derivative = unsafe extern "C" fn(Handle, *const u32, usize, *const u32, usize, *const f64, *mut f64) -> c_int;

/// `fmi2Type` of a unit in co-simulation.
const CO_SIMULATION: c_int = 1;

/// `fmi2CallbackFunctions`.
#[repr(C)]
pub(super) struct Callbacks {
    logger: unsafe extern "C" fn(Handle, *const c_char, c_int, *const c_char, *const c_char, ...),
    allocate: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free: unsafe extern "C" fn(*mut c_void),
    finished: Option<unsafe extern "C" fn(Handle, c_int)>,
    environment: Handle,
}

/// What the logger is given.
#[repr(C)]
struct Environment {
    keep: unsafe extern "C" fn(Handle, c_int, *const c_char),
    messages: Handle,
}

unsafe extern "C" {
    /// In `log2.c`: a function with a variable number of arguments cannot be written in Rust. It fills in the values of a
    /// message, and passes it to the [`Environment`].
    fn orchestrator_fmi2_log(
        environment: Handle,
        instance: *const c_char,
        status: c_int,
        category: *const c_char,
        message: *const c_char,
        ...
    );
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(memory: *mut c_void);
}

/// Keeps a message.
unsafe extern "C" fn log(messages: Handle, code: c_int, message: *const c_char) {
    // SAFETY: the box of messages outlives the instance; the message is a C string.
    unsafe { keep(messages, code, message) }
}

functions! { Functions:
    instantiate: Instantiate;
    set_up: unsafe extern "C" fn(Handle, c_int, f64, f64, c_int, f64) -> c_int;
    enter: Call;
    exit: Call;
    get_real: Get<f64>;
    set_real: Set<f64>;
    get_integer: Get<c_int>;
    set_integer: Set<c_int>;
    get_boolean: Get<c_int>;
    set_boolean: Set<c_int>;
    get_string: Get<*const c_char>;
    set_string: Set<*const c_char>;
    do_step: unsafe extern "C" fn(Handle, f64, f64, c_int) -> c_int;
    derivative: Derivative;
}

/// The functions, and what the unit keeps a pointer to.
struct Two {
    functions: Functions,
    _callbacks: Box<Callbacks>,
    _environment: Box<Environment>,
}

/// Makes an instance; its handle may be null.
pub(crate) fn open(
    library: &Library,
    name: &CStr,
    token: &CStr,
    resources: &Path,
    messages: Handle,
) -> Result<(Handle, Common, Box<dyn Driver>), String> {
    let common = Common::load(
        library,
        [
            c"fmi2FreeInstance",
            c"fmi2Terminate",
            c"fmi2GetFMUstate",
            c"fmi2SetFMUstate",
            c"fmi2FreeFMUstate",
            c"fmi2SerializedFMUstateSize",
            c"fmi2SerializeFMUstate",
            c"fmi2DeSerializeFMUstate",
        ],
    )?;
    let functions = Functions::load(
        library,
        [
            c"fmi2Instantiate",
            c"fmi2SetupExperiment",
            c"fmi2EnterInitializationMode",
            c"fmi2ExitInitializationMode",
            c"fmi2GetReal",
            c"fmi2SetReal",
            c"fmi2GetInteger",
            c"fmi2SetInteger",
            c"fmi2GetBoolean",
            c"fmi2SetBoolean",
            c"fmi2GetString",
            c"fmi2SetString",
            c"fmi2DoStep",
            c"fmi2GetDirectionalDerivative",
        ],
    )?;
    let resources = string(&format!("file://{}", resources.display()))?;
    let logger = Box::new(Environment { keep: log, messages });
    let environment = (&raw const *logger).cast_mut().cast();
    let callbacks =
        Box::new(Callbacks { logger: orchestrator_fmi2_log, allocate: calloc, free, finished: None, environment });
    let (visible, logging) = (0, 1);
    // SAFETY: strings live through the call, environment and callbacks as long as the instance.
    let handle = unsafe {
        let (name, token, resources) = (name.as_ptr(), token.as_ptr(), resources.as_ptr());
        (functions.instantiate)(name, CO_SIMULATION, token, resources, &raw const *callbacks, visible, logging)
    };
    Ok((handle, common, Box::new(Two { functions, _callbacks: callbacks, _environment: logger })))
}

fn get<T: Copy + Default + Into<f64>>(
    handle: Handle,
    function: Get<T>,
    references: &[u32],
    values: &mut [f64],
) -> Status {
    let mut list = vec![T::default(); values.len()];
    // SAFETY: as many values as references.
    let code = unsafe { function(handle, references.as_ptr(), references.len(), list.as_mut_ptr()) };
    values.iter_mut().zip(list).for_each(|(value, item)| *value = item.into());
    status(code)
}

fn set<T>(handle: Handle, function: Set<T>, references: &[u32], values: &[T]) -> Status {
    // SAFETY: as many values as references.
    status(unsafe { function(handle, references.as_ptr(), references.len(), values.as_ptr()) })
}

impl Driver for Two {
    fn initialise(&self, handle: Handle, start: f64, stop: f64) -> Status {
        let f = &self.functions;
        // SAFETY: no pointers but the handle.
        let mut code = unsafe { (f.set_up)(handle, 0, 0.0, start, 1, stop) };
        for call in [f.enter, f.exit] {
            if status(code) == Status::Ok {
                code = unsafe { call(handle) };
            }
        }
        status(code)
    }

    fn get(&self, handle: Handle, ty: VariableType, references: &[u32], values: &mut [f64]) -> Status {
        match ty {
            VariableType::Float64 => get(handle, self.functions.get_real, references, values),
            VariableType::Int32 => get(handle, self.functions.get_integer, references, values),
            VariableType::Boolean => get(handle, self.functions.get_boolean, references, values),
            _ => Status::Error,
        }
    }

    fn set(&self, handle: Handle, ty: VariableType, references: &[u32], values: &[f64]) -> Status {
        let integers: Vec<c_int> = values.iter().map(|&v| v as c_int).collect();
        match ty {
            VariableType::Float64 => set(handle, self.functions.set_real, references, values),
            VariableType::Int32 => set(handle, self.functions.set_integer, references, &integers),
            VariableType::Boolean => set(handle, self.functions.set_boolean, references, &integers),
            _ => Status::Error,
        }
    }

    fn get_text(&self, handle: Handle, reference: u32, text: &mut *const c_char) -> Status {
        // SAFETY: one reference, one value.
        status(unsafe { (self.functions.get_string)(handle, &raw const reference, 1, text) })
    }

    fn set_text(&self, handle: Handle, reference: u32, text: &CStr) -> Status {
        set(handle, self.functions.set_string, &[reference], &[text.as_ptr()])
    }

    fn step(&self, handle: Handle, time: f64, step: f64) -> (Status, bool) {
        // SAFETY: no pointers but the handle. Earlier states may be restored.
        (status(unsafe { (self.functions.do_step)(handle, time, step, 0) }), false)
    }

    fn derivative(&self, handle: Handle, unknown: &[u32], known: &[u32], seed: &[f64], result: &mut [f64]) -> Status {
        // SAFETY: as many values as references.
        status(unsafe {
            (self.functions.derivative)(
                handle,
                unknown.as_ptr(),
                unknown.len(),
                known.as_ptr(),
                known.len(),
                seed.as_ptr(),
                result.as_mut_ptr(),
            )
        })
    }
}
