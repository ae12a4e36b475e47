//! How much work a step takes: numbers that do not depend on the machine.

use std::sync::Arc;

use mechanics_fmu::{Bubbles, ContactState, Neumann, Partner};
use mesh::Vec3;
use mesh::generate::cartesian;

use crate::common::{coulomb, fractured, hold, mesh, model, start, step};

/// A cube that is pulled and sheared more and more: nearly all faces are open, then most are closed again.
#[test]
fn a_newton_iteration_takes_few_linear_ones_and_no_factorisation() {
    let mesh = mesh(fractured("tetrahedra"));
    for bubbles in [Bubbles::OneSided, Bubbles::TwoSided] {
        let mut model = model(&mesh, &coulomb(0.5, 0.0));
        model.bubbles = bubbles;
        hold(&mut model, 3, &["bottom"], |_, _| Vec3::ZERO);
        let path = |t: f64| Vec3::new(2e-3 * t, 1e-3 * t, 1e-3 * (if t < 3.0 { t } else { 5.0 - 2.0 * t }));
        hold(&mut model, 3, &["top"], move |p, t| path(t) * (0.2 + p.at.x));
        let mut mechanics = start(&mesh, model);
        let partner = Partner::uniform(&mesh, 1e5);
        let mut state = mechanics.rest(0.0);
        let mut seen = [0; 3];
        let (mut iterations, mut linear_iterations) = (0, 0);
        for k in 1..=6 {
            let (next, report) = step(&mut mechanics, &state, f64::from(k), &partner);
            let newton = report.newton;
            iterations += newton.iterations;
            linear_iterations += newton.linear_iterations;
            assert_eq!(newton.face_factorisations, 0, "{k}: {newton:?}");
            for (seen, wanted) in seen.iter_mut().zip([ContactState::Open, ContactState::Stick, ContactState::Slip]) {
                *seen += next.count(wanted);
            }
            state = next;
        }
        assert!(linear_iterations <= 12 * iterations, "{linear_iterations} in {iterations}");
        assert!(seen.iter().all(|&n| n > 10), "too little happens: {seen:?}");
        assert_eq!(mechanics.factorisations(), 1);
        // The same again, with nothing to do.
        let (_, report) = step(&mut mechanics, &state, 6.0, &partner);
        assert!(report.newton.iterations <= 1, "{:?}", report.newton);
    }
}

/// A block that nothing but a fracture holds: there is no inverse of its stiffness, and the linearised laws are factorised.
#[test]
fn a_loose_block_takes_one_factorisation_on_the_fracture_an_iteration() {
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [6, 6, 2]);
    data.mark_fracture("flat", |x| x.z == 0.5);
    let mesh = mesh(data);
    let mut model = model(&mesh, &coulomb(0.6, 0.0));
    hold(&mut model, 3, &["bottom"], |_, _| Vec3::ZERO);
    // Pressed most at one corner, so that the others slip.
    let traction = |x: Vec3, _| 1e6 * Vec3::new(0.3 + 0.4 * (x.x - 0.5), 0.2, -0.5 - x.x * x.y);
    model.neumann.push(Neumann { tag: "top".into(), traction: Arc::new(traction) });
    let mut mechanics = start(&mesh, model);
    let rest = mechanics.rest(0.0);
    let (state, report) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
    let newton = report.newton;
    let seen = [ContactState::Open, ContactState::Stick, ContactState::Slip].map(|wanted| state.count(wanted));
    assert!(seen.iter().all(|&n| n > 3), "{seen:?}");
    assert_eq!(newton.face_factorisations, newton.iterations, "{newton:?}");
    assert!(newton.linear_iterations <= 3 * newton.iterations, "{newton:?}");
}
