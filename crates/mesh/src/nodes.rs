//! The vertices, split along the fractures.

use crate::Lists;

/// The nodes that carry displacements: one for each vertex and each class of cells around it.
///
/// Two cells around a vertex are in the same class if and only if a chain of cells around it that
/// share non-fracture faces links them. This alone makes one class at a tip, two where a fracture passes
/// through, three at a T and four at an X, in any dimension (Droniou, Enchéry, Faille, Haidar, Masson,
/// CMAME 2024, section 3.1).
#[derive(Clone, Debug)]
pub struct Nodes {
    vertex: Vec<usize>,
    cell_nodes: Lists,
}

impl Nodes {
    /// Numbers the nodes: those of one vertex stand together, vertices ascending.
    pub(crate) fn new(
        vertex_count: usize,
        faces: &Lists,
        cell_vertices: &Lists,
        face_cells: &[(usize, Option<usize>)],
        is_fracture: impl Fn(usize) -> bool,
    ) -> Self {
        // Union-find over pairs (cell, vertex), joined through faces that are no fracture.
        let slot = |cell: usize, v: usize| {
            let k = cell_vertices.get(cell).binary_search(&v);
            cell_vertices.range(cell).start + k.unwrap_or_else(|_| unreachable!("a face's vertex is its cell's"))
        };
        let mut parent: Vec<usize> = (0..cell_vertices.items().len()).collect();
        for (face, &(first, second)) in face_cells.iter().enumerate() {
            if let Some(second) = second
                && !is_fracture(face)
            {
                for &v in faces.get(face) {
                    let (a, b) = (root(&mut parent, slot(first, v)), root(&mut parent, slot(second, v)));
                    parent[a.max(b)] = a.min(b);
                }
            }
        }
        let mut slots_of_vertex = Lists::new();
        let by_vertex = cell_vertices.transpose(vertex_count);
        for v in 0..vertex_count {
            slots_of_vertex.push(by_vertex.get(v).iter().map(|&cell| slot(cell, v)));
        }
        let mut node_of_slot = vec![0; parent.len()];
        let mut vertex = Vec::with_capacity(vertex_count);
        for (v, slots) in slots_of_vertex.iter().enumerate() {
            // A root is the lowest of its class, so it comes first.
            for &s in slots {
                let r = root(&mut parent, s);
                if r == s {
                    node_of_slot[s] = vertex.len();
                    vertex.push(v);
                } else {
                    node_of_slot[s] = node_of_slot[r];
                }
            }
        }
        let cell_nodes =
            (0..cell_vertices.len()).map(|c| node_of_slot[cell_vertices.range(c)].iter().copied()).collect();
        Self { vertex, cell_nodes }
    }

    /// Number of nodes.
    pub fn count(&self) -> usize {
        self.vertex.len()
    }

    /// The vertex of each node.
    pub fn vertices(&self) -> &[usize] {
        &self.vertex
    }

    /// The nodes of a cell, aligned with its vertices.
    pub fn of_cell(&self, cell: usize) -> &[usize] {
        self.cell_nodes.get(cell)
    }

    /// The nodes of all cells, aligned with the lists of their vertices.
    pub fn of_cells(&self) -> &Lists {
        &self.cell_nodes
    }
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}
