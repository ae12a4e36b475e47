//! The C functions of FMI 3.0 that are used (fmi3FunctionTypes.h), and the library that has them.

#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::Path;
use std::ptr;
use std::sync::{Mutex, PoisonError};

use libloading::Library;

type Handle = *mut c_void;
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
type Call = unsafe extern "C" fn(Handle) -> c_int;
type Get<T> = unsafe extern "C" fn(Handle, *const u32, usize, *mut T, usize) -> c_int;
type Set<T> = unsafe extern "C" fn(Handle, *const u32, usize, *const T, usize) -> c_int;
type Enter = unsafe extern "C" fn(Handle, bool, f64, f64, bool, f64) -> c_int;
type DoStep = unsafe extern "C" fn(Handle, f64, f64, bool, *mut bool, *mut bool, *mut bool, *mut f64) -> c_int;
type Derivative =
    unsafe extern "C" fn(Handle, *const u32, usize, *const u32, usize, *const f64, usize, *mut f64, usize) -> c_int;

/// What a C function returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    /// Done, maybe with a warning.
    Ok,
    /// Refused; the state is as before.
    Discard,
    /// Failed.
    Error,
}

/// Messages of a unit, oldest first.
pub(crate) type Messages = Mutex<Vec<String>>;

/// An instance with the library it lives in. Dropping it frees both.
pub(crate) struct Instance {
    handle: Handle,
    kept: Handle,
    messages: Box<Messages>,
    functions: Functions,
    // Last: the functions are in it.
    _library: Library,
}

macro_rules! functions {
    ($($field:ident: $ty:ty = $name:literal;)*) => {
        struct Functions { $($field: $ty,)* }

        impl Functions {
            fn load(library: &Library) -> Result<Self, String> {
                // SAFETY: the types are those of the standard's header.
                Ok(Self { $($field: unsafe {
                    *library.get::<$ty>($name).map_err(|e| format!("the library lacks a function: {e}"))?
                },)* })
            }
        }
    };
}

functions! {
    instantiate: Instantiate = "fmi3InstantiateCoSimulation";
    free: unsafe extern "C" fn(Handle) = "fmi3FreeInstance";
    enter: Enter = "fmi3EnterInitializationMode";
    exit: Call = "fmi3ExitInitializationMode";
    terminate: Call = "fmi3Terminate";
    get_f64: Get<f64> = "fmi3GetFloat64";
    set_f64: Set<f64> = "fmi3SetFloat64";
    get_i64: Get<i64> = "fmi3GetInt64";
    get_u64: Get<u64> = "fmi3GetUInt64";
    get_i32: Get<i32> = "fmi3GetInt32";
    get_string: Get<*const c_char> = "fmi3GetString";
    do_step: DoStep = "fmi3DoStep";
    get_state: unsafe extern "C" fn(Handle, *mut Handle) -> c_int = "fmi3GetFMUState";
    set_state: unsafe extern "C" fn(Handle, Handle) -> c_int = "fmi3SetFMUState";
    free_state: unsafe extern "C" fn(Handle, *mut Handle) -> c_int = "fmi3FreeFMUState";
    state_size: unsafe extern "C" fn(Handle, Handle, *mut usize) -> c_int = "fmi3SerializedFMUStateSize";
    serialise: unsafe extern "C" fn(Handle, Handle, *mut u8, usize) -> c_int = "fmi3SerializeFMUState";
    deserialise: unsafe extern "C" fn(Handle, *const u8, usize, *mut Handle) -> c_int = "fmi3DeserializeFMUState";
    derivative: Derivative = "fmi3GetDirectionalDerivative";
}

fn status(code: c_int) -> Status {
    match code {
        0 | 1 => Status::Ok,
        2 => Status::Discard,
        _ => Status::Error,
    }
}

/// Keeps a message. Called by the unit, maybe from another thread.
unsafe extern "C" fn log(environment: Handle, code: c_int, _category: *const c_char, message: *const c_char) {
    if environment.is_null() || message.is_null() || status(code) == Status::Ok {
        return;
    }
    // SAFETY: the environment is the box of messages, which outlives the instance; the message is a C string.
    let (messages, message) = unsafe { (&*environment.cast::<Messages>(), CStr::from_ptr(message)) };
    // `#` has a meaning in messages and is doubled where it stands for itself.
    let message = message.to_string_lossy().replace("##", "#");
    messages.lock().unwrap_or_else(PoisonError::into_inner).push(message);
}

impl Instance {
    /// Loads the library and makes an instance.
    pub(crate) fn new(library: &Path, name: &str, token: &str, resources: &Path) -> Result<Self, String> {
        // SAFETY: loading runs the library's initialisers: an FMU is code that the user chose to run.
        let library = unsafe { Library::new(library) }.map_err(|e| format!("its library cannot be loaded: {e}"))?;
        let functions = Functions::load(&library)?;
        let string = |text: &str| CString::new(text).map_err(|_| format!("{text:?} holds a NUL"));
        // The standard wants the path to end with a separator.
        let resources = format!("{}{}", resources.display(), std::path::MAIN_SEPARATOR);
        let (name, token, resources) = (string(name)?, string(token)?, string(&resources)?);
        let messages: Box<Messages> = Box::default();
        let environment = ptr::from_ref::<Messages>(&messages).cast_mut().cast();
        // SAFETY: strings and environment live through the call, the environment as long as the instance.
        let handle = unsafe {
            (functions.instantiate)(
                name.as_ptr(),
                token.as_ptr(),
                resources.as_ptr(),
                false,
                // Logging: the reasons of discarded steps are wanted.
                true,
                false,
                false,
                ptr::null(),
                0,
                environment,
                Some(log),
                None,
            )
        };
        let instance = Self { handle, kept: ptr::null_mut(), messages, functions, _library: library };
        if handle.is_null() { Err(format!("no instance: {}", instance.take_messages())) } else { Ok(instance) }
    }

    /// What the unit has said since the last call.
    pub(crate) fn take_messages(&self) -> String {
        std::mem::take(&mut *self.messages.lock().unwrap_or_else(PoisonError::into_inner)).join("; ")
    }

    pub(crate) fn initialise(&mut self, start: f64, stop: f64) -> Status {
        // SAFETY: the handle is that of a live instance, here and below.
        match status(unsafe { (self.functions.enter)(self.handle, false, 0.0, start, true, stop) }) {
            Status::Ok => status(unsafe { (self.functions.exit)(self.handle) }),
            failed => failed,
        }
    }

    pub(crate) fn get_f64(&mut self, reference: u32, values: &mut [f64]) -> Status {
        self.get(self.functions.get_f64, reference, values)
    }

    pub(crate) fn get_i64(&mut self, reference: u32, values: &mut [i64]) -> Status {
        self.get(self.functions.get_i64, reference, values)
    }

    pub(crate) fn get_u64(&mut self, reference: u32, values: &mut [u64]) -> Status {
        self.get(self.functions.get_u64, reference, values)
    }

    pub(crate) fn get_i32(&mut self, reference: u32, values: &mut [i32]) -> Status {
        self.get(self.functions.get_i32, reference, values)
    }

    fn get<T>(&mut self, function: Get<T>, reference: u32, values: &mut [T]) -> Status {
        // SAFETY: one reference, and as many values as is said.
        status(unsafe { function(self.handle, &raw const reference, 1, values.as_mut_ptr(), values.len()) })
    }

    pub(crate) fn get_string(&mut self, reference: u32) -> Result<String, Status> {
        let mut value = [ptr::null()];
        match self.get(self.functions.get_string, reference, &mut value) {
            Status::Ok if value[0].is_null() => Ok(String::new()),
            // SAFETY: a C string that lives until the next call.
            Status::Ok => Ok(unsafe { CStr::from_ptr(value[0]) }.to_string_lossy().into_owned()),
            failed => Err(failed),
        }
    }

    pub(crate) fn set_f64(&mut self, reference: u32, values: &[f64]) -> Status {
        // SAFETY: one reference, and as many values as is said.
        status(unsafe { (self.functions.set_f64)(self.handle, &raw const reference, 1, values.as_ptr(), values.len()) })
    }

    /// Does a time step; tells whether the unit wants the simulation to end.
    pub(crate) fn step(&mut self, time: f64, step: f64) -> (Status, bool) {
        let (mut event, mut terminate, mut early, mut last) = (false, false, false, time);
        // SAFETY: four places for results. Earlier states may be restored.
        let code = unsafe {
            (self.functions.do_step)(self.handle, time, step, false, &mut event, &mut terminate, &mut early, &mut last)
        };
        (status(code), terminate)
    }

    /// Keeps the present state in place of the one kept before.
    pub(crate) fn save(&mut self) -> Status {
        // SAFETY: the kept state is null or one of this instance.
        status(unsafe { (self.functions.get_state)(self.handle, &mut self.kept) })
    }

    /// Goes back to the kept state, if there is one.
    pub(crate) fn restore(&mut self) -> Option<Status> {
        // SAFETY: the kept state is one of this instance.
        (!self.kept.is_null()).then(|| status(unsafe { (self.functions.set_state)(self.handle, self.kept) }))
    }

    pub(crate) fn serialise(&mut self) -> Result<Vec<u8>, Status> {
        let mut state = ptr::null_mut();
        // SAFETY: a new state of this instance, which is freed below; the bytes have the size that was asked for.
        unsafe {
            ok((self.functions.get_state)(self.handle, &mut state))?;
            let mut size = 0;
            let mut bytes = Vec::new();
            let mut code = (self.functions.state_size)(self.handle, state, &mut size);
            if status(code) == Status::Ok {
                bytes.resize(size, 0);
                code = (self.functions.serialise)(self.handle, state, bytes.as_mut_ptr(), size);
            }
            (self.functions.free_state)(self.handle, &mut state);
            ok(code).map(|()| bytes)
        }
    }

    pub(crate) fn deserialise(&mut self, bytes: &[u8]) -> Result<(), Status> {
        let mut state = ptr::null_mut();
        // SAFETY: a new state of this instance, which is freed below.
        unsafe {
            ok((self.functions.deserialise)(self.handle, bytes.as_ptr(), bytes.len(), &mut state))?;
            let code = (self.functions.set_state)(self.handle, state);
            (self.functions.free_state)(self.handle, &mut state);
            ok(code)
        }
    }

    pub(crate) fn derivative(&mut self, unknown: u32, known: u32, seed: &[f64], result: &mut [f64]) -> Status {
        // SAFETY: one reference each, and arrays of the lengths that are said.
        status(unsafe {
            (self.functions.derivative)(
                self.handle,
                &raw const unknown,
                1,
                &raw const known,
                1,
                seed.as_ptr(),
                seed.len(),
                result.as_mut_ptr(),
                result.len(),
            )
        })
    }
}

fn ok(code: c_int) -> Result<(), Status> {
    match status(code) {
        Status::Ok => Ok(()),
        failed => Err(failed),
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.handle.is_null() {
            return;
        }
        // SAFETY: the last calls; states go before their instance.
        unsafe {
            if !self.kept.is_null() {
                (self.functions.free_state)(self.handle, &mut self.kept);
            }
            (self.functions.terminate)(self.handle);
            (self.functions.free)(self.handle);
        }
    }
}
