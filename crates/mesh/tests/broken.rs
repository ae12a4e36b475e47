//! Broken meshes are refused with the reason, and nothing panics.

use mesh::generate::cartesian;
use mesh::{Lists, Mesh, MeshData, Problem, Vec3, zoo};
use proptest::prelude::*;

fn squares() -> MeshData {
    cartesian(Vec3::ZERO, Vec3::ONE, [2, 2, 0])
}

fn cubes() -> MeshData {
    cartesian(Vec3::ZERO, Vec3::ONE, [2, 2, 2])
}

/// The problems after a change of a sound mesh.
fn problems(mut data: MeshData, change: impl FnOnce(&mut MeshData)) -> Vec<Problem> {
    change(&mut data);
    Mesh::new(data).unwrap_err().problems
}

/// The lists with one changed.
fn with(lists: &Lists, i: usize, change: impl FnOnce(&mut Vec<usize>)) -> Lists {
    let mut all: Vec<Vec<usize>> = lists.iter().map(<[usize]>::to_vec).collect();
    change(&mut all[i]);
    all.into_iter().collect()
}

macro_rules! assert_has {
    ($problems:expr, $pattern:pat $(if $guard:expr)?) => {{
        let problems = $problems;
        assert!(problems.iter().any(|p| matches!(p, $pattern $(if $guard)?)), "{problems:?}");
    }};
}

#[test]
fn dimension_and_emptiness() {
    assert_has!(problems(squares(), |d| d.dim = 4), Problem::Dimension { dimension: 4 });
    assert_eq!(
        Mesh::new(MeshData::default()).unwrap_err().problems,
        [Problem::Dimension { dimension: 0 }, Problem::Empty]
    );
}

#[test]
fn lengths_indices_and_names() {
    let found = problems(squares(), |d| {
        d.cell_region.pop();
        d.face_tag.push(None);
        d.face_fracture[0] = Some(3);
        d.faces = with(&d.faces, 2, |list| list[1] = 99);
        d.cells = with(&d.cells, 1, |list| list[0] = 77);
        d.regions.push("rock".into());
        d.tags.push(String::new());
    });
    assert_has!(&found, Problem::Length { array: "cell_region", found: 3, expected: 4, .. });
    assert_has!(&found, Problem::Length { array: "face_tag", found: 13, expected: 12, .. });
    assert_has!(&found, Problem::OutOfRange { entity: "face", number: 0, target: "fracture", index: 3, count: 0 });
    assert_has!(&found, Problem::OutOfRange { entity: "face", number: 2, target: "vertex", index: 99, count: 9 });
    assert_has!(&found, Problem::OutOfRange { entity: "cell", number: 1, target: "face", index: 77, count: 12 });
    assert_has!(&found, Problem::Name { kind: "region", name } if name == "rock");
    assert_has!(&found, Problem::Name { kind: "tag", name } if name.is_empty());
    assert_eq!(found.len(), 7);
    assert_has!(problems(squares(), |d| d.cell_region[2] = 1), Problem::OutOfRange { target: "region", index: 1, .. });
    assert_has!(problems(squares(), |d| d.face_tag[2] = Some(9)), Problem::OutOfRange { target: "tag", index: 9, .. });
}

#[test]
fn vertices() {
    // Once, and not again for what touches it.
    assert!(matches!(problems(squares(), |d| d.vertices[4].x = f64::NAN)[..], [Problem::Coordinate { vertex: 4, .. }]));
    assert_has!(problems(squares(), |d| d.vertices[4].z = 0.1), Problem::Coordinate { vertex: 4, .. });
    assert_has!(
        problems(squares(), |d| d.vertices.push(Vec3::splat(7.0).with_z(0.0))),
        Problem::UnusedVertex { vertex: 9 }
    );
    assert_has!(
        problems(squares(), |d| d.vertices[4] = d.vertices[1]),
        Problem::CoincidentVertices { first: 1, second: 4, .. }
    );
    // Also where zero has a sign.
    let signed =
        |d: &mut MeshData| (d.vertices[3], d.vertices[0]) = (Vec3::new(0.0, -0.0, 0.0), Vec3::new(-0.0, 0.0, 0.0));
    assert_has!(problems(squares(), signed), Problem::CoincidentVertices { first: 0, second: 3, .. });
    // Coordinates too large for areas.
    assert_has!(problems(cubes(), |d| d.scale(1e200)), Problem::DegenerateFace { face: 0, .. });
}

#[test]
fn faces() {
    let two = |d: &mut MeshData| d.faces = with(&d.faces, 3, |list| list.truncate(2));
    assert_has!(problems(cubes(), two), Problem::VertexCount { face: 3, count: 2 });
    assert_has!(
        problems(squares(), |d| d.faces = with(&d.faces, 3, |list| list.push(0))),
        Problem::VertexCount { face: 3, count: 3 }
    );
    assert_has!(
        problems(cubes(), |d| d.faces = with(&d.faces, 3, |list| list[1] = list[0])),
        Problem::RepeatedVertex { face: 3, .. }
    );
    assert_has!(
        problems(cubes(), |d| d.faces = with(&d.faces, 3, |list| list[2] = list[0])),
        Problem::RepeatedVertex { face: 3, .. }
    );
    // A box without height: all upright faces are degenerate, and the cells.
    let flat = problems(cubes(), |d| d.map_vertices(|x| x * Vec3::new(1.0, 1.0, 1e-14)));
    assert!(flat.iter().filter(|p| matches!(p, Problem::DegenerateFace { .. })).count() >= 24);
    assert_has!(
        problems(squares(), |d| {
            let list = d.faces.get(0).to_vec();
            d.faces.push(list);
            d.face_tag.push(None);
            d.face_fracture.push(None);
        }),
        Problem::DuplicateFaces { first: 0, second: 12 }
    );
}

#[test]
fn cells_of_faces() {
    // Face 0 belongs to no cell; the cell that lost it is open at both ends.
    let found = problems(squares(), |d| d.cells = with(&d.cells, 0, |list| list.retain(|&f| f != 0)));
    assert_has!(&found, Problem::FaceCells { face: 0, cells } if cells.is_empty());
    assert_eq!(found.iter().filter(|p| matches!(p, Problem::OpenCell { cell: 0, count: 1, .. })).count(), 2);
    assert_has!(
        problems(squares(), |d| d.cells = with(&d.cells, 0, |list| list.push(list[0]))),
        Problem::FaceCells { cells, .. } if cells == &[0, 0]
    );
    // Three cells at a face.
    let again = |d: &mut MeshData| {
        let list = d.cells.get(0).to_vec();
        d.cells.push(list);
        d.cell_region.push(0);
    };
    assert_has!(problems(squares(), again), Problem::FaceCells { cells, .. } if cells.len() == 3);
    assert_has!(problems(cubes(), again), Problem::FaceCells { cells, .. } if cells.len() == 3);
    // An empty cell.
    assert_has!(
        problems(squares(), |d| {
            d.cells.push([]);
            d.cell_region.push(0);
        }),
        Problem::CellSurface { cell: 4 }
    );
    // Two squares that touch in one vertex are no cell.
    let mut data = squares();
    let [first, second, third, fourth] = [0, 1, 2, 3].map(|i| data.cells.get(i).to_vec());
    data.cells = [[first, fourth].concat(), second, third].into_iter().collect();
    data.cell_region.pop();
    assert_has!(Mesh::new(data).unwrap_err().problems, Problem::OpenCell { cell: 0, ridge, count: 4 } if ridge == &[4]);
    let open = problems(cubes(), |d| d.cells = with(&d.cells, 5, |list| list.truncate(list.len() - 1)));
    assert_eq!(open.iter().filter(|p| matches!(p, Problem::OpenCell { cell: 5, count: 1, .. })).count(), 4);
}

#[test]
fn surfaces_of_cells() {
    // One cell of two cubes apart.
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [3, 1, 1]);
    let [a, b, c] = [0, 1, 2].map(|i| data.cells.get(i).to_vec());
    data.cells = [[a, c].concat(), b].into_iter().collect();
    data.cell_region.pop();
    assert_has!(Mesh::new(data).unwrap_err().problems, Problem::CellSurface { cell: 0 });
    // A closed surface with one side only: the projective plane of ten triangles.
    let triangles =
        [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 1, 5], [1, 2, 4], [2, 3, 5], [1, 3, 4], [2, 4, 5], [1, 3, 5]];
    let corners = (0..6).map(|i| Vec3::new(f64::from(i), f64::from(i * i), f64::from(i * i * i)));
    let data = MeshData::from_polyhedra(corners.collect(), [triangles]);
    assert_has!(Mesh::new(data).unwrap_err().problems, Problem::CellSurface { cell: 0 });
    // Three points in a line.
    let flat = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
    let data = MeshData::from_polygons(flat.to_vec(), [[0, 1, 2], [0, 2, 3]]);
    assert_has!(Mesh::new(data).unwrap_err().problems, Problem::DegenerateCell { cell: 0, .. });
    // A triangle turned over lies over its neighbour.
    let over = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.2, 0.2]].map(|[x, y]| Vec3::new(x, y, 0.0));
    let data = MeshData::from_polygons(over.to_vec(), [[0, 1, 2], [1, 2, 3]]);
    assert_has!(Mesh::new(data).unwrap_err().problems, Problem::SameSide { first: 0, second: 1, .. });
    let bow = [[0.0, 0.0], [2.0, 1.0], [2.0, 0.0], [0.0, 2.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
    let data = MeshData::from_polygons(bow.to_vec(), [[0, 1, 2, 3]]);
    assert_has!(Mesh::new(data).unwrap_err().problems, Problem::CrossingFaces { cell: 0, first: 0, second: 2 });
}

#[test]
fn fractures_and_tags() {
    let found = problems(squares(), |d| {
        let fracture = d.fracture("crack");
        let inner = (0..12).find(|&f| d.face_tag[f].is_none()).unwrap();
        d.face_tag[inner] = Some(0);
        d.face_fracture[0] = Some(fracture);
    });
    assert_has!(&found, Problem::FractureOnBoundary { face: 0, fracture } if fracture == "crack");
    assert_has!(&found, Problem::TagInside { tag, .. } if tag == "bottom");
    assert_eq!(found.len(), 2);
    let text = Mesh::new(MeshData { dim: 2, ..MeshData::default() }).unwrap_err().to_string();
    assert_eq!(text, "the mesh has 1 problem:\n  there is no cell");
}

/// A random change of a mesh.
#[derive(Clone, Debug)]
enum Change {
    Face(prop::sample::Index, usize),
    Cell(prop::sample::Index, usize),
    Vertex(prop::sample::Index, usize, f64),
    DropFromFace(prop::sample::Index),
    DropFromCell(prop::sample::Index),
    Fracture(prop::sample::Index, Option<usize>),
    Tag(prop::sample::Index, Option<usize>),
    Region(prop::sample::Index, usize),
    Truncate(usize),
    Dimension(usize),
}

fn change() -> impl Strategy<Value = Change> {
    use Change::{Cell, Dimension, DropFromCell, DropFromFace, Face, Fracture, Region, Tag, Truncate, Vertex};
    let any = any::<prop::sample::Index>;
    let number = || prop_oneof![0..60_usize, Just(usize::MAX)];
    let value = prop_oneof![-2.0..2.0, Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(1e-300), Just(0.0)];
    prop_oneof![
        (any(), number()).prop_map(|(i, n)| Face(i, n)),
        (any(), number()).prop_map(|(i, n)| Cell(i, n)),
        (any(), 0..3_usize, value).prop_map(|(i, axis, x)| Vertex(i, axis, x)),
        any().prop_map(DropFromFace),
        any().prop_map(DropFromCell),
        (any(), prop::option::of(0..3_usize)).prop_map(|(i, n)| Fracture(i, n)),
        (any(), prop::option::of(0..3_usize)).prop_map(|(i, n)| Tag(i, n)),
        (any(), 0..3_usize).prop_map(|(i, n)| Region(i, n)),
        (0..5_usize).prop_map(Truncate),
        (0..5_usize).prop_map(Dimension),
    ]
}

fn apply(data: &mut MeshData, change: &Change) {
    let item = |lists: &Lists, i: &prop::sample::Index, edit: &dyn Fn(&mut Vec<usize>, usize)| {
        let k = i.index(lists.items().len());
        let list = (0..lists.len()).find(|&l| lists.range(l).contains(&k)).unwrap();
        with(lists, list, |own| edit(own, k - lists.range(list).start))
    };
    let remove = |list: &mut Vec<usize>, k: usize| {
        list.remove(k);
    };
    match change {
        Change::Face(i, n) => data.faces = item(&data.faces, i, &|list, k| list[k] = *n),
        Change::Cell(i, n) => data.cells = item(&data.cells, i, &|list, k| list[k] = *n),
        Change::DropFromFace(i) => data.faces = item(&data.faces, i, &remove),
        Change::DropFromCell(i) => data.cells = item(&data.cells, i, &remove),
        Change::Vertex(i, axis, x) => {
            let n = data.vertices.len();
            data.vertices[i.index(n)][*axis] = *x;
        }
        Change::Fracture(i, n) => *i.get_mut(&mut data.face_fracture) = *n,
        Change::Tag(i, n) => *i.get_mut(&mut data.face_tag) = *n,
        Change::Region(i, n) => *i.get_mut(&mut data.cell_region) = *n,
        Change::Truncate(0) => data.vertices.truncate(5),
        Change::Truncate(1) => data.face_tag.truncate(5),
        Change::Truncate(2) => data.face_fracture.truncate(5),
        Change::Truncate(3) => data.regions.clear(),
        Change::Truncate(_) => data.tags.clear(),
        Change::Dimension(n) => data.dim = *n,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Whatever is changed, the result is a mesh whose numbers are finite, or an error with a reason.
    #[test]
    fn nothing_panics(pick in any::<prop::sample::Index>(), changes in prop::collection::vec(change(), 1..4)) {
        thread_local! {
            static SMALL: Vec<MeshData> =
                zoo::all().into_iter().map(|s| s.data).filter(|d| d.cells.len() < 400).collect();
        }
        let mut data = SMALL.with(|all| pick.get(all).clone());
        let before = data.clone();
        for change in &changes {
            // A change may leave nothing for the next.
            let has_all = !data.faces.items().is_empty() && !data.cells.items().is_empty();
            if has_all && !data.face_fracture.is_empty() && !data.face_tag.is_empty() {
                apply(&mut data, change);
            }
        }
        match Mesh::new(data.clone()) {
            Ok(mesh) => {
                let g = mesh.geometry();
                prop_assert!(g.cell_measure.iter().all(|m| m.is_finite() && *m > 0.0));
                prop_assert!(g.face_vector.iter().all(|v| v.is_finite()));
                prop_assert!(g.cell_weight.iter().chain(&g.face_weight).all(|w| w.is_finite()));
            }
            Err(error) => {
                prop_assert!(!error.problems.is_empty());
                prop_assert!(data != before);
                prop_assert!(!error.to_string().is_empty());
            }
        }
    }
}
