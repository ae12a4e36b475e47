//! The flow: state, time steps, coupling inputs, reports.
//!
//! The balances of method section 3, with porosity and aperture affine in the pressures (project's `coupling.md`,
//! section 1) and the compressibility of the fluid linearised at the last time level:
//!
//! ```text
//! φ = φ_0 + φ* + C (p − p*) + (p − p⁰)/M
//! |K| [(φⁿ − φⁿ⁻¹) + φⁿ⁻¹ c_f (pⁿ − pⁿ⁻¹)]/δt + Σ F_Ki = |K| h_m + wells
//! |σ| [(d_fⁿ − d_fⁿ⁻¹) + d_fⁿ⁻¹ c_f (p_fⁿ − p_fⁿ⁻¹)]/δt + Σ F_σe − q⁺ − q⁻ = |σ| h_f + wells
//! ```
//!
//! with φ* the porosity change by deformation, and d_f = d* + C_f (p_f − p_f*). The porosity in φⁿ⁻¹ c_f counts
//! deformation. The matrix depends on δt, C, C_f, and the last time level only.

use std::sync::{Arc, OnceLock};

use linear::{Cholesky, Scratch};
use mesh::{Mesh, Side, Vec3};
use serde::{Deserialize, Serialize};

use crate::Tensor;
use crate::error::{FlowError, Problem};
use crate::model::{Condition, Control, FlowModel, Function, Rock, fail_on};
use crate::report::{Balance, Energy, Fluxes, Inflow, State, StepReport, WellReport, Work, timed};
use crate::scheme::{Coefficients, Evaluation, Scheme};
use crate::space::Space;
use crate::wells::{Placed, Spot, place};

/// What comes from outside in a time step: the affine partner, and what the wells are to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Inputs {
    /// φ*, cells: b (div u − div u⁰).
    pub porosity_change: Vec<f64>,
    /// d* (m), fracture faces.
    pub aperture: Vec<f64>,
    /// C (1/Pa), cells; at least 0.
    pub porosity_compliance: Vec<f64>,
    /// C_f (m/Pa), fracture faces; at least 0.
    pub aperture_compliance: Vec<f64>,
    /// p* (Pa), cells.
    pub matrix_pressure_reference: Vec<f64>,
    /// p_f* (Pa), fracture faces.
    pub fracture_pressure_reference: Vec<f64>,
    /// In the order of the model.
    pub wells: Vec<Control>,
}

/// A direction in the space of the coupling inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Perturbation {
    /// δφ*, cells.
    pub porosity_change: Vec<f64>,
    /// δd* (m), fracture faces.
    pub aperture: Vec<f64>,
    /// δp* (Pa), cells.
    pub matrix_pressure_reference: Vec<f64>,
    /// δp_f* (Pa), fracture faces.
    pub fracture_pressure_reference: Vec<f64>,
}

/// The derivative of the pressures in a direction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Response {
    /// δp_K (Pa), cells.
    pub matrix_pressure: Vec<f64>,
    /// δp_f (Pa), fracture faces.
    pub fracture_pressure: Vec<f64>,
}

/// A boundary datum on a trace.
#[derive(Debug)]
struct Datum {
    trace: usize,
    tag: usize,
    measure: f64,
    point: Vec3,
    function: Function,
}

struct Factor {
    cholesky: Cholesky,
    of: Coefficients,
}

/// The equations of a solved time step, to go back to its end with [`Flow::resume`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Linearisation {
    coefficients: Coefficients,
    /// 1/δt, or 0.
    rate: f64,
    porosity_compliance: Vec<f64>,
    aperture_compliance: Vec<f64>,
}

impl Linearisation {
    /// δt (s); infinite for a steady state.
    pub fn time_step(&self) -> f64 {
        self.rate.recip()
    }
}

/// What the last time step leaves beside the state.
struct Solved {
    linearisation: Arc<Linearisation>,
    /// The equations at its end, and the flux through each mesh face; `None` where only the linearisation came back.
    end: Option<(Evaluation, Vec<f64>)>,
    /// Made when asked for.
    fluxes: OnceLock<Fluxes>,
}

/// Darcy flow on a mesh.
pub struct Flow {
    model: FlowModel,
    scheme: Scheme,
    /// Rock of each region of the mesh.
    rocks: Vec<Rock>,
    normal_permeability: Vec<f64>,
    wells: Vec<Placed>,
    pressures: Vec<Datum>,
    inflows: Vec<Datum>,
    /// Connected part of each cell and, after them, of each fracture face; and whether a given pressure fixes it.
    part: Vec<usize>,
    part_is_fixed: Vec<bool>,
    initial_pressure: Vec<f64>,
    state: State,
    factor: Option<Factor>,
    scratch: Scratch,
    solved: Option<Solved>,
    work: Work,
}

/// A correction is repeated while a residual exceeds this many units of round-off of the largest term in the equations,
/// at most [`CORRECTIONS`] times: one is enough in all but very stiff systems.
const RESIDUAL: f64 = 100.0;
const CORRECTIONS: usize = 3;

impl Flow {
    /// Checks the model, numbers the unknowns, builds the local operators, and analyses the linear system.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] with all that is wrong with the model; [`FlowError::Linear`].
    pub fn new(mesh: Arc<Mesh>, model: FlowModel) -> Result<Self, FlowError> {
        let mut problems = model.check(&mesh);
        let data = mesh.data();
        let rock = |name: &String| model.rocks.iter().find(|r| r.0 == *name).map(|r| r.1);
        let plane = |k: Tensor| if data.dim == 2 { in_plane(k) } else { k };
        let rocks: Vec<Option<Rock>> = data.regions.iter().map(rock).collect();
        let permeability = |cell: usize| {
            let rock = rocks[data.cell_region[cell]];
            rock.map_or(Tensor::IDENTITY, |r| r.permeability)
        };
        let wells = place(&mesh, &model.wells, permeability, &mut problems);
        let network = mesh.network();
        let fracture = |i: usize| {
            let name = &data.fractures[network.fracture[i]];
            model.fractures.iter().find(|f| f.0 == *name).map(|f| &f.1)
        };
        let mut aperture = vec![0.0; network.face_count()];
        let mut normal_permeability = vec![0.0; network.face_count()];
        for i in 0..network.face_count() {
            if let Some(fracture) = fracture(i) {
                let value = fracture.aperture.at(mesh.geometry().face_center[network.faces[i]], model.initial_time);
                if !(value > 0.0 && value.is_finite()) {
                    let of = format!("fracture \"{}\", face {i}", data.fractures[network.fracture[i]]);
                    let must = "positive and finite";
                    problems.push(Problem::Value { of, quantity: "the aperture", value, must });
                }
                aperture[i] = value;
                normal_permeability[i] = fracture.normal_permeability;
            }
        }
        fail_on(problems)?;
        let rocks: Vec<Rock> = rocks.into_iter().flatten().collect();

        let space = Space::new(&mesh);
        let (pressures, inflows) = boundary_data(&mesh, &space, &model);
        let mut given = vec![false; space.trace_count()];
        pressures.iter().for_each(|d| given[d.trace] = true);
        let mobility: Vec<Tensor> =
            rocks.iter().map(|r| plane(r.permeability) * model.fluid.viscosity.recip()).collect();
        let weight = model.fluid.density * model.gravity;
        let mut work = Work::default();
        let scheme = Scheme::new(mesh, space, &mobility, weight, &given, &mut work)?;
        let (part, part_is_fixed) = parts(&scheme, &given, &normal_permeability);

        let (mesh, space) = (&scheme.mesh, &scheme.space);
        let p0 = |x| model.initial_pressure.at(x, model.initial_time);
        let mut traces = vec![0.0; space.trace_count()];
        for facet in 0..space.facet_count() {
            traces[facet] = p0(space.facet_center(facet));
        }
        for (i, &face) in mesh.network().faces.iter().enumerate() {
            for (facet, trace) in space.facets(face).zip(space.side_traces(face, i, Side::Minus)) {
                traces[trace] = p0(space.facet_center(facet));
            }
            traces[space.fracture_trace(i)] = p0(space.fracture_point[i]);
        }
        for (e, &x) in space.edge_center.iter().enumerate() {
            traces[space.edge_trace(e)] = p0(x);
        }
        let matrix_pressure: Vec<f64> = space.cell_point.iter().map(|&x| p0(x)).collect();
        if let Some(&value) = matrix_pressure.iter().chain(&traces).find(|p| !p.is_finite()) {
            let (of, quantity, must) = ("model".into(), "the initial pressure", "finite");
            return Err(FlowError::Invalid(vec![Problem::Value { of, quantity, value, must }]));
        }
        let state = State {
            time: model.initial_time,
            porosity_change: vec![0.0; matrix_pressure.len()],
            matrix_pressure,
            traces,
            aperture,
            limited: vec![false; wells.len()],
        };
        Ok(Self {
            initial_pressure: state.matrix_pressure.clone(),
            rocks,
            normal_permeability,
            wells,
            pressures,
            inflows,
            part,
            part_is_fixed,
            state,
            factor: None,
            scratch: Scratch::default(),
            solved: None,
            work,
            scheme,
            model,
        })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.scheme.mesh
    }

    /// The unknowns.
    pub fn space(&self) -> &Space {
        &self.scheme.space
    }

    /// The model.
    pub fn model(&self) -> &FlowModel {
        &self.model
    }

    /// Work done since the flow was made.
    pub fn work(&self) -> Work {
        self.work
    }

    /// Number of unknowns of the linear system.
    pub fn unknowns(&self) -> usize {
        self.scheme.unknowns()
    }

    /// The linear system that was assembled last.
    pub fn system(&self) -> &linear::SparseSymmetric {
        self.scheme.system()
    }

    /// What the factorisation occupies.
    pub fn memory(&self) -> Option<linear::Memory> {
        self.factor.as_ref().map(|f| f.cholesky.memory())
    }

    /// Where each well acts, in the order of the model.
    pub fn well_spots(&self) -> Vec<Spot> {
        self.wells.iter().map(|w| w.spot).collect()
    }

    /// The state after the last time step.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Goes to a state, as one that was saved.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] if it does not fit; then nothing changes.
    pub fn set_state(&mut self, state: State) -> Result<(), FlowError> {
        self.check_state(&state, None)?;
        self.state = state;
        self.solved = None;
        Ok(())
    }

    /// Whether a state and the equations that led to it fit.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] with all that does not.
    pub fn check_state(&self, state: &State, linearisation: Option<&Linearisation>) -> Result<(), FlowError> {
        let (old, mut problems) = (&self.state, Vec::new());
        for (array, new, old) in [
            ("the matrix pressure", &state.matrix_pressure, &old.matrix_pressure),
            ("the traces", &state.traces, &old.traces),
            ("the porosity change", &state.porosity_change, &old.porosity_change),
            ("the aperture", &state.aperture, &old.aperture),
        ] {
            check_array(array, new, old.len(), "finite", |v| v.is_finite(), &mut problems);
        }
        check_array("the aperture", &state.aperture, old.aperture.len(), "positive", |v| v > 0.0, &mut problems);
        if state.limited.len() != self.wells.len() {
            let (found, expected) = (state.limited.len(), self.wells.len());
            problems.push(Problem::Length { array: "the wells", found, expected });
        }
        if let Some(l) = linearisation {
            let (cells, faces) = (self.state.matrix_pressure.len(), self.state.aperture.len());
            let c = &l.coefficients;
            for (array, values, expected) in [
                ("the diagonal of cells", &c.cell_diagonal, cells),
                ("the source of cells", &c.cell_source, cells),
                ("the diagonal of fracture faces", &c.fracture_diagonal, faces),
                ("the source of fracture faces", &c.fracture_source, faces),
                ("the conductivity", &c.conductivity, faces),
                ("the exchange", &c.exchange, faces),
                ("the porosity compliance", &l.porosity_compliance, cells),
                ("the aperture compliance", &l.aperture_compliance, faces),
            ] {
                check_array(array, values, expected, "finite", f64::is_finite, &mut problems);
            }
        }
        fail_on(problems)
    }

    /// The equations of the last time step, if there was one since the last [`set_state`](Self::set_state).
    pub fn linearisation(&self) -> Option<Arc<Linearisation>> {
        self.solved.as_ref().map(|s| Arc::clone(&s.linearisation))
    }

    /// Goes to a state, and makes [`linearised_response`](Self::linearised_response) that of the time step which led to
    /// it. The fluxes do not come back.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] if one of them does not fit; then nothing changes.
    pub fn resume(&mut self, state: State, linearisation: Arc<Linearisation>) -> Result<(), FlowError> {
        self.check_state(&state, Some(&linearisation))?;
        self.state = state;
        self.solved = Some(Solved { linearisation, end: None, fluxes: OnceLock::new() });
        Ok(())
    }

    /// p_f (Pa), fracture faces.
    pub fn fracture_pressure(&self) -> &[f64] {
        let first = self.scheme.space.fracture_trace(0);
        &self.state.traces[first..first + self.normal_permeability.len()]
    }

    /// Pressure (Pa) at the plus and minus side of a fracture face, or twice the same on another face.
    pub fn face_pressure(&self, face: usize) -> [f64; 2] {
        let space = &self.scheme.space;
        let number = self.scheme.mesh.network().number_of_face[face];
        [Side::Plus, Side::Minus].map(|side| {
            let traces = number.map_or(space.facets(face), |i| space.side_traces(face, i, side));
            space.facets(face).zip(traces).map(|(f, t)| self.scheme.share(face, f) * self.state.traces[t]).sum()
        })
    }

    /// Inputs that leave porosity and aperture as they are in the present state, and the wells as in the model.
    pub fn inputs(&self) -> Inputs {
        let state = &self.state;
        Inputs {
            porosity_change: state.porosity_change.clone(),
            aperture: state.aperture.clone(),
            porosity_compliance: vec![0.0; state.porosity_change.len()],
            aperture_compliance: vec![0.0; state.aperture.len()],
            matrix_pressure_reference: state.matrix_pressure.clone(),
            fracture_pressure_reference: self.fracture_pressure().to_vec(),
            wells: self.model.wells.iter().map(|w| w.control).collect(),
        }
    }

    /// Makes a time step of `dt` (s). To repeat it with other inputs, go back with [`set_state`](Self::set_state): the
    /// factorisation is kept as long as `dt`, the compliances and the last time level are the same to the bit.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] for wrong inputs, an isolated part, or boundary data that are not finite;
    /// [`FlowError::Closed`], [`FlowError::WellLimits`], [`FlowError::Linear`]. The state is then unchanged.
    pub fn step(&mut self, dt: f64, inputs: &Inputs) -> Result<StepReport, FlowError> {
        self.step_to(self.state.time + dt, dt, inputs)
    }

    /// As [`step`](Self::step), where the clock is somebody else's: the time at the end is said to be `time` (s).
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn step_to(&mut self, time: f64, dt: f64, inputs: &Inputs) -> Result<StepReport, FlowError> {
        if !(dt > 0.0 && dt.is_finite()) {
            let (of, quantity, must) = ("time step".into(), "its length (s)", "positive and finite");
            return Err(FlowError::Invalid(vec![Problem::Value { of, quantity, value: dt, must }]));
        }
        self.solve(time, dt.recip(), inputs)
    }

    /// Goes to the steady state for the data at the present time. Apertures are those of the state, not of the inputs.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn steady(&mut self, inputs: &Inputs) -> Result<StepReport, FlowError> {
        self.solve(self.state.time, 0.0, inputs)
    }

    /// S = −∂p/∂(porosity change) as the flow sees it, 1/(1/M + φ c_f) (Pa), cells; at most the cap of the model.
    pub fn matrix_pressure_stiffness(&self) -> Vec<f64> {
        let cap = self.model.stiffness_cap.matrix;
        (0..self.state.matrix_pressure.len()).map(|cell| cap.min(self.storage(cell).recip())).collect()
    }

    /// S_f = −∂p_f/∂d_f (Pa/m), fracture faces, as an increase of all apertures alike shows it in a time step of `dt` (s)
    /// from the present state: one solve. It counts the fluid that leaks off, and is finite for an incompressible one; for a
    /// sealed fracture it is 1/(c_f d_f). At most the cap of the model.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn fracture_pressure_stiffness(&mut self, dt: f64) -> Result<Vec<f64>, FlowError> {
        let (inputs, mut problems) = (self.inputs(), Vec::new());
        let mut c = self.coefficients(self.state.time, dt.recip(), &inputs, &mut problems);
        fail_on(problems)?;
        self.add_wells(&mut c, &inputs, &self.state.limited);
        let geometry = self.scheme.mesh.geometry();
        let faces = &self.scheme.mesh.network().faces;
        let taken: Vec<f64> = faces.iter().map(|&f| geometry.face_measure[f] / dt).collect();
        let cells = vec![0.0; geometry.cell_measure.len()];
        let cap = self.model.stiffness_cap.fracture;
        let response = self.respond(&c, &cells, &taken)?;
        Ok(response.fracture_pressure.into_iter().map(|p| p.clamp(0.0, cap)).collect())
    }

    /// φ of each cell in the present state, never below 0.
    pub fn porosity(&self) -> Vec<f64> {
        (0..self.state.matrix_pressure.len()).map(|cell| self.porosity_of(cell)).collect()
    }

    /// Volume of the fluid in place, in the rock and in fractures (m³, 2D: m²), at the reference density.
    pub fn fluid_in_place(&self) -> Inflow {
        let geometry = self.scheme.mesh.geometry();
        let faces = &self.scheme.mesh.network().faces;
        Inflow {
            matrix: geometry.cell_measure.iter().enumerate().map(|(k, v)| v * self.porosity_of(k)).sum(),
            fracture: faces.iter().zip(&self.state.aperture).map(|(&f, d)| geometry.face_measure[f] * d).sum(),
        }
    }

    /// Volume rates of the last time step.
    ///
    /// # Errors
    /// [`FlowError::NothingSolved`] before the first time step, after [`set_state`](Self::set_state) and
    /// [`resume`](Self::resume).
    pub fn fluxes(&self) -> Result<&Fluxes, FlowError> {
        let solved = self.solved.as_ref().and_then(|s| Some((s.end.as_ref()?, &s.fluxes)));
        let ((evaluation, face), fluxes) = solved.ok_or(FlowError::NothingSolved)?;
        Ok(fluxes.get_or_init(|| self.fluxes_of(evaluation, face)))
    }

    /// The derivative of the pressures of the last time step in a direction of the inputs: one solve.
    ///
    /// # Errors
    /// [`FlowError::NothingSolved`], [`FlowError::Invalid`] for wrong lengths, [`FlowError::Linear`].
    pub fn linearised_response(&mut self, direction: &Perturbation) -> Result<Response, FlowError> {
        let Some(solved) = self.linearisation() else { return Err(FlowError::NothingSolved) };
        let mut problems = Vec::new();
        let (cells, faces) = (self.state.matrix_pressure.len(), self.state.aperture.len());
        for (array, values, expected) in [
            ("the direction of porosity change", &direction.porosity_change, cells),
            ("the direction of aperture", &direction.aperture, faces),
            ("the direction of matrix pressure reference", &direction.matrix_pressure_reference, cells),
            ("the direction of fracture pressure reference", &direction.fracture_pressure_reference, faces),
        ] {
            check_array(array, values, expected, "finite", f64::is_finite, &mut problems);
        }
        fail_on(problems)?;
        let geometry = self.scheme.mesh.geometry();
        let matrix: Vec<f64> = (0..cells)
            .map(|k| {
                let change = solved.porosity_compliance[k] * direction.matrix_pressure_reference[k];
                -geometry.cell_measure[k] * solved.rate * (direction.porosity_change[k] - change)
            })
            .collect();
        let fracture: Vec<f64> = (0..faces)
            .map(|i| {
                let change = solved.aperture_compliance[i] * direction.fracture_pressure_reference[i];
                let measure = geometry.face_measure[self.scheme.mesh.network().faces[i]];
                -measure * solved.rate * (direction.aperture[i] - change)
            })
            .collect();
        // A time step that failed, or another state, may have left the factor of other equations.
        self.respond(&solved.coefficients, &matrix, &fracture)
    }

    /// The change of the pressures for sources (m³/s, 2D: m²/s) in cells and fracture faces.
    fn respond(&mut self, c: &Coefficients, matrix: &[f64], fracture: &[f64]) -> Result<Response, FlowError> {
        let load = self.scheme.load(c, matrix, fracture);
        let mut x = Vec::new();
        self.scheme.gather(&load, &mut x);
        self.factorise(c)?;
        let Some(factor) = &self.factor else { return Err(FlowError::NothingSolved) };
        timed(&mut self.work.solving, || factor.cholesky.solve(&mut x, &mut self.scratch))?;
        self.work.solves += 1;
        let mut traces = vec![0.0; load.len()];
        self.scheme.correct(&mut traces, &x);
        let first = self.scheme.space.fracture_trace(0);
        Ok(Response {
            matrix_pressure: self.scheme.cell_response(c, matrix, &traces),
            fracture_pressure: traces[first..first + fracture.len()].to_vec(),
        })
    }

    fn porosity_of(&self, cell: usize) -> f64 {
        let rock = &self.rocks[self.scheme.mesh.data().cell_region[cell]];
        let elastic = rock.storage() * (self.state.matrix_pressure[cell] - self.initial_pressure[cell]);
        (rock.porosity + self.state.porosity_change[cell] + elastic).max(0.0)
    }

    /// 1/M + φ c_f.
    fn storage(&self, cell: usize) -> f64 {
        let rock = &self.rocks[self.scheme.mesh.data().cell_region[cell]];
        match self.model.fluid.compressibility() {
            0.0 => rock.storage(),
            c_f => rock.storage() + self.porosity_of(cell) * c_f,
        }
    }

    /// Whether inputs are such that [`step`](Self::step) can take them.
    ///
    /// # Errors
    /// [`FlowError::Invalid`] with all that is wrong.
    pub fn check_inputs(&self, inputs: &Inputs) -> Result<(), FlowError> {
        fail_on(self.problems_of(inputs))
    }

    fn problems_of(&self, inputs: &Inputs) -> Vec<Problem> {
        let mut problems = Vec::new();
        let (cells, faces) = (self.state.matrix_pressure.len(), self.state.aperture.len());
        for (array, values, expected) in [
            ("the porosity change", &inputs.porosity_change, cells),
            ("the matrix pressure reference", &inputs.matrix_pressure_reference, cells),
            ("the fracture pressure reference", &inputs.fracture_pressure_reference, faces),
        ] {
            check_array(array, values, expected, "finite", f64::is_finite, &mut problems);
        }
        let positive = |v: f64| v > 0.0 && v.is_finite();
        check_array("the aperture", &inputs.aperture, faces, "positive and finite", positive, &mut problems);
        for (array, values, expected) in [
            ("the porosity compliance", &inputs.porosity_compliance, cells),
            ("the aperture compliance", &inputs.aperture_compliance, faces),
        ] {
            let right = |v: f64| v >= 0.0 && v.is_finite();
            check_array(array, values, expected, "at least 0 and finite", right, &mut problems);
        }
        if inputs.wells.len() == self.wells.len() {
            for (well, control) in self.model.wells.iter().zip(&inputs.wells) {
                let (Control::Rate(value) | Control::Pressure(value)) = *control;
                if !value.is_finite() {
                    let of = format!("well \"{}\"", well.name);
                    problems.push(Problem::Value { of, quantity: "its control", value, must: "finite" });
                }
            }
        } else {
            let (found, expected) = (inputs.wells.len(), self.wells.len());
            problems.push(Problem::Length { array: "the list of wells", found, expected });
        }
        problems
    }

    fn solve(&mut self, time: f64, rate: f64, inputs: &Inputs) -> Result<StepReport, FlowError> {
        let mut problems = self.problems_of(inputs);
        let mut traces = self.state.traces.clone();
        let mut inflow = vec![0.0; traces.len()];
        let mut datum = |d: &Datum, quantity| {
            let value = d.function.at(d.point, time);
            if !value.is_finite() {
                let tag = &self.scheme.mesh.data().tags[d.tag];
                let of = format!("boundary \"{tag}\" at {} and {time} s", d.point);
                problems.push(Problem::Value { of, quantity, value, must: "finite" });
            }
            value
        };
        for d in &self.pressures {
            traces[d.trace] = datum(d, "the pressure");
        }
        for d in &self.inflows {
            inflow[d.trace] += d.measure * datum(d, "the inflow");
        }
        let base = self.coefficients(time, rate, inputs, &mut problems);
        fail_on(problems)?;

        let mut limited = self.state.limited.clone();
        // Each well may reach its limit and leave it again; more is a cycle.
        let most_changes = 2 * self.wells.len() + 1;
        for _ in 0..=most_changes {
            let mut c = base.clone();
            self.add_wells(&mut c, inputs, &limited);
            let evaluation = self.correct(&c, &mut traces, &inflow)?;
            let wells = self.well_reports(inputs, &limited, &evaluation, &traces);
            let next = self.limits(inputs, &wells);
            if next == limited {
                return self.accept(time, rate, inputs, limited, wells, c, traces, &inflow, evaluation);
            }
            limited = next;
        }
        Err(FlowError::WellLimits { changes: most_changes })
    }

    /// All coefficients but those of wells.
    fn coefficients(&self, time: f64, rate: f64, inputs: &Inputs, problems: &mut Vec<Problem>) -> Coefficients {
        let mut c = Coefficients::default();
        if !problems.is_empty() {
            return c;
        }
        let mesh = &self.scheme.mesh;
        let geometry = mesh.geometry();
        let mut source = |function: &Option<Function>, x: Vec3, quantity| {
            let value = function.as_ref().map_or(0.0, |h| h.at(x, time));
            if !value.is_finite() {
                problems.push(Problem::Value { of: format!("source at {x}"), quantity, value, must: "finite" });
            }
            value
        };
        for cell in 0..mesh.cell_count() {
            let measure = geometry.cell_measure[cell];
            let compliance = inputs.porosity_compliance[cell];
            let storage = self.storage(cell);
            let change = self.state.porosity_change[cell] - inputs.porosity_change[cell]
                + compliance * inputs.matrix_pressure_reference[cell]
                + storage * self.state.matrix_pressure[cell];
            let h = source(&self.model.matrix_source, geometry.cell_center[cell], "h_m");
            c.cell_diagonal.push(measure * rate * (storage + compliance));
            c.cell_source.push(measure * (rate * change + h));
        }
        let c_f = self.model.fluid.compressibility();
        let viscosity = self.model.fluid.viscosity;
        for (i, &face) in mesh.network().faces.iter().enumerate() {
            let measure = geometry.face_measure[face];
            let d = self.state.aperture[i];
            let compliance = inputs.aperture_compliance[i];
            let change = d - inputs.aperture[i]
                + compliance * inputs.fracture_pressure_reference[i]
                + c_f * d * self.fracture_pressure()[i];
            let h = source(&self.model.fracture_source, geometry.face_center[face], "h_f");
            c.fracture_diagonal.push(measure * rate * (c_f * d + compliance));
            c.fracture_source.push(measure * (rate * change + h));
            c.conductivity.push(d.powi(3) / (12.0 * viscosity));
            c.exchange.push(measure * 2.0 * self.normal_permeability[i] / (viscosity * d));
        }
        c
    }

    fn well_mobility(&self, well: &Placed) -> f64 {
        well.mobility(self.model.fluid.viscosity, |i| self.state.aperture[i])
    }

    /// What a well does, given whether it is at its limit.
    fn active(&self, well: usize, inputs: &Inputs, limited: &[bool]) -> Control {
        match (self.model.wells[well].limit, limited[well]) {
            (Some(limit), true) => Control::Pressure(limit),
            _ => inputs.wells[well],
        }
    }

    fn add_wells(&self, c: &mut Coefficients, inputs: &Inputs, limited: &[bool]) {
        for (w, well) in self.wells.iter().enumerate() {
            let (diagonal, source) = match well.spot {
                Spot::Cell(cell) => (&mut c.cell_diagonal[cell], &mut c.cell_source[cell]),
                Spot::FractureFace(i) => (&mut c.fracture_diagonal[i], &mut c.fracture_source[i]),
            };
            match self.active(w, inputs, limited) {
                Control::Rate(q) => *source += q,
                Control::Pressure(p) => {
                    let mobility = self.well_mobility(well);
                    *diagonal += mobility;
                    *source += mobility * p;
                }
            }
        }
    }

    fn pressure_at(&self, spot: Spot, evaluation: &Evaluation, traces: &[f64]) -> f64 {
        match spot {
            Spot::Cell(cell) => evaluation.matrix_pressure[cell],
            Spot::FractureFace(i) => traces[self.scheme.space.fracture_trace(i)],
        }
    }

    fn well_reports(
        &self,
        inputs: &Inputs,
        limited: &[bool],
        evaluation: &Evaluation,
        traces: &[f64],
    ) -> Vec<WellReport> {
        (self.wells.iter().enumerate())
            .map(|(w, well)| {
                let p = self.pressure_at(well.spot, evaluation, traces);
                let mobility = self.well_mobility(well);
                let (rate, pressure) = match self.active(w, inputs, limited) {
                    Control::Rate(q) => (q, p + q / mobility),
                    Control::Pressure(held) => (mobility * (held - p), held),
                };
                WellReport { rate, pressure, limited: limited[w] }
            })
            .collect()
    }

    /// Which wells are to be held at their limits, after what they did.
    fn limits(&self, inputs: &Inputs, reports: &[WellReport]) -> Vec<bool> {
        (reports.iter().enumerate())
            .map(|(w, report)| match (inputs.wells[w], self.model.wells[w].limit) {
                (Control::Rate(q), Some(limit)) => {
                    let sign = if q < 0.0 { -1.0 } else { 1.0 };
                    if report.limited {
                        // It stays while the limit lets less through than is wanted.
                        sign * report.rate < sign * q
                    } else {
                        sign * report.pressure > sign * limit
                    }
                }
                _ => false,
            })
            .collect()
    }

    fn check_parts(&self, c: &Coefficients) -> Vec<Problem> {
        let mut fixed = self.part_is_fixed.clone();
        let diagonals = c.cell_diagonal.iter().chain(&c.fracture_diagonal);
        for (&part, &diagonal) in self.part.iter().zip(diagonals) {
            fixed[part] |= diagonal > 0.0;
        }
        let cells = c.cell_diagonal.len();
        (fixed.iter().enumerate().filter(|&(_, &fixed)| !fixed))
            .map(|(part, _)| {
                let mut members = (0..self.part.len()).filter(|&k| self.part[k] == part).peekable();
                let first_cell = members.peek().copied().filter(|&k| k < cells);
                let (mut in_rock, mut in_fractures) = (0, 0);
                members.for_each(|k| if k < cells { in_rock += 1 } else { in_fractures += 1 });
                Problem::Isolated { cells: in_rock, first_cell, fracture_faces: in_fractures }
            })
            .collect()
    }

    /// Makes the factor that of these coefficients.
    fn factorise(&mut self, c: &Coefficients) -> Result<(), FlowError> {
        let kept = self.factor.take_if(|f| !f.of.same_matrix(c));
        if self.factor.is_none() {
            fail_on(self.check_parts(c))?;
            let cholesky = self.scheme.factorise(c, kept.map(|f| f.cholesky), &mut self.work)?;
            self.factor = Some(Factor { cholesky, of: c.clone() });
        }
        Ok(())
    }

    /// Solves for the traces, from those given.
    fn correct(&mut self, c: &Coefficients, traces: &mut [f64], inflow: &[f64]) -> Result<Evaluation, FlowError> {
        self.factorise(c)?;
        let Some(factor) = &self.factor else { return Err(FlowError::NothingSolved) };
        let mut x = Vec::new();
        let mut evaluation = self.scheme.evaluate(c, traces, inflow);
        for _ in 0..CORRECTIONS {
            self.scheme.gather(&evaluation.residual, &mut x);
            timed(&mut self.work.solving, || factor.cholesky.solve(&mut x, &mut self.scratch))?;
            self.work.solves += 1;
            self.scheme.correct(traces, &x);
            evaluation = self.scheme.evaluate(c, traces, inflow);
            self.scheme.gather(&evaluation.residual, &mut x);
            let largest = |values: &[f64]| values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let scale = evaluation.size.max(largest(inflow));
            if largest(&x) <= RESIDUAL * f64::EPSILON * scale {
                break;
            }
        }
        Ok(evaluation)
    }

    fn accept(
        &mut self,
        time: f64,
        rate: f64,
        inputs: &Inputs,
        limited: Vec<bool>,
        wells: Vec<WellReport>,
        c: Coefficients,
        traces: Vec<f64>,
        inflow: &[f64],
        evaluation: Evaluation,
    ) -> Result<StepReport, FlowError> {
        let first = self.scheme.space.fracture_trace(0);
        let porosity_change: Vec<f64> = (0..inputs.porosity_change.len())
            .map(|k| {
                let from_reference = evaluation.matrix_pressure[k] - inputs.matrix_pressure_reference[k];
                inputs.porosity_change[k] + inputs.porosity_compliance[k] * from_reference
            })
            .collect();
        let aperture: Vec<f64> = (0..inputs.aperture.len())
            .map(|i| {
                let from_reference = traces[first + i] - inputs.fracture_pressure_reference[i];
                inputs.aperture[i] + inputs.aperture_compliance[i] * from_reference
            })
            .collect();
        if let Some(i) = aperture.iter().position(|&d| d.is_nan() || d <= 0.0) {
            return Err(FlowError::Closed { fracture_face: i, aperture: aperture[i] });
        }
        let face_flux = self.face_fluxes(&evaluation, inflow);
        let mut report = StepReport { time, wells, work: self.work, ..StepReport::default() };
        report.inflow = self.boundary_inflow(&evaluation, inflow);
        let (balance, energy) = rayon::join(
            || self.balance(&c, &report, &traces, &evaluation, &face_flux),
            || self.energy(time, rate, &c, &traces, inflow, &evaluation, &porosity_change, &aperture, &report),
        );
        (report.balance, report.energy) = (balance, energy);
        let geometry = self.scheme.mesh.geometry();
        if rate > 0.0 {
            for k in 0..porosity_change.len() {
                let dp = evaluation.matrix_pressure[k] - self.state.matrix_pressure[k];
                let taken = porosity_change[k] - self.state.porosity_change[k] + self.storage(k) * dp;
                report.stored.matrix += geometry.cell_measure[k] * taken;
            }
            let c_f = self.model.fluid.compressibility();
            for (i, &face) in self.scheme.mesh.network().faces.iter().enumerate() {
                let d = self.state.aperture[i];
                let taken = aperture[i] - d + c_f * d * (traces[first + i] - self.fracture_pressure()[i]);
                report.stored.fracture += geometry.face_measure[face] * taken;
            }
        }
        let matrix_pressure = evaluation.matrix_pressure.clone();
        self.state = State { time, matrix_pressure, traces, porosity_change, aperture, limited };
        let linearisation = Arc::new(Linearisation {
            coefficients: c,
            rate,
            porosity_compliance: inputs.porosity_compliance.clone(),
            aperture_compliance: inputs.aperture_compliance.clone(),
        });
        self.solved = Some(Solved { linearisation, end: Some((evaluation, face_flux)), fluxes: OnceLock::new() });
        Ok(report)
    }

    /// One flux for both sides of each face; on fracture faces that of the plus side.
    fn face_fluxes(&self, evaluation: &Evaluation, inflow: &[f64]) -> Vec<f64> {
        let (mesh, space, network) = (&self.scheme.mesh, &self.scheme.space, self.scheme.mesh.network());
        let mut fluxes = vec![0.0; mesh.face_count()];
        // Whether the flux of a boundary facet is given: nothing flows where nothing is said.
        let mut given = vec![true; space.facet_count()];
        for datum in self.pressures.iter().filter(|d| d.trace < space.facet_count()) {
            given[datum.trace] = false;
        }
        for (&(facet, sign), flux) in space.cell_facets.iter().zip(&evaluation.cell_flux) {
            let face = space.face_of_facet(facet);
            fluxes[face] += match (mesh.is_boundary(face), given[facet]) {
                (false, _) => 0.5 * sign * flux,
                (true, false) => sign * flux,
                (true, true) => -inflow[facet],
            };
        }
        for (&face, exchange) in network.faces.iter().zip(&evaluation.exchange) {
            fluxes[face] = exchange[0];
        }
        fluxes
    }

    fn fluxes_of(&self, evaluation: &Evaluation, face: &[f64]) -> Fluxes {
        let (mesh, space) = (&self.scheme.mesh, &self.scheme.space);
        let (geometry, network) = (mesh.geometry(), mesh.network());
        let mut fluxes = Fluxes {
            face: face.to_vec(),
            exchange: evaluation.exchange.clone(),
            fracture_edge: evaluation.edge_flux.clone(),
            ..Fluxes::default()
        };
        for cell in 0..mesh.cell_count() {
            let moment = |k: usize| {
                evaluation.cell_flux[k] * (space.facet_center(space.cell_facets[k].0) - space.cell_point[cell])
            };
            let moments: Vec3 = space.cell_traces.range(cell).map(moment).sum();
            fluxes.cell_velocity.push(moments / geometry.cell_measure[cell]);
        }
        for (i, &face) in network.faces.iter().enumerate() {
            let edges = network.face_edges.get(i).iter().zip(network.face_edges.range(i));
            let moment: Vec3 =
                edges.map(|(&e, k)| evaluation.edge_flux[k] * (space.edge_center[e] - space.fracture_point[i])).sum();
            fluxes.fracture_velocity.push(moment / geometry.face_measure[face]);
        }
        fluxes
    }

    fn boundary_inflow(&self, evaluation: &Evaluation, inflow: &[f64]) -> Vec<Inflow> {
        let mut by_tag = vec![Inflow::default(); self.scheme.mesh.data().tags.len()];
        let facets = self.scheme.space.facet_count();
        let mut add = |d: &Datum, rate: f64| {
            let entry = &mut by_tag[d.tag];
            *(if d.trace < facets { &mut entry.matrix } else { &mut entry.fracture }) += rate;
        };
        // What arrives at a trace of given pressure leaves through it.
        self.pressures.iter().for_each(|d| add(d, -evaluation.residual[d.trace]));
        self.inflows.iter().for_each(|d| add(d, inflow[d.trace]));
        by_tag
    }

    fn balance(
        &self,
        c: &Coefficients,
        report: &StepReport,
        traces: &[f64],
        evaluation: &Evaluation,
        face_flux: &[f64],
    ) -> Balance {
        let (mesh, space) = (&self.scheme.mesh, &self.scheme.space);
        let network = mesh.network();
        let mut balance = Balance { round_off: f64::EPSILON * evaluation.size, ..Balance::default() };
        // Storage − sources, wells included.
        let mut whole = 0.0;
        for cell in 0..mesh.cell_count() {
            let net = c.cell_diagonal[cell] * evaluation.matrix_pressure[cell] - c.cell_source[cell];
            let (mut sum, mut size) = (net, net.abs());
            for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
                let flux = match (network.number_of_face[face], sign > 0.0) {
                    (Some(i), plus) => evaluation.exchange[i][usize::from(!plus)],
                    (None, _) => sign * face_flux[face],
                };
                sum += flux;
                size += flux.abs();
            }
            whole += net;
            balance.cell = balance.cell.max(sum.abs());
            balance.throughput = balance.throughput.max(0.5 * size);
        }
        let mut at_edge = vec![0.0; network.edge_count()];
        for i in 0..network.face_count() {
            let net = c.fracture_diagonal[i] * traces[space.fracture_trace(i)] - c.fracture_source[i];
            let [plus, minus] = evaluation.exchange[i];
            let (mut sum, mut size) = (net - plus - minus, net.abs() + plus.abs() + minus.abs());
            for (&e, k) in network.face_edges.get(i).iter().zip(network.face_edges.range(i)) {
                let flux = evaluation.edge_flux[k];
                sum += flux;
                size += flux.abs();
                at_edge[e] += flux;
            }
            whole += net;
            balance.fracture_face = balance.fracture_face.max(sum.abs());
            balance.throughput = balance.throughput.max(0.5 * size);
        }
        let first = space.edge_trace(0);
        self.pressures.iter().filter(|d| d.trace >= first).for_each(|d| at_edge[d.trace - first] = 0.0);
        for d in self.inflows.iter().filter(|d| d.trace >= first) {
            at_edge[d.trace - first] += d.measure * d.function.at(d.point, report.time);
        }
        balance.edge = at_edge.iter().fold(0.0, |m, v| m.max(v.abs()));
        let through_boundary: f64 = report.inflow.iter().map(|i| i.matrix + i.fracture).sum();
        balance.total = (whole - through_boundary).abs();
        balance
    }

    fn energy(
        &self,
        time: f64,
        rate: f64,
        c: &Coefficients,
        traces: &[f64],
        inflow: &[f64],
        evaluation: &Evaluation,
        porosity_change: &[f64],
        aperture: &[f64],
        report: &StepReport,
    ) -> Energy {
        let (mesh, space) = (&self.scheme.mesh, &self.scheme.space);
        let (geometry, network) = (mesh.geometry(), mesh.network());
        let dt = if rate > 0.0 { rate.recip() } else { 1.0 };
        let mut energy = Energy::default();
        let increment = |new: f64, old: f64| (0.5 * (new * new - old * old), 0.5 * (new - old).powi(2));
        let source = |function: &Option<Function>, x| function.as_ref().map_or(0.0, |h| h.at(x, time));
        for cell in 0..mesh.cell_count() {
            let p = evaluation.matrix_pressure[cell];
            let measure = geometry.cell_measure[cell];
            if rate > 0.0 {
                let (stored, damped) = increment(p, self.state.matrix_pressure[cell]);
                energy.storage += measure * self.storage(cell) * stored;
                energy.damping += measure * self.storage(cell) * damped;
                energy.deformation += measure * p * (porosity_change[cell] - self.state.porosity_change[cell]);
            }
            energy.source += dt * measure * p * source(&self.model.matrix_source, geometry.cell_center[cell]);
            for (&trace, k) in space.cell_traces.get(cell).iter().zip(space.cell_traces.range(cell)) {
                let flux = evaluation.cell_flux[k];
                energy.matrix_dissipation += dt * flux * (p - traces[trace] + self.scheme.cell_weight[k]);
                energy.gravity += dt * flux * self.scheme.cell_weight[k];
            }
        }
        let c_f = self.model.fluid.compressibility();
        for (i, &face) in network.faces.iter().enumerate() {
            let p = traces[space.fracture_trace(i)];
            let measure = geometry.face_measure[face];
            if rate > 0.0 {
                let d = self.state.aperture[i];
                let (stored, damped) = increment(p, self.fracture_pressure()[i]);
                energy.storage += measure * c_f * d * stored;
                energy.damping += measure * c_f * d * damped;
                energy.deformation += measure * p * (aperture[i] - d);
            }
            energy.source += dt * measure * p * source(&self.model.fracture_source, geometry.face_center[face]);
            for (&e, k) in network.face_edges.get(i).iter().zip(network.face_edges.range(i)) {
                let (flux, weight) = (evaluation.edge_flux[k], self.scheme.fracture_weight[k]);
                energy.fracture_dissipation += dt * flux * (p - traces[space.edge_trace(e)] + weight);
                energy.gravity += dt * flux * weight;
            }
            for q in evaluation.exchange[i] {
                if c.exchange[i] > 0.0 {
                    energy.exchange_dissipation += dt * q * q / c.exchange[i];
                }
                energy.gravity -= dt * q * self.scheme.side_weight[i];
            }
        }
        energy.boundary = dt
            * (self.pressures.iter().map(|d| -evaluation.residual[d.trace] * traces[d.trace]).sum::<f64>()
                + self.inflows.iter().map(|d| inflow[d.trace] * traces[d.trace]).sum::<f64>());
        for (well, done) in self.wells.iter().zip(&report.wells) {
            energy.wells += dt * done.rate * self.pressure_at(well.spot, evaluation, traces);
        }
        energy
    }
}

/// Reports the length of an array if it is wrong, or else its first wrong value.
fn check_array(
    array: &'static str,
    values: &[f64],
    expected: usize,
    must: &'static str,
    right: impl Fn(f64) -> bool,
    problems: &mut Vec<Problem>,
) {
    if values.len() != expected {
        problems.push(Problem::Length { array, found: values.len(), expected });
    } else if let Some(place) = values.iter().position(|&v| !right(v)) {
        let of = format!("entry {place}");
        problems.push(Problem::Value { of, quantity: array, value: values[place], must });
    }
}

fn in_plane(k: Tensor) -> Tensor {
    let [x, y] = [k.x_axis, k.y_axis].map(|axis| axis.with_z(0.0));
    Tensor::from_cols(x, y, Vec3::Z)
}

fn boundary_data(mesh: &Mesh, space: &Space, model: &FlowModel) -> (Vec<Datum>, Vec<Datum>) {
    let condition_of = |face: usize| {
        let tag = mesh.data().face_tag[face]?;
        let name = &mesh.data().tags[tag];
        model.boundaries.iter().find(|b| b.0 == *name).map(|b| (tag, &b.1))
    };
    let (mut pressures, mut inflows) = (Vec::new(), Vec::new());
    let mut push = |trace, tag, measure, point, condition: &Condition| {
        let (list, function) = match condition {
            Condition::Pressure(function) => (&mut pressures, function.clone()),
            Condition::Inflow(function) => (&mut inflows, function.clone()),
        };
        list.push(Datum { trace, tag, measure, point, function });
    };
    for face in (0..mesh.face_count()).filter(|&f| mesh.is_boundary(f)) {
        if let Some((tag, boundary)) = condition_of(face) {
            for facet in space.facets(face) {
                push(facet, tag, space.facet_vector(facet).length(), space.facet_center(facet), &boundary.matrix);
            }
        }
    }
    for e in 0..mesh.network().edge_count() {
        let faces = mesh.network().edge_boundary.get(e).iter();
        let conditions: Vec<_> =
            faces.filter_map(|&f| condition_of(f)).filter_map(|(t, b)| Some((t, b.fracture_condition()?))).collect();
        let pressure = conditions.iter().find(|(_, c)| matches!(c, Condition::Pressure(_)));
        if let Some(&(tag, condition)) = pressure.or(conditions.first()) {
            push(space.edge_trace(e), tag, space.edge_length[e], space.edge_center[e], condition);
        }
    }
    (pressures, inflows)
}

/// The connected parts of cells and fracture faces, and which of them touch a given pressure.
fn parts(scheme: &Scheme, given: &[bool], normal_permeability: &[f64]) -> (Vec<usize>, Vec<bool>) {
    let (mesh, space) = (&scheme.mesh, &scheme.space);
    let (network, cells) = (mesh.network(), mesh.cell_count());
    let mut parent: Vec<usize> = (0..cells + network.face_count()).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    let mut join = |a: usize, b: usize| {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        parent[a.max(b)] = a.min(b);
    };
    for face in 0..mesh.face_count() {
        let (first, second) = mesh.face_cells(face);
        if let Some(second) = second {
            match network.number_of_face[face] {
                None => join(first, second),
                Some(i) if normal_permeability[i] > 0.0 => {
                    join(first, cells + i);
                    join(second, cells + i);
                }
                Some(_) => {}
            }
        }
    }
    for faces in network.edge_faces.iter() {
        faces.windows(2).for_each(|pair| join(cells + pair[0], cells + pair[1]));
    }
    let roots: Vec<usize> = (0..parent.len()).map(|k| root(&mut parent, k)).collect();
    // A root is the lowest of its part, so it comes first.
    let (mut part, mut count) = (vec![0; roots.len()], 0);
    for (k, &r) in roots.iter().enumerate() {
        part[k] = if r == k { count } else { part[r] };
        count += usize::from(r == k);
    }
    let mut fixed = vec![false; count];
    for (cell, traces) in space.cell_traces.iter().enumerate() {
        fixed[part[cell]] |= traces.iter().any(|&t| given[t]);
    }
    for (i, edges) in network.face_edges.iter().enumerate() {
        fixed[part[cells + i]] |= edges.iter().any(|&e| given[space.edge_trace(e)]);
    }
    (part, fixed)
}
