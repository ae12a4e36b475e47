//! The contact laws hold on every face of random problems, and energy is not made.

use std::cell::Cell;
use std::f64::consts::PI;
use std::sync::Arc;

use mechanics_fmu::{
    ContactState, Dilation, Energy, FractureLaw, Friction, Mechanics, NewtonSettings, Outcome, Partner, State,
    StepReport,
};
use mesh::Vec3;
use proptest::prelude::*;

use crate::common::{coulomb, fractured, hold, initial, largest, mesh, model, rock, start, step};
use crate::random::{Law, SMALLEST, case, for_all, joints, partner, plain, prepare};

/// Newton's tolerance is 1e-9 of the largest jump and traction, in the norm of the complementarity functions: laws hold
/// ten times that far in tractions. A gap is a traction divided by β, a hundredth of the stiffness of a face.
const TRACTION: f64 = 1e-8;

/// What the laws of section 1 of the method forbid on some face, written down without any complementarity function. Where
/// bounds had to fade, a face may touch at less than its bound.
fn broken_law(mechanics: &Mechanics, previous: &State, state: &State, faded: bool) -> Option<String> {
    let (space, mesh) = (mechanics.space(), mechanics.mesh());
    let d = space.dim();
    let (jump, before) = (state.jump(space), previous.jump(space));
    let (young, size) = (rock().young_modulus, largest(jump.iter().copied()));
    // Where nothing presses on the fracture, tractions are round-off of the forces that cancel there.
    let traction = TRACTION * largest(state.multiplier.iter().copied()) + 1e-13 * young * size / SMALLEST;
    // The stiffness of a face is not less than E over the size of the body, 1 m, and that of a joint is in series.
    let softest = mechanics.model().fractures.values().filter_map(|law| law.normal_stiffness).fold(young, f64::min);
    let gap = 1e-8 * size + 100.0 * traction / young.min(softest);
    for i in 0..space.face_count() {
        let law = &mechanics.model().fractures[&mesh.data().fractures[mesh.network().fracture[i]]];
        let local = |v: &[f64]| v[i * d..][..d].to_vec();
        let (g, g0, lambda) = (local(jump), local(before), local(&state.multiplier));
        let closes = match (law.normal_stiffness, law.largest_closure) {
            (None, _) => 0.0,
            (Some(k), None) => lambda[0] / k,
            (Some(k), Some(largest)) => lambda[0] / (k + lambda[0].max(0.0) / largest),
        };
        let slip: Vec<f64> = (1..d).map(|c| g[c] - g0[c]).collect();
        let total: f64 = (1..d).map(|c| (g[c] - state.initial_jump[i * d + c]).powi(2)).sum();
        let opens = match law.dilation {
            Dilation::Hydraulic => 0.0,
            Dilation::Mechanical => {
                (law.dilation_angle.tan() * total.sqrt()).min(law.dilation_limit.unwrap_or(f64::INFINITY))
            }
        };
        let closure = g[0] - closes + opens;
        let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let (shear, slipped) = (norm(&lambda[1..]), norm(&slip));
        let open = closure < -gap;
        let (fixed, coefficient) = match law.friction {
            Friction::None => (0.0, 0.0),
            Friction::Tresca { bound } => (bound, 0.0),
            Friction::Coulomb { coefficient, cohesion } => (cohesion, coefficient),
        };
        let bound = fixed + coefficient * lambda[0];
        let touches = faded && lambda[0] < 0.1 * fixed;
        let work: f64 = slip.iter().zip(&lambda[1..]).map(|(s, l)| s * l).sum();
        let faults = [
            ("penetrates", closure > gap),
            ("pulls", lambda[0] < -traction),
            ("is open and pressed", open && lambda[0] > traction),
            ("is open and sheared", open && shear > traction),
            ("is sheared beyond its bound", !open && shear > bound.max(0.0) + 2.0 * traction),
            ("slips below its bound", !open && !touches && slipped > gap && shear < bound - 2.0 * traction),
            ("slips across its traction", !open && slipped > gap && work < (shear - 2.0 * traction) * slipped),
            ("is called open", state.contact[i] == ContactState::Open && (lambda[0] > traction || closure > gap)),
            ("is called stuck", state.contact[i] == ContactState::Stick && slipped > gap),
            (
                "is called slipping",
                state.contact[i] == ContactState::Slip && !touches && shear < bound - 2.0 * traction,
            ),
        ];
        if let Some((fault, _)) = faults.iter().find(|(_, is)| *is) {
            return Some(format!("face {i} {fault}: jump {g:?} after {g0:?}, λ {lambda:?}, bound {bound}"));
        }
    }
    None
}

/// Δ elastic + friction ≤ work of the forces, and friction ≥ 0.
fn balance(before: &Energy, report: &StepReport) -> Result<(), String> {
    let e = &report.energy;
    let scale = e.elastic + before.elastic + e.external_work.abs() + e.pressure_work.abs();
    let slack = e.external_work + e.pressure_work - (e.elastic - before.elastic) - e.friction;
    if slack < -1e-8 * scale || e.friction < -1e-8 * scale {
        return Err(format!("slack {slack} of {scale}: {e:?} after {before:?}"));
    }
    Ok(())
}

/// Number of steps, of those that converged, of these that cycled before, of Newton iterations, and of steps in which
/// bounds faded.
fn run(cases: u32, law: impl Strategy<Value = Law>) -> [usize; 5] {
    let counts = Cell::new([0; 5]);
    for_all(cases, case(law), |case| {
        let mut mechanics = prepare(&case, NewtonSettings::default().tolerance);
        let mut state = mechanics.rest(0.0);
        let mut energy = Energy::default();
        for (k, load) in case.loads.iter().enumerate() {
            let partner = partner(mechanics.mesh(), load, case.follow);
            let [mut steps, mut converged, mut cycled, mut iterations, mut faded] = counts.get();
            steps += 1;
            match mechanics.step(&state, (k + 1) as f64, &partner) {
                Ok(Outcome::Converged(next, report)) => {
                    converged += 1;
                    cycled += usize::from(report.newton.cycles > 0);
                    faded += usize::from(report.newton.fadings > 0);
                    iterations += report.newton.iterations;
                    if let Some(fault) = broken_law(&mechanics, &state, &next, report.newton.fadings > 0) {
                        return Err(TestCaseError::fail(format!("step {k}: {fault}; {report:?}")));
                    }
                    balance(&energy, &report).map_err(|e| TestCaseError::fail(format!("step {k}: {e}")))?;
                    (state, energy) = (next, report.energy);
                }
                Ok(Outcome::Discarded(..)) => {}
                Err(e) => return Err(TestCaseError::fail(e.to_string())),
            }
            counts.set([steps, converged, cycled, iterations, faded]);
            if converged < steps && state.time < k as f64 {
                break;
            }
        }
        Ok(())
    });
    counts.get()
}

#[test]
fn laws_hold_on_every_face() {
    let coulomb = (0.0..0.9).prop_map(|coefficient| Friction::Coulomb { coefficient, cohesion: 0.0 });
    let [steps, converged, _, iterations, _] = run(100, plain(prop_oneof![1 => Just(Friction::None), 4 => coulomb]));
    println!("{converged} of {steps} steps, {iterations} Newton iterations");
    assert_eq!(converged, steps);
    assert!(iterations <= 6 * steps, "{iterations} in {steps} steps");
}

/// Where a face opens, Tresca's bound and cohesion drop to 0 at once. Where that leaves no equilibrium, they fade.
#[test]
fn a_bound_that_opening_ends_gives_an_equilibrium() {
    let tresca = (0.0..5e6).prop_map(|bound| Friction::Tresca { bound });
    let cohesive = (0.0..0.9, 0.0..2e6);
    let cohesive = cohesive.prop_map(|(coefficient, cohesion)| Friction::Coulomb { coefficient, cohesion });
    let [steps, converged, _, iterations, faded] = run(150, plain(prop_oneof![tresca, cohesive]));
    println!("{converged} of {steps} steps, {iterations} Newton iterations, {faded} faded");
    assert_eq!(converged, steps);
    assert!(faded > 0 && 10 * faded < steps, "{faded} of {steps} faded");
    assert!(iterations <= 12 * steps, "{iterations} in {steps} steps");
}

/// Joints that close by a hyperbola, and that slip opens against the rock.
#[test]
fn joints_that_close_and_dilate_hold_their_laws_on_every_face() {
    let [steps, converged, cycled, iterations, faded] = run(200, joints());
    println!("{converged} of {steps} steps, {iterations} Newton iterations, {cycled} cycled, {faded} faded");
    assert_eq!(converged, steps);
    assert!(iterations <= 8 * steps, "{iterations} in {steps} steps");
}

#[test]
fn strong_friction_finds_an_equilibrium_through_cycles() {
    let strong = (1.0..5.0).prop_map(|coefficient| Friction::Coulomb { coefficient, cohesion: 0.0 });
    let [steps, converged, cycled, iterations, _] = run(150, plain(strong));
    println!("{converged} of {steps} steps, {iterations} Newton iterations, {cycled} cycled");
    assert!(cycled > 0, "no case cycled");
    assert_eq!(converged, steps);
    assert!(iterations <= 8 * steps, "{iterations} in {steps} steps");
}

/// A crack in two squares pressed by a pressure and sheared: the slip at both ends of its range.
#[test]
fn a_uniform_slip_dissipates_bound_times_slip() {
    let mut data = mesh::generate::cartesian(Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), [2, 2, 0]);
    data.mark_fracture("flat", |x| x.y == 0.5);
    let mesh = mesh(data);
    // Lower half held, upper half pushed down and along as a rigid body would be, but for its elasticity.
    let law = coulomb(0.5, 0.0);
    let mut model = model(&mesh, &law);
    let (down, along) = (1e-4, 1e-2);
    hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
    hold(&mut model, 2, &["top"], move |_, t| Vec3::new(along * t, -down, 0.0));
    let lateral = move |x: Vec3, t: f64| Vec3::new(if x.y > 0.5 { along * t } else { 0.0 }, 0.0, 0.0);
    for tag in ["left", "right"] {
        let value = Arc::new(move |p: &mechanics_fmu::BoundaryPoint, t: f64| lateral(p.cell, t).x);
        let place = mechanics_fmu::Place::Tag(tag.into());
        model.dirichlet.push(mechanics_fmu::Dirichlet { place, component: 0, value });
    }
    let mut mechanics = start(&mesh, model);
    let partner = Partner::uniform(&mesh, 0.0);
    let (state, _) = {
        let rest = mechanics.rest(0.0);
        step(&mut mechanics, &rest, 1.0, &partner)
    };
    let (next, report) = step(&mut mechanics, &state, 2.0, &partner);
    assert_eq!(next.count(ContactState::Slip), 2);
    let mean = |v: &[f64], c: usize| 0.5 * (v[c] + v[2 + c]);
    let space = mechanics.space();
    let slip = (mean(next.jump(space), 1) - mean(state.jump(space), 1)).abs();
    let pressure = mean(&next.multiplier, 0);
    let wanted = 0.5 * pressure * slip;
    assert!(pressure > 1e5 && (slip - along).abs() < 0.05 * along, "{pressure} {slip}");
    assert!((report.energy.friction - wanted).abs() < 1e-8 * wanted, "{} not {wanted}", report.energy.friction);
    assert_eq!(mechanics.slip_tendency(&next), [1.0, 1.0]);
    assert_eq!(mechanics.slip_tendency(&mechanics.rest(0.0)), [0.0, 0.0]);
}

/// Where a crack opens, its tractions are round-off, and their ratio says nothing.
#[test]
fn an_open_face_has_no_slip_tendency() {
    for friction in [Friction::None, coulomb(0.5, 0.0).friction] {
        let mesh = mesh(fractured("triangles"));
        let mut model = model(&mesh, &FractureLaw { friction, ..coulomb(0.0, 0.0) });
        hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
        hold(&mut model, 2, &["top"], |_, _| Vec3::new(1e-4, 1e-3, 0.0));
        let mut mechanics = start(&mesh, model);
        let rest = mechanics.rest(0.0);
        let (state, _) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
        assert!(state.count(ContactState::Open) > 0);
        for (tendency, contact) in mechanics.slip_tendency(&state).into_iter().zip(&state.contact) {
            let allowed = match contact {
                ContactState::Open => 0.0..=0.0,
                ContactState::Slip => 1.0..=1.0,
                ContactState::Stick => 0.0..=1.0,
            };
            assert!(allowed.contains(&tendency), "{contact:?}: {tendency}");
        }
    }
}

/// A column with a joint of normal stiffness: λ_n = k_n ⟦u⟧_n, and its energy.
#[test]
fn a_joint_is_a_spring() {
    let stiffness = 2e9;
    let mut data = mesh::generate::cartesian(Vec3::ZERO, Vec3::ONE, [1, 1, 2]);
    data.mark_fracture("flat", |x| x.z == 0.5);
    let mesh = mesh(data);
    let contact: mechanics_fmu::model::ScalarFunction = Arc::new(|_, _| 2e-3);
    let law = FractureLaw { normal_stiffness: Some(stiffness), contact_aperture: contact, ..coulomb(10.0, 1e9) };
    let mut model = model(&mesh, &law);
    for (tag, component) in [("left", 0), ("right", 0), ("front", 1), ("back", 1), ("bottom", 2)] {
        model.dirichlet.push(mechanics_fmu::Dirichlet::zero(tag, component));
    }
    let load = 3e6;
    let traction = Arc::new(move |_: Vec3, t: f64| Vec3::new(0.0, 0.0, -load * (t * PI).sin().abs()));
    model.neumann.push(mechanics_fmu::Neumann { tag: "top".into(), traction });
    let rock = rock();
    let mut mechanics = start(&mesh, model);
    let rest = mechanics.rest(0.0);
    let (state, report) = step(&mut mechanics, &rest, 0.5, &Partner::uniform(&mesh, 0.0));
    let closure = state.jump(mechanics.space())[0];
    assert!((closure - load / stiffness).abs() < 1e-10 * closure, "{closure}");
    let oedometric = rock.lambda() + 2.0 * rock.mu();
    let energy = 0.5 * load * load * (1.0 / oedometric + 1.0 / stiffness);
    assert!((report.energy.elastic - energy).abs() < 1e-9 * energy, "{} not {energy}", report.energy.elastic);
    assert!((report.energy.external_work - 2.0 * energy).abs() < 1e-9 * energy, "{:?}", report.energy);
    let aperture = mechanics.aperture(&state)[0];
    assert!((aperture - (2e-3 - closure)).abs() < 1e-15, "{aperture}");
}

/// A column with a joint of Bandis's hyperbola: V = λ_n/(k_n + λ_n/V_m), and the energy k_n V_m² (−x − ln(1 − x)) at x = V/V_m.
#[test]
fn a_joint_closes_by_a_hyperbola() {
    let (stiffness, largest, load) = (2e9, 9e-5, 3e6);
    let mut data = mesh::generate::cartesian(Vec3::ZERO, Vec3::ONE, [1, 1, 2]);
    data.mark_fracture("flat", |x| x.z == 0.5);
    let mesh = mesh(data);
    let law = FractureLaw { normal_stiffness: Some(stiffness), largest_closure: Some(largest), ..coulomb(10.0, 1e9) };
    let mut model = model(&mesh, &law);
    for (tag, component) in [("left", 0), ("right", 0), ("front", 1), ("back", 1), ("bottom", 2)] {
        model.dirichlet.push(mechanics_fmu::Dirichlet::zero(tag, component));
    }
    let traction = Arc::new(move |_: Vec3, t: f64| Vec3::new(0.0, 0.0, -load * t));
    model.neumann.push(mechanics_fmu::Neumann { tag: "top".into(), traction });
    let oedometric = rock().lambda() + 2.0 * rock().mu();
    let mut mechanics = start(&mesh, model);
    let mut state = mechanics.rest(0.0);
    let mut stored = 0.0;
    // Loaded, overloaded a hundred times, and unloaded: the joint is elastic.
    for part in [1.0, 100.0, 0.01] {
        let time = state.time;
        let (next, report) = step(&mut mechanics, &state, part, &Partner::uniform(&mesh, 0.0));
        let pressed = load * part;
        let closure = next.jump(mechanics.space())[0];
        let wanted = pressed / (stiffness + pressed / largest);
        assert!((closure - wanted).abs() < 1e-10 * wanted, "{part}: {closure}, not {wanted}");
        assert!(
            (stiffness * closure / (1.0 - closure / largest) - pressed).abs() < 1e-6 * pressed,
            "{part}: {closure}"
        );
        let aperture = mechanics.aperture(&next)[0];
        assert!(aperture > 1e-4 - largest && (aperture - (1e-4 - closure)).abs() < 1e-15, "{part}: {aperture}");
        let x = closure / largest;
        let energy = 0.5 * pressed * pressed / oedometric + stiffness * largest * largest * (-x - (1.0 - x).ln());
        assert!((report.energy.elastic - energy).abs() < 1e-8 * energy, "{part}: {:?}, not {energy}", report.energy);
        let slack = report.energy.external_work - (energy - stored);
        assert!(slack >= -1e-9 * energy, "from {time} to {part}: slack {slack}");
        (state, stored) = (next, energy);
    }
}

/// Two squares, the upper one moved along like a rigid body while its top is held: slip that dilates presses the joint.
fn dilating(law: &FractureLaw, along: f64) -> Mechanics {
    let mut data = mesh::generate::cartesian(Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), [2, 2, 0]);
    data.mark_fracture("flat", |x| x.y == 0.5);
    let mesh = mesh(data);
    let mut model = model(&mesh, law);
    hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
    hold(&mut model, 2, &["top"], move |_, t| Vec3::new(along * t, -1e-5, 0.0));
    let lateral = move |x: Vec3, t: f64| if x.y > 0.5 { along * t } else { 0.0 };
    for tag in ["left", "right"] {
        let value = Arc::new(move |p: &mechanics_fmu::BoundaryPoint, t: f64| lateral(p.cell, t));
        let place = mechanics_fmu::Place::Tag(tag.into());
        model.dirichlet.push(mechanics_fmu::Dirichlet { place, component: 0, value });
    }
    start(&mesh, model)
}

/// ⟦u⟧_n = −tan ψ s up to the limit, the column above and below it gives way by E_oed, and what is dissipated is
/// (F − tan ψ) λ_n s while it dilates, F λ_n s after.
#[test]
fn mechanical_dilation_presses_the_joint() {
    let (coefficient, angle, limit, along): (_, f64, _, _) = (0.5, 0.2, 1.5e-4, 1e-3);
    let plain = FractureLaw { dilation_angle: angle, ..coulomb(coefficient, 0.0) };
    let law = FractureLaw { dilation: Dilation::Mechanical, dilation_limit: Some(limit), ..plain.clone() };
    let oedometric = rock().lambda() + 2.0 * rock().mu();
    let mut mechanics = dilating(&law, along);
    let mut hydraulic = dilating(&plain, along);
    let partner = Partner::uniform(mechanics.mesh(), 0.0);
    let (mut state, mut other) = (mechanics.rest(0.0), hydraulic.rest(0.0));
    // With F = ½ the shear of the squares is small beside their slip; the last step turns back.
    for time in [0.5, 0.7, 1.0, 0.4] {
        let (next, report) = step(&mut mechanics, &state, time, &partner);
        let (still, _) = step(&mut hydraulic, &other, time, &partner);
        let mean = |v: &[f64], c: usize| 0.5 * (v[c] + v[2 + c]);
        let (jump, before) = (next.jump(mechanics.space()), state.jump(mechanics.space()));
        let slip = mean(jump, 1).abs();
        let opened = (angle.tan() * slip).min(limit);
        assert_eq!(next.count(ContactState::Slip), 2, "{time}");
        assert!((-mean(jump, 0) - opened).abs() < 1e-12, "{time}: {jump:?}, not {opened}");
        let pressure = mean(&next.multiplier, 0);
        let wanted = oedometric * (1e-5 + opened);
        assert!((pressure - wanted).abs() < 1e-6 * wanted, "{time}: {pressure}, not {wanted}");
        let without = mean(&still.multiplier, 0);
        assert!((without - oedometric * 1e-5).abs() < 1e-6 * wanted, "{time}: {without}");
        let dissipated: f64 = (0..2)
            .map(|i| {
                let [slip, slip_before] = [jump[2 * i + 1], before[2 * i + 1]];
                let opens = |slip: f64| (angle.tan() * slip.abs()).min(limit);
                let lifts = opens(slip) - opens(slip_before);
                0.5 * next.multiplier[2 * i] * (coefficient * (slip - slip_before).abs() - lifts)
            })
            .sum();
        let found = report.energy.friction;
        assert!((found - dissipated).abs() < 1e-8 * dissipated, "{time}: {found}, not {dissipated}");
        let apertures = mechanics.aperture(&next).into_iter().zip(hydraulic.aperture(&still));
        for (i, (aperture, other)) in apertures.enumerate() {
            let opens = |slip: f64| angle.tan() * slip.abs();
            assert!((aperture - (1e-4 + opens(jump[2 * i + 1]).min(limit))).abs() < 1e-12, "{time}: {aperture}");
            let free = 1e-4 + opens(still.jump(hydraulic.space())[2 * i + 1]);
            assert!((other - free).abs() < 1e-12, "{time}: {other}, not {free}");
        }
        (state, other) = (next, still);
    }
}

/// Where the initial equilibrium slips, nothing has dilated in it, and dilation counts from there.
#[test]
fn the_initial_equilibrium_does_not_dilate() {
    let law = FractureLaw { dilation_angle: 0.2, dilation: Dilation::Mechanical, ..coulomb(0.5, 0.0) };
    let mut mechanics = dilating(&law, 1e-3);
    let partner = Partner::uniform(mechanics.mesh(), 0.0);
    let before = initial(&mut mechanics, 1.0, &partner);
    let jump = before.jump(mechanics.space()).to_vec();
    assert!(before.count(ContactState::Slip) == 2 && jump[1].abs() > 9e-4, "{jump:?}");
    assert!(jump[0].abs() < 1e-15, "{jump:?}");
    let (same, _) = step(&mut mechanics, &before, 1.0, &partner);
    assert!(largest(same.jump(mechanics.space()).iter().zip(&jump).map(|(a, b)| a - b)) < 1e-12);
    let (after, _) = step(&mut mechanics, &before, 1.5, &partner);
    let now = after.jump(mechanics.space());
    for i in 0..2 {
        let opened = 0.2_f64.tan() * (now[2 * i + 1] - jump[2 * i + 1]).abs();
        assert!(opened > 5e-5 && (now[2 * i] + opened).abs() < 1e-12, "face {i}: {now:?} after {jump:?}");
    }
}
