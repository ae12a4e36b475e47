//! Integrals over cells, by quadrature on their simplices.

use crate::{Mesh, Vec3};

impl Mesh {
    /// Points (m) and weights of a rule of degree 2 on each simplex of a cell (simplex of a face and mean of the vertices);
    /// the weights sum to the cell's measure.
    pub fn quadrature(&self, cell: usize) -> Vec<(Vec3, f64)> {
        let x = |v: usize| self.vertices()[v];
        let mean = |list: &[usize]| list.iter().map(|&v| x(v)).sum::<Vec3>() / list.len() as f64;
        let c = mean(self.cell_vertices(cell));
        let mut points = Vec::new();
        for (&face, &sign) in self.cell_faces(cell).iter().zip(self.cell_face_signs(cell)) {
            let list = self.face_vertices(face);
            if let &[a, b] = list {
                let (a, b) = (x(a), x(b));
                let area = 0.5 * sign * (a - c).cross(b - c).z;
                for p in [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0] {
                    points.push((p, area / 3.0));
                }
            } else {
                let m = mean(list);
                for (i, &a) in list.iter().enumerate() {
                    let corners = [x(a), x(list[(i + 1) % list.len()]), m, c];
                    let volume = sign * (m - c).dot((corners[0] - c).cross(corners[1] - c)) / 6.0;
                    let sum: Vec3 = corners.iter().sum();
                    // Four points, Hammer and Stroud (1956).
                    let near = (5.0 - 5f64.sqrt()) / 20.0;
                    for corner in corners {
                        points.push((near * sum + (1.0 - 4.0 * near) * corner, volume / 4.0));
                    }
                }
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::cartesian;

    #[test]
    fn quadratics_are_integrated_exactly() {
        for n in [[2, 3, 0], [2, 1, 2]] {
            let mesh = Mesh::new(cartesian(Vec3::ZERO, Vec3::ONE, n)).unwrap();
            let sum: f64 = (0..mesh.cell_count())
                .flat_map(|cell| mesh.quadrature(cell))
                .map(|(p, w)| w * (3.0 * p.x * p.x + 4.0 * p.x * p.y))
                .sum();
            assert!((sum - 2.0).abs() < 1e-13, "{sum}");
        }
    }
}
