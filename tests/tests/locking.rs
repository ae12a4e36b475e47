//! Rock that hardly changes its volume: with normal bubbles orders and errors do not depend on λ/μ. Theory: order 1 of ∇u and p,
//! 2 of u (Bernardi, Raugel, Math. Comp. 44, 1985, for simplices).

use std::sync::Arc;

use mechanics_fmu::{Bubbles, NormalBubbles};
use tests::locking::{Because, cantilever, incompressible, penny};
use tests::norms::orders;

/// Asserts the orders of u, ∇u and p on a family with λ/μ = 1e6, and that errors are those at 1e2. Bubbles are where `auto` puts
/// them.
fn check(family: &str, levels: [usize; 3]) {
    for because in [Because::Drained, Because::Undrained] {
        let (mut sizes, mut errors) = (Vec::new(), [const { Vec::new() }; 3]);
        for n in levels {
            let mesh = incompressible::mesh(family, n);
            sizes.push(incompressible::size(&mesh));
            let [soft, stiff] = [1e2, 1e6].map(|ratio| {
                let e = incompressible::solve(&mesh, because, ratio, NormalBubbles::Auto);
                [e.displacement, e.gradient, e.pressure]
            });
            for (list, (stiff, soft)) in errors.iter_mut().zip(stiff.into_iter().zip(soft)) {
                assert!(
                    stiff <= 1.1 * soft,
                    "{family}, n = {n}, {because:?}: {stiff:.3e}, but {soft:.3e} at λ/μ = 100"
                );
                list.push(stiff);
            }
        }
        // From the first to the last level: random movement differs from level to level.
        let ends = |values: &[f64]| [values[0], values[2]];
        let [u, gradient, pressure] = errors.each_ref().map(|e| orders(&ends(&sizes), &ends(e))[0]);
        println!("{family}, {because:?}: {errors:?}, orders {u:.2}, {gradient:.2}, {pressure:.2}");
        assert!(u >= 1.9, "{family}, {because:?}: order of u {u}");
        assert!(gradient >= 0.9, "{family}, {because:?}: order of ∇u {gradient}");
        assert!(pressure >= 0.9, "{family}, {because:?}: order of p {pressure}");
    }
}

#[test]
fn triangles() {
    check("triangles", [8, 16, 32]);
}

#[test]
fn squares() {
    check("squares", [8, 16, 32]);
    check("perturbed squares", [8, 16, 32]);
}

/// Polygons of which three meet at each vertex need no bubbles, and get none.
#[test]
fn polygons() {
    check("polygons", [8, 16, 32]);
}

#[test]
fn tetrahedra() {
    check("tetrahedra", [4, 6, 9]);
}

#[test]
fn hexahedra() {
    check("cubes", [6, 9, 13]);
    check("perturbed hexahedra", [6, 9, 13]);
}

/// The deflection of an undrained cantilever; without bubbles triangles give a tenth of it and tetrahedra a sixtieth.
#[test]
fn an_undrained_cantilever_bends() {
    for (family, tip, pressure) in [("squares", 0.03, 0.01), ("triangles", 0.03, 0.03), ("tetrahedra", 0.05, 0.03)] {
        let [found, error] = cantilever::solve(cantilever::mesh(family, 4), NormalBubbles::Auto);
        assert!((found - 1.0).abs() < tip, "{family}: deflection {found} of the exact one");
        assert!(error < pressure, "{family}: pressure off by {error} of the largest");
    }
}

/// Volume of a penny-shaped crack on tetrahedra: errors fall as the mesh becomes finer, and are less by a quarter with bubbles.
#[test]
fn a_penny_shaped_crack_on_tetrahedra() {
    let [coarse, fine] = [3, 6].map(|faces| {
        let mesh = Arc::new(penny::tetrahedra(faces));
        let error = |normal| 1.0 - penny::solve(Arc::clone(&mesh), Bubbles::OneSided, normal);
        let [without, with] = [NormalBubbles::None, NormalBubbles::All].map(error);
        assert!(
            with > 0.0 && with < 0.75 * without,
            "{faces} faces along the radius: {with}, without bubbles {without}"
        );
        with
    });
    assert!(fine < 0.7 * coarse, "{coarse} and {fine}");
}

/// How many faces a model of one material has bubbles on.
fn bubbles_of(mesh: &str, rock: &str, flow: &str, step: f64) -> usize {
    let text = format!(
        "title = 'rock'\n[mesh]\n{mesh}\n[regions.rock]\n{rock}\npermeability = 1e-17\n[time]\nend = {step}\n\
         [mechanics]\ndisplacement = [{{ on = ['left', 'right', 'bottom', 'top'], x = 0, y = 0 }}]\n{flow}\n"
    );
    let document = model::Document::read("rock", &text, &[], &[]).unwrap_or_else(|e| panic!("{e}"));
    let mesh =
        document.mesh(std::path::Path::new("."), &|_, _| unreachable!("no file")).unwrap_or_else(|e| panic!("{e}"));
    let problem = mechanics_fmu::unit::problem(&document, &mesh).unwrap_or_else(|e| panic!("{e}"));
    let mechanics = mechanics_fmu::Mechanics::new(Arc::new(mesh), problem).unwrap_or_else(|e| panic!("{e}"));
    mechanics.space().normal_bubble_count()
}

/// `auto`: bubbles where rock keeps its volume, drained or because its fluid cannot leave, and nowhere else.
#[test]
fn bubbles_are_where_they_are_needed() {
    let triangles = "triangles = { low = [0, 0], high = [1, 1], size = 0.2 }";
    let dual = "triangles = { low = [0, 0], high = [1, 1], size = 0.2 }\ncells = 'dual'";
    let boxes = "box = { low = [0, 0], high = [1, 1], cells = [4, 4] }";
    let ordinary = "young_modulus = 1e10\npoisson_ratio = 0.25\nbiot_coefficient = 1\nbiot_modulus = 1e10";
    let stiff_fluid = "young_modulus = 1e8\npoisson_ratio = 0.25\nbiot_coefficient = 1\nbiot_modulus = 1e10";
    let rubber = "young_modulus = 1e8\npoisson_ratio = 0.4999\nbiot_coefficient = 1\nbiot_modulus = 1e10";
    let incompressible = "young_modulus = 1e8\npoisson_ratio = 0.25\nbiot_coefficient = 1";
    let flow = "[flow]\nboundary.top.pressure = 0";
    // Pressure diffuses over √(c δt), c = K/η/(1/M + b²/(λ+2μ)) = 1.2e-6 m²/s in the stiff fluid's rock.
    let cases = [
        (triangles, ordinary, flow, 1.0, false),
        (triangles, stiff_fluid, flow, 1.0, true),
        (triangles, stiff_fluid, flow, 1e6, false),
        (triangles, stiff_fluid, "", 1.0, false),
        (triangles, incompressible, flow, 1.0, true),
        (triangles, rubber, "", 1.0, true),
        (boxes, rubber, "", 1.0, true),
        (boxes, ordinary, flow, 1.0, false),
        (dual, rubber, "", 1.0, false),
    ];
    for (mesh, rock, flow, step, wanted) in cases {
        let found = bubbles_of(mesh, rock, flow, step);
        assert_eq!(found > 0, wanted, "{mesh}, {rock}, {flow}, step {step}: {found} bubbles");
    }
}
