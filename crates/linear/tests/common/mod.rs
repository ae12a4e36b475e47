//! Matrices for the tests.
#![allow(dead_code)]

use std::sync::Arc;

use faer::Mat;
use linear::{BlockGraph, Method, Ordering, Pattern, SparseSymmetric};

/// A small generator of numbers in [-1, 1), the same on every run.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub(crate) fn below(&mut self, bound: usize) -> usize {
        ((self.next() + 1.0) / 2.0 * bound as f64) as usize
    }

    pub(crate) fn vector(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.next()).collect()
    }

    /// The first `m` of a random permutation of `0..n`.
    pub(crate) fn choose(&mut self, n: usize, m: usize) -> Vec<u32> {
        let mut all: Vec<u32> = (0..n as u32).collect();
        for i in 0..m {
            let j = i + self.below(n - i);
            all.swap(i, j);
        }
        all.truncate(m);
        all
    }
}

/// A positive definite cell matrix of `n` unknowns: G Gᵀ + I/2.
pub(crate) fn local(random: &mut Random, n: usize) -> Vec<f64> {
    let g = random.vector(n * n);
    let mut k = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            k[i * n + j] = (0..n).map(|l| g[i * n + l] * g[j * n + l]).sum();
        }
        k[i * n + i] += 0.5;
    }
    k
}

/// The pattern of a graph, in an order that keeps some blocks to the end.
pub(crate) fn pattern(graph: &BlockGraph, method: Method, trailing: &[u32]) -> Arc<Pattern> {
    let ordering = Ordering::new(graph, method, trailing).unwrap();
    Arc::new(Pattern::new(graph, &ordering).unwrap())
}

/// Cells with their matrices, every block with its own diagonal too, so that the sum is positive definite; and the sum.
pub(crate) struct System {
    pub(crate) graph: BlockGraph,
    cells: Vec<(Vec<u32>, Vec<f64>)>,
    pub(crate) dense: Mat<f64>,
}

impl System {
    pub(crate) fn new(sizes: &[usize], cells: &[Vec<u32>], random: &mut Random) -> Self {
        let single = (0..sizes.len() as u32).map(|b| vec![b]);
        let cells: Vec<Vec<u32>> = cells.iter().cloned().chain(single).collect();
        let graph = BlockGraph::with_sizes(sizes, &cells).unwrap();
        let mut dense = Mat::zeros(graph.len(), graph.len());
        let mut with_matrices = Vec::new();
        for cell in cells {
            let unknowns: Vec<usize> = (cell.iter()).flat_map(|&b| graph.unknowns(b as usize)).collect();
            let k = local(random, unknowns.len());
            for (r, &i) in unknowns.iter().enumerate() {
                for (c, &j) in unknowns.iter().enumerate() {
                    dense[(i, j)] += k[r * unknowns.len() + c];
                }
            }
            with_matrices.push((cell, k));
        }
        Self { graph, cells: with_matrices, dense }
    }

    pub(crate) fn on(&self, pattern: &Arc<Pattern>) -> SparseSymmetric {
        let mut sparse = SparseSymmetric::zeros(Arc::clone(pattern));
        self.cells.iter().for_each(|(cell, k)| sparse.add(cell, k).unwrap());
        sparse
    }

    pub(crate) fn sparse(&self, method: Method, trailing: &[u32]) -> SparseSymmetric {
        self.on(&pattern(&self.graph, method, trailing))
    }
}

/// The cells of an nx × ny × nz grid of vertices (nz = 1: quadrilaterals).
pub(crate) fn grid(nx: usize, ny: usize, nz: usize) -> Vec<Vec<u32>> {
    let mut cells = Vec::new();
    for z in 0..(nz - 1).max(1) {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let mut cell = Vec::new();
                for (dx, dy, dz) in (0..8).map(|k| (k & 1, (k >> 1) & 1, k >> 2)) {
                    if z + dz < nz {
                        cell.push((x + dx + nx * (y + dy + ny * (z + dz))) as u32);
                    }
                }
                cells.push(cell);
            }
        }
    }
    cells
}
