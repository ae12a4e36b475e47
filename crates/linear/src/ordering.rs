//! Elimination orders.
//!
//! The graph of blocks is ordered, not that of unknowns: the unknowns of a block have the same
//! neighbours. The order is then *post-ordered*: every subtree of the elimination tree becomes
//! contiguous, which changes no fill but lets the columns of a supernode be neighbours.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

use crate::error::{Error, check_index, index};
use crate::graph::BlockGraph;

/// How to reduce fill.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Nested dissection: the better choice in 3D, where it halves the factor.
    #[default]
    Metis,
    /// Approximate minimum degree: as good in 2D, and quicker to find.
    Amd,
}

/// An elimination order of the blocks, and which of them are kept to the end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ordering {
    /// The block at each place.
    block: Vec<u32>,
    trailing: usize,
}

impl Ordering {
    /// Orders the blocks of a graph.
    ///
    /// The `trailing` blocks come last, in the order of that list; they may be all or none.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] or [`Error::Repeated`] for a wrong trailing block,
    /// [`Error::Ordering`] if nested dissection fails.
    pub fn new(blocks: &BlockGraph, method: Method, trailing: &[u32]) -> Result<Self, Error> {
        let n = blocks.blocks();
        let mut is_trailing = vec![false; n];
        for &block in trailing {
            check_index("trailing block", block as usize, n)?;
            if std::mem::replace(&mut is_trailing[block as usize], true) {
                return Err(Error::Repeated { what: "trailing block", index: block as usize });
            }
        }
        let graph = Graph::new(blocks, &is_trailing)?;
        let order = match method {
            Method::Metis => graph.metis()?,
            Method::Amd => graph.amd()?,
        };
        let empty = |&b: &u32| blocks.unknowns(b as usize).is_empty() && !is_trailing[b as usize];
        let mut block: Vec<u32> = (0..n as u32).filter(empty).collect();
        block.extend(graph.post_order(&order).into_iter().map(|v| graph.block[v as usize]));
        block.extend_from_slice(trailing);
        Ok(Self { block, trailing: trailing.len() })
    }

    /// The block at each place of the order, the trailing blocks last.
    pub fn blocks(&self) -> &[u32] {
        &self.block
    }

    /// Number of trailing blocks.
    pub fn trailing(&self) -> usize {
        self.trailing
    }
}

/// The graph of the blocks that have unknowns and are not trailing; both directions of an edge, no loops.
struct Graph {
    block: Vec<u32>,
    ptr: Vec<i32>,
    adj: Vec<i32>,
}

impl Graph {
    fn new(blocks: &BlockGraph, is_trailing: &[bool]) -> Result<Self, Error> {
        let mut vertex = vec![None; blocks.blocks()];
        let mut block = Vec::new();
        for b in 0..blocks.blocks() {
            if !is_trailing[b] && !blocks.unknowns(b).is_empty() {
                vertex[b] = Some(block.len());
                block.push(b as u32);
            }
        }
        let edges = || {
            (0..blocks.blocks()).flat_map(|b| {
                let vertex = &vertex;
                let others = blocks.neighbours_from(b)[1..].iter();
                others.filter_map(move |&a| Some((vertex[b]?, vertex[a as usize]?)))
            })
        };
        let mut ptr = vec![0usize; block.len() + 1];
        for (v, w) in edges() {
            ptr[v + 1] += 1;
            ptr[w + 1] += 1;
        }
        for v in 0..block.len() {
            ptr[v + 1] += ptr[v];
        }
        index(ptr[block.len()])?;
        let mut adj = vec![0; ptr[block.len()]];
        let mut next = ptr.clone();
        for (v, w) in edges() {
            for (from, to) in [(v, w), (w, v)] {
                adj[next[from]] = to as i32;
                next[from] += 1;
            }
        }
        // Sorted already: the smaller neighbours of v arrive, ascending, before the larger ones.
        let ptr = ptr.into_iter().map(|p| p as i32).collect();
        Ok(Self { block, ptr, adj })
    }

    fn neighbours(&self, v: usize) -> &[i32] {
        &self.adj[self.ptr[v] as usize..self.ptr[v + 1] as usize]
    }

    fn metis(&self) -> Result<Vec<u32>, Error> {
        let n = self.block.len();
        let pattern = feral_metis::CscPattern::new(n, &self.ptr, &self.adj)
            .ok_or_else(|| Error::Ordering("malformed graph".into()))?;
        let order = feral_metis::metis_order(&pattern).map_err(|error| Error::Ordering(format!("{error:?}")))?;
        Ok(order.into_iter().map(|v| v as u32).collect())
    }

    fn amd(&self) -> Result<Vec<u32>, Error> {
        let n = self.block.len();
        let ptr: Vec<u32> = self.ptr.iter().map(|&p| p as u32).collect();
        let adj: Vec<u32> = self.adj.iter().map(|&p| p as u32).collect();
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &ptr, None, &adj);
        let (mut order, mut inverse) = (vec![0u32; n], vec![0u32; n]);
        let scratch = amd::order_scratch::<u32>(n, adj.len());
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| Error::OutOfMemory)?;
        amd::order(&mut order, &mut inverse, pattern, amd::Control::default(), MemStack::new(&mut memory))?;
        Ok(order)
    }

    /// The same elimination with every subtree of the elimination tree contiguous.
    fn post_order(&self, order: &[u32]) -> Vec<u32> {
        let n = order.len();
        let mut position = vec![0; n];
        for (k, &v) in order.iter().enumerate() {
            position[v as usize] = k;
        }
        // Liu's algorithm; `n` is above all roots.
        let mut parent = vec![n; n];
        let mut ancestor = vec![n; n];
        for k in 0..n {
            for &w in self.neighbours(order[k] as usize) {
                let mut i = position[w as usize];
                while i < k {
                    let up = std::mem::replace(&mut ancestor[i], k);
                    if up == n {
                        parent[i] = k;
                    }
                    i = up;
                }
            }
        }
        // A parent comes after its children: number from the last root down, each subtree
        // filling the places just below its root.
        let mut size = vec![1usize; n + 1];
        for k in 0..n {
            size[parent[k]] += size[k];
        }
        let mut free = vec![0; n + 1];
        free[n] = n;
        let mut result = vec![0; n];
        for k in (0..n).rev() {
            let place = free[parent[k]] - 1;
            result[place] = order[k];
            free[parent[k]] -= size[k];
            free[k] = place;
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The elimination tree by eliminating in a full array, and the number of entries.
    fn eliminate(graph: &Graph, order: &[u32]) -> (Vec<Option<usize>>, usize) {
        let n = order.len();
        let mut full = vec![vec![false; n]; n];
        for (i, &v) in order.iter().enumerate() {
            for (j, &w) in order.iter().enumerate() {
                full[i][j] = graph.neighbours(v as usize).contains(&(w as i32));
            }
        }
        let mut entries = 0;
        let mut parents = Vec::new();
        for k in 0..n {
            let below: Vec<usize> = (k + 1..n).filter(|&i| full[i][k]).collect();
            for &i in &below {
                for &j in &below {
                    full[i][j] |= i != j;
                }
            }
            entries += below.len();
            parents.push(below.first().copied());
        }
        (parents, entries)
    }

    #[test]
    fn post_order_makes_subtrees_contiguous_and_keeps_the_fill() {
        // Two grids apart, eliminated in strides.
        let cells = (0..60u32).flat_map(|v| {
            let right = (v % 6 != 5).then_some([v, v + 1]);
            let up = (v % 30 < 24).then_some([v, v + 6]);
            right.into_iter().chain(up)
        });
        let blocks = BlockGraph::uniform(60, 1, cells).unwrap();
        let graph = Graph::new(&blocks, &[false; 60]).unwrap();
        let order: Vec<u32> = (0..60).map(|k| k * 7 % 60).collect();
        let (_, before) = eliminate(&graph, &order);
        let (parents, after) = eliminate(&graph, &graph.post_order(&order));
        assert_eq!(before, after);
        let mut first: Vec<usize> = (0..60).collect();
        let mut size = vec![1; 60];
        for k in 0..60 {
            assert_eq!(k + 1 - first[k], size[k]);
            if let Some(p) = parents[k] {
                first[p] = first[p].min(first[k]);
                size[p] += size[k];
            }
        }
    }
}
