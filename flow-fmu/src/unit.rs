//! Flow as an FMI 3.0 co-simulation unit.
//!
//! Resources: `model.toml`, the description of the case, and `mesh.h5`, its mesh. A `fmi3DoStep` is one time step of
//! implicit Euler. One that is given an aperture which is not positive, that closes a fracture, whose wells do not settle, or whose equations cannot be solved, is
//! discarded. The state of the unit is that of the flow at the present time, with the inputs and parameters that the
//! host has set.
//!
//! At the start the pressure is p⁰ of the model; porosity change and aperture are the inputs, unless the host sets them
//! zero and the aperture in contact.

use std::sync::Arc;
use std::time::Duration;

use coupling::{Allowed, Role, Sizes, Table, Worker, identifier, timed};
use fmi_unit::{
    Capabilities, DefaultExperiment, Description, Environment, Experiment, Log, Reference, StepOutcome, Type, Unit,
    UnitError, Values, ValuesMut, Variable,
};
use mesh::{Mesh, Vec3};
use model::{Document, Point, Scope, TipDistances};
use serde::{Deserialize, Serialize};

use crate::{
    Boundary, Condition, Control, Flow, FlowError, FlowModel, FlowState, Fluid, Fracture, Inflow, Inputs,
    Linearisation, Perturbation, Rock, SpaceTimeFunction, StepReport, StiffnessCap, Tensor, Well, WellIndex, WellPlace,
    WellReport,
};

/// Flow behind the FMI.
pub struct FlowUnit {
    flow: Flow,
    table: Arc<Table<Self>>,
    fingerprint: String,
    title: String,
    times: [f64; 3],
    /// The flow as it was made.
    initial: FlowState,
    log: Log,
    settings: Settings,
    report: Arc<StepReport>,
    needs_references: bool,
    /// Wall time of computing.
    computing: Duration,
}

/// What the host has set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Settings {
    inputs: Inputs,
    /// Largest stiffnesses to be published: matrix (Pa), fractures (Pa/m).
    caps: [f64; 2],
}

/// Everything that changes.
#[derive(Clone, Debug)]
pub struct Saved {
    state: FlowState,
    settings: Settings,
    report: Arc<StepReport>,
    linearisation: Option<Arc<Linearisation>>,
}

fn write(values: ValuesMut<'_>, source: &[f64]) -> Result<(), UnitError> {
    values.write(source)
}

impl FlowUnit {
    /// The unit of a model on its mesh.
    ///
    /// # Errors
    /// A model without flow; what the discretisation refuses.
    pub fn new(document: &Document, mesh: Mesh, log: Log) -> Result<Self, UnitError> {
        let mesh = Arc::new(mesh);
        let fingerprint = mesh.fingerprint();
        let problem = flow_model(document, &mesh)?;
        let mut computing = Duration::ZERO;
        let flow = timed(&mut computing, || Flow::new(Arc::clone(&mesh), problem))?;
        let sensitivity = &document.model.coupling.sensitivity;
        let caps = [sensitivity.matrix_stiffness_cap.0, sensitivity.fracture_stiffness_cap.0];
        let settings = Settings { inputs: flow.inputs(), caps };
        let time = &document.model.time;
        Ok(Self {
            table: Arc::new(table(&flow, &settings)),
            fingerprint,
            title: document.model.title.clone(),
            times: [time.start.0, time.end.0, time.step.map_or(time.end.0 - time.start.0, |s| s.0)],
            initial: flow.state().clone(),
            log,
            settings,
            report: Arc::new(no_step(&flow)),
            needs_references: flow.needs_references(),
            flow,
            computing,
        })
    }

    fn capped(&self, stiffness: &[f64], which: usize) -> Vec<f64> {
        stiffness.iter().map(|s| s.min(self.settings.caps[which])).collect()
    }

    /// The last time step (s), or before it the first one of the model.
    fn last_step(&self) -> f64 {
        self.flow.linearisation().map(|l| l.time_step()).filter(|dt| dt.is_finite()).unwrap_or(self.times[2])
    }

    fn matrix_statistics(&self) -> [f64; 3] {
        statistics(&self.flow.state().matrix_pressure, self.flow.mesh().geometry().cell_measure.iter().copied())
    }

    fn fracture_statistics(&self) -> [f64; 3] {
        let mesh = self.flow.mesh();
        let measures = mesh.network().faces.iter().map(|&face| mesh.geometry().face_measure[face]);
        statistics(self.flow.fracture_pressure(), measures)
    }

    fn inflow(&self, tag: usize) -> Inflow {
        self.report.inflow.get(tag).copied().unwrap_or_default()
    }

    fn well(&self, well: usize) -> WellReport {
        self.report.wells.get(well).copied().unwrap_or_default()
    }
}

fn sizes(mesh: &Mesh) -> Sizes {
    Sizes { cells: mesh.cell_count(), fracture_faces: mesh.network().face_count(), dim: mesh.dim() }
}

/// What is reported before the first time step: wells stand still at the pressure around them.
fn no_step(flow: &Flow) -> StepReport {
    let pressure = |spot| match spot {
        crate::Spot::Cell(cell) => flow.state().matrix_pressure[cell],
        crate::Spot::FractureFace(i) => flow.fracture_pressure()[i],
    };
    let wells = flow.well_spots().into_iter().map(|spot| WellReport { pressure: pressure(spot), ..Default::default() });
    StepReport { wells: wells.collect(), ..StepReport::default() }
}

/// Mean, smallest and largest value.
fn statistics(values: &[f64], measures: impl Iterator<Item = f64>) -> [f64; 3] {
    let (mut sum, mut size, mut low, mut high) = (0.0, 0.0, f64::INFINITY, f64::NEG_INFINITY);
    for (&value, measure) in values.iter().zip(measures) {
        (sum, size, low, high) = (sum + value * measure, size + measure, low.min(value), high.max(value));
    }
    [sum / size, low, high]
}

/// The variables.
fn table(flow: &Flow, settings: &Settings) -> Table<FlowUnit> {
    let mesh = flow.mesh();
    let mut t = Table::<FlowUnit>::new(Role::Flow, sizes(mesh));
    add_fields(&mut t, &settings.inputs);
    t.add(
        |r| {
            Variable::output(r, "mesh.fingerprint", Type::String)
                .describe("Hash of the mesh's topology and coordinates")
        },
        |u, v| v.write(std::slice::from_ref(&u.fingerprint)),
        None,
    );
    let float = |name: &'static str, unit: &'static str, about: &'static str| {
        move |r| Variable::output(r, name, Type::Float64).unit(unit).describe(about)
    };
    let (volume, rate) = if mesh.dim() == 2 { ("m2", "m2/s") } else { ("m3", "m3/s") };
    let fractured = mesh.network().face_count() > 0;
    t.add(
        float("matrix_pressure.mean", "Pa", "Mean pressure in the rock"),
        |u, v| write(v, &[u.matrix_statistics()[0]]),
        None,
    );
    t.add(
        float("matrix_pressure.min", "Pa", "Smallest pressure in the rock"),
        |u, v| write(v, &[u.matrix_statistics()[1]]),
        None,
    );
    t.add(
        float("matrix_pressure.max", "Pa", "Largest pressure in the rock"),
        |u, v| write(v, &[u.matrix_statistics()[2]]),
        None,
    );
    if fractured {
        t.add(
            float("fracture_pressure.mean", "Pa", "Mean pressure in the fractures"),
            |u, v| write(v, &[u.fracture_statistics()[0]]),
            None,
        );
        t.add(
            float("fracture_pressure.min", "Pa", "Smallest pressure in the fractures"),
            |u, v| write(v, &[u.fracture_statistics()[1]]),
            None,
        );
        t.add(
            float("fracture_pressure.max", "Pa", "Largest pressure in the fractures"),
            |u, v| write(v, &[u.fracture_statistics()[2]]),
            None,
        );
    }
    t.add(
        float("fluid_in_place.matrix", volume, "Volume of the fluid in the rock"),
        |u, v| write(v, &[u.flow.fluid_in_place().matrix]),
        None,
    );
    if fractured {
        t.add(
            float("fluid_in_place.fractures", volume, "Volume of the fluid in the fractures"),
            |u, v| write(v, &[u.flow.fluid_in_place().fracture]),
            None,
        );
    }
    t.add(
        float("mass_balance.error", rate, "Storage - sources - wells - inflow of the whole in the last time step"),
        |u, v| write(v, &[u.report.balance.total]),
        None,
    );
    t.add(
        float(
            "mass_balance.largest_error",
            rate,
            "Largest error of a cell, fracture face or fracture edge in the last time step",
        ),
        |u, v| {
            let b = u.report.balance;
            write(v, &[b.cell.max(b.fracture_face).max(b.edge)])
        },
        None,
    );
    t.add(
        |r| {
            Variable::output(r, "factorisations", Type::Int64)
                .describe("Factorisations since the instance was made: work, not part of its state")
        },
        |u, v| v.write(&[u.flow.work().factorisations as i64]),
        None,
    );
    t.add(
        |r| {
            Variable::calculated_parameter(r, "pressure_references.needed", Type::Boolean).describe(
                "Whether there are parts whose pressure nothing fixes but the rock's answer: references of the pressures must follow them",
            )
        },
        |u, v| v.write(&[u.needs_references]),
        None,
    );
    t.add(
        |r| {
            Variable::parameter(r, "pressure_references.follow", Type::Boolean).tunable().start(false).describe(
                "Whether the host repeats time steps, with pressures as their own references, until both agree: these then hold \
                 parts that nothing else does",
            )
        },
        |u, v| v.write(&[u.settings.inputs.references_follow]),
        Some(|u, v| {
            u.settings.inputs.references_follow = v.scalar()?;
            Ok(())
        }),
    );
    add_energies(&mut t, sizes(mesh).energy_unit());
    add_boundaries(&mut t, flow, rate);
    add_wells(&mut t, flow, rate);
    t.work();
    t.add(
        |r| {
            Variable::parameter(r, "matrix_pressure_stiffness.cap", Type::Float64)
                .tunable()
                .unit("Pa")
                .start(settings.caps[0])
                .describe("matrix.pressure_stiffness is at most this: what stands for infinity")
        },
        |u, v| write(v, &[u.settings.caps[0]]),
        Some(|u, v| {
            u.settings.caps[0] = Allowed::NotNegative.scalar(v)?;
            Ok(())
        }),
    );
    if fractured {
        t.add(
            |r| {
                Variable::parameter(r, "fracture_pressure_stiffness.cap", Type::Float64)
                    .tunable()
                    .unit("Pa/m")
                    .start(settings.caps[1])
                    .describe("fracture.pressure_stiffness is at most this: what stands for infinity")
            },
            |u, v| write(v, &[u.settings.caps[1]]),
            Some(|u, v| {
                u.settings.caps[1] = Allowed::NotNegative.scalar(v)?;
                Ok(())
            }),
        );
    }
    t
}

fn add_fields(t: &mut Table<FlowUnit>, start: &Inputs) {
    t.input(
        "matrix.porosity_change",
        &start.porosity_change,
        |u, v| write(v, &u.settings.inputs.porosity_change),
        |u, v| Allowed::Finite.read(v, &mut u.settings.inputs.porosity_change),
    );
    t.input(
        "fracture.aperture",
        &start.aperture,
        |u, v| write(v, &u.settings.inputs.aperture),
        // An iterate of the host may be below zero; the time step is then discarded.
        |u, v| Allowed::Finite.read(v, &mut u.settings.inputs.aperture),
    );
    t.input(
        "matrix.porosity_compliance",
        &start.porosity_compliance,
        |u, v| write(v, &u.settings.inputs.porosity_compliance),
        |u, v| Allowed::NotNegative.read(v, &mut u.settings.inputs.porosity_compliance),
    );
    t.input(
        "fracture.aperture_compliance",
        &start.aperture_compliance,
        |u, v| write(v, &u.settings.inputs.aperture_compliance),
        |u, v| Allowed::NotNegative.read(v, &mut u.settings.inputs.aperture_compliance),
    );
    t.reference_of(
        "matrix.pressure",
        &start.matrix_pressure_reference,
        |u, v| write(v, &u.settings.inputs.matrix_pressure_reference),
        |u, v| Allowed::Finite.read(v, &mut u.settings.inputs.matrix_pressure_reference),
    );
    t.reference_of(
        "fracture.pressure",
        &start.fracture_pressure_reference,
        |u, v| write(v, &u.settings.inputs.fracture_pressure_reference),
        |u, v| Allowed::Finite.read(v, &mut u.settings.inputs.fracture_pressure_reference),
    );
    t.output("matrix.pressure", |u, v| write(v, &u.flow.state().matrix_pressure));
    t.output("fracture.pressure", |u, v| write(v, u.flow.fracture_pressure()));
    t.output("matrix.pressure_stiffness", |u, v| write(v, &u.capped(&u.flow.matrix_pressure_stiffness(), 0)));
    t.output("fracture.pressure_stiffness", |u, v| {
        let step = u.last_step();
        let stiffness = timed(&mut u.computing, || u.flow.fracture_pressure_stiffness(step))?;
        write(v, &u.capped(&stiffness, 1))
    });
}

fn add_energies(t: &mut Table<FlowUnit>, unit: &'static str) {
    let float = |name: &'static str, about: &'static str| {
        move |r| Variable::output(r, name, Type::Float64).unit(unit).describe(about)
    };
    macro_rules! energy {
        ($field:ident, $name:literal, $about:literal) => {
            t.add(float(concat!("energy.", $name), $about), |u, v| write(v, &[u.report.energy.$field]), None);
        };
    }
    energy!(storage, "storage", "Stored in the last time step by compression of rock and fluid");
    energy!(damping, "damping", "Dissipated by implicit Euler in the last time step");
    energy!(matrix_dissipation, "matrix_dissipation", "Dissipated by flow in the rock in the last time step");
    energy!(fracture_dissipation, "fracture_dissipation", "Dissipated by flow in fractures in the last time step");
    energy!(
        exchange_dissipation,
        "exchange_dissipation",
        "Dissipated by flow between rock and fractures in the last time step"
    );
    energy!(deformation, "deformation", "Given to the rock in the last time step");
    energy!(source, "source", "From sources in the last time step");
    energy!(boundary, "boundary", "Through the boundary in the last time step");
    energy!(wells, "wells", "From wells in the last time step");
    energy!(gravity, "gravity", "From gravity in the last time step");
}

/// Inflow through the boundaries that have a condition.
fn add_boundaries(t: &mut Table<FlowUnit>, flow: &Flow, rate: &str) {
    let mesh = flow.mesh();
    for (number, tag) in mesh.data().tags.iter().enumerate() {
        if flow.model().boundaries.iter().all(|(name, _)| name != tag) {
            continue;
        }
        let name = identifier(tag);
        let variable = |what: &str, about: &str| {
            let (name, about) =
                (format!("boundary.{name}.{what}"), format!("{about} through {tag} in the last time step"));
            move |r| Variable::output(r, &name, Type::Float64).unit(rate).describe(&about)
        };
        t.add_numbered(
            None,
            number,
            variable("inflow", "Into the rock"),
            |u, tag, v| write(v, &[u.inflow(tag).matrix]),
            None,
        );
        if mesh.network().face_count() > 0 {
            t.add_numbered(
                None,
                number,
                variable("fracture_inflow", "Into fractures"),
                |u, tag, v| write(v, &[u.inflow(tag).fracture]),
                None,
            );
        }
    }
}

/// What each well is to do is an input, `rate` or `pressure` as in the model.
fn add_wells(t: &mut Table<FlowUnit>, flow: &Flow, rate: &str) {
    const TERMINAL: Option<&str> = Some("wells");
    fn control(u: &mut FlowUnit, well: usize) -> &mut f64 {
        match &mut u.settings.inputs.wells[well] {
            Control::Rate(value) | Control::Pressure(value) => value,
        }
    }
    for (number, well) in flow.model().wells.iter().enumerate() {
        let (name, shown) = (identifier(&well.name), &well.name);
        let (input, unit, start, about) = match well.control {
            Control::Rate(q) => ("rate", rate, q, "Rate that is wanted of"),
            Control::Pressure(p) => ("pressure", "Pa", p, "Pressure to be held in"),
        };
        t.add_numbered(
            TERMINAL,
            number,
            |r| {
                Variable::input(r, &format!("wells.{name}.{input}"), Type::Float64)
                    .unit(unit)
                    .start(start)
                    .describe(&format!("{about} well {shown}; a rate is positive where it injects"))
            },
            |u, well, v| write(v, &[*control(u, well)]),
            Some(|u, well, v| {
                *control(u, well) = Allowed::Finite.scalar(v)?;
                Ok(())
            }),
        );
        let output = |what: &str, unit: &str, about: &str| {
            let (name, about) = (format!("wells.{name}.{what}"), format!("{about} well {shown} in the last time step"));
            let unit = unit.to_owned();
            move |r| Variable::output(r, &name, Type::Float64).unit(&unit).describe(&about)
        };
        if input == "pressure" {
            let rate = output("rate", rate, "Rate, positive where it injects, of");
            t.add_numbered(TERMINAL, number, rate, |u, well, v| write(v, &[u.well(well).rate]), None);
            continue;
        }
        // Without an index it is that of the cell.
        let pressure =
            output("pressure", "Pa", if well.index.is_some() { "Pressure in" } else { "Pressure of the cell of" });
        t.add_numbered(TERMINAL, number, pressure, |u, well, v| write(v, &[u.well(well).pressure]), None);
        if well.limit.is_some() {
            let actual = output("actual_rate", rate, "Rate that the limit of pressure leaves of");
            t.add_numbered(TERMINAL, number, actual, |u, well, v| write(v, &[u.well(well).rate]), None);
            t.add_numbered(
                TERMINAL,
                number,
                |r| {
                    Variable::output(r, &format!("wells.{name}.limited"), Type::Boolean)
                        .describe(&format!("Whether well {shown} is held at its limit of pressure"))
                },
                |u, well, v| v.write(&[u.flow.state().limited[well]]),
                None,
            );
        }
    }
}

impl Worker for FlowUnit {
    fn work(&self) -> coupling::Work {
        let work = self.flow.work();
        coupling::Work {
            total: self.computing.as_secs_f64(),
            analysis: work.analysis.as_secs_f64(),
            assembly: work.assembly.as_secs_f64(),
            factorisation: work.factorisation.as_secs_f64(),
            solves: work.solving.as_secs_f64(),
            newton: 0.0,
            factorisations: work.factorisations as f64,
            solve_count: work.solves as f64,
        }
    }
}

impl Unit for FlowUnit {
    type State = Saved;

    fn instantiate(environment: &Environment) -> Result<Self, UnitError> {
        let folder = environment.resource("")?;
        let (document, mesh) = coupling::read_resources(&folder)?;
        Self::new(&document, mesh, environment.log.clone())
    }

    fn description(&self) -> Description {
        let [start, stop, step] = self.times;
        Description::new(&format!("{} (flow)", self.title), "flow")
            .about("Darcy flow in a fractured rock: hybrid finite volumes, implicit Euler")
            .version(env!("CARGO_PKG_VERSION"))
            .license(env!("CARGO_PKG_LICENSE"))
            .capabilities(Capabilities {
                state: true,
                serialize: true,
                directional_derivative: true,
                ..Capabilities::default()
            })
            .default_experiment(DefaultExperiment { start, stop, step })
            .log_category("solver", "What the solver does")
            .units(coupling::units())
            .time_unit("s")
            .variables(self.table.variables())
            .terminals(self.table.terminals())
            .documentation(&format!(
                "<h1>{}: flow</h1>\n{}",
                self.title,
                coupling::documentation(Role::Flow, sizes(self.flow.mesh()))
            ))
    }

    fn get(&mut self, variable: Reference, values: ValuesMut<'_>) -> Result<(), UnitError> {
        let table = Arc::clone(&self.table);
        table.get(self, variable, values)
    }

    fn set(&mut self, variable: Reference, values: Values<'_>) -> Result<(), UnitError> {
        let table = Arc::clone(&self.table);
        table.set(self, variable, values)
    }

    fn initialize(&mut self, experiment: &Experiment) -> Result<(), UnitError> {
        let inputs = &self.settings.inputs;
        self.flow.set_state(FlowState {
            time: experiment.start,
            porosity_change: inputs.porosity_change.clone(),
            aperture: inputs.aperture.clone(),
            ..self.initial.clone()
        })?;
        self.report = Arc::new(no_step(&self.flow));
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        if let Some((face, aperture)) = self.settings.inputs.aperture.iter().enumerate().find(|a| *a.1 <= 0.0) {
            let reason = format!("the aperture of fracture face {face} is {aperture:e} m; it must be above 0");
            return Ok(StepOutcome::Discarded(reason));
        }
        match timed(&mut self.computing, || self.flow.step_to(time + step, step, &self.settings.inputs)) {
            Ok(mut report) => {
                let made = report.work;
                self.log.info("solver", format!("t = {} s: {made:?}, {:?}", report.time, report.balance));
                // Work is no part of the state: a step that is repeated takes less.
                report.work = crate::FlowWork::default();
                self.report = Arc::new(report);
                Ok(StepOutcome::Completed)
            }
            Err(error) if may_pass(&error) => Ok(StepOutcome::Discarded(error.to_string())),
            Err(error) => Err(error.into()),
        }
    }

    fn save(&mut self) -> Result<Saved, UnitError> {
        Ok(Saved {
            state: self.flow.state().clone(),
            settings: self.settings.clone(),
            report: Arc::clone(&self.report),
            linearisation: self.flow.linearisation(),
        })
    }

    fn restore(&mut self, saved: &Saved) -> Result<(), UnitError> {
        match &saved.linearisation {
            Some(linearisation) => self.flow.resume(saved.state.clone(), Arc::clone(linearisation))?,
            None => self.flow.set_state(saved.state.clone())?,
        }
        self.settings.clone_from(&saved.settings);
        self.report = Arc::clone(&saved.report);
        Ok(())
    }

    fn serialize(&self, saved: &Saved) -> Result<Vec<u8>, UnitError> {
        let Saved { state, settings, report, linearisation } = saved;
        Ok(postcard::to_stdvec(&(state, settings, report.as_ref(), linearisation.as_deref()))?)
    }

    fn deserialize(&self, bytes: &[u8]) -> Result<Saved, UnitError> {
        let (state, settings, report, linearisation): (FlowState, Settings, StepReport, Option<Linearisation>) =
            postcard::from_bytes(bytes)?;
        self.flow.check_state(&state, linearisation.as_ref())?;
        self.flow.check_inputs(&settings.inputs)?;
        Ok(Saved { state, settings, report: Arc::new(report), linearisation: linearisation.map(Arc::new) })
    }

    fn directional_derivative(
        &mut self,
        unknowns: &[Reference],
        knowns: &[Reference],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<(), UnitError> {
        let sizes = sizes(self.flow.mesh());
        let (cells, faces) = (vec![0.0; sizes.cells], vec![0.0; sizes.fracture_faces]);
        let mut direction = Perturbation {
            porosity_change: cells.clone(),
            aperture: faces.clone(),
            matrix_pressure_reference: cells,
            fracture_pressure_reference: faces,
        };
        let mut rest = seed;
        for &known in knowns {
            let (own, after) = rest.split_at(self.table.size(known));
            rest = after;
            let part = match self.table.name(known) {
                "matrix.porosity_change" => &mut direction.porosity_change,
                "fracture.aperture" => &mut direction.aperture,
                "matrix.pressure_reference" => &mut direction.matrix_pressure_reference,
                "fracture.pressure_reference" => &mut direction.fracture_pressure_reference,
                name => {
                    return Err(format!(
                        "no derivative with respect to {name}: only to porosity change, aperture and the references"
                    )
                    .into());
                }
            };
            part.copy_from_slice(own);
        }
        // The pressures at the start depend on no input.
        let response = if self.flow.linearisation().is_some() {
            timed(&mut self.computing, || self.flow.linearised_response(&direction))?
        } else {
            crate::PressureResponse {
                matrix_pressure: vec![0.0; sizes.cells],
                fracture_pressure: vec![0.0; sizes.fracture_faces],
            }
        };
        let mut rest = sensitivity;
        for &unknown in unknowns {
            let (own, after) = rest.split_at_mut(self.table.size(unknown));
            rest = after;
            own.copy_from_slice(match self.table.name(unknown) {
                "matrix.pressure" => &response.matrix_pressure,
                "fracture.pressure" => &response.fracture_pressure,
                name => return Err(format!("no derivative of {name}: only of the pressures").into()),
            });
        }
        Ok(())
    }
}

/// Whether a smaller time step, or other inputs, may do where this error came up.
fn may_pass(error: &FlowError) -> bool {
    use linear::Error::{Inaccurate, NotPositiveDefinite};
    match error {
        FlowError::Closed { .. } | FlowError::WellLimits { .. } => true,
        FlowError::Linear(error) => matches!(error, Inaccurate { .. } | NotPositiveDefinite { .. }),
        _ => false,
    }
}

/// The flow problem that a model describes.
///
/// # Errors
/// A model without flow, or expressions that are not sound.
pub fn flow_model(document: &Document, mesh: &Mesh) -> Result<FlowModel, UnitError> {
    let description = &document.model;
    let flow = description.flow.as_ref().ok_or("the model has no [flow]")?;
    let function = |value: &model::Value| -> Result<SpaceTimeFunction, UnitError> {
        let function = description.function(value, Scope::PlaceAndTime)?;
        Ok(SpaceTimeFunction::new(move |x, time| function.at(&Point::new(x, time))))
    };
    let mut problem = FlowModel::new(Fluid {
        viscosity: flow.fluid.viscosity.0,
        density: flow.fluid.density.0,
        bulk_modulus: flow.fluid.bulk_modulus.map(|k| k.0),
    });
    problem.gravity = flow.gravity.as_ref().map_or(Vec3::ZERO, model::Coordinates::vector);
    problem.initial_time = description.time.start.0;
    problem.planarity = description.mesh.planarity();
    let pressure = description.function(&description.initial.pressure, Scope::Place)?;
    problem.initial_pressure = SpaceTimeFunction::new(move |x, _| pressure.at(&Point::new(x, 0.0)));
    for name in &mesh.data().regions {
        let Some(region) = description.regions.get(name) else { continue };
        let permeability = (region.permeability.as_ref())
            .ok_or_else(|| format!("regions.{name} has no permeability, which flow needs"))?;
        let rock = Rock {
            permeability: Tensor::from_cols_array_2d(&permeability.rows(mesh.dim())).transpose(),
            porosity: region.porosity.0,
            biot_modulus: region.biot_modulus.map(|m| m.0),
            biot_coefficient: region.biot_coefficient.0,
        };
        problem.rocks.push((name.clone(), rock));
    }
    let tips = Arc::new(TipDistances::new(mesh));
    for (number, name) in mesh.data().fractures.iter().enumerate() {
        let Some(fracture) = description.fractures.get(name) else { continue };
        let normal_permeability = (fracture.normal_permeability)
            .ok_or_else(|| format!("fractures.{name} has no normal_permeability, which flow needs"))?;
        let aperture = description.function(&fracture.contact_aperture, Scope::Fracture)?;
        let tips = Arc::clone(&tips);
        let aperture = SpaceTimeFunction::new(move |x, _| aperture.at(&tips.point(number, x)));
        problem.fractures.push((name.clone(), Fracture { normal_permeability: normal_permeability.0, aperture }));
    }
    for (tag, boundary) in &flow.boundary {
        let matrix = match (&boundary.pressure, &boundary.inflow) {
            (Some(pressure), _) => Condition::Pressure(function(pressure)?),
            (None, Some(inflow)) => Condition::Inflow(function(inflow)?),
            (None, None) => Condition::Inflow(0.0.into()),
        };
        let fracture = match &boundary.fracture_inflow {
            Some(inflow) => Some(Condition::Inflow(function(inflow)?)),
            None => None,
        };
        problem.boundaries.push((tag.clone(), Boundary { matrix, fracture }));
    }
    problem.matrix_source = flow.matrix_source.as_ref().map(function).transpose()?;
    problem.fracture_source = flow.fracture_source.as_ref().map(function).transpose()?;
    for (name, well) in &flow.wells {
        problem.wells.push(described_well(name, well)?);
    }
    // The unit caps them itself, by parameters.
    problem.stiffness_cap = StiffnessCap { matrix: f64::MAX, fracture: f64::MAX };
    Ok(problem)
}

fn described_well(name: &str, well: &model::Well) -> Result<Well, UnitError> {
    let lacks = |what: &str| UnitError::from(format!("flow.wells.{name} has no {what}"));
    let place = match (&well.cell, &well.fracture_face) {
        (Some(point), _) => WellPlace::Cell(point.vector()),
        (None, Some(point)) => WellPlace::FractureFace(point.vector()),
        (None, None) => return Err(lacks("place")),
    };
    let control = match (well.rate, well.pressure) {
        (Some(rate), _) => Control::Rate(rate.0),
        (None, Some(pressure)) => Control::Pressure(pressure.0),
        (None, None) => return Err(lacks("rate or pressure")),
    };
    let direction = well.direction.as_ref().map_or(Vec3::Z, model::Coordinates::vector);
    let index = match (well.index, well.radius) {
        (Some(index), _) => Some(WellIndex::Given(index.0)),
        (None, Some(radius)) => Some(WellIndex::Radius { radius: radius.0, direction }),
        (None, None) => None,
    };
    Ok(Well { name: name.to_owned(), place, index, control, limit: well.limit.map(|p| p.0) })
}
