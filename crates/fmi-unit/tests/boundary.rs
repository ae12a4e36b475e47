//! The C functions, called in-process: what is refused, and that nothing breaks.
#![allow(unsafe_code, reason = "the functions under test are C functions")]

mod support;

use std::ptr;
use std::sync::atomic::{AtomicPtr, AtomicU8, Ordering};

use fmi_unit::ffi::*;
use fmi_unit::{Description, Environment, Reference, StepOutcome, Type, Unit, UnitError, ValuesMut, Variable};
use support::*;

fn last(messages: &Messages) -> String {
    messages.lock().unwrap().last().map(|m| m.2.clone()).unwrap_or_default()
}

/// Expects an error whose message contains `text`, and resets.
#[track_caller]
fn refused(messages: &Messages, instance: Handle, status: Status, text: &str) {
    assert_eq!(status, Status::Error);
    assert!(last(messages).contains(text), "{}", last(messages));
    // SAFETY: a handle.
    assert_eq!(unsafe { fmi3Reset(instance) }, Status::OK);
}

#[test]
fn bad_arguments_are_refused_with_a_message() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    let mut one = [0.0];
    refused(&messages, i, get(i, 99, &mut one), "value reference 99");
    refused(&messages, i, get(i, 1, &mut one), "1 values were given for 3");
    refused(&messages, i, get(i, 2, &mut one), "`enabled` is of type Boolean");
    refused(&messages, i, set(i, 5, &one), "`hottest` (continuous output) cannot be set");
    refused(&messages, i, set(i, 0, &one), "`time`");
    refused(&messages, i, set_fault(i, 7), "no enumeration item 7");
    refused(&messages, i, step(i, 0.0, 1.0), "fmi3DoStep is not allowed in mode Instantiated");
    // SAFETY: null and misaligned pointers are what is tested, and they are not dereferenced.
    unsafe {
        refused(&messages, i, fmi3GetFloat64(i, ptr::null(), 1, one.as_mut_ptr(), 1), "valueReferences is NULL");
        refused(&messages, i, fmi3GetFloat64(i, &5, 1, ptr::null_mut(), 1), "values is NULL");
        let odd = ptr::without_provenance_mut(9);
        refused(&messages, i, fmi3GetFloat64(i, &5, 1, odd, 1), "not aligned");
        refused(&messages, i, fmi3GetFloat64(i, &5, usize::MAX, one.as_mut_ptr(), 1), "impossible length");
        let text = c"\xff";
        refused(&messages, i, fmi3SetString(i, &10, 1, &text.as_ptr().cast(), 1), "not valid UTF-8");
        refused(&messages, i, fmi3SetString(i, &10, 1, &ptr::null(), 1), "values is NULL");
        refused(&messages, i, fmi3GetFMUState(i, ptr::null_mut()), "FMUState is NULL");
        refused(&messages, i, fmi3SetFMUState(i, ptr::without_provenance_mut(0x1230)), "has been freed");
        refused(&messages, i, unsupported(i, "fmi3EnterEventMode"), "no event mode");
        refused(&messages, i, fmi3SetDebugLogging(i, true.into(), 1, &c"x".as_ptr().cast()), "no category");
    }
    free(i);
}

#[test]
fn time_must_go_on_and_end() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    for (time, dt, text) in [
        (0.0, 0.0, "communicationStepSize is 0"),
        (0.0, f64::NAN, "communicationStepSize is NaN"),
        (1.0, 1.0, "but the unit is at 0"),
        (0.0, 1001.0, "past the stop time 1000"),
    ] {
        initialize(i);
        refused(&messages, i, step(i, time, dt), text);
    }
    free(i);
}

#[test]
fn instances_that_cannot_be_are_null_with_a_message() {
    let messages = Messages::default();
    let good = token_of::<HeatedBars>(resources());
    assert!(instantiate_with::<HeatedBars>(&messages, "wrong", resources(), false).is_null());
    assert!(last(&messages).contains("token is `wrong`"));
    assert!(instantiate_with::<HeatedBars>(&messages, &good, "/nowhere".into(), false).is_null());
    assert!(last(&messages).contains("size.txt"), "{}", last(&messages));

    let changed = tempfile::tempdir().unwrap();
    std::fs::write(changed.path().join("size.txt"), "3 5").unwrap();
    assert!(instantiate_with::<HeatedBars>(&messages, &good, changed.path().into(), false).is_null());
    assert!(last(&messages).contains("token"));
    std::fs::write(changed.path().join("size.txt"), "3").unwrap();
    assert!(instantiate_with::<HeatedBars>(&messages, &good, changed.path().into(), false).is_null());
    assert!(last(&messages).contains("expected two sizes"));

    let environment = ptr::from_ref(&messages).cast_mut().cast();
    // SAFETY: null strings and callbacks are allowed to be refused.
    unsafe {
        let (null, no) = (ptr::null(), Flag(0));
        assert!(fmi3InstantiateModelExchange(null, null, null, no, no, environment, Some(log)).is_null());
        assert!(last(&messages).contains("for co-simulation"));
        assert!(
            fmi3InstantiateScheduledExecution(null, null, null, no, no, environment, Some(log), None, None, None)
                .is_null()
        );
        let no_log = ptr::null_mut();
        assert!(
            fmi3InstantiateCoSimulation::<HeatedBars>(
                null,
                null,
                null,
                no,
                no,
                no,
                no,
                ptr::null(),
                0,
                no_log,
                None,
                None
            )
            .is_null()
        );
    }
}

#[test]
fn a_panic_ends_one_instance_and_no_other() {
    let messages = Messages::default();
    let (broken, sound) = (instantiate(&messages), instantiate(&messages));
    initialize(broken);
    initialize(sound);
    assert_eq!(set_fault(broken, 1), Status::OK);
    assert_eq!(step(broken, 0.0, 1.0), Status::Error);
    assert!(last(&messages).contains("the unit panicked: the bars have a fault"), "{}", last(&messages));
    assert_eq!(get(broken, 5, &mut [0.0]), Status::Error);
    // SAFETY: handles.
    unsafe {
        assert_eq!(fmi3Reset(broken), Status::Error);
        assert_eq!(fmi3Terminate(broken), Status::OK);
        assert_eq!(fmi3Terminate(broken), Status::OK);
    }
    assert_eq!(step(sound, 0.0, 1.0), Status::OK);
    free(broken);
    free(sound);
}

#[test]
fn handles_that_are_stale_or_random_do_nothing() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    free(i);
    free(i);
    free(ptr::null_mut());
    free(ptr::without_provenance_mut(12345));
    assert_eq!(get(i, 5, &mut [0.0]), Status::Error);
    assert_eq!(get(ptr::null_mut(), 5, &mut [0.0]), Status::Error);
}

#[test]
fn an_error_leads_to_terminated_and_a_state_leads_back() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    initialize(i);
    let mut state = ptr::null_mut();
    // SAFETY: the place lives through the call.
    assert_eq!(unsafe { fmi3GetFMUState(i, &mut state) }, Status::OK);
    assert_eq!(set_fault(i, 2), Status::OK);
    assert_eq!(step(i, 0.0, 1.0), Status::Error);
    assert!(last(&messages).contains("fault"));
    assert_eq!(step(i, 0.0, 1.0), Status::Error);
    assert!(last(&messages).contains("not allowed in mode Terminated"));
    assert_eq!(get(i, 5, &mut [0.0]), Status::OK);
    // SAFETY: as above.
    unsafe {
        assert_eq!(fmi3SetFMUState(i, state), Status::OK);
        assert_eq!(step(i, 0.0, 1.0), Status::OK);
        let mut stale = state;
        assert_eq!(fmi3FreeFMUState(i, &mut state), Status::OK);
        assert!(state.is_null());
        assert_eq!(fmi3FreeFMUState(i, &mut state), Status::OK);
        assert_eq!(fmi3FreeFMUState(i, &mut stale), Status::Error);
    }
    free(i);
}

#[test]
fn states_belong_to_their_instance_and_are_overwritten_in_place() {
    let messages = Messages::default();
    let (a, b) = (instantiate(&messages), instantiate(&messages));
    let mut state = ptr::null_mut();
    // SAFETY: the place lives through the calls.
    unsafe {
        assert_eq!(fmi3GetFMUState(a, &mut state), Status::OK);
        let first = state;
        assert_eq!(fmi3GetFMUState(a, &mut state), Status::OK);
        assert_eq!(state, first);
        refused(&messages, b, fmi3SetFMUState(b, state), "not one of this instance");
        let mut size = 0;
        assert_eq!(fmi3SerializedFMUStateSize(a, state, &mut size), Status::OK);
        let mut bytes = vec![0; size];
        assert_eq!(fmi3SerializeFMUState(a, state, bytes.as_mut_ptr(), size), Status::OK);
        let mut copy = ptr::null_mut();
        assert_eq!(fmi3DeserializeFMUState(b, bytes.as_ptr(), size, &mut copy), Status::OK);
        assert_eq!(fmi3SetFMUState(b, copy), Status::OK);
        refused(&messages, a, fmi3SerializeFMUState(a, state, bytes.as_mut_ptr(), size - 1), "size is");
        bytes[size / 2] ^= 4;
        refused(&messages, b, fmi3DeserializeFMUState(b, bytes.as_ptr(), size, &mut copy), "corrupt");
    }
    free(a);
    free(b);
}

#[test]
fn discarded_steps_change_nothing_and_warnings_are_passed_on() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    initialize(i);
    assert_eq!(set(i, 1, &[1.0, 2.0, 3.0]), Status::OK);
    let (mut before, mut after) = ([0.0; 12], [0.0; 12]);
    get(i, 3, &mut before);
    assert_eq!(step(i, 0.0, 11.0), Status::Discard);
    assert!(messages.lock().unwrap().iter().any(|m| m.0 == Status::Discard && m.1 == "logStatusDiscard"));
    get(i, 3, &mut after);
    assert_eq!(before, after);
    assert_eq!(set_fault(i, 3), Status::OK);
    assert_eq!(step(i, 0.0, 1.0), Status::Warning);
    let told = messages.lock().unwrap().iter().find(|m| m.0 == Status::Warning).cloned().unwrap();
    assert_eq!((told.1.as_str(), told.2.as_str()), ("logStatusWarning", "the bars are about to have a fault ##1"));
    free(i);
}

#[test]
fn only_wanted_categories_are_logged() {
    let messages = Messages::default();
    let quiet = instantiate_with::<HeatedBars>(&messages, &token_of::<HeatedBars>(resources()), resources(), false);
    initialize(quiet);
    assert_eq!(step(quiet, 0.0, 1.0), Status::OK);
    assert!(messages.lock().unwrap().is_empty());
    // SAFETY: one string.
    unsafe {
        assert_eq!(fmi3SetDebugLogging(quiet, true.into(), 1, &c"solver".as_ptr().cast()), Status::OK);
    }
    assert_eq!(step(quiet, 1.0, 1.0), Status::OK);
    assert_eq!(last(&messages), "step 2 of 1 s");
    free(quiet);
}

#[test]
fn initial_results_follow_what_is_set() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    // SAFETY: numbers only.
    unsafe {
        assert_eq!(fmi3EnterInitializationMode(i, Flag(0), 0.0, 0.0, Flag(0), 0.0), Status::OK);
        for ambient in [310.0, 290.0] {
            let mut hottest = [0.0];
            assert_eq!(set(i, 8, &[ambient]), Status::OK);
            assert_eq!(get(i, 5, &mut hottest), Status::OK);
            assert_eq!(hottest, [ambient]);
        }
        assert_eq!(fmi3ExitInitializationMode(i), Status::OK);
    }
    assert_eq!(set(i, 8, &[300.0]), Status::Error);
    free(i);
}

#[test]
fn every_type_comes_back() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    // SAFETY: arrays have the lengths that are said; strings and bytes are read before the next call.
    unsafe {
        let text = c"höt";
        assert_eq!(fmi3SetString(i, &10, 1, &text.as_ptr().cast(), 1), Status::OK);
        let mut string = ptr::null();
        assert_eq!(fmi3GetString(i, &10, 1, &mut string, 1), Status::OK);
        assert_eq!(std::ffi::CStr::from_ptr(string.cast()), text);

        let bytes = [7u8, 0, 9, 0];
        assert_eq!(fmi3SetBinary(i, &11, 1, &4, &bytes.as_ptr(), 1), Status::OK);
        let (mut size, mut binary) = (0, ptr::null());
        assert_eq!(fmi3GetBinary(i, &11, 1, &mut size, &mut binary, 1), Status::OK);
        assert_eq!(std::slice::from_raw_parts(binary, size), bytes);

        // A C `bool` may hold anything that is not 0.
        assert_eq!(fmi3SetBoolean(i, &2, 1, &Flag(2), 1), Status::OK);
        let mut flag = Flag(7);
        assert_eq!(fmi3GetBoolean(i, &2, 1, &mut flag, 1), Status::OK);
        assert_eq!(flag, Flag(1));

        let mut steps = 9;
        assert_eq!(fmi3GetUInt64(i, &7, 1, &mut steps, 1), Status::OK);
        assert_eq!(steps, 0);
        let mut phases = [0; 3];
        assert_eq!(fmi3GetInt64(i, &6, 1, phases.as_mut_ptr(), 3), Status::OK);
        assert_eq!(phases, [1; 3]);

        // Several variables in one call, in the order of the references.
        let mut values = [0.0; 4];
        assert_eq!(fmi3GetFloat64(i, [8, 1].as_ptr(), 2, values.as_mut_ptr(), 4), Status::OK);
        assert_eq!(values, [300.0, 0.0, 0.0, 0.0]);
        // All or none: `hottest` cannot be set, so `ambient` is not set either.
        assert_eq!(fmi3SetFloat64(i, [8, 5].as_ptr(), 2, [1.0, 2.0].as_ptr(), 2), Status::Error);
        assert_eq!(get(i, 8, &mut values[..1]), Status::OK);
        assert_eq!(values[0], 300.0);
    }
    free(i);
}

#[test]
fn derivatives_agree_with_differences_and_with_each_other() {
    let messages = Messages::default();
    let i = instantiate(&messages);
    initialize(i);
    let (heat, direction, h) = ([100.0, 200.0, 300.0], [1.0, -2.0, 0.5], 1e-3);
    let loss = |sign: f64| {
        let mut values = [0.0; 3];
        let moved: Vec<_> = heat.iter().zip(direction).map(|(q, d)| q + sign * h * d).collect();
        assert_eq!(set(i, 1, &moved), Status::OK);
        assert_eq!(get(i, 4, &mut values), Status::OK);
        values
    };
    let (plus, minus) = (loss(1.0), loss(-1.0));
    assert_eq!(set(i, 1, &heat), Status::OK);
    let (mut forward, mut adjoint) = ([0.0; 3], [0.0; 3]);
    // SAFETY: arrays have the lengths that are said.
    unsafe {
        let (d, f, a) = (direction.as_ptr(), forward.as_mut_ptr(), adjoint.as_mut_ptr());
        assert_eq!(fmi3GetDirectionalDerivative(i, &4, 1, &1, 1, d, 3, f, 3), Status::OK);
        assert_eq!(fmi3GetAdjointDerivative(i, &4, 1, &1, 1, d, 3, a, 3), Status::OK);
        for k in 0..3 {
            let difference = (plus[k] - minus[k]) / (2.0 * h);
            assert!((forward[k] - difference).abs() <= 1e-6 * difference.abs(), "{} {difference}", forward[k]);
        }
        assert_eq!(forward, adjoint);
        let derivative = |y: u32, seeds: usize| fmi3GetDirectionalDerivative(i, &y, 1, &1, 1, d, seeds, f, 3);
        refused(&messages, i, derivative(4, 2), "2 values were given for 3");
        refused(&messages, i, derivative(4, 3), "not allowed in mode Instantiated");
        initialize(i);
        refused(&messages, i, derivative(6, 3), "not Float64");
    }
    free(i);
}

#[test]
fn a_callback_may_call_back() {
    unsafe extern "C" fn reenter(instance: Handle, _: Status, _: *const Char, _: *const Char) {
        // SAFETY: the environment is a cell that holds the handle of the instance.
        let instance = unsafe { &*instance.cast::<AtomicPtr<std::ffi::c_void>>() }.load(Ordering::Relaxed);
        let mut hottest = [0.0];
        assert_eq!(get(instance, 5, &mut hottest), Status::OK);
    }
    let token = std::ffi::CString::new(token_of::<HeatedBars>(resources())).unwrap();
    let path = std::ffi::CString::new(resources().to_str().unwrap()).unwrap();
    let cell = AtomicPtr::new(ptr::null_mut());
    let environment = ptr::from_ref(&cell).cast_mut().cast();
    // SAFETY: strings and cell live as long as the instance.
    unsafe {
        let (name, token, path) = (c"x".as_ptr().cast(), token.as_ptr().cast(), path.as_ptr().cast());
        let (no, yes) = (Flag(0), Flag(1));
        let new = fmi3InstantiateCoSimulation::<HeatedBars>;
        let i = new(name, token, path, no, yes, no, no, ptr::null(), 0, environment, Some(reenter), None);
        cell.store(i, Ordering::Relaxed);
        initialize(i);
        assert_eq!(step(i, 0.0, 1.0), Status::OK);
        free(i);
    }
}

#[test]
fn threads_do_not_disturb_each_other() {
    let result = |heat: f64| {
        let messages = Messages::default();
        let i = instantiate(&messages);
        initialize(i);
        set(i, 1, &[heat; 3]);
        for n in 0..200 {
            assert_eq!(step(i, f64::from(n), 1.0), Status::OK);
        }
        let mut values = [0.0; 12];
        assert_eq!(get(i, 3, &mut values), Status::OK);
        free(i);
        values
    };
    let alone = [result(1.0), result(2.0)];
    let together = std::thread::scope(|scope| {
        [scope.spawn(|| result(1.0)), scope.spawn(|| result(2.0))].map(|thread| thread.join().unwrap())
    });
    assert_eq!(alone, together);
}

/// A unit without any capability, and with a description that breaks the rules if asked to.
struct Plain;

impl Unit for Plain {
    type State = ();
    fn instantiate(_: &Environment) -> Result<Self, UnitError> {
        Ok(Plain)
    }
    fn description(&self) -> Description {
        Description::new("Plain", "plain").variables([Variable::output(1, "y", Type::String)])
    }
    fn get(&mut self, _: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        values.write(&["a\0b".to_owned()])
    }
    fn step(&mut self, _: f64, _: f64) -> Result<StepOutcome, UnitError> {
        Ok(StepOutcome::Finished)
    }
}

#[test]
fn capabilities_that_are_missing_are_errors() {
    let messages = Messages::default();
    let folder = tempfile::tempdir().unwrap();
    let token = token_of::<Plain>(folder.path().into());
    let i = instantiate_with::<Plain>(&messages, &token, folder.path().into(), true);
    let mut state = ptr::null_mut();
    let mut string = ptr::null();
    // SAFETY: places live through the calls.
    unsafe {
        refused(&messages, i, fmi3GetFMUState(i, &mut state), "cannot save its state");
        refused(&messages, i, fmi3GetString(i, &1, 1, &mut string, 1), "contains NUL");
        initialize(i);
        let nothing = fmi3GetDirectionalDerivative(i, &1, 1, &1, 1, ptr::null(), 0, ptr::null_mut(), 0);
        refused(&messages, i, nothing, "no such derivatives");
        initialize(i);
        let (mut flags, mut last) = ([Flag(0); 3], 0.0);
        let [a, b, c] = &mut flags;
        assert_eq!(fmi3DoStep(i, 0.0, 2.0, Flag(0), a, b, c, &mut last), Status::OK);
        assert_eq!((flags, last), ([Flag(0), Flag(1), Flag(0)], 2.0));
    }
    free(i);
}

/// A unit that panics where it is built, or where it is dropped, or that waits.
struct Fragile(u8);

/// What the next [`Fragile`] does.
static MOOD: AtomicU8 = AtomicU8::new(0);

impl Drop for Fragile {
    fn drop(&mut self) {
        assert_ne!(self.0, 2, "no farewell");
    }
}

impl Unit for Fragile {
    type State = ();
    fn instantiate(_: &Environment) -> Result<Self, UnitError> {
        let mood = MOOD.load(Ordering::Relaxed);
        assert_ne!(mood, 1, "no welcome");
        Ok(Fragile(mood))
    }
    fn description(&self) -> Description {
        Description::new("Fragile", "fragile").variables([Variable::output(1, "y", Type::Float64)])
    }
    fn get(&mut self, _: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        std::thread::sleep(std::time::Duration::from_millis(200));
        values.write(&[1.0])
    }
    fn step(&mut self, _: f64, _: f64) -> Result<StepOutcome, UnitError> {
        Ok(StepOutcome::Completed)
    }
}

#[test]
fn panics_at_birth_and_death_and_calls_at_once_are_errors() {
    let messages = Messages::default();
    let token = token_of::<Fragile>("/nowhere".into());
    let new = || instantiate_with::<Fragile>(&messages, &token, "/nowhere".into(), true);
    MOOD.store(1, Ordering::Relaxed);
    assert!(new().is_null());
    assert!(last(&messages).contains("no welcome"), "{}", last(&messages));
    MOOD.store(2, Ordering::Relaxed);
    free(new());
    assert!(last(&messages).contains("no farewell"), "{}", last(&messages));

    MOOD.store(0, Ordering::Relaxed);
    let i = new().addr();
    let wait = std::time::Duration::from_millis(50);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| get(ptr::without_provenance_mut(i), 1, &mut [0.0]));
        std::thread::sleep(wait);
        assert_eq!(get(ptr::without_provenance_mut(i), 1, &mut [0.0]), Status::Error);
        assert!(last(&messages).contains("being called already"));
        assert_eq!(first.join().unwrap(), Status::OK);
    });
    // Freed while another thread is inside: that thread ends its call first.
    std::thread::scope(|scope| {
        let first = scope.spawn(|| get(ptr::without_provenance_mut(i), 1, &mut [0.0]));
        std::thread::sleep(wait);
        free(ptr::without_provenance_mut(i));
        assert_eq!(first.join().unwrap(), Status::OK);
    });
}
