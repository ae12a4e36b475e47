//! Instances of FMUs behind their C functions, of FMI 3.0 and 2.0: what both versions have alike. What they have not is in
//! `fmi3` and `fmi2`.

#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::Path;
use std::ptr;
use std::sync::{Mutex, PoisonError};

use libloading::Library;

use super::description::{VariableType, Version};
use super::{fmi2, fmi3};
use crate::unit::Calls;

pub(crate) type Handle = *mut c_void;
pub(crate) type Call = unsafe extern "C" fn(Handle) -> c_int;

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

/// Makes a struct of C functions, and its function `load`.
macro_rules! functions {
    ($name:ident: $($field:ident: $ty:ty;)*) => {
        pub(crate) struct $name { $(pub(crate) $field: $ty,)* }

        impl $name {
            /// Looks up the functions by their names, in the order of the fields.
            pub(crate) fn load(
                library: &libloading::Library,
                names: [&std::ffi::CStr; [$(stringify!($field)),*].len()],
            ) -> Result<Self, String> {
                let mut names = names.into_iter();
                let mut next = || names.next().unwrap_or_default().to_bytes_with_nul();
                // SAFETY: the types are those of the standard's header.
                Ok(Self { $($field: unsafe {
                    *library.get::<$ty>(next()).map_err(|e| format!("the library lacks a function: {e}"))?
                },)* })
            }
        }
    };
}
pub(crate) use functions;

functions! { Common:
    free: unsafe extern "C" fn(Handle);
    terminate: Call;
    get_state: unsafe extern "C" fn(Handle, *mut Handle) -> c_int;
    set_state: unsafe extern "C" fn(Handle, Handle) -> c_int;
    free_state: unsafe extern "C" fn(Handle, *mut Handle) -> c_int;
    state_size: unsafe extern "C" fn(Handle, Handle, *mut usize) -> c_int;
    serialise: unsafe extern "C" fn(Handle, Handle, *mut u8, usize) -> c_int;
    deserialise: unsafe extern "C" fn(Handle, *const u8, usize, *mut Handle) -> c_int;
}

/// What the two versions have each in its own way. `handle` is always that of a live instance.
pub(crate) trait Driver {
    /// Through initialisation.
    fn initialise(&self, handle: Handle, start: f64, stop: f64) -> Status;
    /// Values of variables of one type; numbers and truth values become `f64`.
    fn get(&self, handle: Handle, ty: VariableType, references: &[u32], values: &mut [f64]) -> Status;
    /// The other way round.
    fn set(&self, handle: Handle, ty: VariableType, references: &[u32], values: &[f64]) -> Status;
    /// A text; null where there is none. It lives until the next call.
    fn get_text(&self, handle: Handle, reference: u32, text: &mut *const c_char) -> Status;
    /// Sets a text.
    fn set_text(&self, handle: Handle, reference: u32, text: &CStr) -> Status;
    /// A time step; tells whether the unit wants the simulation to end.
    fn step(&self, handle: Handle, time: f64, step: f64) -> (Status, bool);
    /// Directional derivative.
    fn derivative(&self, handle: Handle, unknown: &[u32], known: &[u32], seed: &[f64], result: &mut [f64]) -> Status;
}

pub(crate) fn status(code: c_int) -> Status {
    match code {
        0 | 1 => Status::Ok,
        2 => Status::Discard,
        _ => Status::Error,
    }
}

/// Keeps a message from a warning on.
///
/// # Safety
/// `environment` is null or the messages of a live instance, `message` null or a C string.
pub(crate) unsafe fn keep(environment: Handle, code: c_int, message: *const c_char) {
    if environment.is_null() || message.is_null() || code == 0 {
        return;
    }
    // SAFETY: see above.
    let (messages, message) = unsafe { (&*environment.cast::<Messages>(), CStr::from_ptr(message)) };
    // `#` has a meaning in messages and is doubled where it stands for itself.
    let message = message.to_string_lossy().trim().replace("##", "#");
    messages.lock().unwrap_or_else(PoisonError::into_inner).push(message);
}

pub(crate) fn string(text: &str) -> Result<CString, String> {
    CString::new(text).map_err(|_| format!("{text:?} holds a NUL"))
}

/// Loads a library. One that leaves the functions of Python to its host, as those that are made with pythonfmu3, is
/// loaded after the shared library of `python3`, or of the program that `ORCHESTRATOR_PYTHON` names.
fn load(path: &Path) -> Result<Library, String> {
    // SAFETY: loading runs the library's initialisers: an FMU is code that the user chose to run.
    #[cfg(unix)]
    let library = unsafe {
        use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_LOCAL, RTLD_NOW};
        let open = || Library::open(Some(path), RTLD_NOW | RTLD_LOCAL);
        match open() {
            Err(error) if error.to_string().contains("undefined symbol: Py") || error.to_string().contains("_Py") => {
                let python =
                    python_library().map_err(|reason| format!("its library needs that of Python: {reason}"))?;
                let python = Library::open(Some(&python), RTLD_NOW | RTLD_GLOBAL).map_err(|e| e.to_string())?;
                // Python does not bear to be unloaded.
                std::mem::forget(python);
                open()
            }
            other => other,
        }
    };
    #[cfg(not(unix))]
    // SAFETY: as above.
    let library = unsafe { libloading::Library::new(path) };
    library.map(Library::from).map_err(|e| format!("its library cannot be loaded: {e}"))
}

/// Where the shared library of Python is.
#[cfg(unix)]
fn python_library() -> Result<std::path::PathBuf, String> {
    const QUESTION: &str =
        "import sysconfig as s; print(s.get_config_var('LIBDIR') + '/' + s.get_config_var('INSTSONAME'))";
    let program = std::env::var_os("ORCHESTRATOR_PYTHON").unwrap_or_else(|| "python3".into());
    let shown = program.to_string_lossy().into_owned();
    let output = std::process::Command::new(&program).args(["-c", QUESTION]).output();
    let output = output.map_err(|e| format!("{shown}: {e} (ORCHESTRATOR_PYTHON names another)"))?;
    let path = std::path::PathBuf::from(String::from_utf8_lossy(&output.stdout).trim());
    if output.status.success() && path.extension().is_none_or(|e| e != "a") && path.is_file() {
        Ok(path)
    } else {
        Err(format!("{shown} has no shared library (ORCHESTRATOR_PYTHON names another)"))
    }
}

/// An instance with the library it lives in. Dropping it frees both.
pub(crate) struct Instance {
    handle: Handle,
    kept: Handle,
    messages: Box<Messages>,
    /// What it was called for.
    pub(crate) calls: Calls,
    functions: Common,
    driver: Box<dyn Driver>,
    // Last: the functions are in it.
    _library: Library,
}

impl Instance {
    /// Loads the library and makes an instance.
    pub(crate) fn new(
        version: Version,
        library: &Path,
        name: &str,
        token: &str,
        resources: &Path,
    ) -> Result<Self, String> {
        let library = load(library)?;
        let messages: Box<Messages> = Box::default();
        let environment = ptr::from_ref::<Messages>(&messages).cast_mut().cast();
        let (name, token) = (string(name)?, string(token)?);
        let open = if version == Version::Two { fmi2::open } else { fmi3::open };
        let mut calls = Calls::default();
        let opened = calls.start.time(|| open(&library, &name, &token, resources, environment));
        let (handle, functions, driver) = opened?;
        let instance = Self { handle, kept: ptr::null_mut(), messages, calls, functions, driver, _library: library };
        if handle.is_null() { Err(format!("no instance: {}", instance.take_messages())) } else { Ok(instance) }
    }

    /// What the unit has said since the last call.
    pub(crate) fn take_messages(&self) -> String {
        self.take_list().join("; ")
    }

    pub(crate) fn take_list(&self) -> Vec<String> {
        std::mem::take(&mut *self.messages.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn initialise(&mut self, start: f64, stop: f64) -> Status {
        self.calls.start.time(|| self.driver.initialise(self.handle, start, stop))
    }

    /// Values of a variable: one reference of an array, or one for each entry.
    pub(crate) fn get(&mut self, ty: VariableType, references: &[u32], values: &mut [f64]) -> Status {
        self.calls.get.time(|| self.driver.get(self.handle, ty, references, values))
    }

    pub(crate) fn set(&mut self, ty: VariableType, references: &[u32], values: &[f64]) -> Status {
        self.calls.set.time(|| self.driver.set(self.handle, ty, references, values))
    }

    pub(crate) fn get_text(&mut self, reference: u32) -> Result<String, Status> {
        let mut text = ptr::null();
        ok(self.driver.get_text(self.handle, reference, &mut text))?;
        // SAFETY: null or a C string that lives until the next call.
        Ok(if text.is_null() { String::new() } else { unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned() })
    }

    pub(crate) fn set_text(&mut self, reference: u32, text: &str) -> Result<Status, String> {
        Ok(self.driver.set_text(self.handle, reference, &string(text)?))
    }

    /// Does a time step; tells whether the unit wants the simulation to end.
    pub(crate) fn step(&mut self, time: f64, step: f64) -> (Status, bool) {
        self.calls.step.time(|| self.driver.step(self.handle, time, step))
    }

    pub(crate) fn derivative(&mut self, unknown: &[u32], known: &[u32], seed: &[f64], result: &mut [f64]) -> Status {
        self.calls.derivative.time(|| self.driver.derivative(self.handle, unknown, known, seed, result))
    }

    /// Keeps the present state in place of the one kept before.
    pub(crate) fn save(&mut self) -> Status {
        // SAFETY: the kept state is null or one of this instance, which is live, here and below.
        self.calls.state.time(|| status(unsafe { (self.functions.get_state)(self.handle, &mut self.kept) }))
    }

    /// Goes back to the kept state, if there is one.
    pub(crate) fn restore(&mut self) -> Option<Status> {
        if self.kept.is_null() {
            return None;
        }
        // SAFETY: the kept state is one of this instance.
        Some(self.calls.state.time(|| status(unsafe { (self.functions.set_state)(self.handle, self.kept) })))
    }

    pub(crate) fn serialise(&mut self) -> Result<Vec<u8>, Status> {
        let mut state = ptr::null_mut();
        // SAFETY: a new state of this instance, which is freed below; the bytes have the size that was asked for.
        self.calls.state.time(|| unsafe {
            ok(status((self.functions.get_state)(self.handle, &mut state)))?;
            let mut size = 0;
            let mut bytes = Vec::new();
            let mut code = (self.functions.state_size)(self.handle, state, &mut size);
            if status(code) == Status::Ok {
                bytes.resize(size, 0);
                code = (self.functions.serialise)(self.handle, state, bytes.as_mut_ptr(), size);
            }
            (self.functions.free_state)(self.handle, &mut state);
            ok(status(code)).map(|()| bytes)
        })
    }

    pub(crate) fn deserialise(&mut self, bytes: &[u8]) -> Result<(), Status> {
        let mut state = ptr::null_mut();
        // SAFETY: a new state of this instance, which is freed below.
        self.calls.state.time(|| unsafe {
            ok(status((self.functions.deserialise)(self.handle, bytes.as_ptr(), bytes.len(), &mut state)))?;
            let code = (self.functions.set_state)(self.handle, state);
            (self.functions.free_state)(self.handle, &mut state);
            ok(status(code))
        })
    }
}

fn ok(status: Status) -> Result<(), Status> {
    if status == Status::Ok { Ok(()) } else { Err(status) }
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
