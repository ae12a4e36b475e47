//! Assembly, boundary data, and the one factorisation.
//!
//! In the unknowns ũ of [`Space`] the discrete problem is (Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024,
//! arXiv 2312.09319, section 4)
//!
//! ```text
//! A ũ + |σ| λ_σ (rows of the jumps) = f + Σ_K b |K| p_K div_K − Σ_σ |σ| p_f,σ (normal jump)
//! ```
//!
//! The jumps are eliminated last: the factor of A then holds that of its Schur complement on the fracture.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use linear::{BlockGraph, Cholesky, Csr, DenseSymmetric, Method, Ordering, Pattern, SparseSymmetric, Symbolic};
use mesh::{Mesh, Vec3};
use rayon::prelude::*;

use crate::elasticity::Elasticity;
use crate::error::{MechanicsError, ModelProblem};
use crate::model::{BoundaryFunction, BoundaryPoint, Model, NormalBubbles, Place, Stabilisation};
use crate::space::{CellOperators, CellUnknowns, Space};

/// A prescribed unknown.
pub(crate) struct Fixed {
    pub(crate) unknown: usize,
    pub(crate) point: BoundaryPoint,
    pub(crate) value: BoundaryFunction,
    pub(crate) place: String,
}

/// Elastic constants of a cell (Pa) and its Biot coefficient, which are those of its region.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CellMaterial {
    pub(crate) lambda: f64,
    pub(crate) mu: f64,
    pub(crate) biot: f64,
    pub(crate) bulk_modulus: f64,
    pub(crate) plane_strain_modulus: f64,
}

/// Wall time of the parts of the set-up, and what it made.
#[derive(Clone, Copy, Debug, Default)]
pub struct SetupReport {
    /// Numbering, fill-reducing order and symbolic analysis; beside them, on another thread, the divergence.
    pub analysis: Duration,
    /// Local stiffness matrices and their sum.
    pub assembly: Duration,
    /// Factorisation, its check included.
    pub factorisation: Duration,
    /// The Schur complement on the fracture and its inverse, from the factor.
    pub condensation: Duration,
    /// Free unknowns, jumps included.
    pub unknowns: usize,
    /// Entries in the factor.
    pub factor_entries: usize,
    /// Bytes of the factor, and of the factor with all that goes with it.
    pub factor_bytes: [usize; 2],
}

/// Work done since the mechanics were made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Wall time of orders and symbolic analyses.
    pub analysis: Duration,
    /// Of assembly.
    pub assembly: Duration,
    /// Of factorisations, their checks and the Schur complements included.
    pub factorisation: Duration,
    /// Of triangular solves: both halves.
    pub solving: Duration,
    /// Of Newton's method and linearised problems on the fracture.
    pub newton: Duration,
    /// Triangular solves.
    pub solves: usize,
    /// Factorisations of the bulk.
    pub factorisations: usize,
}

/// A stage of the set-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Numbering, fill-reducing order and symbolic analysis.
    Analysis,
    /// Local matrices and their sum.
    Assembly,
    /// Factorisation, its check included.
    Factorisation,
    /// The Schur complement on the fracture.
    Condensation,
}

/// The assembled operators; vectors over all unknowns are in the numbering of [`Space`].
pub(crate) struct System {
    pub(crate) space: Space,
    /// Of each region.
    pub(crate) materials: Vec<CellMaterial>,
    stabilisation: Stabilisation,
    pub(crate) fixed: Vec<Fixed>,
    /// The unknown of each free one, ascending; the jumps are the last.
    pub(crate) free: Vec<u32>,
    /// div_K: cells × unknowns (1/m).
    pub(crate) divergence: Csr,
    /// Rows of A of the fixed unknowns: fixed × unknowns.
    pub(crate) fixed_rows: Csr,
    pub(crate) cholesky: Cholesky,
    /// Schur complement on the jumps.
    pub(crate) schur: DenseSymmetric,
    /// Its inverse; `None` with springs, where it may be singular.
    pub(crate) inverse: Option<DenseSymmetric>,
    pub(crate) work: Work,
    pub(crate) setup: SetupReport,
    /// Where only fractures hold a piece of the body, the stiffness (N/m) of springs across each jump, which the factor has
    /// and the Schur complement has not: without them there would be no factor.
    springs: Vec<f64>,
}

impl System {
    /// Assembles and factorises; says when each stage has ended.
    pub(crate) fn new(mesh: &Mesh, model: &Model, ended: &mut dyn FnMut(Stage)) -> Result<Self, MechanicsError> {
        let wanted = normal_bubbles(mesh, model);
        let space = Space::with_normal_bubbles(mesh, model.bubbles, |face| wanted[face]);
        let fixed = fixed_unknowns(mesh, model, &space);
        let problems = floating_pieces(mesh, &space, &fixed, true);
        if !problems.is_empty() {
            return Err(MechanicsError::Model(problems));
        }
        let held = floating_pieces(mesh, &space, &fixed, false).is_empty();
        let dim = space.dim();
        let data = mesh.data();
        let materials: Vec<_> = (data.regions.iter())
            .map(|region| {
                let m = &model.materials[region];
                CellMaterial {
                    lambda: m.lambda(),
                    mu: m.mu(),
                    biot: m.biot_coefficient,
                    bulk_modulus: m.bulk_modulus(dim),
                    plane_strain_modulus: m.plane_strain_modulus(),
                }
            })
            .collect();

        let mut clock = Instant::now();
        let mut lap = |stage| {
            let last = std::mem::replace(&mut clock, Instant::now());
            let lap = clock - last;
            ended(stage);
            lap
        };
        let is_fixed = are_fixed(&space, &fixed);
        let free_of = |entity| is_fixed[space.unknowns_of(entity)].iter().filter(|&&fixed| !fixed).count();
        let sizes: Vec<usize> = (0..space.entity_count()).map(free_of).collect();
        let free: Vec<u32> = (0..space.unknown_count() as u32).filter(|&unknown| !is_fixed[unknown as usize]).collect();
        let analyse = || {
            let entities = (0..mesh.cell_count()).map(|cell| space.unknowns(mesh, cell).entities);
            let graph = BlockGraph::with_sizes(&sizes, entities)?;
            let jumps: Vec<u32> = (space.first_jump() as u32..space.entity_count() as u32).collect();
            let method = if dim == 2 { Method::Amd } else { Method::Metis };
            let pattern = Pattern::new(&graph, &Ordering::new(&graph, method, &jumps)?)?;
            drop(graph);
            Symbolic::new(&Arc::new(pattern))
        };
        let stabilisation = model.stabilisation;
        let cells = Cells { mesh, space: &space, materials: &materials, stabilisation, fixed: &is_fixed, extra: &[] };
        // The analysis is sequential and leaves a core idle; it stays on this thread, whose memory the next stages use again.
        let mut divergence = None;
        let symbolic = rayon::in_place_scope(|scope| {
            scope.spawn(|_| divergence = Some(cells.divergence()));
            analyse()
        });
        let (symbolic, divergence) =
            (Arc::new(symbolic?), divergence.transpose()?.unwrap_or_else(|| unreachable!("the scope has ended")));

        let analysis = lap(Stage::Analysis);
        let mut stiffness = SparseSymmetric::zeros(Arc::clone(symbolic.pattern()));
        let fixed_rows = cells.add_stiffness(&fixed, &mut stiffness)?;
        let springs = if held { Vec::new() } else { spring_stiffness(mesh, &materials) };
        add_springs(&space, &springs, &mut stiffness)?;
        let assembly = lap(Stage::Assembly);
        let cholesky = Cholesky::new(&symbolic, &stiffness, faer::get_global_parallelism())?;
        drop(stiffness);
        let factorisation = lap(Stage::Factorisation);
        let (schur, inverse) = schur_without_springs(&cholesky, &springs)?;
        let condensation = lap(Stage::Condensation);
        let memory = cholesky.memory();
        let setup = SetupReport {
            analysis,
            assembly,
            factorisation,
            condensation,
            unknowns: free.len(),
            factor_entries: memory.factor_entries,
            factor_bytes: [memory.factor_bytes, memory.total_bytes],
        };
        Ok(Self {
            setup,
            space,
            materials,
            stabilisation,
            fixed,
            free,
            divergence,
            fixed_rows,
            cholesky,
            schur,
            inverse,
            work: Work {
                analysis,
                assembly,
                factorisation: factorisation + condensation,
                factorisations: 1,
                ..Work::default()
            },
            springs,
        })
    }

    /// y += S x in double precision, over the jumps.
    pub(crate) fn add_schur_product(&self, x: &[f64], y: &mut [f64]) {
        let done = self.cholesky.add_schur_product(x, y);
        debug_assert!(done.is_ok(), "there is a factor, and all jumps are unknowns of it: {done:?}");
        for ((y, x), k) in y.iter_mut().zip(x).zip(&self.springs) {
            *y -= k * x;
        }
    }

    /// Assembles and factorises anew, with S_K b_K² (Pa) added to λ in the consistent part: the rock whose pressure
    /// follows its porosity.
    pub(crate) fn refactorise(&mut self, mesh: &Mesh, extra: &[f64]) -> Result<(), MechanicsError> {
        let clock = Instant::now();
        let mut stiffness = SparseSymmetric::zeros(Arc::clone(self.cholesky.symbolic().pattern()));
        let is_fixed = are_fixed(&self.space, &self.fixed);
        let Self { space, materials, stabilisation, .. } = self;
        let cells = Cells { mesh, space, materials, stabilisation: *stabilisation, fixed: &is_fixed, extra };
        self.fixed_rows = cells.add_stiffness(&self.fixed, &mut stiffness)?;
        add_springs(&self.space, &self.springs, &mut stiffness)?;
        self.work.assembly += clock.elapsed();
        let clock = Instant::now();
        self.cholesky.refactorise(&stiffness)?;
        drop(stiffness);
        (self.schur, self.inverse) = schur_without_springs(&self.cholesky, &self.springs)?;
        self.work.factorisation += clock.elapsed();
        self.work.factorisations += 1;
        Ok(())
    }
}

/// Springs about as stiff as the cells beside the fracture.
fn spring_stiffness(mesh: &Mesh, materials: &[CellMaterial]) -> Vec<f64> {
    let geometry = mesh.geometry();
    (mesh.network().faces.iter())
        .flat_map(|&face| {
            let cell = mesh.face_cells(face).0;
            let CellMaterial { lambda, mu, .. } = materials[mesh.data().cell_region[cell]];
            let k = (lambda + 2.0 * mu) / geometry.cell_diameter[cell] * geometry.face_measure[face];
            std::iter::repeat_n(k, mesh.dim())
        })
        .collect()
}

fn add_springs(space: &Space, springs: &[f64], stiffness: &mut SparseSymmetric) -> Result<(), MechanicsError> {
    let d = space.dim();
    for (i, own) in springs.chunks_exact(d).enumerate() {
        let mut local = vec![0.0; d * d];
        own.iter().enumerate().for_each(|(c, k)| local[c * d + c] = *k);
        stiffness.add(&[(space.first_jump() + i) as u32], &local)?;
    }
    Ok(())
}

fn schur_without_springs(
    cholesky: &Cholesky,
    springs: &[f64],
) -> Result<(DenseSymmetric, Option<DenseSymmetric>), MechanicsError> {
    let (mut schur, inverse) = cholesky.schur()?;
    for (i, k) in springs.iter().enumerate() {
        schur.add_to_diagonal(i, -*k as f32);
    }
    Ok((schur, springs.is_empty().then_some(inverse)))
}

/// What the operators are summed from.
struct Cells<'a> {
    mesh: &'a Mesh,
    space: &'a Space,
    materials: &'a [CellMaterial],
    stabilisation: Stabilisation,
    /// Whether each unknown is.
    fixed: &'a [bool],
    /// Added to λ of each cell in the consistent part (Pa); empty for none.
    extra: &'a [f64],
}

/// What belongs to one cell, in storage for the next.
#[derive(Default)]
struct Local {
    unknowns: CellUnknowns,
    /// Their numbers.
    numbers: Vec<u32>,
    operators: CellOperators,
    /// a_K over its functions.
    functions: Vec<f64>,
}

impl Cells<'_> {
    fn fill_numbers(&self, cell: usize, local: &mut Local) {
        self.space.fill_unknowns(self.mesh, cell, &mut local.unknowns);
        local.numbers.clear();
        for &entity in &local.unknowns.entities {
            let Range { start, end } = self.space.unknowns_of(entity as usize);
            local.numbers.extend(start as u32..end as u32);
        }
    }

    fn fill_stiffness(&self, cell: usize, local: &mut Local) {
        self.space.fill_operators(self.mesh, cell, &mut local.operators);
        let CellMaterial { lambda, mu, .. } = self.materials[self.mesh.data().cell_region[cell]];
        let extra = self.extra.get(cell).copied().unwrap_or(0.0);
        let elasticity = Elasticity { lambda, extra, mu, stabilisation: self.stabilisation };
        elasticity.fill_stiffness(self.space.dim(), &local.operators, &mut local.functions);
    }

    /// Adds the rows and columns of A of free unknowns and gives the rows of fixed ones: fixed × unknowns.
    ///
    /// Each thread computes the cells that its columns need: those between two parts twice, but nothing has to be kept or
    /// copied.
    fn add_stiffness(&self, fixed: &[Fixed], stiffness: &mut SparseSymmetric) -> Result<Csr, linear::Error> {
        let row_of = |unknown: u32| fixed.partition_point(|f| f.unknown < unknown as usize) as u32;
        // Made here, so that the memory of threads does not grow.
        let with_rows = |columns| (columns, Vec::with_capacity(1024));
        let parts: Vec<_> = stiffness.columns(rayon::current_num_threads()).into_iter().map(with_rows).collect();
        let parts = parts.into_par_iter().map(|(mut columns, mut rows)| {
            let (mut local, mut free) = (Local::default(), Vec::new());
            for cell in 0..self.mesh.cell_count() {
                self.fill_numbers(cell, &mut local);
                if !columns.concern(&local.unknowns.entities) {
                    continue;
                }
                self.fill_stiffness(cell, &mut local);
                let Local { unknowns, numbers, functions, .. } = &local;
                let mut matrix = unknowns.reduce_matrix(functions);
                if numbers.iter().any(|&u| self.fixed[u as usize]) {
                    let (fixed, kept): (Vec<usize>, Vec<usize>) =
                        (0..numbers.len()).partition(|&k| self.fixed[numbers[k] as usize]);
                    let row = |i: usize| &matrix[i * numbers.len()..][..numbers.len()];
                    // One thread computes all cells around an entity, in order.
                    let owned = |i: &&usize| columns.concern(&[unknowns.entity_of(self.space.dim(), **i)]);
                    for &i in fixed.iter().filter(owned) {
                        let entries = numbers.iter().zip(row(i));
                        rows.extend(entries.map(|(&column, &v)| (row_of(numbers[i]), column, v)));
                    }
                    free.clear();
                    kept.iter().for_each(|&i| free.extend(kept.iter().map(|&j| row(i)[j])));
                    matrix = Cow::Borrowed(&free);
                }
                columns.add(&unknowns.entities, &matrix)?;
            }
            Ok(rows)
        });
        let rows = parts.collect::<Result<Vec<_>, linear::Error>>()?.concat();
        Csr::from_triplets(fixed.len(), self.fixed.len(), &rows)
    }

    /// div_K: cells × unknowns (1/m).
    fn divergence(&self) -> Result<Csr, linear::Error> {
        let dim = self.space.dim();
        let lengths = (0..self.mesh.cell_count()).map(|cell| self.space.cell_unknown_count(self.mesh, cell));
        Csr::by_rows(
            self.fixed.len(),
            lengths,
            Default::default,
            |scratch: &mut (Local, Vec<Vec3>, Vec<Vec3>), cell, columns, values| {
                let (local, gradients, directions) = scratch;
                self.fill_numbers(cell, local);
                columns.copy_from_slice(&local.numbers);
                self.space.fill_gradients(self.mesh, cell, gradients, directions);
                let (vectors, normals) = gradients.split_at(gradients.len() - directions.len());
                let components = (vectors.iter().flat_map(|g| g.to_array().into_iter().take(dim)))
                    .chain(normals.iter().zip(directions.iter()).map(|(g, n)| g.dot(*n)));
                if local.unknowns.bubbles.is_none() {
                    values.iter_mut().zip(components).for_each(|(value, g)| *value = g);
                } else {
                    values.copy_from_slice(&local.unknowns.reduce_vector(components.collect()));
                }
            },
        )
    }
}

/// Whether each face is to have a normal bubble, apart from what faces may have one.
fn normal_bubbles(mesh: &Mesh, model: &Model) -> Vec<bool> {
    match model.normal_bubbles {
        NormalBubbles::None => vec![false; mesh.face_count()],
        NormalBubbles::All => vec![true; mesh.face_count()],
        NormalBubbles::Auto => {
            let data = mesh.data();
            let mut around = vec![0u32; mesh.vertices().len()];
            mesh.cell_vertex_lists().items().iter().for_each(|&v| around[v] += 1);
            let needs = |cell: usize| {
                let region = &data.regions[data.cell_region[cell]];
                let material = &model.materials[region];
                let diameter = mesh.geometry().cell_diameter[cell];
                let undrained = model.undrained.as_ref().map_or(0.0, |add| add(region, diameter));
                material.lambda() + undrained > NormalBubbles::STIFF * material.mu()
                    && mesh.cell_vertices(cell).iter().any(|&v| around[v] as usize > mesh.dim() + 1)
            };
            let cells: Vec<bool> = (0..mesh.cell_count()).map(needs).collect();
            let face = |face| {
                let (first, second) = mesh.face_cells(face);
                cells[first] || second.is_some_and(|second| cells[second])
            };
            (0..mesh.face_count()).map(face).collect()
        }
    }
}

/// Whether each unknown is prescribed.
fn are_fixed(space: &Space, fixed: &[Fixed]) -> Vec<bool> {
    let mut result = vec![false; space.unknown_count()];
    fixed.iter().for_each(|f| result[f.unknown] = true);
    result
}

/// The prescribed unknowns, ascending.
fn fixed_unknowns(mesh: &Mesh, model: &Model, space: &Space) -> Vec<Fixed> {
    let dim = space.dim();
    let nodes = mesh.nodes();
    let mut by_unknown = std::collections::BTreeMap::new();
    for condition in &model.dirichlet {
        let mut fix = |node: usize, cell: usize| {
            let at = mesh.vertices()[nodes.vertices()[node]];
            let point = BoundaryPoint { at, cell: mesh.geometry().cell_center[cell] };
            let unknown = node * dim + condition.component;
            let (value, place) = (Arc::clone(&condition.value), condition.place.to_string());
            by_unknown.insert(unknown, Fixed { unknown, point, value, place });
        };
        match &condition.place {
            Place::Tag(tag) => {
                for face in mesh.tagged_faces(tag) {
                    let cell = mesh.face_cells(face).0;
                    boundary_nodes(mesh, face).for_each(|node| fix(node, cell));
                }
            }
            Place::Point(p) => {
                let distance = |v: &usize| mesh.vertices()[*v].distance_squared(*p);
                let nearest = (0..mesh.vertices().len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
                for cell in 0..mesh.cell_count() {
                    let place = nearest.and_then(|v| mesh.cell_vertices(cell).binary_search(&v).ok());
                    place.into_iter().for_each(|k| fix(nodes.of_cell(cell)[k], cell));
                }
            }
        }
    }
    by_unknown.into_values().collect()
}

/// The nodes of a boundary face, aligned with its vertices.
pub(crate) fn boundary_nodes(mesh: &Mesh, face: usize) -> impl Iterator<Item = usize> + '_ {
    let cell = mesh.face_cells(face).0;
    let own = mesh.nodes().of_cell(cell);
    mesh.face_vertices(face).iter().filter_map(move |v| mesh.cell_vertices(cell).binary_search(v).ok().map(|k| own[k]))
}

/// The pieces of the body that fixed unknowns leave free to move; those on both sides of a fracture are one, or are not.
fn floating_pieces(mesh: &Mesh, space: &Space, fixed: &[Fixed], across_fractures: bool) -> Vec<ModelProblem> {
    let dim = space.dim();
    let mut piece = vec![None; mesh.cell_count()];
    let mut first_cells = Vec::new();
    let mut sizes = Vec::new();
    for start in 0..mesh.cell_count() {
        if piece[start].is_some() {
            continue;
        }
        let number = first_cells.len();
        first_cells.push(start);
        piece[start] = Some(number);
        let mut queue = vec![start];
        let mut size = 0;
        while let Some(cell) = queue.pop() {
            size += 1;
            for &face in mesh.cell_faces(cell) {
                if !across_fractures && mesh.network().number_of_face[face].is_some() {
                    continue;
                }
                let (a, b) = mesh.face_cells(face);
                for next in [Some(a), b].into_iter().flatten() {
                    if piece[next].is_none() {
                        piece[next] = Some(number);
                        queue.push(next);
                    }
                }
            }
        }
        sizes.push(size);
    }
    let mut piece_of_node = vec![0; space.node_count()];
    for cell in 0..mesh.cell_count() {
        for &node in mesh.nodes().of_cell(cell) {
            piece_of_node[node] = piece[cell].unwrap_or_default();
        }
    }
    let modes = if dim == 2 { 3 } else { 6 };
    // Orthonormal rows of the rigid motions' components that are fixed.
    let mut rows: Vec<Vec<[f64; 6]>> = vec![Vec::new(); first_cells.len()];
    let extent = mesh.vertices().iter().fold(0.0f64, |m, x| m.max(x.distance(mesh.vertices()[0])));
    for f in fixed {
        let (node, c) = (f.unknown / dim, f.unknown % dim);
        let p = piece_of_node[node];
        if rows[p].len() == modes {
            continue;
        }
        let arm = (f.point.at - mesh.geometry().cell_center[first_cells[p]]) / extent;
        let mut row = [0.0; 6];
        row[c] = 1.0;
        let axes: &[Vec3] = if dim == 2 { &[Vec3::Z] } else { &[Vec3::X, Vec3::Y, Vec3::Z] };
        for (k, axis) in axes.iter().enumerate() {
            row[dim + k] = axis.cross(arm)[c];
        }
        for known in &rows[p] {
            let along: f64 = row.iter().zip(known).map(|(a, b)| a * b).sum();
            row.iter_mut().zip(known).for_each(|(a, b)| *a -= along * b);
        }
        let rest = row.iter().map(|x| x * x).sum::<f64>().sqrt();
        // Arms are parts of the body's extent; a lever shorter than this holds nothing.
        if rest > 1e-6 {
            rows[p].push(row.map(|x| x / rest));
        }
    }
    (first_cells.iter().zip(sizes).zip(rows))
        .filter(|(_, rows)| rows.len() < modes)
        .map(|((&cell, cells), rows)| {
            let Vec3 { x, y, z } = mesh.geometry().cell_center[cell];
            ModelProblem::Floating { x, y, z, cells, free: modes - rows.len(), modes }
        })
        .collect()
}
