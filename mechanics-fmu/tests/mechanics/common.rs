//! Meshes and problems that several tests share.

use std::sync::Arc;

use mechanics_fmu::{
    BoundaryPoint, Bubbles, Dirichlet, FractureLaw, Friction, Material, Mechanics, Model, Outcome, Partner, Place,
    State, StepReport,
};
use mesh::generate::{Triangles, agglomerate, cartesian, dual, kershaw, perturb, simplices, tag_box};
use mesh::{Mesh, MeshData, Vec3, zoo};

pub(crate) const BOTH: [Bubbles; 2] = [Bubbles::OneSided, Bubbles::TwoSided];
pub(crate) const SIDES: [&str; 6] = ["left", "right", "front", "back", "bottom", "top"];

pub(crate) fn mesh(data: MeshData) -> Arc<Mesh> {
    Arc::new(Mesh::new(data).unwrap_or_else(|e| panic!("{e}")))
}

/// The whole zoo, with the tags of a box: all its domains are boxes.
pub(crate) fn animals() -> impl Iterator<Item = (&'static str, Arc<Mesh>)> {
    zoo::all().into_iter().map(|mut animal| {
        let [low, high] = bounds(&animal.data.vertices);
        tag_box(&mut animal.data, low, high);
        (animal.name, mesh(animal.data))
    })
}

pub(crate) fn bounds(points: &[Vec3]) -> [Vec3; 2] {
    points.iter().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], &p| [low.min(p), high.max(p)])
}

/// Fractured unit squares and cubes of all families, small: an X in 2D, a T in 3D, both with tips.
pub(crate) fn fractured(family: &str) -> MeshData {
    let boxes = |dim: usize, n: usize| {
        let mut data = cartesian(Vec3::ZERO, Vec3::ONE, if dim == 2 { [n, n, 0] } else { [n; 3] });
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let inside = |x: f64| x > 0.24 && x < 0.76;
        if dim == 2 {
            data.mark_fracture("flat", |x| near(x.y, 0.5) && inside(x.x));
            data.mark_fracture("upright", |x| near(x.x, 0.5) && inside(x.y));
        } else {
            data.mark_fracture("flat", |x| near(x.z, 0.5) && x.x < 0.76);
            data.mark_fracture("upright", |x| near(x.x, 0.5) && x.z < 0.51 && x.z > 0.24);
        }
        data
    };
    let network = || {
        let x = |name, a, b| (name, [a, b]);
        let lines = [x("flat", [0.15, 0.4], [0.85, 0.6]), x("upright", [0.4, 0.85], [0.6, 0.15])];
        let start = Triangles::rectangle([0.0; 2], [1.0; 2], 0.25);
        let made = lines.iter().fold(start, |t, (name, ends)| t.fracture(name, ends, 0.08));
        made.build().unwrap()
    };
    match family {
        "squares" => boxes(2, 8),
        "perturbed squares" => perturb(&mesh(boxes(2, 8)), 0.2, 1),
        "triangles" => network(),
        "polygons" => dual(&mesh(network())).unwrap(),
        "cubes" => boxes(3, 4),
        "perturbed hexahedra" => perturb(&mesh(boxes(3, 4)), 0.15, 1),
        "tetrahedra" => simplices(&mesh(boxes(3, 4))).unwrap(),
        "polyhedra" => agglomerate(&mesh(fractured("tetrahedra")), 4).unwrap(),
        "Kershaw hexahedra" => {
            let mut data = kershaw(Vec3::ZERO, Vec3::ONE, [6, 3, 3], 0.4);
            data.mark_fracture("upright", |x| (x.x - 0.5).abs() < 1e-9);
            data
        }
        _ => panic!("no family {family}"),
    }
}

pub(crate) fn rock() -> Material {
    Material { young_modulus: 10e9, poisson_ratio: 0.25, biot_coefficient: 0.7 }
}

/// One rock and one law everywhere.
pub(crate) fn model(mesh: &Mesh, law: &FractureLaw) -> Model {
    let data = mesh.data();
    Model {
        materials: data.regions.iter().map(|name| (name.clone(), rock())).collect(),
        fractures: data.fractures.iter().map(|name| (name.clone(), law.clone())).collect(),
        ..Model::default()
    }
}

/// Coulomb's law with the aperture 1e-4 m.
pub(crate) fn coulomb(coefficient: f64, cohesion: f64) -> FractureLaw {
    FractureLaw { friction: Friction::Coulomb { coefficient, cohesion }, ..FractureLaw::coulomb(0.0, 1e-4) }
}

/// Prescribes the displacement on some sides.
pub(crate) fn hold(
    model: &mut Model,
    dim: usize,
    sides: &[&str],
    value: impl Fn(&BoundaryPoint, f64) -> Vec3 + Send + Sync + 'static,
) {
    let value = Arc::new(value);
    for side in sides {
        for component in 0..dim {
            let value = Arc::clone(&value);
            let value = Arc::new(move |p: &BoundaryPoint, t: f64| value(p, t)[component]);
            model.dirichlet.push(Dirichlet { place: Place::Tag((*side).into()), component, value });
        }
    }
}

/// The box's sides in this dimension, but for some.
pub(crate) fn sides_without(dim: usize, without: &[&str]) -> Vec<&'static str> {
    SIDES.into_iter().filter(|s| !without.contains(s) && (dim == 3 || !["front", "back"].contains(s))).collect()
}

pub(crate) fn start(mesh: &Arc<Mesh>, model: Model) -> Mechanics {
    Mechanics::new(Arc::clone(mesh), model).unwrap_or_else(|e| panic!("{e}"))
}

pub(crate) fn step(mechanics: &mut Mechanics, from: &State, time: f64, partner: &Partner) -> (State, StepReport) {
    match mechanics.step(from, time, partner) {
        Ok(Outcome::Converged(state, report)) => (state, report),
        Ok(Outcome::Discarded(why, report)) => panic!("{why}: {report:?}"),
        Err(e) => panic!("{e}"),
    }
}

pub(crate) fn initial(mechanics: &mut Mechanics, time: f64, partner: &Partner) -> State {
    match mechanics.initial_equilibrium(time, partner) {
        Ok(Outcome::Converged(state, _)) => state,
        other => panic!("{other:?}"),
    }
}

/// A vector over the face's basis as one in space.
pub(crate) fn vector(mechanics: &Mechanics, face: usize, local: &[f64]) -> Vec3 {
    let d = mechanics.mesh().dim();
    local[face * d..][..d].iter().zip(mechanics.space().basis(face)).map(|(v, e)| *v * *e).sum()
}

pub(crate) fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |m, v| if v.abs() <= m { m } else { v.abs() })
}
