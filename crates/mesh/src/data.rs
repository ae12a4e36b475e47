//! What a mesh is made from.

use rustc_hash::FxHashMap;

use crate::{Lists, Vec3};

/// Vertices, faces and cells with their names: what generators and readers produce and files store.
///
/// | array | length | meaning |
/// |---|---|---|
/// | `vertices` | vertices | coordinates (m), z = 0 in 2D |
/// | `faces` | faces | 2D: two vertices; 3D: the polygon, in order around it |
/// | `cells` | cells | the faces of each cell, in any order |
/// | `cell_region` | cells | index into `regions` |
/// | `face_tag` | faces | index into `tags`, boundary faces only |
/// | `face_fracture` | faces | index into `fractures`, inner faces only |
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshData {
    /// 2 or 3.
    pub dim: usize,
    /// Coordinates (m).
    pub vertices: Vec<Vec3>,
    /// Vertices of each face.
    pub faces: Lists,
    /// Faces of each cell.
    pub cells: Lists,
    /// Region of each cell.
    pub cell_region: Vec<usize>,
    /// Names of the material regions.
    pub regions: Vec<String>,
    /// Boundary tag of each face.
    pub face_tag: Vec<Option<usize>>,
    /// Names of the boundary tags.
    pub tags: Vec<String>,
    /// Fracture of each face.
    pub face_fracture: Vec<Option<usize>>,
    /// Names of the fractures.
    pub fractures: Vec<String>,
}

impl MeshData {
    /// A 2D mesh from the corners of its cells, in order around each (either sense). One region, `rock`;
    /// no tags, no fractures.
    pub fn from_polygons<P: AsRef<[usize]>>(vertices: Vec<Vec3>, polygons: impl IntoIterator<Item = P>) -> Self {
        let mut faces = FaceTable::default();
        let cells = polygons
            .into_iter()
            .map(|polygon| {
                let p = polygon.as_ref();
                (0..p.len()).map(|i| faces.number(&[p[i], p[(i + 1) % p.len()]])).collect::<Vec<_>>()
            })
            .collect();
        Self::unnamed(2, vertices, faces.lists, cells)
    }

    /// A 3D mesh from the faces of its cells, each a polygon of vertices in order (either sense). Faces with
    /// the same vertices are one. One region, `rock`; no tags, no fractures.
    pub fn from_polyhedra<P: AsRef<[usize]>, C: IntoIterator<Item = P>>(
        vertices: Vec<Vec3>,
        polyhedra: impl IntoIterator<Item = C>,
    ) -> Self {
        let mut faces = FaceTable::default();
        let cells = polyhedra
            .into_iter()
            .map(|cell| cell.into_iter().map(|f| faces.number(f.as_ref())).collect::<Vec<_>>())
            .collect();
        Self::unnamed(3, vertices, faces.lists, cells)
    }

    pub(crate) fn unnamed(dim: usize, vertices: Vec<Vec3>, faces: Lists, cells: Lists) -> Self {
        Self {
            dim,
            vertices,
            cell_region: vec![0; cells.len()],
            regions: vec!["rock".into()],
            face_tag: vec![None; faces.len()],
            tags: Vec::new(),
            face_fracture: vec![None; faces.len()],
            fractures: Vec::new(),
            faces,
            cells,
        }
    }

    /// Mean of the vertices of a face (m).
    pub fn face_mean(&self, face: usize) -> Vec3 {
        mean(&self.vertices, self.faces.get(face))
    }

    /// The number of a boundary tag, which is added if it is new.
    pub fn tag(&mut self, name: &str) -> usize {
        number_of(&mut self.tags, name)
    }

    /// The number of a fracture, which is added if it is new.
    pub fn fracture(&mut self, name: &str) -> usize {
        number_of(&mut self.fractures, name)
    }

    /// The number of a region, which is added if it is new.
    pub fn region(&mut self, name: &str) -> usize {
        number_of(&mut self.regions, name)
    }

    /// Number of cells that name each face.
    fn face_uses(&self) -> Vec<u32> {
        let mut uses = vec![0; self.faces.len()];
        for &f in self.cells.items() {
            uses[f] += 1;
        }
        uses
    }

    /// Moves every vertex x to `map(x)`.
    pub fn map_vertices(&mut self, map: impl FnMut(Vec3) -> Vec3) {
        self.vertices = self.vertices.iter().copied().map(map).collect();
    }

    /// Gives every cell the region that `name` gives for the mean of its faces' means; `None` leaves it as
    /// it is. Regions that no cell has any more keep their number.
    pub fn assign_regions(&mut self, mut name: impl FnMut(Vec3) -> Option<&'static str>) {
        for cell in 0..self.cells.len() {
            let faces = self.cells.get(cell);
            let mean = faces.iter().map(|&f| self.face_mean(f)).sum::<Vec3>() / faces.len() as f64;
            if let Some(name) = name(mean) {
                self.cell_region[cell] = self.region(name);
            }
        }
    }

    /// Tags every boundary face by the name that `name` gives for the mean of its vertices; `None`
    /// leaves it as it is.
    pub fn tag_boundary(&mut self, mut name: impl FnMut(Vec3) -> Option<&'static str>) {
        for (face, uses) in self.face_uses().into_iter().enumerate() {
            if uses == 1
                && let Some(name) = name(self.face_mean(face))
            {
                self.face_tag[face] = Some(self.tag(name));
            }
        }
    }

    /// Marks as fracture `fracture` every inner face whose vertices all satisfy `on`.
    pub fn mark_fracture(&mut self, fracture: &str, mut on: impl FnMut(Vec3) -> bool) {
        let number = self.fracture(fracture);
        let on: Vec<bool> = self.vertices.iter().map(|&x| on(x)).collect();
        for (face, uses) in self.face_uses().into_iter().enumerate() {
            if uses == 2 && self.faces.get(face).iter().all(|&v| on[v]) {
                self.face_fracture[face] = Some(number);
            }
        }
    }
}

pub(crate) fn mean(vertices: &[Vec3], list: &[usize]) -> Vec3 {
    list.iter().map(|&v| vertices[v]).sum::<Vec3>() / list.len() as f64
}

fn number_of(names: &mut Vec<String>, name: &str) -> usize {
    names.iter().position(|n| n == name).unwrap_or_else(|| {
        names.push(name.to_owned());
        names.len() - 1
    })
}

/// Numbers faces by their set of vertices.
#[derive(Default)]
pub(crate) struct FaceTable {
    pub(crate) lists: Lists,
    numbers: FxHashMap<Vec<usize>, usize>,
    key: Vec<usize>,
}

impl FaceTable {
    pub(crate) fn number(&mut self, vertices: &[usize]) -> usize {
        self.key.clear();
        self.key.extend_from_slice(vertices);
        self.key.sort_unstable();
        if let Some(&number) = self.numbers.get(&self.key) {
            return number;
        }
        let number = self.lists.len();
        self.lists.push(vertices.iter().copied());
        self.numbers.insert(self.key.clone(), number);
        number
    }
}
