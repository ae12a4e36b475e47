//! What `modelDescription.xml` says, as far as co-simulation needs it, in FMI 3.0 and FMI 2.0.

use std::collections::BTreeMap;
use std::str::FromStr;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::measure::{BASE_UNITS, Conversion, Measure};

/// Version of the standard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Version {
    /// FMI 2.0.
    Two,
    /// FMI 3.0.
    #[default]
    Three,
}

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
    /// Truth value.
    Boolean,
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
    /// Its number for the C functions; where scalars `name[i]` are gathered, that of each.
    pub references: Vec<u32>,
    /// Its type.
    pub ty: VariableType,
    /// What it is to the unit.
    pub causality: Causality,
    /// Its unit of measure, if it has one.
    pub unit: Option<String>,
    /// From what the C functions have to this unit of measure.
    pub conversion: Conversion,
    /// Its dimensions; none for a scalar.
    pub dimensions: Vec<usize>,
    /// Number of entries: the product of its dimensions, 1 for a scalar.
    pub size: usize,
}

/// A model description.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Description {
    /// Version of the standard.
    pub version: Version,
    /// Name of the model.
    pub model_name: String,
    /// What the unit says of itself.
    pub about: String,
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
    /// Whether time steps may differ in size.
    pub takes_any_step: bool,
    /// The variables by name.
    pub variables: BTreeMap<String, Variable>,
    /// The units of measure that are defined, by name.
    pub units: BTreeMap<String, Measure>,
}

impl Description {
    /// Reads the XML text.
    ///
    /// # Errors
    /// What is wrong with it: not XML, not FMI 2 or 3, no co-simulation, or a variable without name or reference.
    pub fn parse(xml: &str) -> Result<Self, String> {
        let mut description = Self::default();
        let mut sizes = Sizes::default();
        let mut reader = Reader::from_str(xml);
        let mut in_variables = false;
        // The unit of measure whose element is open or was last.
        let mut unit = String::new();
        // The type whose element was last, the units of measure of types, and the types of variables.
        let (mut simple, mut types, mut declared) = (String::new(), BTreeMap::new(), Vec::new());
        // The variable whose element is open, and the name of the element.
        let mut current: Option<(String, Variable)> = None;
        loop {
            let event = reader.read_event().map_err(|e| format!("it is not XML: {e}"))?;
            let is_empty = matches!(event, Event::Empty(_));
            match event {
                Event::Start(e) | Event::Empty(e) => match e.name().as_ref() {
                    "fmiModelDescription" => {
                        let version = attribute(&e, "fmiVersion")?.unwrap_or_default();
                        description.version = match version.split('.').next() {
                            Some("2") => Version::Two,
                            Some("3") => Version::Three,
                            _ => return Err(format!("its FMI version is {version:?}; version 2 or 3 is needed")),
                        };
                        description.model_name = attribute(&e, "modelName")?.unwrap_or_default();
                        description.about = attribute(&e, "description")?.unwrap_or_default();
                        description.token =
                            attribute(&e, "instantiationToken")?.or(attribute(&e, "guid")?).unwrap_or_default();
                    }
                    "CoSimulation" => {
                        let flag =
                            |name| Ok::<_, String>(attribute(&e, name)?.is_some_and(|v| v == "true" || v == "1"));
                        description.identifier = attribute(&e, "modelIdentifier")?.unwrap_or_default();
                        // FMI 2 spells them a little differently.
                        description.has_state = flag("canGetAndSetFMUState")? || flag("canGetAndSetFMUstate")?;
                        description.serialises_state = flag("canSerializeFMUState")? || flag("canSerializeFMUstate")?;
                        description.has_derivatives =
                            flag("providesDirectionalDerivatives")? || flag("providesDirectionalDerivative")?;
                        description.takes_any_step = flag("canHandleVariableCommunicationStepSize")?;
                    }
                    "Unit" => unit = attribute(&e, "name")?.unwrap_or_default(),
                    "BaseUnit" => drop(description.units.insert(unit.clone(), read_measure(&e)?)),
                    "ModelVariables" => in_variables = true,
                    "SimpleType" => simple = attribute(&e, "name")?.unwrap_or_default(),
                    "Float64Type" | "Real" if !in_variables => {
                        let name = attribute(&e, "name")?.unwrap_or_else(|| simple.clone());
                        if let Some(unit) = attribute(&e, "unit")? {
                            types.insert(name, unit);
                        }
                    }
                    "Dimension" => {
                        if let Some((_, variable)) = &current {
                            let start = number(&e, "start")?;
                            sizes.dimensions.push((variable.name.clone(), start, number(&e, "valueReference")?));
                        }
                    }
                    name if in_variables && description.version == Version::Two && name != "ScalarVariable" => {
                        // The type of a variable of FMI 2 is an element in it.
                        if let Some((_, variable)) = &mut current
                            && variable.ty == VariableType::Other
                        {
                            (variable.ty, variable.unit) = (variable_type(name), attribute(&e, "unit")?);
                            declared.extend(attribute(&e, "declaredType")?.map(|ty| (variable.name.clone(), ty)));
                        }
                    }
                    _ if in_variables && current.is_none() => {
                        let variable = read_variable(&e)?;
                        declared.extend(attribute(&e, "declaredType")?.map(|ty| (variable.name.clone(), ty)));
                        sizes.starts.insert(u64::from(variable.references[0]), number(&e, "start").ok().flatten());
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
        for (variable, ty) in declared {
            if let Some(variable) = description.variables.get_mut(&variable) {
                variable.unit = variable.unit.take().or_else(|| types.get(&ty).cloned());
            }
        }
        description.gather();
        Ok(description)
    }

    /// Makes arrays of scalars `name[0]`, `name[1]`, … or `name[1]`, `name[2]`, … that have no gap and are alike.
    fn gather(&mut self) {
        let mut groups: BTreeMap<String, BTreeMap<usize, String>> = BTreeMap::new();
        for variable in self.variables.values().filter(|v| v.size == 1) {
            if let Some((base, index)) = variable.name.strip_suffix(']').and_then(|name| name.rsplit_once('['))
                && let Ok(index) = index.parse()
            {
                groups.entry(base.to_owned()).or_default().insert(index, variable.name.clone());
            }
        }
        for (base, members) in groups {
            let first = *members.keys().next().unwrap_or(&0);
            let has_gap = members.keys().enumerate().any(|(i, &index)| index != first + i);
            let of = |name: &String| &self.variables[name];
            let alike = |a: &Variable, b: &Variable| (a.ty, a.causality, &a.unit) == (b.ty, b.causality, &b.unit);
            let model = of(&members[&first]);
            if first > 1
                || has_gap
                || self.variables.contains_key(&base)
                || !members.values().all(|m| alike(of(m), model))
            {
                continue;
            }
            let references: Vec<u32> = members.values().map(|m| of(m).references[0]).collect();
            let (name, size) = (base.clone(), references.len());
            let array = Variable { name, dimensions: vec![size], size, references, ..model.clone() };
            members.values().for_each(|name| drop(self.variables.remove(name)));
            self.variables.insert(base, array);
        }
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
                variable.dimensions.push(size);
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
    let causality = match attribute(e, "causality")?.as_deref() {
        Some("input") => Causality::Input,
        Some("output") => Causality::Output,
        Some("parameter") => Causality::Parameter,
        _ => Causality::Other,
    };
    let ty = match e.name().as_ref() {
        "Enumeration" => VariableType::Int64,
        other => variable_type(other),
    };
    let unit = attribute(e, "unit")?;
    let (references, conversion, dimensions) = (vec![reference], Conversion::NONE, Vec::new());
    Ok(Variable { name, references, ty, causality, unit, conversion, dimensions, size: 1 })
}

/// The type that an element names. Enumerations are those of FMI 2.
fn variable_type(element: &str) -> VariableType {
    match element {
        "Float64" | "Real" => VariableType::Float64,
        "Int64" => VariableType::Int64,
        "UInt64" => VariableType::UInt64,
        "Int32" | "Integer" | "Enumeration" => VariableType::Int32,
        "Boolean" => VariableType::Boolean,
        "String" => VariableType::String,
        _ => VariableType::Other,
    }
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
        let sizes: Vec<_> = d.variables.values().map(|v| (v.name.as_str(), v.references[0], v.size)).collect();
        assert_eq!(sizes, [("e", 4, 5), ("n", 9, 1), ("p", 3, 6), ("s", 5, 1)]);
        assert_eq!(d.units["Pa"].exponents, [1, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(d.variables["e"].ty, VariableType::Int64);
        assert_eq!(d.variables["p"].unit.as_deref(), Some("Pa"));
        assert_eq!(d.variables["p"].causality, Causality::Input);
    }

    #[test]
    fn scalars_of_fmi_2_become_arrays() {
        let variable = |name: &str, reference: u32, causality: &str, unit: &str| {
            format!(
                r#"<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}"><Real {unit}/></ScalarVariable>"#
            )
        };
        let list = [
            variable("p[0]", 7, "output", r#"declaredType="Pressure""#),
            variable("p[1]", 5, "output", r#"unit="bar""#),
            variable("q[1]", 1, "input", ""),
            variable("q[2]", 2, "input", ""),
            variable("gap[1]", 10, "input", ""),
            variable("gap[3]", 11, "input", ""),
            variable("mixed[1]", 12, "input", ""),
            variable("mixed[2]", 13, "output", ""),
        ];
        let xml = format!(
            r#"<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g">
  <CoSimulation modelIdentifier="m" canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true"/>
  <UnitDefinitions><Unit name="bar"><BaseUnit kg="1" m="-1" s="-2" factor="1e5"/><DisplayUnit name="mbar" factor="1e3"/></Unit></UnitDefinitions>
  <TypeDefinitions><SimpleType name="Pressure"><Real unit="bar"/></SimpleType></TypeDefinitions>
  <ModelVariables>{}<ScalarVariable name="n" valueReference="3"><Integer/></ScalarVariable></ModelVariables>
</fmiModelDescription>"#,
            list.concat()
        );
        let d = Description::parse(&xml).unwrap();
        assert_eq!((d.version, d.token.as_str(), d.has_state, d.takes_any_step), (Version::Two, "g", true, true));
        let names: Vec<_> = d.variables.values().map(|v| (v.name.as_str(), &v.references[..], v.size)).collect();
        assert_eq!(
            names,
            [
                ("gap[1]", &[10][..], 1),
                ("gap[3]", &[11], 1),
                ("mixed[1]", &[12], 1),
                ("mixed[2]", &[13], 1),
                ("n", &[3], 1),
                ("p", &[7, 5], 2),
                ("q", &[1, 2], 2),
            ]
        );
        assert_eq!((d.variables["p"].unit.as_deref(), d.units["bar"].factor), (Some("bar"), 1e5));
        assert_eq!(d.variables["n"].ty, VariableType::Int32);
    }

    #[test]
    fn says_what_is_wrong() {
        for (old, new, part) in [
            ("fmiVersion=\"3.0\"", "fmiVersion=\"1.0\"", "version 2 or 3 is needed"),
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
