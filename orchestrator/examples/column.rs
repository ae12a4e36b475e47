//! The analytic columns of the tests as an FMU: which side it is, and the strengths of the columns, are in its
//! resources.

#[allow(dead_code, reason = "the tests use all of it")]
#[path = "../tests/toys/mod.rs"]
pub(crate) mod toys;

use fmi_unit::{
    Capabilities, Description, Environment, Reference, StepOutcome, Type, UnitError, Values, ValuesMut, Variable,
};
use orchestrator::Unit as _;
use toys::{Column, Toy};

/// Name, whether it is one for each column (or for each of no fracture faces), and whether flow gives it.
const NAMES: [(&str, bool, bool); 12] = [
    ("matrix.pressure", true, true),
    ("matrix.porosity_change", true, false),
    ("matrix.pressure_stiffness", true, true),
    ("matrix.porosity_compliance", true, false),
    ("matrix.pressure_reference", true, false),
    ("matrix.porosity_change_reference", true, true),
    ("fracture.pressure", false, true),
    ("fracture.aperture", false, false),
    ("fracture.pressure_stiffness", false, true),
    ("fracture.aperture_compliance", false, false),
    ("fracture.pressure_reference", false, false),
    ("fracture.aperture_reference", false, true),
];
const NEWTON: Reference = 100;

/// A column of unit coupling strength τ with leakage, as all in the test.
pub(crate) fn column(tau: f64) -> Column {
    Column { leakage: 1e-9, hardening: 1e14, ..Column::of_strength(tau) }
}

/// The unit.
pub struct ColumnUnit {
    toy: Toy,
    is_flow: bool,
    columns: usize,
}

impl fmi_unit::Unit for ColumnUnit {
    type State = Vec<u8>;

    fn instantiate(environment: &Environment) -> Result<Self, UnitError> {
        let text = std::fs::read_to_string(environment.resource("columns.txt")?)?;
        let mut words = text.split_whitespace();
        let is_flow = words.next() == Some("flow");
        let columns = words.map(|w| w.parse().map(column)).collect::<Result<Vec<_>, _>>()?;
        let mut toy = Toy::new(is_flow, &columns);
        toy.rejects_above = 0.15;
        Ok(Self { toy, is_flow, columns: columns.len() })
    }

    fn description(&self) -> Description {
        let variables = NAMES.iter().enumerate().filter(|(_, n)| n.1).map(|(i, &(name, _, by_flow))| {
            let reference = i as Reference + 1;
            let variable = if by_flow == self.is_flow && !name.ends_with("_reference") {
                Variable::output(reference, name, Type::Float64)
            } else {
                Variable::input(reference, name, Type::Float64).start(0.0)
            };
            variable.dimensions(&[self.columns])
        });
        let newton = (!self.is_flow).then(|| Variable::output(NEWTON, "newton.iterations", Type::UInt64));
        Description::new("Column", "column")
            .capabilities(Capabilities { state: true, serialize: true, ..Capabilities::default() })
            .variables(variables.chain(newton))
    }

    fn get(&mut self, variable: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        if variable == NEWTON {
            return values.write(&[self.toy.newton_iterations().unwrap_or(0)]);
        }
        let mut list = Vec::new();
        self.toy.get(NAMES[variable as usize - 1].0, &mut list)?;
        values.write(&list)
    }

    fn set(&mut self, variable: Reference, values: Values<'_>) -> Result<(), UnitError> {
        let mut list = vec![0.0; self.columns];
        values.read(&mut list)?;
        Ok(self.toy.set(NAMES[variable as usize - 1].0, &list)?)
    }

    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        Ok(match self.toy.step(time, step)? {
            orchestrator::StepOutcome::Done => StepOutcome::Completed,
            orchestrator::StepOutcome::Discarded { reason } => StepOutcome::Discarded(reason),
        })
    }

    fn save(&mut self) -> Result<Vec<u8>, UnitError> {
        Ok(self.toy.serialise()?)
    }

    fn restore(&mut self, state: &Vec<u8>) -> Result<(), UnitError> {
        Ok(self.toy.deserialise(state)?)
    }

    fn serialize(&self, state: &Vec<u8>) -> Result<Vec<u8>, UnitError> {
        Ok(state.clone())
    }

    fn deserialize(&self, bytes: &[u8]) -> Result<Vec<u8>, UnitError> {
        Ok(bytes.to_vec())
    }
}

fmi_unit::export_unit!(ColumnUnit);
