//! Unknowns of the hybrid finite volumes with discontinuous pressures at fractures, and what of the mesh they need.
//!
//! | entity | count | meaning |
//! |---|---|---|
//! | cell K | 1, eliminated | p_K, pressure at the centre of mass x_K |
//! | facet of a face that is no fracture | 1 | p_σ, pressure at its centre |
//! | facet of a fracture face | 2 | p_K⁺σ and p_K⁻σ, at its centre on the plus and minus side |
//! | fracture face σ | 1 | p_f,σ, pressure in the fracture at the centre of mass x_f |
//! | fracture edge e | 1 | p_e, at its middle (2D: at the vertex), one for all fracture faces that meet there |
//!
//! (Brenner, Hennicker, Masson, Samier, IMA J. Numer. Anal. 2016; method of the project, section 3.)
//!
//! *Traces* are all but p_K, in this order: facets (on fractures the plus side), minus sides of the facets of
//! fracture faces, fracture faces, fracture edges.
//!
//! Deviation: a face is one facet where it is planar, up to a tolerance ([`FlowModel::planarity`](crate::FlowModel::planarity)).
//! Where it is not, one pressure cannot carry an affine function exactly, and the triangles (edge, mean of the vertices) of
//! which the mesh says it consists become facets.

use std::ops::Range;

use mesh::{Lists, Mesh, Side, Vec3};

use crate::local::{Facet, visibility};

/// Numbering and geometry of the unknowns.
#[derive(Clone, Debug)]
pub struct Space {
    /// First facet of each face, and their number.
    facet_start: Vec<usize>,
    facet_face: Vec<usize>,
    facet_vector: Vec<Vec3>,
    facet_center: Vec<Vec3>,
    /// Facets of the fracture faces, one behind the other; their minus sides stand in the same order.
    minus_start: Vec<usize>,
    fracture_faces: usize,
    fracture_edges: usize,
    /// Traces around each cell.
    pub(crate) cell_traces: Lists,
    /// The facet of each of `cell_traces`, and +1 where its vector points out of the cell.
    pub(crate) cell_facets: Vec<(usize, f64)>,
    /// x_K.
    pub(crate) cell_point: Vec<Vec3>,
    /// x_f of each fracture face.
    pub(crate) fracture_point: Vec<Vec3>,
    /// Middle of each fracture edge.
    pub(crate) edge_center: Vec<Vec3>,
    /// Length of each fracture edge; 1 in 2D.
    pub(crate) edge_length: Vec<f64>,
    unseen: Vec<usize>,
}

impl Space {
    /// The unknowns on a mesh. Faces count as planar up to this [`warp`](Mesh::warp).
    pub fn new(mesh: &Mesh, planarity: f64) -> Self {
        let geometry = mesh.geometry();
        let network = mesh.network();
        let mut space = Self {
            facet_start: vec![0],
            facet_face: Vec::new(),
            facet_vector: Vec::new(),
            facet_center: Vec::new(),
            minus_start: vec![0],
            fracture_faces: network.face_count(),
            fracture_edges: network.edge_count(),
            cell_traces: Lists::new(),
            cell_facets: Vec::new(),
            cell_point: Vec::with_capacity(mesh.cell_count()),
            fracture_point: Vec::with_capacity(network.face_count()),
            edge_center: Vec::with_capacity(network.edge_count()),
            edge_length: Vec::with_capacity(network.edge_count()),
            unseen: Vec::new(),
        };
        for face in 0..mesh.face_count() {
            if mesh.warp(face) <= planarity {
                space.push_facet(face, geometry.face_vector[face], geometry.face_center[face]);
            } else {
                space.push_triangles(mesh, face);
            }
            space.facet_start.push(space.facet_face.len());
        }
        for &face in &network.faces {
            let last = space.minus_start[space.minus_start.len() - 1];
            space.minus_start.push(last + space.facets(face).len());
        }
        let mut facets = Vec::new();
        for cell in 0..mesh.cell_count() {
            let mut traces = Vec::new();
            facets.clear();
            for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
                let side = if sign > 0.0 { Side::Plus } else { Side::Minus };
                traces.extend(match network.number_of_face[face] {
                    Some(fracture_face) => space.side_traces(network.faces[fracture_face], fracture_face, side),
                    None => space.facets(face),
                });
                for facet in space.facets(face) {
                    space.cell_facets.push((facet, sign));
                    facets.push(Facet { vector: sign * space.facet_vector[facet], center: space.facet_center[facet] });
                }
            }
            space.cell_traces.push(traces);
            let x = geometry.cell_center[cell];
            space.cell_point.push(x);
            if visibility(geometry.cell_measure[cell], x, &facets) < 1.0 {
                space.unseen.push(cell);
            }
        }
        for e in 0..network.edge_count() {
            let ends = network.edge_vertices.get(e);
            let (a, b) = (mesh.vertices()[ends[0]], mesh.vertices()[ends[ends.len() - 1]]);
            space.edge_center.push(0.5 * (a + b));
            space.edge_length.push(if ends.len() == 1 { 1.0 } else { a.distance(b) });
        }
        space.fracture_point.extend(network.faces.iter().map(|&face| geometry.face_center[face]));
        space
    }

    fn push_facet(&mut self, face: usize, vector: Vec3, center: Vec3) {
        self.facet_face.push(face);
        self.facet_vector.push(vector);
        self.facet_center.push(center);
    }

    fn push_triangles(&mut self, mesh: &Mesh, face: usize) {
        /// A triangle below this part of its face carries no flux worth an unknown.
        const DEGENERATE: f64 = 1e-12;
        let list = mesh.face_vertices(face);
        let mean = list.iter().map(|&v| mesh.vertices()[v]).sum::<Vec3>() / list.len() as f64;
        for (i, &v) in list.iter().enumerate() {
            let (a, b) = (mesh.vertices()[v], mesh.vertices()[list[(i + 1) % list.len()]]);
            let vector = 0.5 * (a - mean).cross(b - mean);
            if vector.length() > DEGENERATE * mesh.geometry().face_measure[face] {
                self.push_facet(face, vector, (a + b + mean) / 3.0);
            }
        }
    }

    /// Number of facets.
    pub fn facet_count(&self) -> usize {
        self.facet_face.len()
    }

    /// Number of traces: all pressures but those of the cells.
    pub fn trace_count(&self) -> usize {
        self.first_edge() + self.fracture_edges
    }

    /// The facets of a face.
    pub fn facets(&self, face: usize) -> Range<usize> {
        self.facet_start[face]..self.facet_start[face + 1]
    }

    /// The face that a facet belongs to.
    pub fn face_of_facet(&self, facet: usize) -> usize {
        self.facet_face[facet]
    }

    /// Measure of a facet times its normal, out of the first cell of its face.
    pub fn facet_vector(&self, facet: usize) -> Vec3 {
        self.facet_vector[facet]
    }

    /// Centre of a facet.
    pub fn facet_center(&self, facet: usize) -> Vec3 {
        self.facet_center[facet]
    }

    /// Corners of a facet (m): those of its face, or of the triangle (edge, mean of the vertices) that it is.
    pub(crate) fn facet_corners(&self, mesh: &Mesh, facet: usize) -> Vec<Vec3> {
        let face = self.facet_face[facet];
        let corners: Vec<Vec3> = mesh.face_vertices(face).iter().map(|&v| mesh.vertices()[v]).collect();
        if self.facets(face).len() == 1 {
            return corners;
        }
        let mean = corners.iter().sum::<Vec3>() / corners.len() as f64;
        let triangle = |i: usize| vec![corners[i], corners[(i + 1) % corners.len()], mean];
        let off = |t: &Vec<Vec3>| (t.iter().sum::<Vec3>() / 3.0).distance_squared(self.facet_center[facet]);
        let nearest = (0..corners.len()).map(triangle).min_by(|s, t| off(s).total_cmp(&off(t)));
        nearest.unwrap_or(corners)
    }

    /// x_K, where the pressure of a cell is taken: its centre of mass.
    pub fn cell_point(&self, cell: usize) -> Vec3 {
        self.cell_point[cell]
    }

    /// x_f, where the pressure of a fracture face is taken: its centre of mass.
    pub fn fracture_point(&self, fracture_face: usize) -> Vec3 {
        self.fracture_point[fracture_face]
    }

    /// Cells whose x_K does not see all facets. See the bound on distances in the local operator.
    pub fn unseen_cells(&self) -> &[usize] {
        &self.unseen
    }

    /// Traces of the facets of a fracture face on one side.
    pub fn side_traces(&self, face: usize, fracture_face: usize, side: Side) -> Range<usize> {
        match side {
            Side::Plus => self.facets(face),
            Side::Minus => {
                let first = self.facet_count();
                first + self.minus_start[fracture_face]..first + self.minus_start[fracture_face + 1]
            }
        }
    }

    /// Trace p_f of a fracture face.
    pub fn fracture_trace(&self, fracture_face: usize) -> usize {
        self.facet_count() + self.minus_start[self.fracture_faces] + fracture_face
    }

    fn first_edge(&self) -> usize {
        self.fracture_trace(self.fracture_faces)
    }

    /// Trace p_e of a fracture edge.
    pub fn edge_trace(&self, edge: usize) -> usize {
        self.first_edge() + edge
    }

    /// Facets of a cell, outward.
    pub(crate) fn cell_local_facets(&self, cell: usize) -> impl Iterator<Item = Facet> + '_ {
        self.cell_facets[self.cell_traces.range(cell)]
            .iter()
            .map(|&(facet, sign)| Facet { vector: sign * self.facet_vector[facet], center: self.facet_center[facet] })
    }

    /// Edges of a fracture face as facets in its (mean) plane, outward.
    pub(crate) fn fracture_facets(&self, mesh: &Mesh, fracture_face: usize) -> Vec<Facet> {
        let network = mesh.network();
        let face = network.faces[fracture_face];
        let normal = mesh.geometry().face_normal(face);
        let center = mesh.geometry().face_center[face];
        let list = mesh.face_vertices(face);
        let edges = network.face_edges.get(fracture_face);
        (0..list.len())
            .map(|i| {
                let a = mesh.vertices()[list[i]];
                let b = mesh.vertices()[list[(i + 1) % list.len()]];
                // Counter-clockwise around the normal; in 2D the "edge" is the vertex a.
                if mesh.dim() == 2 {
                    Facet { vector: (a - b).normalize(), center: a }
                } else {
                    let middle = self.edge_center[edges[i]];
                    let flat = middle - (middle - center).dot(normal) * normal;
                    Facet { vector: (b - a).cross(normal), center: flat }
                }
            })
            .collect()
    }
}

/// Measure of a fracture face in its (mean) plane.
pub(crate) fn fracture_measure(mesh: &Mesh, fracture_face: usize) -> f64 {
    mesh.geometry().face_vector[mesh.network().faces[fracture_face]].length()
}
