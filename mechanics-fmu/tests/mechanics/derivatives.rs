//! Every derivative that mechanics publishes against central differences, on random states of all laws.

use std::cell::RefCell;

use mechanics_fmu::{Mechanics, NewtonSettings, Outcome, Partner, Scalars, State};
use proptest::prelude::*;

use crate::common::{largest, rock};
use crate::random::{Case, Law, SMALLEST, case, for_all, joints, partner, plain, prepare};

/// Newton's method to round-off, so that differences of time steps tell.
const TOLERANCE: f64 = 1e-13;
/// Change of the pressures (Pa): jumps change by about this part of E times the size of the body, 1 m.
const CHANGE: f64 = 300.0;
/// Largest error of a derivative, as a part of the largest entry of its field. Differences are of second order in the change of
/// directions of slip, and round-off of a jump of 1e-3 m is a part of 1e-7 of its change.
const ERROR: f64 = 1e-4;
/// Of the errors of all states, half are below this.
const MEDIAN: f64 = 1e-7;

fn pattern(n: usize, seed: f64) -> Vec<f64> {
    (0..n).map(|k| CHANGE * (12.9898 * (k as f64 + seed)).sin()).collect()
}

/// All that has a derivative: its name, its values, and the size below which they are round-off.
fn published(mechanics: &Mechanics, state: &State) -> Vec<(&'static str, Vec<f64>)> {
    let scalars = mechanics.scalars(state);
    let means = mechanics.cell_displacement(state);
    let gradients = mechanics.displacement_gradient(state);
    let mut fields = vec![
        ("porosity", mechanics.porosity_change(state)),
        ("aperture", mechanics.aperture(state)),
        ("jump", state.jump(mechanics.space()).to_vec()),
        ("multiplier", state.multiplier.clone()),
        ("displacement", means.iter().flat_map(|u| u.to_array()).collect()),
        ("gradient", gradients.iter().flatten().flat_map(|g| g.to_array()).collect()),
    ];
    fields.extend(named(&scalars));
    if scalars.seismic_moment > 0.0 {
        fields.push(("magnitude", vec![scalars.moment_magnitude()]));
    }
    fields
}

/// On which face each extreme is: where it moves from one to another there is no derivative.
fn extremes(mechanics: &Mechanics, state: &State) -> [(&'static str, usize); 4] {
    let d = mechanics.mesh().dim();
    let index_of_largest = |values: &[f64]| (0..values.len()).max_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap();
    let apertures = mechanics.aperture(state);
    let slips: Vec<f64> = (state.jump(mechanics.space()).chunks(d).zip(state.initial_jump.chunks(d)))
        .map(|(g, g0)| g[1..].iter().zip(&g0[1..]).map(|(g, g0)| (g - g0).powi(2)).sum())
        .collect();
    [
        ("smallest aperture", index_of_largest(&apertures.iter().map(|a| -a).collect::<Vec<_>>())),
        ("largest aperture", index_of_largest(&apertures)),
        ("largest slip", index_of_largest(&slips)),
        ("slip tendency", index_of_largest(&mechanics.slip_tendency(state))),
    ]
}

fn named(scalars: &Scalars) -> [(&'static str, Vec<f64>); 6] {
    [
        ("mean aperture", vec![scalars.mean_aperture]),
        ("smallest aperture", vec![scalars.smallest_aperture]),
        ("largest aperture", vec![scalars.largest_aperture]),
        ("largest slip", vec![scalars.largest_slip]),
        ("slip tendency", vec![scalars.largest_slip_tendency]),
        ("moment", vec![scalars.seismic_moment]),
    ]
}

/// Below what a change of a field is round-off.
fn least(name: &str) -> f64 {
    let (young, b) = (rock().young_modulus, rock().biot_coefficient);
    let strain = CHANGE / young;
    1e-2 * match name {
        "porosity" => b * strain,
        "multiplier" => CHANGE,
        "gradient" => strain / SMALLEST,
        "slip tendency" => CHANGE / 1e6,
        "moment" => young * strain,
        "magnitude" => 1e-4,
        _ => strain,
    }
}

/// The error of each derivative at a state; `None` where the contact states, or what holds apertures up, are not those of both
/// states beside it.
fn errors(
    mechanics: &mut Mechanics,
    before: &State,
    state: &State,
    fadings: usize,
    partner: &Partner,
) -> Option<Vec<(&'static str, f64)>> {
    let (cells, faces) = (mechanics.mesh().cell_count(), mechanics.mesh().network().face_count());
    let (matrix, fracture) = (pattern(cells, 0.4), pattern(faces, 0.6));
    let mut beside = |sign: f64| {
        let mut partner = partner.clone();
        partner.matrix_pressure.iter_mut().zip(&matrix).for_each(|(p, c)| *p += sign * c);
        partner.fracture_pressure.iter_mut().zip(&fracture).for_each(|(p, c)| *p += sign * c);
        match mechanics.step(before, state.time, &partner) {
            Ok(Outcome::Converged(next, report)) => {
                let same = next.contact == state.contact
                    && report.newton.fadings == fadings
                    && mechanics.is_residual(&next) == mechanics.is_residual(state);
                same.then_some(next)
            }
            _ => None,
        }
    };
    let (plus, minus) = (beside(1.0)?, beside(-1.0)?);
    let stiffness = partner.response.as_ref().map_or(&[][..], |r| &r.matrix_pressure_stiffness);
    mechanics.follow(stiffness).unwrap();
    let response = mechanics.response(state, &matrix, &fracture).unwrap();
    let scalars = mechanics.scalars_response(state, &response);
    let mut found = vec![
        response.porosity_change.clone(),
        response.aperture.clone(),
        response.jump.clone(),
        mechanics.multiplier_response(state, &response),
        mechanics.cell_displacement_response(&response).iter().flat_map(|u| u.to_array()).collect(),
        mechanics.displacement_gradient_response(&response).iter().flatten().flat_map(|g| g.to_array()).collect(),
    ];
    found.extend(named(&scalars).map(|(_, value)| value));
    found.push(vec![mechanics.scalars(state).moment_magnitude_response(&scalars)]);
    let (of_plus, of_minus) = (extremes(mechanics, &plus), extremes(mechanics, &minus));
    let (plus, minus) = (published(mechanics, &plus), published(mechanics, &minus));
    let errors = plus.into_iter().zip(minus).zip(found).map(|(((name, plus), (_, minus)), found)| {
        let difference: Vec<f64> = plus.iter().zip(&minus).map(|(p, m)| 0.5 * (p - m)).collect();
        assert_eq!(difference.len(), found.len(), "{name}");
        let size = largest(difference.iter().copied()).max(least(name));
        (name, largest(difference.iter().zip(&found).map(|(d, f)| d - f)) / size)
    });
    let moves = |name: &str| of_plus.iter().zip(&of_minus).any(|(p, m)| p.0 == name && p.1 != m.1);
    Some(errors.filter(|(name, _)| !moves(name)).collect())
}

/// Holds the derivatives at all states of random cases; gives the number of states tested, and of those whose bounds faded.
fn hold_derivatives(cases: u32, law: impl Strategy<Value = Law>) -> [usize; 2] {
    let all = RefCell::new(Vec::new());
    let counts = RefCell::new([0; 3]);
    for_all(cases, case(law), |case: Case| {
        let mut mechanics = prepare(&case, TOLERANCE);
        let mut state = mechanics.rest(0.0);
        for (k, load) in case.loads.iter().enumerate() {
            let partner = partner(mechanics.mesh(), load, case.follow);
            let Ok(Outcome::Converged(next, report)) = mechanics.step(&state, (k + 1) as f64, &partner) else { break };
            counts.borrow_mut()[0] += 1;
            let faded = report.newton.fadings > 0;
            if let Some(errors) = errors(&mut mechanics, &state, &next, report.newton.fadings, &partner) {
                counts.borrow_mut()[1] += 1;
                counts.borrow_mut()[2] += usize::from(faded);
                for (name, error) in errors {
                    all.borrow_mut().push((error, name, faded));
                    prop_assert!(error < ERROR, "step {k}: {name} is off by a part of {error}; faded: {faded}");
                }
            }
            state = next;
        }
        Ok(())
    });
    let [steps, tested, faded] = counts.into_inner();
    for kind in [false, true] {
        let mut errors: Vec<_> = all.borrow().iter().filter(|(.., faded)| *faded == kind).copied().collect();
        errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let (Some(median), Some(worst)) = (errors.get(errors.len() / 2), errors.last()) {
            println!("faded: {kind}, median {:.1e}, worst {:.1e} ({})", median.0, worst.0, worst.1);
            assert!(median.0 < MEDIAN, "{median:?}");
        }
    }
    println!("{tested} of {steps} states, {faded} faded");
    assert!(2 * tested > steps, "{tested} of {steps} states could be tested");
    [tested, faded]
}

/// Tresca's bound and cohesion, some of which fade.
#[test]
fn derivatives_of_bounds_that_may_fade() {
    use mechanics_fmu::Friction;
    let tresca = (0.0..5e6).prop_map(|bound| Friction::Tresca { bound });
    let cohesive = (0.0..0.9, 0.0..2e6);
    let cohesive = cohesive.prop_map(|(coefficient, cohesion)| Friction::Coulomb { coefficient, cohesion });
    let [_, faded] = hold_derivatives(150, plain(prop_oneof![tresca, cohesive]));
    assert!(faded > 4, "{faded}");
}

/// Closure by all laws, dilation of both kinds, with and without limit.
#[test]
fn derivatives_of_joints() {
    let [tested, _] = hold_derivatives(100, joints());
    assert!(tested > 100, "{tested}");
}

/// Coulomb's law and none.
#[test]
fn derivatives_of_friction() {
    use mechanics_fmu::Friction;
    let coulomb = (0.0..0.9).prop_map(|coefficient| Friction::Coulomb { coefficient, cohesion: 0.0 });
    let [tested, _] = hold_derivatives(60, plain(prop_oneof![1 => Just(Friction::None), 4 => coulomb]));
    assert!(tested > 60, "{tested}");
    assert!(TOLERANCE < NewtonSettings::default().tolerance);
}
