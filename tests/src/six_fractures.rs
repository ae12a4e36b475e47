//! C3: six fractures in 2D (Berge, Berre, Keilegavlen, Nordbotten, Wohlmuth 2020), coupled by fixed stress straight from
//! the two libraries.

use std::sync::Arc;

use flow_fmu::{Boundary, Flow, FlowModel, Fluid, Fracture, Inputs, Rock};
use mechanics_fmu::{
    BoundaryPoint, Dirichlet, FractureLaw, Material, Mechanics, Model, Outcome, Partner, Place, State, StepReport,
};
use mesh::generate::Triangles;
use mesh::{Mesh, Vec3};

/// Name, corners (m), and tips that lie inside the rock.
pub const FRACTURES: [(&str, &[[f64; 2]]); 6] = [
    ("1", &[[0.2, 0.7], [0.5, 0.7], [0.8, 0.65]]),
    ("2", &[[1.0, 0.3], [1.8, 0.4]]),
    ("3", &[[0.2, 0.3], [0.6, 0.25]]),
    ("4", &[[1.0, 0.4], [1.7, 0.85]]),
    ("5", &[[1.5, 0.65], [2.0, 0.55]]),
    ("6", &[[1.5, 0.05], [1.4, 0.25]]),
];
/// Largest distance of a point of each fracture from its tips (m).
const REACH: [f64; 6] = [0.300, 0.403_113, 0.201_556, 0.416_083, 0.509_902, 0.111_803];
/// End of the case (s).
pub const END: f64 = 2000.0;
/// Pressure at the start (Pa).
pub const INITIAL_PRESSURE: f64 = 1e5;

/// d_c = 1e-4 √(arctan(a D)/arctan(a ℓ)) m, D the distance to the tips of the fracture, a = 25 1/m.
pub fn contact_aperture(fracture: usize, x: Vec3) -> f64 {
    let points = FRACTURES[fracture].1;
    let at = |p: [f64; 2]| Vec3::new(p[0], p[1], 0.0);
    // The end of fracture 5 on the boundary is no tip.
    let last = if fracture == 4 { f64::INFINITY } else { x.distance(at(points[points.len() - 1])) };
    let distance = x.distance(at(points[0])).min(last);
    1e-4 * ((25.0 * distance).atan() / (25.0 * REACH[fracture]).atan()).sqrt()
}

/// Triangles with fracture faces of length `size` (m).
///
/// # Panics
/// If the mesh cannot be made.
pub fn triangles(size: f64) -> Mesh {
    let mut triangles = Triangles::rectangle([0.0, 0.0], [2.0, 1.0], 2.0 * size);
    for (name, points) in FRACTURES {
        triangles = triangles.fracture(name, points, size);
    }
    let data = triangles.build().unwrap_or_else(|e| panic!("{e}"));
    Mesh::new(data).unwrap_or_else(|e| panic!("{e}"))
}

/// The mechanical model.
pub fn mechanics_model() -> Model {
    let mut model = Model::default();
    model.materials.insert("rock".into(), Material { young_modulus: 10e9, poisson_ratio: 0.2, biot_coefficient: 0.5 });
    for (i, (name, _)) in FRACTURES.iter().enumerate() {
        let law = FractureLaw {
            contact_aperture: Arc::new(move |x, _| contact_aperture(i, x)),
            ..FractureLaw::coulomb(0.5, 1e-4)
        };
        model.fractures.insert((*name).into(), law);
    }
    for (component, top) in [5e-3, -2e-3].into_iter().enumerate() {
        model.dirichlet.push(Dirichlet::zero("bottom", component));
        let value = move |_: &BoundaryPoint, t: f64| top * (4.0 * t / END).min(1.0);
        model.dirichlet.push(Dirichlet { place: Place::Tag("top".into()), component, value: Arc::new(value) });
    }
    model
}

/// The flow model.
pub fn flow_model() -> FlowModel {
    let mut model = FlowModel::new(Fluid::default());
    let mut rock = Rock::isotropic(1e-15, 0.0, Some(10e9));
    rock.permeability.y_axis.y = 0.5e-15;
    model.rocks.push(("rock".into(), rock));
    for (i, (name, _)) in FRACTURES.iter().enumerate() {
        let aperture = flow_fmu::SpaceTimeFunction::new(move |x, _| contact_aperture(i, x));
        model.fractures.push(((*name).into(), Fracture { normal_permeability: 1e-15, aperture }));
    }
    model.boundaries.push(("left".into(), Boundary::pressure(INITIAL_PRESSURE)));
    model.initial_pressure = INITIAL_PRESSURE.into();
    model
}

/// Means over the domain after a time step, and what the step took.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Time (s).
    pub time: f64,
    /// Mean d_f (m), p_f and p_m (Pa).
    pub means: [f64; 3],
    /// Coupling iterations.
    pub iterations: usize,
    /// Newton iterations, over all coupling iterations.
    pub newton: usize,
    /// Mechanical step of the last coupling iteration.
    pub mechanics: StepReport,
    /// Faces that are open, stick, slip.
    pub states: [usize; 3],
}

/// Both units and where they are.
pub struct Coupled {
    /// Mechanics.
    pub mechanics: Mechanics,
    /// Flow.
    pub flow: Flow,
    /// The mechanical state.
    pub state: State,
}

impl Coupled {
    /// Sets both units up on a mesh, in equilibrium at the initial pressure: the apertures that the flow starts from include
    /// what this pressure opens.
    ///
    /// # Panics
    /// If a model is refused, or there is no equilibrium.
    pub fn new(mesh: Mesh) -> Self {
        let mesh = Arc::new(mesh);
        let mut mechanics = Mechanics::new(Arc::clone(&mesh), mechanics_model()).unwrap_or_else(|e| panic!("{e}"));
        let initial = mechanics.initial_equilibrium(0.0, &Partner::uniform(&mesh, INITIAL_PRESSURE));
        let Ok(Outcome::Converged(state, _)) = initial else { panic!("no equilibrium at the initial pressure") };
        let mut flow = Flow::new(mesh, flow_model()).unwrap_or_else(|e| panic!("{e}"));
        let aperture = mechanics.aperture(&state);
        flow.set_state(flow_fmu::FlowState { aperture, ..flow.state().clone() }).unwrap_or_else(|e| panic!("{e}"));
        Self { mechanics, flow, state }
    }

    /// One time step of `dt` (s) by fixed stress with the probed aperture compliance, at least `floor` (a factor on
    /// L_f/E′).
    ///
    /// # Panics
    /// If a unit fails, or 100 coupling iterations do not do.
    pub fn step(&mut self, dt: f64, floor: f64) -> Record {
        let (start, start_flow) = (self.state.clone(), self.flow.state().clone());
        let time = start.time + dt;
        let mut matrix_pressure = start_flow.matrix_pressure.clone();
        let mut fracture_pressure = self.flow.fracture_pressure().to_vec();
        let mut porosity = self.mechanics.porosity_change(&start);
        let mut aperture = self.mechanics.aperture(&start);
        let scale = self.mechanics.aperture_compliance_scale();
        let mut newton = 0;
        for iterations in 1..=100 {
            self.flow.set_state(start_flow.clone()).unwrap_or_else(|e| panic!("{e}"));
            // At the latest contact states: what is open at the start may be closed at the end.
            let probed = self.mechanics.aperture_compliance(&self.state).unwrap_or_else(|e| panic!("{e}"));
            let inputs = Inputs {
                porosity_change: porosity.clone(),
                aperture: aperture.clone(),
                porosity_compliance: self.mechanics.porosity_compliance(),
                aperture_compliance: probed.iter().zip(&scale).map(|(c, s)| c.max(floor * s)).collect(),
                matrix_pressure_reference: matrix_pressure.clone(),
                fracture_pressure_reference: fracture_pressure.clone(),
                references_follow: false,
                wells: Vec::new(),
            };
            self.flow.step(dt, &inputs).unwrap_or_else(|e| panic!("{e}"));
            let new_matrix = self.flow.state().matrix_pressure.clone();
            let new_fracture = self.flow.fracture_pressure().to_vec();
            let partner = Partner {
                matrix_pressure: new_matrix.clone(),
                fracture_pressure: new_fracture.clone(),
                response: None,
            };
            let Ok(Outcome::Converged(state, report)) = self.mechanics.step(&start, time, &partner) else {
                panic!("the mechanical step to {time} s failed")
            };
            newton += report.newton.iterations;
            let change = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let displacement = change(&state.unknowns, &self.state.unknowns);
            let pressure = change(&new_matrix, &matrix_pressure).max(change(&new_fracture, &fracture_pressure));
            porosity = self.mechanics.porosity_change(&state);
            aperture = self.mechanics.aperture(&state);
            (matrix_pressure, fracture_pressure) = (new_matrix, new_fracture);
            self.state = state;
            // The criterion of the published code.
            if displacement / 1e-2 + pressure / 1e6 <= 1e-5 {
                return self.record(time, iterations, newton, report);
            }
        }
        panic!("100 coupling iterations did not do at {time} s")
    }

    fn record(&self, time: f64, iterations: usize, newton: usize, mechanics: StepReport) -> Record {
        let mesh = self.mechanics.mesh();
        let geometry = mesh.geometry();
        let mean = |values: &[f64], measures: &mut dyn Iterator<Item = f64>| {
            let (sum, size) = (values.iter().zip(measures)).fold((0.0, 0.0), |(s, m), (v, w)| (s + v * w, m + w));
            sum / size
        };
        let faces = || mesh.network().faces.iter().map(|&f| geometry.face_measure[f]);
        use mechanics_fmu::ContactState::{Open, Slip, Stick};
        Record {
            time,
            means: [
                mean(&self.mechanics.aperture(&self.state), &mut faces()),
                mean(self.flow.fracture_pressure(), &mut faces()),
                mean(&self.flow.state().matrix_pressure, &mut geometry.cell_measure.iter().copied()),
            ],
            iterations,
            newton,
            mechanics,
            states: [Open, Stick, Slip].map(|s| self.state.count(s)),
        }
    }
}
