//! Contact mechanics as an FMI 3.0 co-simulation unit.
//!
//! Resources: `model.toml`, the description of the case, and `mesh.h5`, its mesh. A `fmi3DoStep` is one time step; one
//! that does not converge is discarded. The state of the unit is the equilibrium at the present time with the inputs and
//! parameters that the host has set.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use coupling::{Allowed, CONTACT_STATE, Role, Sizes, Table, Worker, timed};
use fmi_unit::{
    Capabilities, DefaultExperiment, Description, Enumeration, Environment, Experiment, Log, Reference, StepOutcome,
    Type, Unit, UnitError, Values, ValuesMut, Variable,
};
use mesh::{Mesh, Vec3};
use model::{Document, Point, Scope, TipDistances};
use serde::{Deserialize, Serialize};

use crate::{
    BoundaryPoint, Bubbles, ContactState, DEFAULT_RESIDUAL, Dilation, Dirichlet, FractureLaw, Friction, Material,
    Mechanics, Model, Neumann, NewtonSettings, NormalBubbles, Outcome, Partner, PartnerResponse, Place, Scalars,
    Stabilisation, State, UndrainedFunction,
};

/// Contact mechanics behind the FMI.
pub struct MechanicsUnit {
    mechanics: Mechanics,
    table: Arc<Table<Self>>,
    fingerprint: String,
    title: String,
    times: [f64; 3],
    initial: Initial,
    log: Log,
    now: Now,
    /// Whether the host has been told that fractures are closed to their residual aperture.
    told: bool,
    /// Wall time of computing, and of compliances beside it.
    computing: Duration,
    probing: Duration,
}

/// What the start needs.
struct Initial {
    pressure: Partner,
    equilibrium: bool,
}

/// Everything that changes.
#[derive(Clone, Debug)]
pub struct Now {
    state: State,
    inputs: Inputs,
    last: Arc<Last>,
}

/// What the host has set.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Inputs {
    partner: Partner,
    response: PartnerResponse,
    compliance_factor: f64,
    compliance_floor: f64,
}

/// What is remembered of the last time step.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Last {
    newton_iterations: i64,
    /// Largest violation of a contact law (Pa).
    violation: f64,
    /// Terms of the energy balance (J; in 2D J/m): elastic, external, pressure, friction.
    energies: [f64; 4],
    /// The partner's matrix stiffness (Pa) by which the state was found, which its linearised responses need; empty if
    /// it was 0.
    matrix_stiffness: Vec<f64>,
}

/// State in its serialised form.
#[derive(Serialize, Deserialize)]
struct Saved {
    /// Of the mesh.
    fingerprint: String,
    state: State,
    inputs: Inputs,
    last: Last,
}

fn write(values: ValuesMut<'_>, source: &[f64]) -> Result<(), UnitError> {
    values.write(source)
}

impl MechanicsUnit {
    /// The unit of a model on its mesh.
    ///
    /// # Errors
    /// A model without mechanics; what the discretisation refuses.
    pub fn new(document: &Document, mesh: Mesh, log: Log) -> Result<Self, UnitError> {
        let mesh = Arc::new(mesh);
        let fingerprint = mesh.fingerprint();
        let cells = mesh.geometry().cell_center.clone();
        let faces: Vec<Vec3> = mesh.network().faces.iter().map(|&f| mesh.geometry().face_center[f]).collect();
        let pressure = document.model.function(&document.model.initial.pressure, Scope::Place)?;
        let at = |points: &[Vec3]| points.iter().map(|&x| pressure.at(&Point::new(x, 0.0))).collect::<Vec<_>>();
        let pressure = Partner { matrix_pressure: at(&cells), fracture_pressure: at(&faces), response: None };
        let sizes = Sizes { cells: cells.len(), fracture_faces: faces.len(), dim: mesh.dim() };
        let problem = problem(document, &mesh)?;
        let mut computing = Duration::ZERO;
        let mechanics = timed(&mut computing, || Mechanics::new(Arc::clone(&mesh), problem))?;
        let time = &document.model.time;
        let state = mechanics.rest(time.start.0);
        let sensitivity = &document.model.coupling.sensitivity;
        let inputs = Inputs {
            partner: pressure.clone(),
            response: PartnerResponse {
                matrix_pressure_stiffness: vec![0.0; sizes.cells],
                porosity_change: vec![0.0; sizes.cells],
                fracture_pressure_stiffness: vec![0.0; sizes.fracture_faces],
                aperture: mechanics.aperture(&state),
            },
            compliance_factor: sensitivity.matrix_compliance_factor.0,
            compliance_floor: sensitivity.fracture_compliance_floor_factor.0,
        };
        Ok(Self {
            table: Arc::new(table(sizes, &inputs)),
            fingerprint,
            title: document.model.title.clone(),
            times: [time.start.0, time.end.0, time.step.map_or(time.end.0 - time.start.0, |s| s.0)],
            initial: Initial { pressure, equilibrium: document.model.initial.equilibrium },
            log,
            now: Now { state, inputs, last: Arc::default() },
            told: false,
            mechanics,
            computing,
            probing: Duration::ZERO,
        })
    }

    fn about(&self) -> String {
        let mut about =
            "Frictional contact mechanics of a fractured rock: bubble virtual elements, semi-smooth Newton".to_owned();
        let bubbles = self.mechanics.space().normal_bubble_count();
        if bubbles > 0 {
            about += &format!(
                ". Normal bubbles on {bubbles} faces keep nearly incompressible or undrained rock from locking"
            );
        }
        let laws = self.mechanics.model().fractures.iter();
        let held: Vec<_> = laws.filter(|(_, law)| law.has_default_residual()).map(|(name, _)| name.as_str()).collect();
        if !held.is_empty() {
            about += &format!(
                ". Closure is linear without limit on {}: there the fluid finds at least {} % of the contact aperture, as no \
                 residual_aperture and no largest_closure is given",
                held.join(", "),
                100.0 * DEFAULT_RESIDUAL
            );
        }
        about
    }

    fn sizes(&self) -> Sizes {
        let mesh = self.mechanics.mesh();
        Sizes { cells: mesh.cell_count(), fracture_faces: mesh.network().face_count(), dim: mesh.dim() }
    }

    /// Pressures as the step sees them.
    fn partner(&self) -> Partner {
        let Inputs { partner, response, .. } = &self.now.inputs;
        let follows = response.matrix_pressure_stiffness.iter().chain(&response.fracture_pressure_stiffness);
        let response = follows.into_iter().any(|&s| s != 0.0).then(|| response.clone());
        Partner { response, ..partner.clone() }
    }

    fn compliance(&mut self) -> Result<Vec<f64>, UnitError> {
        timed(&mut self.computing, || self.mechanics.follow(&self.now.last.matrix_stiffness))?;
        let floor = self.now.inputs.compliance_floor;
        let probed = timed(&mut self.probing, || self.mechanics.aperture_compliance(&self.now.state))?;
        let scale = self.mechanics.aperture_compliance_scale();
        Ok(probed.iter().zip(scale).map(|(c, scale)| c.max(floor * scale)).collect())
    }

    fn scalars(&self) -> Scalars {
        self.mechanics.scalars(&self.now.state)
    }

    /// Warns once where fractures are closed to their residual aperture.
    fn tell_of_residual_apertures(&mut self) {
        let mesh = self.mechanics.mesh();
        let held = self.mechanics.is_residual(&self.now.state);
        let Some(first) = held.iter().position(|&held| held).filter(|_| !self.told) else { return };
        let Vec3 { x, y, z } = mesh.geometry().face_center[mesh.network().faces[first]];
        self.log.warn(format!(
            "t = {} s: {} of {} fracture faces are closed to their residual aperture, the first of them on fracture \"{}\" at ({x:.4e}, \
             {y:.4e}, {z:.4e}) m. It is what the fluid finds there; the closure of the sides goes beyond the contact aperture, which \
             a largest_closure would prevent",
            self.now.state.time,
            held.iter().filter(|&&held| held).count(),
            held.len(),
            mesh.data().fractures[mesh.network().fracture[first]],
        ));
        self.told = true;
    }
}

/// The variables.
fn table(sizes: Sizes, inputs: &Inputs) -> Table<MechanicsUnit> {
    let mut t = Table::<MechanicsUnit>::new(Role::Mechanics, sizes);
    t.input(
        "matrix.pressure",
        &inputs.partner.matrix_pressure,
        |u, v| write(v, &u.now.inputs.partner.matrix_pressure),
        |u, v| Allowed::Finite.read(v, &mut u.now.inputs.partner.matrix_pressure),
    );
    t.input(
        "fracture.pressure",
        &inputs.partner.fracture_pressure,
        |u, v| write(v, &u.now.inputs.partner.fracture_pressure),
        |u, v| Allowed::Finite.read(v, &mut u.now.inputs.partner.fracture_pressure),
    );
    t.input(
        "matrix.pressure_stiffness",
        &inputs.response.matrix_pressure_stiffness,
        |u, v| write(v, &u.now.inputs.response.matrix_pressure_stiffness),
        |u, v| Allowed::NotNegative.read(v, &mut u.now.inputs.response.matrix_pressure_stiffness),
    );
    t.input(
        "fracture.pressure_stiffness",
        &inputs.response.fracture_pressure_stiffness,
        |u, v| write(v, &u.now.inputs.response.fracture_pressure_stiffness),
        |u, v| Allowed::NotNegative.read(v, &mut u.now.inputs.response.fracture_pressure_stiffness),
    );
    t.reference_of(
        "matrix.porosity_change",
        &inputs.response.porosity_change,
        |u, v| write(v, &u.now.inputs.response.porosity_change),
        |u, v| Allowed::Finite.read(v, &mut u.now.inputs.response.porosity_change),
    );
    t.reference_of(
        "fracture.aperture",
        &inputs.response.aperture,
        |u, v| write(v, &u.now.inputs.response.aperture),
        |u, v| Allowed::Finite.read(v, &mut u.now.inputs.response.aperture),
    );
    t.output("matrix.porosity_change", |u, v| write(v, &u.mechanics.porosity_change(&u.now.state)));
    t.output("fracture.aperture", |u, v| write(v, &u.mechanics.aperture(&u.now.state)));
    t.output("matrix.porosity_compliance", |u, v| {
        let factor = u.now.inputs.compliance_factor;
        write(v, &u.mechanics.porosity_compliance().iter().map(|c| factor * c).collect::<Vec<_>>())
    });
    t.output("fracture.aperture_compliance", |u, v| write(v, &u.compliance()?));
    t.output("fracture.displacement_jump", |u, v| write(v, u.now.state.jump(u.mechanics.space())));
    t.output("fracture.traction", |u, v| write(v, &u.now.state.multiplier.iter().map(|l| -l).collect::<Vec<_>>()));
    t.output("fracture.contact_state", |u, v| {
        v.write(&u.now.state.contact.iter().map(|&s| s as i64).collect::<Vec<_>>())
    });
    t.output("matrix.displacement", |u, v| {
        write(v, &components(u.mechanics.cell_displacement(&u.now.state), u.sizes().dim))
    });
    t.output("matrix.displacement_gradient", |u, v| {
        let d = u.sizes().dim;
        let cells = u.mechanics.displacement_gradient(&u.now.state);
        write(v, &components(cells.iter().flat_map(|rows| rows[..d].iter().copied()), d))
    });
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
    // Of the last time step: no function of the state alone.
    let last = |name, unit, about| move |r| float(name, unit, about)(r).discrete();
    let count =
        |name: &'static str, about: &'static str| move |r| Variable::output(r, name, Type::Int64).describe(about);
    if sizes.fracture_faces > 0 {
        t.add(float("aperture.mean", "m", "Mean aperture"), |u, v| write(v, &[u.scalars().mean_aperture]), None);
        t.add(float("aperture.min", "m", "Smallest aperture"), |u, v| write(v, &[u.scalars().smallest_aperture]), None);
        t.add(float("aperture.max", "m", "Largest aperture"), |u, v| write(v, &[u.scalars().largest_aperture]), None);
        t.add(
            float("slip.max", "m", "Largest slip since the initial state"),
            |u, v| write(v, &[u.scalars().largest_slip]),
            None,
        );
        t.add(
            float("slip_tendency.max", "1", "Largest |tangential traction| / bound of friction of a closed face"),
            |u, v| write(v, &[u.scalars().largest_slip_tendency]),
            None,
        );
        t.add(
            float("seismic_moment", sizes.moment_unit(), "Sum of shear modulus x area x slip since the initial state"),
            |u, v| write(v, &[u.scalars().seismic_moment]),
            None,
        );
        t.add(
            float(
                "moment_magnitude",
                "1",
                "2/3 (log10 of the seismic moment in N.m - 9.1), in 2D of one metre; minus infinity without slip",
            ),
            |u, v| write(v, &[u.scalars().moment_magnitude()]),
            None,
        );
        t.add(
            count("contact.open", "Number of open fracture faces"),
            |u, v| v.write(&[u.now.state.count(ContactState::Open) as i64]),
            None,
        );
        t.add(
            count("contact.stick", "Number of sticking fracture faces"),
            |u, v| v.write(&[u.now.state.count(ContactState::Stick) as i64]),
            None,
        );
        t.add(
            count("contact.slip", "Number of slipping fracture faces"),
            |u, v| v.write(&[u.now.state.count(ContactState::Slip) as i64]),
            None,
        );
    }
    t.add(
        count("newton.iterations", "Newton iterations of the last step"),
        |u, v| v.write(&[u.now.last.newton_iterations]),
        None,
    );
    if sizes.fracture_faces > 0 {
        t.add(
            last("contact.violation", "Pa", "Largest violation of a contact law in the last step"),
            |u, v| write(v, &[u.now.last.violation]),
            None,
        );
    }
    let joule = sizes.energy_unit();
    t.add(last("energy.elastic", joule, "Elastic energy"), |u, v| write(v, &[u.now.last.energies[0]]), None);
    t.add(
        last("energy.external_work", joule, "Work of loads and prescribed displacements in the last step"),
        |u, v| write(v, &[u.now.last.energies[1]]),
        None,
    );
    t.add(
        last("energy.pressure_work", joule, "Work of the pressures in the last step"),
        |u, v| write(v, &[u.now.last.energies[2]]),
        None,
    );
    t.add(
        last(
            "energy.friction",
            joule,
            "Dissipation on fractures in the last step: friction, less the work of mechanical dilation against compression",
        ),
        |u, v| write(v, &[u.now.last.energies[3]]),
        None,
    );
    t.work();
    t.add(
        |r| {
            Variable::parameter(r, "porosity_compliance.factor", Type::Float64)
                .tunable()
                .unit("1")
                .start(inputs.compliance_factor)
                .describe("Factor on b2/K_dr in matrix.porosity_compliance")
        },
        |u, v| write(v, &[u.now.inputs.compliance_factor]),
        Some(|u, v| {
            u.now.inputs.compliance_factor = Allowed::NotNegative.scalar(v)?;
            Ok(())
        }),
    );
    if sizes.fracture_faces > 0 {
        t.add(
            |r| {
                Variable::parameter(r, "aperture_compliance.floor", Type::Float64)
                    .tunable()
                    .unit("1")
                    .start(inputs.compliance_floor)
                    .describe(
                        "fracture.aperture_compliance is at least this times fracture length / plane-strain modulus",
                    )
            },
            |u, v| write(v, &[u.now.inputs.compliance_floor]),
            Some(|u, v| {
                u.now.inputs.compliance_floor = Allowed::NotNegative.scalar(v)?;
                Ok(())
            }),
        );
    }
    t
}

impl Worker for MechanicsUnit {
    fn work(&self) -> coupling::Work {
        let work = self.mechanics.work();
        coupling::Work {
            total: (self.computing + self.probing).as_secs_f64(),
            analysis: work.analysis.as_secs_f64(),
            assembly: work.assembly.as_secs_f64(),
            factorisation: work.factorisation.as_secs_f64(),
            solves: work.solving.as_secs_f64(),
            newton: (work.newton + self.probing).as_secs_f64(),
            factorisations: work.factorisations as f64,
            solve_count: work.solves as f64,
        }
    }
}

impl Unit for MechanicsUnit {
    type State = Now;

    fn instantiate(environment: &Environment) -> Result<Self, UnitError> {
        let folder = environment.resource("")?;
        let (document, mesh) = coupling::read_resources(&folder)?;
        Self::new(&document, mesh, environment.log.clone())
    }

    fn description(&self) -> Description {
        let [start, stop, step] = self.times;
        Description::new(&format!("{} (mechanics)", self.title), "mechanics")
            .about(&self.about())
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
            .enumerations([Enumeration::new(CONTACT_STATE)
                .item("open", ContactState::Open as i64)
                .item("stick", ContactState::Stick as i64)
                .item("slip", ContactState::Slip as i64)])
            .variables(self.table.variables())
            .terminals(self.table.terminals())
            .documentation(&format!(
                "<h1>{}: contact mechanics</h1>\n{}",
                self.title,
                coupling::documentation(Role::Mechanics, self.sizes())
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
        let (start, pressure) = (experiment.start, &self.initial.pressure);
        let mut elastic = 0.0;
        self.now.state = if self.initial.equilibrium {
            match timed(&mut self.computing, || self.mechanics.initial_equilibrium(start, pressure))? {
                Outcome::Converged(state, report) => {
                    elastic = report.energy.elastic;
                    state
                }
                Outcome::Discarded(why, _) => return Err(format!("at the initial equilibrium {why}").into()),
            }
        } else {
            self.mechanics.rest(start)
        };
        self.now.last = Arc::new(Last { energies: [elastic, 0.0, 0.0, 0.0], ..Last::default() });
        self.told = false;
        self.tell_of_residual_apertures();
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<StepOutcome, UnitError> {
        let partner = self.partner();
        match timed(&mut self.computing, || self.mechanics.step(&self.now.state, time + step, &partner))? {
            Outcome::Converged(state, report) => {
                self.now.state = state;
                let e = report.energy;
                self.now.last = Arc::new(Last {
                    newton_iterations: report.newton.iterations as i64,
                    violation: report.violation,
                    energies: [e.elastic, e.external_work, e.pressure_work, e.friction],
                    matrix_stiffness: self.mechanics.matrix_stiffness().to_vec(),
                });
                self.log.info("solver", format!("t = {} s: {:?}", time + step, report.newton));
                self.tell_of_residual_apertures();
                Ok(StepOutcome::Completed)
            }
            Outcome::Discarded(why, _) => Ok(StepOutcome::Discarded(format!("at t = {} s {why}", time + step))),
        }
    }

    fn save(&mut self) -> Result<Now, UnitError> {
        Ok(self.now.clone())
    }

    fn restore(&mut self, state: &Now) -> Result<(), UnitError> {
        self.now.clone_from(state);
        Ok(())
    }

    fn serialize(&self, state: &Now) -> Result<Vec<u8>, UnitError> {
        let saved = Saved {
            fingerprint: self.fingerprint.clone(),
            state: state.state.clone(),
            inputs: state.inputs.clone(),
            last: Last::clone(&state.last),
        };
        Ok(postcard::to_stdvec(&saved)?)
    }

    fn deserialize(&self, bytes: &[u8]) -> Result<Now, UnitError> {
        let Saved { fingerprint, state, inputs, last } = postcard::from_bytes(bytes)?;
        if fingerprint != self.fingerprint {
            return Err(format!(
                "the state belongs to another mesh: its fingerprint is {fingerprint}, that of this unit's mesh {}",
                self.fingerprint
            )
            .into());
        }
        let sizes = self.sizes();
        let fits = |values: &[f64], expected: usize| values.len() == expected;
        let r = &inputs.response;
        if !(fits(&inputs.partner.matrix_pressure, sizes.cells)
            && fits(&inputs.partner.fracture_pressure, sizes.fracture_faces)
            && fits(&r.matrix_pressure_stiffness, sizes.cells)
            && fits(&r.porosity_change, sizes.cells)
            && fits(&r.fracture_pressure_stiffness, sizes.fracture_faces)
            && fits(&r.aperture, sizes.fracture_faces)
            && (last.matrix_stiffness.is_empty() || fits(&last.matrix_stiffness, sizes.cells)))
        {
            return Err("the state belongs to another mesh".into());
        }
        Ok(Now { state: self.mechanics.load(state)?, inputs, last: Arc::new(last) })
    }

    fn directional_derivative(
        &mut self,
        unknowns: &[Reference],
        knowns: &[Reference],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<(), UnitError> {
        let sizes = self.sizes();
        let (mut matrix, mut fracture) = (vec![0.0; sizes.cells], vec![0.0; sizes.fracture_faces]);
        let (state, last) = (&self.now.state, &self.now.last);
        let add = |target: &mut [f64], change: &[f64]| target.iter_mut().zip(change).for_each(|(t, c)| *t += c);
        let times = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>();
        // p = p* − S (φ − φ*): a reference acts like the pressure S φ*, and S like φ* − φ.
        let reference = &self.now.inputs.response;
        let off =
            |reference: &[f64], value: &[f64]| reference.iter().zip(value).map(|(r, v)| r - v).collect::<Vec<_>>();
        let mut rest = seed;
        for &known in knowns {
            let (own, after) = rest.split_at(self.table.size(known));
            rest = after;
            match self.table.name(known) {
                "matrix.pressure" => add(&mut matrix, own),
                "fracture.pressure" => add(&mut fracture, own),
                "matrix.porosity_change_reference" => add(&mut matrix, &times(&last.matrix_stiffness, own)),
                "fracture.aperture_reference" => add(&mut fracture, &times(&state.fracture_stiffness(), own)),
                "matrix.pressure_stiffness" => {
                    let off = off(&reference.porosity_change, &self.mechanics.porosity_change(state));
                    add(&mut matrix, &times(&off, own));
                }
                "fracture.pressure_stiffness" => {
                    add(&mut fracture, &times(&off(&reference.aperture, &self.mechanics.aperture(state)), own));
                }
                name => return Err(format!("no derivative with respect to {name}: only to inputs").into()),
            }
        }
        let response = timed(&mut self.computing, || {
            self.mechanics.follow(&self.now.last.matrix_stiffness)?;
            self.mechanics.response(&self.now.state, &matrix, &fracture)
        })?;
        let (mechanics, state) = (&self.mechanics, &self.now.state);
        let scalars = || mechanics.scalars_response(state, &response);
        let mut rest = sensitivity;
        for &unknown in unknowns {
            let (own, after) = rest.split_at_mut(self.table.size(unknown));
            rest = after;
            let values = match self.table.name(unknown) {
                "matrix.porosity_change" => response.porosity_change.clone(),
                "fracture.aperture" => response.aperture.clone(),
                "fracture.displacement_jump" => response.jump.clone(),
                "fracture.traction" => mechanics.multiplier_response(state, &response).iter().map(|l| -l).collect(),
                "matrix.displacement" => components(mechanics.cell_displacement_response(&response), sizes.dim),
                "matrix.displacement_gradient" => {
                    let rows = mechanics.displacement_gradient_response(&response);
                    components(rows.iter().flat_map(|rows| rows[..sizes.dim].iter().copied()), sizes.dim)
                }
                "matrix.porosity_compliance" => vec![0.0; sizes.cells],
                "aperture.mean" => vec![scalars().mean_aperture],
                "aperture.min" => vec![scalars().smallest_aperture],
                "aperture.max" => vec![scalars().largest_aperture],
                "slip.max" => vec![scalars().largest_slip],
                "slip_tendency.max" => vec![scalars().largest_slip_tendency],
                "seismic_moment" => vec![scalars().seismic_moment],
                "moment_magnitude" => vec![mechanics.scalars(state).moment_magnitude_response(&scalars())],
                name => return Err(format!("no derivative of {name}").into()),
            };
            own.copy_from_slice(&values);
        }
        Ok(())
    }
}

/// The components of vectors, one vector behind the other.
fn components(vectors: impl IntoIterator<Item = Vec3>, dim: usize) -> Vec<f64> {
    vectors.into_iter().flat_map(|v| v.to_array().into_iter().take(dim)).collect()
}

/// The mechanical problem that a model describes.
///
/// # Errors
/// A model without mechanics, or expressions that are not sound.
pub fn problem(document: &Document, mesh: &Mesh) -> Result<Model, UnitError> {
    let description = &document.model;
    let mechanics = description.mechanics.as_ref().ok_or("the model has no [mechanics]")?;
    let mut problem = Model::default();
    for (name, region) in &description.regions {
        let needed = |value: Option<model::Number>, key: &str| {
            value
                .map(|v| v.0)
                .ok_or_else(|| UnitError::from(format!("regions.{name} has no {key}, which mechanics needs")))
        };
        let material = Material {
            young_modulus: needed(region.young_modulus, "young_modulus")?,
            poisson_ratio: needed(region.poisson_ratio, "poisson_ratio")?,
            biot_coefficient: region.biot_coefficient.0,
        };
        problem.materials.insert(name.clone(), material);
    }
    let tips = Arc::new(TipDistances::new(mesh));
    for (number, name) in mesh.data().fractures.iter().enumerate() {
        let Some(fracture) = description.fractures.get(name) else { continue };
        let aperture = description.function(&fracture.contact_aperture, Scope::Fracture)?;
        let tips = Arc::clone(&tips);
        let law = FractureLaw {
            friction: match fracture.friction {
                model::Friction::None => Friction::None,
                model::Friction::Tresca { bound } => Friction::Tresca { bound: bound.0 },
                model::Friction::Coulomb { coefficient, cohesion } => {
                    Friction::Coulomb { coefficient: coefficient.0, cohesion: cohesion.0 }
                }
            },
            dilation_angle: fracture.dilation_angle.0,
            dilation: match fracture.dilation {
                model::Dilation::Hydraulic => Dilation::Hydraulic,
                model::Dilation::Mechanical => Dilation::Mechanical,
            },
            dilation_limit: fracture.dilation_limit.map(|v| v.0),
            normal_stiffness: fracture.normal_stiffness.map(|k| k.0),
            largest_closure: fracture.largest_closure.map(|v| v.0),
            residual_aperture: fracture.residual_aperture.map(|v| v.0),
            contact_aperture: Arc::new(move |x, _| aperture.at(&tips.point(number, x))),
        };
        problem.fractures.insert(name.clone(), law);
    }
    for displacement in &mechanics.displacement {
        let places: Vec<Place> = match &displacement.at {
            Some(point) => vec![Place::Point(point.vector())],
            None => displacement.on.iter().cloned().map(Place::Tag).collect(),
        };
        for (component, _, value) in displacement.components() {
            let function = description.function(value, Scope::Boundary)?;
            for place in &places {
                let function = function.clone();
                problem.dirichlet.push(Dirichlet {
                    place: place.clone(),
                    component,
                    value: Arc::new(move |p: &BoundaryPoint, time| {
                        function.at(&Point { cell: p.cell, ..Point::new(p.at, time) })
                    }),
                });
            }
        }
    }
    for traction in &mechanics.traction {
        let mut components =
            [model::Function::constant(0.0), model::Function::constant(0.0), model::Function::constant(0.0)];
        for (component, _, value) in traction.components() {
            components[component] = description.function(value, Scope::PlaceAndTime)?;
        }
        for tag in &traction.on {
            let components = components.clone();
            let function = move |x, time| vector(&components, x, time);
            problem.neumann.push(Neumann { tag: tag.clone(), traction: Arc::new(function) });
        }
    }
    if let Some(force) = &mechanics.body_force {
        let components = force
            .iter()
            .map(|value| description.function(value, Scope::PlaceAndTime))
            .collect::<Result<Vec<_>, _>>()?;
        problem.body_force = Some(Arc::new(move |x, time| vector(&components, x, time)));
    }
    problem.bubbles = match mechanics.bubbles {
        model::Bubbles::OneSided => Bubbles::OneSided,
        model::Bubbles::TwoSided => Bubbles::TwoSided,
    };
    problem.normal_bubbles = match mechanics.normal_bubbles {
        model::NormalBubbles::Auto => NormalBubbles::Auto,
        model::NormalBubbles::None => NormalBubbles::None,
        model::NormalBubbles::All => NormalBubbles::All,
    };
    problem.undrained = undrained(description, mesh.dim());
    problem.stabilisation = match mechanics.stabilisation {
        model::Stabilisation::Matched => Stabilisation::Matched,
        model::Stabilisation::Published => Stabilisation::Published,
    };
    let defaults = NewtonSettings::default();
    problem.newton = NewtonSettings {
        beta_factor: mechanics.newton.beta_factor.map_or(defaults.beta_factor, |v| v.0),
        max_iterations: mechanics.newton.max_iterations.unwrap_or(defaults.max_iterations),
        tolerance: mechanics.newton.tolerance.map_or(defaults.tolerance, |v| v.0),
    };
    Ok(problem)
}

/// What undrained pores add to λ: b²M, in cells out of which pressure does not diffuse within the first time step.
fn undrained(description: &model::Model, dim: usize) -> Option<UndrainedFunction> {
    let flow = description.flow.as_ref()?;
    let time = &description.time;
    let step = time.step.map_or(time.end.0 - time.start.0, |step| step.0);
    let fluid = flow.fluid.bulk_modulus.map_or(0.0, |k| 1.0 / k.0);
    let mut regions = BTreeMap::new();
    for (name, region) in &description.regions {
        let (Some(young), Some(poisson)) = (region.young_modulus, region.poisson_ratio) else { continue };
        let (young_modulus, poisson_ratio) = (young.0, poisson.0);
        let biot = region.biot_coefficient.0;
        let drained = Material { young_modulus, poisson_ratio, biot_coefficient: biot };
        let storage = region.biot_modulus.map_or(0.0, |m| 1.0 / m.0) + region.porosity.0 * fluid;
        let rows = region.permeability.as_ref().map_or([[0.0; 3]; 3], |k| k.rows(dim));
        let permeability = (0..dim).map(|i| rows[i][i]).fold(0.0, f64::max);
        // Of the pressure, where the rock may move in one direction only.
        let capacity = storage + biot * biot / (drained.lambda() + 2.0 * drained.mu());
        let diffusivity = permeability / (flow.fluid.viscosity.0 * capacity);
        let added = if biot > 0.0 { biot * biot / storage } else { 0.0 };
        regions.insert(name.clone(), (added, (diffusivity * step).sqrt()));
    }
    Some(Arc::new(move |region, diameter| match regions.get(region) {
        Some(&(added, way)) if way < diameter => added,
        _ => 0.0,
    }))
}

fn vector(components: &[model::Function], x: Vec3, time: f64) -> Vec3 {
    let mut value = Vec3::ZERO;
    for (c, function) in components.iter().enumerate() {
        value[c] = function.at(&Point::new(x, time));
    }
    value
}
