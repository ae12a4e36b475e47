//! The mode machine of FMI 3.0 for co-simulation, in one table.
//!
//! The standard's state machine (FMI 3.0.2, sections 2.3 and 4.2) restricted to what these units can
//! reach: they have no event mode, no clocks and no structural parameters, so event, configuration and
//! intermediate update mode do not occur, and the functions that need them are unsupported rather than
//! called at a wrong time. Two rules hold for every function and stand outside the table: an
//! `fmi3Error` leads to [`Mode::Terminated`], from which a saved state or `fmi3Reset` leads back, and a
//! panic leads to [`Mode::Failed`].

use crate::variables::{Causality, Initial, Variability, Variable};

/// Mode of an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// After instantiation or reset: start values can be set.
    Instantiated,
    /// Between entering and leaving initialisation.
    Initialization,
    /// Time steps.
    Step,
    /// After `fmi3Terminate` or an error.
    Terminated,
    /// After a panic: the instance can only be freed.
    Failed,
}

impl std::fmt::Display for Mode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Mode::Instantiated => "mode Instantiated",
            Mode::Initialization => "Initialization Mode",
            Mode::Step => "Step Mode",
            Mode::Terminated => "mode Terminated",
            Mode::Failed => "an instance that has panicked",
        })
    }
}

impl Mode {
    pub(crate) const ALL: [Mode; 5] =
        [Mode::Instantiated, Mode::Initialization, Mode::Step, Mode::Terminated, Mode::Failed];
}

/// Where a function leads when it succeeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    Same,
    To(Mode),
}

/// One row: a function and what the machine says about it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rule {
    pub(crate) name: &'static str,
    /// One letter per mode in which the call is legal.
    legal: &'static str,
    pub(crate) next: Next,
    /// Why the function is answered with an error in every mode.
    pub(crate) unsupported: Option<&'static str>,
}

macro_rules! functions {
    ($($function:ident $legal:literal $next:expr, $unsupported:expr;)*) => {
        /// The functions of the C interface that work on an instance.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum Function { $($function,)* }

        const RULES: &[Rule] = &[$(Rule {
            name: concat!("fmi3", stringify!($function)),
            legal: $legal,
            next: $next,
            unsupported: $unsupported,
        },)*];

        const FUNCTIONS: &[Function] = &[$(Function::$function,)*];
    };
}

use Mode::{Initialization, Instantiated, Step, Terminated};
use Next::{Same, To};

const CLOCKS: Option<&str> = Some("the unit has no clocks");
const EVENTS: Option<&str> = Some("the unit has no event mode");
const STRUCTURE: Option<&str> = Some("the unit has no structural parameters");
const EXCHANGE: Option<&str> = Some("the unit is not for model exchange");
const SCHEDULED: Option<&str> = Some("the unit is not for scheduled execution");
const ELEMENTS: Option<&str> = Some("the unit has no dependencies per element");
const DERIVATIVES: Option<&str> = Some("the unit has no time derivatives of outputs");

// Modes: I instantiated, N initialisation, S step, T terminated, F failed.
functions! {
    // function                         legal    leads to            unsupported
    SetDebugLogging                     "INSTF"  Same,               None;
    EnterInitializationMode             "I"      To(Initialization), None;
    ExitInitializationMode              "N"      To(Step),           None;
    DoStep                              "S"      Same,               None;
    // A failed instance accepts the call and stays as it is, so that hosts can follow their clean-up.
    Terminate                           "SF"     To(Terminated),     None;
    Reset                               "INST"   To(Instantiated),   None;
    GetFloat32                          "INST"   Same,               None;
    GetFloat64                          "INST"   Same,               None;
    GetInt8                             "INST"   Same,               None;
    GetUInt8                            "INST"   Same,               None;
    GetInt16                            "INST"   Same,               None;
    GetUInt16                           "INST"   Same,               None;
    GetInt32                            "INST"   Same,               None;
    GetUInt32                           "INST"   Same,               None;
    GetInt64                            "INST"   Same,               None;
    GetUInt64                           "INST"   Same,               None;
    GetBoolean                          "INST"   Same,               None;
    GetString                           "INST"   Same,               None;
    GetBinary                           "INST"   Same,               None;
    SetFloat32                          "INS"    Same,               None;
    SetFloat64                          "INS"    Same,               None;
    SetInt8                             "INS"    Same,               None;
    SetUInt8                            "INS"    Same,               None;
    SetInt16                            "INS"    Same,               None;
    SetUInt16                           "INS"    Same,               None;
    SetInt32                            "INS"    Same,               None;
    SetUInt32                           "INS"    Same,               None;
    SetInt64                            "INS"    Same,               None;
    SetUInt64                           "INS"    Same,               None;
    SetBoolean                          "INS"    Same,               None;
    SetString                           "INS"    Same,               None;
    SetBinary                           "INS"    Same,               None;
    GetFMUState                         "INST"   Same,               None;
    // Leads to the mode that the state was taken in.
    SetFMUState                         "INST"   Same,               None;
    FreeFMUState                        "INSTF"  Same,               None;
    SerializedFMUStateSize              "INST"   Same,               None;
    SerializeFMUState                   "INST"   Same,               None;
    DeserializeFMUState                 "INST"   Same,               None;
    GetDirectionalDerivative            "NST"    Same,               None;
    GetAdjointDerivative                "NST"    Same,               None;
    GetClock                            ""       Same,               CLOCKS;
    SetClock                            ""       Same,               CLOCKS;
    GetIntervalDecimal                  ""       Same,               CLOCKS;
    GetIntervalFraction                 ""       Same,               CLOCKS;
    GetShiftDecimal                     ""       Same,               CLOCKS;
    GetShiftFraction                    ""       Same,               CLOCKS;
    SetIntervalDecimal                  ""       Same,               CLOCKS;
    SetIntervalFraction                 ""       Same,               CLOCKS;
    SetShiftDecimal                     ""       Same,               CLOCKS;
    SetShiftFraction                    ""       Same,               CLOCKS;
    EnterEventMode                      ""       Same,               EVENTS;
    EnterStepMode                       ""       Same,               EVENTS;
    EvaluateDiscreteStates              ""       Same,               EVENTS;
    UpdateDiscreteStates                ""       Same,               EVENTS;
    EnterConfigurationMode              ""       Same,               STRUCTURE;
    ExitConfigurationMode               ""       Same,               STRUCTURE;
    GetNumberOfVariableDependencies     ""       Same,               ELEMENTS;
    GetVariableDependencies             ""       Same,               ELEMENTS;
    GetOutputDerivatives                ""       Same,               DERIVATIVES;
    EnterContinuousTimeMode             ""       Same,               EXCHANGE;
    CompletedIntegratorStep             ""       Same,               EXCHANGE;
    SetTime                             ""       Same,               EXCHANGE;
    SetContinuousStates                 ""       Same,               EXCHANGE;
    GetContinuousStateDerivatives       ""       Same,               EXCHANGE;
    GetEventIndicators                  ""       Same,               EXCHANGE;
    GetContinuousStates                 ""       Same,               EXCHANGE;
    GetNominalsOfContinuousStates       ""       Same,               EXCHANGE;
    GetNumberOfEventIndicators          ""       Same,               EXCHANGE;
    GetNumberOfContinuousStates         ""       Same,               EXCHANGE;
    ActivateModelPartition              ""       Same,               SCHEDULED;
}

impl Function {
    pub(crate) fn rule(self) -> &'static Rule {
        &RULES[self as usize]
    }

    /// The function of this C name.
    pub(crate) fn named(name: &str) -> Option<Function> {
        FUNCTIONS.iter().copied().find(|f| f.rule().name == name)
    }

    pub(crate) fn is_legal_in(self, mode: Mode) -> bool {
        let letter = match mode {
            Mode::Instantiated => 'I',
            Mode::Initialization => 'N',
            Mode::Step => 'S',
            Mode::Terminated => 'T',
            Mode::Failed => 'F',
        };
        self.rule().legal.contains(letter)
    }
}

/// Whether the standard allows to set `variable` in `mode` (FMI 3.0.2, sections 2.3.2, 2.3.3, 4.2.1).
pub(crate) fn is_settable(variable: &Variable, mode: Mode) -> bool {
    match mode {
        Mode::Instantiated => {
            variable.variability != Variability::Constant
                && matches!(variable.initial, Some(Initial::Exact | Initial::Approx))
        }
        Mode::Initialization => {
            variable.variability != Variability::Constant && variable.initial == Some(Initial::Exact)
        }
        Mode::Step => match variable.causality {
            Causality::Input => true,
            Causality::Parameter => variable.variability == Variability::Tunable,
            _ => false,
        },
        Mode::Terminated | Mode::Failed => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variables::Type;

    #[test]
    fn every_function_has_its_row() {
        // 75 exported functions: these, fmi3GetVersion, three instantiations and fmi3FreeInstance.
        assert_eq!(FUNCTIONS.len(), 70);
        for &function in FUNCTIONS {
            let rule = function.rule();
            assert_eq!(rule.name, format!("fmi3{function:?}"));
            assert!(rule.legal.is_empty() == rule.unsupported.is_some(), "{}", rule.name);
        }
    }

    #[test]
    fn legal_modes_are_those_of_the_standard() {
        let legal =
            |function: Function| Mode::ALL.iter().filter(|m| function.is_legal_in(**m)).copied().collect::<Vec<_>>();
        assert_eq!(legal(Function::EnterInitializationMode), [Instantiated]);
        assert_eq!(legal(Function::ExitInitializationMode), [Initialization]);
        assert_eq!(legal(Function::DoStep), [Step]);
        assert_eq!(legal(Function::Terminate), [Step, Mode::Failed]);
        assert_eq!(legal(Function::GetFloat64), [Instantiated, Initialization, Step, Terminated]);
        assert_eq!(legal(Function::SetFloat64), [Instantiated, Initialization, Step]);
        assert_eq!(legal(Function::GetDirectionalDerivative), [Initialization, Step, Terminated]);
        assert!(legal(Function::EnterEventMode).is_empty());
    }

    #[test]
    fn a_failed_instance_allows_only_cleaning_up() {
        let left: Vec<_> = FUNCTIONS.iter().filter(|f| f.is_legal_in(Mode::Failed)).collect();
        assert_eq!(left, [&Function::SetDebugLogging, &Function::Terminate, &Function::FreeFMUState]);
    }

    #[test]
    fn variables_are_settable_by_causality_and_mode() {
        let settable =
            |variable: Variable| Mode::ALL.iter().filter(|m| is_settable(&variable, **m)).copied().collect::<Vec<_>>();
        assert_eq!(settable(Variable::input(1, "u", Type::Float64).start(0.0)), [Instantiated, Initialization, Step]);
        assert_eq!(settable(Variable::parameter(1, "p", Type::Float64).start(0.0)), [Instantiated, Initialization]);
        assert_eq!(
            settable(Variable::parameter(1, "p", Type::Float64).tunable().start(0.0)),
            [Instantiated, Initialization, Step]
        );
        assert!(settable(Variable::output(1, "y", Type::Float64)).is_empty());
        assert_eq!(
            settable(Variable::output(1, "y", Type::Float64).initial(Initial::Approx).start(0.0)),
            [Instantiated]
        );
    }
}
