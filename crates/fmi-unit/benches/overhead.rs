//! What the layer costs per call, on arrays of 34 000 values: `cargo bench -p fmi-unit`.
//!
//! The unit copies arrays and does nothing else, so "array" minus "copy" is the layer.
#![allow(unsafe_code, reason = "the functions measured are C functions")]

#[path = "../tests/support/mod.rs"]
mod support;

use std::hint::black_box;
use std::ptr;
use std::time::Instant;

use fmi_unit::ffi::*;
use support::*;

const SIZE: usize = 34_000;
const REPEAT: u32 = 2000;

/// The median of five rounds, in nanoseconds per call.
fn measure(what: &str, repeat: u32, mut call: impl FnMut()) {
    let mut rounds: Vec<_> = (0..5)
        .map(|_| {
            let start = Instant::now();
            (0..repeat).for_each(|_| call());
            start.elapsed().as_nanos() as f64 / f64::from(repeat)
        })
        .collect();
    rounds.sort_by(f64::total_cmp);
    println!("{what:<44} {:>12.0} ns", rounds[2]);
}

fn main() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("size.txt"), format!("{SIZE} 1")).unwrap();
    let token = token_of::<HeatedBars>(folder.path().into());
    let messages = Messages::default();
    let new = || instantiate_with::<HeatedBars>(&messages, &token, folder.path().into(), false);
    let i = new();
    initialize(i);

    let (source, mut values) = (vec![1.0; SIZE], vec![0.0; SIZE]);
    measure("copy of 34 000 f64", REPEAT, || {
        black_box(&mut values).copy_from_slice(black_box(&source));
    });
    measure("fmi3GetFloat64, scalar", 100 * REPEAT, || {
        get(i, 8, black_box(&mut [0.0]));
    });
    measure("fmi3GetFloat64, array", REPEAT, || {
        get(i, 1, black_box(&mut values));
    });
    measure("fmi3SetFloat64, array", REPEAT, || {
        set(i, 1, black_box(&source));
    });
    let mut time = 0.0;
    // Discarded, so that the unit itself does next to nothing.
    measure("fmi3DoStep, discarded", REPEAT, || {
        step(i, time, 20.0);
    });
    measure("fmi3DoStep, with the unit's own work", 100, || {
        step(i, time, 0.25);
        time += 0.25;
    });

    let (mut state, mut size) = (ptr::null_mut(), 0);
    // SAFETY: places and arrays live through the calls and have the length that is said.
    unsafe {
        measure("fmi3GetFMUState, 550 kB", 200, || assert_eq!(fmi3GetFMUState(i, &mut state), Status::OK));
        measure("fmi3SetFMUState, 550 kB", 200, || assert_eq!(fmi3SetFMUState(i, state), Status::OK));
        let mut bytes = Vec::new();
        measure("fmi3SerializeFMUState with its size", 50, || {
            fmi3SerializedFMUStateSize(i, state, &mut size);
            bytes.resize(size, 0);
            fmi3SerializeFMUState(i, state, bytes.as_mut_ptr(), size);
        });
        let mut copy = ptr::null_mut();
        measure("fmi3DeserializeFMUState", 50, || {
            assert_eq!(fmi3DeserializeFMUState(i, bytes.as_ptr(), size, &mut copy), Status::OK);
        });
    }
    measure("fmi3InstantiateCoSimulation + fmi3FreeInstance", 50, || free(new()));
    free(i);
}
