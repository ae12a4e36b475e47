//! Bad input is refused, with all its reasons at once.

use flow_fmu::{
    Boundary, Control, Flow, FlowError, FlowModel, Fluid, Fracture, Problem, Rock, SpaceTimeFunction, Tensor, Well,
    WellIndex, WellPlace,
};
use mesh::Vec3;

use super::common::*;

fn good() -> FlowModel {
    let mut model = FlowModel::new(unit_fluid());
    model.rocks.push(("rock".into(), Rock::isotropic(1.0, 0.1, None)));
    model.fractures.push(("f".into(), fracture(1.0, 1.0)));
    model.boundaries.push(("left".into(), Boundary::pressure(0.0)));
    model
}

fn new(model: FlowModel) -> Result<Flow, FlowError> {
    let mut data = unit([4, 4, 0]);
    data.mark_fracture("f", |x| x.x == 0.5);
    Flow::new(mesh(data), model)
}

/// The problems of a model made from a good one.
fn problems(change: impl FnOnce(&mut FlowModel)) -> Vec<Problem> {
    let mut model = good();
    change(&mut model);
    match new(model) {
        Err(FlowError::Invalid(problems)) => problems,
        Err(other) => panic!("another error: {other}"),
        Ok(_) => panic!("it was accepted"),
    }
}

fn well(name: &str, place: WellPlace) -> Well {
    Well { name: name.into(), place, index: Some(WellIndex::Given(1.0)), control: Control::Rate(1.0), limit: None }
}

#[test]
fn the_good_model_is_good() {
    assert!(new(good()).is_ok());
}

#[test]
fn permeabilities() {
    for bad in [-1.0, 0.0] {
        let found = problems(|m| m.rocks[0].1.permeability = Tensor::IDENTITY * bad);
        assert!(matches!(found[..], [Problem::NotDefinite { .. }]), "{found:?}");
    }
    let found = problems(|m| m.rocks[0].1.permeability = Tensor::IDENTITY * f64::NAN);
    assert!(matches!(found[..], [Problem::Value { .. }]), "{found:?}");
    let indefinite = [1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let found = problems(|m| m.rocks[0].1.permeability = Tensor::from_cols_array(&indefinite));
    assert!(matches!(found[..], [Problem::NotDefinite { minor, .. }] if minor == -3.0), "{found:?}");
    let skew = [2.0, 0.5, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0, 1.0];
    let found = problems(|m| m.rocks[0].1.permeability = Tensor::from_cols_array(&skew));
    assert!(matches!(found[..], [Problem::NotSymmetric { .. }]), "{found:?}");
}

#[test]
fn apertures_and_fluid() {
    for bad in [0.0, -1e-4, f64::NAN, f64::INFINITY] {
        let found = problems(|m| m.fractures[0].1.aperture = bad.into());
        assert_eq!(found.len(), 4, "one for each face: {found:?}");
    }
    let found = problems(|m| m.fractures[0].1.normal_permeability = -1.0);
    assert!(found[0].to_string().contains("the normal permeability is -1e0"), "{}", found[0]);
    let found = problems(|m| m.fluid = Fluid { viscosity: 0.0, density: -1.0, bulk_modulus: Some(0.0) });
    assert_eq!(found.len(), 3);
    let found = problems(|m| m.gravity = Vec3::new(0.0, 0.0, -9.81));
    assert!(matches!(found[..], [Problem::Value { value, .. }] if value == -9.81), "{found:?}");
}

#[test]
fn names() {
    let found = problems(|m| {
        m.rocks[0].0 = "granite".into();
        m.fractures[0].0 = "g".into();
        m.boundaries.push(("left".into(), Boundary::pressure(1.0)));
        m.boundaries.push(("lid".into(), Boundary::pressure(1.0)));
        m.wells = vec![
            well("w", WellPlace::Cell(Vec3::new(0.1, 0.1, 0.0))),
            well("w", WellPlace::Cell(Vec3::new(0.1, 0.1, 0.0))),
        ];
    });
    let has = |wanted: &dyn Fn(&Problem) -> bool| found.iter().filter(|&p| wanted(p)).count();
    assert_eq!(has(&|p| matches!(p, Problem::Unknown { kind: "region", name, .. } if name == "granite")), 1);
    assert_eq!(has(&|p| matches!(p, Problem::Missing { kind: "region", name } if name == "rock")), 1);
    assert_eq!(has(&|p| matches!(p, Problem::Unknown { kind: "fracture", .. })), 1);
    assert_eq!(has(&|p| matches!(p, Problem::Missing { kind: "fracture", .. })), 1);
    assert_eq!(has(&|p| matches!(p, Problem::Repeated { kind: "boundary tag", .. })), 1);
    assert_eq!(has(&|p| matches!(p, Problem::Unknown { kind: "boundary tag", name, .. } if name == "lid")), 1);
    assert_eq!(has(&|p| matches!(p, Problem::Repeated { kind: "well", .. })), 1);
    assert_eq!(found.len(), 7);
}

#[test]
fn wells() {
    let found = problems(|m| {
        let mut not = well("not", WellPlace::Cell(Vec3::new(0.1, 0.1, 0.0)));
        not.control = Control::Rate(f64::NAN);
        let mut plain = well("plain", WellPlace::Cell(Vec3::new(0.1, 0.1, 0.0)));
        (plain.index, plain.limit) = (None, Some(1.0));
        let mut aimless = well("aimless", WellPlace::Cell(Vec3::new(0.1, 0.1, 0.0)));
        aimless.index = Some(WellIndex::Radius { radius: 1e-3, direction: Vec3::ZERO });
        m.wells = vec![
            plain,
            aimless,
            well("outside", WellPlace::Cell(Vec3::new(1.1, 0.5, 0.0))),
            well("beside", WellPlace::FractureFace(Vec3::new(0.6, 0.5, 0.0))),
            not,
        ];
    });
    assert_eq!(found.len(), 5, "{found:?}");
    let text = FlowError::Invalid(found).to_string();
    for part in [
        "5 faults",
        "\"outside\" at (1.1, 0.5, 0) lies outside the mesh",
        "on no fracture face",
        "well \"plain\": to hold a pressure",
        "the length of its direction is 0e0",
    ] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    // What only the discretisation tells.
    let found = problems(|m| {
        let mut thick = well("thick", WellPlace::Cell(Vec3::new(0.1, 0.1, 0.0)));
        thick.index = Some(WellIndex::upright(1.0));
        let mut radial = well("radial", WellPlace::FractureFace(Vec3::new(0.5, 0.3, 0.0)));
        radial.index = Some(WellIndex::upright(1e-3));
        m.wells = vec![thick, radial];
    });
    assert_eq!(found.len(), 2, "{found:?}");
    let text = FlowError::Invalid(found).to_string();
    for part in ["\"thick\": its radius of 1 m is not below 1.410e-1 m", "radial flow"] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}

#[test]
fn several_at_once() {
    let found = problems(|m| {
        m.rocks[0].1 =
            Rock { permeability: -Tensor::IDENTITY, porosity: 1.5, biot_modulus: Some(-1.0), biot_coefficient: 0.0 };
        m.fractures[0].1 = Fracture { normal_permeability: f64::NAN, aperture: 0.0.into() };
        m.wells = vec![well("w", WellPlace::Cell(Vec3::new(9.0, 9.0, 0.0)))];
        m.boundaries.push(("lid".into(), Boundary::pressure(1.0)));
    });
    assert_eq!(found.len(), 2 + 1 + 1 + 1 + 1 + 4, "{found:?}");
}

#[test]
fn an_isolated_part_is_found() {
    let isolated = |model: FlowModel| {
        let mut flow = new(model).unwrap();
        let inputs = flow.inputs();
        match flow.steady(&inputs) {
            Err(FlowError::Invalid(problems)) => problems,
            other => panic!("{other:?}"),
        }
    };
    let mut model = good();
    model.boundaries.clear();
    let part = |cells: usize, fracture_faces: usize, first: &str| Problem::Isolated {
        cells,
        fracture_faces,
        first: first.to_owned(),
    };
    let found = isolated(model);
    assert_eq!(found, [part(16, 4, "cell 0 at (0.125, 0.125, 0.000) m")]);
    assert!(found[0].to_string().starts_with("nothing fixes the pressure in 16 cells and 4 fracture faces, linked"));
    // A sealed fracture cuts off the right half, and is itself cut off.
    let mut model = good();
    model.fractures[0].1 = fracture(1.0, 0.0);
    let found = isolated(model.clone());
    let face = "face 0 on fracture \"f\" at (0.500, 0.125, 0.000) m";
    assert_eq!(found, [part(8, 0, "cell 2 at (0.625, 0.125, 0.000) m"), part(0, 4, face)]);
    // Wells with a pressure fix it, one with a rate does not.
    model.wells = vec![well("w", WellPlace::Cell(Vec3::new(0.9, 0.1, 0.0)))];
    assert_eq!(isolated(model.clone()).len(), 2);
    model.wells[0].control = Control::Pressure(1.0);
    assert_eq!(isolated(model.clone()).len(), 1);
    // In time steps compressibility does.
    model.fluid.bulk_modulus = Some(1.0);
    let mut flow = new(model).unwrap();
    let inputs = flow.inputs();
    assert!(flow.step(1.0, &inputs).is_ok());
}

#[test]
fn inputs_of_a_time_step() {
    let mut flow = new(good()).unwrap();
    let right = flow.inputs();
    let before = flow.state().clone();
    let mut wrong = right.clone();
    wrong.porosity_change.pop();
    wrong.aperture[2] = 0.0;
    wrong.aperture_compliance[1] = -1.0;
    wrong.matrix_pressure_reference[3] = f64::NAN;
    wrong.wells.push(Control::Rate(1.0));
    match flow.step(1.0, &wrong) {
        Err(FlowError::Invalid(found)) => assert_eq!(found.len(), 5, "{found:?}"),
        other => panic!("{other:?}"),
    }
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(flow.step(dt, &right), Err(FlowError::Invalid(_))));
    }
    let mut state = before.clone();
    state.traces.pop();
    state.aperture[0] = -1.0;
    match flow.set_state(state) {
        Err(FlowError::Invalid(found)) => assert_eq!(found.len(), 2, "{found:?}"),
        other => panic!("{other:?}"),
    }
    assert_eq!(&before, flow.state());
    assert_eq!(flow.fluxes(), Err(FlowError::NothingSolved));
}

#[test]
fn data_that_are_not_finite() {
    let mut model = good();
    model.boundaries[0].1 = Boundary::pressure(SpaceTimeFunction::new(|_, t| if t > 1.0 { f64::NAN } else { 0.0 }));
    model.rocks[0].1.biot_modulus = Some(1.0);
    model.matrix_source = Some(SpaceTimeFunction::new(|_, t| if t > 2.0 { f64::INFINITY } else { 0.0 }));
    let mut flow = new(model).unwrap();
    let inputs = flow.inputs();
    flow.step(1.0, &inputs).unwrap();
    let before = flow.state().clone();
    match flow.step(1.0, &inputs) {
        Err(FlowError::Invalid(found)) => assert!(found[0].to_string().contains("boundary \"left\""), "{found:?}"),
        other => panic!("{other:?}"),
    }
    assert_eq!(&before, flow.state());
}
