//! The fracture network: its faces, sides, bases and edges.

use rustc_hash::FxHashMap;

use crate::{Lists, Vec3, topology::ridges};

/// A side of a fracture face. The fracture normal n⁺ points out of the plus side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The first cell of the face.
    Plus,
    /// The second cell of the face.
    Minus,
}

/// What a fracture edge (2D: a vertex) is to the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// Two faces of one fracture meet.
    Inner,
    /// A fracture ends inside the rock.
    Tip,
    /// The edge lies on the outer boundary.
    Boundary,
    /// Three faces or more meet, or faces of different fractures.
    Intersection,
}

/// The fracture faces of a mesh, numbered by themselves, and the edges where they meet.
///
/// Edges are pairs of vertices in 3D and single vertices in 2D.
#[derive(Clone, Debug, Default)]
pub struct Network {
    /// Mesh face of each fracture face, ascending.
    pub faces: Vec<usize>,
    /// Fracture that each fracture face belongs to.
    pub fracture: Vec<usize>,
    /// Fracture face of each mesh face.
    pub number_of_face: Vec<Option<usize>>,
    /// Vertices of each fracture edge, ascending.
    pub edge_vertices: Lists,
    /// Fracture faces that meet at each fracture edge, ascending.
    pub edge_faces: Lists,
    /// Fracture edges of each fracture face.
    pub face_edges: Lists,
    /// Mesh faces of the outer boundary that contain each fracture edge.
    pub edge_boundary: Lists,
}

impl Network {
    /// Number of fracture faces.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// Number of fracture edges.
    pub fn edge_count(&self) -> usize {
        self.edge_faces.len()
    }

    /// What an edge is to the network.
    pub fn edge_kind(&self, edge: usize) -> EdgeKind {
        let faces = self.edge_faces.get(edge);
        if !self.edge_boundary.get(edge).is_empty() {
            EdgeKind::Boundary
        } else if faces.len() == 1 {
            EdgeKind::Tip
        } else if faces.len() == 2 && self.fracture[faces[0]] == self.fracture[faces[1]] {
            EdgeKind::Inner
        } else {
            EdgeKind::Intersection
        }
    }

    pub(crate) fn new(faces: &Lists, face_cells: &[(usize, Option<usize>)], face_fracture: &[Option<usize>]) -> Self {
        let mut network = Self { number_of_face: vec![None; faces.len()], ..Self::default() };
        for (face, fracture) in face_fracture.iter().enumerate() {
            if let Some(fracture) = *fracture {
                network.number_of_face[face] = Some(network.faces.len());
                network.faces.push(face);
                network.fracture.push(fracture);
            }
        }
        let mut number = FxHashMap::default();
        let mut faces_of_edge: Vec<Vec<usize>> = Vec::new();
        for (i, &face) in network.faces.iter().enumerate() {
            let edges: Vec<usize> = ridges(faces.get(face))
                .map(|(key, _)| {
                    *number.entry(key).or_insert_with(|| {
                        network.edge_vertices.push(if key.0 == key.1 { vec![key.0] } else { vec![key.0, key.1] });
                        faces_of_edge.push(Vec::new());
                        faces_of_edge.len() - 1
                    })
                })
                .collect();
            for &e in &edges {
                faces_of_edge[e].push(i);
            }
            network.face_edges.push(edges);
        }
        let mut boundary = vec![Vec::new(); faces_of_edge.len()];
        for (face, cells) in face_cells.iter().enumerate() {
            if cells.1.is_none() {
                for (key, _) in ridges(faces.get(face)) {
                    if let Some(&e) = number.get(&key) {
                        boundary[e].push(face);
                    }
                }
            }
        }
        network.edge_faces = faces_of_edge.into_iter().collect();
        network.edge_boundary = boundary.into_iter().collect();
        network
    }
}

/// The unit tangents t₁, t₂ that complete a unit normal to a right-handed basis (n, t₁, t₂).
///
/// In 2D t₁ is n turned by +90° (t₂ is the z axis, not used). In 3D t₁ is horizontal, along the strike
/// (ẑ × n, or x̂ for a horizontal face), and t₂ = n × t₁.
pub fn tangents(dim: usize, n: Vec3) -> [Vec3; 2] {
    let t1 = if dim == 2 {
        Vec3::new(-n.y, n.x, 0.0)
    } else {
        // Below this the strike is lost in round-off.
        const HORIZONTAL: f64 = 1e-8;
        let strike = Vec3::Z.cross(n);
        if strike.length() > HORIZONTAL { strike.normalize() } else { Vec3::X.reject_from(n).normalize() }
    };
    [t1, n.cross(t1)]
}
