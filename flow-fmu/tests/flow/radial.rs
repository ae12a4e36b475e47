//! The pressure in a well against closed forms, on all kinds of cells: the logarithm around a well that goes through, the
//! line source around one that does not.

use std::f64::consts::PI;
use std::sync::Arc;

use flow_fmu::{
    Boundary, Condition, Control, Flow, FlowModel, Fracture, Rock, SpaceTimeFunction, StepReport, Tensor, Well,
    WellIndex, WellPlace,
};
use mesh::generate::{Triangles, cartesian, dual, extrude, perturb, simplices};
use mesh::{Mat3, Mesh, MeshData, Vec3};

use super::common::*;

const RADIUS: f64 = 1e-4;

/// Part of the pressure between the boundary and the well that the pressure in the well may be off.
const ACCURACY: f64 = 0.005;

/// The pressure around a line through `at` along `direction` that injects 1 m³/s per metre (η = 1), 0 at the wall of a well.
#[derive(Clone, Copy)]
struct Logarithm {
    at: Vec3,
    direction: Vec3,
    tensor: Tensor,
}

impl Logarithm {
    /// Distance of `x` from the line in the metric of K⁻¹, in which p is a function of it alone.
    fn distance(&self, x: Vec3) -> f64 {
        let (inverse, to, e) = (self.tensor.inverse(), x - self.at, self.direction);
        let across = to - to.dot(inverse * e) / e.dot(inverse * e) * e;
        across.dot(inverse * across).sqrt()
    }

    /// Mean of ln ρ on the wall: an isobaric wall at the same rate, or a wall that lets the same through everywhere.
    fn wall(&self) -> f64 {
        const POINTS: usize = 360;
        let u = self.direction.any_orthonormal_vector();
        let v = self.direction.cross(u);
        let at = |i: usize| {
            let (sin, cos) = (2.0 * PI * i as f64 / POINTS as f64).sin_cos();
            self.distance(self.at + RADIUS * (cos * u + sin * v)).ln()
        };
        (0..POINTS).map(at).sum::<f64>() / POINTS as f64
    }

    fn pressure(&self, x: Vec3) -> f64 {
        let e = self.direction;
        let strength = 2.0 * PI * (self.tensor.determinant() * e.dot(self.tensor.inverse() * e)).sqrt();
        (self.wall() - self.distance(x).ln()) / strength
    }
}

fn well(name: impl ToString, at: Vec3, direction: Vec3, control: Control) -> Well {
    let index = Some(WellIndex::Radius { radius: RADIUS, direction });
    Well { name: name.to_string(), place: WellPlace::Cell(at), index, control, limit: None }
}

/// Tags the boundary where the well does not go through and `is_open`: there the pressure is given.
fn with_sides(data: MeshData, direction: Vec3, is_open: impl Fn(Vec3) -> bool) -> Arc<Mesh> {
    let mut data = data;
    data.face_tag.fill(None);
    data.tags.clear();
    let mesh = Mesh::new(data).unwrap();
    let mut data = mesh.data().clone();
    let sides = data.tag("sides");
    for face in (0..mesh.face_count()).filter(|&f| mesh.is_boundary(f)) {
        let through = mesh.geometry().face_normal(face).dot(direction).abs() > 0.5;
        data.face_tag[face] = (!through && is_open(mesh.geometry().face_center[face])).then_some(sides);
    }
    Arc::new(Mesh::new(data).unwrap())
}

/// The wells of a mesh with an exact pressure on its sides, and the largest difference of pressure from that in the well.
fn run(
    mesh: &Arc<Mesh>,
    tensor: Tensor,
    wells: Vec<Well>,
    exact: impl Fn(Vec3) -> f64 + Send + Sync + Clone + 'static,
) -> (StepReport, f64) {
    let mut model = all_pressure(mesh, tensor, 0.0.into());
    let p = exact.clone();
    model.boundaries = vec![("sides".into(), Boundary::pressure(SpaceTimeFunction::new(move |x, _| p(x))))];
    model.wells = wells;
    let (_, report) = steady(mesh, model);
    let sides = mesh.tagged_faces("sides").map(|f| exact(mesh.geometry().face_center[f]).abs());
    (report, sides.fold(0.0, f64::max))
}

/// The relative error of a well along `direction` through `at`, of this length.
fn error(data: MeshData, tensor: Tensor, direction: Vec3, at: Vec3, length: f64) -> f64 {
    let tensor_seen = if data.dim == 2 {
        Tensor::from_cols(tensor.x_axis.with_z(0.0), tensor.y_axis.with_z(0.0), Vec3::Z)
    } else {
        tensor
    };
    let exact = Logarithm { at, direction, tensor: tensor_seen };
    let mesh = with_sides(data, direction, |_| true);
    let wells = vec![well("w", at, direction, Control::Rate(length))];
    let (report, drop) = run(&mesh, tensor, wells, move |x| exact.pressure(x));
    report.wells[0].pressure / drop
}

fn check(name: &str, error: f64) {
    assert!(error.abs() < ACCURACY, "{name}: the pressure in the well is off by {:.2} %", 100.0 * error);
}

fn flat(n: [usize; 2]) -> MeshData {
    cartesian(Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 0.0), [n[0], n[1], 0])
}

fn triangles(n: usize) -> MeshData {
    Triangles::rectangle([-1.0, -1.0], [1.0, 1.0], 2.0 / n as f64).build().unwrap()
}

fn checked(data: MeshData) -> Mesh {
    Mesh::new(data).unwrap()
}

/// Isotropic, along the axes, and with all entries.
fn tensors() -> [Tensor; 3] {
    let diagonal = Tensor::from_diagonal(Vec3::new(5.0, 1.0, 2.0));
    [Tensor::IDENTITY, diagonal, full_tensor()]
}

/// The centre of a cell, where cells meet or nearly so, and somewhere.
const PLACES: [Vec3; 3] = [Vec3::ZERO, Vec3::new(0.0951, 0.0951, 0.0), Vec3::new(0.13, -0.07, 0.0)];

#[test]
fn long_cells() {
    for tensor in tensors() {
        for n in [[21, 21], [42, 21], [84, 21], [21, 168]] {
            for at in PLACES {
                check(&format!("{n:?} cells, {tensor}, {at}"), error(flat(n), tensor, Vec3::Z, at, 1.0));
            }
        }
    }
}

#[test]
fn cells_of_all_kinds_in_2d() {
    for tensor in tensors() {
        for at in PLACES {
            for (name, data) in [
                ("triangles", triangles(21)),
                ("polygons", dual(&checked(triangles(21))).unwrap()),
                ("quadrilaterals", perturb(&checked(flat([21, 21])), 0.2, 1)),
            ] {
                check(&format!("{name}, {tensor}, {at}"), error(data, tensor, Vec3::Z, at, 1.0));
            }
        }
    }
}

const HEIGHT: f64 = 0.3;

fn slab(n: usize, layers: usize) -> MeshData {
    cartesian(Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, HEIGHT), [n, n, layers])
}

/// K with z a principal axis: else the exact pressure sends fluid through top and bottom.
fn upright_tensors() -> [Tensor; 2] {
    let full = Tensor::from_cols_array(&[3.0, 0.8, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0, 1.0]);
    [Tensor::IDENTITY, full]
}

#[test]
fn cells_of_all_kinds_in_3d() {
    for tensor in upright_tensors() {
        for at in PLACES {
            for (name, data) in [
                ("boxes", slab(15, 1)),
                ("tetrahedra", simplices(&checked(slab(15, 1))).unwrap()),
                (
                    "hexahedra",
                    extrude(&checked(perturb(&checked(flat([15, 15])), 0.2, 1)), &[0.0, HEIGHT], |_, _| true).unwrap(),
                ),
                ("prisms of triangles", extrude(&checked(triangles(15)), &[0.0, HEIGHT], |_, _| true).unwrap()),
                (
                    "prisms of polygons",
                    extrude(&checked(dual(&checked(triangles(15))).unwrap()), &[0.0, HEIGHT], |_, _| true).unwrap(),
                ),
            ] {
                let at = at.with_z(0.4 * HEIGHT);
                check(&format!("{name}, {tensor}, {at}"), error(data, tensor, Vec3::Z, at, HEIGHT));
            }
        }
    }
}

#[test]
fn wells_in_any_direction() {
    // The slab lies on its side, or anyhow.
    for turn in
        [Mat3::from_cols(Vec3::Y, Vec3::Z, Vec3::X), Mat3::from_axis_angle(Vec3::new(1.0, 2.0, -1.0).normalize(), 0.8)]
    {
        for tensor in upright_tensors() {
            for data in [slab(15, 1), simplices(&checked(slab(15, 1))).unwrap()] {
                let mut data = data;
                data.map_vertices(|x| turn * x);
                let at = turn * Vec3::new(0.13, -0.07, 0.4 * HEIGHT);
                let turned = turn * tensor * turn.transpose();
                let symmetric = 0.5 * (turned + turned.transpose());
                check(&format!("{turn}"), error(data, symmetric, turn * Vec3::Z, at, HEIGHT));
            }
        }
    }
}

/// Wells in the layers of a mesh hold the same pressure, and inject what one through all of them does.
#[test]
fn wells_that_follow_one_another_are_one() {
    for tensor in upright_tensors() {
        for (name, data, layers) in [
            ("3 layers", slab(15, 3), 3),
            ("10 thin layers", slab(15, 10), 10),
            ("hexahedra", perturb(&checked(slab(15, 3)), 0.2, 1), 3),
        ] {
            let at = Vec3::new(0.13, -0.07, 0.0);
            let exact = Logarithm { at, direction: Vec3::Z, tensor };
            let wells = (0..layers).map(|i| {
                let z = HEIGHT * (i as f64 + 0.5) / layers as f64;
                well(i, at.with_z(z), Vec3::Z, Control::Pressure(0.0))
            });
            let mesh = with_sides(data, Vec3::Z, |_| true);
            let (report, _) = run(&mesh, tensor, wells.collect(), move |x| exact.pressure(x));
            let rate: f64 = report.wells.iter().map(|w| w.rate).sum();
            check(&format!("{name}, {tensor}"), rate / HEIGHT - 1.0);
        }
    }
}

/// One of many layers: the line source of even strength, its mean on the wall of the well.
#[test]
fn a_short_well_has_flow_around_its_ends() {
    for (cells, half, length) in
        [([15, 15, 15], 1.0, 2.0 / 15.0), ([15, 15, 75], 1.0, 2.0 / 75.0), ([31, 31, 5], 1.0, 0.4)]
    {
        for direction in [Vec3::Z, Vec3::X] {
            let turn = if direction == Vec3::Z { Mat3::IDENTITY } else { Mat3::from_cols(Vec3::Y, Vec3::Z, Vec3::X) };
            let mut data = cartesian(Vec3::splat(-half), Vec3::splat(half), cells);
            data.map_vertices(|x| turn * x);
            // The points of the source, and the mean over its length of 1/(4πr) at its wall.
            const POINTS: usize = 4000;
            let z = move |i: usize| length * ((i as f64 + 0.5) / POINTS as f64 - 0.5);
            let exact = move |x: Vec3| {
                let part = |i: usize| (4.0 * PI * (x - z(100 * i + 50) * direction).length()).recip();
                (0..POINTS / 100).map(part).sum::<f64>() / (POINTS / 100) as f64
            };
            let at_wall = |s: f64| {
                let to = |end: f64| ((end - s) / RADIUS).asinh();
                (to(0.5 * length) - to(-0.5 * length)) / (4.0 * PI * length)
            };
            let expected = (0..POINTS).map(|i| at_wall(z(i))).sum::<f64>() / POINTS as f64;
            let mesh = with_sides(data, Vec3::ZERO, |_| true);
            let wells = vec![well("w", Vec3::ZERO, direction, Control::Rate(1.0))];
            let (report, _) = run(&mesh, Tensor::IDENTITY, wells, exact);
            check(&format!("{cells:?} cells along {direction}"), report.wells[0].pressure / expected - 1.0);
        }
    }
}

/// A sand of one layer between shales: radial flow, and the same as without the shales.
#[test]
fn tight_rock_ends_the_flow() {
    let mut data = cartesian(Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 3.0 * HEIGHT), [15, 15, 3]);
    data.assign_regions(|x| (x.z < HEIGHT || x.z > 2.0 * HEIGHT).then_some("shale"));
    let mesh = with_sides(data, Vec3::Z, |x| x.z > HEIGHT && x.z < 2.0 * HEIGHT);
    let at = Vec3::new(0.13, -0.07, 1.4 * HEIGHT);
    let exact = Logarithm { at, direction: Vec3::Z, tensor: Tensor::IDENTITY };
    let mut model = all_pressure(&mesh, Tensor::IDENTITY, 0.0.into());
    model.rocks.iter_mut().filter(|r| r.0 == "shale").for_each(|r| r.1.permeability *= 1e-6);
    let p = SpaceTimeFunction::new(move |x, _| exact.pressure(x));
    model.boundaries = vec![("sides".into(), Boundary::pressure(p))];
    model.wells.push(well("w", at, Vec3::Z, Control::Rate(HEIGHT)));
    let (_, report) = steady(&mesh, model);
    check("sand", report.wells[0].pressure / -exact.pressure(Vec3::new(1.0, 1.0, 0.0)));
}

/// Planes of symmetry through the well: a half and a quarter of its flow.
#[test]
fn wells_on_the_boundary_inject_into_what_is_there() {
    for (low, part) in [([-1.0, 0.0], 0.5), ([0.0, 0.0], 0.25)] {
        for height in [0.0, HEIGHT] {
            let (low, high) = (Vec3::new(low[0], low[1], 0.0), Vec3::new(1.0, 1.0, height));
            let n = [if part == 0.25 { 11 } else { 21 }, 11, usize::from(height > 0.0)];
            let tensor = Tensor::from_diagonal(Vec3::new(3.0, 1.0, 1.0));
            let exact = Logarithm { at: Vec3::ZERO, direction: Vec3::Z, tensor };
            let on_plane = move |x: Vec3| x.y < 1e-9 || (part == 0.25 && x.x < 1e-9);
            let mesh = with_sides(cartesian(low, high, n), Vec3::Z, |x| !on_plane(x));
            let length = if height > 0.0 { height } else { 1.0 };
            let wells = vec![well("w", Vec3::ZERO.with_z(0.5 * height), Vec3::Z, Control::Rate(part * length))];
            let (report, drop) = run(&mesh, tensor, wells, move |x| exact.pressure(x));
            check(&format!("{part} of a turn"), report.wells[0].pressure / drop);
        }
    }
}

/// In a fracture whose walls are sealed flow is radial, whatever its faces are like.
#[test]
fn wells_in_fractures_in_3d() {
    const CONDUCTIVITY: f64 = 3.0;
    let cube = |n: [usize; 3]| {
        let mut data = cartesian(Vec3::splat(-1.0), Vec3::ONE, n);
        data.mark_fracture("f", |x| x.x == 0.0);
        data
    };
    for (name, data) in [
        ("squares", cube([2, 15, 15])),
        ("long faces", cube([2, 15, 60])),
        ("triangles", simplices(&checked(cube([2, 15, 15]))).unwrap()),
    ] {
        for at in [Vec3::ZERO, Vec3::new(0.0, 0.13, -0.07)] {
            let mesh = mesh(data.clone());
            let exact = Logarithm { at, direction: Vec3::X, tensor: Tensor::IDENTITY };
            let aperture = (12.0 * CONDUCTIVITY).cbrt();
            let p = SpaceTimeFunction::new(move |x, _| exact.pressure(x) / CONDUCTIVITY);
            let sides = Boundary { matrix: Condition::Pressure(0.0.into()), fracture: Some(Condition::Pressure(p)) };
            let mut model = all_pressure(&mesh, Tensor::IDENTITY, 0.0.into());
            model.boundaries.iter_mut().for_each(|boundary| boundary.1 = sides.clone());
            model.fractures.push(("f".into(), Fracture { normal_permeability: 0.0, aperture: aperture.into() }));
            model.wells.push(Well { place: WellPlace::FractureFace(at), ..well("w", at, Vec3::X, Control::Rate(1.0)) });
            let (_, report) = steady(&mesh, model);
            let drop = -exact.pressure(Vec3::new(0.0, 1.0, 1.0)) / CONDUCTIVITY;
            check(&format!("{name}, {at}"), report.wells[0].pressure / drop);
        }
    }
}

/// Flow up and down tall cells, which one of many tetrahedra cannot bring about: its pressure is beyond that in a thin well. A
/// rate has a pressure all the same; a pressure is refused.
#[test]
fn a_cell_unlike_the_flow_around_it() {
    let data = simplices(&checked(slab(15, 1))).unwrap();
    let tensor = Tensor::from_diagonal(Vec3::new(1.0, 1.0, 0.1));
    let at = Vec3::new(0.13, -0.07, 0.4 * HEIGHT);
    check("tall tetrahedra", error(data.clone(), tensor, Vec3::Z, at, HEIGHT));
    let mesh = with_sides(data, Vec3::Z, |_| true);
    let mut model = all_pressure(&mesh, tensor, 0.0.into());
    model.boundaries = vec![("sides".into(), Boundary::pressure(0.0))];
    model.wells = vec![well("w", at, Vec3::Z, Control::Pressure(1.0))];
    let refused = Flow::new(mesh.clone(), model.clone()).err().unwrap().to_string();
    assert!(refused.contains("to hold a pressure"), "{refused}");
    model.wells[0].control = Control::Rate(1.0);
    let mut flow = Flow::new(mesh, model).unwrap();
    let mut inputs = flow.inputs();
    inputs.wells[0] = Control::Pressure(1.0);
    assert!(flow.steady(&inputs).unwrap_err().to_string().contains("to hold a pressure"));
}

/// A well with a rate alone: no index, no radius; its pressure is said to be that of its cell.
#[test]
fn a_rate_needs_no_index() {
    let mesh = with_sides(flat([5, 5]), Vec3::Z, |_| true);
    let mut plain = well("w", Vec3::ZERO, Vec3::Z, Control::Rate(2.0));
    plain.index = None;
    let mut model: FlowModel = all_pressure(&mesh, Tensor::IDENTITY, 0.0.into());
    model.boundaries = vec![("sides".into(), Boundary { matrix: Condition::Pressure(0.0.into()), fracture: None })];
    model.rocks = vec![("rock".into(), Rock::isotropic(1.0, 0.1, None))];
    model.wells = vec![plain];
    let (flow, report) = steady(&mesh, model);
    assert_eq!(report.wells[0].rate, 2.0);
    assert_eq!(report.wells[0].pressure, flow.state().matrix_pressure[12]);
    assert!(report.wells[0].pressure > 0.0);
}
