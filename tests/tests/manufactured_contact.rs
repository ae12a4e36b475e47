//! C1: orders of frictionless contact with a manufactured solution: 1 for ∇u and λ, 2 for u (Droniou, Haidar, Masson, arXiv
//! 2404.03045, theorem 3.4; for u by duality).

use tests::contact_cases::{manufactured, solve_dry};
use tests::norms::orders;

/// Asserts the orders between all levels, and the number of Newton iterations.
fn check(family: &str, levels: &[usize], iterations: usize) {
    let (mut sizes, mut errors) = (Vec::new(), [const { Vec::new() }; 3]);
    for &n in levels {
        let mesh = manufactured::mesh(family, n);
        sizes.push(manufactured::size(&mesh));
        let (mechanics, state, report) = solve_dry(mesh, manufactured::model());
        let e = manufactured::errors(&mechanics, &state);
        for (list, error) in errors.iter_mut().zip([e.displacement, e.gradient, e.multiplier]) {
            list.push(error);
        }
        let found = report.newton.iterations;
        assert!(found <= iterations, "{family}, n = {n}: {found} Newton iterations");
    }
    for (name, errors, expected) in [("u", &errors[0], 2.0), ("∇u", &errors[1], 1.0), ("λ", &errors[2], 1.0)] {
        let found = orders(&sizes, errors);
        println!("{family}, {name}: {errors:?}, orders {found:.2?}");
        assert!(found.iter().all(|o| *o >= expected - 0.1), "{family}, {name}: {errors:?}, orders {found:?}");
    }
}

#[test]
fn cartesian_boxes() {
    check("Cartesian", &[8, 12, 16], 9);
}

#[test]
fn perturbed_hexahedra() {
    check("perturbed hexahedra", &[8, 12, 16], 9);
}

#[test]
fn tetrahedra() {
    check("tetrahedra", &[6, 8, 12], 9);
}

#[test]
fn dual_polyhedra() {
    check("dual polyhedra", &[6, 8, 12], 9);
}

#[test]
fn agglomerated_tetrahedra() {
    check("agglomerated tetrahedra", &[8, 12, 16], 9);
}
