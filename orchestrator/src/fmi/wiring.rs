//! Connections that a model makes by names.

use super::description::{Causality, Description, Variable, VariableType};
use super::measure::Conversion;
use crate::interface::{Connection, Interface};

/// What is wrong with connections, all of it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the units cannot be connected:\n  {}", problems.join("\n  "))]
pub struct WiringError {
    /// One line each.
    pub problems: Vec<String>,
}

/// Looks up the connections of a model in the descriptions of its units, which come in the order of their numbers with
/// their names. Units of measure are converted.
///
/// # Errors
/// [`WiringError`]: no such unit or variable, no output or no input, different sizes, units of measure that cannot be
/// converted, an input that the coupling sets.
pub fn connections(
    wanted: &[model::Connection],
    interface: &Interface,
    units: &[(&str, &Description)],
) -> Result<Vec<Connection>, WiringError> {
    let (mut list, mut problems) = (Vec::new(), Vec::new());
    for model::Connection { from, to } in wanted {
        let ends = [(from, Causality::Output), (to, Causality::Input)].map(|(text, causality)| {
            find(text, causality, units).map_err(|problem| problems.push(format!("{text}: {problem}"))).ok()
        });
        let [Some((from_unit, a)), Some((to_unit, b))] = ends else { continue };
        if to_unit < interface.coupled && interface.fields.iter().any(|f| f.sets(&b.name)) {
            problems.push(format!("{to}: the coupling sets it"));
        }
        if a.size != b.size {
            problems.push(format!("{from} has {} entries, {to} has {}", a.size, b.size));
        }
        let measure =
            |unit: usize, v: &Variable| v.unit.as_ref().and_then(|name| units[unit].1.units.get(name).copied());
        let (from_measure, to_measure) = (measure(from_unit, a), measure(to_unit, b));
        match Conversion::between((a.unit.as_deref(), from_measure), (b.unit.as_deref(), to_measure)) {
            Ok(conversion) => {
                list.push(Connection { from: (from_unit, a.name.clone()), to: (to_unit, b.name.clone()), conversion })
            }
            Err(problem) => problems.push(format!("{from} to {to}: {problem}")),
        }
    }
    if problems.is_empty() { Ok(list) } else { Err(WiringError { problems }) }
}

/// The number of the unit in `UNIT.VARIABLE`, and the variable.
fn find<'a>(
    text: &str,
    causality: Causality,
    units: &[(&str, &'a Description)],
) -> Result<(usize, &'a Variable), String> {
    let (unit, name) = text.split_once('.').unwrap_or((text, ""));
    let number =
        units.iter().position(|(name, _)| *name == unit).ok_or_else(|| format!("there is no unit \"{unit}\""))?;
    let variables = &units[number].1.variables;
    let is = if causality == Causality::Output { "output" } else { "input" };
    let variable = variables.get(name).ok_or_else(|| {
        let known = variables.values().filter(|v| v.causality == causality).map(|v| v.name.as_str());
        format!("{unit} has no variable \"{name}\"; its {is}s are {}", known.collect::<Vec<_>>().join(", "))
    })?;
    if variable.causality != causality {
        return Err(format!("it is no {is}"));
    }
    let is_number = match causality {
        Causality::Output => variable.is_number(),
        _ => variable.ty == VariableType::Float64,
    };
    if is_number { Ok((number, variable)) } else { Err("it is no number, or no floating-point one".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn description(variables: &str) -> Description {
        let xml = format!(
            r#"<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t">
            <CoSimulation modelIdentifier="m"/>
            <UnitDefinitions><Unit name="MPa"><BaseUnit kg="1" m="-1" s="-2" factor="1e6"/></Unit>
            <Unit name="Pa"><BaseUnit kg="1" m="-1" s="-2"/></Unit><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
            <ModelVariables>{variables}</ModelVariables></fmiModelDescription>"#
        );
        Description::parse(&xml).unwrap()
    }

    #[test]
    fn connections_are_found_by_name_and_all_problems_are_told() {
        let flow = description(
            r#"<Float64 name="p.max" valueReference="1" causality="output" unit="Pa"/>
            <Float64 name="rate" valueReference="2" causality="input"/>
            <Float64 name="matrix.porosity_change" valueReference="3" causality="input"/>"#,
        );
        let light = description(
            r#"<Float64 name="p" valueReference="1" causality="input" unit="MPa"/>
            <Float64 name="length" valueReference="2" causality="input" unit="m"/>
            <Float64 name="list" valueReference="3" causality="input"><Dimension start="2"/></Float64>
            <String name="text" valueReference="4" causality="output"/>
            <Float64 name="rate" valueReference="5" causality="output"/>"#,
        );
        let units = [("flow", &flow), ("mechanics", &flow), ("light", &light)];
        let interface = Interface::poroelastic();
        let find = |list: &[(&str, &str)]| {
            let list: Vec<_> =
                list.iter().map(|(from, to)| model::Connection { from: (*from).into(), to: (*to).into() }).collect();
            connections(&list, &interface, &units)
        };
        let found = find(&[("flow.p.max", "light.p"), ("light.rate", "flow.rate")]).unwrap();
        let ends: Vec<_> = found.iter().map(|c| (c.from.0, c.from.1.as_str(), c.to.0, c.to.1.as_str())).collect();
        assert_eq!(ends, [(0, "p.max", 2, "p"), (2, "rate", 0, "rate")]);
        assert_eq!(found.iter().map(|c| c.conversion.factor).collect::<Vec<_>>(), [1e-6, 1.0]);
        let error = find(&[
            ("flow.p.max", "light.length"),
            ("flow.p.max", "light.list"),
            ("heat.p", "light.p"),
            ("flow.q", "light.rate"),
            ("light.text", "flow.matrix.porosity_change"),
            ("light.rate", "flow.matrix.porosity_change"),
        ])
        .unwrap_err();
        let wanted = [
            "flow.p.max to light.length: \"Pa\" cannot be converted to \"m\": they measure different things",
            "flow.p.max has 1 entries, light.list has 2",
            "heat.p: there is no unit \"heat\"",
            "flow.q: flow has no variable \"q\"; its outputs are p.max",
            "light.rate: it is no input",
            "light.text: it is no number, or no floating-point one",
            "flow.matrix.porosity_change: the coupling sets it",
        ];
        assert_eq!(error.problems, wanted);
    }
}
