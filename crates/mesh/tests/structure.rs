//! Orientation, fracture network and nodes of small meshes, checked by hand.

use mesh::{EdgeKind, Mesh, Vec3, generate::cartesian};

#[test]
fn a_t_in_three_dimensions() {
    let mut data = cartesian(Vec3::splat(-1.0), Vec3::splat(1.0), [2, 2, 2]);
    data.mark_fracture("horizontal", |x| x.z == 0.0);
    data.mark_fracture("vertical", |x| x.x == 0.0 && x.z <= 0.0);
    let mesh = Mesh::new(data).unwrap();
    let network = mesh.network();
    assert_eq!(network.face_count(), 6);
    let crossing: Vec<_> =
        (0..network.edge_count()).filter(|&e| network.edge_kind(e) == EdgeKind::Intersection).collect();
    // The T's line is x = 0, z = 0: two edges, each of three faces.
    assert_eq!(crossing.len(), 2);
    assert!(crossing.iter().all(|&e| network.edge_faces.get(e).len() == 3));
    // 27 vertices; z = 0: 9 of two classes, of which the 3 on x = 0 have 3; x = 0, z < 0: 3 of two classes.
    assert_eq!(mesh.nodes().count(), 27 + 9 + 3 + 3);
    let volume: f64 = mesh.geometry().cell_measure.iter().sum();
    assert!((volume - 8.0).abs() < 1e-14);
}
