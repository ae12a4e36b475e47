//! Affine pressures are reproduced to round-off, on any mesh.

use flow_fmu::{Boundary, Condition, SpaceTimeFunction};
use mesh::{Mesh, Vec3};

use super::common::*;

fn affine(x: Vec3) -> f64 {
    1.5 + GRADIENT.dot(x)
}

const GRADIENT: Vec3 = Vec3::new(0.7, -1.3, 2.1);

/// Errors of pressures of size 1 to 4 and permeabilities of size 3: a few hundred units of round-off, more where a
/// tiny face makes a stiff cell.
const ROUND_OFF: f64 = 1e-11;

fn in_dim(mesh: &Mesh) -> Vec3 {
    if mesh.dim() == 2 { GRADIENT.with_z(0.0) } else { GRADIENT }
}

#[test]
fn affine_pressure_with_a_full_tensor() {
    let mut unseen = 0;
    for name in ZOO {
        let n = if name == "large clumps of triangles" { 12 } else { 3 };
        let mesh = mesh(family(name, n));
        let (flow, report) =
            steady(&mesh, all_pressure(&mesh, full_tensor(), SpaceTimeFunction::new(|x, _| affine(x))));
        let velocity = -(full_tensor() * in_dim(&mesh));
        let fluxes = flow.fluxes().unwrap();
        for cell in 0..mesh.cell_count() {
            let error = flow.state().matrix_pressure[cell] - affine(flow.space().cell_point(cell));
            assert!(error.abs() < ROUND_OFF, "{name}: pressure of cell {cell} is off by {error:e}");
            let error = (fluxes.cell_velocity[cell] - velocity).truncate().length();
            assert!(error < 100.0 * ROUND_OFF, "{name}: velocity in cell {cell} is off by {error:e}");
        }
        for face in 0..mesh.face_count() {
            let exact = velocity.dot(mesh.geometry().face_vector[face]);
            let error = fluxes.face[face] - exact;
            assert!(error.abs() < 10.0 * ROUND_OFF, "{name}: flux of face {face} is off by {error:e}");
        }
        assert!(report.balance.cell <= 1e-13 * report.balance.throughput, "{name}: {:?}", report.balance);
        assert!(report.balance.total < ROUND_OFF);
        unseen += flow.space().unseen_cells().len();
    }
    assert!(unseen > 0, "also cells that their centre does not see whole");
}

#[test]
fn affine_pressure_on_the_zoo_of_the_mesh() {
    for mesh::zoo::Specimen { name, mut data, .. } in mesh::zoo::all() {
        let low = data.vertices.iter().copied().reduce(Vec3::min).unwrap();
        let size = (data.vertices.iter().copied().reduce(Vec3::max).unwrap() - low).length();
        let exact = move |x: Vec3| affine((x - low) / size);
        data.face_fracture.fill(None);
        data.fractures.clear();
        data.face_tag.fill(None);
        data.tags.clear();
        data.tag_boundary(|_| Some("all"));
        let mesh = super::common::mesh(data);
        let mut model = all_pressure(&mesh, full_tensor(), 0.0.into());
        model.boundaries = vec![("all".into(), Boundary::pressure(SpaceTimeFunction::new(move |x, _| exact(x))))];
        model.planarity = 1e-10;
        let (flow, report) = steady(&mesh, model);
        let velocity = -(full_tensor() * in_dim(&mesh)) / size;
        for cell in 0..mesh.cell_count() {
            let error = flow.state().matrix_pressure[cell] - exact(flow.space().cell_point(cell));
            assert!(error.abs() < 10.0 * ROUND_OFF, "{name}: pressure of cell {cell} is off by {error:e}");
        }
        let largest = mesh.geometry().face_measure.iter().fold(0.0f64, |m, a| m.max(*a));
        for face in 0..mesh.face_count() {
            let error = flow.fluxes().unwrap().face[face] - velocity.dot(mesh.geometry().face_vector[face]);
            let scale = largest * velocity.length();
            assert!(error.abs() < 100.0 * ROUND_OFF * scale, "{name}: flux of face {face} is off by {error:e}");
        }
        assert!(report.balance.total < 1000.0 * report.balance.round_off, "{name}: {:?}", report.balance);
    }
}

/// The conductivity is small for the sake of one specimen, a fracture of one face of 1e-6 m with two tips: what it
/// exchanges must not drown in the round-off of what it conducts.
#[test]
fn constant_pressure_on_the_zoo_with_its_fractures() {
    for mesh::zoo::Specimen { name, mut data, .. } in mesh::zoo::all() {
        data.face_tag.fill(None);
        data.tags.clear();
        data.tag_boundary(|_| Some("all"));
        let mesh = super::common::mesh(data);
        let mut model = all_pressure(&mesh, full_tensor(), 0.0.into());
        model.fractures = mesh.data().fractures.iter().map(|f| (f.clone(), fracture(1e-8, 2.0))).collect();
        model.boundaries = vec![("all".into(), Boundary::pressure(4.0))];
        let (flow, _) = steady(&mesh, model);
        let pressures = flow.state().matrix_pressure.iter().chain(flow.fracture_pressure());
        let worst = pressures.map(|p| (p - 4.0).abs()).fold(0.0, f64::max);
        assert!(worst < 100.0 * ROUND_OFF, "{name}: off by {worst:e}");
    }
}

/// Coordinates in single precision: faces stay whole, and what that costs is the accuracy of the coordinates.
#[test]
fn noise_in_coordinates_splits_no_face() {
    const SINGLE: f64 = 1.2e-7;
    let unknowns = |data: mesh::MeshData, planarity: Option<f64>| {
        let mesh = mesh(data);
        let exact = SpaceTimeFunction::new(|x: Vec3, _| affine(x / 1000.0));
        let mut model = all_pressure(&mesh, full_tensor(), exact);
        model.planarity = planarity.unwrap_or(model.planarity);
        let (flow, _) = steady(&mesh, model);
        let error = |cell| flow.state().matrix_pressure[cell] - affine(flow.space().cell_point(cell) / 1000.0);
        let worst = (0..mesh.cell_count()).map(|cell| f64::abs(error(cell))).fold(0.0, f64::max);
        (flow.unknowns(), flow.space().facet_count() - mesh.face_count(), worst)
    };
    let clean = mesh::generate::cartesian(Vec3::ZERO, Vec3::splat(1000.0), [6; 3]);
    let mut noisy = clean.clone();
    noisy.map_vertices(|x| {
        let noise = |v: f64| v * (1.0 + SINGLE * (1e5 * (x.x + 3.1 * x.y + 0.7 * x.z)).sin());
        Vec3::new(noise(x.x), noise(x.y), noise(x.z))
    });
    let (whole, split, _) = unknowns(clean, None);
    assert_eq!(split, 0);
    let (noisy_whole, split, error) = unknowns(noisy.clone(), None);
    assert!(noisy_whole == whole && split == 0 && error < 1e-6, "{noisy_whole} for {whole}, error {error:e}");
    let (many, split, error) = unknowns(noisy, Some(0.0));
    assert!(many > 3 * whole && split > 0 && error < 10.0 * ROUND_OFF, "{many} for {whole}, error {error:e}");
}

#[test]
fn affine_pressure_from_inflow_data() {
    // Neumann data on all sides but one.
    for name in ["polygons", "polyhedra", "perturbed cubes"] {
        let mesh = mesh(family(name, 3));
        let mut model = all_pressure(&mesh, full_tensor(), SpaceTimeFunction::new(|x, _| affine(x)));
        let velocity = -(full_tensor() * in_dim(&mesh));
        for (tag, boundary) in &mut model.boundaries {
            let axis = sides(&mesh).iter().position(|s| s == tag).unwrap();
            let normal = Vec3::AXES[axis / 2] * if axis % 2 == 0 { -1.0 } else { 1.0 };
            if tag != "right" {
                *boundary = Boundary::inflow(-velocity.dot(normal));
            }
        }
        let (flow, _) = steady(&mesh, model);
        for cell in 0..mesh.cell_count() {
            let error = flow.state().matrix_pressure[cell] - affine(flow.space().cell_point(cell));
            assert!(error.abs() < 10.0 * ROUND_OFF, "{name}: cell {cell} is off by {error:e}");
        }
    }
}

#[test]
fn hydrostatic_rest_is_kept_to_round_off() {
    // 2000 m of water, in the rock and in a fracture, in time steps and in the steady state.
    for dim in [2, 3] {
        let n = if dim == 2 { [4, 4, 0] } else { [4, 4, 4] };
        let mut data = mesh::generate::cartesian(Vec3::ZERO, Vec3::splat(2000.0), n);
        data.mark_fracture("fault", |x| x.x == 1000.0 && x.y >= 500.0);
        let mesh = mesh(data);
        let up = if dim == 2 { Vec3::Y } else { Vec3::Z };
        let mut model =
            flow_fmu::FlowModel::new(flow_fmu::Fluid { viscosity: 1e-3, density: 1000.0, bulk_modulus: Some(2.18e9) });
        model.gravity = -10.0 * up;
        model.rocks.push(("rock".into(), flow_fmu::Rock::isotropic(1e-15, 0.1, Some(1e10))));
        model
            .fractures
            .push(("fault".into(), flow_fmu::Fracture { normal_permeability: 1e-12, aperture: 1e-4.into() }));
        let top = 2000.0 * up;
        model.initial_pressure = model.hydrostatic(5e6, top);
        model.boundaries.push(("right".into(), Boundary::pressure(model.initial_pressure.clone())));
        let mut flow = flow_fmu::Flow::new(mesh, model).unwrap();
        let before = flow.state().clone();
        let inputs = flow.inputs();
        flow.step(1e5, &inputs).unwrap();
        let report = flow.steady(&inputs).unwrap();
        let after = flow.state();
        assert!(distance(&before.matrix_pressure, &after.matrix_pressure) < 1e-14 * 2.5e7 * 100.0);
        assert!(distance(&before.traces, &after.traces) < 1e-14 * 2.5e7 * 100.0);
        let through = flow.fluxes().unwrap().cell_velocity.iter().map(|v| v.length()).fold(0.0, f64::max);
        // Gravity alone would drive K/η ρ g = 1e-8 m/s.
        assert!(through < 1e-12 * 1e-8, "{through:e} m/s");
        assert!(report.inflow.iter().all(|i| i.matrix.abs() < 1e-8 * 1e-9 * 4e6));
    }
}

#[test]
fn flow_along_a_fracture_is_exact() {
    // p is affine, and K ∇p lies in the fracture's plane: nothing is exchanged.
    for dim in [2, 3] {
        let n = if dim == 2 { [4, 3, 0] } else { [4, 3, 3] };
        let mut data = unit(n);
        data.mark_fracture("f", |x| x.x == 0.5);
        let mesh = mesh(data);
        let along = if dim == 2 { Vec3::Y } else { Vec3::new(0.0, 1.0, -0.5) };
        let gradient = full_tensor().inverse() * along;
        let gradient = if dim == 2 {
            // In 2D only the upper left 2 × 2 block acts.
            let k = full_tensor();
            let det = k.x_axis.x * k.y_axis.y - k.x_axis.y.powi(2);
            Vec3::new(-k.x_axis.y / det, k.x_axis.x / det, 0.0)
        } else {
            gradient
        };
        let exact = move |x: Vec3| gradient.dot(x);
        let mut model = all_pressure(&mesh, full_tensor(), SpaceTimeFunction::new(move |x, _| exact(x)));
        model.fractures.push(("f".into(), fracture(2.5, 7.0)));
        let (flow, report) = steady(&mesh, model);
        for (i, p) in flow.fracture_pressure().iter().enumerate() {
            assert!((p - exact(flow.space().fracture_point(i))).abs() < ROUND_OFF);
        }
        let fluxes = flow.fluxes().unwrap();
        assert!(fluxes.exchange.iter().flatten().all(|q| q.abs() < ROUND_OFF));
        let in_plane = gradient - gradient.dot(Vec3::X) * Vec3::X;
        assert!(fluxes.fracture_velocity.iter().all(|v| (*v + 2.5 * in_plane).length() < 10.0 * ROUND_OFF));
        // Energy: all that comes in through the boundary is dissipated.
        assert!(report.energy.defect().abs() < 1e-12 * report.energy.dissipation());
        assert!(report.energy.fracture_dissipation > 0.0 && report.energy.exchange_dissipation < 1e-20);
    }
}

#[test]
fn bent_fracture_faces_are_exact() {
    // A fracture whose faces are not planar: many facets on each side, one exchange. The pressure is constant.
    let mut data = unit([3, 3, 4]);
    data.mark_fracture("f", |x| x.z == 0.5);
    for x in &mut data.vertices {
        x.z += 0.1 * (3.0 * x.x).sin() * (4.0 * x.y).cos() * x.z * (1.0 - x.z);
    }
    let mesh = mesh(data);
    let mut model = all_pressure(&mesh, full_tensor(), 4.0.into());
    model.fractures.push(("f".into(), fracture(2.5, 7.0)));
    let (flow, report) = steady(&mesh, model);
    assert!(flow.space().facet_count() > mesh.face_count());
    assert!(flow.state().matrix_pressure.iter().chain(flow.fracture_pressure()).all(|p| (p - 4.0).abs() < ROUND_OFF));
    assert!(report.balance.throughput < ROUND_OFF);
}

#[test]
fn inflow_into_a_fracture_goes_in() {
    let mut data = unit([4, 4, 0]);
    data.mark_fracture("f", |x| x.y == 0.5);
    let mesh = mesh(data);
    let mut model = all_pressure(&mesh, full_tensor(), 0.0.into());
    model.fractures.push(("f".into(), fracture(1.0, 10.0)));
    let left = model.boundaries.iter_mut().find(|b| b.0 == "left").unwrap();
    left.1.fracture = Some(Condition::Inflow(0.3.into()));
    let (_, report) = steady(&mesh, model);
    assert!((inflow(&mesh, &report, "left").fracture - 0.3).abs() < 1e-15);
    assert!(report.balance.total < 1e-14 && report.balance.edge < 1e-14);
}
