//! The typed description of a case, `model.toml`.
//!
//! All numbers are SI. Every table refuses keys it does not know.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::value::{Coordinates, Number, Numbers, Tensor, Value};

/// A case: geometry, materials, data, and how it is to be run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Model {
    /// What it is called.
    pub title: String,
    /// What it is and where its data are from.
    #[serde(default)]
    pub description: String,
    /// Named expressions that all expressions may use, each of what its place of use allows.
    #[serde(default)]
    pub define: BTreeMap<String, Value>,
    /// The mesh.
    pub mesh: MeshSource,
    /// The rock of each region.
    pub regions: BTreeMap<String, Region>,
    /// The law of each fracture.
    #[serde(default)]
    pub fractures: BTreeMap<String, Fracture>,
    /// State at the start.
    #[serde(default)]
    pub initial: Initial,
    /// Data of the mechanical problem. Left out: no mechanics unit.
    pub mechanics: Option<Mechanics>,
    /// Data of the flow problem. Left out: no flow unit, pressures stay as they are.
    pub flow: Option<Flow>,
    /// Times and time steps.
    #[serde(default)]
    pub time: Time,
    /// How the units are coupled.
    #[serde(default)]
    pub coupling: Coupling,
    /// Units from elsewhere, by name. `flow` and `mechanics` are taken in place of the own ones. All others follow the
    /// coupled units: they step once for each accepted time step.
    #[serde(default)]
    pub units: BTreeMap<String, ForeignUnit>,
    /// Connections of outputs to inputs outside the coupling.
    #[serde(default)]
    pub connections: Vec<Connection>,
    /// What a run leaves.
    #[serde(default)]
    pub output: Output,
    /// Named changes to this file: tables that are laid over it when the variant is chosen. One with another source of the
    /// mesh replaces all of `mesh`.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, BTreeMap<String, serde_json::Value>>")]
    pub variants: BTreeMap<String, toml::Table>,
}

/// Where the mesh comes from. Exactly one of `box`, `triangles`, `corner_point` and `file`; the rest is applied in the
/// order of the fields.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshSource {
    /// A box of quadrilaterals or hexahedra.
    #[serde(rename = "box")]
    pub cartesian: Option<CartesianBox>,
    /// Triangles that conform to fractures.
    pub triangles: Option<Triangles>,
    /// A corner-point grid.
    pub corner_point: Option<CornerPoint>,
    /// A Gmsh (.msh) or HDF5 (.h5) file, relative to the model's folder.
    pub file: Option<PathBuf>,
    /// Fractures: the inner faces all of whose vertices satisfy an expression of x, y, z.
    #[serde(default)]
    pub fractures: BTreeMap<String, Value>,
    /// Prisms over a 2D mesh.
    pub extrude: Option<Extrude>,
    /// Regions: the cells whose centre satisfies an expression of x, y, z. The first, by name, that holds is taken;
    /// cells for which none does stay in the region they are in, `rock` in meshes that are made here.
    #[serde(default)]
    pub regions: BTreeMap<String, Value>,
    /// Moves inner vertices at random.
    pub perturb: Option<Perturb>,
    /// What becomes of the cells.
    #[serde(default)]
    pub cells: Cells,
    /// Boundary tags: the boundary faces whose centre satisfies an expression of x, y, z. The first, by name, that
    /// holds replaces the tag that the face has.
    #[serde(default)]
    pub tags: BTreeMap<String, Value>,
    /// Largest distance of a vertex from the plane of its face, over the face's diameter, up to which flow takes the face for
    /// planar; others are split into triangles, which costs about four times the unknowns. Left out: 1e-4.
    pub planarity: Option<Number>,
}

/// A box. Boundary tags `left`, `right` (x), `front`, `back` (y), `bottom`, `top` (z); in 2D `bottom` and `top` are
/// those of y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CartesianBox {
    /// Lowest corner (m): two numbers or three.
    pub low: Coordinates,
    /// Highest corner (m).
    pub high: Coordinates,
    /// Number of cells in each direction.
    pub cells: Vec<usize>,
    /// Ratio in (0, 1] of the thinnest layer to the Cartesian one in a distortion after Kershaw; left out: none.
    pub kershaw: Option<Number>,
}

/// Triangles in a rectangle, tagged `left`, `right`, `bottom` and `top`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Triangles {
    /// Lowest corner (m).
    pub low: Numbers<2>,
    /// Highest corner (m).
    pub high: Numbers<2>,
    /// Edge length (m) far from lines.
    pub size: Number,
    /// Length (m) of fracture faces, where the fracture does not give its own.
    pub fracture_size: Option<Number>,
    /// How fast sizes grow with the distance from lines (metres per metre).
    #[serde(default = "growth")]
    pub growth: Number,
    /// Limits the edge length (m): an expression of x, y.
    pub size_limit: Option<Value>,
    /// Fractures by name.
    #[serde(default)]
    pub fractures: BTreeMap<String, Line>,
    /// Lines that faces follow without being fractures, as between regions.
    #[serde(default)]
    pub interfaces: BTreeMap<String, Line>,
}

fn growth() -> Number {
    Number(0.2)
}

/// A polyline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// Its points (m).
    pub points: Vec<Numbers<2>>,
    /// Length (m) of the faces on it.
    pub size: Option<Number>,
}

/// A corner-point grid. Boundary tags `left`, `right` along i, `front`, `back` along j, `bottom` and `top` below and above
/// each column; fractures are the faults of the file (keyword `FAULTS`), and those of `fractures` below.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CornerPoint {
    /// The file, GRDECL text, relative to the model's folder.
    pub file: PathBuf,
    /// Whether a grid of one row of cells along j is a section in 2D, of x and height.
    #[serde(default)]
    pub section: bool,
    /// Height (m) of depth 0: depths of the file, positive downward, turn into heights below it.
    #[serde(default)]
    pub elevation: Number,
    /// What tells the regions. Left out: all cells are in region `rock`.
    pub regions: Option<CellNumbers>,
    /// The faults of the file that are fractures. Left out: all.
    pub faults: Option<Vec<String>>,
}

/// Regions by a number for each cell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CellNumbers {
    /// The keyword of the file that gives it, as `SATNUM`.
    pub keyword: String,
    /// Names of the regions by their number; others are called by their number.
    #[serde(default)]
    pub names: BTreeMap<String, String>,
}

/// Prisms over a 2D mesh; its sides in y, `bottom` and `top`, become `front` and `back`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Extrude {
    /// Heights z (m), ascending, that are levels of the mesh.
    pub levels: Vec<Number>,
    /// Number of layers between each level and the next.
    pub layers: Vec<usize>,
    /// From which to which height (m) a fracture reaches; those not named go all the way. Heights must be levels.
    #[serde(default)]
    pub fractures: BTreeMap<String, Numbers<2>>,
}

/// Random movement of inner vertices; boundary and fractures keep their shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Perturb {
    /// Part of the shortest edge by which a vertex moves at most in each direction; up to 0.2 cells stay sound.
    pub amplitude: Number,
    /// Start of the random numbers.
    #[serde(default)]
    pub seed: u64,
}

/// What becomes of the cells.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Cells {
    /// They stay as they are.
    #[default]
    AsMade,
    /// Cut into triangles or tetrahedra.
    Simplices,
    /// The dual of the simplices into which they are cut: polygons or polyhedra.
    Dual,
    /// Agglomerates of about so many of the simplices into which they are cut.
    Agglomerate(usize),
}

/// The rock of a region.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// E of the drained rock (Pa). Needed by mechanics.
    pub young_modulus: Option<Number>,
    /// ν of the drained rock, in (−1, ½). Needed by mechanics.
    pub poisson_ratio: Option<Number>,
    /// b, in 0..1.
    #[serde(default)]
    pub biot_coefficient: Number,
    /// M (Pa). Left out: infinite, no storage of its own.
    pub biot_modulus: Option<Number>,
    /// K_m (m²). Needed by flow.
    pub permeability: Option<Tensor>,
    /// φ at the start, in 0..1; matters for a compressible fluid only.
    #[serde(default)]
    pub porosity: Number,
}

/// The law of a fracture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fracture {
    /// What bounds the tangential traction.
    #[serde(default)]
    pub friction: Friction,
    /// ψ (rad), in [0, π/2): slip s since the initial state opens the fracture by D = s tan ψ.
    #[serde(default)]
    pub dilation_angle: Number,
    /// What D opens.
    #[serde(default)]
    pub dilation: Dilation,
    /// D_m (m): D is at most this; s_c tan ψ for a critical slip s_c. Left out: no limit.
    pub dilation_limit: Option<Number>,
    /// k_n (Pa/m): how the closed fracture closes further under the normal traction T_n, linearly by V = −T_n/k_n unless there is a
    /// `largest_closure`. Left out: rigid.
    pub normal_stiffness: Option<Number>,
    /// V_m (m), below d_c: the closure V follows the hyperbola −T_n = k_n V/(1 − V/V_m) of Bandis, with `normal_stiffness` k_n at
    /// zero stress; the aperture stays above d_c − V_m.
    pub largest_closure: Option<Number>,
    /// d_c (m), > 0, the aperture of the fracture in contact at zero stress: an expression of x, y, z, `tip_distance` (m, to the
    /// nearest tip of this fracture) and `max_tip_distance` (m, its largest value on the fracture's vertices).
    pub contact_aperture: Value,
    /// d_r (m), at most d_c: the aperture that the fluid finds at least, however far the sides close. 0: none; a time step that
    /// leaves no aperture is then discarded. Left out: 1 % of d_c with a linear `normal_stiffness`, 0 otherwise (there the aperture
    /// stays positive by itself).
    pub residual_aperture: Option<Number>,
    /// K_n (m²) in T_f = 2 K_n/(η d_f); 0 seals. Needed by flow.
    pub normal_permeability: Option<Number>,
}

/// What dilation opens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Dilation {
    /// The aperture alone, d_f = d_c − ⟦u⟧_n + D: the fluid gets more room, the rock does not move.
    #[default]
    Hydraulic,
    /// The fracture: non-penetration becomes ⟦u⟧_n + D ≤ V, so that slip moves the sides apart against the rock around it, and
    /// d_f = d_c − ⟦u⟧_n. It needs Coulomb friction with F ≥ tan ψ, as less would make energy.
    Mechanical,
}

/// What bounds the tangential traction.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Friction {
    /// There is none.
    #[default]
    None,
    /// |T_τ| ≤ bound.
    Tresca {
        /// The bound (Pa), ≥ 0.
        bound: Number,
    },
    /// |T_τ| ≤ cohesion − F T_n.
    Coulomb {
        /// F ≥ 0.
        coefficient: Number,
        /// Cohesion (Pa), ≥ 0.
        #[serde(default)]
        cohesion: Number,
    },
}

/// State at the start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Initial {
    /// p⁰ (Pa): an expression of x, y, z.
    pub pressure: Value,
    /// Whether the mechanical equilibrium at p⁰ and the loads at the start is found first; slip and porosity changes
    /// then count from it. Otherwise they count from the undeformed rock.
    pub equilibrium: bool,
}

impl Default for Initial {
    fn default() -> Self {
        Self { pressure: Value::Number(0.0), equilibrium: false }
    }
}

/// Data of the mechanical problem.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Mechanics {
    /// Prescribed displacements; where several give a component of a point, the last holds.
    pub displacement: Vec<Displacement>,
    /// Prescribed tractions; elsewhere σ_T n = 0. Those on one tag add up.
    pub traction: Vec<Traction>,
    /// f (N/m³), one component for each dimension: expressions of x, y, z, t.
    pub body_force: Option<Vec<Value>>,
    /// On which sides of a fracture the displacement has a bubble.
    pub bubbles: Bubbles,
    /// On which faces of the rock the displacement has a normal bubble, which keeps nearly incompressible or undrained rock from
    /// locking and its pressure from oscillating.
    pub normal_bubbles: NormalBubbles,
    /// Weight of the stabilisation.
    pub stabilisation: Stabilisation,
    /// Newton's method.
    pub newton: Newton,
}

/// A prescribed displacement (m): the components that are given.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Displacement {
    /// Boundary tags.
    #[serde(default)]
    pub on: Vec<String>,
    /// Or the vertex nearest to this point (m).
    pub at: Option<Coordinates>,
    /// u_x (m): an expression of x, y, z, t, and of `cell_x`, `cell_y`, `cell_z`, the centre of a cell at the point
    /// (which tells the sides of a fracture apart).
    pub x: Option<Value>,
    /// u_y (m).
    pub y: Option<Value>,
    /// u_z (m).
    pub z: Option<Value>,
}

impl Displacement {
    /// The given components: number, key and value.
    pub fn components(&self) -> impl Iterator<Item = (usize, &'static str, &Value)> {
        components([&self.x, &self.y, &self.z])
    }
}

fn components(list: [&Option<Value>; 3]) -> impl Iterator<Item = (usize, &'static str, &Value)> {
    let keys = ["x", "y", "z"];
    list.into_iter().enumerate().filter_map(move |(i, value)| Some((i, keys[i], value.as_ref()?)))
}

/// A prescribed traction σ_T n (Pa), of the total stress; components left out are 0.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Traction {
    /// Boundary tags.
    pub on: Vec<String>,
    /// x component (Pa): an expression of x, y, z, t.
    pub x: Option<Value>,
    /// y component (Pa).
    pub y: Option<Value>,
    /// z component (Pa).
    pub z: Option<Value>,
}

impl Traction {
    /// The given components: number, key and value.
    pub fn components(&self) -> impl Iterator<Item = (usize, &'static str, &Value)> {
        components([&self.x, &self.y, &self.z])
    }
}

/// On which sides of a fracture the displacement has a bubble.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Bubbles {
    /// On the plus side.
    #[default]
    OneSided,
    /// On both sides.
    TwoSided,
}

/// On which faces of the rock the displacement has a normal bubble.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NormalBubbles {
    /// On those of cells that need it: of rock that hardly changes its volume, because its Poisson's ratio is above .45 or because
    /// pore fluid, which cannot leave a cell within the first time step, makes it so. Cells of Voronoi and dual meshes, at whose
    /// vertices three (2D) or four (3D) cells meet, need none.
    #[default]
    Auto,
    /// On no face.
    None,
    /// On all inner faces.
    All,
}

/// Weight of the stabilisation of virtual elements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stabilisation {
    /// Matched to the shear energy of bi- and trilinear functions.
    #[default]
    Matched,
    /// h^{d−2} (2μ+λ), of the published tables: 3 (2D) to 12 (3D) times too stiff.
    Published,
}

/// Settings of the semi-smooth Newton method; left out: those of the unit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Newton {
    /// β > 0 of the complementarity functions as a factor on E_max/h of each face.
    pub beta_factor: Option<Number>,
    /// Newton iterations before a time step is given up.
    pub max_iterations: Option<usize>,
    /// Part of the largest jump by which jumps may change in the last iteration.
    pub tolerance: Option<Number>,
}

/// Data of the flow problem. Boundaries that are not named are impervious.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Flow {
    /// The fluid.
    #[serde(default)]
    pub fluid: Fluid,
    /// g (m/s²), a vector; left out: none.
    pub gravity: Option<Coordinates>,
    /// What holds on the boundary faces with a tag.
    #[serde(default)]
    pub boundary: BTreeMap<String, FlowBoundary>,
    /// h_m (1/s) in the rock: an expression of x, y, z, t.
    pub matrix_source: Option<Value>,
    /// h_f (m/s) in fractures: an expression of x, y, z, t.
    pub fracture_source: Option<Value>,
    /// Wells by name.
    #[serde(default)]
    pub wells: BTreeMap<String, Well>,
}

/// The fluid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Fluid {
    /// η (Pa s).
    pub viscosity: Number,
    /// ρ (kg/m³); matters with gravity only.
    pub density: Number,
    /// K_f (Pa). Left out: incompressible.
    pub bulk_modulus: Option<Number>,
}

impl Default for Fluid {
    fn default() -> Self {
        Self { viscosity: Number(1e-3), density: Number(1000.0), bulk_modulus: None }
    }
}

/// What holds on a part of the boundary: a pressure or an inflow.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FlowBoundary {
    /// Pressure (Pa) of rock, and of fractures that end here: an expression of x, y, z, t.
    pub pressure: Option<Value>,
    /// Inflow (m/s) into the rock, positive into the domain.
    pub inflow: Option<Value>,
    /// Inflow (m²/s) into fractures that end here, over all their aperture. Left out with `inflow`: none.
    pub fracture_inflow: Option<Value>,
}

/// A well: in the rock or in a fracture, with a rate or a pressure.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Well {
    /// A point (m) in the cell that it is in.
    pub cell: Option<Coordinates>,
    /// Or a point (m) on the fracture face that it is in.
    pub fracture_face: Option<Coordinates>,
    /// Rate (m³/s, 2D: m²/s), positive when it injects.
    pub rate: Option<Number>,
    /// Or its pressure (Pa).
    pub pressure: Option<Number>,
    /// Pressure (Pa) that a well with a rate must not pass.
    pub limit: Option<Number>,
    /// Well index W (m³, 2D: m²) in q = (W/η) (p_w − p). A well with a rate and no limit needs neither index nor radius; its pressure
    /// is then said to be that of its cell.
    pub index: Option<Number>,
    /// Or the radius (m), from which W follows: such that the pressure in the well is that of the exact radial flow around it.
    pub radius: Option<Number>,
    /// Along the well in 3D, with `cell` and `radius`: a vector of any length. Left out: along z. It is as long as its cell, goes on
    /// where it leaves the mesh or the permeable rock, and wells that follow one another on a line are one.
    pub direction: Option<Coordinates>,
}

/// Times and time steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Time {
    /// Time (s) at the start.
    pub start: Number,
    /// Time (s) at the end.
    pub end: Number,
    /// Time step (s): every one of them, or the first one where steps adapt. Left out: one step from start to end.
    pub step: Option<Number>,
    /// Smallest time step (s) that is tried after failures. Left out: 2⁻¹⁰ of `step`.
    pub minimum: Option<Number>,
    /// Lets time steps adapt.
    pub adaptive: Option<Adaptive>,
}

impl Default for Time {
    fn default() -> Self {
        Self { start: Number(0.0), end: Number(1.0), step: None, minimum: None, adaptive: None }
    }
}

/// How time steps adapt: the next is the last one times the least of `target/iterations` and, for each field,
/// `largest change/change`, within ½ and `growth`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Adaptive {
    /// Time (s) up to which they are `step`. Left out: they adapt from the start.
    pub from: Option<Number>,
    /// Largest time step (s). Left out: no limit.
    pub maximum: Option<Number>,
    /// Coupling iterations that a time step should take.
    pub target_iterations: Number,
    /// Largest growth from one time step to the next.
    pub growth: Number,
    /// Largest change of a coupling field in a time step, in its unit, by name.
    pub largest_change: BTreeMap<String, Number>,
}

impl Default for Adaptive {
    fn default() -> Self {
        Self {
            from: None,
            maximum: None,
            target_iterations: Number(6.0),
            growth: Number(1.5),
            largest_change: BTreeMap::new(),
        }
    }
}

/// How the units are coupled. Split, acceleration, criteria and extrapolation are independent of one another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Coupling {
    /// Which unit goes first, and which sensitivities are connected.
    pub split: Split,
    /// How the next iterate is made from the last ones.
    pub acceleration: Acceleration,
    /// First guess of a time step.
    pub extrapolation: Extrapolation,
    /// Coupling iterations before a time step is given up.
    pub max_iterations: usize,
    /// Whether each time step is one pass without a criterion: loose coupling, for units that cannot roll back.
    pub loose: bool,
    /// When a coupling field has converged, by name; fields not named have the defaults of the interface. All must.
    pub criteria: BTreeMap<String, Criterion>,
    /// Factors and floors of the sensitivities.
    pub sensitivity: Sensitivity,
}

impl Default for Coupling {
    fn default() -> Self {
        Self {
            split: Split::default(),
            acceleration: Acceleration::default(),
            extrapolation: Extrapolation::default(),
            max_iterations: 50,
            loose: false,
            criteria: BTreeMap::new(),
            sensitivity: Sensitivity::default(),
        }
    }
}

/// The four splits (Kim, Tchelepi, Juanes, CMAME 200, 2011, 1591-1606 and 2094-2116).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Flow first; nothing connected. Conditionally stable: b²M/K_dr < 1.
    FixedStrain,
    /// Mechanics first; nothing connected. Conditionally stable, the same.
    Drained,
    /// Flow first; the compliances of mechanics connected. Unconditionally stable.
    #[default]
    FixedStress,
    /// Mechanics first; the stiffnesses of flow connected. Unconditionally stable.
    Undrained,
}

/// How the next iterate is made from the last ones. Loose coupling has none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Acceleration {
    /// As it comes.
    None,
    /// Constant relaxation.
    Relaxation {
        /// ω in (0, 2): the part of the residual that is added.
        factor: Number,
    },
    /// Aitken's relaxation (Irons, Tuck, IJNME 1, 1969; Küttler, Wall, Comput. Mech. 43, 2008, equation 44).
    Aitken {
        /// ω of the first iteration of a time step.
        #[serde(default = "one")]
        initial: Number,
    },
    /// Anderson's mixing (Walker, Ni, SIAM J. Numer. Anal. 49, 2011).
    Anderson {
        /// How many earlier iterations take part.
        #[serde(default = "depth")]
        depth: usize,
        /// Part of the residual that is added, in (0, 1].
        #[serde(default = "one")]
        mixing: Number,
    },
    /// Interface quasi-Newton from least squares (Degroote, Bathe, Vierendeels, Comput. Struct. 87, 2009).
    IqnIls {
        /// Number of earlier time steps whose differences are used again.
        #[serde(default = "reuse")]
        reuse: usize,
        /// ω of the first iteration, where there is nothing to use.
        #[serde(default = "one")]
        initial: Number,
    },
    /// Newton's method on the residual of a pass, by GMRES with the units' directional derivatives (Knoll, Keyes,
    /// J. Comput. Phys. 193, 2004), or differences of time steps where a unit has none.
    NewtonKrylov {
        /// Most GMRES iterations in a Newton iteration; each takes a derivative of both units.
        #[serde(default = "krylov")]
        krylov: usize,
    },
}

fn krylov() -> usize {
    60
}

impl Default for Acceleration {
    fn default() -> Self {
        Self::NewtonKrylov { krylov: krylov() }
    }
}

fn one() -> Number {
    Number(1.0)
}

fn depth() -> usize {
    5
}

fn reuse() -> usize {
    3
}

/// First guess of a time step from the last ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Extrapolation {
    /// As at the last time.
    #[default]
    Constant,
    /// From the last two times.
    Linear,
    /// From the last three times.
    Quadratic,
}

/// A field has converged when norm(residual) and norm(estimated error) ≤ tolerance × max(floor, range). The range is that of what is
/// left of the field: the least of the range of all its values at the times up to now, of the range of its values in this time step, and of
/// the range of their changes since the start. Where the units' round-off is larger, the time step is accepted as soon as nothing more is gained,
/// and recorded as `round_off`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Criterion {
    /// Part of the scale.
    pub tolerance: Number,
    /// Least scale, in the unit of the field: a range below it is taken for nothing. Default: 100 Pa, 1e-8, 10 nm.
    pub floor: Number,
    /// How the entries count.
    #[serde(default)]
    pub norm: Norm,
}

/// How the entries of a residual count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Norm {
    /// The largest.
    #[default]
    Largest,
    /// Root of the mean square.
    RootMeanSquare,
}

/// Factors and floors of the sensitivities that the units publish.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Sensitivity {
    /// When the units are asked for them.
    pub refresh: Refresh,
    /// Factor on the matrix compliance b²/K_dr; the linear problem contracts from ½ on.
    pub matrix_compliance_factor: Number,
    /// The fracture compliance (m/Pa) is probed by a linearised solve; this is the factor on its floor L_f/E′, L_f the
    /// length of the fracture. A floor of about 1 lets plain iterations and differences converge at smaller time steps,
    /// where closed faces open; but on faces that stay closed they then creep, the more so the less these leak in a time
    /// step, and their residuals say little about their errors. Newton's method needs none.
    pub fracture_compliance_floor_factor: Number,
    /// Largest matrix stiffness (Pa) that flow publishes.
    pub matrix_stiffness_cap: Number,
    /// Largest fracture stiffness (Pa/m) that flow publishes. It is probed by a linearised solve: the pressure that a uniform
    /// opening of the fractures takes away in a time step like the last one, finite through what leaks off.
    pub fracture_stiffness_cap: Number,
}

impl Default for Sensitivity {
    fn default() -> Self {
        Self {
            refresh: Refresh::default(),
            matrix_compliance_factor: Number(1.0),
            fracture_compliance_floor_factor: Number(0.0),
            matrix_stiffness_cap: Number(1e13),
            fracture_stiffness_cap: Number(1e16),
        }
    }
}

/// When the units are asked for their sensitivities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Refresh {
    /// At the start of each time step: the partner's matrix stays the same, and is factorised once.
    #[default]
    TimeStep,
    /// After each coupling iteration.
    Iteration,
}

/// A unit from elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForeignUnit {
    /// The FMU, relative to the model's folder.
    pub fmu: PathBuf,
    /// Values of its parameters and start values of its inputs, by the name of the variable.
    #[serde(default)]
    pub parameters: BTreeMap<String, Parameter>,
}

/// A start value of a variable of a unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Parameter {
    /// A truth value.
    Flag(bool),
    /// A number.
    Number(f64),
    /// A text.
    Text(String),
    /// The entries of an array.
    Numbers(Vec<f64>),
}

/// An output that an input is set to. An input of a coupled unit is set before each time step and stays as it is in it;
/// that of a unit that follows, when it steps.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Connection {
    /// `UNIT.VARIABLE`, as `mechanics.slip_tendency.max`.
    pub from: String,
    /// `UNIT.VARIABLE`, as `flow.wells.injector.rate`.
    pub to: String,
}

/// What a run leaves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Output {
    /// Times (s) at which fields are written; time steps end there. Empty: after every time step.
    pub times: Vec<Number>,
    /// Plots to draw.
    pub plots: Vec<Plot>,
}

/// A plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Plot {
    /// Mean aperture against time.
    MeanAperture,
    /// Mean pressures of matrix and fractures against time.
    MeanPressure,
    /// Contact states on the network at the output times.
    ContactStates,
    /// Jump and traction along each fracture (2D) at the output times.
    FractureProfiles,
    /// Pressure along each fracture (2D) at the output times.
    PressureProfiles,
    /// Slack of the energy estimate in each time step.
    Energy,
    /// Residuals of the coupling iterations.
    CouplingConvergence,
}
