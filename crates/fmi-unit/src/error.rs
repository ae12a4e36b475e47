//! What can go wrong, grouped by who can do something about it.

use crate::modes::Mode;
use crate::variables::{Problem, Reference, Type};

/// Any error of a unit: the layer shows it and its sources to the host.
pub type UnitError = Box<dyn std::error::Error + Send + Sync>;

/// An error of the layer. Across the C interface each becomes `fmi3Error` with this text as message.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The host called a function in a mode in which the standard forbids it.
    #[error("{function} is not allowed in {mode}")]
    IllegalCall {
        /// C name of the function.
        function: &'static str,
        /// Mode of the instance.
        mode: Mode,
    },
    /// The host called a function of a capability that the unit does not declare.
    #[error("{function} is not supported: {reason}")]
    Unsupported {
        /// C name of the function.
        function: &'static str,
        /// Which capability is missing.
        reason: &'static str,
    },
    /// An argument of the host is null, misaligned, not UTF-8 or outside its range.
    #[error("argument {argument} {problem}")]
    Argument {
        /// Name of the argument in the standard's header.
        argument: &'static str,
        /// What is wrong with it.
        problem: String,
    },
    /// No variable has this reference.
    #[error("no variable has the value reference {0}")]
    UnknownReference(Reference),
    /// A variable was used as another type than it has.
    #[error("variable `{name}` is of type {is:?}, not {asked:?}")]
    WrongType {
        /// Name of the variable.
        name: String,
        /// Type of the variable.
        is: Type,
        /// Type asked for.
        asked: Type,
    },
    /// The number of values differs from the total size of the variables.
    #[error("{given} values were given for {expected} (variables {names})")]
    WrongLength {
        /// Sum of the sizes of the variables.
        expected: usize,
        /// Number of values.
        given: usize,
        /// Names of the variables, shortened.
        names: String,
    },
    /// The variable cannot be set in this mode.
    #[error("variable `{name}` ({causality}) cannot be set in {mode}")]
    NotSettable {
        /// Name of the variable.
        name: String,
        /// Its causality and variability.
        causality: String,
        /// Mode of the instance.
        mode: Mode,
    },
    /// The value is not an item of the variable's enumeration.
    #[error("variable `{name}` has no enumeration item {value}")]
    NoItem {
        /// Name of the variable.
        name: String,
        /// The value.
        value: i64,
    },
    /// The instantiation token is not the one of this unit with these resources.
    #[error("the instantiation token is `{given}`, but this library with these resources has `{expected}`")]
    Token {
        /// From the host.
        given: String,
        /// From library and resources.
        expected: String,
    },
    /// The state was freed, or belongs to another instance.
    #[error("the state is not one of this instance, or has been freed")]
    UnknownState,
    /// Another call into the same instance has not returned yet.
    #[error("the instance is being called already")]
    Busy,
    /// A serialised state cannot be used here.
    #[error("the serialised state cannot be used: {0}")]
    State(#[from] crate::state::StateError),
    /// The description of the unit breaks rules of the standard.
    #[error("the description of the unit is not valid:\n{}", lines(.0))]
    Description(Vec<Problem>),
    /// The unit handed over something that does not fit its own description.
    #[error("the unit breaks its description: {0}")]
    Contract(String),
    /// The unit reported an error.
    #[error("{}", chain(.0.as_ref()))]
    Unit(#[source] UnitError),
    /// The unit panicked; its instance is of no use any more.
    #[error("the unit panicked: {0}")]
    Panic(String),
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    File {
        /// Which file.
        path: std::path::PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The archive could not be written.
    #[error("cannot write the archive: {0}")]
    Archive(#[from] zip::result::ZipError),
}

fn lines(problems: &[Problem]) -> String {
    let lines: Vec<_> = problems.iter().map(ToString::to_string).collect();
    lines.join("\n")
}

fn chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(inner) = source {
        text = format!("{text}: {inner}");
        source = inner.source();
    }
    text
}
