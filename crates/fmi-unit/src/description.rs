//! What a unit says about itself: the content of `modelDescription.xml` and `terminalsAndIcons.xml`.

use std::collections::HashSet;

use crate::error::Error;
use crate::variables::{Problem, Variable, is_identifier, problems};
use crate::xml::{model_description, terminals_and_icons};

/// The description of a unit: built once per instance, checked, and written into the FMU by
/// [`pack`](crate::pack).
///
/// ```
/// use fmi_unit::{Description, Type, UnitDefinition, Variable};
///
/// let description = Description::new("Heated bar", "bar")
///     .units([UnitDefinition::new("K").kelvin(1)])
///     .variables([Variable::output(1, "temperature", Type::Float64).unit("K")]);
/// assert!(description.check().is_ok());
/// ```
#[derive(Clone, Debug)]
pub struct Description {
    pub(crate) model_name: String,
    pub(crate) identifier: String,
    pub(crate) about: String,
    pub(crate) version: String,
    pub(crate) author: String,
    pub(crate) license: String,
    pub(crate) capabilities: Capabilities,
    pub(crate) time_unit: Option<String>,
    pub(crate) experiment: Option<DefaultExperiment>,
    pub(crate) log_categories: Vec<(String, String)>,
    pub(crate) units: Vec<UnitDefinition>,
    pub(crate) enumerations: Vec<Enumeration>,
    pub(crate) variables: Vec<Variable>,
    pub(crate) terminals: Vec<Terminal>,
    pub(crate) documentation: String,
}

/// What the unit can do beyond stepping. All are off by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Capabilities {
    /// [`Unit::save`](crate::Unit::save) and [`Unit::restore`](crate::Unit::restore) work.
    pub state: bool,
    /// [`Unit::serialize`](crate::Unit::serialize) and [`Unit::deserialize`](crate::Unit::deserialize) work.
    pub serialize: bool,
    /// [`Unit::directional_derivative`](crate::Unit::directional_derivative) works.
    pub directional_derivative: bool,
    /// [`Unit::adjoint_derivative`](crate::Unit::adjoint_derivative) works.
    pub adjoint_derivative: bool,
    /// Every step needs the same size.
    pub fixed_step: bool,
}

/// The simulation that a host proposes when nothing else is asked for, in the unit of time.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "the names say it")]
pub struct DefaultExperiment {
    pub start: f64,
    pub stop: f64,
    pub step: f64,
}

/// A physical unit as a product of powers of SI base units, times a factor.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitDefinition {
    pub(crate) name: String,
    pub(crate) exponents: [i32; 8],
    pub(crate) factor: f64,
    pub(crate) offset: f64,
}

pub(crate) const BASE_UNITS: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

macro_rules! exponents {
    ($($method:ident $index:literal;)*) => {$(
        #[doc = concat!("Sets the exponent of the base unit `", stringify!($method), "`.")]
        pub fn $method(mut self, exponent: i32) -> Self {
            self.exponents[$index] = exponent;
            self
        }
    )*};
}

impl UnitDefinition {
    /// A unit without dimension, to be given exponents.
    pub fn new(name: &str) -> Self {
        UnitDefinition { name: name.to_owned(), exponents: [0; 8], factor: 1.0, offset: 0.0 }
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Exponents of kg, m, s, A, K, mol, cd, rad.
    pub fn exponents(&self) -> [i32; 8] {
        self.exponents
    }

    exponents! { kilogram 0; metre 1; second 2; ampere 3; kelvin 4; mole 5; candela 6; radian 7; }

    /// Value in base units = `factor` · value + `offset`.
    pub fn scaled(mut self, factor: f64, offset: f64) -> Self {
        self.factor = factor;
        self.offset = offset;
        self
    }
}

/// A type with named integer values.
#[derive(Clone, Debug, PartialEq)]
pub struct Enumeration {
    pub(crate) name: String,
    pub(crate) items: Vec<Item>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Item {
    pub(crate) name: String,
    pub(crate) value: i64,
}

impl Enumeration {
    /// An enumeration without items.
    pub fn new(name: &str) -> Self {
        Enumeration { name: name.to_owned(), items: Vec::new() }
    }

    /// Adds an item.
    pub fn item(mut self, name: &str, value: i64) -> Self {
        self.items.push(Item { name: name.to_owned(), value });
        self
    }
}

/// A named group of variables that hosts connect together, member by member of equal name.
#[derive(Clone, Debug, PartialEq)]
pub struct Terminal {
    pub(crate) name: String,
    pub(crate) about: String,
    pub(crate) members: Vec<(String, String)>,
}

impl Terminal {
    /// A terminal without members.
    pub fn new(name: &str, about: &str) -> Self {
        Terminal { name: name.to_owned(), about: about.to_owned(), members: Vec::new() }
    }

    /// Adds the variable named `variable` as `member`.
    pub fn member(mut self, member: &str, variable: &str) -> Self {
        self.members.push((member.to_owned(), variable.to_owned()));
        self
    }
}

/// The categories under which the layer itself logs; their names are the standard's.
pub(crate) const LAYER_CATEGORIES: [(&str, &str); 3] = [
    ("logStatusWarning", "Warnings"),
    ("logStatusDiscard", "Steps that were rejected, and why"),
    ("logStatusError", "Errors, always logged"),
];

impl Description {
    /// `identifier` names the library inside the FMU and must be a C identifier.
    pub fn new(model_name: &str, identifier: &str) -> Self {
        Description {
            model_name: model_name.to_owned(),
            identifier: identifier.to_owned(),
            about: String::new(),
            version: String::new(),
            author: String::new(),
            license: String::new(),
            capabilities: Capabilities::default(),
            time_unit: None,
            experiment: None,
            log_categories: Vec::new(),
            units: Vec::new(),
            enumerations: Vec::new(),
            variables: Vec::new(),
            terminals: Vec::new(),
            documentation: String::new(),
        }
    }

    /// One paragraph for people.
    pub fn about(mut self, about: &str) -> Self {
        self.about = about.to_owned();
        self
    }

    /// Version of the model; put the version of your crate here, so that it enters the token.
    pub fn version(mut self, version: &str) -> Self {
        self.version = version.to_owned();
        self
    }

    /// Who wrote the model.
    pub fn author(mut self, author: &str) -> Self {
        self.author = author.to_owned();
        self
    }

    /// Licence of the model.
    pub fn license(mut self, license: &str) -> Self {
        self.license = license.to_owned();
        self
    }

    /// What the unit can do beyond stepping.
    pub fn capabilities(mut self, capabilities: Capabilities) -> Self {
        self.capabilities = capabilities;
        self
    }

    /// Unit of `time`, one of the defined units.
    pub fn time_unit(mut self, unit: &str) -> Self {
        self.time_unit = Some(unit.to_owned());
        self
    }

    /// The simulation that hosts propose.
    pub fn default_experiment(mut self, experiment: DefaultExperiment) -> Self {
        self.experiment = Some(experiment);
        self
    }

    /// Adds a category for [`Log`](crate::Log).
    pub fn log_category(mut self, name: &str, about: &str) -> Self {
        self.log_categories.push((name.to_owned(), about.to_owned()));
        self
    }

    /// Adds units.
    pub fn units(mut self, units: impl IntoIterator<Item = UnitDefinition>) -> Self {
        self.units.extend(units);
        self
    }

    /// Adds enumerations.
    pub fn enumerations(mut self, enumerations: impl IntoIterator<Item = Enumeration>) -> Self {
        self.enumerations.extend(enumerations);
        self
    }

    /// Adds variables. `time`, with reference 0, is always there.
    pub fn variables(mut self, variables: impl IntoIterator<Item = Variable>) -> Self {
        self.variables.extend(variables);
        self
    }

    /// Adds terminals.
    pub fn terminals(mut self, terminals: impl IntoIterator<Item = Terminal>) -> Self {
        self.terminals.extend(terminals);
        self
    }

    /// HTML for `documentation/index.html`, before the table of variables.
    pub fn documentation(mut self, html: &str) -> Self {
        html.clone_into(&mut self.documentation);
        self
    }

    /// `time`, then the unit's variables.
    pub fn all_variables(&self) -> impl Iterator<Item = Variable> {
        let mut time = Variable::time();
        time.unit.clone_from(&self.time_unit);
        std::iter::once(time).chain(self.variables.iter().cloned())
    }

    pub(crate) fn all_categories(&self) -> impl Iterator<Item = (&str, &str)> {
        let own = self.log_categories.iter().map(|(name, about)| (name.as_str(), about.as_str()));
        LAYER_CATEGORIES.into_iter().chain(own)
    }

    /// Holds the description against the rules of the standard.
    ///
    /// # Errors
    /// [`Error::Description`] with every problem found.
    pub fn check(&self) -> Result<(), Error> {
        let mut found = problems(self);
        let mut report = |place: String, problem: &str| {
            found.push(Problem { place, problem: problem.to_owned() });
        };
        if !is_identifier(&self.identifier) {
            report(format!("identifier `{}`", self.identifier), "it is no C identifier");
        }
        for (what, names) in [
            ("unit", self.units.iter().map(|u| u.name.as_str()).collect::<Vec<_>>()),
            ("enumeration", self.enumerations.iter().map(|e| e.name.as_str()).collect()),
            ("terminal", self.terminals.iter().map(|t| t.name.as_str()).collect()),
            ("log category", self.all_categories().map(|c| c.0).collect()),
        ] {
            let mut seen = HashSet::new();
            for name in names {
                if name.trim().is_empty() {
                    report(format!("{what} `{name}`"), "it has no name");
                }
                if !seen.insert(name) {
                    report(format!("{what} `{name}`"), "the name is used twice");
                }
            }
        }
        for enumeration in &self.enumerations {
            let place = || format!("enumeration `{}`", enumeration.name);
            let values: HashSet<_> = enumeration.items.iter().map(|item| item.value).collect();
            if enumeration.items.is_empty() {
                report(place(), "it has no items");
            }
            if values.len() != enumeration.items.len() {
                report(place(), "two items have the same value");
            }
        }
        for terminal in &self.terminals {
            let place = || format!("terminal `{}`", terminal.name);
            if terminal.members.is_empty() {
                report(place(), "it has no members");
            }
            let mut members = HashSet::new();
            for (member, variable) in &terminal.members {
                if !members.insert(member) {
                    report(place(), &format!("the member `{member}` occurs twice"));
                }
                if self.variables.iter().all(|v| &v.name != variable) {
                    report(place(), &format!("there is no variable `{variable}`"));
                }
            }
        }
        // XML cannot hold them, not even escaped.
        let xml = model_description(self, "") + &terminals_and_icons(self, false);
        if xml.contains(|c: char| c.is_control() && c != '\n') {
            report("texts".to_owned(), "a name or description contains control characters");
        }
        if self.capabilities.serialize && !self.capabilities.state {
            report("capabilities".to_owned(), "states that are serialised must be saved and restored too");
        }
        if found.is_empty() { Ok(()) } else { Err(Error::Description(found)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variables::Type;

    #[test]
    fn names_members_and_capabilities_are_checked() {
        let description = Description::new("Test", "a-b")
            .time_unit("s")
            .units([UnitDefinition::new("K"), UnitDefinition::new("K")])
            .enumerations([Enumeration::new("Empty"), Enumeration::new("Same").item("a", 1).item("b", 1)])
            .variables([Variable::output(1, "y", Type::Float64)])
            .terminals([Terminal::new("port", "").member("y", "y").member("y", "z"), Terminal::new("bare", "\u{7}")])
            .log_category("logStatusError", "")
            .capabilities(Capabilities { serialize: true, ..Capabilities::default() });
        let Err(Error::Description(problems)) = description.check() else { panic!("not refused") };
        let text: Vec<_> = problems.iter().map(ToString::to_string).collect();
        assert_eq!(problems.len(), 11, "{text:#?}");
    }
}
