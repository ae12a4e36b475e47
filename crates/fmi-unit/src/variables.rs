//! The variables of a unit, known at run time, and what the standard demands of them.

use std::collections::{HashMap, HashSet};

use crate::description::Description;

/// Value reference: the number by which host and unit name a variable.
pub type Reference = u32;

/// The reference of `time`, the independent variable that every unit has and the layer answers for.
pub const TIME: Reference = 0;

/// Type of a variable's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names of the standard")]
pub enum Type {
    Float32,
    Float64,
    Int8,
    UInt8,
    Int16,
    UInt16,
    Int32,
    UInt32,
    Int64,
    UInt64,
    Boolean,
    String,
    Binary,
    /// Carried as `i64`; made by [`Variable::enumeration`].
    Enumeration,
}

impl Type {
    pub(crate) fn is_float(self) -> bool {
        matches!(self, Type::Float32 | Type::Float64)
    }

    /// The type of the C functions that carry it.
    pub(crate) fn carrier(self) -> Type {
        if self == Type::Enumeration { Type::Int64 } else { self }
    }
}

/// Who computes a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names of the standard")]
pub enum Causality {
    Parameter,
    CalculatedParameter,
    Input,
    Output,
    Local,
    Independent,
}

/// When a variable changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names of the standard")]
pub enum Variability {
    Constant,
    Fixed,
    Tunable,
    Discrete,
    Continuous,
}

/// What a start value means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names of the standard")]
pub enum Initial {
    Exact,
    Approx,
    Calculated,
}

impl Causality {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Causality::Parameter => "parameter",
            Causality::CalculatedParameter => "calculatedParameter",
            Causality::Input => "input",
            Causality::Output => "output",
            Causality::Local => "local",
            Causality::Independent => "independent",
        }
    }
}

impl Variability {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Variability::Constant => "constant",
            Variability::Fixed => "fixed",
            Variability::Tunable => "tunable",
            Variability::Discrete => "discrete",
            Variability::Continuous => "continuous",
        }
    }
}

impl Initial {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Initial::Exact => "exact",
            Initial::Approx => "approx",
            Initial::Calculated => "calculated",
        }
    }
}

/// Start values: one for each element in row-major order, or one for all.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Start {
    Float(Vec<f64>),
    Integer(Vec<i64>),
    Unsigned(Vec<u64>),
    Boolean(Vec<bool>),
    String(Vec<String>),
    Binary(Vec<Vec<u8>>),
}

macro_rules! start {
    ($($from:ty, $variant:ident, $value:ident => $vector:expr;)*) => {$(
        impl From<$from> for Start {
            fn from($value: $from) -> Start { Start::$variant($vector) }
        }
    )*};
}

start! {
    f64, Float, v => vec![v];
    Vec<f64>, Float, v => v;
    i32, Integer, v => vec![v.into()];
    i64, Integer, v => vec![v];
    Vec<i64>, Integer, v => v;
    u64, Unsigned, v => vec![v];
    Vec<u64>, Unsigned, v => v;
    bool, Boolean, v => vec![v];
    Vec<bool>, Boolean, v => v;
    &str, String, v => vec![v.to_owned()];
    String, String, v => vec![v];
    Vec<String>, String, v => v;
    Vec<u8>, Binary, v => vec![v];
    Vec<Vec<u8>>, Binary, v => v;
}

impl Start {
    fn len(&self) -> usize {
        match self {
            Start::Float(v) => v.len(),
            Start::Integer(v) => v.len(),
            Start::Unsigned(v) => v.len(),
            Start::Boolean(v) => v.len(),
            Start::String(v) => v.len(),
            Start::Binary(v) => v.len(),
        }
    }

    fn fits(&self, ty: Type) -> bool {
        fn all<T, U: TryFrom<T>>(values: &[T]) -> bool
        where
            T: Copy,
        {
            values.iter().all(|&v| U::try_from(v).is_ok())
        }
        match (self, ty) {
            (Start::Float(_), Type::Float64) => true,
            (Start::Float(v), Type::Float32) => {
                v.iter().all(|&x| x.is_infinite() || (x as f32).is_finite() || x.is_nan())
            }
            (Start::Integer(v), Type::Int8) => all::<_, i8>(v),
            (Start::Integer(v), Type::Int16) => all::<_, i16>(v),
            (Start::Integer(v), Type::Int32) => all::<_, i32>(v),
            (Start::Integer(_), Type::Int64 | Type::Enumeration) => true,
            (Start::Integer(v), Type::UInt8) => all::<_, u8>(v),
            (Start::Integer(v), Type::UInt16) => all::<_, u16>(v),
            (Start::Integer(v), Type::UInt32) => all::<_, u32>(v),
            (Start::Integer(v), Type::UInt64) => all::<_, u64>(v),
            (Start::Unsigned(v), Type::UInt8) => all::<_, u8>(v),
            (Start::Unsigned(v), Type::UInt16) => all::<_, u16>(v),
            (Start::Unsigned(v), Type::UInt32) => all::<_, u32>(v),
            (Start::Unsigned(_), Type::UInt64) => true,
            (Start::Boolean(_), Type::Boolean) => true,
            (Start::String(_), Type::String) => true,
            (Start::Binary(_), Type::Binary) => true,
            _ => false,
        }
    }
}

/// A variable. Made by [`Variable::input`], [`output`](Variable::output),
/// [`parameter`](Variable::parameter) or [`local`](Variable::local) and refined by the methods after it.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    pub(crate) reference: Reference,
    pub(crate) name: String,
    pub(crate) ty: Type,
    pub(crate) declared_type: Option<String>,
    pub(crate) causality: Causality,
    pub(crate) variability: Variability,
    pub(crate) initial: Option<Initial>,
    pub(crate) dimensions: Vec<usize>,
    pub(crate) unit: Option<String>,
    pub(crate) start: Option<Start>,
    pub(crate) min: Option<f64>,
    pub(crate) max: Option<f64>,
    pub(crate) nominal: Option<f64>,
    pub(crate) description: String,
    pub(crate) derivative_of: Option<Reference>,
    pub(crate) dependencies: Option<Vec<Reference>>,
}

impl Variable {
    fn new(reference: Reference, name: &str, ty: Type, causality: Causality, initial: Option<Initial>) -> Self {
        Variable {
            reference,
            name: name.to_owned(),
            ty,
            declared_type: None,
            causality,
            variability: if ty.is_float() { Variability::Continuous } else { Variability::Discrete },
            initial,
            dimensions: Vec::new(),
            unit: None,
            start: None,
            min: None,
            max: None,
            nominal: None,
            description: String::new(),
            derivative_of: None,
            dependencies: None,
        }
    }

    /// A variable that the host sets between steps. It needs a start value.
    pub fn input(reference: Reference, name: &str, ty: Type) -> Self {
        Variable::new(reference, name, ty, Causality::Input, Some(Initial::Exact))
    }

    /// A variable that the unit computes.
    pub fn output(reference: Reference, name: &str, ty: Type) -> Self {
        Variable::new(reference, name, ty, Causality::Output, Some(Initial::Calculated))
    }

    /// A value that the host may change before initialisation. It needs a start value.
    pub fn parameter(reference: Reference, name: &str, ty: Type) -> Self {
        let mut parameter = Variable::new(reference, name, ty, Causality::Parameter, Some(Initial::Exact));
        parameter.variability = Variability::Fixed;
        parameter
    }

    /// A value that the unit computes once, from its parameters.
    pub fn calculated_parameter(reference: Reference, name: &str, ty: Type) -> Self {
        let mut parameter =
            Variable::new(reference, name, ty, Causality::CalculatedParameter, Some(Initial::Calculated));
        parameter.variability = Variability::Fixed;
        parameter
    }

    /// A variable that the host may look at but should not connect.
    pub fn local(reference: Reference, name: &str, ty: Type) -> Self {
        Variable::new(reference, name, ty, Causality::Local, Some(Initial::Calculated))
    }

    pub(crate) fn time() -> Self {
        let mut time = Variable::new(TIME, "time", Type::Float64, Causality::Independent, None);
        time.description = "Simulation time".to_owned();
        time
    }

    /// The parameter may be changed between steps.
    pub fn tunable(mut self) -> Self {
        self.variability = Variability::Tunable;
        self
    }

    /// The variable never changes and has its start value.
    pub fn constant(mut self) -> Self {
        self.variability = Variability::Constant;
        self.initial = Some(Initial::Exact);
        self
    }

    /// The variable (a float) changes only at steps.
    pub fn discrete(mut self) -> Self {
        self.variability = Variability::Discrete;
        self
    }

    /// What the start value means.
    pub fn initial(mut self, initial: Initial) -> Self {
        self.initial = Some(initial);
        self
    }

    /// Gives the variable the named [`Enumeration`](crate::Enumeration) as type.
    pub fn enumeration(mut self, name: &str) -> Self {
        self.ty = Type::Enumeration;
        self.declared_type = Some(name.to_owned());
        if self.variability == Variability::Continuous {
            self.variability = Variability::Discrete;
        }
        self
    }

    /// Fixed sizes of an array, slowest first; values are in row-major order.
    pub fn dimensions(mut self, sizes: &[usize]) -> Self {
        self.dimensions = sizes.to_vec();
        self
    }

    /// Name of a [`UnitDefinition`](crate::UnitDefinition).
    pub fn unit(mut self, unit: &str) -> Self {
        self.unit = Some(unit.to_owned());
        self
    }

    /// Start value: one for each element, or one for all.
    pub fn start(mut self, start: impl Into<Start>) -> Self {
        self.start = Some(start.into());
        self
    }

    /// Range in which the variable has a meaning; a hint to hosts, not enforced.
    pub fn range(mut self, min: f64, max: f64) -> Self {
        self.min = Some(min);
        self.max = Some(max);
        self
    }

    /// Typical magnitude, by which hosts scale tolerances.
    pub fn nominal(mut self, nominal: f64) -> Self {
        self.nominal = Some(nominal);
        self
    }

    /// One sentence for people.
    pub fn describe(mut self, description: &str) -> Self {
        self.description = description.to_owned();
        self
    }

    /// The variable is the time derivative of another.
    pub fn derivative_of(mut self, reference: Reference) -> Self {
        self.derivative_of = Some(reference);
        self
    }

    /// The variables that this output depends on. Without it: on all.
    pub fn depends_on(mut self, references: &[Reference]) -> Self {
        self.dependencies = Some(references.to_vec());
        self
    }

    /// Number of values.
    pub fn size(&self) -> usize {
        self.dimensions.iter().product()
    }

    /// Name of the variable.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Value reference of the variable.
    pub fn reference(&self) -> Reference {
        self.reference
    }

    /// Type of the variable.
    pub fn ty(&self) -> Type {
        self.ty
    }

    pub(crate) fn is_initial_unknown(&self) -> bool {
        let computed = matches!(self.initial, Some(Initial::Approx | Initial::Calculated));
        computed && matches!(self.causality, Causality::Output | Causality::CalculatedParameter)
    }
}

/// One thing that is wrong in a description.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct Problem {
    /// Which part of the description.
    pub place: String,
    /// What is wrong there.
    pub problem: String,
}

/// The variables of a checked description, found by reference.
#[derive(Debug)]
pub(crate) struct Table {
    variables: Vec<Variable>,
    index: HashMap<Reference, usize>,
    items: HashMap<String, HashSet<i64>>,
}

impl Table {
    pub(crate) fn new(description: &Description) -> Self {
        let variables: Vec<_> = description.all_variables().collect();
        Table {
            index: variables.iter().enumerate().map(|(i, v)| (v.reference, i)).collect(),
            variables,
            items: description
                .enumerations
                .iter()
                .map(|e| (e.name.clone(), e.items.iter().map(|item| item.value).collect()))
                .collect(),
        }
    }

    pub(crate) fn get(&self, reference: Reference) -> Option<&Variable> {
        self.index.get(&reference).map(|&i| &self.variables[i])
    }

    /// Whether `value` is an item of the enumeration of `variable`.
    pub(crate) fn has_item(&self, variable: &Variable, value: i64) -> bool {
        let name = variable.declared_type.as_deref().unwrap_or_default();
        self.items.get(name).is_some_and(|items| items.contains(&value))
    }
}

/// Every rule of the standard that `description` breaks in its variables.
pub(crate) fn problems(description: &Description) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut names = HashSet::new();
    let mut references = HashSet::new();
    let all: Vec<_> = description.all_variables().collect();
    for variable in &all {
        let mut report = |problem: String| {
            problems.push(Problem { place: format!("variable `{}`", variable.name), problem });
        };
        if !names.insert(&variable.name) {
            report("the name is used twice".to_owned());
        }
        if !is_structured_name(&variable.name) {
            report("the name does not follow the structured naming convention".to_owned());
        }
        if !references.insert(variable.reference) {
            report(format!("the reference {} is used twice ({TIME} is that of `time`)", variable.reference));
        }
        check_kind(variable, &mut report);
        check_start(variable, &mut report);
        if variable.dimensions.contains(&0) {
            report("an array of size 0 is not allowed: leave the variable out".to_owned());
        }
        if variable.dimensions.iter().try_fold(8usize, |n, &d| n.checked_mul(d)).is_none() {
            report("the array is too large to address".to_owned());
        }
        if let Some(unit) = &variable.unit {
            if !variable.ty.is_float() {
                report("only floats have a unit".to_owned());
            }
            if description.units.iter().all(|u| &u.name != unit) {
                report(format!("the unit `{unit}` is not defined"));
            }
        }
        if variable.ty == Type::Enumeration {
            check_enumeration(variable, description, &mut report);
        }
        if !variable.ty.is_float() && (variable.min.is_some() || variable.nominal.is_some()) {
            report("only floats have a range and a nominal value".to_owned());
        }
        for reference in variable.dependencies.iter().flatten() {
            if all.iter().all(|v| v.reference != *reference) {
                report(format!("it depends on the unknown reference {reference}"));
            }
        }
        if let Some(reference) = variable.derivative_of {
            match all.iter().find(|v| v.reference == reference) {
                Some(state) if state.ty == variable.ty && state.dimensions == variable.dimensions => {}
                Some(state) => report(format!("`{}` has another type or shape than its derivative", state.name)),
                None => report(format!("it is the derivative of the unknown reference {reference}")),
            }
        }
    }
    problems
}

fn check_kind(variable: &Variable, report: &mut impl FnMut(String)) {
    use Causality as C;
    use Initial as I;
    use Variability as V;
    // FMI 3.0.2, section 2.4.7.5, tables of causality, variability and initial.
    let legal = matches!(
        (variable.causality, variable.variability, variable.initial),
        (C::Parameter, V::Fixed | V::Tunable, Some(I::Exact))
            | (C::CalculatedParameter, V::Fixed | V::Tunable, Some(I::Calculated | I::Approx))
            | (C::Input, V::Discrete | V::Continuous, Some(I::Exact))
            | (C::Output | C::Local, V::Constant, Some(I::Exact))
            | (C::Local, V::Fixed | V::Tunable, Some(I::Calculated | I::Approx))
            | (C::Output | C::Local, V::Discrete | V::Continuous, Some(_))
            | (C::Independent, V::Continuous, None)
    );
    if !legal {
        let initial = variable.initial.map_or("no", Initial::name);
        report(format!(
            "{} cannot be {} with {initial} initial value",
            variable.causality.name(),
            variable.variability.name()
        ));
    }
    if variable.variability == V::Continuous && !variable.ty.is_float() {
        report("only floats are continuous".to_owned());
    }
}

fn check_start(variable: &Variable, report: &mut impl FnMut(String)) {
    let needed = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
    match &variable.start {
        None if needed => report("it needs a start value".to_owned()),
        Some(_) if !needed => report("it is calculated and cannot have a start value".to_owned()),
        Some(start) => {
            if !start.fits(variable.ty) {
                report(format!("the start value does not fit the type {:?}", variable.ty));
            }
            if start.len() != 1 && start.len() != variable.size() {
                report(format!("{} start values for {} elements", start.len(), variable.size()));
            }
            if let Start::String(values) = start
                && values.iter().any(|v| v.contains('\0'))
            {
                report("a start value contains the character NUL".to_owned());
            }
        }
        None => {}
    }
}

fn check_enumeration(variable: &Variable, description: &Description, report: &mut impl FnMut(String)) {
    let Some(name) = &variable.declared_type else {
        return report("the enumeration is not named".to_owned());
    };
    let Some(enumeration) = description.enumerations.iter().find(|e| &e.name == name) else {
        return report(format!("the enumeration `{name}` is not defined"));
    };
    if let Some(Start::Integer(values)) = &variable.start {
        for value in values {
            if enumeration.items.iter().all(|item| item.value != *value) {
                report(format!("the start value {value} is no item of `{name}`"));
            }
        }
    }
}

/// `a.b[1,2].c`: the structured naming convention without quoted names and derivatives.
fn is_structured_name(name: &str) -> bool {
    name.split('.').all(|part| {
        let (identifier, indices) = match part.strip_suffix(']') {
            Some(open) => match open.split_once('[') {
                Some((identifier, indices)) => (identifier, Some(indices)),
                None => return false,
            },
            None => (part, None),
        };
        is_identifier(identifier)
            && indices
                .is_none_or(|list| list.split(',').all(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit())))
    })
}

pub(crate) fn is_identifier(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::{Enumeration, UnitDefinition};

    fn problems_of(variables: Vec<Variable>) -> Vec<String> {
        let description = Description::new("Test", "test")
            .units([UnitDefinition::new("K").kelvin(1)])
            .enumerations([Enumeration::new("Phase").item("solid", 1).item("liquid", 2)])
            .variables(variables);
        problems(&description).iter().map(ToString::to_string).collect()
    }

    #[track_caller]
    fn assert_problem(variable: Variable, expected: &str) {
        let found = problems_of(vec![variable]);
        assert!(found.len() == 1 && found[0].contains(expected), "{found:?}");
    }

    #[test]
    fn a_sound_table_has_no_problems() {
        let found = problems_of(vec![
            Variable::input(1, "bars.heat", Type::Float64).dimensions(&[2, 3]).start(vec![0.0; 6]),
            Variable::output(2, "bars.temperature[1]", Type::Float64).unit("K").depends_on(&[1]),
            Variable::output(3, "bars.phase", Type::Int64).enumeration("Phase"),
            Variable::parameter(4, "n", Type::UInt8).start(255),
            Variable::output(5, "version", Type::String).constant().start("1"),
        ]);
        assert!(found.is_empty(), "{found:?}");
    }

    #[test]
    fn every_problem_is_reported() {
        let found = problems_of(vec![
            Variable::input(0, "u", Type::Float64).start(0.0),
            Variable::input(1, "u", Type::Float64).unit("m"),
        ]);
        assert_eq!(found.len(), 4, "{found:?}");
    }

    #[test]
    fn each_rule_is_checked() {
        let float = |name: &str| Variable::input(1, name, Type::Float64).start(0.0);
        assert_problem(float("a b"), "naming convention");
        assert_problem(float("a[1"), "naming convention");
        assert_problem(float("a").dimensions(&[0]), "size 0");
        assert_problem(float("a").dimensions(&[usize::MAX, 2]).start(0.0), "too large");
        assert_problem(float("a").dimensions(&[3]).start(vec![0.0; 2]), "2 start values for 3 elements");
        assert_problem(float("a").start(1), "does not fit");
        assert_problem(Variable::parameter(1, "a", Type::Int8).start(128), "does not fit");
        assert_problem(Variable::output(1, "a", Type::Float64).start(1.0), "cannot have a start value");
        assert_problem(Variable::input(1, "a", Type::Float64), "needs a start value");
        assert_problem(float("a").tunable(), "input cannot be tunable");
        assert_problem(float("a").initial(Initial::Approx), "input cannot be continuous with approx");
        assert_problem(float("a").depends_on(&[9]), "unknown reference 9");
        assert_problem(Variable::output(1, "a", Type::Int64).enumeration("Colour"), "not defined");
        assert_problem(Variable::input(1, "a", Type::Int64).enumeration("Phase").start(3), "no item");
        assert_problem(Variable::parameter(1, "a", Type::String).start("a\0b"), "NUL");
        assert_problem(Variable::parameter(1, "a", Type::Int32).unit("K").start(0), "only floats");
    }
}
