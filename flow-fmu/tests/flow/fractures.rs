//! Fractures with closed-form solutions: blocking, conducting, crossing.

use flow_fmu::{Boundary, Rock, SpaceTimeFunction, Tensor};
use mesh::generate::{Triangles, cartesian};
use mesh::{EdgeKind, Mesh, MeshData, Side, Vec3};

use super::common::*;

#[test]
fn a_blocking_fracture_carries_a_jump() {
    // In series: two halves of the rock of K = 1, and two passages of T_f = 4 into and out of the fracture.
    for name in ["squares", "cubes"] {
        let mut data = family(name, 4);
        data.mark_fracture("f", |x| x.x == 0.5);
        let mesh = mesh(data);
        let mut model = all_pressure(&mesh, Tensor::IDENTITY, 0.0.into());
        model.boundaries = vec![("left".into(), Boundary::pressure(1.0)), ("right".into(), Boundary::pressure(0.0))];
        model.fractures.push(("f".into(), fracture(1e-3, 4.0)));
        let (flow, report) = steady(&mesh, model);
        let flux = 1.0 / (0.5 + 0.25 + 0.25 + 0.5);
        assert!((inflow(&mesh, &report, "left").matrix - flux).abs() < 1e-13);
        for &p in flow.fracture_pressure() {
            assert!((p - 0.5).abs() < 1e-13);
        }
        for &face in &mesh.network().faces {
            let mut sides = flow.face_pressure(face);
            sides.sort_by(f64::total_cmp);
            assert!(distance(&sides, &[0.5 - 0.25 * flux, 0.5 + 0.25 * flux]) < 1e-13);
        }
        // Of the energy 1 × flux that comes in, half is left in the passages.
        assert!((report.energy.exchange_dissipation - 0.5 * flux * flux).abs() < 1e-13);
        assert!(report.energy.defect().abs() < 1e-13);
    }
}

#[test]
fn a_sealed_fracture_lets_nothing_through() {
    let mut data = unit([4, 4, 0]);
    data.mark_fracture("f", |x| x.x == 0.5);
    let mesh = mesh(data);
    let mut model =
        all_pressure(&mesh, Tensor::IDENTITY, SpaceTimeFunction::new(|x, _| if x.x < 0.5 { 2.0 } else { 1.0 }));
    model.boundaries.retain(|b| b.0 == "left" || b.0 == "right" || b.0 == "top");
    model.fractures.push(("f".into(), fracture(1.0, 0.0)));
    let (flow, _) = steady(&mesh, model);
    for cell in 0..mesh.cell_count() {
        let expected = if mesh.geometry().cell_center[cell].x < 0.5 { 2.0 } else { 1.0 };
        assert!((flow.state().matrix_pressure[cell] - expected).abs() < 1e-13);
    }
}

/// On −1 < x < 1 with a fracture at x = 0 and κ = π: p_m = cos(κy) cosh(κ(1 − |x|)), p_f = (cosh κ + κ sinh κ/T) cos(κy)
/// for K = 1, with h_f = (C κ² (cosh κ + κ sinh κ/T) + 2 κ sinh κ) cos(κy). Nothing flows through y = 0 and y = 1.
fn along_and_across(data: MeshData, conductivity: f64, transmissivity: f64) -> (f64, f64) {
    use std::f64::consts::PI as K;
    let mesh = mesh(data);
    let matrix = |x: Vec3| (K * x.y).cos() * (K * (1.0 - x.x.abs())).cosh();
    let amplitude = K.cosh() + K * K.sinh() / transmissivity;
    let source = conductivity * K * K * amplitude + 2.0 * K * K.sinh();
    let mut model = all_pressure(&mesh, Tensor::IDENTITY, SpaceTimeFunction::new(move |x, _| matrix(x)));
    model.boundaries.retain(|b| b.0 == "left" || b.0 == "right");
    model.fractures.push(("f".into(), fracture(conductivity, transmissivity)));
    model.fracture_source = Some(SpaceTimeFunction::new(move |x, _| source * (K * x.y).cos()));
    let (flow, _) = steady(&mesh, model);
    let mut error = [0.0, 0.0];
    let mut size = [0.0, 0.0];
    for cell in 0..mesh.cell_count() {
        let exact = matrix(flow.space().cell_point(cell));
        let measure = mesh.geometry().cell_measure[cell];
        error[0] += measure * (flow.state().matrix_pressure[cell] - exact).powi(2);
        size[0] += measure * exact * exact;
    }
    for (i, &face) in mesh.network().faces.iter().enumerate() {
        let exact = amplitude * (K * flow.space().fracture_point(i).y).cos();
        let measure = mesh.geometry().face_measure[face];
        error[1] += measure * (flow.fracture_pressure()[i] - exact).powi(2);
        size[1] += measure * exact * exact;
    }
    ((error[0] / size[0]).sqrt(), (error[1] / size[1]).sqrt())
}

#[test]
fn second_order_at_conducting_and_blocking_fractures() {
    let flat = |n: usize| {
        let h = 1.0 / n as f64;
        let line = [[0.0, 0.0], [0.0, 1.0]];
        Triangles::rectangle([-1.0, 0.0], [1.0, 1.0], h).fracture("f", &line, h).build().unwrap()
    };
    let solid = |n: usize| {
        let mut data = cartesian(Vec3::new(-1.0, 0.0, 0.0), Vec3::ONE, [2 * n, n, 2]);
        data.mark_fracture("f", |x| x.x == 0.0);
        data
    };
    let families: [&dyn Fn(usize) -> MeshData; 2] = [&flat, &solid];
    for (family, levels) in families.into_iter().zip([[8, 16, 32], [6, 12, 24]]) {
        for (conductivity, transmissivity) in [(10.0, 1e6), (1.0, 1.0), (1e-6, 1e-2)] {
            let errors = levels.map(|n| along_and_across(family(n), conductivity, transmissivity));
            let sizes = levels.map(|n| 1.0 / n as f64);
            let orders = [order(&sizes, &errors.map(|e| e.0)), order(&sizes, &errors.map(|e| e.1))];
            assert!(
                orders.iter().all(|&o| o >= 1.9),
                "C = {conductivity}, T = {transmissivity}: {orders:?} {errors:?}"
            );
        }
    }
}

/// A fracture: its name, where it is, and its conductivity.
type Pipe<'a> = (&'a str, &'a dyn Fn(Vec3) -> bool, f64);

/// Fractures in a rock that is almost tight, so that they are a network of pipes.
fn pipes(fractures: &[Pipe], n: [usize; 3]) -> (flow_fmu::Flow, flow_fmu::StepReport) {
    let mut data = unit(n);
    for (name, on, _) in fractures {
        data.mark_fracture(name, on);
    }
    let mesh = mesh(data);
    let at_left = SpaceTimeFunction::new(|x, _| if x.x == 0.0 { 1.0 } else { 0.0 });
    let mut model = all_pressure(&mesh, Tensor::IDENTITY, at_left);
    if mesh.dim() == 3 {
        model.boundaries.retain(|b| b.0 != "bottom" && b.0 != "top");
    }
    // The passage, not the rock, is what seals: so the linear system stays well conditioned.
    model.rocks[0].1 = Rock::isotropic(1e-9, 0.1, None);
    for (name, _, conductivity) in fractures {
        model.fractures.push((name.to_string(), fracture(*conductivity, 1e-9)));
    }
    steady(&mesh, model)
}

#[test]
fn fractures_that_cross_share_one_pressure() {
    for n in [[8, 8, 0], [8, 8, 2]] {
        let through = |x: Vec3| x.y == 0.5;
        let left = |x: Vec3| x.y == 0.5 && x.x <= 0.5;
        let up = |x: Vec3| x.x == 0.5;
        let upper = |x: Vec3| x.x == 0.5 && x.y >= 0.5;
        // X with conductivities 1 and 3, T, and L: the crossing is at the mean of the ends, weighted by conductivity.
        let cases: [(&[Pipe], f64, usize); 3] = [
            (&[("a", &through, 1.0), ("b", &up, 3.0)], 1.0 / (1.0 + 1.0 + 3.0 + 3.0), 4),
            (&[("a", &through, 1.0), ("b", &upper, 1.0)], 1.0 / 3.0, 3),
            (&[("a", &left, 1.0), ("b", &upper, 1.0)], 1.0 / 2.0, 2),
        ];
        for (fractures, expected, meeting) in cases {
            let (flow, report) = pipes(fractures, n);
            let network = flow.mesh().network();
            let crossings: Vec<usize> =
                (0..network.edge_count()).filter(|&e| network.edge_kind(e) == EdgeKind::Intersection).collect();
            assert_eq!(crossings.len(), n[2].max(1));
            for e in crossings {
                assert_eq!(network.edge_faces.get(e).len(), meeting);
                let p = flow.state().traces[flow.space().edge_trace(e)];
                assert!((p - expected).abs() < 1e-7, "{p} is not {expected}");
            }
            let into = inflow(flow.mesh(), &report, "left").fracture;
            assert!((into - (1.0 - expected) / 0.5).abs() < 1e-6, "{into}");
            assert!(report.balance.edge < 1e-13 && report.balance.fracture_face < 1e-13, "{:?}", report.balance);
        }
    }
}

#[test]
fn nothing_leaves_through_a_tip() {
    let mut data = unit([8, 8, 0]);
    data.mark_fracture("f", |x| x.y == 0.5 && (0.25..=0.75).contains(&x.x));
    let mesh = mesh(data);
    let mut model = all_pressure(&mesh, Tensor::IDENTITY, SpaceTimeFunction::new(|x, _| 1.0 - x.x));
    model.fractures.push(("f".into(), fracture(100.0, 100.0)));
    let (flow, _) = steady(&mesh, model);
    let network = mesh.network();
    let fluxes = flow.fluxes().unwrap();
    let mut tips = 0;
    for i in 0..network.face_count() {
        for (&e, k) in network.face_edges.get(i).iter().zip(network.face_edges.range(i)) {
            if network.edge_kind(e) == EdgeKind::Tip {
                tips += 1;
                assert!(fluxes.fracture_edge[k].abs() < 1e-13);
            }
        }
    }
    assert_eq!(tips, 2);
    // The fracture does carry flow in the middle.
    assert!(fluxes.fracture_velocity.iter().all(|v| v.x > 0.1));
}

#[test]
fn sides_and_numbers_do_not_matter() {
    let mut data = unit([6, 6, 4]);
    data.mark_fracture("a", |x| x.x == 0.5 && x.z <= 0.75);
    data.mark_fracture("b", |x| x.y == 0.5);
    let original = Mesh::new(data.clone()).unwrap();
    let solve = |mesh: Mesh| {
        let mesh = std::sync::Arc::new(mesh);
        let mut model =
            all_pressure(&mesh, full_tensor(), SpaceTimeFunction::new(|x, _| (3.0 * x.x).sin() + x.y * x.z));
        model.fractures.push(("a".into(), fracture(5.0, 3.0)));
        model.fractures.push(("b".into(), fracture(0.1, 50.0)));
        steady(&mesh, model).0
    };
    let reference = solve(original.clone());
    let swapped = solve(Mesh::with_swapped_sides(data).unwrap());
    assert!(distance(&reference.state().matrix_pressure, &swapped.state().matrix_pressure) < 1e-12);
    let (one, other) = (reference.fluxes().unwrap(), swapped.fluxes().unwrap());
    for (a, b) in one.exchange.iter().zip(&other.exchange) {
        assert!(distance(a, &[b[1], b[0]]) < 1e-12);
        assert!(a[0] != a[1]);
    }
    let cells = original.cell_count();
    let order: Vec<usize> = (0..cells).map(|k| (k * 25 + 7) % cells).collect();
    assert_eq!(cells % 5, 4, "25 must have no factor in common with {cells}");
    let mut data = original.data().clone();
    data.cells = order.iter().map(|&k| original.cell_faces(k).iter().copied()).collect();
    data.cell_region = vec![0; cells];
    let renumbered = solve(Mesh::new(data).unwrap());
    for (new, &old) in order.iter().enumerate() {
        let difference = reference.state().matrix_pressure[old] - renumbered.state().matrix_pressure[new];
        assert!(difference.abs() < 1e-12);
    }
    // Also the plus side is a side like the other.
    let plus = reference.space().side_traces(original.network().faces[0], 0, Side::Plus);
    assert_eq!(plus.len(), 1);
}
