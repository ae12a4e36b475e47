//! From what was given to a checked, oriented mesh.

use std::hash::{Hash, Hasher};

use rustc_hash::{FxHashMap, FxHasher};

use crate::generate::side;
use crate::geometry::{diameter, face_vector};
use crate::{Geometry, Lists, Mesh, MeshData, MeshError, Network, Nodes, Problem, Vec3};

/// A face or cell below this part of its diameter's power is degenerate: a few hundred units of round-off.
const DEGENERATE: f64 = 1e-13;

/// Whether a measure is no round-off, nor lost because coordinates are too large or too small to be multiplied: then
/// both sides are infinite or zero, or one is NaN.
fn is_sound(measure: f64, diameter: f64, dim: usize) -> bool {
    measure > DEGENERATE * diameter.powi(dim as i32)
}

/// The ridges of a face: its edges in 3D as (lower vertex, higher vertex), its vertices in 2D as (v, v). The
/// direction is ±1, such that two faces which meet at a ridge with opposite directions have normals to the
/// same side of their common surface.
pub(crate) fn ridges(face: &[usize]) -> impl Iterator<Item = ((usize, usize), i8)> {
    let n = face.len();
    (0..n).map(move |i| {
        let (a, b) = (face[i], face[(i + 1) % n]);
        match (n, i) {
            (2, 0) => ((a, a), -1),
            (2, _) => ((a, a), 1),
            _ if a < b => ((a, b), 1),
            _ => ((b, a), -1),
        }
    })
}

/// `swap` exchanges plus and minus side of every fracture.
pub(crate) fn build(mut data: MeshData, swap: bool) -> Result<Mesh, MeshError> {
    let mut problems = check_references(&data);
    fail_on(&mut problems)?;
    check_vertices(&data, &mut problems);
    check_faces(&data, &mut problems);

    let mut signs = orient_cells(&data, &mut problems);
    fail_on(&mut problems)?;

    let mut cell_vertices = Lists::new();
    let mut own = Vec::new();
    for faces in data.cells.iter() {
        own.clear();
        own.extend(faces.iter().flat_map(|&f| data.faces.get(f)));
        own.sort_unstable();
        own.dedup();
        cell_vertices.push(own.iter().copied());
    }
    check_crossings(&data, &mut problems);
    let cells = outward_cells(&data, &cell_vertices, &mut signs, &mut problems);
    fail_on(&mut problems)?;

    let face_cells = orient_faces(&mut data, &mut signs, swap, &mut problems);
    fail_on(&mut problems)?;

    let geometry = cells.with_faces(&data.vertices, &data.faces);
    let network = Network::new(&data.faces, &face_cells, &data.face_fracture);
    let nodes =
        Nodes::new(data.vertices.len(), &data.faces, &cell_vertices, &face_cells, |f| data.face_fracture[f].is_some());
    Ok(Mesh { data, face_cells, cell_face_signs: signs, cell_vertices, geometry, network, nodes })
}

fn fail_on(problems: &mut Vec<Problem>) -> Result<(), MeshError> {
    if problems.is_empty() { Ok(()) } else { Err(MeshError { problems: std::mem::take(problems) }) }
}

/// Lengths, ranges and names: what everything else relies on.
fn check_references(data: &MeshData) -> Vec<Problem> {
    let mut problems = Vec::new();
    if !(data.dim == 2 || data.dim == 3) {
        problems.push(Problem::Dimension { dimension: data.dim });
    }
    if data.cells.is_empty() {
        problems.push(Problem::Empty);
    }
    for (array, entity, found, expected) in [
        ("cell_region", "cell", data.cell_region.len(), data.cells.len()),
        ("face_tag", "face", data.face_tag.len(), data.faces.len()),
        ("face_fracture", "face", data.face_fracture.len(), data.faces.len()),
    ] {
        if found != expected {
            problems.push(Problem::Length { array, entity, found, expected });
        }
    }
    let mut refer = |entity, number, target, index, count| {
        if index >= count {
            problems.push(Problem::OutOfRange { entity, number, target, index, count });
        }
    };
    for (face, list) in data.faces.iter().enumerate() {
        list.iter().for_each(|&v| refer("face", face, "vertex", v, data.vertices.len()));
    }
    for (cell, list) in data.cells.iter().enumerate() {
        list.iter().for_each(|&f| refer("cell", cell, "face", f, data.faces.len()));
    }
    for (cell, &region) in data.cell_region.iter().enumerate() {
        refer("cell", cell, "region", region, data.regions.len());
    }
    for (face, &tag) in data.face_tag.iter().enumerate() {
        tag.into_iter().for_each(|t| refer("face", face, "tag", t, data.tags.len()));
    }
    for (face, &fracture) in data.face_fracture.iter().enumerate() {
        fracture.into_iter().for_each(|i| refer("face", face, "fracture", i, data.fractures.len()));
    }
    for (kind, names) in [("region", &data.regions), ("tag", &data.tags), ("fracture", &data.fractures)] {
        for (i, name) in names.iter().enumerate() {
            if name.is_empty() || names[..i].contains(name) {
                problems.push(Problem::Name { kind, name: name.clone() });
            }
        }
    }
    problems
}

fn check_vertices(data: &MeshData, problems: &mut Vec<Problem>) {
    let mut used = vec![false; data.vertices.len()];
    data.faces.items().iter().for_each(|&v| used[v] = true);
    let mut at = FxHashMap::with_capacity_and_hasher(data.vertices.len(), Default::default());
    for (vertex, (&p, used)) in data.vertices.iter().zip(used).enumerate() {
        let Vec3 { x, y, z } = p;
        if !p.is_finite() || (data.dim == 2 && z != 0.0) {
            problems.push(Problem::Coordinate { vertex, x, y, z });
        }
        if !used {
            problems.push(Problem::UnusedVertex { vertex });
        }
        // Adding zero turns −0 into +0.
        let key = (p + Vec3::ZERO).to_array().map(f64::to_bits);
        if let Some(first) = at.insert(key, vertex) {
            problems.push(Problem::CoincidentVertices { first, second: vertex, x, y, z });
        }
    }
}

fn check_faces(data: &MeshData, problems: &mut Vec<Problem>) {
    let mut hashes = Vec::with_capacity(data.faces.len());
    let mut key = Vec::new();
    for (face, list) in data.faces.iter().enumerate() {
        let enough = if data.dim == 2 { list.len() == 2 } else { list.len() >= 3 };
        if !enough {
            problems.push(Problem::VertexCount { face, count: list.len() });
            continue;
        }
        sort_into(&mut key, list);
        if let Some(pair) = key.windows(2).find(|pair| pair[0] == pair[1]) {
            problems.push(Problem::RepeatedVertex { face, vertex: pair[0] });
            continue;
        }
        let mut hasher = FxHasher::default();
        key.hash(&mut hasher);
        hashes.push((hasher.finish(), face));
        let measure = face_vector(&data.vertices, list).length();
        let diameter = diameter(&data.vertices, list);
        let finite = list.iter().all(|&v| data.vertices[v].is_finite());
        if finite && !is_sound(measure, diameter, data.dim - 1) {
            problems.push(Problem::DegenerateFace { face, measure, diameter });
        }
    }
    // Faces with the same vertices have the same hash.
    hashes.sort_unstable();
    let mut other = Vec::new();
    for group in hashes.chunk_by(|a, b| a.0 == b.0) {
        for (i, &(_, second)) in group.iter().enumerate().skip(1) {
            sort_into(&mut key, data.faces.get(second));
            let same = |&&(_, first): &&(u64, usize)| {
                sort_into(&mut other, data.faces.get(first));
                key == other
            };
            if let Some(&(_, first)) = group[..i].iter().find(same) {
                problems.push(Problem::DuplicateFaces { first, second });
            }
        }
    }
    let cells_of_face = data.cells.transpose(data.faces.len());
    for (face, cells) in cells_of_face.iter().enumerate() {
        let inner = cells.len() == 2 && cells[0] != cells[1];
        if !(inner || cells.len() == 1) {
            problems.push(Problem::FaceCells { face, cells: cells.to_vec() });
        }
        if let (1, Some(fracture)) = (cells.len(), data.face_fracture[face]) {
            problems.push(Problem::FractureOnBoundary { face, fracture: data.fractures[fracture].clone() });
        }
        if let (true, Some(tag)) = (inner, data.face_tag[face]) {
            problems.push(Problem::TagInside { face, tag: data.tags[tag].clone() });
        }
    }
}

fn sort_into(key: &mut Vec<usize>, list: &[usize]) {
    key.clear();
    key.extend_from_slice(list);
    key.sort_unstable();
}

/// Signs that make the faces of each cell agree with one another; the surface must be closed.
fn orient_cells(data: &MeshData, problems: &mut Vec<Problem>) -> Vec<f64> {
    let mut signs = vec![0.0; data.cells.items().len()];
    let mut at_ridge: Vec<((usize, usize), usize, i8)> = Vec::new();
    let mut links: Vec<(usize, usize, f64)> = Vec::new();
    let mut queue = Vec::new();
    for (cell, faces) in data.cells.iter().enumerate() {
        at_ridge.clear();
        links.clear();
        for (i, &face) in faces.iter().enumerate() {
            at_ridge.extend(ridges(data.faces.get(face)).map(|(key, direction)| (key, i, direction)));
        }
        at_ridge.sort_unstable();
        let before = problems.len();
        for group in at_ridge.chunk_by(|a, b| a.0 == b.0) {
            if let &[(_, i, di), (_, j, dj)] = group {
                let relative = if di == dj { -1.0 } else { 1.0 };
                links.push((i, j, relative));
                links.push((j, i, relative));
            } else {
                let (a, b) = group[0].0;
                let ridge = if a == b { vec![a] } else { vec![a, b] };
                problems.push(Problem::OpenCell { cell, ridge, count: group.len() });
            }
        }
        if problems.len() > before {
            continue;
        }
        links.sort_unstable_by_key(|link| link.0);
        let own = &mut signs[data.cells.range(cell)];
        queue.clear();
        if let Some(first) = own.first_mut() {
            *first = 1.0;
            queue.push(0);
        }
        let mut sound = true;
        while let Some(i) = queue.pop() {
            let from = links.partition_point(|link| link.0 < i);
            for &(_, j, relative) in links[from..].iter().take_while(|link| link.0 == i) {
                if own[j] == 0.0 {
                    own[j] = relative * own[i];
                    queue.push(j);
                }
                sound &= own[j] == relative * own[i];
            }
        }
        if !sound || own.contains(&0.0) || own.is_empty() {
            problems.push(Problem::CellSurface { cell });
        }
    }
    signs
}

/// In 2D no two edges of a cell may cross (in a triangle they cannot).
fn check_crossings(data: &MeshData, problems: &mut Vec<Problem>) {
    for (cell, faces) in data.cells.iter().enumerate().filter(|(_, faces)| data.dim == 2 && faces.len() > 3) {
        let ends = |face: usize| data.faces.get(face).iter().map(|&v| data.vertices[v].truncate());
        let apart = |first: usize, second: usize| {
            let mut points = ends(first).zip(ends(second));
            let (Some((a, c)), Some((b, d))) = (points.next(), points.next()) else { return true };
            let opposite = |p: f64, q: f64| (p > 0.0 && q < 0.0) || (p < 0.0 && q > 0.0);
            !(opposite(side(a, b, c), side(a, b, d)) && opposite(side(c, d, a), side(c, d, b)))
        };
        for (i, &second) in faces.iter().enumerate() {
            if let Some(&first) = faces[..i].iter().find(|&&first| !apart(first, second)) {
                problems.push(Problem::CrossingFaces { cell, first, second });
            }
        }
    }
}

/// Turns the signs of each cell so that its measure is positive; gives the geometry of the cells.
fn outward_cells(data: &MeshData, cell_vertices: &Lists, signs: &mut [f64], problems: &mut Vec<Problem>) -> Geometry {
    let mut geometry = Geometry::of_cells(data.dim, &data.vertices, &data.faces, &data.cells, signs, cell_vertices);
    for cell in 0..data.cells.len() {
        let (measure, diameter) = (&mut geometry.cell_measure[cell], geometry.cell_diameter[cell]);
        if !is_sound(measure.abs(), diameter, data.dim) {
            problems.push(Problem::DegenerateCell { cell, measure: *measure, diameter });
        } else if *measure < 0.0 {
            // The weights do not change with the sense of the surface.
            *measure = -*measure;
            signs[data.cells.range(cell)].iter_mut().for_each(|s| *s = -*s);
        }
    }
    geometry
}

/// Finds the cells on both sides of each face and turns faces so that boundary normals point outward and
/// the normals of one fracture agree.
fn orient_faces(
    data: &mut MeshData,
    signs: &mut [f64],
    swap: bool,
    problems: &mut Vec<Problem>,
) -> Vec<(usize, Option<usize>)> {
    let n = data.faces.len();
    let mut sides = vec![[None::<usize>; 2]; n];
    for cell in 0..data.cells.len() {
        for (&face, &sign) in data.cells.get(cell).iter().zip(&signs[data.cells.range(cell)]) {
            let side = &mut sides[face][usize::from(sign < 0.0)];
            if let Some(first) = *side {
                problems.push(Problem::SameSide { face, first, second: cell });
            }
            *side = Some(cell);
        }
    }
    let mut flip: Vec<bool> = sides.iter().map(|side| side[0].is_none()).collect();
    agree_along_fractures(data, swap, &mut flip);
    let mut face_cells = Vec::with_capacity(n);
    for face in 0..n {
        if flip[face] {
            data.faces.get_mut(face).reverse();
            sides[face].swap(0, 1);
        }
        let [first, second] = sides[face];
        // Every face has a cell: `check_faces` saw to it.
        face_cells.push((first.unwrap_or_default(), second));
    }
    for (sign, &face) in signs.iter_mut().zip(data.cells.items()) {
        if flip[face] {
            *sign = -*sign;
        }
    }
    face_cells
}

/// Makes the normals of each fracture agree from face to face. Where a chain starts, the first component of
/// the normal that is not small is positive, so that the choice does not depend on the numbering of cells.
fn agree_along_fractures(data: &MeshData, swap: bool, flip: &mut [bool]) {
    let faces: Vec<usize> = (0..data.faces.len()).filter(|&f| data.face_fracture[f].is_some()).collect();
    type FractureRidge = (usize, (usize, usize));
    let mut at_ridge: FxHashMap<FractureRidge, Vec<(usize, i8)>> = FxHashMap::default();
    for &face in &faces {
        let fracture = data.face_fracture[face].unwrap_or_default();
        for (key, direction) in ridges(data.faces.get(face)) {
            at_ridge.entry((fracture, key)).or_default().push((face, direction));
        }
    }
    let mut seen = vec![false; data.faces.len()];
    for &start in &faces {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        let normal = face_vector(&data.vertices, data.faces.get(start)).normalize().to_array();
        flip[start] = normal.into_iter().find(|c| c.abs() > 1e-3).is_some_and(|c| (c < 0.0) != swap);
        let mut queue = vec![start];
        while let Some(face) = queue.pop() {
            let fracture = data.face_fracture[face].unwrap_or_default();
            for (key, direction) in ridges(data.faces.get(face)) {
                let Some(group) = at_ridge.get(&(fracture, key)) else { continue };
                // At a branching there is no one neighbour to agree with.
                if group.len() == 2 {
                    for &(other, other_direction) in group {
                        if !seen[other] {
                            seen[other] = true;
                            flip[other] = flip[face] ^ (direction == other_direction);
                            queue.push(other);
                        }
                    }
                }
            }
        }
    }
}
