//! The contact laws hold on every face of random problems, and energy is not made.

use std::cell::Cell;
use std::f64::consts::PI;
use std::sync::{Arc, LazyLock};

use mechanics_fmu::{
    Bubbles, ContactState, Energy, FractureLaw, Friction, Mechanics, Outcome, Partner, PartnerResponse, State,
    StepReport,
};
use mesh::{Mesh, Vec3};
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

use crate::common::{coulomb, fractured, hold, largest, mesh, model, rock, start, step};

/// Newton's tolerance is 1e-9 of the largest jump and traction, in the norm of the complementarity functions: laws hold
/// ten times that far in tractions. A gap is a traction divided by β, a hundredth of the stiffness of a face.
const TRACTION: f64 = 1e-8;

/// Size of the smallest faces (m).
const SMALLEST: f64 = 0.03;

static MESHES: LazyLock<Vec<(&str, Arc<Mesh>)>> = LazyLock::new(|| {
    let families = ["triangles", "polygons", "perturbed squares", "cubes", "tetrahedra"];
    families.into_iter().map(|family| (family, mesh(fractured(family)))).collect()
});

#[derive(Clone, Debug)]
struct Load {
    top: Vec3,
    matrix_pressure: f64,
    fracture_pressure: f64,
}

#[derive(Clone, Debug)]
struct Case {
    mesh: usize,
    laws: Vec<(Friction, f64, Option<f64>)>,
    two_sided: bool,
    /// Stiffnesses (Pa, Pa/m) with which pressures follow.
    follow: Option<(f64, f64)>,
    loads: Vec<Load>,
}

fn load() -> impl Strategy<Value = Load> {
    let part = -1e-3..1e-3;
    (part.clone(), part, -1e-3..3e-4, 0.0..5e6, 0.0..5e6).prop_map(|(x, y, up, matrix_pressure, fracture_pressure)| {
        Load { top: Vec3::new(x, y, up), matrix_pressure, fracture_pressure }
    })
}

fn case(friction: impl Strategy<Value = Friction>) -> impl Strategy<Value = Case> {
    let law = (friction, 0.0..0.4, prop_oneof![2 => Just(None), 1 => (1e10..1e12).prop_map(Some)]);
    let laws = prop::collection::vec(law, 2);
    let follow = prop_oneof![3 => Just(None), 1 => (0.0..1e10, 0.0..1e10).prop_map(Some)];
    (0..MESHES.len(), laws, any::<bool>(), follow, prop::collection::vec(load(), 3))
        .prop_map(|(mesh, laws, two_sided, follow, loads)| Case { mesh, laws, two_sided, follow, loads })
}

fn prepare(case: &Case) -> Mechanics {
    let mesh = &MESHES[case.mesh].1;
    let d = mesh.dim();
    let mut model = model(mesh, &coulomb(0.0, 0.0));
    for (law, &(friction, angle, stiffness)) in model.fractures.values_mut().zip(&case.laws) {
        *law = FractureLaw { friction, dilation_angle: angle, normal_stiffness: stiffness, ..law.clone() };
    }
    model.bubbles = if case.two_sided { Bubbles::TwoSided } else { Bubbles::OneSided };
    hold(&mut model, d, &["bottom"], |_, _| Vec3::ZERO);
    let loads = case.loads.clone();
    hold(&mut model, d, &["top"], move |_, t| {
        let v = loads[t as usize - 1].top;
        if d == 2 { Vec3::new(v.x, v.z, 0.0) } else { v }
    });
    start(mesh, model)
}

fn partner(mesh: &Mesh, load: &Load, follow: Option<(f64, f64)>) -> Partner {
    let (cells, faces) = (mesh.cell_count(), mesh.network().face_count());
    let response = follow.map(|(matrix, fracture)| PartnerResponse {
        matrix_pressure_stiffness: vec![matrix; cells],
        porosity_change: vec![0.0; cells],
        fracture_pressure_stiffness: vec![fracture; faces],
        aperture: vec![1e-4; faces],
    });
    let fracture_pressure = vec![load.fracture_pressure; faces];
    Partner { fracture_pressure, response, ..Partner::uniform(mesh, load.matrix_pressure) }
}

/// What the laws of section 1 of the method forbid on some face, written down without any complementarity function. Where
/// bounds had to fade, a face may touch at less than its bound.
fn broken_law(mechanics: &Mechanics, previous: &State, state: &State, faded: bool) -> Option<String> {
    let (space, mesh) = (mechanics.space(), mechanics.mesh());
    let d = space.dim();
    let (jump, before) = (state.jump(space), previous.jump(space));
    let (young, size) = (rock().young_modulus, largest(jump.iter().copied()));
    // Where nothing presses on the fracture, tractions are round-off of the forces that cancel there.
    let traction = TRACTION * largest(state.multiplier.iter().copied()) + 1e-13 * young * size / SMALLEST;
    // The stiffness of a face is not less than E over the size of the body, 1 m.
    let gap = 1e-8 * size + 100.0 * traction / young;
    for i in 0..space.face_count() {
        let law = &mechanics.model().fractures[&mesh.data().fractures[mesh.network().fracture[i]]];
        let local = |v: &[f64]| v[i * d..][..d].to_vec();
        let (g, g0, lambda) = (local(jump), local(before), local(&state.multiplier));
        let closure = g[0] - law.normal_stiffness.map_or(0.0, |k| lambda[0] / k);
        let slip: Vec<f64> = (1..d).map(|c| g[c] - g0[c]).collect();
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
fn run(cases: u32, friction: impl Strategy<Value = Friction>) -> [usize; 5] {
    let counts = Cell::new([0; 5]);
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let result = runner.run(&case(friction), |case| {
        let mut mechanics = prepare(&case);
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
                Ok(Outcome::NotConverged(_)) => {}
                Err(e) => return Err(TestCaseError::fail(e.to_string())),
            }
            counts.set([steps, converged, cycled, iterations, faded]);
            if converged < steps && state.time < k as f64 {
                break;
            }
        }
        Ok(())
    });
    if let Err(e) = result {
        panic!("{e}");
    }
    counts.get()
}

#[test]
fn laws_hold_on_every_face() {
    let coulomb = (0.0..0.9).prop_map(|coefficient| Friction::Coulomb { coefficient, cohesion: 0.0 });
    let [steps, converged, _, iterations, _] = run(100, prop_oneof![1 => Just(Friction::None), 4 => coulomb]);
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
    let [steps, converged, _, iterations, faded] = run(150, prop_oneof![tresca, cohesive]);
    println!("{converged} of {steps} steps, {iterations} Newton iterations, {faded} faded");
    assert_eq!(converged, steps);
    assert!(faded > 0 && 10 * faded < steps, "{faded} of {steps} faded");
    assert!(iterations <= 12 * steps, "{iterations} in {steps} steps");
}

#[test]
fn strong_friction_finds_an_equilibrium_through_cycles() {
    let strong = (1.0..5.0).prop_map(|coefficient| Friction::Coulomb { coefficient, cohesion: 0.0 });
    let [steps, converged, cycled, iterations, _] = run(150, strong);
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
    let law = FractureLaw { normal_stiffness: Some(stiffness), ..coulomb(10.0, 1e9) };
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
    assert!((aperture - (1e-4 - closure)).abs() < 1e-15, "{aperture}");
}
