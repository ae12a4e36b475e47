//! Writes `modelDescription.xml` and `terminalsAndIcons.xml`.
//!
//! The bytes depend on the description alone: order is that of the description, numbers are written in
//! the shortest form that reads back to the same bits, and there is no date.

use std::fmt::Display;

use quick_xml::escape::escape;
use quick_xml::events::attributes::Attribute;
use quick_xml::events::{BytesDecl, BytesEnd, BytesStart, Event};
use quick_xml::name::QName;

use crate::description::{BASE_UNITS, Capabilities, Description, UnitDefinition};
use crate::variables::{Causality, Initial, Start, Type, Variable};

/// The content of `modelDescription.xml`.
pub fn model_description(description: &Description, token: &str) -> String {
    let d = description;
    let mut root = Attributes::new("fmiModelDescription");
    root.set("fmiVersion", "3.0");
    root.set("modelName", &d.model_name);
    root.set("instantiationToken", token);
    root.set_text("description", &d.about);
    root.set_text("author", &d.author);
    root.set_text("version", &d.version);
    root.set_text("license", &d.license);
    root.set("generationTool", concat!("fmi-unit ", env!("CARGO_PKG_VERSION")));
    root.set("variableNamingConvention", "structured");
    document(root, |w| {
        w.empty(co_simulation(d));
        w.group("UnitDefinitions", &d.units, |w, unit| {
            let mut a = Attributes::new("Unit");
            a.set("name", &unit.name);
            w.parent(a, |w| w.empty(base_unit(unit)));
        });
        w.group("TypeDefinitions", &d.enumerations, |w, enumeration| {
            let mut a = Attributes::new("EnumerationType");
            a.set("name", &enumeration.name);
            w.parent(a, |w| {
                for item in &enumeration.items {
                    let mut a = Attributes::new("Item");
                    a.set("name", &item.name);
                    a.set("value", item.value);
                    w.empty(a);
                }
            });
        });
        w.group("LogCategories", &d.all_categories().collect::<Vec<_>>(), |w, (name, about)| {
            let mut a = Attributes::new("Category");
            a.set("name", name);
            a.set_text("description", about);
            w.empty(a);
        });
        if let Some(experiment) = d.experiment {
            let mut a = Attributes::new("DefaultExperiment");
            a.set("startTime", experiment.start);
            a.set("stopTime", experiment.stop);
            a.set("stepSize", experiment.step);
            w.empty(a);
        }
        let variables: Vec<_> = d.all_variables().collect();
        w.group("ModelVariables", &variables, write_variable);
        w.parent(Attributes::new("ModelStructure"), |w| {
            let outputs = variables.iter().filter(|v| v.causality == Causality::Output);
            outputs.for_each(|v| w.empty(unknown("Output", v)));
            let unknowns = variables.iter().filter(|v| v.is_initial_unknown());
            unknowns.for_each(|v| w.empty(unknown("InitialUnknown", v)));
        });
    })
}

/// The content of `terminalsAndIcons.xml`; `icon` tells whether there is an `icon.png`.
pub fn terminals_and_icons(description: &Description, icon: bool) -> String {
    let mut root = Attributes::new("fmiTerminalsAndIcons");
    root.set("fmiVersion", "3.0");
    document(root, |w| {
        if icon {
            w.parent(Attributes::new("GraphicalRepresentation"), |w| {
                let mut system = box_of("CoordinateSystem");
                system.set("suggestedScalingFactorTo_mm", 0.1);
                w.empty(system);
                w.empty(box_of("Icon"));
            });
        }
        w.group("Terminals", &description.terminals, |w, terminal| {
            let mut a = Attributes::new("Terminal");
            a.set("name", &terminal.name);
            // Members are connected by name, and those that one side lacks stay open.
            a.set("matchingRule", "bus");
            a.set_text("description", &terminal.about);
            w.parent(a, |w| {
                for (member, variable) in &terminal.members {
                    let mut a = Attributes::new("TerminalMemberVariable");
                    a.set("memberName", member);
                    a.set("variableName", variable);
                    a.set("variableKind", "signal");
                    w.empty(a);
                }
            });
        });
    })
}

fn box_of(element: &str) -> Attributes {
    let mut a = Attributes::new(element);
    for (name, value) in [("x1", -100), ("y1", -100), ("x2", 100), ("y2", 100)] {
        a.set(name, value);
    }
    a
}

fn co_simulation(d: &Description) -> Attributes {
    let Capabilities { state, serialize, directional_derivative, adjoint_derivative, fixed_step } = d.capabilities;
    let mut a = Attributes::new("CoSimulation");
    a.set("modelIdentifier", &d.identifier);
    a.set("canGetAndSetFMUState", state);
    a.set("canSerializeFMUState", serialize);
    a.set("providesDirectionalDerivatives", directional_derivative);
    a.set("providesAdjointDerivatives", adjoint_derivative);
    a.set("canHandleVariableCommunicationStepSize", !fixed_step);
    a
}

fn base_unit(unit: &UnitDefinition) -> Attributes {
    let mut a = Attributes::new("BaseUnit");
    for (name, exponent) in BASE_UNITS.iter().zip(unit.exponents) {
        if exponent != 0 {
            a.set(name, exponent);
        }
    }
    if unit.factor != 1.0 {
        a.set("factor", Float(unit.factor));
    }
    if unit.offset != 0.0 {
        a.set("offset", Float(unit.offset));
    }
    a
}

fn unknown(element: &str, variable: &Variable) -> Attributes {
    let mut a = Attributes::new(element);
    a.set("valueReference", variable.reference);
    if let Some(dependencies) = &variable.dependencies {
        a.set("dependencies", list(dependencies));
    }
    a
}

fn write_variable(w: &mut Writer, v: &Variable) {
    let mut a = Attributes::new(&format!("{:?}", v.ty));
    a.set("name", &v.name);
    a.set("valueReference", v.reference);
    a.set_text("description", &v.description);
    a.set("causality", v.causality.name());
    a.set("variability", v.variability.name());
    // Inputs are always exact, and time has no initial value.
    let implied = matches!(v.causality, Causality::Input | Causality::Independent);
    if let Some(initial) = v.initial.filter(|_| !implied) {
        a.set("initial", initial.name());
    }
    if let Some(declared) = &v.declared_type {
        a.set("declaredType", declared);
    }
    if let Some(unit) = &v.unit {
        a.set("unit", unit);
    }
    if let Some(state) = v.derivative_of {
        a.set("derivative", state);
    }
    for (name, value) in [("min", v.min), ("max", v.max), ("nominal", v.nominal)] {
        if let Some(value) = value {
            a.set(name, Float(value));
        }
    }
    let mut elements = Vec::new();
    match v.start.as_ref().filter(|_| v.initial != Some(Initial::Calculated)) {
        None => {}
        Some(Start::Float(values)) if v.ty == Type::Float32 => {
            a.set("start", list(&values.iter().map(|x| Float(*x as f32)).collect::<Vec<_>>()));
        }
        Some(Start::Float(values)) => a.set("start", list(&values.iter().map(|x| Float(*x)).collect::<Vec<_>>())),
        Some(Start::Integer(values)) => a.set("start", list(values)),
        Some(Start::Unsigned(values)) => a.set("start", list(values)),
        Some(Start::Boolean(values)) => a.set("start", list(values)),
        Some(Start::String(values)) => elements = values.clone(),
        Some(Start::Binary(values)) => {
            let hex = |bytes: &Vec<u8>| bytes.iter().map(|b| format!("{b:02x}")).collect();
            elements = values.iter().map(hex).collect();
        }
    }
    w.parent(a, |w| {
        for size in &v.dimensions {
            let mut a = Attributes::new("Dimension");
            a.set("start", size);
            w.empty(a);
        }
        for value in &elements {
            let mut a = Attributes::new("Start");
            a.set("value", value);
            w.empty(a);
        }
    });
}

fn list<T: Display>(values: &[T]) -> String {
    let values: Vec<_> = values.iter().map(ToString::to_string).collect();
    values.join(" ")
}

/// A float as XML Schema writes it: shortest digits, `INF`, `NaN`.
struct Float<T>(T);

impl<T: Display + std::fmt::LowerExp + Into<f64> + Copy> Display for Float<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let value: f64 = self.0.into();
        if value.is_nan() {
            f.write_str("NaN")
        } else if value.is_infinite() {
            f.write_str(if value > 0.0 { "INF" } else { "-INF" })
        } else if value != 0.0 && !(1e-4..1e7).contains(&value.abs()) {
            write!(f, "{:e}", self.0)
        } else {
            write!(f, "{}", self.0)
        }
    }
}

struct Attributes {
    name: String,
    list: Vec<(String, String)>,
}

impl Attributes {
    fn new(name: &str) -> Self {
        Attributes { name: name.to_owned(), list: Vec::new() }
    }

    fn set(&mut self, name: &str, value: impl Display) {
        self.list.push((name.to_owned(), value.to_string()));
    }

    fn set_text(&mut self, name: &str, value: &str) {
        if !value.is_empty() {
            self.set(name, value);
        }
    }

    fn start(&self) -> BytesStart<'static> {
        let mut start = BytesStart::new(self.name.clone());
        for (name, value) in &self.list {
            // A reader turns bare white space into blanks, so it is written as references.
            let value = escape(value.as_str()).replace('\n', "&#10;").replace('\r', "&#13;").replace('\t', "&#9;");
            start.push_attribute(Attribute { key: QName(name.as_str()), value: value.into() });
        }
        start
    }
}

struct Writer(quick_xml::Writer<Vec<u8>>);

fn document(root: Attributes, content: impl FnOnce(&mut Writer)) -> String {
    let mut writer = Writer(quick_xml::Writer::new_with_indent(Vec::new(), b' ', 2));
    writer.event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)));
    writer.parent(root, content);
    let mut bytes = writer.0.into_inner();
    bytes.push(b'\n');
    String::from_utf8(bytes).expect("only strings were written")
}

impl Writer {
    fn event(&mut self, event: Event<'_>) {
        self.0.write_event(event).expect("writing to memory does not fail");
    }

    fn empty(&mut self, attributes: Attributes) {
        self.event(Event::Empty(attributes.start()));
    }

    fn parent(&mut self, attributes: Attributes, content: impl FnOnce(&mut Writer)) {
        self.event(Event::Start(attributes.start()));
        content(self);
        self.event(Event::End(BytesEnd::new(attributes.name)));
    }

    /// An element around `items`, left out if there are none.
    fn group<T>(&mut self, name: &str, items: &[T], each: impl Fn(&mut Writer, &T)) {
        if !items.is_empty() {
            self.parent(Attributes::new(name), |w| items.iter().for_each(|item| each(w, item)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::{Enumeration, Terminal};

    fn description() -> Description {
        Description::new("A & B", "ab")
            .about("two\nlines")
            .units([UnitDefinition::new("bar").kilogram(1).metre(-1).second(-2).scaled(1e5, 0.0)])
            .enumerations([Enumeration::new("Phase").item("solid", 1)])
            .variables([
                Variable::input(1, "u", Type::Float64).unit("bar").dimensions(&[3]).start(vec![0.1, -1e300, 3.0]),
                Variable::output(2, "y", Type::Float64).depends_on(&[1]),
                Variable::output(3, "phase", Type::Int64).enumeration("Phase"),
                Variable::parameter(4, "names", Type::String)
                    .dimensions(&[2])
                    .start(vec!["a".to_owned(), "\"<".to_owned()]),
                Variable::parameter(5, "blob", Type::Binary).start(vec![0u8, 255]),
            ])
            .terminals([Terminal::new("port", "").member("pressure", "u")])
    }

    #[test]
    fn the_same_description_gives_the_same_bytes() {
        assert_eq!(model_description(&description(), "t"), model_description(&description(), "t"));
    }

    #[test]
    fn what_is_declared_is_written() {
        let xml = model_description(&description(), "t");
        for expected in [
            r#"modelName="A &amp; B""#,
            r#"description="two&#10;lines""#,
            r#"<BaseUnit kg="1" m="-1" s="-2" factor="100000"/>"#,
            r#"start="0.1 -1e300 3""#,
            r#"<Dimension start="3"/>"#,
            r#"<Start value="&quot;&lt;"/>"#,
            r#"<Start value="00ff"/>"#,
            r#"<Enumeration name="phase" valueReference="3" causality="output" variability="discrete" initial="calculated" declaredType="Phase">"#,
            r#"<Output valueReference="2" dependencies="1"/>"#,
            r#"<InitialUnknown valueReference="3"/>"#,
        ] {
            assert!(xml.contains(expected), "{expected} is not in\n{xml}");
        }
        let terminals = terminals_and_icons(&description(), true);
        assert!(terminals.contains(r#"memberName="pressure" variableName="u""#), "{terminals}");
    }

    #[test]
    fn floats_keep_their_bits() {
        for value in [0.1, 1e-300, 123456789.123, -0.0, 1.0 / 3.0, f64::MAX] {
            assert_eq!(Float(value).to_string().parse::<f64>().unwrap().to_bits(), value.to_bits());
        }
        assert_eq!(Float(0.1f32).to_string(), "0.1");
        assert_eq!(Float(f64::NEG_INFINITY).to_string(), "-INF");
    }
}
