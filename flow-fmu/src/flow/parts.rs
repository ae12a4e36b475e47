//! The connected parts of rock and fractures: in each of them something must fix the pressure.

use mesh::Vec3;

use super::Flow;
use crate::error::Problem;
use crate::scheme::{Coefficients, Scheme};

impl Flow {
    pub(super) fn check_parts(&self, c: &Coefficients) -> Vec<Problem> {
        let mut fixed = self.part_is_fixed.clone();
        let diagonals = c.cell_diagonal.iter().chain(&c.fracture_diagonal);
        for (&part, &diagonal) in self.part.iter().zip(diagonals) {
            fixed[part] |= diagonal > 0.0;
        }
        let cells = c.cell_diagonal.len();
        (fixed.iter().enumerate().filter(|&(_, &fixed)| !fixed))
            .map(|(part, _)| {
                let mesh = &self.scheme.mesh;
                let members: Vec<usize> = (0..self.part.len()).filter(|&k| self.part[k] == part).collect();
                let in_rock = members.iter().filter(|&&k| k < cells).count();
                let place = |k: usize| match k.checked_sub(cells) {
                    None => format!("cell {k} at {} m", shown(mesh.geometry().cell_center[k])),
                    Some(i) => {
                        let name = &mesh.data().fractures[mesh.network().fracture[i]];
                        let center = mesh.geometry().face_center[mesh.network().faces[i]];
                        format!("face {i} on fracture \"{name}\" at {} m", shown(center))
                    }
                };
                let first = members.first().map_or_else(String::new, |&k| place(k));
                Problem::Isolated { cells: in_rock, fracture_faces: members.len() - in_rock, first }
            })
            .collect()
    }
}

/// A place in a message: three digits are enough to find it.
fn shown(x: Vec3) -> String {
    format!("({:.3}, {:.3}, {:.3})", x.x, x.y, x.z)
}

/// Sets of numbers that are joined to each other.
pub(super) struct Sets {
    parent: Vec<usize>,
}

impl Sets {
    /// Each number a set of its own.
    pub(super) fn new(count: usize) -> Self {
        Self { parent: (0..count).collect() }
    }

    /// The least number of a set.
    pub(super) fn root(&mut self, mut i: usize) -> usize {
        while self.parent[i] != i {
            self.parent[i] = self.parent[self.parent[i]];
            i = self.parent[i];
        }
        i
    }

    /// Makes the sets of two numbers one.
    pub(super) fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b)] = a.min(b);
    }
}

/// The connected parts of cells and fracture faces, and which of them touch a given pressure.
pub(super) fn parts(scheme: &Scheme, given: &[bool], normal_permeability: &[f64]) -> (Vec<usize>, Vec<bool>) {
    let (mesh, space) = (&scheme.mesh, &scheme.space);
    let (network, cells) = (mesh.network(), mesh.cell_count());
    let mut sets = Sets::new(cells + network.face_count());
    for face in 0..mesh.face_count() {
        let (first, second) = mesh.face_cells(face);
        if let Some(second) = second {
            match network.number_of_face[face] {
                None => sets.join(first, second),
                Some(i) if normal_permeability[i] > 0.0 => {
                    sets.join(first, cells + i);
                    sets.join(second, cells + i);
                }
                Some(_) => {}
            }
        }
    }
    for faces in network.edge_faces.iter() {
        faces.windows(2).for_each(|pair| sets.join(cells + pair[0], cells + pair[1]));
    }
    let roots: Vec<usize> = (0..cells + network.face_count()).map(|k| sets.root(k)).collect();
    // A root is the lowest of its part, so it comes first.
    let (mut part, mut count) = (vec![0; roots.len()], 0);
    for (k, &r) in roots.iter().enumerate() {
        part[k] = if r == k { count } else { part[r] };
        count += usize::from(r == k);
    }
    let mut fixed = vec![false; count];
    for (cell, traces) in space.cell_traces.iter().enumerate() {
        fixed[part[cell]] |= traces.iter().any(|&t| given[t]);
    }
    for (i, edges) in network.face_edges.iter().enumerate() {
        fixed[part[cells + i]] |= edges.iter().any(|&e| given[space.edge_trace(e)]);
    }
    (part, fixed)
}
