//! Corner-point grids: faces where layers are displaced, gaps, pinch-outs, and what is refused.

mod common;

use common::{check, measure};
use mesh::generate::{CornerPoint, Fault, InputProblem};
use mesh::{Mesh, MeshData, Vec3};
use proptest::prelude::*;

fn upright(i: usize, j: usize) -> [Vec3; 2] {
    [0.0, 1.0].map(|z| Vec3::new(i as f64, j as f64, z))
}

fn made(grid: &CornerPoint, section: bool) -> (Mesh, Vec<usize>) {
    let (data, cells) = grid.build(section).unwrap();
    (Mesh::new(data).unwrap_or_else(|error| panic!("{error}")), cells)
}

/// Numbers of vertices of the faces that hold for `on`, ascending.
fn sizes(mesh: &Mesh, on: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut sizes: Vec<usize> =
        (0..mesh.face_count()).filter(|&f| on(f)).map(|f| mesh.face_vertices(f).len()).collect();
    sizes.sort_unstable();
    sizes
}

fn area(mesh: &Mesh, on: impl Fn(usize) -> bool) -> f64 {
    (0..mesh.face_count()).filter(|&f| on(f)).map(|f| mesh.geometry().face_measure[f]).sum()
}

/// Two columns of two cells; the right one lies lower by `throw` in front and `back` behind.
fn two_columns(throw: f64, back: f64) -> CornerPoint {
    CornerPoint::new([2, 1, 2], upright, |[i, _, k], [_, dj, dk]| {
        2.0 - (k + dk) as f64 - if i == 1 { [throw, back][dj] } else { 0.0 }
    })
}

#[test]
fn a_section_with_a_throw() {
    let mut grid = two_columns(0.25, 0.25);
    grid.faults.push(Fault { name: "f".into(), first: [1, 0, 0], last: [1, 0, 1], axis: 0, upper: false });
    let (mesh, cells) = made(&grid, true);
    check("throw", &mesh);
    assert_eq!((mesh.dim(), mesh.cell_count(), cells), (2, 4, vec![0, 1, 2, 3]));
    assert!((0..4).all(|cell| (mesh.geometry().cell_measure[cell] - 1.0).abs() < 1e-15));
    // Heights -.25, 0, .75, 1, 1.75, 2 on the pillar between; the lowest and the highest face have one cell each.
    assert_eq!(mesh.vertices().len(), 3 + 6 + 3);
    assert_eq!(mesh.face_count(), 2 + 3 + 5 + 3 + 2);
    let corners: Vec<usize> = (0..4).map(|cell| mesh.cell_vertices(cell).len()).collect();
    assert_eq!(corners, [5, 5, 5, 5]);
    assert_eq!(mesh.network().face_count(), 3);
    let lengths = |tag| mesh.tagged_faces(tag).map(|f| mesh.geometry().face_measure[f]).sum::<f64>();
    for (tag, length) in [("left", 2.0), ("right", 2.0), ("bottom", 2.0), ("top", 2.0)] {
        assert_eq!(lengths(tag), length, "{tag}");
    }
    let untagged = (0..mesh.face_count()).filter(|&f| mesh.is_boundary(f) && mesh.data().face_tag[f].is_none());
    assert_eq!(untagged.count(), 2);
    // Without a throw the columns meet.
    assert_eq!(made(&two_columns(0.0, 0.0), true).0.vertices().len(), 9);
}

#[test]
fn lines_cross_between_pillars() {
    let (mesh, _) = made(&two_columns(0.5, -0.25), false);
    check("crossing", &mesh);
    assert!((measure(&mesh) - 4.0).abs() < 1e-14);
    // In front, 0, 1, 2 meet -.5, .5, 1.5; behind, they meet .25, 1.25, 2.25: each line crosses its counterpart at 2/3 of
    // the way, and no other.
    assert_eq!(mesh.vertices().len(), 6 + 12 + 6 + 3);
    let x = mesh.vertices();
    let crossings: Vec<Vec3> = x.iter().copied().filter(|x| x.x == 1.0 && x.y > 0.0 && x.y < 1.0).collect();
    let expected = [0.0, 1.0, 2.0].map(|z| Vec3::new(1.0, 2.0 / 3.0, z));
    assert!(crossings.iter().zip(expected).all(|(a, b)| a.distance(b) < 1e-15), "{crossings:?}");
    let between = |f: usize| mesh.face_vertices(f).iter().all(|&v| x[v].x == 1.0);
    // The cells at the same height share a hexagon, the others a triangle; below and above, each column has one alone.
    let inner = sizes(&mesh, |f| between(f) && !mesh.is_boundary(f));
    assert_eq!(inner, [3, 3, 6, 6]);
    assert_eq!(sizes(&mesh, |f| between(f) && mesh.is_boundary(f)), [3, 3, 3, 3]);
    // Common to both sides is a height of 1.5 to 2 to 1.75.
    let common = (1.5 + 2.0) / 2.0 * 2.0 / 3.0 + (2.0 + 1.75) / 2.0 / 3.0;
    assert!((area(&mesh, |f| between(f) && !mesh.is_boundary(f)) - common).abs() < 1e-14);
    // Upper and lower faces have the crossings of their edges.
    let is_layer = |f: usize| mesh.geometry().face_normal(f).z.abs() > 0.5;
    assert_eq!(sizes(&mesh, is_layer), [5; 6]);
}

#[test]
fn cells_vanish_and_leave_gaps() {
    // The middle layer is pinched out on the left, and a wedge on the right.
    let mut grid = CornerPoint::new([2, 1, 3], upright, |[i, _, k], [di, _, dk]| {
        let thickness = (i + di).saturating_sub(1) as f64 / 2.0;
        [2.0, 1.0 + thickness, 1.0, 0.0][k + dk]
    });
    for (section, faces) in [(true, 3), (false, 5)] {
        let meet = |mesh: &Mesh, a, b| {
            (0..mesh.face_count()).filter(|&f| [(a, Some(b)), (b, Some(a))].contains(&mesh.face_cells(f))).count()
        };
        grid.active[3] = true;
        let (mesh, cells) = made(&grid, section);
        check("pinched", &mesh);
        assert_eq!(cells, [0, 1, 3, 4, 5]);
        assert!((measure(&mesh) - 4.0).abs() < 1e-14);
        assert_eq!(mesh.cell_faces(2).len(), faces);
        // Across the layer that is not there; the wedge above and below.
        assert_eq!((meet(&mesh, 0, 3), meet(&mesh, 1, 2), meet(&mesh, 2, 4), meet(&mesh, 1, 4)), (1, 1, 1, 0));

        // Without the wedge, there is a gap, whose faces have no tag.
        grid.active[3] = false;
        let (mesh, cells) = made(&grid, section);
        check("gap", &mesh);
        assert_eq!(cells, [0, 1, 4, 5]);
        assert!((measure(&mesh) - 3.75).abs() < 1e-14);
        assert_eq!((meet(&mesh, 0, 2), meet(&mesh, 1, 3)), (1, 0));
        let untagged = (0..mesh.face_count()).filter(|&f| mesh.is_boundary(f) && mesh.data().face_tag[f].is_none());
        assert_eq!(untagged.count(), 2);
    }
    // Beside a cell that is not active, too, and a cell above it is not connected to the one below.
    let mut grid = two_columns(0.25, 0.25);
    grid.active[1] = false;
    let (mesh, _) = made(&grid, false);
    check("inactive", &mesh);
    assert!((measure(&mesh) - 3.0).abs() < 1e-14);
    let x = mesh.vertices();
    let between = |f: usize| mesh.face_vertices(f).iter().all(|&v| x[v].x == 1.0);
    assert!((area(&mesh, |f| between(f) && mesh.is_boundary(f)) - (0.25 + 1.25)).abs() < 1e-14);
    assert!((area(&mesh, |f| between(f) && !mesh.is_boundary(f)) - 0.75).abs() < 1e-14);
}

#[test]
fn faults_are_on_either_side_of_a_block() {
    let block = |axis, upper, [first, last]: [[usize; 3]; 2]| Fault { name: "f".into(), first, last, axis, upper };
    let mut grid = CornerPoint::new([2, 2, 2], upright, |[.., k], [.., dk]| -((k + dk) as f64));
    for fault in [
        block(0, true, [[0, 0, 0], [0, 1, 0]]),
        block(0, false, [[1, 0, 0], [1, 1, 0]]),
        block(1, true, [[0, 0, 0], [1, 0, 0]]),
        block(2, true, [[0, 0, 0], [1, 0, 0]]),
        block(2, false, [[0, 0, 1], [1, 0, 1]]),
    ] {
        let axis = [Vec3::X, Vec3::Y, Vec3::Z][fault.axis];
        grid.faults = vec![fault];
        let (mesh, _) = made(&grid, false);
        let network = mesh.network();
        assert_eq!(network.face_count(), 2, "{:?}", grid.faults);
        assert!(network.faces.iter().all(|&f| mesh.geometry().face_normal(f).dot(axis).abs() > 0.99));
        assert!(network.faces.iter().all(|&f| mesh.geometry().face_center[f].dot(axis).abs() == 1.0));
    }
    // None where there is no cell on the other side.
    grid.faults = vec![block(0, true, [[0, 0, 0], [1, 1, 1]]), block(0, true, [[1, 0, 0], [1, 1, 1]])];
    assert_eq!(made(&grid, false).0.network().face_count(), 4);
}

#[test]
fn what_is_wrong_is_said_of_every_cell() {
    let problems = |grid: &CornerPoint, section| grid.build(section).unwrap_err().problems;
    let sound = two_columns(0.25, 0.0);
    let mut grid = sound.clone();
    grid.heights.pop();
    grid.active.push(true);
    let text = grid.build(false).unwrap_err().to_string();
    assert!(text.contains("31 heights; it needs 32") && text.contains("5 flags of active cells; it needs 4"), "{text}");

    let mut grid = sound.clone();
    grid.pillars[4][0] = Vec3::new(0.0, 0.0, 1.0);
    grid.heights[0] = f64::NAN;
    grid.faults.push(Fault { name: "f".into(), first: [0, 0, 0], last: [2, 0, 0], axis: 0, upper: true });
    let found = problems(&grid, true);
    assert!(matches!(found[0], InputProblem::Pillar { pillar: [1, 1], .. }), "{found:?}");
    assert!(matches!(found[1], InputProblem::GridCell { cell: [0, 0, 0], .. }), "{found:?}");
    assert!(matches!(found[2], InputProblem::GridCell { cell: [1, 0, 0], .. }), "not a section: {found:?}");
    assert!(matches!(found[4], InputProblem::Fault { .. }) && found.len() == 5, "{found:?}");

    // Upside down, and deeper than the one below.
    let mut grid = sound;
    grid.heights[2] = 0.5;
    grid.heights[16] = 1.5;
    let text = grid.build(false).unwrap_err().to_string();
    assert!(text.contains("cell (1, 1, 2) reaches into a cell above"), "{text}");
    assert!(text.contains("cell (2, 1, 1) is inverted"), "{text}");
    // What is not active does not matter.
    grid.active[..2].fill(false);
    grid.build(false).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Layers of which some are pinched out, dipping differently in each column, with holes.
    #[test]
    fn any_throw_gives_a_sound_mesh(
        cells in [1..4_usize, 1..4_usize, 1..5_usize],
        dips in prop::collection::vec([-3..=3_i8, -3..=3_i8, -3..=3_i8], 9),
        layers in prop::collection::vec(0..3_u8, 4),
        holes in prop::collection::vec(0..36_usize, 0..4),
        lean in -2..=2_i8,
    ) {
        let lean = f64::from(lean) / 8.0;
        let pillar = |i: usize, j: usize| {
            let (x, y, lean) = (i as f64, j as f64, lean * ((i + j) % 2) as f64);
            [Vec3::new(x, y, 0.0), Vec3::new(x + lean, y + 0.5 * lean, 4.0)]
        };
        let mut grid = CornerPoint::new(cells, pillar, |[i, j, k], [di, dj, dk]| {
            let [dip, strike, throw] = dips[3 * (i % 3) + j % 3].map(|d| f64::from(d) / 4.0);
            let depth: u8 = layers[..k + dk].iter().sum();
            dip * di as f64 + strike * dj as f64 + throw - f64::from(depth) / 2.0
        });
        holes.iter().filter(|&&hole| hole < grid.active.len()).copied().collect::<Vec<_>>()
            .into_iter().for_each(|hole| grid.active[hole] = false);
        let kept = |cell: usize| grid.active[cell] && layers[cell / (cells[0] * cells[1])] > 0;
        let (data, numbers) = grid.build(false).unwrap();
        prop_assert_eq!(&numbers, &(0..grid.active.len()).filter(|&cell| kept(cell)).collect::<Vec<_>>());
        if !numbers.is_empty() {
            let mesh = Mesh::new(data).map_err(|error| TestCaseError::fail(error.to_string()))?;
            check("random", &mesh);
            // With upright pillars, the volume of a cell is its thickness.
            for (cell, number) in numbers.iter().enumerate().filter(|_| lean == 0.0) {
                let thickness = f64::from(layers[number / (cells[0] * cells[1])]) / 2.0;
                prop_assert!((mesh.geometry().cell_measure[cell] - thickness).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn no_heights_make_it_panic(heights in prop::collection::vec(prop::num::f64::ANY, 32), section: bool) {
        let grid = CornerPoint { heights, ..two_columns(0.0, 0.0) };
        let made: Result<(MeshData, _), _> = grid.build(section);
        if let Ok((data, _)) = made {
            // Sound or not, it says so.
            let _ = Mesh::new(data);
        }
    }
}
