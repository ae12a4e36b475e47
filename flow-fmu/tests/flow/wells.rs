//! Wells: rates, pressures, limits, places. Their pressures against closed forms: `radial`.

use flow_fmu::{Boundary, Control, Flow, FlowModel, Rock, Spot, Well, WellIndex, WellPlace};
use mesh::Vec3;
use mesh::generate::cartesian;

use super::common::*;

fn well(name: &str, place: WellPlace, control: Control, limit: Option<f64>) -> Well {
    Well { name: name.into(), place, index: Some(WellIndex::Given(2.0)), control, limit }
}

fn flow(wells: Vec<Well>, biot_modulus: Option<f64>) -> Flow {
    let mut data = cartesian(Vec3::ZERO, Vec3::new(8.0, 8.0, 0.0), [8, 8, 0]);
    data.mark_fracture("f", |x| x.x == 4.0);
    let mut model = FlowModel::new(unit_fluid());
    model.rocks.push(("rock".into(), Rock::isotropic(1.0, 0.1, biot_modulus)));
    model.fractures.push(("f".into(), fracture(5.0, 100.0)));
    model.boundaries.push(("left".into(), Boundary::pressure(0.0)));
    model.wells = wells;
    Flow::new(mesh(data), model).unwrap()
}

#[test]
fn rate_and_pressure_are_two_views_of_a_well() {
    for place in [WellPlace::Cell(Vec3::new(6.2, 3.7, 0.0)), WellPlace::FractureFace(Vec3::new(4.0, 2.5, 0.0))] {
        let mut by_rate = flow(vec![well("w", place, Control::Rate(3.0), None)], None);
        let inputs = by_rate.inputs();
        let report = by_rate.steady(&inputs).unwrap();
        assert_eq!(report.wells[0].rate, 3.0);
        assert!(
            (inflow(by_rate.mesh(), &report, "left").matrix + 3.0).abs() < 1e-12,
            "all that is injected leaves on the left"
        );
        let mut by_pressure = flow(vec![well("w", place, Control::Pressure(report.wells[0].pressure), None)], None);
        let inputs = by_pressure.inputs();
        let other = by_pressure.steady(&inputs).unwrap();
        assert!((other.wells[0].rate - 3.0).abs() < 1e-12);
        assert!(distance(&by_rate.state().matrix_pressure, &by_pressure.state().matrix_pressure) < 1e-12);
        let spot = by_rate.well_spots()[0];
        match (place, spot) {
            (WellPlace::Cell(_), Spot::Cell(cell)) => assert_eq!(cell, 6 + 3 * 8),
            (WellPlace::FractureFace(_), Spot::FractureFace(i)) => {
                let face = by_rate.mesh().network().faces[i];
                assert!((by_rate.mesh().geometry().face_center[face].y - 2.5).abs() < 1e-14);
            }
            _ => panic!("{spot:?} is not where the well was put"),
        }
    }
}

#[test]
fn a_limit_takes_over_and_gives_back() {
    let place = WellPlace::Cell(Vec3::new(6.2, 3.7, 0.0));
    let mut flow = flow(vec![well("w", place, Control::Rate(3.0), Some(4.0))], Some(1.0));
    let mut inputs = flow.inputs();
    let mut was_limited = false;
    for _ in 0..40 {
        let report = flow.step(5.0, &inputs).unwrap();
        let w = report.wells[0];
        assert!(w.pressure <= 4.0 + 1e-12 && w.rate <= 3.0 + 1e-12);
        assert!(w.limited == (w.rate < 3.0));
        assert!(report.balance.total < 1e-12);
        was_limited |= w.limited;
    }
    assert!(was_limited && flow.state().limited[0]);
    inputs.wells[0] = Control::Rate(0.1);
    let report = flow.step(5.0, &inputs).unwrap();
    assert!(!report.wells[0].limited && report.wells[0].rate == 0.1);
    // A producer's limit is a floor.
    inputs.wells[0] = Control::Rate(-3.0);
    flow.step(5.0, &inputs).unwrap();
}
