//! A host in the test's own process: calls the C functions as a host would.
#![allow(dead_code, reason = "each test uses a part")]

use std::ffi::{CStr, CString};
use std::path::PathBuf;
use std::ptr;
use std::sync::Mutex;

use fmi_unit::ffi::*;
use fmi_unit::{Environment, Log, Unit, token};

#[allow(unreachable_pub, reason = "public where it is a library")]
#[path = "../../examples/heated_bars.rs"]
pub(crate) mod heated_bars;

pub(crate) use heated_bars::HeatedBars;

/// What the callback was told: status, category, text.
pub(crate) type Messages = Mutex<Vec<(Status, String, String)>>;

pub(crate) unsafe extern "C" fn log(messages: Handle, status: Status, category: *const Char, text: *const Char) {
    // SAFETY: the environment is the one given in `instantiate`, the strings are the unit's.
    let (messages, category, text) =
        unsafe { (&*messages.cast::<Messages>(), CStr::from_ptr(category.cast()), CStr::from_ptr(text.cast())) };
    let entry = (status, category.to_string_lossy().into_owned(), text.to_string_lossy().into_owned());
    messages.lock().unwrap().push(entry);
}

pub(crate) fn resources() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/examples/heated_bars_resources"))
}

pub(crate) fn token_of<U: Unit>(resources: PathBuf) -> String {
    let environment =
        Environment { instance_name: "token".to_owned(), resources: Some(resources.clone()), log: Log::default() };
    let unit = U::instantiate(&environment).unwrap();
    token(&unit.description(), Some(&resources)).unwrap()
}

pub(crate) fn instantiate_with<U: Unit>(messages: &Messages, token: &str, resources: PathBuf, logging: bool) -> Handle {
    let [name, token] = ["test", token].map(|s| CString::new(s).unwrap());
    let resources = CString::new(resources.to_str().unwrap()).unwrap();
    // SAFETY: the strings live through the call, the messages as long as the test.
    unsafe {
        fmi3InstantiateCoSimulation::<U>(
            name.as_ptr().cast(),
            token.as_ptr().cast(),
            resources.as_ptr().cast(),
            false.into(),
            logging.into(),
            false.into(),
            false.into(),
            ptr::null(),
            0,
            ptr::from_ref(messages).cast_mut().cast(),
            Some(log),
            None,
        )
    }
}

pub(crate) fn instantiate(messages: &Messages) -> Handle {
    instantiate_with::<HeatedBars>(messages, &token_of::<HeatedBars>(resources()), resources(), true)
}

pub(crate) fn initialize(instance: Handle) {
    // SAFETY: numbers only.
    unsafe {
        let (no, yes) = (false.into(), true.into());
        assert_eq!(fmi3EnterInitializationMode(instance, no, 0.0, 0.0, yes, 1000.0), Status::OK);
        assert_eq!(fmi3ExitInitializationMode(instance), Status::OK);
    }
}

pub(crate) fn step(instance: Handle, time: f64, step: f64) -> Status {
    let (mut a, mut b, mut c, mut last) = (Flag(9), Flag(9), Flag(9), 0.0);
    // SAFETY: the places live through the call.
    unsafe { fmi3DoStep(instance, time, step, false.into(), &mut a, &mut b, &mut c, &mut last) }
}

pub(crate) fn get(instance: Handle, reference: u32, values: &mut [f64]) -> Status {
    // SAFETY: the arrays have the lengths that are said.
    unsafe { fmi3GetFloat64(instance, &reference, 1, values.as_mut_ptr(), values.len()) }
}

pub(crate) fn set(instance: Handle, reference: u32, values: &[f64]) -> Status {
    // SAFETY: as above.
    unsafe { fmi3SetFloat64(instance, &reference, 1, values.as_ptr(), values.len()) }
}

pub(crate) fn set_fault(instance: Handle, fault: i64) -> Status {
    // SAFETY: as above.
    unsafe { fmi3SetInt64(instance, &12, 1, &fault, 1) }
}

pub(crate) fn free(instance: Handle) {
    // SAFETY: any handle is allowed.
    unsafe { fmi3FreeInstance(instance) }
}
