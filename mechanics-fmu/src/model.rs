//! What a mechanical problem consists of, apart from its mesh.

use std::collections::BTreeMap;
use std::sync::Arc;

use mesh::{Mesh, Vec3};

use crate::error::ModelProblem;

/// A scalar function of the position (m) and the time (s).
pub type ScalarFunction = Arc<dyn Fn(Vec3, f64) -> f64 + Send + Sync>;
/// A vector function of the position (m) and the time (s); in 2D its z component is not looked at.
pub type VectorFunction = Arc<dyn Fn(Vec3, f64) -> Vec3 + Send + Sync>;

/// What undrained pores add to λ (Pa) in a region, for a cell diameter (m).
pub type UndrainedFunction = Arc<dyn Fn(&str, f64) -> f64 + Send + Sync>;

/// A function of a boundary point and the time (s).
pub type BoundaryFunction = Arc<dyn Fn(&BoundaryPoint, f64) -> f64 + Send + Sync>;

/// Where a boundary value is taken. Where a fracture meets the boundary there is a node on each side of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundaryPoint {
    /// The point (m).
    pub at: Vec3,
    /// Centre of a cell around it (m) that tells the sides of a fracture apart.
    pub cell: Vec3,
}

/// Linear elastic, porous rock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Young's modulus E of the drained rock (Pa), > 0.
    pub young_modulus: f64,
    /// Poisson's ratio ν of the drained rock, in (−1, ½).
    pub poisson_ratio: f64,
    /// Biot coefficient b, in [0, 1].
    pub biot_coefficient: f64,
}

impl Material {
    /// From Lamé's parameters λ and μ (Pa).
    pub fn from_lame(lambda: f64, mu: f64, biot_coefficient: f64) -> Self {
        Self {
            young_modulus: mu * (3.0 * lambda + 2.0 * mu) / (lambda + mu),
            poisson_ratio: 0.5 * lambda / (lambda + mu),
            biot_coefficient,
        }
    }

    /// Lamé's first parameter λ (Pa); two dimensions are plane strain.
    pub fn lambda(&self) -> f64 {
        let nu = self.poisson_ratio;
        self.young_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    }

    /// Shear modulus μ (Pa).
    pub fn mu(&self) -> f64 {
        0.5 * self.young_modulus / (1.0 + self.poisson_ratio)
    }

    /// Drained bulk modulus K_dr = λ + 2μ/d (Pa) in `dim` dimensions.
    pub fn bulk_modulus(&self, dim: usize) -> f64 {
        self.lambda() + 2.0 * self.mu() / dim as f64
    }

    /// Plane-strain modulus E′ = E/(1 − ν²) (Pa).
    pub fn plane_strain_modulus(&self) -> f64 {
        self.young_modulus / (1.0 - self.poisson_ratio.powi(2))
    }
}

/// The bound that a fracture sets to the tangential traction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Friction {
    /// |T_τ| = 0.
    None,
    /// |T_τ| ≤ bound.
    Tresca {
        /// The bound (Pa), ≥ 0.
        bound: f64,
    },
    /// |T_τ| ≤ cohesion − F T_n.
    Coulomb {
        /// Friction coefficient F ≥ 0.
        coefficient: f64,
        /// Cohesion (Pa), ≥ 0.
        cohesion: f64,
    },
}

/// How a fracture behaves.
#[derive(Clone)]
pub struct FractureLaw {
    /// The friction law.
    pub friction: Friction,
    /// Dilation angle ψ (rad), in [0, π/2): slip s opens the fracture by D = min(s tan ψ, D_m).
    pub dilation_angle: f64,
    /// What D opens.
    pub dilation: Dilation,
    /// D_m (m), ≥ 0; `None` for no limit. At a given critical slip s_c it is s_c tan ψ.
    pub dilation_limit: Option<f64>,
    /// Normal stiffness k_n > 0 (Pa/m) of the closed fracture at λ_n = 0; `None` where it is rigid.
    pub normal_stiffness: Option<f64>,
    /// Largest closure V_m (m) > 0 of the hyperbola λ_n = k_n V/(1 − V/V_m), less than the contact aperture; `None` where
    /// closure is linear, λ_n = k_n V.
    pub largest_closure: Option<f64>,
    /// Aperture in contact d_c > 0 (m), at the centre of each face; the time is 0.
    pub contact_aperture: ScalarFunction,
    /// Residual aperture d_r (m) that the fluid sees at least, up to the contact aperture; 0 for none, and then a time step
    /// that closes the fracture is discarded. `None`: [`DEFAULT_RESIDUAL`] where closure is linear, and none elsewhere, where
    /// closure never reaches the contact aperture.
    pub residual_aperture: Option<f64>,
}

/// Residual aperture where none is given and a linear closure may exceed the contact aperture, as a part of the latter.
pub const DEFAULT_RESIDUAL: f64 = 0.01;

/// What dilation opens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dilation {
    /// The aperture alone: the fluid gets more room, the rock does not move.
    #[default]
    Hydraulic,
    /// The fracture: its sides move apart, against the rock around it, and the aperture with them.
    Mechanical,
}

impl FractureLaw {
    /// Coulomb friction without cohesion, no dilation, rigid in contact.
    pub fn coulomb(coefficient: f64, contact_aperture: f64) -> Self {
        Self {
            friction: Friction::Coulomb { coefficient, cohesion: 0.0 },
            dilation_angle: 0.0,
            dilation: Dilation::Hydraulic,
            dilation_limit: None,
            normal_stiffness: None,
            largest_closure: None,
            contact_aperture: Arc::new(move |_, _| contact_aperture),
            residual_aperture: None,
        }
    }

    /// The aperture (m) that is kept on a face with this contact aperture (m); `None` for none.
    pub(crate) fn kept_aperture(&self, contact_aperture: f64) -> Option<f64> {
        match self.residual_aperture {
            Some(residual) => (residual > 0.0).then_some(residual),
            None => self.has_default_residual().then_some(DEFAULT_RESIDUAL * contact_aperture),
        }
    }

    /// Whether [`DEFAULT_RESIDUAL`] holds.
    pub(crate) fn has_default_residual(&self) -> bool {
        self.residual_aperture.is_none() && self.normal_stiffness.is_some() && self.largest_closure.is_none()
    }

    /// Calls `check` (holds, parameter, value, allowed) for each parameter.
    fn check(&self, mut check: impl FnMut(bool, &'static str, f64, &'static str)) {
        let not_negative = |v: f64| v >= 0.0 && v.is_finite();
        let positive = |v: f64| v > 0.0 && v.is_finite();
        match self.friction {
            Friction::None => {}
            Friction::Tresca { bound } => check(not_negative(bound), "bound", bound, "finite and ≥ 0 Pa"),
            Friction::Coulomb { coefficient, cohesion } => {
                check(not_negative(coefficient), "friction coefficient", coefficient, "finite and ≥ 0");
                check(not_negative(cohesion), "cohesion", cohesion, "finite and ≥ 0 Pa");
            }
        }
        let angle = self.dilation_angle;
        let right = std::f64::consts::FRAC_PI_2;
        check((0.0..right).contains(&angle), "dilation_angle", angle, "at least 0 and less than π/2");
        if self.dilation == Dilation::Mechanical {
            let coefficient = match self.friction {
                Friction::Coulomb { coefficient, .. } => coefficient,
                Friction::None | Friction::Tresca { .. } => 0.0,
            };
            let allowed =
                "at most the friction angle of Coulomb's law where dilation is mechanical: else slip makes energy";
            let steep = angle.tan() > coefficient;
            check(!steep, "dilation_angle", angle, allowed);
        }
        if let Some(limit) = self.dilation_limit {
            check(not_negative(limit), "dilation_limit", limit, "finite and ≥ 0 m");
        }
        if let Some(k) = self.normal_stiffness {
            check(positive(k), "normal_stiffness", k, "finite and > 0 Pa/m");
        }
        if let Some(largest) = self.largest_closure {
            check(positive(largest), "largest_closure", largest, "finite and > 0 m");
            check(
                self.normal_stiffness.is_some(),
                "largest_closure",
                largest,
                "left out where there is no normal_stiffness",
            );
        }
        if let Some(residual) = self.residual_aperture {
            check(not_negative(residual), "residual_aperture", residual, "finite and ≥ 0 m");
        }
    }

    /// Calls `check` (holds, quantity, value, allowed) for what must hold of the contact aperture (m) of a face.
    pub(crate) fn check_aperture(&self, aperture: f64, mut check: impl FnMut(bool, &'static str, f64, &'static str)) {
        let name = "the contact aperture";
        check(aperture > 0.0 && aperture.is_finite(), name, aperture, "finite and > 0 m");
        if let Some(largest) = self.largest_closure {
            check(largest < aperture, "the largest closure", largest, "less than the contact aperture there");
        }
        if let Some(residual) = self.residual_aperture {
            check(residual <= aperture, "the residual aperture", residual, "at most the contact aperture there");
        }
    }
}

/// Where Dirichlet data hold.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// All nodes on the boundary faces with this tag.
    Tag(String),
    /// The nodes of the vertex nearest to this point (m).
    Point(Vec3),
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tag(tag) => write!(f, "boundary \"{tag}\""),
            Self::Point(p) => write!(f, "the point ({}, {}, {})", p.x, p.y, p.z),
        }
    }
}

/// A prescribed component of the displacement.
#[derive(Clone)]
pub struct Dirichlet {
    /// Where.
    pub place: Place,
    /// Which component, 0 for x.
    pub component: usize,
    /// Its value (m).
    pub value: BoundaryFunction,
}

impl Dirichlet {
    /// A component that is held at zero on the faces with a boundary tag.
    pub fn zero(tag: &str, component: usize) -> Self {
        Self { place: Place::Tag(tag.into()), component, value: Arc::new(|_, _| 0.0) }
    }
}

/// A prescribed traction σ_T n on the outer boundary.
#[derive(Clone)]
pub struct Neumann {
    /// Boundary tag.
    pub tag: String,
    /// The traction (Pa).
    pub traction: VectorFunction,
}

/// On which sides of a fracture face the displacement has a bubble.
///
/// With bubbles on both sides the method does not tell the sides apart. With one, exchanging them makes another
/// discretisation, whose solution agrees to the order of the method; a slip that changes along the fracture, as near tips,
/// then loads its two sides differently, and the normal traction oscillates there from face to face.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bubbles {
    /// On the plus side.
    #[default]
    OneSided,
    /// On both sides.
    TwoSided,
}

/// On which faces the displacement has a normal bubble, with which nothing locks and no pressure oscillates where rock is
/// nearly incompressible or undrained; a bubble takes as much of the factor as an unknown of a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NormalBubbles {
    /// On no face.
    None,
    /// On all inner faces off the fractures.
    All,
    /// On those of cells that need it: of rock that hardly changes its volume, λ_u > [`STIFF`](Self::STIFF) μ, and with a vertex at
    /// which more than d + 1 cells meet. Where no more do, as in Voronoi and dual meshes, there are enough vertices for each
    /// cell to keep its volume.
    #[default]
    Auto,
}

impl NormalBubbles {
    /// λ_u/μ from which on a cell needs normal bubbles: Poisson's ratio, undrained where fluid cannot leave, of 0.45.
    pub const STIFF: f64 = 9.0;
}

/// The weight of the stabilisation of virtual elements (see [`crate::Elasticity`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stabilisation {
    /// Matched to the shear energy of bi- and trilinear functions.
    #[default]
    Matched,
    /// h^{d−2} (2μ+λ), of the published tables: 3 (2D) to 12 (3D) times too stiff.
    Published,
}

/// Settings of the semi-smooth Newton method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewtonSettings {
    /// β > 0 of the complementarity functions, as a part of the stiffness of the bulk against a jump of the face alone; the
    /// iterates hardly depend on it.
    pub beta_factor: f64,
    /// Newton iterations of one attempt. A time step is given up after attempts with other β and, where Tresca's bound or
    /// cohesion end at opening, with these fading.
    pub max_iterations: usize,
    /// The jump may change by at most this part of the largest jump in the last iteration, and contact laws may be
    /// violated by this part of the largest traction.
    pub tolerance: f64,
}

impl Default for NewtonSettings {
    fn default() -> Self {
        Self { beta_factor: 0.01, max_iterations: 60, tolerance: 1e-9 }
    }
}

/// A mechanical problem, apart from its mesh. Names refer to those of the mesh.
#[derive(Clone, Default)]
pub struct Model {
    /// The rock of each region.
    pub materials: BTreeMap<String, Material>,
    /// The law of each fracture.
    pub fractures: BTreeMap<String, FractureLaw>,
    /// Prescribed displacements; where several give the same component of a node, the last holds.
    pub dirichlet: Vec<Dirichlet>,
    /// Prescribed tractions; elsewhere σ_T n = 0. Those on one tag add up.
    pub neumann: Vec<Neumann>,
    /// Body force (N/m³).
    pub body_force: Option<VectorFunction>,
    /// Bubbles on one or both sides.
    pub bubbles: Bubbles,
    /// Normal bubbles off the fractures.
    pub normal_bubbles: NormalBubbles,
    /// What pores that fluid cannot leave within a time step add to λ (Pa): b²M, by region and cell diameter (m).
    pub undrained: Option<UndrainedFunction>,
    /// Weight of the stabilisation.
    pub stabilisation: Stabilisation,
    /// Settings of Newton's method.
    pub newton: NewtonSettings,
}

impl Model {
    /// Everything in the model that is out of range or does not fit the mesh.
    pub(crate) fn problems(&self, mesh: &Mesh) -> Vec<ModelProblem> {
        let mut problems = Vec::new();
        let data = mesh.data();
        for (name, m) in &self.materials {
            let mut check = |ok: bool, parameter, value, allowed| {
                if !ok {
                    problems.push(ModelProblem::Parameter {
                        place: format!("region \"{name}\""),
                        parameter,
                        value,
                        allowed,
                    });
                }
            };
            let Material { young_modulus: e, poisson_ratio: nu, biot_coefficient: b } = *m;
            check(e > 0.0 && e.is_finite(), "young_modulus", e, "finite and > 0 Pa");
            check(nu > -1.0 && nu < 0.5, "poisson_ratio", nu, "between −1 and 0.5, both excluded");
            check((0.0..=1.0).contains(&b), "biot_coefficient", b, "between 0 and 1");
        }
        for (name, law) in &self.fractures {
            law.check(|ok, parameter, value, allowed| {
                if !ok {
                    let place = format!("fracture \"{name}\"");
                    problems.push(ModelProblem::Parameter { place, parameter, value, allowed });
                }
            });
        }
        let n = &self.newton;
        let mut check = |ok: bool, parameter, value, allowed| {
            if !ok {
                problems.push(ModelProblem::Parameter { place: "newton".into(), parameter, value, allowed });
            }
        };
        check(n.beta_factor > 0.0 && n.beta_factor.is_finite(), "beta_factor", n.beta_factor, "finite and > 0");
        check(n.max_iterations > 0, "max_iterations", n.max_iterations as f64, "at least 1");
        check(n.tolerance > 0.0 && n.tolerance < 1.0, "tolerance", n.tolerance, "between 0 and 1, both excluded");

        let mut name = |kind, name: &str, fault, names: &[String]| {
            let known = if names.is_empty() { "none".into() } else { names.join(", ") };
            problems.push(ModelProblem::Name { kind, name: name.into(), fault, known });
        };
        for region in data.regions.iter().filter(|r| !self.materials.contains_key(*r)) {
            name("region", region, "has no material", &data.regions);
        }
        for region in self.materials.keys().filter(|r| !data.regions.contains(r)) {
            name("region", region, "has a material, but does not exist", &data.regions);
        }
        for fracture in data.fractures.iter().filter(|f| !self.fractures.contains_key(*f)) {
            name("fracture", fracture, "has no law", &data.fractures);
        }
        for fracture in self.fractures.keys().filter(|f| !data.fractures.contains(f)) {
            name("fracture", fracture, "has a law, but does not exist", &data.fractures);
        }
        for d in &self.dirichlet {
            if let Place::Tag(tag) = &d.place
                && mesh.tagged_faces(tag).next().is_none()
            {
                name("boundary", tag, "has Dirichlet data, but no face", &data.tags);
            }
        }
        for d in self.neumann.iter().filter(|d| mesh.tagged_faces(&d.tag).next().is_none()) {
            name("boundary", &d.tag, "has a traction, but no face", &data.tags);
        }
        for d in &self.dirichlet {
            if let Place::Point(p) = &d.place
                && !p.is_finite()
            {
                problems.push(ModelProblem::Point { place: d.place.to_string() });
            }
        }
        for d in self.dirichlet.iter().filter(|d| d.component >= mesh.dim()) {
            let (component, dim) = (d.component, mesh.dim());
            problems.push(ModelProblem::Component { place: d.place.to_string(), component, dim });
        }
        problems
    }
}
