//! The affine partner, factorisation counts, the linearised response.

use std::sync::Arc;

use flow_fmu::{Boundary, Flow, FlowError, FlowModel, Fluid, Fracture, Perturbation, Rock};
use mesh::generate::cartesian;
use mesh::{Mesh, Vec3};

use super::common::*;

fn problem(bulk_modulus: Option<f64>, biot_modulus: Option<f64>) -> Flow {
    let mut data = cartesian(Vec3::ZERO, Vec3::new(2.0, 1.0, 0.0), [16, 8, 0]);
    data.mark_fracture("f", |x| x.y == 0.5 && (0.5..=1.5).contains(&x.x));
    let mesh = Arc::new(Mesh::new(data).unwrap());
    let mut model = FlowModel::new(Fluid { viscosity: 1e-3, density: 1000.0, bulk_modulus });
    model.rocks.push(("rock".into(), Rock::isotropic(1e-15, 0.1, biot_modulus)));
    model.fractures.push(("f".into(), Fracture { normal_permeability: 1e-15, aperture: 1e-4.into() }));
    model.boundaries.push(("left".into(), Boundary::pressure(1e5)));
    model.initial_pressure = 1e5.into();
    Flow::new(mesh, model).unwrap()
}

#[test]
fn one_factorisation_a_time_step_and_none_in_coupling_iterations() {
    let mut flow = problem(None, Some(1e10));
    let mut inputs = flow.inputs();
    inputs.porosity_compliance.fill(2e-11);
    inputs.aperture_compliance.fill(1e-11);
    for step in 1..=3 {
        let before = flow.state().clone();
        for iteration in 0..5 {
            flow.set_state(before.clone()).unwrap();
            // New values and references, the same compliances.
            inputs.porosity_change.fill(-1e-5 * f64::from(iteration + step));
            inputs.aperture.fill(1e-4 * (1.0 - 1e-3 * f64::from(iteration + step)));
            inputs.matrix_pressure_reference.fill(1e5 + 10.0 * f64::from(iteration));
            let report = flow.step(100.0, &inputs).unwrap();
            assert_eq!(report.work.factorisations, step as usize);
            assert_eq!(report.work.analyses, 1);
        }
    }
    let before = flow.state().clone();
    let report = flow.step(50.0, &inputs).unwrap();
    assert_eq!(report.work.factorisations, 4, "another time step changes the matrix");
    flow.set_state(before.clone()).unwrap();
    inputs.porosity_compliance.fill(3e-11);
    assert_eq!(flow.step(50.0, &inputs).unwrap().work.factorisations, 5, "another compliance changes the matrix");
    flow.set_state(before).unwrap();
    assert_eq!(flow.step(50.0, &inputs).unwrap().work.factorisations, 5);
    // A solve needs one correction, not more.
    let report = flow.step(50.0, &inputs).unwrap();
    assert!(report.work.solves == 19, "{:?}", report.work);
}

#[test]
fn a_compliance_at_the_last_pressure_is_storage() {
    // φ* + C (p − p^{n−1}) stores as much as a Biot modulus with 1/M' = 1/M + C.
    let mut one = problem(None, Some(1e10));
    let mut other = problem(None, Some(1.0 / (1e-10 + 4e-11)));
    let mut inputs = one.inputs();
    inputs.porosity_compliance.fill(4e-11);
    inputs.porosity_change.fill(-1e-4);
    let mut frozen = other.inputs();
    frozen.porosity_change.fill(-1e-4);
    one.step(100.0, &inputs).unwrap();
    other.step(100.0, &frozen).unwrap();
    let (p, q) = (&one.state().matrix_pressure, &other.state().matrix_pressure);
    assert!(p.iter().any(|p| *p > 2e5));
    assert!(distance(p, q) < 1e-9 * 1e6, "{}", distance(p, q));
    // What it has accounted for is the affine function at the new pressure.
    let expected = -1e-4 + 4e-11 * (p[5] - 1e5);
    assert!((one.state().porosity_change[5] - expected).abs() < 1e-18);
}

#[test]
fn the_linearised_response_is_the_difference() {
    // Affine in its inputs, so the difference quotient is the derivative.
    let mut flow = problem(Some(2e9), Some(1e10));
    let mut inputs = flow.inputs();
    inputs.porosity_compliance.fill(2e-11);
    inputs.aperture_compliance.fill(1e-11);
    let direction = Perturbation {
        porosity_change: (0..128).map(|k| 1e-3 * f64::from(k).sin()).collect(),
        aperture: (0..8).map(|k| 1e-5 * f64::from(k).cos()).collect(),
        matrix_pressure_reference: (0..128).map(|k| 1e4 * f64::from(k).cos()).collect(),
        fracture_pressure_reference: (0..8).map(|k| 1e4 * f64::from(k).sin()).collect(),
    };
    assert_eq!(flow.linearised_response(&direction), Err(FlowError::NothingSolved));
    let before = flow.state().clone();
    flow.step(100.0, &inputs).unwrap();
    let base = (flow.state().matrix_pressure.clone(), flow.fracture_pressure().to_vec());
    let response = flow.linearised_response(&direction).unwrap();
    flow.set_state(before).unwrap();
    for (values, change) in [
        (&mut inputs.porosity_change, &direction.porosity_change),
        (&mut inputs.aperture, &direction.aperture),
        (&mut inputs.matrix_pressure_reference, &direction.matrix_pressure_reference),
        (&mut inputs.fracture_pressure_reference, &direction.fracture_pressure_reference),
    ] {
        values.iter_mut().zip(change).for_each(|(v, d)| *v += d);
    }
    flow.step(100.0, &inputs).unwrap();
    let add = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a + b).collect::<Vec<f64>>();
    let size = response.fracture_pressure.iter().fold(0.0f64, |m, p| m.max(p.abs()));
    assert!(size > 1e3, "{size}");
    assert!(distance(&add(&base.0, &response.matrix_pressure), &flow.state().matrix_pressure) < 1e-9 * size);
    assert!(distance(&add(&base.1, &response.fracture_pressure), flow.fracture_pressure()) < 1e-9 * size);
}

#[test]
fn stiffnesses_are_published() {
    let mut flow = problem(Some(2e9), Some(1e10));
    let s = flow.matrix_pressure_stiffness();
    assert!((s[0] - 1.0 / (1e-10 + 0.1 / 2e9)).abs() < 1e-6 * s[0]);
    // In no time nothing leaks off: 1/(c_f d_f).
    let at_once = flow.fracture_pressure_stiffness(1e-12).unwrap();
    assert!(at_once.iter().all(|s| (s / (2e9 / 1e-4) - 1.0).abs() < 1e-6), "{at_once:?}");
    let mut flow = problem(None, None);
    assert_eq!(flow.matrix_pressure_stiffness()[0], 1e13);
    // Without any storage the fluid goes out at the left, the sooner the longer the time step is.
    let [short, long] = [1.0, 100.0].map(|dt| flow.fracture_pressure_stiffness(dt).unwrap());
    assert!(short.iter().zip(&long).all(|(s, l)| *l > 0.0 && (s / l - 100.0).abs() < 1e-6));
}

/// An opening of all faces alike in a time step takes as much pressure away as the stiffness says.
#[test]
fn the_fracture_stiffness_is_that_of_a_time_step() {
    for (fluid, rock) in [(Some(2e9), Some(1e10)), (None, Some(1e10)), (None, None)] {
        let mut flow = problem(fluid, rock);
        let (dt, opening) = (30.0, 1e-9);
        let stiffness = flow.fracture_pressure_stiffness(dt).unwrap();
        let mut inputs = flow.inputs();
        inputs.aperture.iter_mut().for_each(|d| *d += opening);
        flow.step(dt, &inputs).unwrap();
        for (s, p) in stiffness.iter().zip(flow.fracture_pressure()) {
            assert!(((1e5 - p) / opening / s - 1.0).abs() < 1e-6, "{s} {p}");
        }
    }
}

#[test]
fn a_fracture_that_would_close_is_an_error_that_changes_nothing() {
    let mut flow = problem(None, Some(1e10));
    let mut inputs = flow.inputs();
    inputs.aperture_compliance.fill(1e-9);
    inputs.fracture_pressure_reference.fill(1e7);
    let before = flow.state().clone();
    let result = flow.step(1e6, &inputs);
    assert!(matches!(result, Err(FlowError::Closed { aperture, .. }) if aperture <= 0.0), "{result:?}");
    assert_eq!(&before, flow.state());
}

/// Parts that nothing but the partner holds: which they are, and that their references are the answer where they fit.
#[test]
fn references_hold_what_nothing_else_does() {
    let with = |normal_permeability: f64, permeability: f64, b: f64, bulk_modulus, pressure: bool| {
        let mut data = cartesian(Vec3::ZERO, Vec3::new(2.0, 1.0, 0.0), [16, 8, 0]);
        data.mark_fracture("f", |x| x.y == 0.5 && (0.5..=1.5).contains(&x.x));
        let mut model = FlowModel::new(Fluid { viscosity: 1e-3, density: 1000.0, bulk_modulus });
        let rock = Rock { biot_coefficient: b, ..Rock::isotropic(permeability, 0.1, None) };
        model.rocks.push(("rock".into(), rock));
        model.fractures.push(("f".into(), Fracture { normal_permeability, aperture: 1e-4.into() }));
        if pressure {
            model.boundaries.push(("left".into(), Boundary::pressure(1e5)));
        }
        Flow::new(Arc::new(Mesh::new(data).unwrap()), model).unwrap()
    };
    // A fracture that leaks into rock that drains; sealed, by nothing and by next to nothing; water in it.
    assert!(!with(1e-15, 1e-15, 1.0, None, true).needs_references());
    assert!(with(0.0, 1e-15, 1.0, None, true).needs_references());
    assert!(with(1e-40, 1e-15, 1.0, None, true).needs_references());
    assert!(!with(0.0, 1e-15, 1.0, Some(2e9), true).needs_references());
    // Tight rock that answers to pressure, and rock that does not; rock without an outlet.
    assert!(with(1e-15, 1e-30, 1.0, None, true).needs_references());
    assert!(!with(1e-15, 1e-15, 0.0, None, true).needs_references());
    assert!(with(1e-15, 1e-15, 1.0, None, false).needs_references());
    for (mut flow, is_rock) in
        [(with(0.0, 1e-15, 1.0, None, true), false), (with(1e-15, 1e-30, 1.0, None, false), true)]
    {
        let mut inputs = flow.inputs();
        let before = flow.state().clone();
        assert!(matches!(flow.step(10.0, &inputs), Err(FlowError::Invalid(_))), "nobody follows");
        inputs.references_follow = true;
        inputs.fracture_pressure_reference.fill(3e6);
        inputs.matrix_pressure_reference.fill(if is_rock { 3e6 } else { 1e5 });
        // Where nothing must give way, the pressure is its reference.
        flow.step(10.0, &inputs).unwrap();
        assert!(flow.fracture_pressure().iter().all(|p| (p / 3e6 - 1.0).abs() < 1e-9));
        // What its partner takes away must go somewhere: the pressure rises, and what the flow accounts for stays as it was.
        flow.set_state(before.clone()).unwrap();
        inputs.aperture.iter_mut().for_each(|d| *d -= 1e-6);
        flow.step(10.0, &inputs).unwrap();
        let volume = |apertures: &[f64]| apertures.iter().sum::<f64>();
        assert!(flow.fracture_pressure().iter().all(|p| *p > 3.001e6));
        if !is_rock {
            let (found, wanted) = (volume(&flow.state().aperture), volume(&before.aperture));
            assert!((found / wanted - 1.0).abs() < 1e-12);
        }
    }
}
