//! The mechanical problem in time: states, steps, and what they give.

use std::sync::Arc;
use std::time::{Duration, Instant};

use linear::{Forward, Scratch};
use mesh::{Mesh, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::contact::{ContactState, Face, FacePartner, Local};
use crate::error::{MechanicsError, ModelProblem};
use crate::linearised::Schur;
use crate::model::Model;
use crate::newton::{FractureData, FractureProblem, NewtonReport, SingularFracture};
use crate::space::Space;
use crate::system::{CellMaterial, SetupReport, Stage, System, Work, boundary_nodes};

/// How the partner's fields follow ours: p_m = p_m* − S (φ − φ*), p_f = p_f* − S_f (d_f − d_f*).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Partner {
    /// Matrix pressure p_m* (Pa): cells.
    pub matrix_pressure: Vec<f64>,
    /// Fracture pressure p_f* (Pa): fracture faces.
    pub fracture_pressure: Vec<f64>,
    /// How pressures answer to deformation; `None` where they are given.
    pub response: Option<PartnerResponse>,
}

/// The part of [`Partner`] that makes pressures follow the deformation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartnerResponse {
    /// S ≥ 0 (Pa): cells.
    pub matrix_pressure_stiffness: Vec<f64>,
    /// Porosity change φ* at which p_m* holds: cells.
    pub porosity_change: Vec<f64>,
    /// S_f ≥ 0 (Pa/m): fracture faces.
    pub fracture_pressure_stiffness: Vec<f64>,
    /// Aperture d_f* (m) at which p_f* holds: fracture faces.
    pub aperture: Vec<f64>,
}

impl Partner {
    /// The same pressure (Pa) in the matrix and in the fractures.
    pub fn uniform(mesh: &Mesh, pressure: f64) -> Self {
        Self {
            matrix_pressure: vec![pressure; mesh.cell_count()],
            fracture_pressure: vec![pressure; mesh.network().face_count()],
            response: None,
        }
    }
}

/// A mechanical equilibrium at a time. It is all that the next one depends on.
#[derive(Clone, Debug)]
pub struct State {
    /// Time (s).
    pub time: f64,
    /// All unknowns in the numbering of [`Space`] (m).
    pub unknowns: Vec<f64>,
    /// Multiplier λ = −T⁺ (Pa) in the basis of each face: fracture faces × d.
    pub multiplier: Vec<f64>,
    /// State of each fracture face.
    pub contact: Vec<ContactState>,
    /// div u at the initial state, from which porosity changes count: cells.
    pub initial_divergence: Vec<f64>,
    /// Jump at the initial state (m), from which the slip of dilation counts: fracture faces × d.
    pub initial_jump: Vec<f64>,
    pub(crate) history: History,
}

/// A [`State`] in a form that can be written and read; made by [`State::to_saved`], taken by [`Mechanics::load`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SavedState {
    time: f64,
    unknowns: Vec<f64>,
    multiplier: Vec<f64>,
    contact: Vec<ContactState>,
    initial_divergence: Vec<f64>,
    initial_jump: Vec<f64>,
    history: History,
}

/// What is remembered of the step that led to a state, for the linearised response and the first guess of the next.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct History {
    previous_jump: Vec<f64>,
    time_step: f64,
    partners: Vec<FacePartner>,
}

impl History {
    /// The increment of the jump if it goes on at the same rate.
    fn extrapolate(&self, jump: &[f64], time_step: f64) -> Option<Vec<f64>> {
        let factor = time_step / self.time_step;
        let increment = jump.iter().zip(&self.previous_jump).map(|(g, p)| factor * (g - p));
        (self.time_step > 0.0 && factor.is_finite()).then(|| increment.collect())
    }
}

/// Terms of the energy balance of a step (J, per metre of thickness in 2D).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Elastic energy at the end of the step: ½ a(u,u), stabilisation included, and ½ λ_n²/k_n of the fractures.
    pub elastic: f64,
    /// Work of tractions, body forces and prescribed displacements during the step, forces at their end values.
    pub external_work: f64,
    /// Work of the pressures during the step, pressures at their end values.
    pub pressure_work: f64,
    /// Dissipation of friction ∫ λ_τ·δ⟦u⟧_τ during the step; ≥ 0 up to the solver's tolerance.
    pub friction: f64,
}

/// What a step took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Work of Newton's method.
    pub newton: NewtonReport,
    /// Largest violation of a contact law (Pa).
    pub violation: f64,
    /// Largest change of a jump in the last Newton iteration (m).
    pub change: f64,
    /// Terms of the energy balance.
    pub energy: Energy,
    /// Wall time of its parts.
    pub times: StepTimes,
}

/// Wall time of the parts of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepTimes {
    /// Right-hand side.
    pub loads: Duration,
    /// Elimination of the bulk from the right-hand side: the first half of a triangular solve.
    pub forward: Duration,
    /// Newton's method on the fracture.
    pub newton: Duration,
    /// Displacements from the jumps: the second half of the triangular solve.
    pub backward: Duration,
    /// Energy terms.
    pub energy: Duration,
}

/// The result of a step.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// The equilibrium was found.
    Converged(State, StepReport),
    /// Newton's method gave up; nothing of it may be used.
    NotConverged(StepReport),
}

/// A change of the jump and of what follows from it, to first order.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Porosity (1): cells.
    pub porosity_change: Vec<f64>,
    /// Aperture (m): fracture faces.
    pub aperture: Vec<f64>,
    /// Jump (m) in the basis of each face: fracture faces × d.
    pub jump: Vec<f64>,
}

/// Work space of solves.
#[derive(Default)]
struct Buffers {
    forward: Forward,
    scratch: Scratch,
}

/// Static contact mechanics of a fractured rock.
pub struct Mechanics {
    mesh: Arc<Mesh>,
    model: Model,
    system: System,
    faces: Vec<Face>,
    /// The S of the present factorisation; empty for none.
    stiffness_response: Vec<f64>,
    buffers: Buffers,
}

impl Mechanics {
    /// Checks the model against the mesh, assembles and factorises.
    ///
    /// # Errors
    /// [`MechanicsError::Model`] with all that is wrong with the model; [`MechanicsError::Linear`] if the stiffness cannot
    /// be factorised.
    pub fn new(mesh: Arc<Mesh>, model: Model) -> Result<Self, MechanicsError> {
        Self::watched(mesh, model, &mut |_| {})
    }

    /// As [`new`](Self::new); `ended` is told when each stage has.
    ///
    /// # Errors
    /// As there.
    pub fn watched(mesh: Arc<Mesh>, model: Model, ended: &mut dyn FnMut(Stage)) -> Result<Self, MechanicsError> {
        let mut problems = model.problems(&mesh);
        let network = mesh.network();
        let geometry = mesh.geometry();
        let mut apertures = Vec::new();
        for (&face, &fracture) in network.faces.iter().zip(&network.fracture) {
            let name = &mesh.data().fractures[fracture];
            let Some(law) = model.fractures.get(name) else { continue };
            let p = geometry.face_center[face];
            let value = (law.contact_aperture)(p, 0.0);
            if !(value > 0.0 && value.is_finite()) {
                let what = format!("the contact aperture of fracture \"{name}\"");
                let (x, y, z) = (p.x, p.y, p.z);
                problems.push(ModelProblem::Function { what, x, y, z, time: 0.0, value, allowed: "finite and > 0 m" });
            }
            apertures.push((law, value));
        }
        if !problems.is_empty() {
            return Err(MechanicsError::Model(problems));
        }
        let system = System::new(&mesh, &model, ended)?;
        let d = mesh.dim();
        let faces = (apertures.iter().zip(&network.faces).enumerate())
            .map(|(i, (&(law, aperture), &face))| {
                let measure = geometry.face_measure[face];
                let local = (0..d).map(|c| f64::from(system.schur.get(i * d + c, i * d + c))).sum::<f64>() / d as f64;
                Face::new(law, measure, local / measure, model.newton.beta_factor, aperture)
            })
            .collect();
        Ok(Self { mesh, model, system, faces, stiffness_response: Vec::new(), buffers: Buffers::default() })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    /// The unknowns.
    pub fn space(&self) -> &Space {
        &self.system.space
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Number of factorisations of the bulk so far: one, and one more for each change of the partner's matrix stiffness.
    pub fn factorisations(&self) -> usize {
        self.system.work.factorisations
    }

    /// Work done since the mechanics were made.
    pub fn work(&self) -> Work {
        self.system.work
    }

    /// What the set-up took and made.
    pub fn setup(&self) -> &SetupReport {
        &self.system.setup
    }

    /// The body at rest: no displacement, no traction, all fractures in contact.
    pub fn rest(&self, time: f64) -> State {
        let jumps = self.faces.len() * self.mesh.dim();
        State {
            time,
            unknowns: vec![0.0; self.mesh.dim() * self.system.space.entity_count()],
            multiplier: vec![0.0; jumps],
            contact: vec![ContactState::Stick; self.faces.len()],
            initial_divergence: vec![0.0; self.mesh.cell_count()],
            initial_jump: vec![0.0; jumps],
            history: History {
                previous_jump: vec![0.0; jumps],
                time_step: 0.0,
                partners: vec![FacePartner::default(); self.faces.len()],
            },
        }
    }

    /// Declares a state the initial one, from which porosity changes and the slip of dilation count.
    pub fn make_initial(&self, state: &mut State) {
        state.initial_jump = state.jump(&self.system.space).to_vec();
        state.initial_divergence = self.divergence(state);
    }

    /// The equilibrium at `time` (s), after `previous`. The result depends on nothing else, to the last bit.
    ///
    /// # Errors
    /// Arrays of the wrong length, as in a state of another mesh, values that are not finite, boundary functions that give such,
    /// a singular contact problem.
    pub fn step(&mut self, previous: &State, time: f64, partner: &Partner) -> Result<Outcome, MechanicsError> {
        if !time.is_finite() {
            return Err(MechanicsError::Value { field: "time", index: 0, value: time, allowed: "finite" });
        }
        self.check_state(previous)?;
        self.check_partner(partner)?;
        let stiffness = partner.response.as_ref().map_or(&[][..], |r| &r.matrix_pressure_stiffness);
        self.follow(stiffness)?;
        let mut times = StepTimes::default();
        let mut clock = Instant::now();
        let mut lap = |part: &mut Duration| {
            *part = clock.elapsed();
            clock = Instant::now();
        };
        let loads = self.loads(time)?;
        let mut rhs = loads.clone();
        self.add_pressures(partner, previous, &mut rhs)?;

        let mut unknowns = vec![0.0; rhs.len()];
        for (f, value) in self.system.fixed.iter().zip(self.prescribed(time)?) {
            unknowns[f.unknown] = value;
        }
        let fixed: Vec<f64> = self.system.fixed.iter().map(|f| unknowns[f.unknown]).collect();
        let mut full = rhs.clone();
        self.system.fixed_rows.mul_transpose_add(-1.0, &fixed, &mut full)?;
        let b: Vec<f64> = self.system.free.iter().map(|&u| full[u as usize]).collect();
        lap(&mut times.loads);
        self.system.cholesky.forward(&b, &mut self.buffers.forward, &mut self.buffers.scratch)?;
        lap(&mut times.forward);

        let partners = self.face_partners(partner);
        let previous_jump = previous.jump(&self.system.space);
        let add_product = |x: &[f64], y: &mut [f64]| self.system.add_schur_product(x, y);
        let problem = self.fracture_problem(&add_product);
        let data = FractureData {
            rhs: self.buffers.forward.condensed(),
            largest_force: b.iter().fold(0.0, |m, f| f.abs().max(m)),
            previous: previous_jump,
            origin: &previous.initial_jump,
            partners: &partners,
            guess: previous.history.extrapolate(previous_jump, time - previous.time),
        };
        let solution = on_the_pool(|| problem.solve(&data)).map_err(singular)?;
        let mut report = StepReport {
            newton: solution.report,
            violation: solution.violation,
            change: solution.change,
            energy: Energy::default(),
            times,
        };
        lap(&mut report.times.newton);
        self.system.work.newton += report.times.newton;
        if !solution.converged {
            return Ok(Outcome::NotConverged(report));
        }
        let mut x = vec![0.0; b.len()];
        self.system.cholesky.backward(&self.buffers.forward, &solution.jump, &mut x, &mut self.buffers.scratch)?;
        for (&u, x) in self.system.free.iter().zip(x) {
            unknowns[u as usize] = x;
        }
        lap(&mut report.times.backward);
        self.system.work.solving += report.times.forward + report.times.backward;
        self.system.work.solves += 1;
        let state = State {
            time,
            unknowns,
            multiplier: solution.lambda,
            contact: solution.states,
            initial_divergence: previous.initial_divergence.clone(),
            initial_jump: previous.initial_jump.clone(),
            history: History { previous_jump: previous_jump.to_vec(), time_step: time - previous.time, partners },
        };
        report.energy = self.energy(previous, &state, &loads, &rhs)?;
        lap(&mut report.times.energy);
        Ok(Outcome::Converged(state, report))
    }

    fn fracture_problem<'a>(&'a self, add_product: &'a (dyn Fn(&[f64], &mut [f64]) + Sync)) -> FractureProblem<'a, 'a> {
        FractureProblem {
            dim: self.mesh.dim(),
            schur: Schur { single: &self.system.schur, inverse: self.system.inverse.as_ref(), add_product },
            faces: &self.faces,
            settings: self.model.newton,
        }
    }

    fn check_partner(&self, partner: &Partner) -> Result<(), MechanicsError> {
        let (cells, faces) = (self.mesh.cell_count(), self.faces.len());
        let check = |field, values: &[f64], expected, not_negative: bool| {
            if values.len() != expected {
                return Err(MechanicsError::Length { field, found: values.len(), expected });
            }
            let ok = |v: f64| v.is_finite() && (!not_negative || v >= 0.0);
            match values.iter().position(|&v| !ok(v)) {
                Some(index) => {
                    let allowed = if not_negative { "finite and ≥ 0" } else { "finite" };
                    Err(MechanicsError::Value { field, index, value: values[index], allowed })
                }
                None => Ok(()),
            }
        };
        check("matrix pressure", &partner.matrix_pressure, cells, false)?;
        check("fracture pressure", &partner.fracture_pressure, faces, false)?;
        if let Some(r) = &partner.response {
            check("matrix pressure stiffness", &r.matrix_pressure_stiffness, cells, true)?;
            check("porosity change reference", &r.porosity_change, cells, false)?;
            check("fracture pressure stiffness", &r.fracture_pressure_stiffness, faces, true)?;
            check("aperture reference", &r.aperture, faces, false)?;
        }
        Ok(())
    }

    /// Makes the factorisation that of a matrix stiffness of the partner (Pa, cells; empty for 0), as
    /// [`response`](Self::response) and [`aperture_compliance`](Self::aperture_compliance) need it at a state that was
    /// found with it, if other time steps have been made since.
    ///
    /// # Errors
    /// [`MechanicsError::Length`]; a singular system.
    pub fn follow(&mut self, matrix_stiffness: &[f64]) -> Result<(), MechanicsError> {
        let (found, expected) = (matrix_stiffness.len(), self.mesh.cell_count());
        if found != 0 && found != expected {
            return Err(MechanicsError::Length { field: "matrix pressure stiffness", found, expected });
        }
        let wanted = if matrix_stiffness.iter().any(|&s| s != 0.0) { matrix_stiffness } else { &[] };
        if self.stiffness_response != wanted {
            let extra: Vec<f64> = (0..self.mesh.cell_count())
                .map(|k| wanted.get(k).map_or(0.0, |s| s * self.material(k).biot.powi(2)))
                .collect();
            self.stiffness_response = wanted.to_vec();
            self.system.refactorise(&self.mesh, &extra)?;
        }
        Ok(())
    }

    /// The matrix stiffness of the partner (Pa, cells) that the factorisation is made for; empty for 0.
    pub fn matrix_stiffness(&self) -> &[f64] {
        &self.stiffness_response
    }

    fn face_partners(&self, partner: &Partner) -> Vec<FacePartner> {
        match &partner.response {
            None => vec![FacePartner::default(); self.faces.len()],
            Some(r) => (r.fracture_pressure_stiffness.iter().zip(&r.aperture))
                .map(|(&stiffness, &aperture)| FacePartner { offset: stiffness * aperture, stiffness })
                .collect(),
        }
    }

    /// Tractions and body forces at a time, over all unknowns (N).
    fn loads(&self, time: f64) -> Result<Vec<f64>, MechanicsError> {
        let d = self.mesh.dim();
        let geometry = self.mesh.geometry();
        let mut f = vec![0.0; d * self.system.space.entity_count()];
        let finite = |what: &str, p: Vec3, value: Vec3| {
            if value.is_finite() {
                return Ok(());
            }
            let (x, y, z) = (p.x, p.y, p.z);
            let value = value.to_array().into_iter().find(|v| !v.is_finite()).unwrap_or(f64::NAN);
            let problem = ModelProblem::Function { what: what.into(), x, y, z, time, value, allowed: "finite" };
            Err(MechanicsError::Model(vec![problem]))
        };
        if let Some(force) = &self.model.body_force {
            for cell in 0..self.mesh.cell_count() {
                let p = geometry.cell_center[cell];
                let value = force(p, time);
                finite("the body force", p, value)?;
                let weights = &geometry.cell_weight[self.mesh.cell_vertex_lists().range(cell)];
                for (&node, w) in self.mesh.nodes().of_cell(cell).iter().zip(weights) {
                    for c in 0..d {
                        f[node * d + c] += geometry.cell_measure[cell] * w * value[c];
                    }
                }
            }
        }
        for condition in &self.model.neumann {
            for face in self.mesh.tagged_faces(&condition.tag) {
                let p = geometry.face_center[face];
                let value = (condition.traction)(p, time);
                finite(&format!("the traction on \"{}\"", condition.tag), p, value)?;
                let weights = &geometry.face_weight[self.mesh.data().faces.range(face)];
                for (node, w) in boundary_nodes(&self.mesh, face).zip(weights) {
                    for c in 0..d {
                        f[node * d + c] += geometry.face_measure[face] * w * value[c];
                    }
                }
            }
        }
        Ok(f)
    }

    fn prescribed(&self, time: f64) -> Result<Vec<f64>, MechanicsError> {
        (self.system.fixed.iter())
            .map(|f| {
                let value = (f.value)(&f.point, time);
                if value.is_finite() {
                    return Ok(value);
                }
                let what = format!("the displacement on {}", f.place);
                let Vec3 { x, y, z } = f.point.at;
                let problem = ModelProblem::Function { what, x, y, z, time, value, allowed: "finite" };
                Err(MechanicsError::Model(vec![problem]))
            })
            .collect()
    }

    /// Adds the pressures' part to a right-hand side; where they follow the deformation, the part that does not depend
    /// on it.
    fn add_pressures(&self, partner: &Partner, state: &State, rhs: &mut [f64]) -> Result<(), MechanicsError> {
        let measures = &self.mesh.geometry().cell_measure;
        let mut weighted: Vec<f64> = partner.matrix_pressure.clone();
        if let Some(r) = &partner.response {
            for (k, p) in weighted.iter_mut().enumerate() {
                let initial = self.material(k).biot * state.initial_divergence[k];
                *p += r.matrix_pressure_stiffness[k] * (r.porosity_change[k] + initial);
            }
        }
        for (k, p) in weighted.iter_mut().enumerate() {
            *p *= measures[k] * self.material(k).biot;
        }
        self.system.divergence.mul_transpose_add(1.0, &weighted, rhs)?;
        let partners = self.face_partners(partner);
        for (i, face) in self.faces.iter().enumerate() {
            rhs[self.normal_jump(i)] -= face.measure * (partner.fracture_pressure[i] + partners[i].offset);
        }
        Ok(())
    }

    fn normal_jump(&self, face: usize) -> usize {
        (self.system.space.first_jump() + face) * self.mesh.dim()
    }

    /// div_K u (1) of each cell.
    pub fn divergence(&self, state: &State) -> Vec<f64> {
        let mut div = vec![0.0; self.mesh.cell_count()];
        // The lengths agree by construction of the state.
        let _ = self.system.divergence.mul_add(1.0, &state.unknowns, &mut div);
        div
    }

    /// Porosity change b (div u − div u at the initial state) (1) of each cell.
    pub fn porosity_change(&self, state: &State) -> Vec<f64> {
        let mut div = self.divergence(state);
        for (k, v) in div.iter_mut().enumerate() {
            *v = self.material(k).biot * (*v - state.initial_divergence[k]);
        }
        div
    }

    fn local(&self, v: &[f64], face: usize) -> Local {
        let d = self.mesh.dim();
        let mut out = [0.0; 3];
        out[..d].copy_from_slice(&v[face * d..][..d]);
        out
    }

    /// Aperture d_f = d_c − ⟦u⟧_n + tan ψ |⟦u − u⁰⟧_τ| (m) of each fracture face.
    pub fn aperture(&self, state: &State) -> Vec<f64> {
        let jump = state.jump(&self.system.space);
        (0..self.faces.len())
            .map(|i| self.faces[i].aperture(&self.local(jump, i), &self.local(&state.initial_jump, i)))
            .collect()
    }

    /// |λ_τ|/bound of each fracture face; 0 where open, 1 where slipping.
    pub fn slip_tendency(&self, state: &State) -> Vec<f64> {
        (0..self.faces.len())
            .map(|i| {
                let l = self.local(&state.multiplier, i);
                let (shear, bound) = (l[1].hypot(l[2]), self.faces[i].bound(l[0]));
                // By the state: where the bound vanishes, both are round-off.
                match state.contact[i] {
                    ContactState::Open => 0.0,
                    ContactState::Slip => 1.0,
                    ContactState::Stick if shear == 0.0 => 0.0,
                    ContactState::Stick => shear / bound,
                }
            })
            .collect()
    }

    fn material(&self, cell: usize) -> &CellMaterial {
        &self.system.materials[self.mesh.data().cell_region[cell]]
    }

    /// Shear modulus μ (Pa) on the plus side of each fracture face.
    pub fn fracture_rigidity(&self) -> Vec<f64> {
        let plus = |&face: &usize| self.material(self.mesh.face_cells(face).0).mu;
        self.mesh.network().faces.iter().map(plus).collect()
    }

    /// The state that was saved; what follows it has the same bits.
    ///
    /// # Errors
    /// [`MechanicsError::Length`] if it is that of another mesh.
    pub fn load(&self, saved: SavedState) -> Result<State, MechanicsError> {
        let state = State {
            time: saved.time,
            unknowns: saved.unknowns,
            multiplier: saved.multiplier,
            contact: saved.contact,
            initial_divergence: saved.initial_divergence,
            initial_jump: saved.initial_jump,
            history: saved.history,
        };
        self.check_state(&state)?;
        Ok(state)
    }

    /// Whether a state has the lengths of this mesh.
    fn check_state(&self, state: &State) -> Result<(), MechanicsError> {
        let (d, faces) = (self.mesh.dim(), self.faces.len());
        for (field, found, expected) in [
            ("displacement", state.unknowns.len(), d * self.system.space.entity_count()),
            ("multiplier", state.multiplier.len(), d * faces),
            ("contact state", state.contact.len(), faces),
            ("initial divergence", state.initial_divergence.len(), self.mesh.cell_count()),
            ("initial jump", state.initial_jump.len(), d * faces),
            ("previous jump", state.history.previous_jump.len(), d * faces),
            ("partner of a fracture face", state.history.partners.len(), faces),
        ] {
            if found != expected {
                return Err(MechanicsError::Length { field, found, expected });
            }
        }
        Ok(())
    }

    /// b²/K_dr of each cell (1/Pa): how the porosity of a free body answers to pressure.
    pub fn porosity_compliance(&self) -> Vec<f64> {
        let of = |k| self.material(k).biot.powi(2) / self.material(k).bulk_modulus;
        (0..self.mesh.cell_count()).map(of).collect()
    }

    /// Floor of the aperture compliance (m/Pa): L_f/E′, L_f the extent of the face's fracture.
    pub fn aperture_compliance_scale(&self) -> Vec<f64> {
        let network = self.mesh.network();
        let names = &self.mesh.data().fractures;
        let mut bounds = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); names.len()];
        for (&face, &fracture) in network.faces.iter().zip(&network.fracture) {
            for &v in self.mesh.face_vertices(face) {
                let (low, high) = &mut bounds[fracture];
                *low = low.min(self.mesh.vertices()[v]);
                *high = high.max(self.mesh.vertices()[v]);
            }
        }
        (network.faces.iter().zip(&network.fracture))
            .map(|(&face, &fracture)| {
                let (low, high) = bounds[fracture];
                let cell = self.mesh.face_cells(face).0;
                low.distance(high) / self.material(cell).plane_strain_modulus
            })
            .collect()
    }

    /// How jump, aperture and porosity at a state answer to a change of the pressures (Pa; matrix: cells, fracture: fracture
    /// faces), at fixed contact states: the product of the Jacobian with this change, by one linearised solve. Where the
    /// partner's pressures followed the deformation in the step to this state, they follow here, and the changes are those of
    /// p_m* and p_f*.
    ///
    /// # Errors
    /// Arrays of the wrong length; a singular contact problem.
    pub fn response(
        &mut self,
        state: &State,
        matrix_pressure: &[f64],
        fracture_pressure: &[f64],
    ) -> Result<Response, MechanicsError> {
        let change = Partner {
            matrix_pressure: matrix_pressure.to_vec(),
            fracture_pressure: fracture_pressure.to_vec(),
            response: None,
        };
        self.check_state(state)?;
        self.check_partner(&change)?;
        let mut full = vec![0.0; state.unknowns.len()];
        self.add_pressures(&change, state, &mut full)?;
        let b: Vec<f64> = self.system.free.iter().map(|&u| full[u as usize]).collect();
        let clock = Instant::now();
        self.system.cholesky.forward(&b, &mut self.buffers.forward, &mut self.buffers.scratch)?;
        let forward = clock.elapsed();
        let jump = self.jump_response(state, self.buffers.forward.condensed())?;
        let both = clock.elapsed();
        let mut x = vec![0.0; b.len()];
        self.system.cholesky.backward(&self.buffers.forward, &jump, &mut x, &mut self.buffers.scratch)?;
        self.system.work.newton += both - forward;
        self.system.work.solving += forward + (clock.elapsed() - both);
        self.system.work.solves += 1;
        full.fill(0.0);
        for (&u, x) in self.system.free.iter().zip(x) {
            full[u as usize] = x;
        }
        let mut porosity_change = vec![0.0; self.mesh.cell_count()];
        self.system.divergence.mul_add(1.0, &full, &mut porosity_change)?;
        porosity_change.iter_mut().enumerate().for_each(|(k, p)| *p *= self.material(k).biot);
        Ok(Response { porosity_change, aperture: self.aperture_response(state, &jump), jump })
    }

    /// ∂d_f/∂p_f (m/Pa) of each face as a uniform change of fracture pressure shows it, at fixed contact states: a solve
    /// on the fracture only. Closed rigid faces give 0; negative values are possible.
    ///
    /// # Errors
    /// A state of another mesh; a singular contact problem.
    pub fn aperture_compliance(&self, state: &State) -> Result<Vec<f64>, MechanicsError> {
        self.check_state(state)?;
        let d = self.mesh.dim();
        let mut change = vec![0.0; self.faces.len() * d];
        for (i, face) in self.faces.iter().enumerate() {
            change[i * d] = -face.measure;
        }
        let jump = self.jump_response(state, &change)?;
        Ok(self.aperture_response(state, &jump))
    }

    fn aperture_response(&self, state: &State, change: &[f64]) -> Vec<f64> {
        let jump = state.jump(&self.system.space);
        (0..self.faces.len())
            .map(|i| {
                let (jump, origin) = (self.local(jump, i), self.local(&state.initial_jump, i));
                let gradient = self.faces[i].aperture_gradient(&jump, &origin, [0.0; 2]);
                gradient.iter().zip(self.local(change, i)).map(|(g, c)| g * c).sum()
            })
            .collect()
    }

    /// The change of the jump for a change of the condensed right-hand side.
    fn jump_response(&self, state: &State, change: &[f64]) -> Result<Vec<f64>, MechanicsError> {
        let add_product = |x: &[f64], y: &mut [f64]| self.system.add_schur_product(x, y);
        let problem = self.fracture_problem(&add_product);
        let data = FractureData {
            rhs: change,
            largest_force: 0.0,
            previous: &state.history.previous_jump,
            origin: &state.initial_jump,
            partners: &state.history.partners,
            guess: None,
        };
        let jump = state.jump(&self.system.space);
        on_the_pool(|| problem.response(&data, jump, &state.multiplier, &state.contact, change)).map_err(singular)
    }

    /// Stress σ(u) − b p_m I (Pa) of each cell as (xx, yy, zz, xy, yz, xz), for pressures p_m (Pa) of the cells; tension is
    /// positive, and 2D is plane strain.
    ///
    /// # Errors
    /// A pressure field of the wrong length.
    pub fn stress(&self, state: &State, matrix_pressure: &[f64]) -> Result<Vec<[f64; 6]>, MechanicsError> {
        let expected = self.mesh.cell_count();
        if matrix_pressure.len() != expected {
            return Err(MechanicsError::Length { field: "matrix pressure", found: matrix_pressure.len(), expected });
        }
        let gradients = self.displacement_gradient(state);
        Ok((gradients.iter().zip(matrix_pressure).enumerate())
            .map(|(k, (g, p))| {
                let m = self.material(k);
                let isotropic = m.lambda * (g[0][0] + g[1][1] + g[2][2]) - m.biot * p;
                let normal = |i: usize| 2.0 * m.mu * g[i][i] + isotropic;
                let shear = |i: usize, j: usize| m.mu * (g[i][j] + g[j][i]);
                [normal(0), normal(1), normal(2), shear(0, 1), shear(1, 2), shear(0, 2)]
            })
            .collect())
    }

    /// ∇^K u (1) of each cell, row i being the gradient of component i; zero in z in 2D.
    pub fn displacement_gradient(&self, state: &State) -> Vec<[Vec3; 3]> {
        let d = self.mesh.dim();
        let space = &self.system.space;
        (0..self.mesh.cell_count())
            .into_par_iter()
            .map(|cell| {
                let operators = space.operators(&self.mesh, cell);
                let mut gradient = [Vec3::ZERO; 3];
                let values = self.function_values(state, cell);
                for (g, v) in operators.gradient.iter().zip(values.chunks_exact(d)) {
                    for c in 0..d {
                        gradient[c] += v[c] * *g;
                    }
                }
                gradient
            })
            .collect()
    }

    /// Mean displacement Π^K u(x_K) = Σ_s ω_s^K u_Ks (m) of each cell.
    pub fn cell_displacement(&self, state: &State) -> Vec<Vec3> {
        let d = self.mesh.dim();
        let weights = &self.mesh.geometry().cell_weight;
        (0..self.mesh.cell_count())
            .map(|cell| {
                let mut mean = [0.0; 3];
                let range = self.mesh.cell_vertex_lists().range(cell);
                for (&node, w) in self.mesh.nodes().of_cell(cell).iter().zip(&weights[range]) {
                    for c in 0..d {
                        mean[c] += w * state.unknowns[node * d + c];
                    }
                }
                Vec3::from_array(mean)
            })
            .collect()
    }

    /// The values of a cell's functions, nodes and then bubbles (m): functions × d.
    fn function_values(&self, state: &State, cell: usize) -> Vec<f64> {
        let d = self.mesh.dim();
        let unknowns = self.system.space.unknowns(&self.mesh, cell);
        let own: Vec<f64> =
            (unknowns.entities.iter()).flat_map(|&e| state.unknowns[e as usize * d..][..d].iter().copied()).collect();
        match &unknowns.bubbles {
            None => own,
            Some(p) => p.chunks_exact(own.len()).map(|row| row.iter().zip(&own).map(|(p, v)| p * v).sum()).collect(),
        }
    }

    /// The terms of the energy balance of a step. `loads` are the forces without, `rhs` with the pressures' given part.
    fn energy(&self, previous: &State, state: &State, loads: &[f64], rhs: &[f64]) -> Result<Energy, MechanicsError> {
        let d = self.mesh.dim();
        // The pressures' actual forces: those given, less what follows the deformation.
        let mut pressure: Vec<f64> = rhs.iter().zip(loads).map(|(r, l)| r - l).collect();
        if !self.stiffness_response.is_empty() {
            let div = self.divergence(state);
            let weighted: Vec<f64> = (0..div.len())
                .map(|k| {
                    let biot = self.material(k).biot;
                    self.mesh.geometry().cell_measure[k] * biot * biot * self.stiffness_response[k] * div[k]
                })
                .collect();
            self.system.divergence.mul_transpose_add(-1.0, &weighted, &mut pressure)?;
        }
        for (i, aperture) in self.aperture(state).iter().enumerate() {
            let follows = state.history.partners[i].stiffness * aperture;
            pressure[self.normal_jump(i)] += self.faces[i].measure * follows;
        }
        // Where an unknown is free, A ũ = f − |σ| λ: no product with A is needed.
        let mut forces: Vec<f64> = loads.iter().zip(&pressure).map(|(l, p)| l + p).collect();
        let mut reactions = vec![0.0; self.system.fixed.len()];
        self.system.fixed_rows.mul_add(1.0, &state.unknowns, &mut reactions)?;
        let mut external = loads.to_vec();
        for (f, reaction) in self.system.fixed.iter().zip(reactions) {
            // The rows of A hold the stiffness that makes pressures follow; `rhs` has what balances it.
            let force = reaction - rhs[f.unknown];
            forces[f.unknown] += force;
            external[f.unknown] += force;
        }
        let first = self.system.space.first_jump() * d;
        let (mut friction, mut springs) = (0.0, 0.0);
        for (i, face) in self.faces.iter().enumerate() {
            for c in 0..d {
                let at = i * d + c;
                let force = face.measure * state.multiplier[at];
                forces[first + at] -= force;
                if c == 0 {
                    springs += 0.5 * force * state.multiplier[at] * face.compliance;
                } else {
                    friction += force * (state.unknowns[first + at] - previous.unknowns[first + at]);
                }
            }
        }
        let change = |f: &[f64]| -> f64 {
            (f.iter().zip(&state.unknowns).zip(&previous.unknowns)).map(|((f, u), v)| f * (u - v)).sum()
        };
        Ok(Energy {
            elastic: 0.5 * forces.iter().zip(&state.unknowns).map(|(f, u)| f * u).sum::<f64>() + springs,
            external_work: change(&external),
            pressure_work: change(&pressure),
            friction,
        })
    }
}

/// Many short products, each of which would else be handed over to a thread of the pool and back.
fn on_the_pool<R: Send>(f: impl FnOnce() -> R + Send) -> R {
    rayon::join(f, || ()).0
}

fn singular(SingularFracture(states): SingularFracture) -> MechanicsError {
    let count = |wanted| states.iter().filter(|&&s| s == wanted).count();
    MechanicsError::Singular { open: count(ContactState::Open), slipping: count(ContactState::Slip) }
}

impl State {
    /// Jump ⟦u⟧ (m) in the basis (n⁺, t₁[, t₂]) of each face: fracture faces × d.
    pub fn jump(&self, space: &Space) -> &[f64] {
        &self.unknowns[space.first_jump() * space.dim()..]
    }

    /// The state in a form that can be written.
    pub fn to_saved(&self) -> SavedState {
        SavedState {
            time: self.time,
            unknowns: self.unknowns.clone(),
            multiplier: self.multiplier.clone(),
            contact: self.contact.clone(),
            initial_divergence: self.initial_divergence.clone(),
            initial_jump: self.initial_jump.clone(),
            history: self.history.clone(),
        }
    }

    /// Number of faces in a contact state.
    pub fn count(&self, wanted: ContactState) -> usize {
        self.contact.iter().filter(|&&s| s == wanted).count()
    }
}
