//! The connected parts of rock and fractures: in each of them something must fix the pressure.

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
                let mut members = (0..self.part.len()).filter(|&k| self.part[k] == part).peekable();
                let first_cell = members.peek().copied().filter(|&k| k < cells);
                let (mut in_rock, mut in_fractures) = (0, 0);
                members.for_each(|k| if k < cells { in_rock += 1 } else { in_fractures += 1 });
                Problem::Isolated { cells: in_rock, first_cell, fracture_faces: in_fractures }
            })
            .collect()
    }
}

/// The connected parts of cells and fracture faces, and which of them touch a given pressure.
pub(super) fn parts(scheme: &Scheme, given: &[bool], normal_permeability: &[f64]) -> (Vec<usize>, Vec<bool>) {
    let (mesh, space) = (&scheme.mesh, &scheme.space);
    let (network, cells) = (mesh.network(), mesh.cell_count());
    let mut parent: Vec<usize> = (0..cells + network.face_count()).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    let mut join = |a: usize, b: usize| {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        parent[a.max(b)] = a.min(b);
    };
    for face in 0..mesh.face_count() {
        let (first, second) = mesh.face_cells(face);
        if let Some(second) = second {
            match network.number_of_face[face] {
                None => join(first, second),
                Some(i) if normal_permeability[i] > 0.0 => {
                    join(first, cells + i);
                    join(second, cells + i);
                }
                Some(_) => {}
            }
        }
    }
    for faces in network.edge_faces.iter() {
        faces.windows(2).for_each(|pair| join(cells + pair[0], cells + pair[1]));
    }
    let roots: Vec<usize> = (0..parent.len()).map(|k| root(&mut parent, k)).collect();
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
