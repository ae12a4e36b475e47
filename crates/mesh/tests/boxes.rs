//! Boxes: perturbed, distorted, cut into simplices; prisms.

mod common;

use common::{check, measure};
use mesh::generate::{InputProblem, Triangles, cartesian, extrude, kershaw, perturb, simplices};
use mesh::{EdgeKind, Mesh, MeshData, Vec3};

/// The T of a horizontal fracture with a vertical one below it in (−1, 1)³.
fn t_box(n: usize) -> MeshData {
    let mut data = cartesian(Vec3::splat(-1.0), Vec3::splat(1.0), [n; 3]);
    data.mark_fracture("horizontal", |x| x.z == 0.0);
    data.mark_fracture("vertical", |x| x.x == 0.0 && x.z <= 0.0);
    data
}

fn edges(mesh: &Mesh, kind: EdgeKind) -> usize {
    (0..mesh.network().edge_count()).filter(|&e| mesh.network().edge_kind(e) == kind).count()
}

#[test]
fn sides_have_their_names() {
    let (low, high) = (Vec3::new(-1.0, 0.0, 2.0), Vec3::new(1.0, 3.0, 4.0));
    for n in [[2, 3, 0], [2, 3, 1]] {
        let mesh = Mesh::new(cartesian(low, high, n)).unwrap();
        let sides: &[[&str; 2]] = if n[2] == 0 {
            &[["left", "right"], ["bottom", "top"]]
        } else {
            &[["left", "right"], ["front", "back"], ["bottom", "top"]]
        };
        let mut tagged = 0;
        for (axis, names) in sides.iter().enumerate() {
            for (name, at) in names.iter().zip([low, high]) {
                for face in mesh.tagged_faces(name) {
                    assert_eq!(mesh.geometry().face_center[face][axis], at[axis], "{name}");
                    tagged += 1;
                }
            }
        }
        assert_eq!(tagged, (0..mesh.face_count()).filter(|&face| mesh.is_boundary(face)).count());
    }
}

#[test]
fn perturbed_boxes_keep_boundary_and_fractures() {
    for dim in [2, 3] {
        let mut data = cartesian(Vec3::splat(-1.0), Vec3::splat(1.0), [4, 4, if dim == 3 { 4 } else { 0 }]);
        data.mark_fracture("through", |x| x.y == 0.0);
        data.mark_fracture("part", |x| x.x == 0.0 && x.y <= 0.5 && (dim == 2 || x.z.abs() <= 0.5));
        let plain = Mesh::new(data).unwrap();
        let mesh = Mesh::new(perturb(&plain, 0.2, 7)).unwrap();
        check("perturbed", &mesh);
        assert!((measure(&mesh) - 2.0_f64.powi(dim)).abs() < 1e-13);
        let moved = |v: usize| mesh.vertices()[v] - plain.vertices()[v];
        let tips: Vec<usize> = (0..plain.network().edge_count())
            .filter(|&e| plain.network().edge_kind(e) == EdgeKind::Tip)
            .flat_map(|e| plain.network().edge_vertices.get(e).to_vec())
            .collect();
        assert!(!tips.is_empty());
        for v in 0..plain.vertices().len() {
            let x = plain.vertices()[v];
            for i in 0..dim as usize {
                if x[i].abs() == 1.0 || tips.contains(&v) || (i == 1 && x.y == 0.0) {
                    assert!(moved(v)[i].abs() < 1e-15);
                } else if x[0] != 0.0 {
                    assert!(moved(v)[i] != 0.0 && moved(v)[i].abs() <= 0.1);
                }
            }
        }
        assert_eq!(perturb(&plain, 0.2, 7), perturb(&plain, 0.2, 7));
        assert_ne!(perturb(&plain, 0.2, 7), perturb(&plain, 0.2, 8));
    }
}

#[test]
fn kershaw_boxes_are_sound() {
    for n in [[6, 6, 0], [12, 12, 0], [6, 6, 6], [12, 6, 12]] {
        let mesh = Mesh::new(kershaw(Vec3::new(-1.0, 0.0, 2.0), Vec3::new(1.0, 3.0, 4.0), n, 0.3)).unwrap();
        check("kershaw", &mesh);
        assert!((measure(&mesh) - if n[2] == 0 { 6.0 } else { 12.0 }).abs() < 1e-12);
        // The thinnest layer has 0.3 of the Cartesian height (3D: in both directions), and the thickest the rest of two.
        let plain = measure(&mesh) / mesh.cell_count() as f64;
        let (low, high) =
            mesh.geometry().cell_measure.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), &m| (l.min(m), h.max(m)));
        let directions = if n[2] == 0 { 1 } else { 2 };
        assert!((low / plain - 0.3_f64.powi(directions)).abs() < 1e-12, "{low} {plain}");
        assert!((high / plain - 1.7_f64.powi(directions)).abs() < 1e-12, "{high} {plain}");
    }
    let plain = cartesian(Vec3::ZERO, Vec3::ONE, [6, 4, 4]);
    let same = kershaw(Vec3::ZERO, Vec3::ONE, [6, 4, 4], 1.0);
    assert!(plain.vertices.iter().zip(&same.vertices).all(|(a, b)| a.distance(*b) < 1e-15));
}

#[test]
fn boxes_are_cut_into_simplices() {
    let boxes = Mesh::new(t_box(4)).unwrap();
    let tets = Mesh::new(simplices(&boxes).unwrap()).unwrap();
    check("Kuhn", &tets);
    assert_eq!(tets.cell_count(), 6 * 64);
    assert_eq!(tets.vertices(), boxes.vertices());
    assert_eq!(tets.network().face_count(), 2 * boxes.network().face_count());
    assert_eq!(edges(&tets, EdgeKind::Intersection), 4);
    assert_eq!(tets.nodes().count(), boxes.nodes().count());
    let area =
        |mesh: &Mesh, tag: &str| -> f64 { mesh.tagged_faces(tag).map(|f| mesh.geometry().face_measure[f]).sum() };
    for tag in ["left", "right", "front", "back", "bottom", "top"] {
        assert!((area(&tets, tag) - 4.0).abs() < 1e-14);
    }
    // All of Kuhn's simplices have the same volume.
    assert!(tets.geometry().cell_measure.iter().all(|m| (m - 0.125 / 6.0).abs() < 1e-15));

    // Bent faces and any numbering do not break conformity.
    let (shuffled, _) = perturb(&boxes, 0.15, 1).renumbered(3);
    let tets = Mesh::new(simplices(&Mesh::new(shuffled).unwrap()).unwrap()).unwrap();
    check("perturbed", &tets);
    assert!((measure(&tets) - 8.0).abs() < 1e-13);
    assert_eq!(tets.nodes().count(), boxes.nodes().count());

    let quads = Mesh::new(cartesian(Vec3::ZERO, Vec3::ONE, [3, 2, 0])).unwrap();
    let triangles = Mesh::new(simplices(&quads).unwrap()).unwrap();
    check("triangles", &triangles);
    assert_eq!(triangles.cell_count(), 12);

    let l = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
    let hanging = Mesh::new(MeshData::from_polygons(l.to_vec(), [[0, 1, 2, 3, 4]])).unwrap();
    let error = simplices(&hanging).unwrap_err();
    assert_eq!(error.problems, [InputProblem::NotConvex { cell: 0 }]);
}

#[test]
fn regions_go_with_their_cells() {
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [2, 4, 0]);
    data.assign_regions(|x| (x.y > 0.7).then_some("cap"));
    let plane = Mesh::new(data).unwrap();
    let prisms = Mesh::new(extrude(&plane, &[0.0, 0.5, 2.0], |_, _| true).unwrap()).unwrap();
    let cut = |mesh: &Mesh| Mesh::new(simplices(mesh).unwrap()).unwrap();
    for (mesh, wanted) in [(cut(&plane), 0.25), (cut(&prisms), 0.5), (prisms, 0.5)] {
        let cells: Vec<usize> = mesh.region_cells("cap").collect();
        let volume: f64 = cells.iter().map(|&cell| mesh.geometry().cell_measure[cell]).sum();
        assert!((volume - wanted).abs() < 1e-14, "{volume}");
        assert!(cells.iter().all(|&cell| mesh.geometry().cell_center[cell].y > 0.75));
    }
}

fn four_fractures(h: f64, far: f64) -> Triangles<'static> {
    Triangles::rectangle([0.0, 0.0], [1.0, 1.0], far)
        .fracture("1", &[[0.1, 0.5], [0.9, 0.5]], h)
        .fracture("2", &[[0.15, 0.7], [0.4, 0.2]], h)
        .fracture("3", &[[0.45, 0.3], [0.6, 0.8]], h)
        .fracture("4", &[[0.6, 0.2], [0.8, 0.8]], h)
}

#[test]
fn four_crossing_fractures_are_extruded_and_cut_into_tetrahedra() {
    let plane = Mesh::new(four_fractures(0.1, 0.15).build().unwrap()).unwrap();
    let levels: Vec<f64> = (0..=10).map(|i| f64::from(i) / 10.0).collect();
    let inside = |_: &str, layer: usize| (2..8).contains(&layer);
    let prisms = Mesh::new(extrude(&plane, &levels, inside).unwrap()).unwrap();
    check("prisms", &prisms);
    assert_eq!(prisms.cell_count(), 10 * plane.cell_count());
    assert_eq!(prisms.network().face_count(), 6 * plane.network().face_count());
    let crossings = |mesh: &Mesh| edges(mesh, EdgeKind::Intersection);
    assert_eq!(crossings(&plane), 3);
    assert_eq!(crossings(&prisms), 6 * 3);
    // Tips: the upper and lower edge of every fracture, and the two ends in each layer. Where the traces cross
    // the edges of several fractures meet in a vertex only.
    assert_eq!(edges(&prisms, EdgeKind::Tip), 2 * plane.network().face_count() + 6 * 8);
    for (tag, axis, at) in [("front", 1, 0.0), ("back", 1, 1.0), ("bottom", 2, 0.0), ("top", 2, 1.0), ("left", 0, 0.0)]
    {
        let faces: Vec<usize> = prisms.tagged_faces(tag).collect();
        let area: f64 = faces.iter().map(|&f| prisms.geometry().face_measure[f]).sum();
        assert!(
            (area - 1.0).abs() < 1e-13
                && faces.iter().all(|&f| (prisms.geometry().face_center[f][axis] - at).abs() < 1e-14)
        );
    }

    let tets = Mesh::new(simplices(&prisms).unwrap()).unwrap();
    check("tetrahedra", &tets);
    assert_eq!(tets.cell_count(), 3 * prisms.cell_count());
    assert_eq!(tets.network().face_count(), 2 * prisms.network().face_count());
    assert_eq!(tets.nodes().count(), prisms.nodes().count());
    assert_eq!(crossings(&tets), 6 * 3);
    assert!((measure(&tets) - 1.0).abs() < 1e-13);
}

#[test]
fn extrusion_refuses_what_it_cannot_do() {
    let plane = Mesh::new(cartesian(Vec3::ZERO, Vec3::ONE, [2, 2, 0])).unwrap();
    let error = extrude(&plane, &[0.0, 0.0, f64::NAN], |_, _| true).unwrap_err();
    assert!(matches!(
        error.problems[..],
        [InputProblem::Levels { index: 1, .. }, InputProblem::Levels { index: 2, .. }]
    ));
    assert!(matches!(extrude(&plane, &[1.0], |_, _| true).unwrap_err().problems[..], [InputProblem::Levels { .. }]));
    let solid = Mesh::new(extrude(&plane, &[0.0, 1.0], |_, _| true).unwrap()).unwrap();
    let error = extrude(&solid, &[0.0, 1.0], |_, _| true).unwrap_err();
    assert_eq!(error.problems, [InputProblem::Dimension { needed: 2, found: 3 }]);
}
