//! Where prescribed displacements hold.

use std::sync::Arc;

use mechanics_fmu::{Dirichlet, Partner, Place};
use mesh::Vec3;
use mesh::generate::cartesian;

use crate::common::{coulomb, hold, mesh, model, start, step};

/// The displacement of the nodes at a vertex near `x`.
fn at(mechanics: &mechanics_fmu::Mechanics, state: &mechanics_fmu::State, x: Vec3) -> Vec<Vec3> {
    let mesh = mechanics.mesh();
    let (d, nodes) = (mesh.dim(), mesh.nodes().vertices());
    let near = (0..nodes.len()).filter(|&node| mesh.vertices()[nodes[node]].distance(x) < 1e-9);
    let value = |node: usize, c: usize| if c < d { state.unknowns[node * d + c] } else { 0.0 };
    near.map(|node| Vec3::new(value(node, 0), value(node, 1), value(node, 2))).collect()
}

#[test]
fn of_several_conditions_on_a_component_the_last_holds() {
    let mesh = mesh(cartesian(Vec3::ZERO, Vec3::ONE, [2, 2, 0]));
    let mut model = model(&mesh, &coulomb(0.0, 0.0));
    hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
    hold(&mut model, 2, &["left"], |_, _| Vec3::new(1e-3, 2e-3, 0.0));
    let place = Place::Tag("bottom".into());
    model.dirichlet.push(Dirichlet { place, component: 1, value: Arc::new(|_, _| -1e-3) });
    let mut mechanics = start(&mesh, model);
    let rest = mechanics.rest(0.0);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
    assert_eq!(at(&mechanics, &state, Vec3::ZERO), [Vec3::new(1e-3, -1e-3, 0.0)]);
    assert_eq!(at(&mechanics, &state, Vec3::X), [Vec3::new(0.0, -1e-3, 0.0)]);
    assert_eq!(at(&mechanics, &state, Vec3::Y), [Vec3::new(1e-3, 2e-3, 0.0)]);
}

/// On both sides of a fracture, if the vertex lies on one.
#[test]
fn a_point_holds_the_nodes_of_the_nearest_vertex() {
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [2, 2, 2]);
    data.mark_fracture("flat", |x| x.z == 0.5);
    let mesh = mesh(data);
    let mut model = model(&mesh, &coulomb(0.5, 0.0));
    hold(&mut model, 3, &["bottom", "top"], |_, _| Vec3::ZERO);
    for component in 0..3 {
        let place = Place::Point(Vec3::new(0.4, 0.55, 0.6));
        let value = Arc::new(move |p: &mechanics_fmu::BoundaryPoint, _| 1e-4 * [1.0, 2.0, p.cell.z][component]);
        model.dirichlet.push(Dirichlet { place, component, value });
    }
    let mut mechanics = start(&mesh, model);
    let rest = mechanics.rest(0.0);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
    let found = at(&mechanics, &state, Vec3::splat(0.5));
    assert_eq!(found.len(), 2);
    for (found, z) in found.into_iter().zip([0.25, 0.75]) {
        assert!(found.distance(1e-4 * Vec3::new(1.0, 2.0, z)) < 1e-18, "{found}");
    }
    assert!(at(&mechanics, &state, Vec3::new(0.5, 0.5, 0.0)).iter().all(|&u| u == Vec3::ZERO));
}
