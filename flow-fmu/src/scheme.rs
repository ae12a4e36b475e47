//! The discrete equations of one time step, and their linear system.
//!
//! With ψ_j = p_j − ρ g·(x_j − x_K) in each cell and likewise in each fracture face:
//!
//! ```text
//! cell K:           s_K p_K + Σ_i F_Ki = r_K,                    F_Ki = Σ_j T_ij (p_K − ψ_j)
//! fracture face σ:  s_σ p_f + Σ_e F_σe − q⁺ − q⁻ = r_σ,          F_σe = (d_f³/12η) Σ_e' T_ee' (p_f − ψ_e')
//! side of σ:        q = |σ| T_f (Σ_τ |τ| p_τ / |σ| − p_f − ρ g·(x_σ − x_f)),   F_Kτ = q |τ|/|σ| for its facets τ
//! facet, edge:      Σ F + inflow = 0
//! ```
//!
//! (project's method, section 3; s and r hold storage, sources and wells.) p_K is eliminated: with a_i = Σ_j T_ij, the
//! cell adds T − a aᵀ/(s_K + Σ a) to the system of the traces. It is solved for a correction of given traces, so that
//! round-off scales with pressure differences and not with the depth.

use std::sync::Arc;
use std::time::Instant;

use linear::{BlockGraph, Method, Ordering, Par, Pattern, SparseSymmetric, Symbolic};
use mesh::{Mesh, Side, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::local::{Facet, Tensor, transmissivity};
use crate::report::{FlowWork, timed};
use crate::space::{Space, fracture_measure};

/// Cells that a thread evaluates in one go.
const RUN: usize = 1024;

/// What changes from one time step to the next.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Coefficients {
    /// s_K, with the mobility of wells that hold a pressure.
    pub(crate) cell_diagonal: Vec<f64>,
    /// r_K.
    pub(crate) cell_source: Vec<f64>,
    /// s_σ.
    pub(crate) fracture_diagonal: Vec<f64>,
    /// r_σ.
    pub(crate) fracture_source: Vec<f64>,
    /// d_f³/12η.
    pub(crate) conductivity: Vec<f64>,
    /// |σ| T_f.
    pub(crate) exchange: Vec<f64>,
}

impl Coefficients {
    /// Whether both give the same matrix.
    pub(crate) fn same_matrix(&self, other: &Self) -> bool {
        self.cell_diagonal == other.cell_diagonal
            && self.fracture_diagonal == other.fracture_diagonal
            && self.conductivity == other.conductivity
            && self.exchange == other.exchange
    }
}

/// The equations at given traces.
#[derive(Clone, Debug, Default)]
pub(crate) struct Evaluation {
    pub(crate) matrix_pressure: Vec<f64>,
    /// F_Ki, aligned with the traces of cells.
    pub(crate) cell_flux: Vec<f64>,
    /// F_σe, aligned with the edges of fracture faces.
    pub(crate) edge_flux: Vec<f64>,
    /// q⁺ and q⁻.
    pub(crate) exchange: Vec<[f64; 2]>,
    /// What flows into each trace and not out again.
    pub(crate) residual: Vec<f64>,
    /// Largest product of a pressure with its coefficient in the equations: what round-off is relative to.
    pub(crate) size: f64,
}

/// The operators that never change.
#[derive(Debug)]
pub(crate) struct Scheme {
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) space: Space,
    cell_start: Vec<usize>,
    cell_operator: Vec<f64>,
    /// a_i, aligned with the traces of cells.
    cell_row: Vec<f64>,
    /// Σ a_i, cells.
    cell_sum: Vec<f64>,
    /// ρ g·(x_i − x_K), aligned with the traces of cells.
    pub(crate) cell_weight: Vec<f64>,
    fracture_start: Vec<usize>,
    fracture_operator: Vec<f64>,
    fracture_row: Vec<f64>,
    /// ρ g·(x_e − x_f), aligned with the edges of fracture faces.
    pub(crate) fracture_weight: Vec<f64>,
    /// ρ g·(x_σ − x_f).
    pub(crate) side_weight: Vec<f64>,
    /// Number in the linear system of each trace; none where the pressure is given.
    unknown: Vec<Option<u32>>,
    symbolic: Arc<Symbolic>,
    system: SparseSymmetric,
}

impl Scheme {
    /// `mobility` is K/η of each region, `given` tells the traces with a given pressure. Counts its analysis.
    pub(crate) fn new(
        mesh: Arc<Mesh>,
        space: Space,
        mobility: &[Tensor],
        weight: Vec3,
        given: &[bool],
        work: &mut FlowWork,
    ) -> Result<Self, linear::Error> {
        let geometry = mesh.geometry();
        let mut cell_start = vec![0];
        for traces in space.cell_traces.iter() {
            cell_start.push(cell_start[cell_start.len() - 1] + traces.len() * traces.len());
        }
        let mut cell_operator = vec![0.0; cell_start[cell_start.len() - 1]];
        let mut rest = &mut cell_operator[..];
        let mut blocks = Vec::with_capacity(mesh.cell_count());
        for cell in 0..mesh.cell_count() {
            let (block, tail) = rest.split_at_mut(cell_start[cell + 1] - cell_start[cell]);
            blocks.push(block);
            rest = tail;
        }
        blocks.par_iter_mut().enumerate().with_min_len(64).for_each(|(cell, block)| {
            let facets: Vec<Facet> = space.cell_local_facets(cell).collect();
            let tensor = mobility[mesh.data().cell_region[cell]];
            transmissivity(geometry.cell_measure[cell], space.cell_point[cell], &facets, tensor, block);
        });
        let mut cell_row = Vec::with_capacity(space.cell_facets.len());
        let mut cell_weight = Vec::with_capacity(space.cell_facets.len());
        for cell in 0..mesh.cell_count() {
            let block = &cell_operator[cell_start[cell]..cell_start[cell + 1]];
            cell_row.extend(block.chunks_exact(space.cell_traces.get(cell).len()).map(|row| row.iter().sum::<f64>()));
            cell_weight.extend(space.cell_local_facets(cell).map(|f| weight.dot(f.center - space.cell_point[cell])));
        }
        let cell_sum = space.cell_traces.offsets().windows(2).map(|w| cell_row[w[0]..w[1]].iter().sum()).collect();
        let network = mesh.network();
        let (mut fracture_start, mut fracture_operator) = (vec![0], Vec::new());
        let (mut fracture_row, mut fracture_weight, mut side_weight) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..network.face_count() {
            let facets = space.fracture_facets(&mesh, i);
            let x = space.fracture_point[i];
            let m = facets.len();
            let mut block = vec![0.0; m * m];
            transmissivity(fracture_measure(&mesh, i), x, &facets, Tensor::IDENTITY, &mut block);
            fracture_row.extend(block.chunks_exact(m).map(|row| row.iter().sum::<f64>()));
            fracture_operator.extend(block);
            fracture_start.push(fracture_operator.len());
            let edges = network.face_edges.get(i);
            fracture_weight.extend(edges.iter().map(|&e| weight.dot(space.edge_center[e] - x)));
            let mut center = Vec3::ZERO;
            for facet in space.facets(network.faces[i]) {
                center += share(&space, network.faces[i], facet) * space.facet_center(facet);
            }
            side_weight.push(weight.dot(center - x));
        }
        let mut count = 0;
        let unknown: Vec<Option<u32>> = (given.iter())
            .map(|&given| {
                (!given).then(|| {
                    count += 1;
                    count - 1
                })
            })
            .collect();
        let clock = Instant::now();
        let graph = graph(&mesh, &space, &unknown, count as usize)?;
        // In 2D minimum degree is as good as nested dissection, and quicker to find.
        let method = if mesh.dim() == 2 { Method::Amd } else { Method::Metis };
        let pattern = Arc::new(Pattern::new(&graph, &Ordering::new(&graph, method, &[])?)?);
        drop(graph);
        let symbolic = Arc::new(Symbolic::new(&pattern)?);
        work.analyses += 1;
        work.analysis += clock.elapsed();
        let system = SparseSymmetric::zeros(pattern);
        Ok(Self {
            cell_start,
            cell_operator,
            cell_row,
            cell_sum,
            cell_weight,
            fracture_start,
            fracture_operator,
            fracture_row,
            fracture_weight,
            side_weight,
            unknown,
            symbolic,
            system,
            mesh,
            space,
        })
    }

    /// Number of unknowns of the linear system.
    pub(crate) fn unknowns(&self) -> usize {
        self.system.len()
    }

    pub(crate) fn system(&self) -> &SparseSymmetric {
        &self.system
    }

    /// Assembles and factorises. Counts its work.
    pub(crate) fn factorise(
        &mut self,
        c: &Coefficients,
        factor: Option<linear::Cholesky>,
        work: &mut FlowWork,
    ) -> Result<linear::Cholesky, linear::Error> {
        timed(&mut work.assembly, || self.assemble(c))?;
        work.factorisations += 1;
        timed(&mut work.factorisation, || match factor {
            Some(mut factor) => factor.refactorise(&self.system).map(|()| factor),
            None => linear::Cholesky::new(&self.symbolic, &self.system, Par::rayon(0)),
        })
    }

    pub(crate) fn assemble(&mut self, c: &Coefficients) -> Result<(), linear::Error> {
        let Self { mesh, space, unknown, system, .. } = self;
        let network = mesh.network();
        system.set_zero();
        let mut blocks: Vec<u32> = Vec::new();
        let mut places: Vec<usize> = Vec::new();
        let mut local: Vec<f64> = Vec::new();
        let mut add = |traces: &mut dyn Iterator<Item = usize>, entry: &dyn Fn(usize, usize) -> f64| {
            blocks.clear();
            places.clear();
            for (place, trace) in traces.enumerate() {
                if let Some(number) = unknown[trace] {
                    blocks.push(number);
                    places.push(place);
                }
            }
            local.clear();
            for &i in &places {
                local.extend(places.iter().map(|&j| entry(i, j)));
            }
            system.add(&blocks, &local)
        };
        for cell in 0..mesh.cell_count() {
            let traces = space.cell_traces.get(cell);
            let m = traces.len();
            let t = &self.cell_operator[self.cell_start[cell]..self.cell_start[cell + 1]];
            let a = &self.cell_row[space.cell_traces.range(cell)];
            let pivot = c.cell_diagonal[cell] + self.cell_sum[cell];
            add(&mut traces.iter().copied(), &|i, j| t[i * m + j] - a[i] * a[j] / pivot)?;
        }
        for i in 0..network.face_count() {
            let edges = network.face_edges.get(i);
            let m = edges.len();
            let t = &self.fracture_operator[self.fracture_start[i]..self.fracture_start[i + 1]];
            let a = &self.fracture_row[network.face_edges.range(i)];
            let k = c.conductivity[i];
            let diagonal = c.fracture_diagonal[i] + k * a.iter().sum::<f64>();
            let own = space.fracture_trace(i);
            let mut traces = std::iter::once(own).chain(edges.iter().map(|&e| space.edge_trace(e)));
            add(&mut traces, &|i, j| match (i, j) {
                (0, 0) => diagonal,
                (0, e) | (e, 0) => -k * a[e - 1],
                _ => k * t[(i - 1) * m + j - 1],
            })?;
            let face = network.faces[i];
            let shares: Vec<f64> = space.facets(face).map(|f| share(space, face, f)).collect();
            let of = |k: usize| shares.get(k).map_or(-1.0, |share| *share);
            for side in [Side::Plus, Side::Minus] {
                let mut traces = space.side_traces(face, i, side).chain(std::iter::once(own));
                add(&mut traces, &|j, k| c.exchange[i] * of(j) * of(k))?;
            }
        }
        Ok(())
    }

    /// The equations at `traces`, with `inflow` into each of them from outside.
    pub(crate) fn evaluate(&self, c: &Coefficients, traces: &[f64], inflow: &[f64]) -> Evaluation {
        let Self { mesh, space, .. } = self;
        let network = mesh.network();
        let mut result = Evaluation {
            matrix_pressure: vec![0.0; mesh.cell_count()],
            cell_flux: vec![0.0; space.cell_facets.len()],
            residual: inflow.to_vec(),
            ..Evaluation::default()
        };
        let starts = space.cell_traces.offsets();
        let mut runs = Vec::new();
        let mut rest = &mut result.cell_flux[..];
        for (run, pressures) in result.matrix_pressure.chunks_mut(RUN).enumerate() {
            let first = run * RUN;
            let (own, tail) = rest.split_at_mut(starts[first + pressures.len()] - starts[first]);
            runs.push((first, pressures, own));
            rest = tail;
        }
        let evaluate_run = |(first, pressures, mut fluxes): (usize, &mut [f64], &mut [f64])| {
            let mut size: f64 = 0.0;
            // ψ, then what drives the flux through each trace.
            let mut psi = Vec::new();
            for (cell, pressure) in (first..).zip(pressures) {
                let range = starts[cell]..starts[cell + 1];
                let m = range.len();
                let weights = &self.cell_weight[range.clone()];
                psi.clear();
                psi.extend(space.cell_traces.items()[range.clone()].iter().zip(weights).map(|(&t, w)| traces[t] - w));
                let coefficient = c.cell_diagonal[cell] + self.cell_sum[cell];
                let sum: f64 = self.cell_row[range].iter().zip(&psi).map(|(a, psi)| a * psi).sum();
                *pressure = (c.cell_source[cell] + sum) / coefficient;
                psi.iter_mut().for_each(|psi| *psi = *pressure - *psi);
                let (own, tail) = fluxes.split_at_mut(m);
                let t = &self.cell_operator[self.cell_start[cell]..self.cell_start[cell + 1]];
                for (flux, row) in own.iter_mut().zip(t.chunks_exact(m)) {
                    *flux = row.iter().zip(&psi).map(|(t, drop)| t * drop).sum();
                }
                fluxes = tail;
                size = size.max(coefficient * pressure.abs());
            }
            size
        };
        result.size = runs.into_par_iter().map(evaluate_run).reduce(|| 0.0, f64::max);
        for (&trace, flux) in space.cell_traces.items().iter().zip(&result.cell_flux) {
            result.residual[trace] += flux;
        }
        for i in 0..network.face_count() {
            let own = space.fracture_trace(i);
            let p = traces[own];
            let edges = network.face_edges.get(i);
            let m = edges.len();
            let weight = &self.fracture_weight[network.face_edges.range(i)];
            let t = &self.fracture_operator[self.fracture_start[i]..self.fracture_start[i + 1]];
            result.residual[own] += c.fracture_source[i] - c.fracture_diagonal[i] * p;
            let a: f64 = self.fracture_row[network.face_edges.range(i)].iter().sum();
            let coefficient = c.conductivity[i] * a + c.exchange[i] + c.fracture_diagonal[i];
            result.size = result.size.max(coefficient * p.abs());
            for k in 0..m {
                let drop = |l: usize| p - traces[space.edge_trace(edges[l])] + weight[l];
                let flux = c.conductivity[i] * (0..m).map(|l| t[k * m + l] * drop(l)).sum::<f64>();
                result.edge_flux.push(flux);
                result.residual[own] -= flux;
                result.residual[space.edge_trace(edges[k])] += flux;
            }
            let face = network.faces[i];
            let q = [Side::Plus, Side::Minus].map(|side| {
                let sides = space.facets(face).zip(space.side_traces(face, i, side));
                let mean: f64 = sides.clone().map(|(facet, trace)| share(space, face, facet) * traces[trace]).sum();
                let q = c.exchange[i] * (mean - p - self.side_weight[i]);
                for (facet, trace) in sides {
                    result.residual[trace] -= share(space, face, facet) * q;
                }
                q
            });
            result.residual[own] += q[0] + q[1];
            result.exchange.push(q);
        }
        result
    }

    /// The part of a quantity on traces that belongs to unknowns.
    pub(crate) fn gather(&self, traces: &[f64], unknowns: &mut Vec<f64>) {
        unknowns.clear();
        unknowns.extend(traces.iter().zip(&self.unknown).filter(|(_, u)| u.is_some()).map(|(v, _)| *v));
    }

    /// Adds a correction of the unknowns to the traces.
    pub(crate) fn correct(&self, traces: &mut [f64], unknowns: &[f64]) {
        for (value, number) in traces.iter_mut().zip(&self.unknown) {
            if let Some(number) = *number {
                *value += unknowns[number as usize];
            }
        }
    }

    /// The right-hand side, on traces, for sources in cells and fracture faces.
    pub(crate) fn load(&self, c: &Coefficients, cell_source: &[f64], fracture_source: &[f64]) -> Vec<f64> {
        let mut load = vec![0.0; self.space.trace_count()];
        for (cell, source) in cell_source.iter().enumerate() {
            let a = &self.cell_row[self.space.cell_traces.range(cell)];
            let pivot = c.cell_diagonal[cell] + self.cell_sum[cell];
            for (&trace, a) in self.space.cell_traces.get(cell).iter().zip(a) {
                load[trace] += a / pivot * source;
            }
        }
        for (i, source) in fracture_source.iter().enumerate() {
            load[self.space.fracture_trace(i)] += source;
        }
        load
    }

    /// p_K for traces and sources without gravity.
    pub(crate) fn cell_response(&self, c: &Coefficients, cell_source: &[f64], traces: &[f64]) -> Vec<f64> {
        (0..self.mesh.cell_count())
            .map(|cell| {
                let a = &self.cell_row[self.space.cell_traces.range(cell)];
                let own = self.space.cell_traces.get(cell).iter();
                let sum: f64 = own.zip(a).map(|(&trace, a)| a * traces[trace]).sum();
                (cell_source[cell] + sum) / (c.cell_diagonal[cell] + self.cell_sum[cell])
            })
            .collect()
    }

    /// The facet's part of its face.
    pub(crate) fn share(&self, face: usize, facet: usize) -> f64 {
        share(&self.space, face, facet)
    }
}

fn share(space: &Space, face: usize, facet: usize) -> f64 {
    let facets = space.facets(face);
    if facets.len() == 1 {
        return 1.0;
    }
    space.facet_vector(facet).length() / facets.map(|f| space.facet_vector(f).length()).sum::<f64>()
}

fn graph(mesh: &Mesh, space: &Space, unknown: &[Option<u32>], count: usize) -> Result<BlockGraph, linear::Error> {
    let network = mesh.network();
    let mut groups: Vec<Vec<u32>> = Vec::with_capacity(mesh.cell_count() + 3 * network.face_count());
    let numbers = |traces: &mut dyn Iterator<Item = usize>| traces.filter_map(|t| unknown[t]).collect();
    groups.extend(space.cell_traces.iter().map(|list| numbers(&mut list.iter().copied())));
    for i in 0..network.face_count() {
        let own = space.fracture_trace(i);
        let edges = network.face_edges.get(i).iter().map(|&e| space.edge_trace(e));
        groups.push(numbers(&mut edges.chain([own])));
        for side in [Side::Plus, Side::Minus] {
            groups.push(numbers(&mut space.side_traces(network.faces[i], i, side).chain([own])));
        }
    }
    BlockGraph::uniform(count, 1, groups)
}
