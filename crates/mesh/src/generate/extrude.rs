//! Prisms over a 2D mesh.

use super::{InputError, InputProblem};
use crate::{Lists, Mesh, MeshData};

/// Prisms between the heights `levels` (m, ascending) over the cells of a 2D mesh. Fracture edges become
/// vertical fracture faces, in the layers for which `exists(fracture, layer)` holds; layer i lies between
/// levels i and i + 1. Regions and boundary tags are kept, but for `bottom` and `top` of the 2D mesh, its
/// sides in y, which become `front` and `back`: `bottom` and `top` are those of z.
///
/// Cells and vertices are numbered layer by layer, and within a layer as in the 2D mesh.
///
/// # Errors
/// A mesh that is not 2D; levels that do not ascend.
pub fn extrude(
    mesh: &Mesh,
    levels: &[f64],
    mut exists: impl FnMut(&str, usize) -> bool,
) -> Result<MeshData, InputError> {
    let mut problems = Vec::new();
    if mesh.dim() != 2 {
        problems.push(InputProblem::Dimension { needed: 2, found: mesh.dim() });
    }
    if levels.len() < 2 {
        problems.push(InputProblem::Levels { index: levels.len(), value: f64::NAN });
    }
    for (index, &value) in levels.iter().enumerate() {
        if !value.is_finite() || (index > 0 && value <= levels[index - 1]) {
            problems.push(InputProblem::Levels { index, value });
        }
    }
    InputError::check(problems)?;

    let old = mesh.data();
    let layers = levels.len() - 1;
    let [vertices, edges, polygons] = [old.vertices.len(), mesh.face_count(), mesh.cell_count()];
    let renamed = |name: &String| match name.as_str() {
        "bottom" => "front".to_owned(),
        "top" => "back".to_owned(),
        _ => name.clone(),
    };
    let mut data = MeshData {
        dim: 3,
        vertices: levels.iter().flat_map(|&z| old.vertices.iter().map(move |x| x.with_z(z))).collect(),
        cell_region: (0..layers).flat_map(|_| old.cell_region.iter().copied()).collect(),
        regions: old.regions.clone(),
        tags: old.tags.iter().map(renamed).collect(),
        fractures: old.fractures.clone(),
        ..MeshData::default()
    };
    // Horizontal faces level by level, then vertical ones layer by layer.
    let (bottom, top) = (data.tag("bottom"), data.tag("top"));
    let outlines: Lists = (0..polygons).map(|cell| mesh.cell_polygon(cell)).collect();
    for level in 0..=layers {
        for outline in outlines.iter() {
            data.faces.push(outline.iter().map(|v| v + level * vertices));
            data.face_tag.push(if level == 0 {
                Some(bottom)
            } else if level == layers {
                Some(top)
            } else {
                None
            });
            data.face_fracture.push(None);
        }
    }
    for layer in 0..layers {
        let open: Vec<bool> = old.fractures.iter().map(|name| exists(name, layer)).collect();
        let low = layer * vertices;
        for edge in 0..edges {
            let ends = mesh.face_vertices(edge);
            let (a, b) = (ends[0] + low, ends[1] + low);
            data.faces.push([a, b, b + vertices, a + vertices]);
            data.face_tag.push(old.face_tag[edge]);
            data.face_fracture.push(old.face_fracture[edge].filter(|&fracture| open[fracture]));
        }
    }
    for layer in 0..layers {
        for cell in 0..polygons {
            let sides = (layers + 1) * polygons + layer * edges;
            let ends = [layer * polygons + cell, (layer + 1) * polygons + cell];
            data.cells.push(ends.into_iter().chain(mesh.cell_faces(cell).iter().map(|edge| sides + edge)));
        }
    }
    Ok(data)
}
