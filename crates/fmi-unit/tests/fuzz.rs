//! Random sequences of C calls with random arguments: no crash, no panic across the boundary, a message
//! with every error, and instances that work again after a reset.
//!
//! `FMI_FUZZ_CALLS` sets the number of calls, `FMI_FUZZ_SEED` the sequence.
#![allow(unsafe_code, reason = "the functions under test are C functions")]

mod support;

use std::ffi::CString;
use std::ptr;

use fmi_unit::ffi::*;
use support::*;

/// Number of calls in the ordinary run of the tests.
const CALLS: u64 = 50_000;
/// Arrays of the host are this long, and lengths are said up to it.
const ROOM: usize = 24;

/// Xorshift, so that a sequence belongs to a seed for ever.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
    fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }
    fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[self.below(items.len())]
    }
    fn float(&mut self) -> f64 {
        match self.below(8) {
            0 => f64::from_bits(self.next()),
            1 => self.pick(&[f64::NAN, f64::INFINITY, -1.0, 1e308]),
            _ => self.below(40) as f64 * 0.25,
        }
    }
    fn flag(&mut self) -> Flag {
        Flag(if self.one_in(50) { self.next() as u8 } else { (self.next() & 1) as u8 })
    }
    fn pointer<T>(&mut self, good: *mut T) -> *mut T {
        if self.one_in(60) { self.pick(&[ptr::null_mut(), ptr::without_provenance_mut(1)]) } else { good }
    }
}

/// Misaligned pointers stand for pointers that are refused before they are used; a `u8` or a string has
/// no alignment, so there only null can be refused.
fn byte_pointer<T>(random: &mut Random, good: *mut T) -> *mut T {
    if random.one_in(60) { ptr::null_mut() } else { good }
}

struct Fuzz {
    random: Random,
    live: Vec<Handle>,
    stale: Vec<Handle>,
    states: Vec<Handle>,
    bytes: Vec<u8>,
    token: CString,
    resources: CString,
    messages: Box<Messages>,
}

const NAMES: [&str; 16] = [
    "fmi3EnterEventMode",
    "fmi3GetClock",
    "fmi3SetClock",
    "fmi3GetNumberOfVariableDependencies",
    "fmi3EnterConfigurationMode",
    "fmi3GetIntervalDecimal",
    "fmi3SetShiftFraction",
    "fmi3UpdateDiscreteStates",
    "fmi3EnterContinuousTimeMode",
    "fmi3SetTime",
    "fmi3GetContinuousStates",
    "fmi3GetNumberOfEventIndicators",
    "fmi3EnterStepMode",
    "fmi3GetOutputDerivatives",
    "fmi3ActivateModelPartition",
    "fmi3ExitConfigurationMode",
];

impl Fuzz {
    fn instance(&mut self) -> Handle {
        let r = &mut self.random;
        match r.below(40) {
            0 => ptr::null_mut(),
            1 => ptr::without_provenance_mut(r.next() as usize),
            2 if !self.stale.is_empty() => r.pick(&self.stale),
            _ if self.live.is_empty() => ptr::null_mut(),
            _ => r.pick(&self.live),
        }
    }

    fn state(&mut self) -> Handle {
        let r = &mut self.random;
        match r.below(12) {
            0 => ptr::null_mut(),
            1 => ptr::without_provenance_mut(r.next() as usize),
            _ if self.states.is_empty() => ptr::null_mut(),
            _ => r.pick(&self.states),
        }
    }

    fn instantiate(&mut self) {
        let r = &mut self.random;
        let name = r.pick(&[c"a", c"instance", c"", c"\xff"]);
        let token = if r.one_in(20) { c"other" } else { self.token.as_c_str() };
        let (name, token) = (name.as_ptr().cast_mut(), token.as_ptr().cast_mut());
        let resources = self.resources.as_ptr().cast_mut();
        let (name, token, resources) = (byte_pointer(r, name), byte_pointer(r, token), byte_pointer(r, resources));
        let event = Flag(r.one_in(30).into());
        let logging = r.flag();
        // SAFETY: the strings live through the call, the messages as long as the fuzz.
        let instance = unsafe {
            fmi3InstantiateCoSimulation::<HeatedBars>(
                name.cast(),
                token.cast(),
                resources.cast(),
                logging,
                logging,
                event,
                logging,
                ptr::null(),
                0,
                ptr::from_ref(self.messages.as_ref()).cast_mut().cast(),
                Some(log),
                None,
            )
        };
        if instance.is_null() {
            assert!(!self.messages.lock().unwrap().is_empty(), "no instance and no message");
        } else {
            self.live.push(instance);
        }
    }

    fn free(&mut self, instance: Handle) {
        free(instance);
        if let Some(i) = self.live.iter().position(|live| *live == instance) {
            self.live.swap_remove(i);
            self.stale.push(instance);
            self.stale.truncate(50);
        }
    }

    /// One call; the status, and the instance if there was one.
    fn call(&mut self) -> (Status, Handle) {
        let i = self.instance();
        let state = self.state();
        let r = &mut self.random;
        // Calls that make sense in Step Mode are commoner, so that sequences get somewhere.
        let operation = if r.one_in(3) {
            r.below(32)
        } else {
            r.pick(&[4, 5, 6, 7, 11, 12, 13, 15, 17, 19, 24, 25, 26, 27, 28, 29])
        };
        let mut references: [u32; ROOM] =
            std::array::from_fn(|_| if r.one_in(40) { r.next() as u32 } else { r.below(14) as u32 });
        let (mut count, mut size) = (r.below(4), r.below(ROOM));
        // Nonsense alone would never get far: most calls name a variable of the type and its size.
        if !r.one_in(8) {
            count = 1;
            (references[0], size) = match operation {
                11 | 12 => r.pick(&[(1, 3), (3, 12), (4, 3), (5, 1), (8, 1), (9, 1)]),
                13 | 14 => r.pick(&[(6, 3), (12, 1)]),
                17 | 18 => (10, 1),
                19 | 20 => (11, 1),
                29 => (1, 3),
                _ => (2, 1),
            };
        }
        let refs: *const u32 = r.pointer(references.as_ptr().cast_mut());
        let mut floats: [f64; ROOM] = std::array::from_fn(|_| r.float());
        let mut other = floats;
        let mut longs: [i64; ROOM] =
            std::array::from_fn(|_| if r.one_in(3) { r.next() as i64 } else { r.below(4) as i64 });
        // A panic would end the instance: it is wanted, but seldom.
        if !r.one_in(40) {
            longs.iter_mut().filter(|v| **v == 1).for_each(|v| *v = 0);
        }
        let mut flags = [Flag(3); ROOM];
        let mut sizes = [0usize; ROOM];
        let texts = [c"text".as_ptr().cast::<Char>(), c"\xf0\x28".as_ptr().cast(), ptr::null(), c"".as_ptr().cast()];
        let mut strings: [*const Char; ROOM] =
            std::array::from_fn(|_| if r.one_in(4) { r.pick(&texts) } else { texts[0] });
        let mut blobs = [references.as_ptr().cast::<u8>(); ROOM];
        let (yes, no) = (Flag(1), Flag(0));
        let f = r.pointer(floats.as_mut_ptr());
        let l = r.pointer(longs.as_mut_ptr());
        let b = flags.as_mut_ptr();
        let n = size;
        let mut now = [0.0];
        if r.one_in(20) {
            now = [r.float()];
        } else {
            get(i, 0, &mut now);
        }
        let step = if r.one_in(20) { r.float() } else { r.pick(&[0.5, 0.5, 0.5, 20.0]) };
        let mut place = state;
        let mut last = 0.0;
        // SAFETY: every array has room for the length that is said; bad pointers are null or misaligned.
        let status = unsafe {
            match operation {
                0 | 1 => fmi3EnterInitializationMode(i, r.flag(), r.float(), 0.0, no, r.float()),
                2 | 3 => fmi3ExitInitializationMode(i),
                4..=7 => {
                    let ends = r.pointer(&raw mut last);
                    fmi3DoStep(i, now[0], step, yes, b, b.add(1), b.add(2), ends)
                }
                8 => fmi3Terminate(i),
                9 | 10 => fmi3Reset(i),
                11 => fmi3GetFloat64(i, refs, count, f, n),
                12 => fmi3SetFloat64(i, refs, count, f, n),
                13 => fmi3GetInt64(i, refs, count, l, n),
                14 => fmi3SetInt64(i, refs, count, l, n),
                15 => fmi3GetBoolean(i, refs, count, b, n),
                16 => fmi3SetBoolean(i, refs, count, b, n),
                17 => fmi3GetString(i, refs, count, strings.as_mut_ptr(), n),
                18 => fmi3SetString(i, refs, count, strings.as_ptr(), n),
                19 => fmi3GetBinary(i, refs, count, sizes.as_mut_ptr(), blobs.as_mut_ptr(), n),
                20 => {
                    sizes.fill(r.below(4 * ROOM));
                    fmi3SetBinary(i, refs, count, sizes.as_ptr(), blobs.as_ptr(), n)
                }
                21 => fmi3GetInt8(i, refs, count, l.cast(), n),
                22 => fmi3SetUInt16(i, refs, count, l.cast(), n),
                23 => fmi3GetFloat32(i, refs, count, f.cast(), n),
                24 => {
                    let status = fmi3GetFMUState(i, &mut place);
                    if status == Status::OK && !self.states.contains(&place) && self.states.len() < 100 {
                        self.states.push(place);
                    }
                    status
                }
                25 => fmi3SetFMUState(i, state),
                26 => fmi3FreeFMUState(i, r.pointer(&raw mut place)),
                27 => {
                    let mut size = 0;
                    let status = fmi3SerializedFMUStateSize(i, state, &mut size);
                    if status != Status::OK {
                        return (status, i);
                    }
                    self.bytes.resize(size, 0);
                    fmi3SerializeFMUState(i, state, self.bytes.as_mut_ptr(), size)
                }
                28 => {
                    let mut bytes = self.bytes.clone();
                    if !bytes.is_empty() && r.one_in(2) {
                        let at = r.below(bytes.len());
                        bytes[at] ^= r.next() as u8;
                        bytes.truncate(r.below(2 * self.bytes.len()));
                    }
                    let changed = bytes != self.bytes;
                    let status = fmi3DeserializeFMUState(i, bytes.as_ptr(), bytes.len(), &mut place);
                    assert!(!changed || status == Status::Error, "a corrupt state was accepted");
                    status
                }
                29 => {
                    let known = references[0];
                    let unknown = if r.one_in(4) { r.below(14) as u32 } else { 4 };
                    fmi3GetDirectionalDerivative(i, &unknown, 1, &known, 1, f, n, other.as_mut_ptr(), n)
                }
                30 => {
                    let names = [c"solver".as_ptr().cast(), texts[r.below(2)]];
                    fmi3SetDebugLogging(i, r.flag(), r.below(3), names.as_ptr())
                }
                _ => unsupported(i, r.pick(&NAMES)),
            }
        };
        (status, i)
    }
}

#[test]
fn random_calls_do_no_harm() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse().ok());
    let (calls, seed) = (number("FMI_FUZZ_CALLS").unwrap_or(CALLS), number("FMI_FUZZ_SEED").unwrap_or(1));
    // The panics of the unit under test would fill the screen.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if !info.to_string().contains("the bars have a fault") {
            hook(info);
        }
    }));
    let mut fuzz = Fuzz {
        random: Random(u64::wrapping_mul(seed, 0x9e37_79b9_7f4a_7c15) | 1),
        live: Vec::new(),
        stale: Vec::new(),
        states: Vec::new(),
        bytes: Vec::new(),
        token: CString::new(token_of::<HeatedBars>(resources())).unwrap(),
        resources: CString::new(resources().to_str().unwrap()).unwrap(),
        messages: Box::default(),
    };
    let mut seen = [0u64; 5];
    for _ in 0..calls {
        fuzz.messages.lock().unwrap().clear();
        if fuzz.live.len() < 2 || fuzz.random.one_in(200) {
            fuzz.instantiate();
        }
        if fuzz.live.len() > 6 || fuzz.random.one_in(200) {
            let instance = fuzz.instance();
            fuzz.free(instance);
        }
        fuzz.messages.lock().unwrap().clear();
        let (status, instance) = fuzz.call();
        seen[status as usize] += 1;
        if status == Status::Error && fuzz.live.contains(&instance) {
            let told = fuzz.messages.lock().unwrap();
            assert!(told.iter().any(|m| m.0 == Status::Error && m.2.contains("fmi3")), "an error without a message");
        }
        // An error ends a run, so that nothing would be left to try.
        if status == Status::Error && !fuzz.random.one_in(4) {
            // SAFETY: a handle of any kind.
            if unsafe { fmi3Reset(instance) } != Status::OK {
                fuzz.free(instance);
            } else if !fuzz.random.one_in(4) {
                initialize(instance);
            }
            continue;
        }
    }
    // All but Fatal must have occurred often, or the sequence tests nothing.
    assert!(seen[0] > calls / 4 && seen[2] > calls / 1000 && seen[3] > calls / 10 && seen[4] == 0, "{seen:?}");
    for instance in fuzz.live {
        // SAFETY: handles. A reset fails only after a panic.
        unsafe {
            if fmi3Reset(instance) == Status::OK {
                initialize(instance);
                assert_eq!(step(instance, 0.0, 0.5), Status::OK);
            }
        }
        free(instance);
    }
}
