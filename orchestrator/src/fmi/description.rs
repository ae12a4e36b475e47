//! What `modelDescription.xml` says, as far as co-simulation needs it.

use std::collections::BTreeMap;
use std::str::FromStr;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::measure::{BASE_UNITS, Measure};

/// What a variable is to its unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Causality {
    /// Set by the partner.
    Input,
    /// Read by the partner.
    Output,
    /// Set before the start, or between time steps where it is tunable.
    Parameter,
    /// All else.
    Other,
}

/// Type of a variable, as far as it can be read or set here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VariableType {
    /// 64-bit float.
    Float64,
    /// 64-bit integer, or an enumeration.
    Int64,
    /// 64-bit unsigned integer.
    UInt64,
    /// 32-bit integer.
    Int32,
    /// Text.
    String,
    /// Any other.
    Other,
}

/// A variable.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// Its number for the C functions.
    pub reference: u32,
    /// Its type.
    pub ty: VariableType,
    /// What it is to the unit.
    pub causality: Causality,
    /// Its unit of measure, if it has one.
    pub unit: Option<String>,
    /// Number of entries: the product of its dimensions, 1 for a scalar.
    pub size: usize,
}

/// A model description.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Description {
    /// Name of the model.
    pub model_name: String,
    /// Token that the instance is made with.
    pub token: String,
    /// Name of the library, without its ending.
    pub identifier: String,
    /// Whether states can be kept and restored.
    pub has_state: bool,
    /// Whether states can be bytes.
    pub serialises_state: bool,
    /// Whether there are directional derivatives.
    pub has_derivatives: bool,
    /// The variables by name.
    pub variables: BTreeMap<String, Variable>,
    /// The units of measure that are defined, by name.
    pub units: BTreeMap<String, Measure>,
}

impl Description {
    /// Reads the XML text.
    ///
    /// # Errors
    /// What is wrong with it: not XML, not FMI 3, no co-simulation, or a variable without name or reference.
    pub fn parse(xml: &str) -> Result<Self, String> {
        let mut description = Self::default();
        let mut sizes = Sizes::default();
        let mut reader = Reader::from_str(xml);
        let mut in_variables = false;
        // The unit of measure whose element is open or was last.
        let mut unit = String::new();
        // The variable whose element is open, and the name of the element.
        let mut current: Option<(String, Variable)> = None;
        loop {
            let event = reader.read_event().map_err(|e| format!("it is not XML: {e}"))?;
            let is_empty = matches!(event, Event::Empty(_));
            match event {
                Event::Start(e) | Event::Empty(e) => match e.name().as_ref() {
                    "fmiModelDescription" => {
                        let version = attribute(&e, "fmiVersion")?.unwrap_or_default();
                        if !version.starts_with("3.") {
                            return Err(format!("its FMI version is {version:?}; version 3 is needed"));
                        }
                        description.model_name = attribute(&e, "modelName")?.unwrap_or_default();
                        description.token = attribute(&e, "instantiationToken")?.unwrap_or_default();
                    }
                    "CoSimulation" => {
                        let flag =
                            |name| Ok::<_, String>(attribute(&e, name)?.is_some_and(|v| v == "true" || v == "1"));
                        description.identifier = attribute(&e, "modelIdentifier")?.unwrap_or_default();
                        description.has_state = flag("canGetAndSetFMUState")?;
                        description.serialises_state = flag("canSerializeFMUState")?;
                        description.has_derivatives = flag("providesDirectionalDerivatives")?;
                    }
                    "Unit" => unit = attribute(&e, "name")?.unwrap_or_default(),
                    "BaseUnit" => drop(description.units.insert(unit.clone(), read_measure(&e)?)),
                    "ModelVariables" => in_variables = true,
                    "Dimension" => {
                        if let Some((_, variable)) = &current {
                            let start = number(&e, "start")?;
                            sizes.dimensions.push((variable.name.clone(), start, number(&e, "valueReference")?));
                        }
                    }
                    _ if in_variables && current.is_none() => {
                        let variable = read_variable(&e)?;
                        sizes.starts.insert(u64::from(variable.reference), number(&e, "start").ok().flatten());
                        if is_empty {
                            description.variables.insert(variable.name.clone(), variable);
                        } else {
                            current = Some((e.name().as_ref().to_owned(), variable));
                        }
                    }
                    _ => {}
                },
                Event::End(e) => {
                    let name = e.name();
                    in_variables &= name.as_ref() != "ModelVariables";
                    if let Some((_, variable)) = current.take_if(|(element, _)| element == name.as_ref()) {
                        description.variables.insert(variable.name.clone(), variable);
                    }
                }
                Event::Eof => break,
                _ => {}
            }
        }
        if description.identifier.is_empty() {
            return Err("it has no co-simulation interface".into());
        }
        sizes.apply(&mut description.variables)?;
        Ok(description)
    }
}

/// Dimensions, which may refer to the start values of variables that come later.
#[derive(Default)]
struct Sizes {
    dimensions: Vec<(String, Option<u64>, Option<u64>)>,
    starts: BTreeMap<u64, Option<u64>>,
}

impl Sizes {
    fn apply(self, variables: &mut BTreeMap<String, Variable>) -> Result<(), String> {
        for (name, start, reference) in self.dimensions {
            let of_reference = reference.and_then(|r| self.starts.get(&r).copied().flatten());
            let size = start.or(of_reference).and_then(|n| usize::try_from(n).ok());
            let size = size.ok_or_else(|| format!("a dimension of \"{name}\" has no size"))?;
            if let Some(variable) = variables.get_mut(&name) {
                variable.size = variable.size.checked_mul(size).ok_or_else(|| format!("\"{name}\" is too large"))?;
            }
        }
        Ok(())
    }
}

fn read_measure(e: &BytesStart<'_>) -> Result<Measure, String> {
    let mut measure = Measure { exponents: [0; 8], factor: 1.0, offset: 0.0 };
    for (exponent, name) in measure.exponents.iter_mut().zip(BASE_UNITS) {
        *exponent = number(e, name)?.unwrap_or(0);
    }
    measure.factor = number(e, "factor")?.unwrap_or(1.0);
    measure.offset = number(e, "offset")?.unwrap_or(0.0);
    Ok(measure)
}

fn read_variable(e: &BytesStart<'_>) -> Result<Variable, String> {
    let name = attribute(e, "name")?.ok_or("a variable has no name")?;
    let reference = number::<u32>(e, "valueReference")?;
    let reference = reference.ok_or_else(|| format!("the variable \"{name}\" has no reference"))?;
    let ty = match e.name().as_ref() {
        "Float64" => VariableType::Float64,
        "Int64" | "Enumeration" => VariableType::Int64,
        "UInt64" => VariableType::UInt64,
        "Int32" => VariableType::Int32,
        "String" => VariableType::String,
        _ => VariableType::Other,
    };
    let causality = match attribute(e, "causality")?.as_deref() {
        Some("input") => Causality::Input,
        Some("output") => Causality::Output,
        Some("parameter") => Causality::Parameter,
        _ => Causality::Other,
    };
    Ok(Variable { name, reference, ty, causality, unit: attribute(e, "unit")?, size: 1 })
}

fn attribute(e: &BytesStart<'_>, name: &str) -> Result<Option<String>, String> {
    match e.try_get_attribute(name).map_err(|e| format!("it is not XML: {e}"))? {
        Some(a) => {
            let value = quick_xml::escape::unescape(&a.value).map_err(|e| format!("\"{name}\": {e}"))?;
            Ok(Some(value.into_owned()))
        }
        None => Ok(None),
    }
}

fn number<T: FromStr>(e: &BytesStart<'_>, name: &str) -> Result<Option<T>, String> {
    let text = attribute(e, name)?;
    text.map(|t| t.parse().map_err(|_| format!("\"{name}\" is \"{t}\", not a number"))).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    const XML: &str = r#"<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="a &amp; " instantiationToken="{1}">
  <CoSimulation modelIdentifier="lib" canGetAndSetFMUState="true" canSerializeFMUState="false"/>
  <UnitDefinitions><Unit name="Pa"><BaseUnit kg="1"/></Unit></UnitDefinitions>
  <ModelVariables>
    <Float64 name="p" valueReference="3" causality="input" unit="Pa" start="0 0"><Dimension start="2"/><Dimension valueReference="9"/></Float64>
    <Enumeration name="e" valueReference="4" causality="output" declaredType="E"><Dimension start="5"/><Alias name="f"/></Enumeration>
    <String name="s" valueReference="5"><Start value="x"/></String>
    <UInt64 name="n" valueReference="9" causality="structuralParameter" start="3"/>
  </ModelVariables>
  <ModelStructure><Output valueReference="4"/></ModelStructure>
</fmiModelDescription>"#;

    #[test]
    fn reads_what_is_needed() {
        let d = Description::parse(XML).unwrap();
        assert_eq!((d.model_name.as_str(), d.token.as_str(), d.identifier.as_str()), ("a & ", "{1}", "lib"));
        assert_eq!((d.has_state, d.serialises_state, d.has_derivatives), (true, false, false));
        let sizes: Vec<_> = d.variables.values().map(|v| (v.name.as_str(), v.reference, v.size)).collect();
        assert_eq!(sizes, [("e", 4, 5), ("n", 9, 1), ("p", 3, 6), ("s", 5, 1)]);
        assert_eq!(d.units["Pa"].exponents, [1, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(d.variables["e"].ty, VariableType::Int64);
        assert_eq!(d.variables["p"].unit.as_deref(), Some("Pa"));
        assert_eq!(d.variables["p"].causality, Causality::Input);
    }

    #[test]
    fn says_what_is_wrong() {
        for (old, new, part) in [
            ("fmiVersion=\"3.0\"", "fmiVersion=\"2.0\"", "version 3 is needed"),
            ("CoSimulation", "ModelExchange", "no co-simulation"),
            ("valueReference=\"3\"", "", "\"p\" has no reference"),
            ("valueReference=\"3\"", "valueReference=\"x\"", "is \"x\", not a number"),
            ("name=\"p\"", "", "has no name"),
            ("start=\"3\"", "", "a dimension of \"p\" has no size"),
            ("</Float64>", "</Float>", "not XML"),
        ] {
            let error = Description::parse(&XML.replace(old, new)).unwrap_err();
            assert!(error.contains(part), "{old}: {error}");
        }
    }
}
