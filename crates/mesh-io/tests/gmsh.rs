//! Reading meshes that Gmsh 4.15 made; tests/data/README.md says how.

use std::path::PathBuf;

use mesh::{EdgeKind, Mesh, MeshData};
use mesh_io::{FileError, read_gmsh};

fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn read(name: &str) -> Mesh {
    Mesh::new(read_gmsh(data(name)).unwrap()).unwrap()
}

fn edges(mesh: &Mesh, kind: EdgeKind) -> usize {
    (0..mesh.network().edge_count()).filter(|&e| mesh.network().edge_kind(e) == kind).count()
}

fn of_fracture(mesh: &Mesh, name: &str) -> f64 {
    let network = mesh.network();
    (network.faces.iter().zip(&network.fracture))
        .filter(|&(_, &fracture)| mesh.data().fractures[fracture] == name)
        .map(|(&face, _)| mesh.geometry().face_measure[face])
        .sum()
}

fn tagged(mesh: &Mesh, tag: &str) -> f64 {
    mesh.tagged_faces(tag).map(|face| mesh.geometry().face_measure[face]).sum()
}

fn region(mesh: &Mesh, name: &str) -> f64 {
    mesh.region_cells(name).map(|cell| mesh.geometry().cell_measure[cell]).sum()
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-12
}

#[test]
fn a_plane_with_groups() {
    for name in ["plane-text.msh", "plane-binary.msh", "mixed-text.msh"] {
        let mesh = read(name);
        assert_eq!(mesh.dim(), 2);
        assert!(close(region(&mesh, "left rock"), 1.0) && close(region(&mesh, "right rock"), 1.0), "{name}");
        assert!(close(of_fracture(&mesh, "fault"), 1.0) && close(of_fracture(&mesh, "crack"), 0.4), "{name}");
        // The group without a name is called by its number.
        assert!(close(tagged(&mesh, "bottom"), 2.0) && close(tagged(&mesh, "37"), 1.0), "{name}");
        assert_eq!((edges(&mesh, EdgeKind::Tip), edges(&mesh, EdgeKind::Boundary)), (2, 2), "{name}");
    }
    // Also quadrilaterals.
    let mixed = read("mixed-text.msh");
    assert!((0..mixed.cell_count()).any(|cell| mixed.cell_faces(cell).len() == 4));
}

#[test]
fn text_and_binary_are_the_same() {
    for name in ["plane", "solid"] {
        let [text, binary] = ["text", "binary"].map(|kind| read_gmsh(data(&format!("{name}-{kind}.msh"))).unwrap());
        let rounded = |mut data: MeshData| {
            data.map_vertices(|x| (x * 1e9).round());
            data
        };
        assert_eq!(rounded(text), rounded(binary));
    }
}

#[test]
fn a_solid_with_groups() {
    let mesh = read("solid-binary.msh");
    assert_eq!(mesh.dim(), 3);
    assert!(close(region(&mesh, "rock mass"), 1.0));
    assert!(close(of_fracture(&mesh, "fracture"), 0.36));
    assert!(close(tagged(&mesh, "top"), 1.0));
    assert!(edges(&mesh, EdgeKind::Tip) > 0 && edges(&mesh, EdgeKind::Boundary) == 0);
}

#[test]
fn prisms_and_hexahedra() {
    let mesh = read("layers-text.msh");
    let count = |n: usize| (0..mesh.cell_count()).filter(|&cell| mesh.cell_faces(cell).len() == n).count();
    assert!(count(5) > 0 && count(6) > 0 && count(5) + count(6) == mesh.cell_count());
    assert!(close(region(&mesh, "1"), 2.0) && close(tagged(&mesh, "base"), 2.0));
}

/// Writes `bytes` to a file and reads it.
fn attempt(bytes: &[u8]) -> Result<MeshData, FileError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.msh");
    std::fs::write(&path, bytes).unwrap();
    read_gmsh(&path)
}

#[test]
fn nodes_may_come_in_any_order() {
    // Numbers without gaps, but not ascending.
    let text = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 3 1 3\n2 1 0 3\n3\n1\n2\n0 1 0\n0 0 0\n1 0 0\n$EndNodes\n\
                $Elements\n1 1 1 1\n2 1 2 1\n1 1 2 3\n$EndElements\n";
    let data = attempt(text.as_bytes()).unwrap();
    assert_eq!(data.vertices.iter().map(|x| (x.x, x.y)).collect::<Vec<_>>(), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]);
    assert_eq!(data.regions, ["rock"]);
}

/// A file of one element, of this kind, at these points.
fn element(kind: u32, points: &[[f64; 3]]) -> String {
    let n = points.len();
    let numbers: Vec<String> = (1..=n).map(|i| i.to_string()).collect();
    let coordinates: Vec<String> = points.iter().map(|[x, y, z]| format!("{x} {y} {z}")).collect();
    format!(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {n} 1 {n}\n3 1 0 {n}\n{}\n{}\n$EndNodes\n\
         $Elements\n1 1 1 1\n3 1 {kind} 1\n1 {}\n$EndElements\n",
        numbers.join("\n"),
        coordinates.join("\n"),
        numbers.join(" ")
    )
}

/// Corners in the order of Gmsh's manual; all faces are on the boundary.
#[test]
fn each_kind_of_solid_has_its_faces() {
    let [a, b, c, d] = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    let up = |p: [f64; 3]| [p[0], p[1], 1.0];
    let (half, root) = (0.5, |x: f64| x.sqrt());
    let cases = [
        ("tetrahedron", 4, vec![a, b, d, up(a)], 4, 1.0 / 6.0, 1.5 + root(0.75)),
        ("hexahedron", 5, vec![a, b, c, d, up(a), up(b), up(c), up(d)], 6, 1.0, 6.0),
        ("prism", 6, vec![a, b, d, up(a), up(b), up(d)], 5, 0.5, 3.0 + root(2.0)),
        ("pyramid", 7, vec![a, b, c, d, [half, half, 1.0]], 5, 1.0 / 3.0, 1.0 + root(5.0)),
    ];
    for (name, kind, points, faces, volume, area) in cases {
        let mesh = Mesh::new(attempt(element(kind, &points).as_bytes()).unwrap()).unwrap();
        assert_eq!((mesh.cell_count(), mesh.face_count()), (1, faces), "{name}");
        assert!(close(mesh.geometry().cell_measure[0], volume), "{name}: {}", mesh.geometry().cell_measure[0]);
        assert!(close(mesh.geometry().face_measure.iter().sum(), area), "{name}");
    }
}

#[test]
fn lines_may_end_as_on_windows() {
    let text = std::fs::read_to_string(data("plane-text.msh")).unwrap();
    assert_eq!(attempt(text.replace('\n', "\r\n").as_bytes()).unwrap(), attempt(text.as_bytes()).unwrap());
}

#[test]
fn nodes_may_have_parameters() {
    let text = std::fs::read_to_string(data("plane-text.msh")).unwrap();
    // The node in a corner is on a point, which has none; the next is on a curve.
    let lines: Vec<&str> = text.lines().collect();
    let block =
        lines.iter().position(|line| line.starts_with("1 ") && line.ends_with(" 0 1") && line.len() < 10).unwrap();
    let with = [
        &lines[..block],
        &[&lines[block].replacen(" 0 1", " 1 1", 1), lines[block + 1], &format!("{} 0.25", lines[block + 2])],
        &lines[block + 3..],
    ];
    assert_eq!(attempt(with.concat().join("\n").as_bytes()).unwrap(), attempt(text.as_bytes()).unwrap());
}

/// Gmsh gives an entity that lies the other way in its group a minus sign.
#[test]
fn the_first_group_of_an_entity_counts_whatever_its_sense() {
    let text = std::fs::read_to_string(data("plane-text.msh")).unwrap();
    let plain = attempt(text.as_bytes()).unwrap();
    for groups in ["1 -37", "2 37 5", "2 -37 4"] {
        let changed = text.replace("1 37 2 2 -3", &format!("{groups} 2 2 -3"));
        assert_ne!(changed, text);
        assert_eq!(attempt(changed.as_bytes()).unwrap(), plain, "{groups}");
    }
}

#[test]
fn damaged_files_are_refused() {
    let text = std::fs::read_to_string(data("plane-text.msh")).unwrap();
    let problem = |text: String| attempt(text.as_bytes()).unwrap_err();
    assert!(matches!(problem(text.replace("4.1 0 8", "2.2 0 8")), FileError::Version { found, .. } if found == "2.2"));
    assert!(matches!(read_gmsh("nowhere.msh"), Err(FileError::Io { .. })));
    let about = |error: FileError, entry: &str, part: &str| {
        let text = error.to_string();
        assert!(text.contains("damaged.msh") && text.contains(entry) && text.contains(part), "{text}");
    };
    about(problem(String::new()), "$MeshFormat", "missing");
    about(problem(text.replace("$Nodes", "$Knots")), "$Nodes", "missing");
    about(problem(text.replace("1 4 \"fault\"", "1 4 fault")), "$PhysicalNames", "quotation");
    about(problem(text.replace("4.1 0 8", "4.1 1 8")), "$MeshFormat", "little-endian");
    let line = text.lines().nth(text.lines().position(|l| l == "$Elements").unwrap() + 1).unwrap();
    about(problem(text.replace(line, &format!("9{line}"))), "$Elements", "number");
    about(problem(text.replace(line, &format!("99999999{line}"))), "$Elements", "exceeds");
    // Second order.
    let block = text.lines().find(|l| l.starts_with("2 1 2 ")).unwrap();
    about(
        problem(text.replace(block, &block.replacen("2 1 2", "2 1 9", 1))),
        "$Elements",
        "type 9 are not read; points, lines",
    );
    // Groups that cannot be read are not taken for none.
    about(problem(text.replace("$EndEntities", "$EndOfEntities")), "$Entities", "no end");
    let partitioned =
        text.replace("$EndEntities\n", "$EndEntities\n$PartitionedEntities\n2\n$EndPartitionedEntities\n");
    about(problem(partitioned), "$PartitionedEntities", "unite");
}

#[test]
fn no_damage_makes_it_panic() {
    for name in ["plane-text.msh", "plane-binary.msh", "layers-text.msh"] {
        let bytes = std::fs::read(data(name)).unwrap();
        for cut in (0..bytes.len() - 1).step_by(37) {
            assert!(attempt(&bytes[..cut]).is_err(), "{name} cut at {cut}");
        }
        for i in (0..bytes.len()).step_by(5) {
            let mut damaged = bytes.clone();
            damaged[i] ^= 1 << (i % 8);
            // Whether it still is a mesh does not matter.
            let _ = attempt(&damaged).map(Mesh::new);
        }
    }
}
