//! Unites cells, and the faces between two cells.
//!
//! Surfaces, which are the outer boundary, the fractures and the interfaces between regions, keep their shape;
//! cells are never united across them.

use rustc_hash::{FxHashMap, FxHashSet};

use crate::geometry::Geometry;
use crate::topology::ridges;
use crate::{Lists, MeshData, Vec3};

/// Directions that differ by less are one: far above round-off, far below any angle of a mesh.
const PARALLEL: f64 = 1e-9;

/// Which faces between the same two cells become one face.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unite {
    /// Those in one plane.
    Flat,
    /// All, unless on a surface, where they must lie in one plane. Such faces need not be planar.
    All,
}

/// What cells are not united across: tag, fracture and the regions on both sides.
type Surface = (Option<usize>, Option<usize>, usize, Option<usize>);

/// Unites the cells of each group (a number for each cell; every group must be in one piece, and lie on one side
/// of each face that is a surface).
pub(crate) fn unite(data: &MeshData, group: &[usize], mode: Unite) -> MeshData {
    // Groups numbered as they come.
    let mut number = FxHashMap::default();
    let mut cell_region = Vec::new();
    let new_cell: Vec<usize> = (group.iter().zip(&data.cell_region))
        .map(|(g, &region)| {
            *number.entry(*g).or_insert_with(|| {
                cell_region.push(region);
                cell_region.len() - 1
            })
        })
        .collect();

    // Faces that stay, with their new cells (ascending).
    let uses = data.cells.transpose(data.faces.len());
    let mut kept: Vec<(usize, [Option<usize>; 2])> = Vec::new();
    for (face, cells) in uses.iter().enumerate() {
        let first = new_cell[cells[0]];
        let second = cells.get(1).map(|&c| new_cell[c]);
        match second {
            Some(second) if second == first => {}
            Some(second) => kept.push((face, [Some(first.min(second)), Some(first.max(second))])),
            None => kept.push((face, [Some(first), None])),
        }
    }
    let surface = |face: usize, cells: [Option<usize>; 2]| -> Surface {
        let region = |cell: Option<usize>| cell.map(|c| cell_region[c]);
        (data.face_tag[face], data.face_fracture[face], region(cells[0]).unwrap_or(0), region(cells[1]))
    };
    let is_surface = |face: usize, cells: [Option<usize>; 2]| {
        let (_, fracture, first, second) = surface(face, cells);
        fracture.is_some() || second != Some(first)
    };
    let normals = Geometry::of_faces(&data.vertices, &data.faces).face_vector;
    let normal = |face: usize| normals[face].normalize_or_zero();

    let mut faces: Vec<Face> = Vec::new();
    let mut parts: FxHashMap<([Option<usize>; 2], Surface), Vec<usize>> = FxHashMap::default();
    let mut order = Vec::new();
    for &(face, cells) in &kept {
        let key = (cells, surface(face, cells));
        parts.entry(key).or_insert_with(|| {
            order.push(key);
            Vec::new()
        });
        parts.entry(key).and_modify(|list| list.push(face));
    }
    for key in order {
        let list = &parts[&key];
        let (cells, surface) = key;
        let keeps_shape = is_surface(list[0], cells);
        let flat = keeps_shape || mode == Unite::Flat;
        let mut add = |members: &[usize], outline: Vec<usize>| {
            let (tag, fracture, ..) = surface;
            let normal = keeps_shape.then(|| normal(members[0]));
            faces.push(Face { outline, cells, tag, fracture, normal });
        };
        if data.dim == 2 {
            list.iter().for_each(|&face| add(&[face], data.faces.get(face).to_vec()));
            continue;
        }
        for members in pieces(data, list, |a, b| !flat || normal(a).cross(normal(b)).length() < PARALLEL) {
            if let Some(outline) = outline(data, &members) {
                add(&members, outline);
            } else {
                members.iter().for_each(|&face| add(&[face], data.faces.get(face).to_vec()));
            }
        }
    }
    drop_vertices(data, &mut faces, mode);
    assemble(data, faces, cell_region)
}

/// A face of the united mesh.
struct Face {
    outline: Vec<usize>,
    cells: [Option<usize>; 2],
    tag: Option<usize>,
    fracture: Option<usize>,
    /// Its normal where it lies on a surface.
    normal: Option<Vec3>,
}

/// Parts of `list` that hang together across edges of exactly two of them, where `join` allows it.
fn pieces(data: &MeshData, list: &[usize], join: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut at_edge: Vec<((usize, usize), usize)> = (list.iter().enumerate())
        .flat_map(|(i, &face)| ridges(data.faces.get(face)).map(move |(key, _)| (key, i)))
        .collect();
    at_edge.sort_unstable();
    let mut links = vec![Vec::new(); list.len()];
    for group in at_edge.chunk_by(|a, b| a.0 == b.0) {
        if let &[(_, i), (_, j)] = group
            && join(list[i], list[j])
        {
            links[i].push(j);
            links[j].push(i);
        }
    }
    let mut seen = vec![false; list.len()];
    let mut result = Vec::new();
    for start in 0..list.len() {
        let mut queue = vec![start];
        let mut piece = Vec::new();
        while let Some(i) = queue.pop() {
            if !std::mem::replace(&mut seen[i], true) {
                piece.push(list[i]);
                queue.extend(&links[i]);
            }
        }
        if !piece.is_empty() {
            result.push(piece);
        }
    }
    result
}

/// The polygon around some faces; `None` where that is not one simple polygon.
fn outline(data: &MeshData, faces: &[usize]) -> Option<Vec<usize>> {
    if let &[face] = faces {
        return Some(data.faces.get(face).to_vec());
    }
    let mut count: FxHashMap<(usize, usize), usize> = FxHashMap::default();
    for &face in faces {
        ridges(data.faces.get(face)).for_each(|(key, _)| *count.entry(key).or_default() += 1);
    }
    let mut next: FxHashMap<usize, Vec<usize>> = FxHashMap::default();
    let mut edges = 0;
    for (&(a, b), _) in count.iter().filter(|entry| *entry.1 == 1) {
        next.entry(a).or_default().push(b);
        next.entry(b).or_default().push(a);
        edges += 1;
    }
    if next.values().any(|ends| ends.len() != 2) {
        return None;
    }
    let start = *next.keys().min()?;
    let mut polygon = vec![start];
    let (mut previous, mut here) = (start, *next[&start].iter().min()?);
    while here != start {
        polygon.push(here);
        let ends = &next[&here];
        (previous, here) = (here, if ends[0] == previous { ends[1] } else { ends[0] });
    }
    (polygon.len() == edges).then_some(polygon)
}

/// Drops vertices at which only two edges meet: those in line with their neighbours, and under
/// [`Unite::All`] others unless a surface would change its shape.
fn drop_vertices(data: &MeshData, faces: &mut [Face], mode: Unite) {
    let mut at: Vec<Vec<usize>> = vec![Vec::new(); data.vertices.len()];
    for (i, face) in faces.iter().enumerate() {
        face.outline.iter().for_each(|&v| at[v].push(i));
    }
    for v in 0..data.vertices.len() {
        let mut around = FxHashSet::default();
        for &i in &at[v] {
            around.extend(neighbours(&faces[i].outline, v));
        }
        let &[p, q] = &around.into_iter().collect::<Vec<_>>()[..] else { continue };
        let (to, from) = (data.vertices[v] - data.vertices[p], data.vertices[q] - data.vertices[v]);
        let in_line = to.cross(from).length() < PARALLEL * to.length() * from.length() && to.dot(from) > 0.0;
        let normals: Vec<Vec3> = at[v].iter().filter_map(|&i| faces[i].normal).collect();
        let one_plane = normals.iter().all(|n| n.cross(normals[0]).length() < PARALLEL);
        // All faces at v have both edges: where only one lies on a surface, the surface ends there.
        let keeps_shape = normals.is_empty() || (data.dim == 3 && one_plane && normals.len() > 1);
        if !(in_line || (mode == Unite::All && keeps_shape)) {
            continue;
        }
        if data.dim == 2 {
            let &[i, j] = &at[v][..] else { continue };
            let (a, b) = (&faces[i], &faces[j]);
            let same = a.cells == b.cells && a.tag == b.tag && a.fracture == b.fracture;
            let is_new = !at[p].iter().any(|&f| faces[f].outline.contains(&q));
            if same && is_new {
                faces[i].outline = vec![p, q];
                faces[j].outline.clear();
                at[p].retain(|&f| f != j);
                at[q].retain(|&f| f != j);
                // Whichever end belonged to the face that is gone.
                for end in [p, q] {
                    if !at[end].contains(&i) {
                        at[end].push(i);
                    }
                }
                at[v].clear();
            }
        } else {
            let large = at[v].iter().all(|&i| faces[i].outline.len() > 3);
            let is_new = !at[p].iter().any(|&i| {
                let own = &faces[i].outline;
                own.contains(&q) && neighbours(own, p).contains(&q)
            });
            if large && is_new {
                for &i in &at[v] {
                    faces[i].outline.retain(|&u| u != v);
                }
                at[v].clear();
            }
        }
    }
}

/// The two neighbours of `v` in a polygon that has it (in a segment, the other end twice).
fn neighbours(polygon: &[usize], v: usize) -> [usize; 2] {
    let n = polygon.len();
    let i = polygon.iter().position(|&u| u == v).unwrap_or_default();
    [polygon[(i + n - 1) % n], polygon[(i + 1) % n]]
}

/// Numbers what is left.
fn assemble(old: &MeshData, mut faces: Vec<Face>, cell_region: Vec<usize>) -> MeshData {
    faces.retain(|face| !face.outline.is_empty());
    let mut used = vec![false; old.vertices.len()];
    faces.iter().flat_map(|face| &face.outline).for_each(|&v| used[v] = true);
    let mut number = vec![0; used.len()];
    let mut vertices = Vec::new();
    for v in (0..used.len()).filter(|&v| used[v]) {
        number[v] = vertices.len();
        vertices.push(old.vertices[v]);
    }
    let cells_of_face: Lists = faces.iter().map(|face| face.cells.into_iter().flatten()).collect();
    MeshData {
        dim: old.dim,
        vertices,
        faces: faces.iter().map(|face| face.outline.iter().map(|&v| number[v])).collect(),
        cells: cells_of_face.transpose(cell_region.len()),
        cell_region,
        regions: old.regions.clone(),
        face_tag: faces.iter().map(|face| face.tag).collect(),
        tags: old.tags.clone(),
        face_fracture: faces.iter().map(|face| face.fracture).collect(),
        fractures: old.fractures.clone(),
    }
}
