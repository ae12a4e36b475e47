//! The 75 functions of the FMI 3.0 C interface, each signature written once: [`export_unit!`] makes the
//! exported symbols of this list, and [`c_header`](crate::ffi::c_header) the declarations that the tests
//! compile together with the standard's header.

/// Hands the list to the macro `$then`, in three groups: the one function that knows the type of the
/// unit, those that do something, and those that are answered with an error.
#[doc(hidden)]
#[macro_export]
macro_rules! __fmi3_functions {
    ($then:ident $($argument:tt)*) => {
        $crate::$then! { [$($argument)*]
          unit {
            fn fmi3InstantiateCoSimulation(
                name: *const Char, token: *const Char, resources: *const Char, visible: Flag,
                logging: Flag, event_mode: Flag, early_return: Flag, intermediate: *const u32,
                intermediate_count: usize, environment: Handle, log: LogMessage,
                intermediate_update: IntermediateUpdate,
            ) -> Handle;
          }
          supported {
            fn fmi3GetVersion() -> *const Char;
            fn fmi3SetDebugLogging(
                instance: Handle, on: Flag, count: usize, categories: *const *const Char,
            ) -> Status;
            fn fmi3InstantiateModelExchange(
                name: *const Char, token: *const Char, resources: *const Char, visible: Flag,
                logging: Flag, environment: Handle, log: LogMessage,
            ) -> Handle;
            fn fmi3InstantiateScheduledExecution(
                name: *const Char, token: *const Char, resources: *const Char, visible: Flag,
                logging: Flag, environment: Handle, log: LogMessage, clock_update: ClockUpdate,
                lock: Preemption, unlock: Preemption,
            ) -> Handle;
            fn fmi3FreeInstance(instance: Handle) -> ();
            fn fmi3EnterInitializationMode(
                instance: Handle, tolerance_defined: Flag, tolerance: f64, start: f64,
                stop_defined: Flag, stop: f64,
            ) -> Status;
            fn fmi3ExitInitializationMode(instance: Handle) -> Status;
            fn fmi3Terminate(instance: Handle) -> Status;
            fn fmi3Reset(instance: Handle) -> Status;
            fn fmi3GetFloat32(
                instance: Handle, references: *const u32, count: usize, values: *mut f32, size: usize,
            ) -> Status;
            fn fmi3GetFloat64(
                instance: Handle, references: *const u32, count: usize, values: *mut f64, size: usize,
            ) -> Status;
            fn fmi3GetInt8(
                instance: Handle, references: *const u32, count: usize, values: *mut i8, size: usize,
            ) -> Status;
            fn fmi3GetUInt8(
                instance: Handle, references: *const u32, count: usize, values: *mut u8, size: usize,
            ) -> Status;
            fn fmi3GetInt16(
                instance: Handle, references: *const u32, count: usize, values: *mut i16, size: usize,
            ) -> Status;
            fn fmi3GetUInt16(
                instance: Handle, references: *const u32, count: usize, values: *mut u16, size: usize,
            ) -> Status;
            fn fmi3GetInt32(
                instance: Handle, references: *const u32, count: usize, values: *mut i32, size: usize,
            ) -> Status;
            fn fmi3GetUInt32(
                instance: Handle, references: *const u32, count: usize, values: *mut u32, size: usize,
            ) -> Status;
            fn fmi3GetInt64(
                instance: Handle, references: *const u32, count: usize, values: *mut i64, size: usize,
            ) -> Status;
            fn fmi3GetUInt64(
                instance: Handle, references: *const u32, count: usize, values: *mut u64, size: usize,
            ) -> Status;
            fn fmi3GetBoolean(
                instance: Handle, references: *const u32, count: usize, values: *mut Flag, size: usize,
            ) -> Status;
            fn fmi3GetString(
                instance: Handle, references: *const u32, count: usize, values: *mut *const Char,
                size: usize,
            ) -> Status;
            fn fmi3GetBinary(
                instance: Handle, references: *const u32, count: usize, sizes: *mut usize,
                values: *mut *const u8, size: usize,
            ) -> Status;
            fn fmi3SetFloat32(
                instance: Handle, references: *const u32, count: usize, values: *const f32,
                size: usize,
            ) -> Status;
            fn fmi3SetFloat64(
                instance: Handle, references: *const u32, count: usize, values: *const f64,
                size: usize,
            ) -> Status;
            fn fmi3SetInt8(
                instance: Handle, references: *const u32, count: usize, values: *const i8, size: usize,
            ) -> Status;
            fn fmi3SetUInt8(
                instance: Handle, references: *const u32, count: usize, values: *const u8, size: usize,
            ) -> Status;
            fn fmi3SetInt16(
                instance: Handle, references: *const u32, count: usize, values: *const i16,
                size: usize,
            ) -> Status;
            fn fmi3SetUInt16(
                instance: Handle, references: *const u32, count: usize, values: *const u16,
                size: usize,
            ) -> Status;
            fn fmi3SetInt32(
                instance: Handle, references: *const u32, count: usize, values: *const i32,
                size: usize,
            ) -> Status;
            fn fmi3SetUInt32(
                instance: Handle, references: *const u32, count: usize, values: *const u32,
                size: usize,
            ) -> Status;
            fn fmi3SetInt64(
                instance: Handle, references: *const u32, count: usize, values: *const i64,
                size: usize,
            ) -> Status;
            fn fmi3SetUInt64(
                instance: Handle, references: *const u32, count: usize, values: *const u64,
                size: usize,
            ) -> Status;
            fn fmi3SetBoolean(
                instance: Handle, references: *const u32, count: usize, values: *const Flag,
                size: usize,
            ) -> Status;
            fn fmi3SetString(
                instance: Handle, references: *const u32, count: usize, values: *const *const Char,
                size: usize,
            ) -> Status;
            fn fmi3SetBinary(
                instance: Handle, references: *const u32, count: usize, sizes: *const usize,
                values: *const *const u8, size: usize,
            ) -> Status;
            fn fmi3GetFMUState(instance: Handle, state: *mut Handle) -> Status;
            fn fmi3SetFMUState(instance: Handle, state: Handle) -> Status;
            fn fmi3FreeFMUState(instance: Handle, state: *mut Handle) -> Status;
            fn fmi3SerializedFMUStateSize(instance: Handle, state: Handle, size: *mut usize) -> Status;
            fn fmi3SerializeFMUState(
                instance: Handle, state: Handle, bytes: *mut u8, size: usize,
            ) -> Status;
            fn fmi3DeserializeFMUState(
                instance: Handle, bytes: *const u8, size: usize, state: *mut Handle,
            ) -> Status;
            fn fmi3GetDirectionalDerivative(
                instance: Handle, unknowns: *const u32, unknown_count: usize, knowns: *const u32,
                known_count: usize, seed: *const f64, seed_size: usize, sensitivity: *mut f64,
                size: usize,
            ) -> Status;
            fn fmi3GetAdjointDerivative(
                instance: Handle, unknowns: *const u32, unknown_count: usize, knowns: *const u32,
                known_count: usize, seed: *const f64, seed_size: usize, sensitivity: *mut f64,
                size: usize,
            ) -> Status;
            fn fmi3DoStep(
                instance: Handle, time: f64, step: f64, no_earlier_state: Flag, event: *mut Flag,
                terminate: *mut Flag, early_return: *mut Flag, last_time: *mut f64,
            ) -> Status;
          }
          unsupported {
            fn fmi3EnterEventMode(instance: Handle) -> Status;
            fn fmi3GetClock(
                instance: Handle, references: *const u32, count: usize, values: *mut Flag,
            ) -> Status;
            fn fmi3SetClock(
                instance: Handle, references: *const u32, count: usize, values: *const Flag,
            ) -> Status;
            fn fmi3GetNumberOfVariableDependencies(
                instance: Handle, reference: u32, count: *mut usize,
            ) -> Status;
            fn fmi3GetVariableDependencies(
                instance: Handle, dependent: u32, dependent_elements: *mut usize,
                independents: *mut u32, independent_elements: *mut usize, kinds: *mut DependencyKind,
                count: usize,
            ) -> Status;
            fn fmi3EnterConfigurationMode(instance: Handle) -> Status;
            fn fmi3ExitConfigurationMode(instance: Handle) -> Status;
            fn fmi3GetIntervalDecimal(
                instance: Handle, references: *const u32, count: usize, intervals: *mut f64,
                qualifiers: *mut IntervalQualifier,
            ) -> Status;
            fn fmi3GetIntervalFraction(
                instance: Handle, references: *const u32, count: usize, counters: *mut u64,
                resolutions: *mut u64, qualifiers: *mut IntervalQualifier,
            ) -> Status;
            fn fmi3GetShiftDecimal(
                instance: Handle, references: *const u32, count: usize, shifts: *mut f64,
            ) -> Status;
            fn fmi3GetShiftFraction(
                instance: Handle, references: *const u32, count: usize, counters: *mut u64,
                resolutions: *mut u64,
            ) -> Status;
            fn fmi3SetIntervalDecimal(
                instance: Handle, references: *const u32, count: usize, intervals: *const f64,
            ) -> Status;
            fn fmi3SetIntervalFraction(
                instance: Handle, references: *const u32, count: usize, counters: *const u64,
                resolutions: *const u64,
            ) -> Status;
            fn fmi3SetShiftDecimal(
                instance: Handle, references: *const u32, count: usize, shifts: *const f64,
            ) -> Status;
            fn fmi3SetShiftFraction(
                instance: Handle, references: *const u32, count: usize, counters: *const u64,
                resolutions: *const u64,
            ) -> Status;
            fn fmi3EvaluateDiscreteStates(instance: Handle) -> Status;
            fn fmi3UpdateDiscreteStates(
                instance: Handle, needs_update: *mut Flag, terminate: *mut Flag,
                nominals_changed: *mut Flag, values_changed: *mut Flag, next_event_defined: *mut Flag,
                next_event: *mut f64,
            ) -> Status;
            fn fmi3EnterContinuousTimeMode(instance: Handle) -> Status;
            fn fmi3CompletedIntegratorStep(
                instance: Handle, no_earlier_state: Flag, event: *mut Flag, terminate: *mut Flag,
            ) -> Status;
            fn fmi3SetTime(instance: Handle, time: f64) -> Status;
            fn fmi3SetContinuousStates(instance: Handle, states: *const f64, count: usize) -> Status;
            fn fmi3GetContinuousStateDerivatives(
                instance: Handle, values: *mut f64, count: usize,
            ) -> Status;
            fn fmi3GetEventIndicators(instance: Handle, values: *mut f64, count: usize) -> Status;
            fn fmi3GetContinuousStates(instance: Handle, values: *mut f64, count: usize) -> Status;
            fn fmi3GetNominalsOfContinuousStates(
                instance: Handle, values: *mut f64, count: usize,
            ) -> Status;
            fn fmi3GetNumberOfEventIndicators(instance: Handle, count: *mut usize) -> Status;
            fn fmi3GetNumberOfContinuousStates(instance: Handle, count: *mut usize) -> Status;
            fn fmi3EnterStepMode(instance: Handle) -> Status;
            fn fmi3GetOutputDerivatives(
                instance: Handle, references: *const u32, count: usize, orders: *const i32,
                values: *mut f64, size: usize,
            ) -> Status;
            fn fmi3ActivateModelPartition(instance: Handle, clock: u32, time: f64) -> Status;
          }
        }
    };
}

/// Exports a [`Unit`](crate::Unit) as the FMI 3.0 C interface of this library, which must be of crate type
/// `cdylib`. Call it once, where the unit is defined: `export_unit!(MyUnit);`.
#[macro_export]
macro_rules! export_unit {
    ($unit:ty) => {
        $crate::__fmi3_functions! { __fmi3_export $unit }
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __fmi3_export {
    ([$unit:ty]
        unit { fn $new:ident($($new_arg:ident: $new_ty:ty),* $(,)?) -> $new_ret:ty; }
        supported { $(fn $name:ident($($arg:ident: $ty:ty),* $(,)?) -> $ret:ty;)* }
        unsupported { $(fn $other:ident($instance:ident: Handle $(, $rest:ident: $rest_ty:ty)* $(,)?) -> Status;)* }
    ) => {
        #[allow(unsafe_code, missing_docs, unreachable_pub, reason = "the C interface of the standard")]
        const _: () = {
            #[cfg(panic = "abort")]
            compile_error!("a unit needs panic = \"unwind\", so that a panic does not end the host");

            #[allow(unused_imports, reason = "which types occur is not this macro's concern")]
            use $crate::ffi::*;

            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $new($($new_arg: $new_ty),*) -> $new_ret {
                // SAFETY: the caller keeps the promises of the standard, which are those of this function.
                unsafe { $crate::ffi::$new::<$unit>($($new_arg),*) }
            }
            $(
                #[unsafe(no_mangle)]
                pub unsafe extern "C" fn $name($($arg: $ty),*) -> $ret {
                    // SAFETY: as above.
                    unsafe { $crate::ffi::$name($($arg),*) }
                }
            )*
            $(
                #[unsafe(no_mangle)]
                pub unsafe extern "C" fn $other($instance: Handle $(, $rest: $rest_ty)*) -> Status {
                    $(let _ = $rest;)*
                    $crate::ffi::unsupported($instance, stringify!($other))
                }
            )*
        };
    };
}
