//! Polygons and polyhedra from simplices.

use rustc_hash::FxHashMap;

use super::coarsen::{Unite, unite};
use super::{InputError, InputProblem};
use crate::data::FaceTable;
use crate::{Mesh, MeshData, Vec3};

fn check_simplices(mesh: &Mesh) -> Result<(), InputError> {
    let wanted = mesh.dim() + 1;
    let problems = (0..mesh.cell_count())
        .filter(|&cell| mesh.cell_faces(cell).len() != wanted || mesh.cell_vertices(cell).len() != wanted)
        .map(|cell| InputProblem::NoSimplex { cell, faces: mesh.cell_faces(cell).len() });
    InputError::check(problems.collect())
}

/// The dual of a mesh of simplices: one cell around each vertex, whose corners are the centres of the
/// simplices. Boundary, fractures and interfaces between regions keep their shape: a vertex on them gets a cell
/// on each side, also where a fracture ends. In 2D the cells have about 6 faces, in 3D about 14 to 20, which
/// inside are not planar (their vertices are the centres of the tetrahedra around an edge).
///
/// # Errors
/// Cells that are not simplices.
pub fn dual(mesh: &Mesh) -> Result<MeshData, InputError> {
    check_simplices(mesh)?;
    let (data, corner) = corners(mesh);
    let group = groups(&data, &corner, mesh);
    Ok(unite(&data, &group, Unite::All))
}

/// Cuts each simplex into one hexahedron (2D: quadrilateral) for each of its vertices, between the means of its
/// vertices taken one, two, three and four at a time; gives that vertex for each.
fn corners(mesh: &Mesh) -> (MeshData, Vec<usize>) {
    let old = mesh.data();
    let mut vertices = old.vertices.clone();
    let mut numbers: FxHashMap<Vec<usize>, usize> = FxHashMap::default();
    let mut point = |list: &[usize]| {
        if let &[v] = list {
            return v;
        }
        let mut key = list.to_vec();
        key.sort_unstable();
        *numbers.entry(key).or_insert_with_key(|key| {
            vertices.push(key.iter().map(|&v| old.vertices[v]).sum::<Vec3>() / key.len() as f64);
            vertices.len() - 1
        })
    };
    let mut table = FaceTable::default();
    let (mut face_tag, mut face_fracture) = (Vec::new(), Vec::new());
    for face in 0..mesh.face_count() {
        let list = mesh.face_vertices(face);
        for &a in list {
            let others: Vec<usize> = list.iter().copied().filter(|&v| v != a).collect();
            table.number(&match others[..] {
                [b] => vec![a, point(&[a, b])],
                _ => vec![a, point(&[a, others[0]]), point(list), point(&[a, others[1]])],
            });
            face_tag.push(old.face_tag[face]);
            face_fracture.push(old.face_fracture[face]);
        }
    }
    let mut cells = Vec::new();
    let mut corner = Vec::new();
    let mut cell_region = Vec::new();
    for cell in 0..mesh.cell_count() {
        let list = mesh.cell_vertices(cell);
        for &a in list {
            let o: Vec<usize> = list.iter().copied().filter(|&v| v != a).collect();
            let n = o.len();
            let mut faces = Vec::new();
            for i in 0..n {
                // The parts of the simplex's faces around a, and the cut across the edge from a to each other vertex.
                let (b, c) = (o[i], o[(i + 1) % n]);
                if n == 2 {
                    faces.push(table.number(&[a, point(&[a, b])]));
                    faces.push(table.number(&[point(&[a, b]), point(list)]));
                } else {
                    let d = o[(i + 2) % n];
                    faces.push(table.number(&[a, point(&[a, b]), point(&[a, b, c]), point(&[a, c])]));
                    faces.push(table.number(&[point(&[a, b]), point(&[a, b, c]), point(list), point(&[a, b, d])]));
                }
            }
            cells.push(faces);
            corner.push(a);
            cell_region.push(old.cell_region[cell]);
        }
    }
    face_tag.resize(table.lists.len(), None);
    face_fracture.resize(table.lists.len(), None);
    let data = MeshData {
        dim: old.dim,
        vertices,
        faces: table.lists,
        cells: cells.into_iter().collect(),
        cell_region,
        regions: old.regions.clone(),
        face_tag,
        tags: old.tags.clone(),
        face_fracture,
        fractures: old.fractures.clone(),
    };
    (data, corner)
}

/// Groups the corners of simplices around each vertex: those that hang together without crossing a fracture
/// or leaving a region. Where a group lies on both sides of a fracture (at its tip) it is cut along the
/// plane of the fracture.
fn groups(data: &MeshData, corner: &[usize], mesh: &Mesh) -> Vec<usize> {
    let uses = data.cells.transpose(data.faces.len());
    let center: Vec<Vec3> = (data.cells.iter())
        .map(|faces| faces.iter().map(|&f| data.face_mean(f)).sum::<Vec3>() / faces.len() as f64)
        .collect();
    let mut side: Vec<u64> = vec![0; corner.len()];
    let join = |side: &[u64]| {
        let mut parent: Vec<usize> = (0..corner.len()).collect();
        for (face, cells) in uses.iter().enumerate() {
            if let &[a, b] = cells
                && data.face_fracture[face].is_none()
                && corner[a] == corner[b]
                && data.cell_region[a] == data.cell_region[b]
                && side[a] == side[b]
            {
                let (a, b) = (root(&mut parent, a), root(&mut parent, b));
                parent[a.max(b)] = a.min(b);
            }
        }
        (0..corner.len()).map(|i| root(&mut parent, i)).collect::<Vec<_>>()
    };
    let group = join(&side);
    // The planes that cut each vertex's cells.
    let mut planes: FxHashMap<usize, Vec<Vec3>> = FxHashMap::default();
    for face in (0..data.faces.len()).filter(|&f| data.face_fracture[f].is_some()) {
        if let &[a, b] = uses.get(face)
            && group[a] == group[b]
        {
            let list = data.faces.get(face);
            let normal = if data.dim == 2 {
                (data.vertices[list[1]] - data.vertices[list[0]]).cross(Vec3::Z)
            } else {
                (data.vertices[list[2]] - data.vertices[list[0]]).cross(data.vertices[list[3]] - data.vertices[list[1]])
            };
            let normal = normal.normalize();
            let known = planes.entry(corner[a]).or_default();
            // Faces of one plane; the number of planes fits the bits of `side`.
            if known.len() < 64 && !known.iter().any(|n| n.cross(normal).length() < 1e-6) {
                known.push(normal);
            }
        }
    }
    if planes.is_empty() {
        return group;
    }
    for (cell, own) in side.iter_mut().enumerate() {
        if let Some(planes) = planes.get(&corner[cell]) {
            let away = center[cell] - mesh.vertices()[corner[cell]];
            for (i, normal) in planes.iter().enumerate() {
                *own |= u64::from(away.dot(*normal) > 0.0) << i;
            }
        }
    }
    join(&side)
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

/// Cells of about `size` simplices each: polygons and polyhedra with many planar faces, mostly not convex.
/// Every cell is a ball (in one piece, without holes, its surface a manifold) and lies on one side of every
/// fracture and in one region; faces of two cells that lie in one plane are united.
///
/// # Errors
/// Cells that are not simplices.
pub fn agglomerate(mesh: &Mesh, size: usize) -> Result<MeshData, InputError> {
    check_simplices(mesh)?;
    let mut clusters = Clusters { mesh, of_cell: vec![None; mesh.cell_count()], members: Vec::new() };
    for start in 0..mesh.cell_count() {
        if clusters.of_cell[start].is_none() {
            clusters.grow(start, size);
        }
    }
    clusters.dissolve_small(size.div_ceil(3));
    let group: Vec<usize> = clusters.of_cell.iter().map(|c| c.unwrap_or_default()).collect();
    Ok(unite(mesh.data(), &group, Unite::Flat))
}

/// Unites the cells of each group; `group` gives a number for each cell. A group must be one piece, a ball, in one
/// region and on one side of every fracture, or [`Mesh::new`] will refuse the result. Faces of the same two cells in one
/// plane are united, vertices within straight edges dropped. The groups become cells in the order of their first
/// cells.
///
/// # Panics
/// Where `data` is no sound mesh or `group` is not as long as its cells.
pub fn unite_cells(data: &MeshData, group: &[usize]) -> MeshData {
    unite(data, group, Unite::Flat)
}

/// Clusters of simplices, each a ball.
struct Clusters<'a> {
    mesh: &'a Mesh,
    of_cell: Vec<Option<usize>>,
    members: Vec<Vec<usize>>,
}

impl Clusters<'_> {
    /// The cells across the faces of `cell` that lie in its region, where the face is no fracture.
    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> {
        let data = self.mesh.data();
        (self.mesh.cell_faces(cell).iter())
            .filter(|&&face| data.face_fracture[face].is_none())
            .filter_map(move |&face| self.across(cell, face))
            .filter(move |&other| data.cell_region[other] == data.cell_region[cell])
    }

    fn across(&self, cell: usize, face: usize) -> Option<usize> {
        let (first, second) = self.mesh.face_cells(face);
        if first == cell { second } else { Some(first) }
    }

    /// Whether the cluster stays a ball, on one side of each fracture, with `cell` added: what they have in common
    /// must be the faces they share, with all the vertices and edges common to both on these.
    fn fits(&self, cluster: usize, cell: usize) -> bool {
        let mesh = self.mesh;
        let mut on_shared: Vec<usize> = Vec::new();
        let mut shared = 0;
        for &face in mesh.cell_faces(cell) {
            if self.across(cell, face).is_some_and(|other| self.of_cell[other] == Some(cluster)) {
                if mesh.data().face_fracture[face].is_some() {
                    return false;
                }
                shared += 1;
                on_shared.extend(mesh.face_vertices(face));
            }
        }
        let members = &self.members[cluster];
        let has = |list: &[usize]| {
            members.iter().any(|&m| list.iter().all(|v| mesh.cell_vertices(m).binary_search(v).is_ok()))
        };
        let own = mesh.cell_vertices(cell);
        match shared {
            // The vertex opposite the shared face.
            1 => own.iter().all(|v| on_shared.contains(v) || !has(&[*v])),
            // In 3D the edge opposite the one between the shared faces: its ends lie on one face each.
            2 if mesh.dim() == 3 => {
                let once = |v: &&usize| on_shared.iter().filter(|u| u == v).count() == 1;
                let edge: Vec<usize> = own.iter().filter(once).copied().collect();
                !has(&edge)
            }
            n => n >= 2 && n <= mesh.dim(),
        }
    }

    fn add(&mut self, cluster: usize, cell: usize) {
        self.of_cell[cell] = Some(cluster);
        self.members[cluster].push(cell);
    }

    /// Makes a cluster from `start`, adding what lies next to it and shares most faces.
    fn grow(&mut self, start: usize, size: usize) {
        let cluster = self.members.len();
        self.members.push(Vec::new());
        self.add(cluster, start);
        let center = &self.mesh.geometry().cell_center;
        let mut middle = center[start];
        while self.members[cluster].len() < size {
            let rank = |&cell: &usize| {
                let shared = self.neighbours(cell).filter(|&n| self.of_cell[n] == Some(cluster)).count();
                center[cell].distance(middle) / shared as f64
            };
            let best = (self.members[cluster].iter())
                .flat_map(|&cell| self.neighbours(cell))
                .filter(|&cell| self.of_cell[cell].is_none() && self.fits(cluster, cell))
                .min_by(|a, b| rank(a).total_cmp(&rank(b)).then(a.cmp(b)));
            let Some(best) = best else { break };
            self.add(cluster, best);
            let own = &self.members[cluster];
            middle = own.iter().map(|&c| center[c]).sum::<Vec3>() / own.len() as f64;
        }
    }

    /// Hands the cells of clusters with less than `least` cells to their neighbours, where these stay balls.
    fn dissolve_small(&mut self, least: usize) {
        for cluster in 0..self.members.len() {
            if self.members[cluster].len() >= least {
                continue;
            }
            // All or none: what is left of a ball need not be one.
            let own = std::mem::take(&mut self.members[cluster]);
            own.iter().for_each(|&cell| self.of_cell[cell] = None);
            let mut left = own.clone();
            while let Some((i, target)) = left.iter().enumerate().find_map(|(i, &cell)| {
                let to = self.neighbours(cell).filter_map(|n| self.of_cell[n]).find(|&to| self.fits(to, cell))?;
                Some((i, to))
            }) {
                let cell = left.swap_remove(i);
                self.add(target, cell);
            }
            if !left.is_empty() {
                for &cell in &own {
                    if let Some(target) = self.of_cell[cell].replace(cluster) {
                        self.members[target].retain(|&c| c != cell);
                    }
                }
                self.members[cluster] = own;
            }
        }
    }
}
