//! How far a cell reaches along a direction.
//!
//! The longest chord of a convex body K along e is the least distance, measured along e, of two parallel planes that hold K
//! between them: both say where the ray along e leaves K − K. The planes of that least distance are parallel to a face
//! of K or to two of its edges, for these are the faces of K − K.

use mesh::{Mesh, Vec3};

/// Two parallel planes n·x = low and n·x = high.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slab {
    normal: Vec3,
    low: f64,
    high: f64,
}

impl Slab {
    /// The slab that holds a cell (or its convex hull) and is thinnest along `direction`, in 3D; of several the one most nearly
    /// across it.
    pub(crate) fn around(mesh: &Mesh, cell: usize, direction: Vec3) -> Self {
        /// Thicknesses are the same up to this part of them.
        const SAME: f64 = 1e-9;
        let x: Vec<Vec3> = mesh.cell_vertices(cell).iter().map(|&v| mesh.vertices()[v]).collect();
        let mut normals: Vec<Vec3> = mesh.cell_faces(cell).iter().map(|&f| mesh.geometry().face_normal(f)).collect();
        let edges = edges(mesh, cell);
        for (i, a) in edges.iter().enumerate() {
            normals.extend(edges[..i].iter().map(|b| a.cross(*b)));
        }
        let mut best = Self { normal: direction, low: f64::NEG_INFINITY, high: f64::INFINITY };
        for normal in normals.into_iter().chain([direction]) {
            let normal = normal / normal.dot(direction);
            if !normal.is_finite() {
                continue;
            }
            let (low, high) = (x.iter().map(|x| normal.dot(*x)))
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| (low.min(s), high.max(s)));
            let (width, least) = (high - low, best.high - best.low);
            let is_less_steep = normal.length() < best.normal.length();
            if width < least * (1.0 - SAME) || width <= least * (1.0 + SAME) && is_less_steep {
                best = Self { normal, low, high };
            }
        }
        best
    }

    /// Where the line through `x` along the direction enters and leaves, from `x` (m).
    pub(crate) fn chord(&self, x: Vec3) -> [f64; 2] {
        let s = self.normal.dot(x);
        [self.low - s, self.high - s]
    }
}

/// The edges of a cell as vectors.
fn edges(mesh: &Mesh, cell: usize) -> Vec<Vec3> {
    let mut pairs = Vec::new();
    for &face in mesh.cell_faces(cell) {
        let list = mesh.face_vertices(face);
        for (i, &a) in list.iter().enumerate() {
            let b = list[(i + 1) % list.len()];
            pairs.push((a.min(b), a.max(b)));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs.into_iter().map(|(a, b)| mesh.vertices()[b] - mesh.vertices()[a]).collect()
}

#[cfg(test)]
mod tests {
    use mesh::generate::{cartesian, simplices};

    use super::*;

    fn length(mesh: &Mesh, cell: usize, direction: Vec3) -> f64 {
        let [a, b] = Slab::around(mesh, cell, direction).chord(mesh.geometry().cell_center[cell]);
        b - a
    }

    #[test]
    fn is_the_longest_chord() {
        let cube = Mesh::new(cartesian(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0), [1, 1, 1])).unwrap();
        assert!((length(&cube, 0, Vec3::Z) - 3.0).abs() < 1e-15);
        // Through opposite edges: √(1² + 1²).
        let slanted = Vec3::new(1.0, 1.0, 0.0).normalize();
        assert!((length(&cube, 0, slanted) - 2f64.sqrt()).abs() < 1e-14);
        // Each of Kuhn's tetrahedra has an upright edge, and an edge along the space diagonal.
        let tetrahedra = Mesh::new(simplices(&cube).unwrap()).unwrap();
        for cell in 0..6 {
            // From the bottom of the cube to its top, wherever the line is.
            let [a, b] = Slab::around(&tetrahedra, cell, Vec3::Z).chord(Vec3::new(0.4, 0.7, 1.0));
            assert!((a + 1.0).abs() < 1e-14 && (b - 2.0).abs() < 1e-14);
            let diagonal = Vec3::new(1.0, 2.0, 3.0);
            assert!((length(&tetrahedra, cell, diagonal.normalize()) - diagonal.length()).abs() < 1e-14);
        }
        // A layer of thickness 3 that dips: its height counts, not the difference of its lowest and highest corner.
        let mut dipping = cube.data().clone();
        dipping.map_vertices(|x| x + Vec3::Z * (2.0 * x.x - x.y));
        assert!((length(&Mesh::new(dipping).unwrap(), 0, Vec3::Z) - 3.0).abs() < 1e-14);
    }
}
