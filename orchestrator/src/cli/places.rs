//! Where on the mesh a failed coupling had not converged.

use std::fmt::Write;

use mesh::Mesh;
use orchestrator::Failure;
use orchestrator::results::Shape;

/// A line for each entry that the report of a failure names.
pub(crate) fn places(failure: &Failure, mesh: &Mesh) -> String {
    let mut text = String::new();
    let (geometry, network) = (mesh.geometry(), mesh.network());
    for field in &failure.fields {
        for &(entry, _) in &field.entries {
            let on = |shape: Shape| entry < shape.length(mesh);
            let (what, x) = if field.name.starts_with("matrix.") && on(Shape::Cells) {
                (format!("cell {entry}"), geometry.cell_center[entry])
            } else if field.name.starts_with("fracture.") && on(Shape::FractureFaces) {
                let fracture = &mesh.data().fractures[network.fracture[entry]];
                (format!("face {entry} of fracture {fracture}"), geometry.face_center[network.faces[entry]])
            } else {
                continue;
            };
            // Writing to text cannot fail.
            let x = x.to_array()[..mesh.dim()].iter().map(|x| format!("{x:.6}")).collect::<Vec<_>>().join(", ");
            let _ = write!(text, "\n  {}: {what} is at ({x}) m", field.name);
        }
    }
    text
}
