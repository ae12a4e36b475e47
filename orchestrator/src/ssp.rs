//! The wiring of units as an archive of the standard SSP 2.0 (System Structure and Parameterization), which other tools
//! open: the units, their connections by name, start values.
//!
//! | entry | content |
//! |---|---|
//! | `SystemStructure.ssd` | components, connectors, connections, units of measure, times |
//! | `resources/UNIT.fmu` | the units |
//! | `resources/UNIT.ssv` | parameters that are set |
//!
//! A tool that couples explicitly sees in `…_reference`, connected from the same unit's field, the value at the last
//! communication point: that at which its partner was evaluated.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use model::Parameter;
use quick_xml::Writer;
use quick_xml::events::{BytesDecl, Event};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::fmi::{Causality, Description, Measure, Variable, VariableType, Version};
use crate::interface::{Interface, Scheme};

const SSD: &str = "http://ssp-standard.org/SSP1/SystemStructureDescription";
const SSC: &str = "http://ssp-standard.org/SSP1/SystemStructureCommon";
const SSV: &str = "http://ssp-standard.org/SSP1/SystemStructureParameterValues";
const TOOL: &str = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));

/// A unit of the archive.
#[derive(Clone, Debug)]
pub struct Component {
    /// Its name.
    pub name: String,
    /// Its FMU.
    pub fmu: PathBuf,
    /// What the FMU says of itself.
    pub description: Description,
    /// Parameters that are set.
    pub parameters: BTreeMap<String, Parameter>,
}

/// A system of units.
#[derive(Clone, Debug)]
pub struct System<'a> {
    /// Its name.
    pub name: &'a str,
    /// What it is, for people.
    pub title: &'a str,
    /// The units, in the order of the interface's numbers.
    pub components: Vec<Component>,
    /// What they exchange.
    pub interface: &'a Interface,
    /// Which sensitivities are connected.
    pub scheme: Scheme,
    /// Start and end (s).
    pub span: [f64; 2],
}

/// Unit and variable of both ends of a connection, the output first.
type Link = [(usize, String); 2];

impl System<'_> {
    /// Writes the archive, under a temporary name first. The same system gives the same bytes.
    ///
    /// # Errors
    /// The operating system; a unit whose arrays are gathered from scalars, which the standard cannot connect to arrays.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let part = path.with_extension("ssp.part");
        let result = self.write_to(&part).and_then(|()| std::fs::rename(&part, path));
        if result.is_err() {
            // What is left of it is of no use; that it cannot be removed either says nothing new.
            let _ = std::fs::remove_file(&part);
        }
        result
    }

    fn write_to(&self, path: &Path) -> io::Result<()> {
        let structure = self.structure()?;
        let mut zip = ZipWriter::new(File::create(path)?);
        let options = SimpleFileOptions::default().last_modified_time(DateTime::default());
        zip.start_file("SystemStructure.ssd", options)?;
        zip.write_all(&structure)?;
        for component in &self.components {
            if !component.parameters.is_empty() {
                zip.start_file(format!("resources/{}.ssv", component.name), options)?;
                zip.write_all(&parameters(component)?)?;
            }
            // FMUs are compressed already.
            let stored = options.compression_method(CompressionMethod::Stored).large_file(true);
            zip.start_file(format!("resources/{}.fmu", component.name), stored)?;
            io::copy(&mut File::open(&component.fmu)?, &mut zip)?;
        }
        zip.finish()?.sync_all()
    }

    /// All connections: fields, the sensitivities that the scheme connects with their references, and further ones.
    fn links(&self) -> Vec<Link> {
        let mut links = Vec::new();
        let mut add = |from: (usize, &str), to: (usize, &str)| {
            links.push([from, to].map(|(unit, name)| (unit, name.to_owned())));
        };
        for field in &self.interface.fields {
            let taker = 1 - field.from;
            add((field.from, &field.name), (taker, &field.name));
            if let Some(sensitivity) = field.sensitivity.as_ref().filter(|_| self.scheme.connected[field.from]) {
                add((field.from, &sensitivity.variable), (taker, &sensitivity.variable));
                let own = &self.interface.fields[sensitivity.partner].name;
                add((taker, own), (taker, &format!("{own}_reference")));
            }
        }
        self.interface.connections.iter().for_each(|c| add((c.from.0, &c.from.1), (c.to.0, &c.to.1)));
        links
    }

    fn variable(&self, unit: usize, name: &str) -> io::Result<&Variable> {
        let component = &self.components[unit];
        let fail = |what: &str| io::Error::other(format!("{}: {name} {what}", component.name));
        let variable = component.description.variables.get(name).ok_or_else(|| fail("is missing"))?;
        if variable.references.len() > 1 {
            return Err(fail("is given by scalars, which SSP cannot connect to the entries of an array"));
        }
        Ok(variable)
    }

    /// `SystemStructure.ssd`.
    fn structure(&self) -> io::Result<Vec<u8>> {
        let links = self.links();
        let mut measures: BTreeMap<&str, Measure> = BTreeMap::new();
        let mut connectors = vec![BTreeMap::new(); self.components.len()];
        for (unit, name) in links.iter().flatten() {
            let variable = self.variable(*unit, name)?;
            connectors[*unit].insert(name.as_str(), variable);
            if let Some(unit_of_measure) = &variable.unit
                && let Some(measure) = self.components[*unit].description.units.get(unit_of_measure)
            {
                measures.insert(unit_of_measure, *measure);
            }
        }
        let mut xml = declared()?;
        let root = xml.create_element("ssd:SystemStructureDescription").with_attributes([
            ("xmlns:ssd", SSD),
            ("xmlns:ssc", SSC),
            ("version", "2.0"),
            ("name", self.name),
            ("generationTool", TOOL),
        ]);
        root.write_inner_content(|xml| {
            let system =
                xml.create_element("ssd:System").with_attributes([("name", self.name), ("description", self.title)]);
            system.write_inner_content(|xml| {
                xml.create_element("ssd:Elements").write_inner_content(|xml| {
                    self.components.iter().zip(&connectors).try_for_each(|(c, own)| write_component(xml, c, own))
                })?;
                xml.create_element("ssd:Connections").write_inner_content(|xml| {
                    links.iter().try_for_each(|[from, to]| {
                        let attributes = [
                            ("startElement", self.components[from.0].name.as_str()),
                            ("startConnector", from.1.as_str()),
                            ("endElement", self.components[to.0].name.as_str()),
                            ("endConnector", to.1.as_str()),
                        ];
                        xml.create_element("ssd:Connection").with_attributes(attributes).write_empty().map(drop)
                    })
                })?;
                Ok(())
            })?;
            if !measures.is_empty() {
                xml.create_element("ssd:Units").write_inner_content(|xml| {
                    measures.iter().try_for_each(|(name, measure)| write_measure(xml, name, measure))
                })?;
            }
            let [start, stop] = self.span.map(|t| format!("{t:?}"));
            let times = [("startTime", start.as_str()), ("stopTime", stop.as_str())];
            xml.create_element("ssd:DefaultExperiment").with_attributes(times).write_empty().map(drop)
        })?;
        Ok(xml.into_inner())
    }
}

type Xml = Writer<Vec<u8>>;

fn declared() -> io::Result<Xml> {
    let mut xml = Writer::new_with_indent(Vec::new(), b' ', 2);
    xml.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    Ok(xml)
}

fn write_component(xml: &mut Xml, component: &Component, connectors: &BTreeMap<&str, &Variable>) -> io::Result<()> {
    let source = format!("resources/{}.fmu", component.name);
    let attributes =
        [("name", component.name.as_str()), ("source", source.as_str()), ("implementation", "CoSimulation")];
    xml.create_element("ssd:Component").with_attributes(attributes).write_inner_content(|xml| {
        if !connectors.is_empty() {
            xml.create_element("ssd:Connectors").write_inner_content(|xml| {
                connectors.values().try_for_each(|variable| write_connector(xml, component, variable))
            })?;
        }
        if !component.parameters.is_empty() {
            let source = format!("resources/{}.ssv", component.name);
            xml.create_element("ssd:ParameterBindings").write_inner_content(|xml| {
                let binding = xml.create_element("ssd:ParameterBinding");
                binding.with_attribute(("source", source.as_str())).write_empty().map(drop)
            })?;
        }
        Ok(())
    })?;
    Ok(())
}

fn write_connector(xml: &mut Xml, component: &Component, variable: &Variable) -> io::Result<()> {
    let kind = if variable.causality == Causality::Output { "output" } else { "input" };
    let attributes = [("name", variable.name.as_str()), ("kind", kind)];
    xml.create_element("ssd:Connector").with_attributes(attributes).write_inner_content(|xml| {
        let ty = format!("ssc:{}", type_name(component.description.version, variable.ty));
        let unit = variable.unit.as_ref().filter(|name| component.description.units.contains_key(*name));
        let element = xml.create_element(ty.as_str());
        let element = match unit {
            Some(unit) => element.with_attribute(("unit", unit.as_str())),
            None => element,
        };
        element.write_empty()?;
        write_dimensions(xml, &variable.dimensions)
    })?;
    Ok(())
}

fn write_dimensions(xml: &mut Xml, dimensions: &[usize]) -> io::Result<()> {
    dimensions.iter().try_for_each(|size| {
        let size = size.to_string();
        xml.create_element("ssc:Dimension").with_attribute(("size", size.as_str())).write_empty().map(drop)
    })
}

fn write_measure(xml: &mut Xml, name: &str, measure: &Measure) -> io::Result<()> {
    xml.create_element("ssc:Unit").with_attribute(("name", name)).write_inner_content(|xml| {
        let mut attributes: Vec<(&str, String)> =
            measure.base().filter(|(_, exponent)| *exponent != 0).map(|(name, e)| (name, e.to_string())).collect();
        attributes.extend((measure.factor != 1.0).then(|| ("factor", format!("{:?}", measure.factor))));
        attributes.extend((measure.offset != 0.0).then(|| ("offset", format!("{:?}", measure.offset))));
        let list = attributes.iter().map(|(name, value)| (*name, value.as_str()));
        xml.create_element("ssc:BaseUnit").with_attributes(list).write_empty().map(drop)
    })?;
    Ok(())
}

/// `UNIT.ssv`.
fn parameters(component: &Component) -> io::Result<Vec<u8>> {
    let mut xml = declared()?;
    let root = xml.create_element("ssv:ParameterSet").with_attributes([
        ("xmlns:ssv", SSV),
        ("xmlns:ssc", SSC),
        ("version", "2.0"),
        ("name", component.name.as_str()),
        ("generationTool", TOOL),
    ]);
    root.write_inner_content(|xml| {
        xml.create_element("ssv:Parameters").write_inner_content(|xml| {
            component.parameters.iter().try_for_each(|(name, value)| {
                let description = &component.description;
                let ty = description.variables.get(name).map_or(VariableType::Other, |variable| variable.ty);
                let text = match value {
                    Parameter::Flag(value) => value.to_string(),
                    Parameter::Number(value) => format!("{value:?}"),
                    Parameter::Text(text) => text.clone(),
                    Parameter::Numbers(list) => list.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(" "),
                };
                let ty = format!("ssv:{}", type_name(description.version, ty));
                xml.create_element("ssv:Parameter").with_attribute(("name", name.as_str())).write_inner_content(
                    |xml| {
                        xml.create_element(ty.as_str()).with_attribute(("value", text.as_str())).write_empty()?;
                        match value {
                            Parameter::Numbers(list) => write_dimensions(xml, &[list.len()]),
                            _ => Ok(()),
                        }
                    },
                )?;
                Ok(())
            })
        })?;
        Ok(())
    })?;
    Ok(xml.into_inner())
}

/// The name that SSP has for a type.
fn type_name(version: Version, ty: VariableType) -> &'static str {
    match (version, ty) {
        (Version::Two, VariableType::Float64) => "Real",
        (Version::Two, VariableType::Int32) => "Integer",
        (_, VariableType::Float64) => "Float64",
        (_, VariableType::Int64) => "Int64",
        (_, VariableType::UInt64) => "UInt64",
        (_, VariableType::Int32) => "Int32",
        (_, VariableType::Boolean) => "Boolean",
        (_, VariableType::String | VariableType::Other) => "String",
    }
}
