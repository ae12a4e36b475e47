//! Changes that leave the mesh what it is: motion, units, numbering.

use glam::DQuat;

use crate::{Lists, MeshData, Vec3, random::Random};

/// The new number of each old vertex, face and cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Renumbering {
    /// New number of each vertex.
    pub vertices: Vec<usize>,
    /// New number of each face.
    pub faces: Vec<usize>,
    /// New number of each cell.
    pub cells: Vec<usize>,
}

impl MeshData {
    /// Turns the mesh by `angle` (rad) about `axis` through the origin, then shifts it by `shift` (m). In 2D
    /// the axis must be that of z.
    pub fn move_rigidly(&mut self, axis: Vec3, angle: f64, shift: Vec3) {
        let rotation = DQuat::from_axis_angle(axis.normalize(), angle);
        let dim = self.dim;
        self.map_vertices(|x| {
            let y = rotation * x + shift;
            if dim == 2 { y.with_z(0.0) } else { y }
        });
    }

    /// Multiplies all coordinates by `factor`.
    pub fn scale(&mut self, factor: f64) {
        self.map_vertices(|x| factor * x);
    }

    /// The same mesh with vertices, faces, cells, the vertices within each face (turned and perhaps reversed)
    /// and the faces within each cell in an order drawn from `seed`.
    pub fn renumbered(&self, seed: u64) -> (MeshData, Renumbering) {
        let mut random = Random::new(seed);
        let new = Renumbering {
            vertices: random.permutation(self.vertices.len()),
            faces: random.permutation(self.faces.len()),
            cells: random.permutation(self.cells.len()),
        };
        let [old_vertices, old_faces, old_cells] = [&new.vertices, &new.faces, &new.cells].map(|new| {
            let mut old = vec![0; new.len()];
            new.iter().enumerate().for_each(|(from, &to)| old[to] = from);
            old
        });
        let faces: Lists = (old_faces.iter())
            .map(|&face| {
                let mut list: Vec<usize> = self.faces.get(face).iter().map(|&v| new.vertices[v]).collect();
                let turn = (random.next() % list.len().max(1) as u64) as usize;
                list.rotate_left(turn);
                if random.next().is_multiple_of(2) {
                    list.reverse();
                }
                list
            })
            .collect();
        let cells: Lists = (old_cells.iter())
            .map(|&cell| {
                let list = self.cells.get(cell);
                random.permutation(list.len()).into_iter().map(|i| new.faces[list[i]]).collect::<Vec<_>>()
            })
            .collect();
        let data = MeshData {
            dim: self.dim,
            vertices: old_vertices.iter().map(|&v| self.vertices[v]).collect(),
            faces,
            cells,
            cell_region: old_cells.iter().map(|&c| self.cell_region[c]).collect(),
            regions: self.regions.clone(),
            face_tag: old_faces.iter().map(|&f| self.face_tag[f]).collect(),
            tags: self.tags.clone(),
            face_fracture: old_faces.iter().map(|&f| self.face_fracture[f]).collect(),
            fractures: self.fractures.clone(),
        };
        (data, new)
    }
}
