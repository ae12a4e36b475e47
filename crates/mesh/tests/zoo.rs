//! Every mesh of the zoo: identities, and what must not depend on numbering, place and size.

mod common;

use common::{check, measure};
use mesh::generate::cartesian;
use mesh::{EdgeKind, Mesh, Vec3, tangents, zoo};

fn kinds(mesh: &Mesh) -> [usize; 4] {
    let kinds = [EdgeKind::Inner, EdgeKind::Tip, EdgeKind::Boundary, EdgeKind::Intersection];
    kinds.map(|kind| (0..mesh.network().edge_count()).filter(|&e| mesh.network().edge_kind(e) == kind).count())
}

#[test]
fn identities_hold() {
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data).unwrap_or_else(|error| panic!("{}: {error}", specimen.name));
        check(specimen.name, &mesh);
        assert!((measure(&mesh) / specimen.measure - 1.0).abs() < 1e-12, "{}: {}", specimen.name, measure(&mesh));
    }
}

#[test]
fn the_zoo_has_every_kind_of_fracture_edge() {
    for zoo in [zoo::plane(), zoo::solid()] {
        let mut total = [0; 4];
        for specimen in zoo {
            let own = kinds(&Mesh::new(specimen.data).unwrap());
            (0..4).for_each(|i| total[i] += own[i].min(1));
        }
        assert!(total.iter().all(|&n| n >= 3), "{total:?}");
    }
}

#[test]
fn numbering_does_not_matter() {
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data.clone()).unwrap();
        let (data, new) = specimen.data.renumbered(11);
        let other = Mesh::new(data).unwrap();
        check(specimen.name, &other);
        assert_eq!(other.nodes().count(), mesh.nodes().count(), "{}", specimen.name);
        assert_eq!(kinds(&other), kinds(&mesh), "{}", specimen.name);
        for cell in 0..mesh.cell_count() {
            let (a, b) = (mesh.geometry().cell_measure[cell], other.geometry().cell_measure[new.cells[cell]]);
            assert!((a - b).abs() < 1e-11 * a, "{}: {a} {b}", specimen.name);
            assert_eq!(mesh.data().cell_region[cell], other.data().cell_region[new.cells[cell]], "{}", specimen.name);
        }
        for &face in &mesh.network().faces {
            let (a, b) = (mesh.geometry().face_normal(face), other.geometry().face_normal(new.faces[face]));
            assert!(a.distance(b) < 1e-9, "{}: {a} {b}", specimen.name);
        }
        assert_ne!(mesh.fingerprint(), other.fingerprint());
    }
}

#[test]
fn motion_and_scale_do_not_matter() {
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data.clone()).unwrap();
        let mut data = specimen.data.clone();
        let axis = if data.dim == 2 { Vec3::Z } else { Vec3::new(1.0, 2.0, -0.5) };
        data.move_rigidly(axis, 0.7, Vec3::new(3.0, -2.0, if mesh.dim() == 2 { 0.0 } else { 1.0 }));
        data.scale(100.0);
        let other = Mesh::new(data).unwrap();
        check(specimen.name, &other);
        assert_eq!((other.nodes().count(), kinds(&other)), (mesh.nodes().count(), kinds(&mesh)), "{}", specimen.name);
        let factor = 100.0_f64.powi(mesh.dim() as i32);
        assert!((measure(&other) / measure(&mesh) / factor - 1.0).abs() < 1e-11, "{}", specimen.name);
    }
}

#[test]
fn edges_know_all_boundary_faces_that_contain_them() {
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data).unwrap();
        let network = mesh.network();
        for edge in 0..network.edge_count() {
            let ends = network.edge_vertices.get(edge);
            let contains = |face: &usize| {
                let list = mesh.face_vertices(*face);
                let pairs = (0..list.len()).map(|i| [list[i], list[(i + 1) % list.len()]]);
                pairs.into_iter().any(|pair| ends.iter().all(|v| pair.contains(v)))
            };
            let wanted: Vec<usize> = (0..mesh.face_count()).filter(|&f| mesh.is_boundary(f)).filter(contains).collect();
            let mut found = network.edge_boundary.get(edge).to_vec();
            found.sort_unstable();
            assert_eq!(found, wanted, "{}: edge {edge}", specimen.name);
        }
    }
}

/// Cells that share a face which is no fracture share the nodes on it, and those on both sides of a fracture do not unless it
/// ends there.
#[test]
fn nodes_are_those_of_their_vertices_and_split_along_fractures() {
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data).unwrap();
        let (nodes, network) = (mesh.nodes(), mesh.network());
        let tips = (0..network.edge_count()).filter(|&e| network.edge_kind(e) == EdgeKind::Tip);
        let tips: Vec<usize> = tips.flat_map(|e| network.edge_vertices.get(e).to_vec()).collect();
        let mut used = vec![false; nodes.count()];
        for cell in 0..mesh.cell_count() {
            let own = nodes.of_cell(cell);
            own.iter().for_each(|&node| used[node] = true);
            let vertices: Vec<usize> = own.iter().map(|&node| nodes.vertices()[node]).collect();
            assert_eq!(vertices, mesh.cell_vertices(cell), "{}", specimen.name);
        }
        assert!(used.iter().all(|&used| used), "{}", specimen.name);
        for face in 0..mesh.face_count() {
            let (first, Some(second)) = mesh.face_cells(face) else { continue };
            let on = |cell: usize| -> Vec<usize> {
                let vertices = mesh.cell_vertices(cell);
                let node = |v: &usize| nodes.of_cell(cell)[vertices.binary_search(v).unwrap()];
                mesh.face_vertices(face).iter().map(node).collect()
            };
            let shared = on(first).iter().zip(on(second)).filter(|&(a, b)| *a == b).count();
            let list = mesh.face_vertices(face);
            match network.number_of_face[face] {
                None => assert_eq!(shared, list.len(), "{}", specimen.name),
                Some(_) if list.iter().all(|v| tips.contains(v)) => {}
                Some(_) => assert!(shared < list.len(), "{}: face {face} is not split", specimen.name),
            }
        }
    }
}

#[test]
fn polygons_run_counter_clockwise() {
    for specimen in zoo::plane() {
        let mesh = Mesh::new(specimen.data).unwrap();
        for cell in 0..mesh.cell_count() {
            let corners: Vec<Vec3> = mesh.cell_polygon(cell).into_iter().map(|v| mesh.vertices()[v]).collect();
            assert_eq!(corners.len(), mesh.cell_faces(cell).len(), "{}", specimen.name);
            let next = |i: usize| corners[(i + 1) % corners.len()];
            let area: f64 = (0..corners.len()).map(|i| 0.5 * corners[i].cross(next(i)).z).sum();
            let measure = mesh.geometry().cell_measure[cell];
            assert!(
                (area - measure).abs() < 1e-12 * (measure + 1.0),
                "{}, cell {cell}: {area} {measure}",
                specimen.name
            );
        }
    }
}

#[test]
fn changes_of_data_do_what_they_say() {
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [2, 2, 0]);
    // Inner faces have no tag.
    data.tag_boundary(|x| (x.y > 0.25).then_some("most"));
    let mesh = Mesh::new(data.clone()).unwrap();
    let length = |tag| mesh.tagged_faces(tag).map(|f| mesh.geometry().face_measure[f]).sum::<f64>();
    assert_eq!(["bottom", "left", "most"].map(length), [1.0, 0.5, 2.0]);
    assert_eq!(mesh.region_cells("sand").count(), 0);
    data.move_rigidly(Vec3::Z, std::f64::consts::FRAC_PI_2, Vec3::X);
    assert!(data.vertices[1].distance(Vec3::new(1.0, 0.5, 0.0)) < 1e-15, "{}", data.vertices[1]);
}

#[test]
fn bases_are_right_handed_and_along_the_strike() {
    let [t1, t2] = tangents(2, Vec3::new(0.6, 0.8, 0.0));
    assert!(t1.distance(Vec3::new(-0.8, 0.6, 0.0)) < 1e-15 && t2.distance(Vec3::Z) < 1e-15, "{t1} {t2}");
    let dipping = Vec3::new(0.0, -0.6, 0.8);
    let [t1, t2] = tangents(3, dipping);
    // The strike is ẑ × n, and t₂ points up the dip.
    assert!(t1.distance(Vec3::X) < 1e-15 && t2.distance(Vec3::new(0.0, 0.8, 0.6)) < 1e-15, "{t1} {t2}");
    for n in [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::new(1e-9, 0.0, 1.0), Vec3::new(1.0, 2.0, -3.0).normalize()] {
        let [t1, t2] = tangents(3, n);
        assert!(t1.cross(t2).distance(n) < 1e-8 && (t1.length() - 1.0).abs() < 1e-15, "{n}: {t1} {t2}");
        assert!(t1.dot(n).abs() < 1e-15 && t1.z.abs() < 1e-8, "{n}: {t1}");
    }
    assert_eq!(tangents(3, Vec3::Z)[0], Vec3::X);
}

#[test]
fn sides_are_swapped() {
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data.clone()).unwrap();
        let other = Mesh::with_swapped_sides(specimen.data).unwrap();
        for face in 0..mesh.face_count() {
            let ((a, b), (c, d)) = (mesh.face_cells(face), other.face_cells(face));
            let swapped = mesh.network().number_of_face[face].is_some();
            assert_eq!((a, b), if swapped { (d.unwrap(), Some(c)) } else { (c, d) }, "{}", specimen.name);
        }
    }
}

#[test]
fn points_are_located() {
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data).unwrap();
        let locator = mesh.locator();
        let x = mesh.vertices();
        for cell in 0..mesh.cell_count() {
            // A point just inside each face.
            for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
                let list = mesh.face_vertices(face);
                let mean = list.iter().map(|&v| x[v]).sum::<Vec3>() / list.len() as f64;
                let middle = if mesh.dim() == 2 { mean } else { (x[list[0]] + x[list[1]] + mean) / 3.0 };
                let normal = if mesh.dim() == 2 {
                    mesh.geometry().face_normal(face)
                } else {
                    (x[list[0]] - mean).cross(x[list[1]] - mean).normalize()
                };
                let depth = 1e-6 * mesh.geometry().cell_measure[cell]
                    / mesh.geometry().cell_diameter[cell].powi(mesh.dim() as i32 - 1);
                let point = middle - sign * depth * normal;
                // In a face that is not convex the triangle with the mean may lie beside the face.
                if mesh.dim() == 2 || mesh.cell_faces(cell).len() == 4 {
                    assert_eq!(locator.locate(point), Some(cell), "{}", specimen.name);
                }
                if cell % 16 == 0 {
                    assert_eq!(locator.locate(point), mesh.locate(point), "{}", specimen.name);
                }
                let (first, second) = mesh.face_cells(face);
                let on_face = locator.locate(mean);
                if list.len() == mesh.dim() {
                    assert!(on_face == Some(first) || (on_face.is_some() && on_face == second), "{}", specimen.name);
                }
            }
        }
        for &point in x {
            let cell = locator.locate(point).unwrap_or_else(|| panic!("{}: vertex at {point}", specimen.name));
            assert!(mesh.cell_vertices(cell).iter().any(|&v| x[v].distance(point) < 1e-5), "{}", specimen.name);
        }
        assert_eq!(locator.locate(Vec3::new(77.0, 0.5, 0.0)), None);
        assert_eq!(locator.locate(Vec3::NAN), None);
        let mut outside = x.iter().fold(Vec3::INFINITY, |m, &p| m.min(p));
        outside.x -= 1e-6;
        assert_eq!(locator.locate(outside), None);
    }
}

#[test]
fn fingerprints_tell_meshes_apart() {
    let all: Vec<String> =
        zoo::all().into_iter().map(|specimen| Mesh::new(specimen.data).unwrap().fingerprint()).collect();
    let mut different = all.clone();
    different.sort();
    different.dedup();
    assert_eq!(different.len(), all.len());
    assert!(all[0].len() == 64 && all[0].chars().all(|c| c.is_ascii_hexdigit()));
    let one = zoo::plane().swap_remove(0).data;
    let mut renamed = one.clone();
    renamed.tags[0].push('x');
    assert_eq!(Mesh::new(one.clone()).unwrap().fingerprint(), all[0]);
    assert_eq!(Mesh::new(renamed).unwrap().fingerprint(), all[0]);
    // A face of another fracture.
    let mut renumbered = one.clone();
    let marked = renumbered.face_fracture.iter_mut().find(|f| **f == Some(0)).unwrap();
    *marked = Some(1);
    assert_ne!(Mesh::new(renumbered).unwrap().fingerprint(), all[0]);
    // −0 is 0.
    let mut signed = one.clone();
    let zero = signed.vertices.iter_mut().find(|x| x.y == 0.0).unwrap();
    zero.y = -0.0;
    assert_eq!(Mesh::new(signed).unwrap().fingerprint(), all[0]);
    let mut moved = one;
    moved.vertices[3].x += 1e-12;
    assert_ne!(Mesh::new(moved).unwrap().fingerprint(), all[0]);
}
