//! Results for ParaView, read back.

use mesh::{Mesh, Vec3, zoo};
use mesh_io::{Field, FileError, write_fracture_vtu, write_pvd, write_vtu};

/// The bytes of an array, without the eight that tell their number.
fn array(text: &str, name: &str) -> Vec<u8> {
    let at = text.find(&format!("Name=\"{name}\"")).unwrap_or_else(|| panic!("no array {name}"));
    let start = at + text[at..].find('>').unwrap() + 1;
    let code = &text[start..start + text[start..].find('<').unwrap()];
    let digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut bytes = Vec::new();
    assert_eq!(code.len() % 4, 0);
    for group in code.as_bytes().chunks(4) {
        let bits = group.iter().fold(0_usize, |bits, &c| bits << 6 | digits.find(char::from(c)).unwrap_or(0));
        let padding = group.iter().filter(|&&c| c == b'=').count();
        bytes.extend_from_slice(&(bits as u32).to_be_bytes()[1..4 - padding]);
    }
    let (length, rest) = bytes.split_at(8);
    assert_eq!(u64::from_le_bytes(length.try_into().unwrap()) as usize, rest.len());
    rest.to_vec()
}

fn integers(text: &str, name: &str) -> Vec<i64> {
    array(text, name).chunks_exact(8).map(|b| i64::from_le_bytes(b.try_into().unwrap())).collect()
}

fn floats(text: &str, name: &str) -> Vec<f64> {
    array(text, name).chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
}

#[test]
fn cells_and_fields_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cells.vtu");
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data).unwrap();
        let volume = &mesh.geometry().cell_measure;
        let displacement: Vec<Vec3> = (0..mesh.nodes().count()).map(|node| Vec3::new(node as f64, 0.5, -1.0)).collect();
        let fields = [Field::scalars("volume & <more>", volume)];
        write_vtu(&path, &mesh, &[Field::vectors("displacement", &displacement)], &fields).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(floats(&text, "volume &amp; &lt;more&gt;"), *volume);
        let flat: Vec<f64> = displacement.iter().flat_map(|v| v.to_array()).collect();
        assert_eq!(floats(&text, "displacement"), flat);
        let x: Vec<Vec3> = floats(&text, "Points").chunks(3).map(Vec3::from_slice).collect();
        let [connectivity, offsets] = ["connectivity", "offsets"].map(|name| integers(&text, name));
        let types = array(&text, "types");
        let mut start = 0;
        for cell in 0..mesh.cell_count() {
            let points = &connectivity[start..offsets[cell] as usize];
            start = offsets[cell] as usize;
            let p = |i: usize| x[points[i] as usize];
            // A cell's points are its vertices; on fractures they are its own.
            let mut nodes: Vec<i64> = mesh.nodes().of_cell(cell).iter().map(|&n| n as i64).collect();
            let mut own = points.to_vec();
            nodes.sort_unstable();
            own.sort_unstable();
            assert_eq!(own, nodes, "{}", specimen.name);
            match types[cell] {
                10 => {
                    let signed = (p(1) - p(0)).cross(p(2) - p(0)).dot(p(3) - p(0)) / 6.0;
                    assert!((signed - volume[cell]).abs() < 1e-12 * volume[cell], "{}", specimen.name);
                }
                5 | 7 => {
                    let n = points.len();
                    let signed: f64 = (0..n).map(|i| 0.5 * (p(i) - p(0)).cross(p((i + 1) % n) - p(0)).z).sum();
                    assert!((signed - volume[cell]).abs() < 1e-10 * volume[cell], "{}", specimen.name);
                    assert_eq!(types[cell] == 5, n == 3);
                }
                kind => assert_eq!(kind, 42),
            }
        }
        if types.contains(&42) {
            check_polyhedra(&mesh, &x, &types, &integers(&text, "faces"), &integers(&text, "faceoffsets"));
        }
    }
}

/// The faces of polyhedra close: their vectors sum to zero, and they enclose the volume.
fn check_polyhedra(mesh: &Mesh, x: &[Vec3], types: &[u8], faces: &[i64], ends: &[i64]) {
    let mut at = 0;
    for cell in 0..mesh.cell_count() {
        if types[cell] != 42 {
            assert_eq!(ends[cell], -1);
            continue;
        }
        let mut volume = 0.0;
        let count = faces[at];
        at += 1;
        assert_eq!(count as usize, mesh.cell_faces(cell).len());
        for _ in 0..count {
            let n = faces[at] as usize;
            let list: Vec<Vec3> = faces[at + 1..=at + n].iter().map(|&i| x[i as usize]).collect();
            at += n + 1;
            let mean = list.iter().sum::<Vec3>() / n as f64;
            volume += (0..n).map(|i| mean.dot(list[i].cross(list[(i + 1) % n])) / 6.0).sum::<f64>();
        }
        assert_eq!(ends[cell] as usize, at);
        let expected = mesh.geometry().cell_measure[cell];
        assert!((volume - expected).abs() < 1e-9 * expected.max(1e-4), "{volume} {expected}");
    }
    assert_eq!(at, faces.len());
}

#[test]
fn fracture_faces_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fractures.vtu");
    for specimen in zoo::all() {
        let mesh = Mesh::new(specimen.data).unwrap();
        let network = mesh.network();
        let size: Vec<f64> = network.faces.iter().map(|&f| mesh.geometry().face_measure[f]).collect();
        write_fracture_vtu(&path, &mesh, &[Field::scalars("size", &size)]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(floats(&text, "size"), size);
        let fracture: Vec<i64> = network.fracture.iter().map(|&i| i as i64).collect();
        assert_eq!(integers(&text, "fracture"), fracture);
        let x: Vec<Vec3> = floats(&text, "Points").chunks(3).map(Vec3::from_slice).collect();
        let vertices: Vec<Vec3> = (network.faces.iter())
            .flat_map(|&face| mesh.face_vertices(face).iter().map(|&v| mesh.vertices()[v]))
            .collect();
        let read: Vec<Vec3> = integers(&text, "connectivity").iter().map(|&i| x[i as usize]).collect();
        assert_eq!(read, vertices);
    }
}

#[test]
fn fields_must_have_one_value_for_each_entity() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cells.vtu");
    let mesh = Mesh::new(zoo::plane().swap_remove(0).data).unwrap();
    let short = [1.0];
    let expect = |result: Result<(), FileError>, what: &str| {
        assert!(matches!(result, Err(FileError::FieldLength { entity, found: 1, .. }) if entity == what));
    };
    expect(write_vtu(&path, &mesh, &[Field::scalars("a", &short)], &[]), "nodes");
    expect(write_vtu(&path, &mesh, &[], &[Field::scalars("a", &short)]), "cells");
    expect(write_fracture_vtu(&path, &mesh, &[Field::scalars("a", &short)]), "fracture faces");
    assert!(!path.exists());
}

#[test]
fn series_list_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("series.pvd");
    write_pvd(&path, &[(0.0, "a.vtu".into()), (100.5, "b&c.vtu".into())]).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("<DataSet timestep=\"0\" file=\"a.vtu\"/>"));
    assert!(text.contains("<DataSet timestep=\"100.5\" file=\"b&amp;c.vtu\"/>"));
}
