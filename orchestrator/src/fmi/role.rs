//! What an FMU must have, and may have, to be the flow or the mechanics of a model: docs/interface.md.

use coupling::{QUANTITIES, Quantity, Role, Shape, Sizes};

use model::Parameter;

use super::description::{Causality, Description, Variable, VariableType};
use super::measure::{Conversion, Measure};

/// How a unit fits its role.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fit {
    /// What keeps it from being used.
    pub problems: Vec<String>,
    /// What is there and right: names of variables.
    pub offered: Vec<String>,
    /// What may be missing, and is.
    pub lacking: Vec<String>,
}

/// A variable that a role has.
struct Wanted {
    quantity: &'static Quantity,
    name: String,
    causality: Causality,
    is_required: bool,
}

/// The variables of a role, the required ones first.
fn wanted(role: Role) -> Vec<Wanted> {
    let mut list = Vec::new();
    for quantity in QUANTITIES.iter().filter(|q| q.exchanged) {
        let causality = if quantity.from == role { Causality::Output } else { Causality::Input };
        // Fields have references; sensitivities have none, and may be missing.
        list.push(Wanted { quantity, name: quantity.name.into(), causality, is_required: quantity.referenced });
        if quantity.referenced && quantity.from == role {
            let name = format!("{}_reference", quantity.name);
            list.push(Wanted { quantity, name, causality: Causality::Input, is_required: false });
        }
    }
    list.sort_by_key(|w| !w.is_required);
    list
}

/// The SI unit of a quantity.
fn measure(name: &str) -> Option<Measure> {
    let units = coupling::units();
    let unit = units.iter().find(|unit| unit.name() == name)?;
    Some(Measure { exponents: unit.exponents(), factor: 1.0, offset: 0.0 })
}

impl Description {
    /// Compares the variables with those of a role on a mesh. Those that are right are in the unit of measure of the
    /// role from then on.
    pub(crate) fn fit(&mut self, role: Role, sizes: Sizes) -> Fit {
        let mut fit = Fit::default();
        for Wanted { quantity, name, causality, is_required } in wanted(role) {
            let size: usize = sizes.of(quantity.shape).iter().product();
            if size == 0 {
                continue;
            }
            let is = if causality == Causality::Output { "output" } else { "input" };
            let of = if quantity.shape == Shape::Cells { "cells" } else { "fracture faces" };
            let definition = self.variables.get(&name).and_then(|v| self.units.get(v.unit.as_ref()?)).copied();
            let Some(variable) = self.variables.get_mut(&name) else {
                if !is_required {
                    fit.lacking.push(name);
                    continue;
                }
                let entry = format!("{name}[");
                let hint = if self.variables.keys().any(|v| v.starts_with(&entry)) {
                    "; of its entries some are missing, or they differ in type, causality or unit"
                } else {
                    ""
                };
                fit.problems.push(format!("it lacks the {is} {name} ({size} {of}, {}){hint}", quantity.unit));
                continue;
            };
            let before = fit.problems.len();
            if variable.ty != VariableType::Float64 {
                fit.problems.push(format!("{name} is no Float64 (FMI 2: Real)"));
            }
            if variable.causality != causality {
                fit.problems.push(format!("{name} is no {is}"));
            }
            if variable.size != size {
                fit.problems
                    .push(format!("{name} has {} entries, the mesh has {size} {of}: another mesh", variable.size));
            }
            let to = (Some(quantity.unit), measure(quantity.unit));
            match Conversion::between((variable.unit.as_deref(), definition), to) {
                Ok(conversion) => variable.conversion = conversion,
                Err(problem) => fit.problems.push(format!("{name}: {problem}")),
            }
            if fit.problems.len() == before {
                variable.unit = Some(quantity.unit.to_owned());
                self.units.extend(measure(quantity.unit).map(|measure| (quantity.unit.to_owned(), measure)));
                fit.offered.push(name);
            }
        }
        fit
    }
}

impl Description {
    /// What is wrong with a start value.
    pub fn start_problem(&self, variable: &str, value: &Parameter) -> Option<String> {
        let Some(found) = self.variables.get(variable) else { return Some("is no variable of it".into()) };
        let size = match value {
            Parameter::Numbers(values) => values.len(),
            _ => 1,
        };
        let is_text = matches!(value, Parameter::Text(_));
        let fits = if is_text { found.ty == VariableType::String } else { found.is_number() };
        match (found.causality, fits) {
            (Causality::Output, _) => Some("is an output".into()),
            (_, false) => Some(if is_text { "is no text".into() } else { "is no number".into() }),
            _ => (size != found.size).then(|| format!("has {} entries, not {size}", found.size)),
        }
    }
}

impl Variable {
    /// Whether its values are numbers or truth values.
    pub fn is_number(&self) -> bool {
        !matches!(self.ty, VariableType::String | VariableType::Other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: Sizes = Sizes { cells: 3, fracture_faces: 2, dim: 2 };

    fn flow(change: impl Fn(String) -> String) -> Description {
        let variable = |name: &str, causality: &str, unit: &str, size: usize| {
            format!(
                r#"<Float64 name="{name}" valueReference="1" causality="{causality}" {unit}><Dimension start="{size}"/></Float64>"#
            )
        };
        let variables = [
            variable("matrix.pressure", "output", "unit=\"bar\"", 3),
            variable("fracture.pressure", "output", "", 2),
            variable("matrix.porosity_change", "input", "unit=\"1\"", 3),
            variable("fracture.aperture", "input", "unit=\"mm\"", 2),
        ];
        let xml = format!(
            r#"<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t"><CoSimulation modelIdentifier="m"/>
            <UnitDefinitions><Unit name="bar"><BaseUnit kg="1" m="-1" s="-2" factor="1e5"/></Unit>
            <Unit name="mm"><BaseUnit m="1" factor="1e-3"/></Unit></UnitDefinitions>
            <ModelVariables>{}</ModelVariables></fmiModelDescription>"#,
            variables.concat()
        );
        Description::parse(&change(xml)).unwrap()
    }

    #[test]
    fn the_minimum_fits_and_is_converted() {
        let mut d = flow(|xml| xml);
        let fit = d.fit(Role::Flow, SIZES);
        assert_eq!(fit.problems, [""; 0]);
        assert_eq!(fit.offered.len(), 4);
        assert_eq!(fit.lacking.len(), 6, "{:?}", fit.lacking);
        assert_eq!(d.variables["matrix.pressure"].conversion.factor, 1e5);
        assert_eq!(d.variables["fracture.aperture"].unit.as_deref(), Some("m"));
        // Without fractures their variables may be missing.
        let mut d = flow(|xml| xml.replace("fracture.", "other."));
        assert_eq!(d.fit(Role::Flow, Sizes { fracture_faces: 0, ..SIZES }).problems, [""; 0]);
    }

    #[test]
    fn all_that_is_wrong_is_said_at_once() {
        let change = |xml: String| {
            xml.replace("matrix.pressure", "matrix.p")
                .replace(
                    "name=\"fracture.pressure\" valueReference=\"1\" causality=\"output\"",
                    "name=\"fracture.pressure\" valueReference=\"1\" causality=\"local\"",
                )
                .replace("unit=\"1\"><Dimension start=\"3\"", "unit=\"mm\"><Dimension start=\"4\"")
        };
        let fit = flow(change).fit(Role::Flow, SIZES);
        assert_eq!(
            fit.problems,
            [
                "it lacks the output matrix.pressure (3 cells, Pa)",
                "fracture.pressure is no output",
                "matrix.porosity_change has 4 entries, the mesh has 3 cells: another mesh",
                "matrix.porosity_change: \"mm\" cannot be converted to \"1\": they measure different things",
            ]
        );
        let start = |variable: &str, value| flow(|xml| xml).start_problem(variable, &value);
        assert_eq!(start("fracture.aperture", Parameter::Numbers(vec![1.0; 2])), None);
        assert_eq!(start("fracture.aperture", Parameter::Number(1.0)).unwrap(), "has 2 entries, not 1");
        assert_eq!(start("fracture.aperture", Parameter::Text("1".into())).unwrap(), "is no text");
        assert_eq!(start("matrix.pressure", Parameter::Numbers(vec![1.0; 3])).unwrap(), "is an output");
        assert_eq!(start("aperture", Parameter::Flag(true)).unwrap(), "is no variable of it");
        // As mechanics it has everything the wrong way round.
        assert_eq!(flow(|xml| xml).fit(Role::Mechanics, SIZES).problems.len(), 4);
    }
}
