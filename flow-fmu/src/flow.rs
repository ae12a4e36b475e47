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

mod balance;
mod boundary;
mod control;
mod energy;
mod fluxes;
mod held;
mod inputs;
mod parts;
mod porosity;
mod response;
mod state;

use std::sync::{Arc, OnceLock};

use linear::{Cholesky, Scratch};
use mesh::{Mesh, Side, Vec3};

use self::boundary::{Datum, boundary_data};
use self::parts::parts;
use crate::Tensor;
use crate::error::{FlowError, Problem};
use crate::model::{FlowModel, Rock, SpaceTimeFunction, fail_on};
use crate::report::{FlowWork, StepReport, WellReport, timed};
use crate::scheme::{Coefficients, Evaluation, Scheme};
use crate::space::Space;
use crate::wells::{Placed, Spot, connect, place};

pub use self::balance::Balance;
pub use self::energy::Energy;
pub use self::fluxes::Fluxes;
pub use self::inputs::Inputs;
pub use self::response::{Perturbation, PressureResponse};
pub use self::state::{FlowState, Linearisation};

struct Factor {
    cholesky: Cholesky,
    of: Coefficients,
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
    state: FlowState,
    factor: Option<Factor>,
    scratch: Scratch,
    solved: Option<Solved>,
    work: FlowWork,
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
        let spots = place(&mesh, &model.wells, &mut problems);
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

        let space = Space::new(&mesh, model.planarity);
        let mut problems = Vec::new();
        let permeability = |cell: usize| plane(rocks[data.cell_region[cell]].permeability);
        let wells = connect(&mesh, &space, &model.wells, &spots, &permeability, &mut problems)?;
        fail_on(problems)?;
        let (pressures, inflows) = boundary_data(&mesh, &space, &model);
        let mut given = vec![false; space.trace_count()];
        pressures.iter().for_each(|d| given[d.trace] = true);
        let mobility: Vec<Tensor> =
            rocks.iter().map(|r| plane(r.permeability) * model.fluid.viscosity.recip()).collect();
        let weight = model.fluid.density * model.gravity;
        let mut work = FlowWork::default();
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
        let state = FlowState {
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
    pub fn work(&self) -> FlowWork {
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
    pub fn state(&self) -> &FlowState {
        &self.state
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
        fail_on(std::mem::take(&mut problems))?;
        let inputs = &*self.held(rate, inputs);
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
        let mut source = |function: &Option<SpaceTimeFunction>, x: Vec3, quantity| {
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
        // Where references follow, a pressure far from its reference is not the last one.
        let is_closed = |&d: &f64| d.is_nan() || (d <= 0.0 && !inputs.references_follow);
        if let Some(i) = aperture.iter().position(is_closed) {
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
        self.state = FlowState { time, matrix_pressure, traces, porosity_change, aperture, limited };
        let linearisation = Arc::new(Linearisation {
            coefficients: c,
            rate,
            porosity_compliance: inputs.porosity_compliance.clone(),
            aperture_compliance: inputs.aperture_compliance.clone(),
        });
        self.solved = Some(Solved { linearisation, end: Some((evaluation, face_flux)), fluxes: OnceLock::new() });
        Ok(report)
    }
}

fn in_plane(k: Tensor) -> Tensor {
    let [x, y] = [k.x_axis, k.y_axis].map(|axis| axis.with_z(0.0));
    Tensor::from_cols(x, y, Vec3::Z)
}
