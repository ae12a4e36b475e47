//! Bad input is refused with its reason, and nothing panics.

use std::sync::Arc;

use mechanics_fmu::{
    Dilation, Dirichlet, FractureLaw, Friction, Mechanics, Model, Neumann, Outcome, Partner, PartnerResponse, Place,
};
use mesh::generate::cartesian;
use mesh::{Mesh, Vec3};

use crate::common::{coulomb, hold, mesh, model, step};

/// Four squares with a fracture, held at the bottom.
fn squares() -> (Arc<Mesh>, Model) {
    let mut data = cartesian(Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), [2, 2, 0]);
    data.mark_fracture("flat", |x| x.y == 0.5);
    let mesh = mesh(data);
    let mut model = model(&mesh, &coulomb(0.5, 0.0));
    hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
    (mesh, model)
}

fn refusal(change: impl FnOnce(&mut Model)) -> String {
    let (mesh, mut model) = squares();
    change(&mut model);
    match Mechanics::new(mesh, model) {
        Ok(_) => panic!("not refused"),
        Err(e) => e.to_string(),
    }
}

/// The refusal is the head and exactly these lines.
fn refused(lines: &[&str], change: impl FnOnce(&mut Model)) {
    let found = refusal(change);
    let s = if lines.len() == 1 { "" } else { "s" };
    let wanted = format!("the mechanical model has {} problem{s}:\n  {}", lines.len(), lines.join("\n  "));
    assert_eq!(found, wanted);
}

fn rock(model: &mut Model) -> &mut mechanics_fmu::Material {
    model.materials.get_mut("rock").unwrap()
}

fn law(model: &mut Model) -> &mut FractureLaw {
    model.fractures.get_mut("flat").unwrap()
}

#[test]
fn parameters_out_of_range() {
    for e in [0.0, -1e9, f64::NAN, f64::INFINITY] {
        let line = format!("region \"rock\": young_modulus is {e}; it must be finite and > 0 Pa");
        refused(&[&line], |m| rock(m).young_modulus = e);
    }
    for nu in [0.5, 0.7, -1.0, f64::NAN] {
        let line = format!("region \"rock\": poisson_ratio is {nu}; it must be between −1 and 0.5, both excluded");
        refused(&[&line], |m| rock(m).poisson_ratio = nu);
    }
    for b in [-0.1, 1.1, f64::NAN] {
        let line = format!("region \"rock\": biot_coefficient is {b}; it must be between 0 and 1");
        refused(&[&line], |m| rock(m).biot_coefficient = b);
    }
    for v in [-0.1, f64::NAN, f64::INFINITY] {
        let line = format!("fracture \"flat\": friction coefficient is {v}; it must be finite and ≥ 0");
        refused(&[&line], |m| law(m).friction = Friction::Coulomb { coefficient: v, cohesion: 0.0 });
        let line = format!("fracture \"flat\": cohesion is {v}; it must be finite and ≥ 0 Pa");
        refused(&[&line], |m| law(m).friction = Friction::Coulomb { coefficient: 0.0, cohesion: v });
        let line = format!("fracture \"flat\": bound is {v}; it must be finite and ≥ 0 Pa");
        refused(&[&line], |m| law(m).friction = Friction::Tresca { bound: v });
        let line = format!("fracture \"flat\": normal_stiffness is {v}; it must be finite and > 0 Pa/m");
        refused(&[&line], |m| law(m).normal_stiffness = Some(v));
    }
    refused(&["fracture \"flat\": normal_stiffness is 0; it must be finite and > 0 Pa/m"], |m| {
        law(m).normal_stiffness = Some(0.0);
    });
    for angle in [-0.1, 1.6, f64::NAN] {
        let line = format!("fracture \"flat\": dilation_angle is {angle}; it must be at least 0 and less than π/2");
        refused(&[&line], |m| law(m).dilation_angle = angle);
    }
    let steep = "at most the friction angle of Coulomb's law where dilation is mechanical: else slip makes energy";
    let line = format!("fracture \"flat\": dilation_angle is 0.47; it must be {steep}");
    refused(&[&line], |m| (law(m).dilation_angle, law(m).dilation) = (0.47, Dilation::Mechanical));
    for friction in [Friction::None, Friction::Tresca { bound: 1e9 }] {
        let line = format!("fracture \"flat\": dilation_angle is 0.1; it must be {steep}");
        refused(&[&line], |m| {
            *law(m) = FractureLaw { friction, dilation_angle: 0.1, dilation: Dilation::Mechanical, ..law(m).clone() };
        });
    }
    for v in [-1.0, f64::NAN, f64::INFINITY] {
        let line = format!("fracture \"flat\": dilation_limit is {v}; it must be finite and ≥ 0 m");
        refused(&[&line], |m| law(m).dilation_limit = Some(v));
    }
    let line = "fracture \"flat\": largest_closure is 0.00005; it must be left out where there is no normal_stiffness";
    refused(&[line], |m| law(m).largest_closure = Some(5e-5));
    for v in [0.0, -1.0, f64::NAN] {
        let line = format!("newton: beta_factor is {v}; it must be finite and > 0");
        refused(&[&line], |m| m.newton.beta_factor = v);
        let line = format!("newton: tolerance is {v}; it must be between 0 and 1, both excluded");
        refused(&[&line], |m| m.newton.tolerance = v);
    }
    refused(&["newton: max_iterations is 0; it must be at least 1"], |m| m.newton.max_iterations = 0);
}

#[test]
fn names_and_places() {
    refused(&["region \"rock\" has no material; the mesh has rock"], |m| {
        m.materials.clear();
    });
    refused(&["region \"sand\" has a material, but does not exist; the mesh has rock"], |m| {
        m.materials.insert("sand".into(), crate::common::rock());
    });
    refused(&["fracture \"flat\" has no law; the mesh has flat"], |m| {
        m.fractures.clear();
    });
    refused(&["fracture \"steep\" has a law, but does not exist; the mesh has flat"], |m| {
        m.fractures.insert("steep".into(), coulomb(0.1, 0.0));
    });
    refused(&["boundary \"floor\" has Dirichlet data, but no face; the mesh has bottom, left, right, top"], |m| {
        m.dirichlet.push(Dirichlet::zero("floor", 0));
    });
    refused(&["boundary \"roof\" has a traction, but no face; the mesh has bottom, left, right, top"], |m| {
        m.neumann.push(Neumann { tag: "roof".into(), traction: Arc::new(|_, _| Vec3::ZERO) });
    });
    refused(&["Dirichlet data on boundary \"top\" fix component 2; there are only 2"], |m| {
        m.dirichlet.push(Dirichlet::zero("top", 2));
    });
    refused(&["Dirichlet data on the point (1, 0, 0) fix component 5; there are only 2"], |m| {
        let place = Place::Point(Vec3::X);
        m.dirichlet.push(Dirichlet { place, component: 5, value: Arc::new(|_, _| 0.0) });
    });
}

#[test]
fn a_point_that_is_no_point() {
    refused(&["Dirichlet data hold at the point (NaN, 0, 0), which is not finite"], |m| {
        let place = Place::Point(Vec3::new(f64::NAN, 0.0, 0.0));
        m.dirichlet.push(Dirichlet { place, component: 0, value: Arc::new(|_, _| 0.0) });
    });
}

#[test]
fn apertures() {
    for value in [0.0, -1e-4, f64::NAN] {
        let line = |x: f64| {
            format!(
                "the contact aperture of fracture \"flat\" at ({x}, 0.5, 0) m, t = 0 s, is {value}; it must be finite and > 0 m"
            )
        };
        refused(&[&line(0.25), &line(0.75)], |m| law(m).contact_aperture = Arc::new(move |_, _| value));
    }
    // A contact aperture of 1 mm at one face and 3 mm at the other.
    let graded: mechanics_fmu::model::ScalarFunction = Arc::new(|x: Vec3, _| 4e-3 * x.x);
    let line = "the largest closure of fracture \"flat\" at (0.25, 0.5, 0) m, t = 0 s, is 0.001; it must be less than the contact aperture \
                there";
    let aperture = Arc::clone(&graded);
    refused(&[line], |m| {
        let (normal_stiffness, largest_closure) = (Some(1e10), Some(1e-3));
        *law(m) = FractureLaw { normal_stiffness, largest_closure, contact_aperture: aperture, ..law(m).clone() };
    });
    let line = "the residual aperture of fracture \"flat\" at (0.25, 0.5, 0) m, t = 0 s, is 0.002; it must be at most the contact \
                aperture there";
    refused(&[line], |m| (law(m).residual_aperture, law(m).contact_aperture) = (Some(2e-3), graded));
    let line = "fracture \"flat\": residual_aperture is -1; it must be finite and ≥ 0 m";
    refused(&[line], |m| law(m).residual_aperture = Some(-1.0));
}

#[test]
fn floating_bodies() {
    let line = |free: usize| {
        format!(
            "the piece of the body around (2.5000e-1, 2.5000e-1, 0.0000e0) m, of 4 cells, can move as a rigid body: its Dirichlet \
             data leave {free} of 3 rigid motions free"
        )
    };
    refused(&[&line(3)], |m| m.dirichlet.clear());
    refused(&[&line(1)], |m| {
        m.dirichlet.remove(0);
    });
    refused(&[&line(2)], |m| {
        m.dirichlet.remove(1);
    });
    refused(&[&line(1)], |m| {
        m.dirichlet.clear();
        for component in 0..2 {
            let place = Place::Point(Vec3::ZERO);
            m.dirichlet.push(Dirichlet { place, component, value: Arc::new(|_, _| 0.0) });
        }
    });
    // Of two bodies that do not touch, one is held.
    let box_at = |x: f64| cartesian(Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1.0, 1.0, 1.0), [1, 1, 1]);
    let (mut data, other) = (box_at(0.0), box_at(2.0));
    let (vertices, faces) = (data.vertices.len(), data.faces.len());
    data.vertices.extend(other.vertices);
    other.faces.iter().for_each(|list| data.faces.push(list.iter().map(|v| v + vertices)));
    other.cells.iter().for_each(|list| data.cells.push(list.iter().map(|f| f + faces)));
    data.cell_region.extend(other.cell_region);
    data.face_fracture.extend(other.face_fracture);
    data.face_tag.extend(vec![None; other.face_tag.len()]);
    let mesh = mesh(data);
    let mut model = model(&mesh, &coulomb(0.5, 0.0));
    hold(&mut model, 3, &["left"], |_, _| Vec3::ZERO);
    let Err(error) = Mechanics::new(mesh, model) else { panic!("not refused") };
    let wanted = "the piece of the body around (2.5000e0, 5.0000e-1, 5.0000e-1) m, of 1 cells, can move as a rigid body: its \
                  Dirichlet data leave 6 of 6 rigid motions free";
    assert!(error.to_string().ends_with(wanted), "{error}");
}

#[test]
fn all_problems_at_once() {
    refused(
        &[
            "region \"rock\": young_modulus is -1; it must be finite and > 0 Pa",
            "region \"rock\": poisson_ratio is 0.5; it must be between −1 and 0.5, both excluded",
            "newton: max_iterations is 0; it must be at least 1",
            "fracture \"flat\" has no law; the mesh has flat",
            "fracture \"steep\" has a law, but does not exist; the mesh has flat",
            "boundary \"floor\" has Dirichlet data, but no face; the mesh has bottom, left, right, top",
        ],
        |m| {
            let law = m.fractures.remove("flat").unwrap();
            m.fractures.insert("steep".into(), law);
            (rock(m).young_modulus, rock(m).poisson_ratio) = (-1.0, 0.5);
            m.newton.max_iterations = 0;
            m.dirichlet.push(Dirichlet::zero("floor", 1));
        },
    );
}

fn step_error(change: impl FnOnce(&mut Model, &mut Partner)) -> String {
    let (mesh, mut model) = squares();
    let mut partner = Partner::uniform(&mesh, 1e5);
    let (cells, faces) = (mesh.cell_count(), mesh.network().face_count());
    partner.response = Some(PartnerResponse {
        matrix_pressure_stiffness: vec![1e9; cells],
        porosity_change: vec![0.0; cells],
        fracture_pressure_stiffness: vec![1e9; faces],
        aperture: vec![1e-4; faces],
    });
    change(&mut model, &mut partner);
    let mut mechanics = Mechanics::new(mesh, model).unwrap();
    let rest = mechanics.rest(0.0);
    let message = match mechanics.step(&rest, 1.0, &partner) {
        Err(e) => e.to_string(),
        Ok(_) => panic!("not refused"),
    };
    assert_eq!(mechanics.factorisations(), 1 + usize::from(message.contains(" at (")), "{message}");
    message
}

#[test]
fn exchanged_fields() {
    type Field = fn(&mut Partner) -> &mut Vec<f64>;
    fn response(partner: &mut Partner) -> &mut PartnerResponse {
        partner.response.as_mut().unwrap()
    }
    let fields: [(&str, usize, bool, Field); 6] = [
        ("matrix pressure", 4, false, |p| &mut p.matrix_pressure),
        ("fracture pressure", 2, false, |p| &mut p.fracture_pressure),
        ("matrix pressure stiffness", 4, true, |p| &mut response(p).matrix_pressure_stiffness),
        ("porosity change reference", 4, false, |p| &mut response(p).porosity_change),
        ("fracture pressure stiffness", 2, true, |p| &mut response(p).fracture_pressure_stiffness),
        ("aperture reference", 2, false, |p| &mut response(p).aperture),
    ];
    for (name, length, not_negative, field) in fields {
        let more = step_error(|_, p| field(p).push(0.0));
        assert_eq!(more, format!("{name} has {} values; it needs {length}", length + 1));
        assert_eq!(step_error(|_, p| field(p).clear()), format!("{name} has 0 values; it needs {length}"));
        let allowed = if not_negative { "finite and ≥ 0" } else { "finite" };
        for value in [f64::NAN, f64::INFINITY] {
            let found = step_error(|_, p| field(p)[1] = value);
            assert_eq!(found, format!("{name}[1] is {value}; it must be {allowed}"));
        }
        if not_negative {
            assert_eq!(step_error(|_, p| field(p)[0] = -1.0), format!("{name}[0] is -1; it must be {allowed}"));
        }
    }
    let (mesh, model) = squares();
    let mut mechanics = Mechanics::new(mesh, model).unwrap();
    let rest = mechanics.rest(0.0);
    let error = mechanics.response(&rest, &[1.0], &[0.0; 2]).unwrap_err();
    assert_eq!(error.to_string(), "matrix pressure has 1 values; it needs 4");
    let error = mechanics.stress(&rest, &[]).unwrap_err();
    assert_eq!(error.to_string(), "matrix pressure has 0 values; it needs 4");
}

#[test]
fn functions_that_give_no_number() {
    let head = "the mechanical model has 1 problem:\n  ";
    let tail = "m, t = 1 s, is NaN; it must be finite";
    let found = step_error(|m, _| {
        m.dirichlet.push(Dirichlet { place: Place::Tag("top".into()), component: 0, value: Arc::new(|_, _| f64::NAN) });
    });
    assert_eq!(found, format!("{head}the displacement on boundary \"top\" at (0, 1, 0) {tail}"));
    let found = step_error(|m, _| {
        m.neumann.push(Neumann { tag: "top".into(), traction: Arc::new(|_, _| Vec3::NAN) });
    });
    assert_eq!(found, format!("{head}the traction on \"top\" at (0.25, 1, 0) {tail}"));
    let found = step_error(|m, _| m.body_force = Some(Arc::new(|_, _| Vec3::new(0.0, f64::NAN, 0.0))));
    assert_eq!(found, format!("{head}the body force at (0.25, 0.25, 0) {tail}"));
}

#[test]
fn times_must_be_numbers() {
    let (mesh, model) = squares();
    let partner = Partner::uniform(&mesh, 0.0);
    let mut mechanics = Mechanics::new(mesh, model).unwrap();
    let rest = mechanics.rest(0.0);
    let error = mechanics.step(&rest, f64::NAN, &partner).unwrap_err();
    assert_eq!(error.to_string(), "time[0] is NaN; it must be finite");
}

/// A piece that only a fracture holds: it rests on it, slides off or lifts off. The last two have no equilibrium, which is
/// said or not found, but never made up.
#[test]
fn a_loose_piece() {
    for (push, pull) in [(0.4, -1.0), (0.6, -1.0), (0.0, 1.0)] {
        let (mesh, mut model) = squares();
        let traction = Arc::new(move |_, _| 1e6 * Vec3::new(push, pull, 0.0));
        model.neumann.push(Neumann { tag: "top".into(), traction });
        let partner = Partner::uniform(&mesh, 0.0);
        let mut mechanics = Mechanics::new(mesh, model).unwrap();
        let rest = mechanics.rest(0.0);
        match mechanics.step(&rest, 1.0, &partner) {
            Ok(Outcome::Converged(state, _)) if push < 0.5 && pull < 0.0 => {
                let mean = |c: usize| 0.5 * (state.multiplier[c] + state.multiplier[2 + c]);
                // λ = −T⁺, and the plus side is below.
                assert!((mean(0) - 1e6).abs() < 1e-3, "{:?}", state.multiplier);
                assert!((mean(1).abs() - 0.4e6).abs() < 1e-3, "{:?}", state.multiplier);
            }
            Ok(Outcome::Discarded(..)) if push > 0.5 || pull > 0.0 => {}
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn no_fracture_and_no_load() {
    let mesh = mesh(cartesian(Vec3::ZERO, Vec3::ONE, [2, 1, 1]));
    let mut model = model(&mesh, &coulomb(0.5, 0.0));
    hold(&mut model, 3, &["left"], |_, _| Vec3::ZERO);
    let mut mechanics = Mechanics::new(Arc::clone(&mesh), model).unwrap();
    let rest = mechanics.rest(0.0);
    let (state, report) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
    assert!(state.unknowns.iter().all(|&u| u == 0.0));
    assert_eq!(report.newton.iterations, 0);
    let (squares, model) = squares();
    let mut mechanics = Mechanics::new(Arc::clone(&squares), model).unwrap();
    let rest = mechanics.rest(0.0);
    let (state, report) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&squares, 0.0));
    assert!(state.unknowns.iter().all(|&u| u == 0.0));
    assert_eq!(report.newton.iterations, 1);
}

/// Parameters in their range, but beyond all reason: an error, a step that does not converge, or a finite solution.
#[test]
fn extreme_parameters_give_no_nonsense() {
    use proptest::prelude::*;
    use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
    let of = |list: &'static [f64]| prop::sample::select(list);
    let rock = (of(&[1e-300, 1e-3, 1e10, 1e150, 1e300]), of(&[-0.999999999999, 0.0, 0.3, 0.499999999999]));
    let friction = (of(&[0.0, 1e-300, 0.5, 1e12, 1e300]), of(&[0.0, 1e-300, 1e6, 1e300]));
    let closes = (of(&[0.0, 1e-300, 1e-5, 1e200]), any::<bool>());
    let joint = (of(&[0.0, 1e-300, 1e10, 1e300]), of(&[0.0, 0.3, 1.56]), of(&[1e-300, 1e-4, 1e300]), closes);
    let load = (of(&[0.0, 1e-300, 1e6, 1e300]), of(&[0.0, 1e-300, 1e-3, 1e300]), of(&[1e-300, 0.01, 1e12]));
    let config = ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let converged = std::cell::Cell::new(0);
    let result =
        runner.run(&(rock, friction, joint, load), |((e, nu), (f, c), (k, angle, aperture, closes), (p, u, beta))| {
            let (mesh, mut model) = squares();
            (self::rock(&mut model).young_modulus, self::rock(&mut model).poisson_ratio) = (e, nu);
            *law(&mut model) = FractureLaw {
                friction: Friction::Coulomb { coefficient: f, cohesion: c },
                dilation_angle: angle,
                dilation: if closes.1 { Dilation::Mechanical } else { Dilation::Hydraulic },
                dilation_limit: (f < 1.0).then_some(u),
                normal_stiffness: (k > 0.0).then_some(k),
                largest_closure: (k > 0.0 && closes.0 > 0.0).then_some(closes.0),
                contact_aperture: Arc::new(move |_, _| aperture),
                residual_aperture: None,
            };
            model.newton.beta_factor = beta;
            hold(&mut model, 2, &["top"], move |p, _| u * Vec3::new(1.0, p.at.x - 0.6, 0.0));
            let mut partner = Partner::uniform(&mesh, 0.0);
            partner.fracture_pressure.fill(p);
            let Ok(mut mechanics) = Mechanics::new(mesh, model) else { return Ok(()) };
            let rest = mechanics.rest(0.0);
            if let Ok(Outcome::Converged(state, _)) = mechanics.step(&rest, 1.0, &partner) {
                let finite = state.unknowns.iter().chain(&state.multiplier).all(|v| v.is_finite());
                prop_assert!(finite, "{:?} {:?}", state.unknowns, state.multiplier);
                converged.set(converged.get() + 1);
            }
            Ok(())
        });
    if let Err(e) = result {
        panic!("{e}");
    }
    assert!(converged.get() > 30, "{}", converged.get());
}
