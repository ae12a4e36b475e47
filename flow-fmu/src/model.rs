//! The description of a flow problem, and its check against a mesh.

use std::collections::HashSet;
use std::fmt;
use std::sync::Arc;

use mesh::{Mesh, Vec3};
use serde::{Deserialize, Serialize};

use crate::Tensor;
use crate::error::{FlowError, Problem};

/// A function of point (m) and time (s).
#[derive(Clone)]
pub struct SpaceTimeFunction(Arc<dyn Fn(Vec3, f64) -> f64 + Send + Sync>);

impl SpaceTimeFunction {
    /// From a closure.
    pub fn new(f: impl Fn(Vec3, f64) -> f64 + Send + Sync + 'static) -> Self {
        Self(Arc::new(f))
    }

    /// The same value everywhere and always.
    pub fn constant(value: f64) -> Self {
        Self::new(move |_, _| value)
    }

    /// Its value.
    pub fn at(&self, x: Vec3, t: f64) -> f64 {
        (self.0)(x, t)
    }
}

impl fmt::Debug for SpaceTimeFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SpaceTimeFunction")
    }
}

impl From<f64> for SpaceTimeFunction {
    fn from(value: f64) -> Self {
        Self::constant(value)
    }
}

/// The fluid. Its density in ρ g is that of the reference state, and its compressibility 1/K_f acts on the storage
/// alone, with porosity and aperture of the last time level: so a time step is linear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fluid {
    /// η (Pa s).
    pub viscosity: f64,
    /// ρ (kg/m³); matters with gravity only.
    pub density: f64,
    /// K_f (Pa); `None`: incompressible.
    pub bulk_modulus: Option<f64>,
}

impl Default for Fluid {
    /// Water that does not compress.
    fn default() -> Self {
        Self { viscosity: 1e-3, density: 1000.0, bulk_modulus: None }
    }
}

impl Fluid {
    /// 1/K_f (1/Pa).
    pub fn compressibility(&self) -> f64 {
        self.bulk_modulus.map_or(0.0, f64::recip)
    }
}

/// The rock of a region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rock {
    /// K_m (m²), symmetric and positive definite; in 2D only x and y are looked at.
    pub permeability: Tensor,
    /// φ at the start, in 0..1.
    pub porosity: f64,
    /// M (Pa); `None`: infinite, no storage of its own.
    pub biot_modulus: Option<f64>,
    /// b, by which pressure drives the rock: where it is 0, no partner answers to the pressure in the rock.
    pub biot_coefficient: f64,
}

impl Rock {
    /// A rock of the same permeability (m²) in all directions, that pressure does not drive.
    pub fn isotropic(permeability: f64, porosity: f64, biot_modulus: Option<f64>) -> Self {
        Self { permeability: Tensor::IDENTITY * permeability, porosity, biot_modulus, biot_coefficient: 0.0 }
    }

    /// 1/M (1/Pa).
    pub(crate) fn storage(&self) -> f64 {
        self.biot_modulus.map_or(0.0, f64::recip)
    }
}

/// The properties of a fracture.
#[derive(Clone, Debug)]
pub struct Fracture {
    /// K_n (m²) in T_f = 2 K_n/(η d_f); 0 seals it.
    pub normal_permeability: f64,
    /// d_f at the start (m), taken at the centres of its faces.
    pub aperture: SpaceTimeFunction,
}

/// What holds on a part of the boundary.
#[derive(Clone, Debug)]
pub enum Condition {
    /// The pressure (Pa).
    Pressure(SpaceTimeFunction),
    /// The inflow, positive into the domain: m/s on the matrix; m²/s on fracture edges, over all the aperture (m²/s is
    /// also what it is at the boundary point of a 2D fracture).
    Inflow(SpaceTimeFunction),
}

/// The conditions on the boundary faces with a tag.
#[derive(Clone, Debug)]
pub struct Boundary {
    /// On the matrix.
    pub matrix: Condition,
    /// On the fracture edges that lie on the faces. `None`: the pressure of the matrix, if that is given, or else no
    /// flow. Where faces of several tags meet at an edge a pressure goes before an inflow, and the face of the lower
    /// number before the other.
    pub fracture: Option<Condition>,
}

impl Boundary {
    /// A pressure (Pa), on matrix and fractures.
    pub fn pressure(function: impl Into<SpaceTimeFunction>) -> Self {
        Self { matrix: Condition::Pressure(function.into()), fracture: None }
    }

    /// An inflow (m/s) through the matrix, none through fractures.
    pub fn inflow(function: impl Into<SpaceTimeFunction>) -> Self {
        Self { matrix: Condition::Inflow(function.into()), fracture: None }
    }

    pub(crate) fn fracture_condition(&self) -> Option<&Condition> {
        self.fracture.as_ref().or(match &self.matrix {
            pressure @ Condition::Pressure(_) => Some(pressure),
            Condition::Inflow(_) => None,
        })
    }
}

/// Where a well is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WellPlace {
    /// In the cell that holds the point, see [`Mesh::locate`].
    Cell(Vec3),
    /// In the fracture face that holds the point.
    FractureFace(Vec3),
}

/// The index W of a well in q = (W/η) (p_w − p), W in m³ (2D: m²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WellIndex {
    /// Given.
    Given(f64),
    /// From the radius, as p_w − p is in the exact flow around a straight well on this mesh, see `wells.rs`. A fracture
    /// face in 2D has no radial flow: give W.
    Radius {
        /// r_w (m).
        radius: f64,
        /// Along the well in 3D, of any length; in 2D a well goes across the plane, and in a fracture across the face.
        direction: Vec3,
    },
}

impl WellIndex {
    /// That of a well along z, of this radius (m).
    pub fn upright(radius: f64) -> Self {
        Self::Radius { radius, direction: Vec3::Z }
    }
}

/// What a well is to do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Control {
    /// Inject at this rate, m³/s (2D: m²/s); negative: produce.
    Rate(f64),
    /// Hold this pressure (Pa).
    Pressure(f64),
}

/// A well.
#[derive(Clone, Debug, PartialEq)]
pub struct Well {
    /// Its name.
    pub name: String,
    /// Where it is.
    pub place: WellPlace,
    /// How well it is connected. `None`: unknown, which will do for a rate without a limit; the pressure of such a well is said to be
    /// that of its cell or fracture face.
    pub index: Option<WellIndex>,
    /// What it does at the start; [`Inputs`](crate::Inputs) may change it at each time step.
    pub control: Control,
    /// The pressure (Pa) that a well with a rate must not pass: from below when it injects, from above when it
    /// produces. There it holds this pressure until the rate can be had again.
    pub limit: Option<f64>,
}

impl Well {
    /// Whether it holds a pressure, or may come to.
    pub(crate) fn holds_pressure(&self) -> bool {
        self.limit.is_some() || matches!(self.control, Control::Pressure(_))
    }
}

/// The largest pressure stiffnesses that are published, for where they would be infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StiffnessCap {
    /// Pa.
    pub matrix: f64,
    /// Pa/m.
    pub fracture: f64,
}

impl Default for StiffnessCap {
    fn default() -> Self {
        Self { matrix: 1e13, fracture: 1e16 }
    }
}

/// A flow problem. Boundary faces without a condition are impervious.
#[derive(Clone, Debug)]
pub struct FlowModel {
    /// The fluid.
    pub fluid: Fluid,
    /// g (m/s²), downward.
    pub gravity: Vec3,
    /// The rock of each region, by name.
    pub rocks: Vec<(String, Rock)>,
    /// The properties of each fracture, by name.
    pub fractures: Vec<(String, Fracture)>,
    /// The conditions of each boundary tag, by name.
    pub boundaries: Vec<(String, Boundary)>,
    /// h_m (1/s), taken at the centres of cells.
    pub matrix_source: Option<SpaceTimeFunction>,
    /// h_f (m/s), taken at the centres of fracture faces.
    pub fracture_source: Option<SpaceTimeFunction>,
    /// The wells.
    pub wells: Vec<Well>,
    /// p⁰ (Pa) at the start, also the reference of the porosity.
    pub initial_pressure: SpaceTimeFunction,
    /// Time at the start (s).
    pub initial_time: f64,
    /// The largest published stiffnesses.
    pub stiffness_cap: StiffnessCap,
    /// The warp ([`Mesh::warp`]) up to which a face counts as planar; beyond, it is split into triangles, which costs four
    /// times the unknowns on hexahedra. The velocity of an affine pressure is wrong by about this part in cells with such
    /// faces, the pressure by less than a tenth of it.
    pub planarity: f64,
}

impl FlowModel {
    /// An impervious box of one fluid at rest, without gravity, sources or wells, at p = 0.
    pub fn new(fluid: Fluid) -> Self {
        Self {
            fluid,
            gravity: Vec3::ZERO,
            rocks: Vec::new(),
            fractures: Vec::new(),
            boundaries: Vec::new(),
            matrix_source: None,
            fracture_source: None,
            wells: Vec::new(),
            initial_pressure: 0.0.into(),
            initial_time: 0.0,
            stiffness_cap: StiffnessCap::default(),
            planarity: Mesh::PLANAR,
        }
    }

    /// The hydrostatic pressure that is `pressure` (Pa) at the point `at`.
    pub fn hydrostatic(&self, pressure: f64, at: Vec3) -> SpaceTimeFunction {
        let weight = self.fluid.density * self.gravity;
        SpaceTimeFunction::new(move |x, _| pressure + weight.dot(x - at))
    }

    /// Looks for all that is wrong with this model on a mesh, but for the places of wells.
    pub(crate) fn check(&self, mesh: &Mesh) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut value = |of: &str, quantity, value: f64, right: bool, must| {
            if !(right && value.is_finite()) {
                problems.push(Problem::Value { of: of.to_owned(), quantity, value, must });
            }
        };
        const POSITIVE: &str = "positive and finite";
        let fluid = &self.fluid;
        value("fluid", "the viscosity", fluid.viscosity, fluid.viscosity > 0.0, POSITIVE);
        value("fluid", "the density", fluid.density, fluid.density >= 0.0, "at least 0 and finite");
        if let Some(k) = fluid.bulk_modulus {
            value("fluid", "the bulk modulus", k, k > 0.0, POSITIVE);
        }
        for (axis, g) in self.gravity.to_array().into_iter().enumerate() {
            let in_plane = axis < mesh.dim() || g == 0.0;
            value("gravity", "a component", g, in_plane, "finite, and 0 along z in 2D");
        }
        value("model", "the initial time", self.initial_time, true, "finite");
        let cap = self.stiffness_cap;
        let planarity = self.planarity;
        value("model", "the planarity of faces", planarity, planarity >= 0.0, "at least 0 and finite");
        value("model", "the cap of the matrix stiffness", cap.matrix, cap.matrix > 0.0, POSITIVE);
        value("model", "the cap of the fracture stiffness", cap.fracture, cap.fracture > 0.0, POSITIVE);
        for (name, rock) in &self.rocks {
            let of = format!("rock \"{name}\"");
            value(&of, "the porosity", rock.porosity, (0.0..1.0).contains(&rock.porosity), "in 0..1");
            if let Some(m) = rock.biot_modulus {
                value(&of, "the Biot modulus", m, m > 0.0, POSITIVE);
            }
        }
        for (name, fracture) in &self.fractures {
            let k = fracture.normal_permeability;
            value(&format!("fracture \"{name}\""), "the normal permeability", k, k >= 0.0, "at least 0 and finite");
        }
        for well in &self.wells {
            let of = format!("well \"{}\"", well.name);
            match well.control {
                Control::Rate(q) => value(&of, "the rate", q, true, "finite"),
                Control::Pressure(p) => value(&of, "the pressure", p, true, "finite"),
            }
            match well.index {
                Some(WellIndex::Given(w)) => value(&of, "the index", w, w > 0.0, POSITIVE),
                Some(WellIndex::Radius { radius, direction }) => {
                    value(&of, "the radius", radius, radius > 0.0, POSITIVE);
                    let length = direction.length();
                    value(&of, "the length of its direction", length, length > 0.0, POSITIVE);
                }
                None => {}
            }
            if let Some(limit) = well.limit {
                value(&of, "the limit", limit, true, "finite");
            }
        }
        for (name, rock) in &self.rocks {
            check_tensor(&format!("rock \"{name}\""), rock.permeability, mesh.dim(), &mut problems);
        }
        let data = mesh.data();
        let rocks = self.rocks.iter().map(|r| &r.0);
        let fractures = self.fractures.iter().map(|f| &f.0);
        check_names("region", rocks, &data.regions, true, &mut problems);
        check_names("fracture", fractures, &data.fractures, true, &mut problems);
        check_names("boundary tag", self.boundaries.iter().map(|b| &b.0), &data.tags, false, &mut problems);
        let mut seen = HashSet::new();
        for well in &self.wells {
            if well.name.is_empty() || !seen.insert(&well.name) {
                problems.push(Problem::Repeated { kind: "well", name: well.name.clone() });
            }
            if well.index.is_none() && well.holds_pressure() {
                problems.push(Problem::lacks_index(well));
            }
        }
        problems
    }
}

fn check_tensor(of: &str, k: Tensor, dim: usize, problems: &mut Vec<Problem>) {
    /// Entries that should be equal may differ by this part of the largest.
    const SYMMETRY: f64 = 1e-12;
    let entry = |i: usize, j: usize| k.col(j)[i];
    let pairs = (0..dim).flat_map(|i| (0..dim).map(move |j| (i, j)));
    if let Some((i, j)) = pairs.clone().find(|&(i, j)| !entry(i, j).is_finite()) {
        let quantity = "an entry of the permeability";
        problems.push(Problem::Value { of: of.to_owned(), quantity, value: entry(i, j), must: "finite" });
        return;
    }
    let largest = pairs.clone().map(|(i, j)| entry(i, j).abs()).fold(0.0, f64::max);
    let difference = pairs.map(|(i, j)| (entry(i, j) - entry(j, i)).abs()).fold(0.0, f64::max);
    if difference > SYMMETRY * largest {
        problems.push(Problem::NotSymmetric { of: of.to_owned(), difference });
    }
    // Sylvester's criterion.
    let second = entry(0, 0) * entry(1, 1) - entry(0, 1) * entry(1, 0);
    let minors = [entry(0, 0), second, if dim == 3 { k.determinant() } else { 1.0 }];
    if let Some(&minor) = minors.iter().find(|&&m| m <= 0.0) {
        problems.push(Problem::NotDefinite { of: of.to_owned(), minor });
    }
}

fn check_names<'a>(
    kind: &'static str,
    given: impl Iterator<Item = &'a String> + Clone,
    known: &[String],
    all_needed: bool,
    problems: &mut Vec<Problem>,
) {
    let mut seen = HashSet::new();
    for name in given.clone() {
        if name.is_empty() || !seen.insert(name) {
            problems.push(Problem::Repeated { kind, name: name.clone() });
        } else if !known.contains(name) {
            problems.push(Problem::Unknown { kind, name: name.clone(), known: known.to_vec() });
        }
    }
    for name in known.iter().filter(|&name| all_needed && !seen.contains(name)) {
        problems.push(Problem::Missing { kind, name: name.clone() });
    }
}

pub(crate) fn fail_on(problems: Vec<Problem>) -> Result<(), FlowError> {
    if problems.is_empty() { Ok(()) } else { Err(FlowError::Invalid(problems)) }
}
