//! Simplices from convex cells.

use super::{InputError, InputProblem};
use crate::data::FaceTable;
use crate::{Mesh, MeshData};

/// A simplex below this part of its cell's measure has no volume but round-off.
const FLAT: f64 = 1e-10;

/// Splits every cell into simplices without a new vertex, such that they match across cells: a face is cut
/// from its vertex of lowest number, and a cell from its own (a hexahedron into 6 tetrahedra or 5, a prism
/// into 3). On Cartesian boxes this is Kuhn's subdivision. Regions, tags and fractures are kept; vertices
/// keep their numbers.
///
/// # Errors
/// Cells that are not strictly convex (hanging vertices, or faces bent too far).
pub fn simplices(mesh: &Mesh) -> Result<MeshData, InputError> {
    let old = mesh.data();
    let mut table = FaceTable::default();
    let (mut face_tag, mut face_fracture) = (Vec::new(), Vec::new());
    for face in 0..mesh.face_count() {
        for part in face_parts(old.faces.get(face)) {
            table.number(&part);
            face_tag.push(old.face_tag[face]);
            face_fracture.push(old.face_fracture[face]);
        }
    }
    let mut cells = Vec::new();
    let mut cell_region = Vec::new();
    let mut problems = Vec::new();
    for cell in 0..mesh.cell_count() {
        let apex = mesh.cell_vertices(cell)[0];
        let x = |v: usize| old.vertices[v] - old.vertices[apex];
        let mut convex = true;
        for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
            if old.faces.get(face).contains(&apex) {
                continue;
            }
            for part in face_parts(old.faces.get(face)) {
                let measure = sign
                    * match part[..] {
                        [a, b] => x(a).cross(x(b)).z / 2.0,
                        _ => x(part[0]).dot(x(part[1]).cross(x(part[2]))) / 6.0,
                    };
                convex &= measure > FLAT * mesh.geometry().cell_measure[cell];
                let mut faces = vec![table.number(&part)];
                for without in 0..part.len() {
                    let mut other = part.clone();
                    other[without] = apex;
                    faces.push(table.number(&other));
                }
                cells.push(faces);
                cell_region.push(old.cell_region[cell]);
            }
        }
        if !convex {
            problems.push(InputProblem::NotConvex { cell });
        }
    }
    InputError::check(problems)?;
    face_tag.resize(table.lists.len(), None);
    face_fracture.resize(table.lists.len(), None);
    Ok(MeshData {
        dim: old.dim,
        vertices: old.vertices.clone(),
        faces: table.lists,
        cells: cells.into_iter().collect(),
        cell_region,
        regions: old.regions.clone(),
        face_tag,
        tags: old.tags.clone(),
        face_fracture,
        fractures: old.fractures.clone(),
    })
}

/// The simplices of a face, cut from its vertex of lowest number, with the sense of the face.
fn face_parts(list: &[usize]) -> Vec<Vec<usize>> {
    let n = list.len();
    if n == 2 {
        return vec![list.to_vec()];
    }
    let lowest = (0..n).min_by_key(|&i| list[i]).unwrap_or(0);
    (1..n - 1).map(|i| vec![list[lowest], list[(lowest + i) % n], list[(lowest + i + 1) % n]]).collect()
}
