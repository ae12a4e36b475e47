//! Polygons and polyhedra from simplices.

mod common;

use common::{check, measure};
use mesh::generate::{InputProblem, Triangles, agglomerate, cartesian, dual, extrude, perturb, simplices};
use mesh::{EdgeKind, Mesh, Vec3};

fn edges(mesh: &Mesh, kind: EdgeKind) -> usize {
    (0..mesh.network().edge_count()).filter(|&e| mesh.network().edge_kind(e) == kind).count()
}

fn fracture_measure(mesh: &Mesh) -> f64 {
    mesh.network().faces.iter().map(|&f| mesh.geometry().face_measure[f]).sum()
}

/// Tips, an X, a T, an L, a bend, an end on the boundary, and two regions.
fn plane() -> Mesh {
    let mut data = Triangles::rectangle([0.0, 0.0], [3.0, 1.0], 0.12)
        .fracture("x1", &[[0.2, 0.2], [0.8, 0.8]], 0.06)
        .fracture("x2", &[[0.2, 0.8], [0.8, 0.2]], 0.06)
        .fracture("t1", &[[1.2, 0.5], [1.8, 0.5]], 0.06)
        .fracture("t2", &[[1.5, 0.1], [1.5, 0.5]], 0.06)
        .fracture("l1", &[[2.2, 0.2], [2.8, 0.2]], 0.06)
        .fracture("l2", &[[2.8, 0.2], [2.8, 0.8]], 0.06)
        .fracture("bent", &[[1.9, 1.0], [2.1, 0.7], [2.6, 0.6]], 0.06)
        .interface("horizon", &[[0.0, 0.9], [3.0, 0.9]], None)
        .build()
        .unwrap();
    data.assign_regions(|x| (x.y > 0.9).then_some("cap"));
    Mesh::new(data).unwrap()
}

fn check_plane(name: &str, mesh: &Mesh, from: &Mesh) {
    check(name, mesh);
    assert!((measure(mesh) - 3.0).abs() < 1e-12);
    assert!((fracture_measure(mesh) - fracture_measure(from)).abs() < 1e-12, "{name}");
    for kind in [EdgeKind::Intersection, EdgeKind::Tip, EdgeKind::Boundary] {
        assert_eq!(edges(mesh, kind), edges(from, kind), "{name}: {kind:?}");
    }
    for tag in ["left", "right", "bottom", "top"] {
        let length: f64 = mesh.tagged_faces(tag).map(|f| mesh.geometry().face_measure[f]).sum();
        assert!((length - if matches!(tag, "left" | "right") { 1.0 } else { 3.0 }).abs() < 1e-12, "{name}: {tag}");
    }
    let cap: f64 = mesh.region_cells("cap").map(|c| mesh.geometry().cell_measure[c]).sum();
    assert!((cap - 0.3).abs() < 1e-12, "{name}");
    // No two fracture faces of a cell are the two sides of one.
    assert!(mesh.network().faces.iter().all(|&f| Some(mesh.face_cells(f).0) != mesh.face_cells(f).1));
}

#[test]
fn polygons_conform_to_fractures() {
    let triangles = plane();
    let polygons = Mesh::new(dual(&triangles).unwrap()).unwrap();
    check_plane("dual", &polygons, &triangles);
    // One cell for each node, two more for each of the ten tips and for each vertex between regions.
    let between = triangles.vertices().iter().filter(|x| (x.y - 0.9).abs() < 1e-9).count();
    let crossing = 1;
    let expected = triangles.nodes().count() + edges(&triangles, EdgeKind::Tip) + between;
    assert!(polygons.cell_count().abs_diff(expected) <= 2 * crossing, "{} {expected}", polygons.cell_count());
    let faces = polygons.data().cells.items().len() as f64 / polygons.cell_count() as f64;
    assert!((5.0..6.0).contains(&faces), "{faces}");

    for size in [1, 4, 9] {
        let clusters = Mesh::new(agglomerate(&triangles, size).unwrap()).unwrap();
        check_plane("agglomerate", &clusters, &triangles);
        let ratio = triangles.cell_count() as f64 / clusters.cell_count() as f64;
        assert!(ratio > 0.7 * size as f64 && ratio <= 1.3 * size as f64, "{size}: {ratio}");
    }
}

fn t_box(n: usize, amplitude: f64) -> Mesh {
    let mut data = cartesian(Vec3::splat(-1.0), Vec3::splat(1.0), [n; 3]);
    data.mark_fracture("horizontal", |x| x.z == 0.0);
    data.mark_fracture("vertical", |x| x.x == 0.0 && x.z <= 0.0);
    let boxes = Mesh::new(perturb(&Mesh::new(data).unwrap(), amplitude, 5)).unwrap();
    Mesh::new(simplices(&boxes).unwrap()).unwrap()
}

#[test]
fn polyhedra_conform_to_a_t() {
    let tets = t_box(4, 0.15);
    let classes = |mesh: &Mesh| mesh.nodes().count() - mesh.vertices().len();
    assert!(classes(&tets) > 0);
    for (name, data) in [("dual", dual(&tets).unwrap()), ("agglomerate", agglomerate(&tets, 8).unwrap())] {
        let mesh = Mesh::new(data).unwrap();
        check(name, &mesh);
        assert!((measure(&mesh) - 8.0).abs() < 1e-12, "{name}");
        assert!((fracture_measure(&mesh) - 6.0).abs() < 1e-12, "{name}");
        assert_eq!(edges(&mesh, EdgeKind::Tip), 0, "{name}");
        let length: f64 = (0..mesh.network().edge_count())
            .filter(|&e| mesh.network().edge_kind(e) == EdgeKind::Intersection)
            .map(|e| mesh.network().edge_vertices.get(e))
            .map(|ends| mesh.vertices()[ends[0]].distance(mesh.vertices()[ends[1]]))
            .sum();
        assert!((length - 2.0).abs() < 1e-12, "{name}: {length}");
        for tag in ["left", "right", "front", "back", "bottom", "top"] {
            let area: f64 = mesh.tagged_faces(tag).map(|f| mesh.geometry().face_measure[f]).sum();
            assert!((area - 4.0).abs() < 1e-12, "{name}: {tag}");
        }
        let faces = mesh.data().cells.items().len() as f64 / mesh.cell_count() as f64;
        assert!(faces > 10.0, "{name}: {faces}");
    }
    assert_eq!(Mesh::new(dual(&tets).unwrap()).unwrap().cell_count(), tets.nodes().count());
}

#[test]
fn polyhedra_conform_to_fractures_with_tips() {
    let data = Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 0.15)
        .fracture("1", &[[0.1, 0.5], [0.9, 0.5]], 0.12)
        .fracture("3", &[[0.45, 0.3], [0.6, 0.8]], 0.12)
        .build()
        .unwrap();
    let levels: Vec<f64> = (0..=5).map(|i| f64::from(i) / 5.0).collect();
    let prisms = extrude(&Mesh::new(data).unwrap(), &levels, |_, layer| (1..4).contains(&layer)).unwrap();
    let tets = Mesh::new(simplices(&Mesh::new(prisms).unwrap()).unwrap()).unwrap();
    for (name, data) in [("dual", dual(&tets).unwrap()), ("agglomerate", agglomerate(&tets, 10).unwrap())] {
        let mesh = Mesh::new(data).unwrap();
        check(name, &mesh);
        assert!((measure(&mesh) - 1.0).abs() < 1e-12, "{name}");
        assert!((fracture_measure(&mesh) - fracture_measure(&tets)).abs() < 1e-12, "{name}");
        let length = |mesh: &Mesh, kind| -> f64 {
            (0..mesh.network().edge_count())
                .filter(|&e| mesh.network().edge_kind(e) == kind)
                .map(|e| mesh.network().edge_vertices.get(e))
                .map(|ends| mesh.vertices()[ends[0]].distance(mesh.vertices()[ends[1]]))
                .sum()
        };
        for kind in [EdgeKind::Tip, EdgeKind::Intersection] {
            assert!((length(&mesh, kind) - length(&tets, kind)).abs() < 1e-12, "{name}: {kind:?}");
        }
    }
}

#[test]
fn only_simplices_are_taken() {
    let quads = Mesh::new(cartesian(Vec3::ZERO, Vec3::ONE, [2, 1, 0])).unwrap();
    let expected = [InputProblem::NoSimplex { cell: 0, faces: 4 }, InputProblem::NoSimplex { cell: 1, faces: 4 }];
    assert_eq!(dual(&quads).unwrap_err().problems, expected);
    assert_eq!(agglomerate(&quads, 3).unwrap_err().problems, expected);
}
