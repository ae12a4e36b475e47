//! Meshes and problems that several tests share.

use std::sync::Arc;

use flow_fmu::{Boundary, Flow, FlowModel, Fluid, Fracture, Rock, SpaceTimeFunction, StepReport, Tensor};
use mesh::generate::{Triangles, agglomerate, cartesian, dual, extrude, kershaw, perturb, simplices};
use mesh::{Mesh, MeshData, Vec3};

pub(crate) const SIDES_2D: [&str; 4] = ["left", "right", "bottom", "top"];
pub(crate) const SIDES_3D: [&str; 6] = ["left", "right", "front", "back", "bottom", "top"];

pub(crate) fn sides(mesh: &Mesh) -> &'static [&'static str] {
    if mesh.dim() == 2 { &SIDES_2D } else { &SIDES_3D }
}

pub(crate) fn unit(n: [usize; 3]) -> MeshData {
    cartesian(Vec3::ZERO, Vec3::ONE, n)
}

pub(crate) fn mesh(data: MeshData) -> Arc<Mesh> {
    Arc::new(Mesh::new(data).unwrap())
}

/// Mesh families of the unit square or cube, `n` cells in each direction or so.
pub(crate) fn family(name: &str, n: usize) -> MeshData {
    let (flat, solid) = ([n, n, 0], [n, n, n]);
    match name {
        "squares" => unit(flat),
        "cubes" => unit(solid),
        "triangles" => Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 1.0 / n as f64).build().unwrap(),
        "perturbed squares" => perturb(&mesh(unit(flat)), 0.2, 1),
        "perturbed cubes" => perturb(&mesh(unit(solid)), 0.2, 1),
        "Kershaw squares" => kershaw(Vec3::ZERO, Vec3::ONE, flat, 0.4),
        "Kershaw cubes" => kershaw(Vec3::ZERO, Vec3::ONE, solid, 0.4),
        "polygons" => dual(&mesh(family("triangles", n))).unwrap(),
        "tetrahedra" => simplices(&mesh(unit(solid))).unwrap(),
        "perturbed tetrahedra" => simplices(&mesh(family("perturbed cubes", n))).unwrap(),
        "polyhedra" => dual(&mesh(family("tetrahedra", n))).unwrap(),
        "clumps of triangles" => agglomerate(&mesh(family("triangles", n)), 6).unwrap(),
        "large clumps of triangles" => agglomerate(&mesh(family("triangles", n)), 24).unwrap(),
        "clumps of tetrahedra" => agglomerate(&mesh(family("tetrahedra", n)), 8).unwrap(),
        "prisms" => {
            let levels: Vec<f64> = (0..=n).map(|k| k as f64 / n as f64).collect();
            extrude(&mesh(family("triangles", n)), &levels, |_, _| true).unwrap()
        }
        "hanging vertices" => hanging(),
        _ => panic!("no family {name}"),
    }
}

pub(crate) const ZOO: [&str; 16] = [
    "squares",
    "cubes",
    "triangles",
    "perturbed squares",
    "perturbed cubes",
    "Kershaw squares",
    "Kershaw cubes",
    "polygons",
    "tetrahedra",
    "perturbed tetrahedra",
    "polyhedra",
    "clumps of triangles",
    "large clumps of triangles",
    "clumps of tetrahedra",
    "prisms",
    "hanging vertices",
];

/// A coarse cell beside two fine ones, one with a tiny face, one not convex, and a dart.
fn hanging() -> MeshData {
    let at =
        [(0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.5, 1.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1e-4), (0.55, 0.5), (1.0, 1.0)];
    let vertices = at.iter().map(|&(x, y)| Vec3::new(x, y, 0.0)).collect();
    let cells = [vec![0, 1, 2, 3, 4], vec![1, 5, 6, 7, 2], vec![2, 7, 6, 8, 3]];
    let mut data = MeshData::from_polygons(vertices, cells);
    mesh::generate::tag_box(&mut data, Vec3::ZERO, Vec3::ONE);
    data
}

/// A water that makes K/η = K.
pub(crate) fn unit_fluid() -> Fluid {
    Fluid { viscosity: 1.0, density: 1.0, bulk_modulus: None }
}

/// A steady problem with the pressure given on all sides.
pub(crate) fn all_pressure(mesh: &Mesh, permeability: Tensor, p: SpaceTimeFunction) -> FlowModel {
    let mut model = FlowModel::new(unit_fluid());
    model.rocks = mesh.data().regions.iter().map(|r| (r.clone(), rock(permeability))).collect();
    model.boundaries = sides(mesh).iter().map(|s| (s.to_string(), Boundary::pressure(p.clone()))).collect();
    model
}

pub(crate) fn rock(permeability: Tensor) -> Rock {
    Rock { permeability, porosity: 0.2, biot_modulus: None, biot_coefficient: 0.0 }
}

/// A fracture by what the equations see of it for η = 1: d_f³/12 and T_f.
pub(crate) fn fracture(conductivity: f64, transmissivity: f64) -> Fracture {
    let aperture = (12.0 * conductivity).cbrt();
    Fracture { normal_permeability: 0.5 * transmissivity * aperture, aperture: aperture.into() }
}

pub(crate) fn steady(mesh: &Arc<Mesh>, model: FlowModel) -> (Flow, StepReport) {
    let mut flow = Flow::new(mesh.clone(), model).unwrap();
    let inputs = flow.inputs();
    let report = flow.steady(&inputs).unwrap();
    (flow, report)
}

pub(crate) fn full_tensor() -> Tensor {
    Tensor::from_cols_array(&[3.0, 0.8, -0.4, 0.8, 1.0, 0.3, -0.4, 0.3, 2.0])
}

/// Largest |a − b|.
pub(crate) fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The least of the observed orders of errors on meshes of sizes h.
pub(crate) fn order(sizes: &[f64], errors: &[f64]) -> f64 {
    (1..sizes.len())
        .map(|k| (errors[k - 1] / errors[k]).ln() / (sizes[k - 1] / sizes[k]).ln())
        .fold(f64::INFINITY, f64::min)
}

/// What came in through a boundary tag.
pub(crate) fn inflow(mesh: &Mesh, report: &StepReport, tag: &str) -> flow_fmu::Inflow {
    report.inflow[mesh.data().tags.iter().position(|t| t == tag).unwrap()]
}
