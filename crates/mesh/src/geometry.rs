//! Measures, centres and weights of faces and cells.
//!
//! A 3D face is split into triangles (edge, mean of the face's vertices), a cell into simplices (simplex
//! of a face, mean of the cell's vertices). A simplex gives its measure in equal parts to its corners, and
//! a mean passes its part on in equal parts to the vertices it is the mean of. The resulting weights
//! integrate affine functions exactly, whether or not faces are planar or cells convex
//! (Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024, arXiv 2312.09319, section 3).

use crate::{Lists, Vec3, data::mean};

/// Measures (m, m², m³ according to dimension), centres and weights of a mesh.
#[derive(Clone, Debug, Default)]
pub struct Geometry {
    /// Length (2D) or area (3D) of each face: the sum over its triangles, where one that is turned over (in a face
    /// that is not convex) counts negative.
    pub face_measure: Vec<f64>,
    /// Integral of the unit normal over each face, out of its first cell; its length is the face's measure
    /// where the face is planar.
    pub face_vector: Vec<Vec3>,
    /// Centre of mass of each face, Σ_s ω_s^σ x_s.
    pub face_center: Vec<Vec3>,
    /// ω_s^σ for each vertex of each face, aligned with the lists of face vertices; sums to 1.
    pub face_weight: Vec<f64>,
    /// Integral of the normal times the hat function of each vertex of each face, aligned likewise: |σ| ω_s^σ n
    /// where the face is planar.
    pub face_vertex_vector: Vec<Vec3>,
    /// Area (2D) or volume (3D) of each cell.
    pub cell_measure: Vec<f64>,
    /// Centre of mass of each cell, Σ_s ω_s^K x_s.
    pub cell_center: Vec<Vec3>,
    /// ω_s^K for each vertex of each cell, aligned with the lists of cell vertices; sums to 1.
    pub cell_weight: Vec<f64>,
    /// Largest distance of two vertices of each cell.
    pub cell_diameter: Vec<f64>,
}

impl Geometry {
    /// Unit normal of a face, out of its first cell (the mean one where the face is not planar).
    pub fn face_normal(&self, face: usize) -> Vec3 {
        self.face_vector[face].normalize()
    }

    pub(crate) fn of_faces(vertices: &[Vec3], faces: &Lists) -> Self {
        let mut g = Self::default();
        for list in faces.iter() {
            let first = g.face_weight.len();
            g.face_weight.resize(first + list.len(), 0.0);
            g.face_vertex_vector.resize(first + list.len(), Vec3::ZERO);
            let weight = &mut g.face_weight[first..];
            let vector = &mut g.face_vertex_vector[first..];
            let total = face_vector(vertices, list);
            let mut measure = 0.0;
            if list.len() == 2 {
                measure = total.length();
                weight.fill(0.5);
                vector.fill(0.5 * total);
            } else {
                let n = list.len();
                let m = mean(vertices, list);
                let triangle = |i: usize| 0.5 * (vertices[list[i]] - m).cross(vertices[list[(i + 1) % n]] - m);
                for i in 0..n {
                    let area = triangle(i);
                    // Where the mean does not see the edge, the triangle counts negative.
                    let size = area.length().copysign(area.dot(total));
                    for end in [i, (i + 1) % n] {
                        weight[end] += size / 3.0;
                        vector[end] += area / 3.0;
                    }
                    measure += size;
                }
                for i in 0..n {
                    weight[i] = (weight[i] + measure / (3 * n) as f64) / measure;
                    vector[i] += total / (3 * n) as f64;
                }
            }
            g.face_center.push(list.iter().zip(weight).map(|(&v, w)| *w * vertices[v]).sum());
            g.face_measure.push(measure);
            g.face_vector.push(total);
        }
        g
    }

    /// The same cells with these faces.
    pub(crate) fn with_faces(self, vertices: &[Vec3], faces: &Lists) -> Self {
        let Self { cell_measure, cell_center, cell_weight, cell_diameter, .. } = self;
        Self { cell_measure, cell_center, cell_weight, cell_diameter, ..Self::of_faces(vertices, faces) }
    }

    /// The cells; `signs` is aligned with `cells`.
    pub(crate) fn of_cells(
        dim: usize,
        vertices: &[Vec3],
        faces: &Lists,
        cells: &Lists,
        signs: &[f64],
        cell_vertices: &Lists,
    ) -> Self {
        let mut g = Self::default();
        for cell in 0..cells.len() {
            let own = cell_vertices.get(cell);
            let first = g.cell_weight.len();
            g.cell_weight.resize(first + own.len(), 0.0);
            let weight = &mut g.cell_weight[first..];
            let slot = |v: usize| {
                own.binary_search(&v).unwrap_or_else(|_| unreachable!("a cell has the vertices of its faces"))
            };
            let c = mean(vertices, own);
            let mut measure = 0.0;
            let corners = (dim + 1) as f64;
            for (&face, &sign) in cells.get(cell).iter().zip(&signs[cells.range(cell)]) {
                let list = faces.get(face);
                if let &[a, b] = list {
                    let t = vertices[b] - vertices[a];
                    let v = 0.5 * sign * Vec3::new(t.y, -t.x, 0.0).dot(vertices[a] - c);
                    measure += v;
                    weight[slot(a)] += v / corners;
                    weight[slot(b)] += v / corners;
                } else {
                    let n = list.len();
                    let m = mean(vertices, list) - c;
                    let mut face_total = 0.0;
                    for i in 0..n {
                        let (a, b) = (list[i], list[(i + 1) % n]);
                        let v = sign * m.dot((vertices[a] - c).cross(vertices[b] - c)) / 6.0;
                        face_total += v;
                        weight[slot(a)] += v / corners;
                        weight[slot(b)] += v / corners;
                    }
                    measure += face_total;
                    for &v in list {
                        weight[slot(v)] += face_total / (corners * n as f64);
                    }
                }
            }
            let rest = measure / (corners * own.len() as f64);
            for w in weight.iter_mut() {
                *w = (*w + rest) / measure;
            }
            g.cell_center.push(own.iter().zip(weight).map(|(&v, w)| *w * vertices[v]).sum());
            g.cell_measure.push(measure);
            g.cell_diameter.push(diameter(vertices, own));
        }
        g
    }
}

/// Integral of the unit normal over a face.
pub(crate) fn face_vector(vertices: &[Vec3], list: &[usize]) -> Vec3 {
    if let &[a, b] = list {
        let t = vertices[b] - vertices[a];
        return Vec3::new(t.y, -t.x, 0.0);
    }
    let m = mean(vertices, list);
    let n = list.len();
    (0..n).map(|i| 0.5 * (vertices[list[i]] - m).cross(vertices[list[(i + 1) % n]] - m)).sum()
}

pub(crate) fn diameter(vertices: &[Vec3], list: &[usize]) -> f64 {
    let mut largest: f64 = 0.0;
    for (i, &a) in list.iter().enumerate() {
        for &b in &list[..i] {
            largest = largest.max(vertices[a].distance_squared(vertices[b]));
        }
    }
    largest.sqrt()
}
