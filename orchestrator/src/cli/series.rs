//! What is read from the units after a time step.

use mesh::Mesh;
use orchestrator::fmi::{Causality, Description};
use orchestrator::results::{Array, Scalar, Shape, Snapshot};
use orchestrator::{CouplingError, EnergyEstimate, Interface, Run, Settings, Unit};

/// Outputs that count what an instance did: they are no part of its state, and would not survive a resumed run.
const WORK: [&str; 1] = ["factorisations"];

/// Which outputs are recorded.
pub(crate) struct Series {
    scalars: Vec<Output>,
    arrays: Vec<(Output, Shape)>,
    /// All arrays that are outputs, recorded or not.
    fields: Vec<Output>,
    /// They say at which times arrays are recorded.
    settings: Settings,
    energy: EnergyEstimate,
}

struct Output {
    /// Which unit has it.
    unit: usize,
    variable: String,
    /// What it is called in the results.
    name: String,
    measure: String,
}

impl Series {
    /// All scalar outputs, and all arrays on cells and fracture faces but for the sensitivities.
    pub(crate) fn new(units: &[(&str, &Description)], interface: &Interface, mesh: &Mesh, settings: Settings) -> Self {
        let sensitivities: Vec<&str> =
            interface.fields.iter().filter_map(|f| f.sensitivity.as_ref()).map(|s| s.variable.as_str()).collect();
        let (scalars, arrays, fields) = (Vec::new(), Vec::new(), Vec::new());
        let mut series = Self { scalars, arrays, fields, settings, energy: EnergyEstimate::default() };
        for (unit, &(unit_name, description)) in units.iter().enumerate() {
            for (variable, v) in &description.variables {
                let left_out = WORK.contains(&variable.as_str()) || sensitivities.contains(&variable.as_str());
                if v.causality != Causality::Output || !v.is_number() {
                    continue;
                }
                if ["matrix.", "fracture."].iter().any(|terminal| variable.starts_with(terminal)) {
                    series.fields.push(Output {
                        unit,
                        variable: variable.clone(),
                        name: variable.clone(),
                        measure: String::new(),
                    });
                }
                if left_out {
                    continue;
                }
                let is_output = |(_, d): &&(&str, &Description)| {
                    d.variables.get(variable).is_some_and(|p| p.causality == Causality::Output)
                };
                // What follows leaves the coupled units their names.
                let rivals = if unit < interface.coupled { &units[..interface.coupled] } else { units };
                let is_twice = rivals.iter().filter(is_output).count() > 1;
                let name = if is_twice { format!("{unit_name}.{variable}") } else { variable.clone() };
                let measure = v.unit.clone().unwrap_or_else(|| "1".into());
                let output = Output { unit, variable: variable.clone(), name, measure };
                let shapes: &[Shape] = match variable.split('.').next() {
                    Some("matrix") => &[Shape::Cells, Shape::CellVectors],
                    Some("fracture") => &[Shape::FractureFaces, Shape::FractureVectors],
                    _ => &[],
                };
                if let Some(&shape) = shapes.iter().find(|shape| shape.length(mesh) == v.size) {
                    series.arrays.push((output, shape));
                } else if v.size == 1 {
                    series.scalars.push(output);
                }
            }
        }
        series
    }

    /// The state of the units at the start, or after the time step that follows the last snapshot.
    pub(crate) fn snapshot(&mut self, time: f64, units: &mut [Box<dyn Unit>]) -> Result<Snapshot, CouplingError> {
        let mut snapshot = Snapshot { time, scalars: Vec::new(), arrays: Vec::new() };
        let mut read = |output: &Output| {
            let mut values = Vec::new();
            let unit = units[output.unit].as_mut();
            unit.get(&output.variable, &mut values)
                .map_err(|error| CouplingError::Unit { unit: unit.name().to_owned(), error })?;
            Ok::<_, CouplingError>(values)
        };
        for output in &self.scalars {
            let value = read(output)?.first().copied().unwrap_or(f64::NAN);
            snapshot.scalars.push(Scalar::new(&output.name, &output.measure, value));
        }
        if self.settings.is_output_time(time) {
            for (output, shape) in &self.arrays {
                snapshot.arrays.push(Array::new(&output.name, &output.measure, *shape, read(output)?));
            }
        }
        self.energy.add(&mut snapshot);
        Ok(snapshot)
    }

    /// The state that a run has got to.
    pub(crate) fn of(&mut self, run: &mut Run) -> Result<Snapshot, CouplingError> {
        let time = run.time();
        self.snapshot(time, run.units())
    }

    /// Goes on from an energy estimate that has seen the time steps before.
    pub(crate) fn goes_on(&mut self, energy: &EnergyEstimate) {
        self.energy = energy.clone();
    }

    /// Names of the arrays on cells and fracture faces.
    pub(crate) fn fields(&self) -> impl Iterator<Item = &str> {
        self.fields.iter().map(|output| output.variable.as_str())
    }

    /// An array by its name; empty where there is none.
    pub(crate) fn field(&self, name: &str, units: &mut [Box<dyn Unit>]) -> Result<Vec<f64>, CouplingError> {
        let mut values = Vec::new();
        if let Some(output) = self.fields.iter().find(|output| output.variable == name) {
            let unit = units[output.unit].as_mut();
            unit.get(name, &mut values).map_err(|error| CouplingError::Unit { unit: unit.name().to_owned(), error })?;
        }
        Ok(values)
    }
}
