//! Identities that hold on every sound mesh.

use mesh::{Mesh, Vec3};

/// Weights, closedness, divergence theorem and orientation, to round-off scaled by the cell.
pub(crate) fn check(name: &str, mesh: &Mesh) {
    let g = mesh.geometry();
    let x = mesh.vertices();
    for face in 0..mesh.face_count() {
        let range = mesh.data().faces.range(face);
        let list = mesh.face_vertices(face);
        let weights = &g.face_weight[range.clone()];
        let size = list.iter().map(|&v| x[v].distance(x[list[0]])).fold(0.0, f64::max);
        let offset = x[list[0]].length();
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{name}: weights of face {face}");
        let center: Vec3 = list.iter().zip(weights).map(|(&v, w)| *w * x[v]).sum();
        assert!(center.distance(g.face_center[face]) < 1e-12 * (size + offset), "{name}: center of face {face}");
        let vector: Vec3 = g.face_vertex_vector[range].iter().sum();
        assert!(vector.distance(g.face_vector[face]) < 1e-12 * g.face_measure[face], "{name}: vector of face {face}");
        let normal = g.face_normal(face);
        let planar = list.iter().all(|&v| (x[v] - x[list[0]]).dot(normal).abs() < 1e-12 * (size + offset));
        if planar {
            let length = g.face_vector[face].length();
            assert!((g.face_measure[face] - length).abs() < 1e-11 * length, "{name}: measure of face {face}");
        }
        if planar {
            // From triangles that all have the first vertex.
            let (mut sum, mut total) = (Vec3::ZERO, 0.0);
            for i in 1..list.len() - 1 {
                let [a, b, c] = [list[0], list[i], list[i + 1]].map(|v| x[v]);
                let area = (b - a).cross(c - a).dot(normal);
                (sum, total) = (sum + area * (a + b + c) / 3.0, total + area);
            }
            let wanted = if list.len() == 2 { (x[list[0]] + x[list[1]]) / 2.0 } else { sum / total };
            assert!(g.face_center[face].distance(wanted) < 1e-11 * (size + offset), "{name}: {wanted} of face {face}");
        }
        let (first, second) = mesh.face_cells(face);
        if let Some(second) = second {
            assert_ne!(first, second, "{name}: cells of face {face}");
        }
    }
    for cell in 0..mesh.cell_count() {
        let (measure, diameter) = (g.cell_measure[cell], g.cell_diameter[cell]);
        let list = mesh.cell_vertices(cell);
        let offset = x[list[0]].length();
        let weights = &g.cell_weight[mesh.cell_vertex_lists().range(cell)];
        assert!(measure > 0.0, "{name}: measure of cell {cell}");
        // A cell thinner than it is wide loses digits.
        let thin = diameter.powi(mesh.dim() as i32) / measure;
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12 * thin, "{name}: weights of cell {cell}");
        let center: Vec3 = list.iter().zip(weights).map(|(&v, w)| *w * x[v]).sum();
        assert!(center.distance(g.cell_center[cell]) < 1e-12 * (diameter + offset) * thin, "{name}: center of {cell}");
        let mass: Vec3 = mesh.quadrature(cell).into_iter().map(|(point, weight)| weight * point).sum();
        let off = (mass / measure).distance(g.cell_center[cell]);
        assert!(off < 1e-12 * (diameter + offset) * thin, "{name}: center of {cell} off by {off}");
        let area: f64 = mesh.cell_faces(cell).iter().map(|&f| g.face_measure[f]).sum();
        let mut closed = Vec3::ZERO;
        let mut moment = [Vec3::ZERO; 3];
        for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
            let own = if mesh.face_cells(face).0 == cell { 1.0 } else { -1.0 };
            assert_eq!(own, sign, "{name}: sign of face {face} in cell {cell}");
            closed += sign * g.face_vector[face];
            let vectors = &g.face_vertex_vector[mesh.data().faces.range(face)];
            for (&v, &vector) in mesh.face_vertices(face).iter().zip(vectors) {
                for i in 0..3 {
                    moment[i] += sign * (x[v] - x[list[0]])[i] * vector;
                }
            }
        }
        assert!(closed.length() < 1e-12 * area, "{name}: cell {cell} is not closed: {closed}");
        for i in 0..mesh.dim() {
            let mut expected = Vec3::ZERO;
            expected[i] = measure;
            let error = moment[i].distance(expected);
            assert!(error < 1e-12 * area * (diameter + offset), "{name}: divergence theorem on {cell}: {error:e}");
        }
    }
    // Boundary normals point outward: their volume is that of the cells.
    let total: f64 = g.cell_measure.iter().sum();
    let outer: f64 = (0..mesh.face_count())
        .filter(|&f| mesh.is_boundary(f))
        .flat_map(|f| {
            let vectors = &g.face_vertex_vector[mesh.data().faces.range(f)];
            mesh.face_vertices(f).iter().zip(vectors).map(|(&v, vector)| (x[v] - x[0]).dot(*vector))
        })
        .sum();
    assert!((outer / mesh.dim() as f64 - total).abs() < 1e-11 * total, "{name}: {outer} {total}");
}

/// The measure of all cells.
pub(crate) fn measure(mesh: &Mesh) -> f64 {
    mesh.geometry().cell_measure.iter().sum()
}
