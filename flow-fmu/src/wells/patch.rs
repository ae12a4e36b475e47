//! The discrete flow around a well: the scheme's own operator on the cells near it, driven by the exact pressure around them.
//!
//! Out of a patch of cells flows, through each facet, what a [`LineSource`] sends there, and nothing where the source itself goes
//! through; what the well injects enters its cells evenly, as in the scheme. That leaves a constant free: it is such that
//! cells far from the source have its pressure on average. The pressures that the well's cells then have are those that the
//! scheme gives them for the exact pressure farther out, on this mesh: so Peaceman found his radius (SPE 6893, 1978).
//!
//! Fluxes and the pressures of cells, for on facets the scheme's pressure is off by a multiple of h² ∂_nn p, of one sign all around a
//! well: with it, the pressure in the well was twice as far off. What is left falls with the square of the patch's reach.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};
use std::sync::Arc;

use linear::{BlockGraph, Cholesky, Method, Ordering, Par, Pattern, Scratch, SparseSymmetric, Symbolic};
use mesh::{Mesh, Vec3};

use super::source::LineSource;
use crate::local::{Facet, transmissivity};
use crate::space::{Space, fracture_measure};

/// How far the patch reaches, in radii of the well's cells, in the metric in which the rock is isotropic. The pressure in the well is
/// off by about a thousandth of that between it and the boundary with 4, a third of it with 6.
const REACH: f64 = 4.0;

/// Cells are far from the source from this part of the largest distance on.
const FAR: f64 = 0.5;

/// The patch has no more cells than so many, the nearest: very flat ones around a short source would go on and on.
const MOST_CELLS: usize = 8000;

/// What the patch is made of: the cells of the rock, or the faces of a fracture.
pub(crate) trait Medium {
    /// A cell and its facets, with a number for each facet that all cells around it know it by.
    fn cell(&self, number: usize) -> Cell;
    /// The corners of a facet (m): two for a segment.
    fn corners(&self, number: usize, facet: usize) -> Vec<Vec3>;
    /// The cells on the other sides of a facet; none on the boundary.
    fn across(&self, number: usize, facet: usize) -> Vec<usize>;
}

/// A cell as the local operator sees it.
pub(crate) struct Cell {
    measure: f64,
    point: Vec3,
    facets: Vec<Facet>,
    traces: Vec<usize>,
}

/// The cells of the rock. Fractures are passed over; nothing flows into cells that are not open.
pub(crate) struct Rock<'a> {
    pub(crate) mesh: &'a Mesh,
    pub(crate) space: &'a Space,
    pub(crate) is_open: &'a dyn Fn(usize) -> bool,
}

impl Medium for Rock<'_> {
    fn cell(&self, number: usize) -> Cell {
        Cell {
            measure: self.mesh.geometry().cell_measure[number],
            point: self.space.cell_point(number),
            facets: self.space.cell_local_facets(number).collect(),
            traces: self.space.cell_facets[self.space.cell_traces.range(number)].iter().map(|f| f.0).collect(),
        }
    }

    fn corners(&self, number: usize, facet: usize) -> Vec<Vec3> {
        let facet = self.space.cell_facets[self.space.cell_traces.range(number)][facet].0;
        self.space.facet_corners(self.mesh, facet)
    }

    fn across(&self, number: usize, facet: usize) -> Vec<usize> {
        let facet = self.space.cell_facets[self.space.cell_traces.range(number)][facet].0;
        let (first, second) = self.mesh.face_cells(self.space.face_of_facet(facet));
        [Some(first), second].into_iter().flatten().filter(|&cell| cell != number && (self.is_open)(cell)).collect()
    }
}

/// The faces of a fracture in 3D, each in its own plane. Other fractures are passed over.
pub(crate) struct FractureFaces<'a> {
    pub(crate) mesh: &'a Mesh,
    pub(crate) space: &'a Space,
}

impl Medium for FractureFaces<'_> {
    fn cell(&self, number: usize) -> Cell {
        Cell {
            measure: fracture_measure(self.mesh, number),
            point: self.space.fracture_point(number),
            facets: self.space.fracture_facets(self.mesh, number),
            traces: self.mesh.network().face_edges.get(number).to_vec(),
        }
    }

    fn corners(&self, number: usize, facet: usize) -> Vec<Vec3> {
        let list = self.mesh.face_vertices(self.mesh.network().faces[number]);
        [list[facet], list[(facet + 1) % list.len()]].map(|v| self.mesh.vertices()[v]).to_vec()
    }

    fn across(&self, number: usize, facet: usize) -> Vec<usize> {
        let network = self.mesh.network();
        let faces = network.edge_faces.get(network.face_edges.get(number)[facet]);
        let same = |&i: &usize| i != number && network.fracture[i] == network.fracture[number];
        faces.iter().copied().filter(same).collect()
    }
}

/// The pressures (Pa for η = 1 Pa s) of the well's `cells` for their `rates`, with the flow of `source` around them.
///
/// # Errors
/// Those of the factorisation.
pub(crate) fn pressures(
    medium: &dyn Medium,
    source: &LineSource,
    cells: &[usize],
    rates: &[f64],
) -> Result<Vec<f64>, linear::Error> {
    let patch = gather(medium, source, cells);
    let mut number = HashMap::new();
    for (_, cell) in &patch {
        for &trace in &cell.traces {
            let next = number.len();
            number.entry(trace).or_insert(next);
        }
    }
    let mut given: Vec<Option<f64>> = vec![None; number.len()];
    let mut load = vec![0.0; number.len()];
    let outside = outside(medium, source, &patch);
    for side in &outside {
        load[number[&side.trace]] -= side.flux;
    }
    // A flux everywhere leaves a constant free; the farthest facet holds the exact pressure until it is known better.
    let farthest = outside.iter().max_by(|a, b| source.distance(a.center).total_cmp(&source.distance(b.center)));
    if let Some(side) = farthest {
        given[number[&side.trace]] = Some(source.pressure(side.center));
    }
    let mut count = 0;
    let unknown: Vec<Option<u32>> = (given.iter())
        .map(|given| {
            given.is_none().then(|| {
                count += 1;
                count - 1
            })
        })
        .collect();
    let places = |cell: &Cell| -> Vec<usize> { cell.traces.iter().map(|trace| number[trace]).collect() };
    let groups: Vec<Vec<u32>> =
        patch.iter().map(|(_, cell)| places(cell).into_iter().filter_map(|t| unknown[t]).collect()).collect();
    let graph = BlockGraph::uniform(count as usize, 1, groups)?;
    let pattern = Arc::new(Pattern::new(&graph, &Ordering::new(&graph, Method::Amd, &[])?)?);
    let symbolic = Arc::new(Symbolic::new(&pattern)?);
    let mut system = SparseSymmetric::zeros(pattern);
    let rate_of = |cell: usize| cells.iter().position(|&c| c == cell).map_or(0.0, |i| rates[i]);
    let mut rows = Vec::new();
    for (cell_number, cell) in &patch {
        let (m, places) = (cell.traces.len(), places(cell));
        let mut t = vec![0.0; m * m];
        transmissivity(cell.measure, cell.point, &cell.facets, source.tensor(), &mut t);
        let row: Vec<f64> = t.chunks_exact(m).map(|row| row.iter().sum()).collect();
        let (sum, rate) = (row.iter().sum::<f64>(), rate_of(*cell_number));
        let free: Vec<usize> = (0..m).filter(|&i| unknown[places[i]].is_some()).collect();
        let entry = |i: usize, j: usize| t[i * m + j] - row[i] * row[j] / sum;
        for &i in &free {
            load[places[i]] += row[i] / sum * rate;
            load[places[i]] -= (0..m).filter_map(|j| Some(entry(i, j) * given[places[j]]?)).sum::<f64>();
        }
        let blocks: Vec<u32> = free.iter().filter_map(|&i| unknown[places[i]]).collect();
        let local: Vec<f64> = free.iter().flat_map(|&i| free.iter().map(move |&j| entry(i, j))).collect();
        system.add(&blocks, &local)?;
        rows.push((places, row, sum, rate));
    }
    let mut x: Vec<f64> = (0..load.len()).filter(|&t| unknown[t].is_some()).map(|t| load[t]).collect();
    Cholesky::new(&symbolic, &system, Par::Seq)?.solve(&mut x, &mut Scratch::default())?;
    let pressure = |place: usize| given[place].unwrap_or_else(|| x[unknown[place].map_or(0, |u| u as usize)]);
    let found: Vec<f64> = (rows.iter())
        .map(|(places, row, sum, rate)| {
            (rate + places.iter().zip(row).map(|(&t, a)| a * pressure(t)).sum::<f64>()) / sum
        })
        .collect();
    // The constant for which cells far from the source have its pressure on average.
    let distance = |cell: &Cell| source.distance(cell.point);
    let far = FAR * patch.iter().map(|(_, cell)| distance(cell)).fold(0.0, f64::max);
    let (mut missing, mut measure) = (0.0, 0.0);
    for ((_, cell), p) in patch.iter().zip(&found).skip(cells.len()).filter(|((_, cell), _)| distance(cell) >= far) {
        missing += cell.measure * (source.pressure(cell.point) - p);
        measure += cell.measure;
    }
    let shift = if measure > 0.0 { missing / measure } else { 0.0 };
    Ok(found[..cells.len()].iter().map(|p| p + shift).collect())
}

/// The cells near the source that are connected to those of the well, these first; at most so many, the nearest.
fn gather(medium: &dyn Medium, source: &LineSource, cells: &[usize]) -> Vec<(usize, Cell)> {
    let distance = |number: usize, facet: usize, center: Vec3| {
        let corners = medium.corners(number, facet).into_iter().chain([center]);
        corners.map(|x| source.distance(x)).fold(f64::INFINITY, f64::min)
    };
    let mut patch: Vec<(usize, Cell)> = cells.iter().map(|&number| (number, medium.cell(number))).collect();
    let mut radius: f64 = 0.0;
    for (number, cell) in &patch {
        for facet in 0..cell.facets.len() {
            let corners = medium.corners(*number, facet);
            radius = corners.iter().fold(radius, |r, x| r.max(source.length(*x - cell.point)));
        }
    }
    // The cells to take next, by their distance, whose bits are in the order of its value.
    let mut next = BinaryHeap::new();
    let mut seen: HashSet<usize> = cells.iter().copied().collect();
    let mut done = 0;
    loop {
        for (number, cell) in &patch[done..] {
            for (k, facet) in cell.facets.iter().enumerate() {
                let distance = distance(*number, k, facet.center);
                if distance <= REACH * radius {
                    next.extend(
                        medium.across(*number, k).into_iter().map(|other| Reverse((distance.to_bits(), other))),
                    );
                }
            }
        }
        done = patch.len();
        while patch.len() == done && done < MOST_CELLS {
            let Some(Reverse((_, number))) = next.pop() else { return patch };
            if seen.insert(number) {
                patch.push((number, medium.cell(number)));
            }
        }
        if patch.len() == done {
            return patch;
        }
    }
}

/// A facet on the outside of a patch.
struct Outside {
    trace: usize,
    center: Vec3,
    /// What flows out through it (m³/s).
    flux: f64,
}

/// The outside of a patch, with the exact flux through it.
fn outside(medium: &dyn Medium, source: &LineSource, patch: &[(usize, Cell)]) -> Vec<Outside> {
    let mut uses: HashMap<usize, usize> = HashMap::new();
    patch.iter().flat_map(|(_, cell)| &cell.traces).for_each(|&trace| *uses.entry(trace).or_default() += 1);
    let mut outside = Vec::new();
    for (number, cell) in patch {
        for (k, facet) in cell.facets.iter().enumerate().filter(|&(k, _)| uses[&cell.traces[k]] == 1) {
            let corners = medium.corners(*number, k);
            let flux = |(x, weight)| source.flux(x, weight * facet.vector);
            let flux = if source.pierces(&corners) { 0.0 } else { rule(&corners).into_iter().map(flux).sum() };
            outside.push(Outside { trace: cell.traces[k], center: facet.center, flux });
        }
    }
    outside
}

/// Points (m) and weights, which sum to 1, of a rule on a segment or a planar polygon with these corners.
fn rule(corners: &[Vec3]) -> Vec<(Vec3, f64)> {
    /// Parts of each segment, and of each edge of a triangle.
    const PARTS: usize = 16;
    let middles = || (0..PARTS).map(|i| (i as f64 + 0.5) / PARTS as f64);
    if let &[a, b] = corners {
        return middles().map(|t| (a.lerp(b, t), 1.0 / PARTS as f64)).collect();
    }
    let mean = corners.iter().sum::<Vec3>() / corners.len() as f64;
    let triangle = |i: usize| (corners[i] - mean, corners[(i + 1) % corners.len()] - mean);
    let whole: Vec3 = (0..corners.len()).map(triangle).map(|(u, v)| u.cross(v)).sum();
    let mut points = Vec::new();
    for (u, v) in (0..corners.len()).map(triangle) {
        let part = u.cross(v).dot(whole) / whole.length_squared();
        // By strips around the mean: the area grows with the distance from it.
        for r in middles() {
            points.extend(middles().map(|t| (mean + r * u.lerp(v, t), 2.0 * r * part / (PARTS * PARTS) as f64)));
        }
    }
    points
}
