//! Time steps: order in time, conservation, energy, invariance.

use std::f64::consts::PI;

use flow_fmu::{Boundary, Flow, FlowModel, Fluid, Fracture, Rock, SpaceTimeFunction};
use mesh::Vec3;
use mesh::generate::cartesian;

use super::common::*;

/// p = cos(πx/2) e^(−D π² t/4) on a column of length 1 with D = K M/η, drained at x = 1.
fn column_error(steps: usize) -> f64 {
    let mesh = mesh(cartesian(Vec3::ZERO, Vec3::new(1.0, 0.1, 0.0), [200, 1, 0]));
    let mut model = FlowModel::new(unit_fluid());
    model.rocks.push(("rock".into(), Rock::isotropic(2.0, 0.1, Some(3.0))));
    model.boundaries.push(("right".into(), Boundary::pressure(0.0)));
    model.initial_pressure = SpaceTimeFunction::new(|x, _| (0.5 * PI * x.x).cos());
    let mut flow = Flow::new(mesh, model).unwrap();
    let inputs = flow.inputs();
    let end = 0.1;
    for _ in 0..steps {
        flow.step(end / steps as f64, &inputs).unwrap();
    }
    let decay = (-6.0 * PI * PI / 4.0 * end).exp();
    let exact = |cell| decay * (0.5 * PI * flow.space().cell_point(cell).x).cos();
    let exact: Vec<f64> = (0..200).map(exact).collect();
    distance(&exact, &flow.state().matrix_pressure) / decay
}

#[test]
fn first_order_in_time() {
    let steps = [8usize, 16, 32, 64];
    let errors = steps.map(column_error);
    let order = order(&steps.map(|s| 1.0 / s as f64), &errors);
    assert!(order >= 0.9, "order {order}, errors {errors:?}");
}

/// A compressible fluid in a rock with two fractures, a well and all kinds of boundary data.
fn everything(dim: usize) -> Flow {
    let n = if dim == 2 { [8, 8, 0] } else { [4, 4, 4] };
    let mut data = cartesian(Vec3::ZERO, Vec3::splat(100.0), n);
    data.mark_fracture("a", |x| x.x == 50.0 && x.y <= 75.0);
    data.mark_fracture("b", |x| x.y == 50.0);
    let mesh = mesh(data);
    let up = if dim == 2 { Vec3::Y } else { Vec3::Z };
    let mut model = FlowModel::new(Fluid { viscosity: 1e-3, density: 1000.0, bulk_modulus: Some(2.2e9) });
    model.gravity = -9.81 * up;
    let rock =
        Rock { permeability: 1e-15 * full_tensor(), porosity: 0.15, biot_modulus: Some(1.2e10), biot_coefficient: 0.0 };
    model.rocks.push(("rock".into(), rock));
    for name in ["a", "b"] {
        let aperture = SpaceTimeFunction::new(|x, _| 1e-4 * (1.0 + 0.5 * (x.y / 30.0).sin()));
        model.fractures.push((name.into(), Fracture { normal_permeability: 1e-14, aperture }));
    }
    model.initial_pressure = model.hydrostatic(1e5, 100.0 * up);
    let rising = SpaceTimeFunction::new(|x, t| 1e6 + 1e4 * x.y + 10.0 * t);
    model.boundaries.push(("left".into(), Boundary::pressure(rising)));
    model.boundaries.push(("right".into(), Boundary::inflow(1e-9)));
    model.matrix_source = Some(SpaceTimeFunction::new(|x, _| 1e-12 * x.x));
    model.fracture_source = Some(1e-10.into());
    model.wells.push(flow_fmu::Well {
        name: "injector".into(),
        place: flow_fmu::WellPlace::Cell(Vec3::new(30.0, 30.0, if dim == 2 { 0.0 } else { 30.0 })),
        index: Some(flow_fmu::WellIndex::upright(0.1)),
        control: flow_fmu::Control::Rate(1e-6),
        limit: None,
    });
    Flow::new(mesh, model).unwrap()
}

#[test]
fn volume_and_energy_are_conserved() {
    for dim in [2, 3] {
        let mut flow = everything(dim);
        let mut inputs = flow.inputs();
        for step in 1..=3 {
            // A partner that moves: porosity and aperture change, and answer to the pressures.
            let moved = f64::from(step);
            inputs.porosity_change.iter_mut().enumerate().for_each(|(k, v)| *v = 1e-6 * moved * (k as f64).sin());
            inputs.aperture.iter_mut().for_each(|d| *d *= 1.1);
            inputs.porosity_compliance.fill(5e-11);
            inputs.aperture_compliance.fill(1e-12);
            let place = flow.fluid_in_place();
            let report = flow.step(1e4 * moved, &inputs).unwrap();
            let balance = report.balance;
            for error in [balance.cell, balance.fracture_face, balance.edge, balance.total] {
                assert!(
                    error <= 1e-9 * balance.throughput && error <= 100.0 * balance.round_off,
                    "{dim}D: {balance:?}"
                );
            }
            let energy = report.energy;
            let size = energy.storage.abs() + energy.dissipation() + energy.deformation.abs() + energy.boundary.abs();
            assert!(energy.defect().abs() < 1e-10 * size, "{dim}D: {energy:?}, defect {}", energy.defect());
            assert!(energy.matrix_dissipation > 0.0 && energy.fracture_dissipation > 0.0);
            // What the whole has taken up is what came in.
            let sources = 1e-12 * 50.0 * flow.mesh().geometry().cell_measure.iter().sum::<f64>()
                + 1e-10
                    * flow.mesh().network().faces.iter().map(|&f| flow.mesh().geometry().face_measure[f]).sum::<f64>();
            let inflow: f64 = report.inflow.iter().map(|i| i.matrix + i.fracture).sum();
            let came = 1e4 * moved * (inflow + sources + 1e-6);
            let taken = report.stored.matrix + report.stored.fracture;
            assert!((came - taken).abs() < 1e-9 * came.abs(), "{came} came, {taken} was taken up");
            let opened = flow.fluid_in_place().fracture - place.fracture;
            assert!(opened > 0.0);
        }
    }
}

#[test]
fn a_repeated_time_step_has_the_same_bits() {
    let mut flow = everything(2);
    let inputs = flow.inputs();
    flow.step(1e4, &inputs).unwrap();
    let saved = flow.state().clone();
    let mut other = inputs.clone();
    other.aperture.iter_mut().for_each(|d| *d *= 1.01);
    let first = flow.step(2e4, &other).unwrap();
    let after = flow.state().clone();
    flow.set_state(saved.clone()).unwrap();
    flow.step(1e3, &inputs).unwrap();
    flow.set_state(saved.clone()).unwrap();
    let again = flow.step(2e4, &other).unwrap();
    assert_eq!(&after, flow.state());
    assert_eq!((first.balance, first.inflow, first.energy), (again.balance, again.inflow, again.energy));
    // And in another instance, as after a restart.
    let mut fresh = everything(2);
    fresh.set_state(saved).unwrap();
    fresh.step(2e4, &other).unwrap();
    assert_eq!(&after, fresh.state());
}

#[test]
fn units_do_not_matter() {
    // The same problem with lengths in mm, times in ms and pressures in bar.
    let (metre, second, pascal) = (1e3, 1e3, 1e-5);
    let solve = |metre: f64, second: f64, pascal: f64| {
        let mut data = cartesian(Vec3::ZERO, Vec3::new(2.0, 1.0, 0.0) * metre, [10, 8, 0]);
        data.mark_fracture("f", |x| x.y == 0.5 * metre && x.x <= 1.0 * metre);
        let mesh = mesh(data);
        let fluid = Fluid { viscosity: 1e-3 * pascal * second, density: 0.0, bulk_modulus: Some(2e9 * pascal) };
        let mut model = FlowModel::new(fluid);
        let rock = Rock::isotropic(1e-15 * metre * metre, 0.1, Some(1e10 * pascal));
        model.rocks.push(("rock".into(), rock));
        let fracture = Fracture { normal_permeability: 1e-16 * metre * metre, aperture: (1e-4 * metre).into() };
        model.fractures.push(("f".into(), fracture));
        model.boundaries.push(("left".into(), Boundary::pressure(1e6 * pascal)));
        let mut flow = Flow::new(mesh, model).unwrap();
        let inputs = flow.inputs();
        flow.step(100.0 * second, &inputs).unwrap();
        flow.step(100.0 * second, &inputs).unwrap();
        flow.state().matrix_pressure.iter().map(|p| p / pascal).collect::<Vec<f64>>()
    };
    let (one, other) = (solve(1.0, 1.0, 1.0), solve(metre, second, pascal));
    assert!(one.iter().all(|&p| p > 0.0) && one[0] > 1e5);
    assert!(distance(&one, &other) < 1e-9 * 1e6);
}
