//! Polytopal meshes of a fractured rock, in two and three dimensions.
//!
//! A [`MeshData`] says which vertices make a face and which faces make a cell, and names regions,
//! boundary tags and fractures. [`Mesh::new`] checks it and derives all that the discretisations need:
//!
//! - orientation: every face has a normal outward from its first cell ([`Mesh::face_cells`]);
//! - [`Geometry`]: measures, centres, and the weights that integrate affine functions exactly;
//! - [`Network`]: the fracture faces, their sides and bases, and the edges where they meet;
//! - [`Nodes`]: the vertices, split along the fractures.
//!
//! Coordinates are metres; in two dimensions z = 0. Entities are called as in the literature on
//! fractured media: cell, face, edge and vertex have dimension d, d − 1, 1 and 0.

mod data;
mod error;
mod fingerprint;
pub mod generate;
mod geometry;
mod lists;
mod locate;
mod network;
mod nodes;
mod quadrature;
mod random;
mod topology;
mod transform;
#[cfg(feature = "zoo")]
pub mod zoo;

pub use data::MeshData;
pub use error::{MeshError, Problem};
pub use geometry::Geometry;
pub use glam::{DMat3 as Mat3, DVec3 as Vec3};
pub use lists::Lists;
pub use locate::Locator;
pub use network::{EdgeKind, Network, Side, tangents};
pub use nodes::Nodes;
pub use transform::Renumbering;

/// A checked mesh with all that is derived from it.
///
/// The fields of [`data`](Self::data) keep their numbering; the vertices of a face may have been
/// reversed so that its normal points out of its first cell.
#[derive(Clone, Debug)]
pub struct Mesh {
    data: MeshData,
    face_cells: Vec<(usize, Option<usize>)>,
    cell_face_signs: Vec<f64>,
    cell_vertices: Lists,
    geometry: Geometry,
    network: Network,
    nodes: Nodes,
}

impl Mesh {
    /// The [`warp`](Self::warp) up to which a face counts as planar where nothing else is said: coordinates of single precision
    /// (6e-8) leave as much on a thousandth of the mesh's extent.
    pub const PLANAR: f64 = 1e-4;

    /// Checks `data` and derives orientation, geometry, fracture network and nodes.
    ///
    /// # Errors
    /// All the problems found. Those of geometry are looked for only where the topology is sound.
    pub fn new(data: MeshData) -> Result<Self, MeshError> {
        topology::build(data, false)
    }

    /// As [`new`](Self::new), with plus and minus side of every fracture exchanged.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_swapped_sides(data: MeshData) -> Result<Self, MeshError> {
        topology::build(data, true)
    }

    /// 2 or 3.
    pub fn dim(&self) -> usize {
        self.data.dim
    }

    /// What the mesh was made from.
    pub fn data(&self) -> &MeshData {
        &self.data
    }

    /// Gives back what the mesh was made from.
    pub fn into_data(self) -> MeshData {
        self.data
    }

    /// Coordinates (m); z = 0 in 2D.
    pub fn vertices(&self) -> &[Vec3] {
        &self.data.vertices
    }

    /// Number of faces.
    pub fn face_count(&self) -> usize {
        self.data.faces.len()
    }

    /// Number of cells.
    pub fn cell_count(&self) -> usize {
        self.data.cells.len()
    }

    /// The vertices of a face: the two ends (2D), the normal pointing to the right on the way from the first to the second, or
    /// the polygon, counter-clockwise seen from the side its normal points to (3D).
    pub fn face_vertices(&self, face: usize) -> &[usize] {
        self.data.faces.get(face)
    }

    /// The faces of a cell.
    pub fn cell_faces(&self, cell: usize) -> &[usize] {
        self.data.cells.get(cell)
    }

    /// For each of [`cell_faces`](Self::cell_faces), +1 where the face's normal points out of the cell, −1
    /// where it points in.
    pub fn cell_face_signs(&self, cell: usize) -> &[f64] {
        &self.cell_face_signs[self.data.cells.range(cell)]
    }

    /// The vertices of a cell, ascending.
    pub fn cell_vertices(&self, cell: usize) -> &[usize] {
        self.cell_vertices.get(cell)
    }

    /// The corners of a cell of a 2D mesh, counter-clockwise; without meaning in 3D.
    pub fn cell_polygon(&self, cell: usize) -> Vec<usize> {
        let mut edges: Vec<(usize, usize)> = (self.cell_faces(cell).iter().zip(self.cell_face_signs(cell)))
            .map(|(&face, &sign)| {
                let list = self.face_vertices(face);
                if sign > 0.0 { (list[0], list[list.len() - 1]) } else { (list[list.len() - 1], list[0]) }
            })
            .collect();
        // The surface is closed and in one piece: each edge has one that continues it.
        for i in 1..edges.len() {
            if let Some(next) = (i..edges.len()).find(|&j| edges[j].0 == edges[i - 1].1) {
                edges.swap(i, next);
            }
        }
        edges.into_iter().map(|edge| edge.0).collect()
    }

    /// The vertices of all cells.
    pub fn cell_vertex_lists(&self) -> &Lists {
        &self.cell_vertices
    }

    /// The cell that a face's normal points out of, and the cell on the other side if there is one. On a
    /// fracture face the first is the plus side.
    pub fn face_cells(&self, face: usize) -> (usize, Option<usize>) {
        self.face_cells[face]
    }

    /// Whether a face lies on the outer boundary.
    pub fn is_boundary(&self, face: usize) -> bool {
        self.face_cells[face].1.is_none()
    }

    /// Measures, centres and weights.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// The fracture network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// The vertices, split along the fractures.
    pub fn nodes(&self) -> &Nodes {
        &self.nodes
    }

    /// How far a face is from planar: the largest distance of a vertex from its mean plane, over its diameter (twice the largest
    /// distance of a vertex from its centre). 0 where there are no more than three vertices.
    pub fn warp(&self, face: usize) -> f64 {
        let list = self.face_vertices(face);
        if list.len() <= 3 {
            return 0.0;
        }
        let (normal, center) = (self.geometry.face_normal(face), self.geometry.face_center[face]);
        let (mut off_plane, mut diameter) = (0.0f64, 0.0f64);
        for &v in list {
            let offset = self.vertices()[v] - center;
            off_plane = off_plane.max(offset.dot(normal).abs());
            diameter = diameter.max(2.0 * offset.length());
        }
        off_plane / diameter
    }

    /// The faces of the outer boundary that carry a tag; none where there is no such tag.
    pub fn tagged_faces<'a>(&'a self, tag: &str) -> impl Iterator<Item = usize> + 'a {
        let wanted = self.data.tags.iter().position(|t| t == tag);
        (0..self.face_count()).filter(move |&f| wanted.is_some() && self.data.face_tag[f] == wanted)
    }

    /// The cells of a region; none where there is no such region.
    pub fn region_cells<'a>(&'a self, region: &str) -> impl Iterator<Item = usize> + 'a {
        let wanted = self.data.regions.iter().position(|r| r == region);
        (0..self.cell_count()).filter(move |&c| Some(self.data.cell_region[c]) == wanted)
    }
}
