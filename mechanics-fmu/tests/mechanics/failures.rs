//! What fails says so, and leaves what was there.

use std::sync::Arc;

use mechanics_fmu::{DEFAULT_RESIDUAL, Discard, FractureLaw, Mechanics, Neumann, Outcome, Partner, State};
use mesh::Vec3;
use mesh::generate::cartesian;

use crate::common::{coulomb, hold, initial, mesh, model, start, step};

/// Four squares with a fracture under a load, held at the bottom.
fn pressed(law: &FractureLaw) -> Mechanics {
    let mut data = cartesian(Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), [2, 2, 0]);
    data.mark_fracture("flat", |x| x.y == 0.5);
    let mesh = mesh(data);
    let mut model = model(&mesh, law);
    hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
    let traction = Arc::new(move |_, t: f64| 1e6 * Vec3::new(0.2 * t, -t, 0.0));
    model.neumann.push(Neumann { tag: "top".into(), traction });
    start(&mesh, model)
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn a_failed_factorisation_is_an_error_until_another_succeeds() {
    let mut mechanics = pressed(&coulomb(0.5, 0.0));
    let rest = mechanics.rest(0.0);
    let partner = Partner::uniform(mechanics.mesh(), 0.0);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
    let compliance = mechanics.aperture_compliance(&state).unwrap();
    for (values, wanted) in [
        (vec![f64::NAN; 4], "matrix pressure stiffness[0] is NaN; it must be finite and ≥ 0"),
        (vec![1.0, -1.0, 0.0, 0.0], "matrix pressure stiffness[1] is -1; it must be finite and ≥ 0"),
        (vec![1.0; 3], "matrix pressure stiffness has 3 values; it needs 4"),
    ] {
        assert_eq!(mechanics.follow(&values).unwrap_err().to_string(), wanted);
        assert_eq!(bits(&mechanics.aperture_compliance(&state).unwrap()), bits(&compliance));
    }
    let error = mechanics.follow(&[f64::MAX; 4]).unwrap_err().to_string();
    assert!(error.starts_with("the stiffness could not be factorised: "), "{error}");
    let none =
        [mechanics.aperture_compliance(&state).map(drop), mechanics.response(&state, &[1.0; 4], &[0.0; 2]).map(drop)];
    for found in none {
        let error = found.unwrap_err().to_string();
        assert!(error.starts_with("the stiffness is not factorised, as the last attempt failed"), "{error}");
    }
    // Another stiffness, and the one before, make a factorisation again.
    mechanics.follow(&[1e9; 4]).unwrap();
    let swelling = mechanics.response(&state, &[1.0; 4], &[0.0; 2]).unwrap().porosity_change;
    assert!(swelling.iter().all(|&p| p > 0.0), "{swelling:?}");
    assert!(mechanics.follow(&[f64::MAX; 4]).is_err());
    mechanics.follow(&[]).unwrap();
    assert_eq!(bits(&mechanics.aperture_compliance(&state).unwrap()), bits(&compliance));
    assert!(mechanics.follow(&[f64::MAX; 4]).is_err());
    let (again, _) = step(&mut mechanics, &rest, 1.0, &partner);
    assert_eq!(bits(&again.unknowns), bits(&state.unknowns));
}

#[test]
fn a_state_that_is_not_finite_is_not_loaded() {
    let mut mechanics = pressed(&coulomb(0.5, 0.0));
    let rest = mechanics.rest(0.0);
    let partner = Partner::uniform(mechanics.mesh(), 0.0);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
    assert_eq!(bits(&mechanics.load(state.clone()).unwrap().unknowns), bits(&state.unknowns));
    type Change = fn(&mut State);
    let changes: [(&str, Change); 5] = [
        ("time[0] is NaN", |s| s.time = f64::NAN),
        ("displacement[3] is inf", |s| s.unknowns[3] = f64::INFINITY),
        ("multiplier[2] is NaN", |s| s.multiplier[2] = f64::NAN),
        ("initial divergence[1] is -inf", |s| s.initial_divergence[1] = f64::NEG_INFINITY),
        ("initial jump[0] is NaN", |s| s.initial_jump[0] = f64::NAN),
    ];
    for (wanted, change) in changes {
        let mut broken = state.clone();
        change(&mut broken);
        let error = mechanics.load(broken).unwrap_err().to_string();
        assert_eq!(error, format!("{wanted}; it must be finite"));
    }
}

/// A block that lies on a fracture and is pulled off it: there are contact states, and no unique solution at them. The step is
/// discarded after all ways to solve it, and the next one, without the pull, is as if nothing had been.
#[test]
fn a_singular_problem_is_a_step_that_is_discarded() {
    let mut mechanics = pressed(&coulomb(0.5, 0.0));
    let rest = mechanics.rest(0.0);
    let partner = Partner::uniform(mechanics.mesh(), 0.0);
    let (held, _) = step(&mut mechanics, &rest, 1.0, &partner);
    match mechanics.step(&held, -1.0, &partner).unwrap() {
        Outcome::Discarded(Discard::Singular { iterations, open, .. }, report) => {
            assert!(open > 0 && iterations == report.newton.iterations && iterations >= 3, "{report:?}");
        }
        other => panic!("{other:?}"),
    }
    let (again, _) = step(&mut mechanics, &rest, 1.0, &partner);
    assert_eq!(bits(&again.unknowns), bits(&held.unknowns));
}

/// k_n = 5 GPa/m under 1 MPa closes by .2 mm, twice the contact aperture.
#[test]
fn a_fracture_that_closes_to_nothing_is_a_step_that_is_discarded() {
    let soft = FractureLaw { normal_stiffness: Some(5e9), ..coulomb(0.5, 0.0) };
    let partner = |mechanics: &Mechanics| Partner::uniform(mechanics.mesh(), 0.0);
    let mut mechanics = pressed(&FractureLaw { residual_aperture: Some(0.0), ..soft.clone() });
    let (rest, given) = (mechanics.rest(0.0), partner(&mechanics));
    let outcomes = [mechanics.step(&rest, 1.0, &given), mechanics.initial_equilibrium(1.0, &given)];
    for outcome in outcomes {
        let Ok(Outcome::Discarded(why, _)) = outcome else { panic!("{outcome:?}") };
        let Discard::Closed { fracture, faces, at, contact_aperture, aperture, pressed } = &why else {
            panic!("{why}")
        };
        assert_eq!((fracture.as_str(), *faces, at.y, *contact_aperture), ("flat", 2, 0.5, 1e-4));
        assert!((aperture - (1e-4 - pressed / 5e9)).abs() < 1e-12 && *pressed > 1e6, "{why}");
    }
    let half = mechanics.step(&rest, 0.1, &given);
    assert!(matches!(half, Ok(Outcome::Converged(..))), "{half:?}");
    for (residual, wanted) in [(None, DEFAULT_RESIDUAL * 1e-4), (Some(2e-5), 2e-5)] {
        let mut mechanics = pressed(&FractureLaw { residual_aperture: residual, ..soft.clone() });
        let given = partner(&mechanics);
        let state = initial(&mut mechanics, 1.0, &given);
        assert_eq!(mechanics.is_residual(&state), [true; 2]);
        assert_eq!(mechanics.aperture(&state), [wanted; 2]);
        assert_eq!(mechanics.aperture_compliance(&state).unwrap(), [0.0; 2]);
    }
}
