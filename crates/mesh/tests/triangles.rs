//! Triangles that conform to fractures.

use mesh::generate::{InputProblem, Triangles};
use mesh::{EdgeKind, Mesh, Vec3};
use proptest::prelude::*;

/// Smallest angle of each triangle (degrees), ascending.
fn angles(mesh: &Mesh) -> Vec<f64> {
    let mut angles: Vec<f64> = (0..mesh.cell_count())
        .map(|cell| {
            let p: Vec<Vec3> = mesh.cell_vertices(cell).iter().map(|&v| mesh.vertices()[v]).collect();
            (0..3).map(|i| (p[(i + 1) % 3] - p[i]).angle_between(p[(i + 2) % 3] - p[i])).fold(4.0, f64::min)
        })
        .map(f64::to_degrees)
        .collect();
    angles.sort_by(f64::total_cmp);
    angles
}

fn edges(mesh: &Mesh, kind: EdgeKind) -> usize {
    (0..mesh.network().edge_count()).filter(|&e| mesh.network().edge_kind(e) == kind).count()
}

fn area(mesh: &Mesh) -> f64 {
    mesh.geometry().cell_measure.iter().sum()
}

fn lengths(mesh: &Mesh) -> Vec<f64> {
    mesh.network().faces.iter().map(|&f| mesh.geometry().face_measure[f]).collect()
}

#[test]
fn a_crack_in_a_wide_domain_has_the_prescribed_faces() {
    let (s, c) = 20.0_f64.to_radians().sin_cos();
    let data = Triangles::rectangle([-160.0; 2], [160.0; 2], 20.0)
        .fracture("crack", &[[-c, -s], [c, s]], 0.02)
        .growth(0.1)
        .build()
        .unwrap();
    let mesh = Mesh::new(data).unwrap();
    assert_eq!(mesh.network().face_count(), 100);
    assert!(lengths(&mesh).iter().all(|l| (l - 0.02).abs() < 1e-12));
    assert_eq!(edges(&mesh, EdgeKind::Tip), 2);
    assert!((area(&mesh) - 320.0 * 320.0).abs() < 1e-6);
    let angles = angles(&mesh);
    assert!(angles[0] > 30.0 && angles[angles.len() / 2] > 50.0, "{} {}", angles[0], angles[angles.len() / 2]);
    // Sizes reach that far away, neither coarser nor finer.
    let largest = mesh.geometry().face_measure.iter().fold(0.0, |m: f64, &l| m.max(l));
    assert!(largest > 15.0 && largest < 35.0, "{largest}");
    assert!((9_000..16_000).contains(&mesh.cell_count()), "{}", mesh.cell_count());
}

fn six_fractures(h: f64) -> Triangles<'static> {
    Triangles::rectangle([0.0, 0.0], [2.0, 1.0], 2.5 * h)
        .fracture("1", &[[0.2, 0.7], [0.5, 0.7], [0.8, 0.65]], h)
        .fracture("2", &[[1.0, 0.3], [1.8, 0.4]], h)
        .fracture("3", &[[0.2, 0.3], [0.6, 0.25]], h)
        .fracture("4", &[[1.0, 0.4], [1.7, 0.85]], h)
        .fracture("5", &[[1.5, 0.65], [2.0, 0.55]], h)
        .fracture("6", &[[1.5, 0.05], [1.4, 0.25]], h)
}

#[test]
fn six_fractures_at_three_sizes() {
    for h in [0.04, 0.02, 0.01] {
        let mesh = Mesh::new(six_fractures(h).build().unwrap()).unwrap();
        assert!(angles(&mesh)[0] > 22.0, "{h}: {}", angles(&mesh)[0]);
        assert!(lengths(&mesh).iter().all(|l| (l / h - 1.0).abs() < 0.1));
        assert_eq!(edges(&mesh, EdgeKind::Tip), 11);
        assert_eq!(edges(&mesh, EdgeKind::Boundary), 1);
        assert_eq!(edges(&mesh, EdgeKind::Intersection), 0);
        assert!((area(&mesh) - 2.0).abs() < 1e-12);
        for tag in ["left", "right", "bottom", "top"] {
            let length: f64 = mesh.tagged_faces(tag).map(|f| mesh.geometry().face_measure[f]).sum();
            let expected = if matches!(tag, "left" | "right") { 1.0 } else { 2.0 };
            assert!((length - expected).abs() < 1e-12);
        }
    }
}

#[test]
fn fractures_meet_in_x_t_and_l() {
    let data = Triangles::rectangle([0.0, 0.0], [3.0, 1.0], 0.2)
        .fracture("x1", &[[0.2, 0.2], [0.8, 0.8]], 0.05)
        .fracture("x2", &[[0.2, 0.8], [0.8, 0.2]], 0.05)
        .fracture("t1", &[[1.2, 0.5], [1.8, 0.5]], 0.05)
        // An end a little off the other fracture is taken as on it.
        .fracture("t2", &[[1.5, 0.1], [1.5, 0.5 - 1e-10]], 0.05)
        .fracture("l1", &[[2.2, 0.2], [2.8, 0.2]], 0.05)
        .fracture("l2", &[[2.8, 0.2], [2.8, 0.8]], 0.05)
        .fracture("through", &[[2.0, 0.0], [2.1, 1.0]], 0.05)
        .build()
        .unwrap();
    let mesh = Mesh::new(data).unwrap();
    assert_eq!(edges(&mesh, EdgeKind::Intersection), 3);
    assert_eq!(edges(&mesh, EdgeKind::Tip), 4 + 3 + 2);
    assert_eq!(edges(&mesh, EdgeKind::Boundary), 2);
    let classes = |p: Vec3| mesh.nodes().vertices().iter().filter(|&&v| mesh.vertices()[v].distance(p) < 1e-9).count();
    assert_eq!(classes(Vec3::new(0.5, 0.5, 0.0)), 4);
    assert_eq!(classes(Vec3::new(1.5, 0.5, 0.0)), 3);
    assert_eq!(classes(Vec3::new(2.8, 0.2, 0.0)), 2);
    assert_eq!(classes(Vec3::new(0.2, 0.2, 0.0)), 1);
    assert_eq!(classes(Vec3::new(2.0, 0.0, 0.0)), 2);
}

#[test]
fn the_domain_may_be_a_polygon_that_is_not_convex() {
    let corners = [[0.0, 0.0], [3.0, 0.2], [1.2, 1.0], [2.5, 2.9], [0.1, 2.0]];
    let data = Triangles::polygon(&corners, &["a", "b"], 0.3)
        .fracture("long", &[[0.2, 0.2], [1.0, 1.0], [2.0, 2.3]], 0.05)
        .interface("layer", &[[0.05, 1.0], [1.2, 1.0]], None)
        .build()
        .unwrap();
    let mesh = Mesh::new(data).unwrap();
    let shoelace: f64 =
        (0..5).map(|i| (corners[i], corners[(i + 1) % 5])).map(|(p, q)| 0.5 * (p[0] * q[1] - p[1] * q[0])).sum();
    assert!((area(&mesh) - shoelace).abs() < 1e-12);
    // The interface is followed by faces, but is no fracture.
    let on_layer = |f: usize| mesh.face_vertices(f).iter().all(|&v| mesh.vertices()[v].y == 1.0);
    let length: f64 = (0..mesh.face_count()).filter(|&f| on_layer(f)).map(|f| mesh.geometry().face_measure[f]).sum();
    assert!((length - 1.15).abs() < 1e-12);
    assert!(mesh.network().faces.iter().all(|&f| !on_layer(f)));
}

#[test]
fn the_size_function_rules_on_lines_too() {
    let data = Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 0.2)
        .fracture("a", &[[0.2, 0.5], [0.8, 0.5]], 0.1)
        .size(|x| 0.02 + 0.2 * x.x)
        .build()
        .unwrap();
    let mesh = Mesh::new(data).unwrap();
    let near = |x: f64| {
        let by_distance = |f: &usize| (mesh.geometry().face_center[*f].x - x).abs();
        let face = mesh.network().faces.iter().min_by(|a, b| by_distance(a).total_cmp(&by_distance(b))).unwrap();
        mesh.geometry().face_measure[*face]
    };
    assert!((near(0.2) / 0.06 - 1.0).abs() < 0.2 && (near(0.7) / 0.1 - 1.0).abs() < 0.1, "{} {}", near(0.2), near(0.7));
}

#[test]
fn all_that_is_wrong_is_reported_at_once() {
    let error = Triangles::rectangle([0.0, 0.0], [1.0, 1.0], -1.0)
        .fracture("a", &[[0.2, 0.5], [f64::NAN, 0.5]], 0.1)
        .fracture("a", &[[0.2, 0.5]], 0.0)
        .growth(f64::INFINITY)
        .build()
        .unwrap_err();
    let count = |found: fn(&InputProblem) -> bool| error.problems.iter().filter(|&p| found(p)).count();
    assert_eq!(count(|p| matches!(p, InputProblem::NotPositive { .. })), 3);
    assert_eq!(count(|p| matches!(p, InputProblem::Coordinate { index: 1, .. })), 1);
    assert_eq!(count(|p| matches!(p, InputProblem::TooFewPoints { count: 1, .. })), 1);
    assert_eq!(count(|p| matches!(p, InputProblem::Name { .. })), 1);
    assert_eq!(error.problems.len(), 6);

    let error = Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 0.1)
        .fracture("out", &[[0.5, 0.5], [1.5, 0.5]], 0.1)
        .fracture("one", &[[0.2, 0.2], [0.6, 0.2]], 0.1)
        .fracture("two", &[[0.4, 0.2], [0.8, 0.2]], 0.1)
        .fracture("edge", &[[0.0, 0.2], [0.0, 0.4]], 0.1)
        .build()
        .unwrap_err();
    let problems = &error.problems;
    assert!(matches!(&problems[0], InputProblem::Outside { what, x: 1.5, .. } if what == "fracture \"out\""));
    assert!(
        problems.iter().any(|p| matches!(p, InputProblem::Overlap { first, second, from: [0.4, 0.2], to: [0.6, 0.2] }
            if first == "fracture \"one\"" && second == "fracture \"two\""))
    );
    assert!(problems.iter().any(|p| matches!(p, InputProblem::Overlap { first, second, .. }
            if first == "the boundary of the domain" && second == "fracture \"edge\"")));
    assert_eq!(problems.len(), 3, "{error}");

    let error = Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 0.1)
        .fracture("b", &[[0.5, 0.5], [0.6, 0.5], [0.6, 0.5]], 0.1)
        .build()
        .unwrap_err();
    assert!(matches!(error.problems[..], [InputProblem::ZeroLength { index: 1, .. }]), "{error}");

    let bow = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
    let error = Triangles::polygon(&bow, &[], 0.1).build().unwrap_err();
    assert!(matches!(error.problems[..], [InputProblem::DomainCrosses { x: 0.5, y: 0.5 }]), "{error}");

    let notch = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 0.4], [0.0, 1.0]];
    let error =
        Triangles::polygon(&notch, &[], 0.1).fracture("over", &[[0.1, 0.6], [0.9, 0.6]], 0.1).build().unwrap_err();
    assert!(matches!(error.problems[..], [InputProblem::Outside { x: 0.5, y: 0.6, .. }]), "{error}");

    let error = Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 0.1).size(|x| x.x - 0.5).build().unwrap_err();
    assert!(matches!(error.problems[..], [InputProblem::NotPositive { .. }]), "{error}");
    let error = Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 0.1).size(|_| 1e-12).build().unwrap_err();
    assert!(matches!(error.problems[..], [InputProblem::TooFine { .. }]), "{error}");
}

/// Points on a coarse lattice, so that fractures meet in all ways, or anywhere.
fn point() -> impl Strategy<Value = [f64; 2]> {
    let lattice = (0..=6_i32, 0..=4_i32).prop_map(|(i, j)| [f64::from(i) / 3.0, f64::from(j) / 4.0]);
    prop_oneof![3 => lattice, 1 => [0.0..2.0, 0.0..1.0]]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Any network is refused with a reason or meshed: conforming, covering the domain, with all its fractures.
    #[test]
    fn any_network_is_meshed_or_refused(
        lines in prop::collection::vec((prop::collection::vec(point(), 2..4), 0.03..0.4), 0..7),
        growth in 0.05..1.5,
    ) {
        let mut triangles = Triangles::rectangle([0.0, 0.0], [2.0, 1.0], 0.3).growth(growth);
        for (i, (points, size)) in lines.iter().enumerate() {
            triangles = triangles.fracture(&i.to_string(), points, *size);
        }
        match triangles.build() {
            Ok(data) => {
                let mesh = Mesh::new(data).map_err(|error| TestCaseError::fail(error.to_string()))?;
                prop_assert!((area(&mesh) - 2.0).abs() < 1e-9);
                let wanted: f64 = (lines.iter())
                    .flat_map(|(points, _)| points.windows(2))
                    .map(|w| (w[0][0] - w[1][0]).hypot(w[0][1] - w[1][1]))
                    .sum();
                prop_assert!((lengths(&mesh).iter().sum::<f64>() - wanted).abs() < 1e-7);
                let boundary: f64 = ["left", "right", "bottom", "top"]
                    .iter()
                    .flat_map(|tag| mesh.tagged_faces(tag))
                    .map(|face| mesh.geometry().face_measure[face])
                    .sum();
                prop_assert!((boundary - 6.0).abs() < 1e-9);
            }
            Err(error) => prop_assert!(
                error.problems.iter().all(|p| matches!(p, InputProblem::Overlap { .. } | InputProblem::ZeroLength { .. })),
                "{error}"
            ),
        }
    }
}
