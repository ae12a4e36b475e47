//! Corner-point grids.
//!
//! Cells lie in columns between four pillars, straight lines on which each cell has its own upper and lower corners;
//! layers need not meet from column to column (Ponting, *Corner point geometry in reservoir simulation*, ECMOR 1989; Lie,
//! *An Introduction to Reservoir Simulation Using MATLAB/GNU Octave*, 2019, section 3.3.1).
//!
//! Between two pillars the side of a cell is a band: what lies between the lines that join its corners, two above and two
//! below. A face is where the bands of two columns overlap, gaps between cells taken as bands too. It has its corners on
//! the pillars, and where a line of one column crosses one of the other. Lines are told by the ranks of their ends on the
//! pillars, so that which of them cross, and all of the topology, does not depend on round-off. In two dimensions there
//! is one pillar instead of two, and a band is an interval of it.

use rustc_hash::FxHashMap;

use super::{InputError, InputProblem};
use crate::data::FaceTable;
use crate::{MeshData, Vec3};

/// Corners on a pillar that are nearer than this part of the grid's height become one vertex; a cell whose corners all
/// do has no thickness. Files have six digits or so.
const TOLERANCE: f64 = 1e-6;

/// A corner-point grid. Layers count downward, as in the files; heights are positive upward.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CornerPoint {
    /// Number of cells along i, j and k.
    pub cells: [usize; 3],
    /// Two points (m) of each pillar, at different heights unless it is vertical; those along i first.
    pub pillars: Vec<[Vec3; 2]>,
    /// Height (m) of the eight corners of each cell: those along i first, two to a cell, then along j, then along k, the
    /// upper ones before the lower ones (as in the keyword `ZCORN`).
    pub heights: Vec<f64>,
    /// Whether each cell exists; those along i first, then along j, then along k.
    pub active: Vec<bool>,
    /// Fractures.
    pub faults: Vec<Fault>,
}

/// The faces on one side of a block of cells, where there is a cell on both sides.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Name of the fracture.
    pub name: String,
    /// First cell of the block.
    pub first: [usize; 3],
    /// Its last cell.
    pub last: [usize; 3],
    /// The axis, 0 to 2, across which the faces lie.
    pub axis: usize,
    /// Whether they lie on the side of higher numbers.
    pub upper: bool,
}

impl Fault {
    fn holds(&self, cell: [usize; 3]) -> bool {
        (0..3).all(|i| (self.first[i]..=self.last[i]).contains(&cell[i]))
    }
}

/// A line from pillar to pillar, by the vertices at its ends. In two dimensions both are the same.
type Line = [usize; 2];

/// Stand for lines below and above all vertices.
const BELOW: Line = [0; 2];
const ABOVE: Line = [usize::MAX; 2];

/// What lies between two lines: a cell, or a gap.
#[derive(Clone, Copy)]
struct Band {
    cell: Option<usize>,
    low: Line,
    high: Line,
}

impl CornerPoint {
    /// A grid of active cells without faults: `pillar` gives the two points of each pillar by its numbers along i and
    /// j, `height` that of each corner by the numbers of the cell and the side, 0 or 1, of the corner along each axis.
    pub fn new(
        cells: [usize; 3],
        pillar: impl Fn(usize, usize) -> [Vec3; 2],
        height: impl Fn([usize; 3], [usize; 3]) -> f64,
    ) -> Self {
        let [ni, nj, nk] = cells;
        let pillars = (0..=nj).flat_map(|j| (0..=ni).map(move |i| (i, j))).map(|(i, j)| pillar(i, j)).collect();
        let corner = |c: usize| {
            let c = [c % (2 * ni), c / (2 * ni) % (2 * nj), c / (4 * ni * nj)];
            height(c.map(|c| c / 2), c.map(|c| c % 2))
        };
        let heights = (0..8 * ni * nj * nk).map(corner).collect();
        Self { cells, pillars, heights, active: vec![true; ni * nj * nk], faults: Vec::new() }
    }

    /// Makes the mesh, and says for each of its cells which of the grid it is. With `section`, a grid of one row of cells
    /// along j is taken as a mesh in two dimensions, of x and height.
    ///
    /// Boundary tags: `left` and `right` along i, `front` and `back` along j, `bottom` and `top` below the lowest and
    /// above the highest cell of each column. Faces beside gaps and cells that are left out have none. One region,
    /// `rock`. [`Mesh::new`](crate::Mesh::new) may refuse a cell in 3D that is thinner than its upper and lower faces are
    /// twisted.
    ///
    /// # Errors
    /// All that is wrong with lengths, pillars, cells and faults.
    pub fn build(&self, section: bool) -> Result<(MeshData, Vec<usize>), InputError> {
        InputError::check(self.problems(section))?;
        let (vertices, corners) = self.vertices(section);
        InputError::check(self.stacking(&corners))?;
        Ok(Builder::new(self, section, vertices, corners).build())
    }

    fn problems(&self, section: bool) -> Vec<InputProblem> {
        let mut problems = Vec::new();
        let [ni, nj, nk] = self.cells;
        for (what, found, expected) in [
            ("pillars", self.pillars.len(), (ni + 1) * (nj + 1)),
            ("heights", self.heights.len(), 8 * ni * nj * nk),
            ("flags of active cells", self.active.len(), ni * nj * nk),
            ("rows of cells in a section", if section { nj } else { 1 }, 1),
        ] {
            if found != expected {
                problems.push(InputProblem::Count { what, found, expected });
            }
        }
        if !problems.is_empty() {
            return problems;
        }
        for (p, [a, b]) in self.pillars.iter().enumerate() {
            let mut wrong =
                |problem| problems.push(InputProblem::Pillar { pillar: [p % (ni + 1), p / (ni + 1)], problem });
            if !(a.is_finite() && b.is_finite()) {
                wrong("has a coordinate that is not finite");
            } else if a.z == b.z && a.truncate() != b.truncate() {
                wrong("is level: its two points must differ in height");
            } else if section && p <= ni && [a, b].iter().any(|x| x.y != self.pillars[0][0].y) {
                wrong("is not in the plane of the others: a section has one y in its first row of pillars");
            }
        }
        for cell in (0..self.active.len()).filter(|&cell| self.active[cell]) {
            let heights = self.corners(cell).map(|corner| self.heights[corner]);
            let mut wrong = |problem| problems.push(InputProblem::GridCell { cell: self.place(cell), problem });
            if heights.iter().any(|z| !z.is_finite()) {
                wrong("has a height that is not finite");
            } else if section && [0, 1, 4, 5].iter().any(|&c| heights[c] != heights[c + 2]) {
                wrong("has other heights at the back than in front; in a section they are the same");
            }
        }
        for fault in &self.faults {
            if (0..3).any(|i| fault.first[i] > fault.last[i] || fault.last[i] >= self.cells[i]) || fault.axis > 2 {
                problems.push(InputProblem::Fault { name: fault.name.clone(), cells: self.cells });
            }
        }
        problems
    }

    /// Numbers of a cell along i, j and k.
    fn place(&self, cell: usize) -> [usize; 3] {
        let [ni, nj, _] = self.cells;
        [cell % ni, cell / ni % nj, cell / (ni * nj)]
    }

    /// Places in `heights` of the corners of a cell: along i first, then j, then the upper and the lower ones.
    fn corners(&self, cell: usize) -> [usize; 8] {
        let ([ni, nj, _], [i, j, k]) = (self.cells, self.place(cell));
        std::array::from_fn(|c| 2 * i + c % 2 + 2 * ni * (2 * j + c / 2 % 2 + 2 * nj * (2 * k + c / 4)))
    }

    /// The cells of a column, downward.
    fn column(&self, i: usize, j: usize) -> impl Iterator<Item = usize> + Clone {
        let [ni, nj, nk] = self.cells;
        (0..nk).map(move |k| i + ni * (j + nj * k))
    }

    /// All vertices on pillars, upward on each, and for each corner of an active cell its vertex.
    fn vertices(&self, section: bool) -> (Vec<Vec3>, Vec<usize>) {
        let [ni, nj, _] = self.cells;
        let active = || (0..self.active.len()).filter(|&cell| self.active[cell]);
        let all = || active().flat_map(|cell| self.corners(cell)).map(|corner| self.heights[corner]);
        let tolerance = TOLERANCE * (all().fold(f64::MIN, f64::max) - all().fold(f64::MAX, f64::min));
        let (mut vertices, mut vertex_of) = (Vec::new(), vec![usize::MAX; self.heights.len()]);
        let mut own = Vec::new();
        for (p, &[a, b]) in self.pillars.iter().enumerate().take(if section { ni + 1 } else { usize::MAX }) {
            let (pi, pj) = (p % (ni + 1), p / (ni + 1));
            own.clear();
            for side in 0..4 {
                // The pillar has this number in the column.
                let (Some(i), Some(j)) = (pi.checked_sub(side % 2), pj.checked_sub(side / 2)) else { continue };
                if i < ni && j < nj {
                    let cells = self.column(i, j).filter(|&cell| self.active[cell]);
                    own.extend(cells.map(|cell| self.corners(cell)).flat_map(|c| [c[side], c[side + 4]]));
                }
            }
            own.sort_by(|&c, &d| self.heights[c].total_cmp(&self.heights[d]));
            for group in own.chunk_by(|&c, &d| self.heights[d] - self.heights[c] <= tolerance) {
                group.iter().for_each(|&corner| vertex_of[corner] = vertices.len());
                let z = 0.5 * (self.heights[group[0]] + self.heights[group[group.len() - 1]]);
                let t = if a.z == b.z { 0.0 } else { (z - a.z) / (b.z - a.z) };
                vertices.push((a + t * (b - a)).with_z(z));
            }
        }
        if section {
            // In two dimensions there is no back.
            for cell in active() {
                let corners = self.corners(cell);
                [0, 1, 4, 5].into_iter().for_each(|c| vertex_of[corners[c + 2]] = vertex_of[corners[c]]);
            }
        }
        (vertices, vertex_of)
    }

    /// Cells that are upside down, or reach into one above.
    fn stacking(&self, vertex_of: &[usize]) -> Vec<InputProblem> {
        let mut problems = Vec::new();
        let [ni, nj, _] = self.cells;
        for (i, j) in (0..ni * nj).map(|column| (column % ni, column / ni)) {
            let mut lowest = [usize::MAX; 4];
            for cell in self.column(i, j).filter(|&cell| self.active[cell]) {
                let v = self.corners(cell).map(|corner| vertex_of[corner]);
                let mut wrong = |problem| problems.push(InputProblem::GridCell { cell: self.place(cell), problem });
                if (0..4).any(|side| v[side] < v[side + 4]) {
                    wrong("is inverted: a lower corner lies above the upper one");
                } else if (0..4).any(|side| v[side] > lowest[side]) {
                    wrong("reaches into a cell above");
                }
                (0..4).for_each(|side| lowest[side] = lowest[side].min(v[side + 4]));
            }
        }
        problems
    }
}

struct Builder<'a> {
    grid: &'a CornerPoint,
    section: bool,
    vertices: Vec<Vec3>,
    /// Vertex of each corner of the cells that are kept.
    vertex_of: Vec<usize>,
    /// Number in the mesh of each cell of the grid that is kept.
    number: Vec<Option<usize>>,
    /// Vertices where two lines cross, by their lower and their higher line.
    crossings: FxHashMap<[Line; 2], usize>,
    /// Those on each line, with their place on it from 0 to 1.
    on_line: FxHashMap<Line, Vec<(f64, usize)>>,
    faces: FaceTable,
    /// The axis across which each face lies, and the cells of the grid on its lower and its higher side.
    sides: Vec<(usize, [Option<usize>; 2])>,
    /// Boundary faces with their tags.
    tagged: Vec<(usize, &'static str)>,
}

impl<'a> Builder<'a> {
    /// Leaves out cells without thickness, and vertices that no other cell has.
    fn new(grid: &'a CornerPoint, section: bool, vertices: Vec<Vec3>, vertex_of: Vec<usize>) -> Self {
        let mut used = vec![false; vertices.len()];
        let mut count = 0;
        let number = (0..grid.active.len())
            .map(|cell| {
                let v = grid.corners(cell).map(|corner| vertex_of[corner]);
                let kept = grid.active[cell] && (0..4).any(|side| v[side] != v[side + 4]);
                kept.then(|| {
                    (0..4).for_each(|side| (used[v[side]], used[v[side + 4]]) = (true, true));
                    count += 1;
                    count - 1
                })
            })
            .collect();
        let mut kept = Vec::new();
        let new: Vec<usize> = (vertices.into_iter().zip(used))
            .map(|(x, used)| {
                let new = kept.len();
                kept.extend(used.then_some(x));
                new
            })
            .collect();
        let vertex_of = vertex_of.into_iter().map(|v| new.get(v).copied().unwrap_or(v)).collect();
        let (crossings, on_line) = (FxHashMap::default(), FxHashMap::default());
        let faces = FaceTable::default();
        Self {
            grid,
            section,
            vertices: kept,
            vertex_of,
            number,
            crossings,
            on_line,
            faces,
            sides: Vec::new(),
            tagged: Vec::new(),
        }
    }

    fn build(mut self) -> (MeshData, Vec<usize>) {
        let [ni, nj, _] = self.grid.cells;
        for (i, j) in (0..=ni).flat_map(|i| (0..nj).map(move |j| (i, j))) {
            let columns = [(i > 0).then(|| (i - 1, j)), (i < ni).then_some((i, j))];
            self.side_faces(0, columns, [[1, 3], [0, 2]]);
        }
        let rows = if self.section { 0 } else { nj + 1 };
        for (i, j) in (0..ni).flat_map(|i| (0..rows).map(move |j| (i, j))) {
            let columns = [(j > 0).then(|| (i, j - 1)), (j < nj).then_some((i, j))];
            self.side_faces(1, columns, [[2, 3], [0, 1]]);
        }
        self.on_line.values_mut().for_each(|list| list.sort_by(|a, b| a.0.total_cmp(&b.0)));
        for (i, j) in (0..ni).flat_map(|i| (0..nj).map(move |j| (i, j))) {
            self.layer_faces(i, j);
        }
        self.finish()
    }

    /// What is in a column, upward, at two of its pillars.
    fn bands(&self, column: Option<(usize, usize)>, pillars: [usize; 2]) -> Vec<Band> {
        let mut bands = Vec::new();
        let mut low = BELOW;
        for cell in column.iter().flat_map(|&(i, j)| self.kept(i, j).rev()) {
            let corners = self.grid.corners(cell);
            let [upper, lower] = [0, 4].map(|side| pillars.map(|p| self.vertex_of[corners[p + side]]));
            bands.push(Band { cell: None, low, high: lower });
            bands.push(Band { cell: Some(cell), low: lower, high: upper });
            low = upper;
        }
        bands.push(Band { cell: None, low, high: ABOVE });
        bands.retain(|band| band.low != band.high);
        bands
    }

    /// The cells of a column that are kept, downward.
    fn kept(&self, i: usize, j: usize) -> std::vec::IntoIter<usize> {
        self.grid.column(i, j).filter(|&cell| self.number[cell].is_some()).collect::<Vec<_>>().into_iter()
    }

    /// The faces between two columns along an axis; each has these two of its pillars there.
    fn side_faces(&mut self, axis: usize, columns: [Option<(usize, usize)>; 2], pillars: [[usize; 2]; 2]) {
        const TAGS: [[&str; 2]; 2] = [["left", "right"], ["front", "back"]];
        let tag = (0..2).find(|&side| columns[side].is_none()).map(|side| TAGS[axis][side]);
        let second = self.bands(columns[1], pillars[1]);
        for a in self.bands(columns[0], pillars[0]) {
            for b in second.iter().filter(|b| a.cell.or(b.cell).is_some()) {
                if let Some(vertices) = self.overlap(&a, b) {
                    let face = self.face(&vertices, axis, [a.cell, b.cell]);
                    self.tagged.extend(tag.map(|tag| (face, tag)));
                }
            }
        }
    }

    fn face(&mut self, vertices: &[usize], axis: usize, cells: [Option<usize>; 2]) -> usize {
        let face = self.faces.number(vertices);
        debug_assert_eq!(face, self.sides.len(), "each face is made once");
        self.sides.push((axis, cells));
        face
    }

    /// The polygon common to two bands: down the first pillar, along the lower lines, up the second pillar, back along the
    /// upper lines. Both bands are convex; so is this.
    fn overlap(&mut self, a: &Band, b: &Band) -> Option<Vec<usize>> {
        let [first, second] = [0, 1].map(|end| a.low[end].max(b.low[end])..=a.high[end].min(b.high[end]));
        if self.section {
            return (first.start() < first.end()).then(|| vec![*first.start(), *first.end()]);
        }
        let mut polygon: Vec<usize> = first.rev().collect();
        // Where the lower line of one crosses the upper line of the other, the polygon ends in a corner.
        let ends = [[a.low, b.high], [b.low, a.high]];
        polygon
            .extend(ends.into_iter().filter(|[low, high]| low[0] > high[0]).filter_map(|[l, h]| self.crossing(l, h)));
        polygon.extend(self.crossing(a.low, b.low));
        polygon
            .extend(ends.into_iter().filter(|[low, high]| low[0] < high[0]).filter_map(|[l, h]| self.crossing(l, h)));
        polygon.extend(second);
        polygon.extend(self.crossing(a.high, b.high));
        (polygon.len() > 2).then_some(polygon)
    }

    /// The vertex where two lines between the same pillars cross, if they do.
    fn crossing(&mut self, l: Line, m: Line) -> Option<usize> {
        use std::cmp::Ordering::{Greater, Less};
        if !matches!((l[0].cmp(&m[0]), l[1].cmp(&m[1])), (Less, Greater) | (Greater, Less)) {
            return None;
        }
        let [l, m] = if l < m { [l, m] } else { [m, l] };
        if let Some(&vertex) = self.crossings.get(&[l, m]) {
            return Some(vertex);
        }
        // Seen along the horizontal direction across the pillars. Where these are skew, the lines pass each other at a
        // small distance; the middle is taken.
        let [[p, q], [r, s]] = [l, m].map(|line| line.map(|v| self.vertices[v]));
        let across = (q + s - p - r).with_z(0.0);
        let cross = |a: Vec3, b: Vec3| a.dot(across) * b.z - a.z * b.dot(across);
        let det = cross(q - p, s - r);
        let (t, u) = (cross(r - p, s - r) / det, cross(r - p, q - p) / det);
        let vertex = self.vertices.len();
        self.vertices.push(0.5 * (p.lerp(q, t) + r.lerp(s, u)));
        self.crossings.insert([l, m], vertex);
        self.on_line.entry(l).or_default().push((t, vertex));
        self.on_line.entry(m).or_default().push((u, vertex));
        Some(vertex)
    }

    /// The faces below and above the cells of a column.
    fn layer_faces(&mut self, i: usize, j: usize) {
        let mut above = None;
        for cell in self.kept(i, j) {
            let corners = self.grid.corners(cell);
            for lower in [0, 4] {
                let [a, b, c, d] = [0, 1, 3, 2].map(|p| self.vertex_of[corners[p + lower]]);
                let polygon = if self.section {
                    vec![a, b]
                } else {
                    let mut polygon = Vec::new();
                    for (line, forward) in [([a, b], true), ([b, c], true), ([d, c], false), ([a, d], false)] {
                        let between = self.on_line.get(&line).map_or(&[][..], |list| list).iter().map(|point| point.1);
                        polygon.push(line[usize::from(!forward)]);
                        if forward { polygon.extend(between) } else { polygon.extend(between.rev()) }
                    }
                    polygon
                };
                let face = self.faces.number(&polygon);
                if face == self.sides.len() {
                    self.sides.push((2, [None; 2]));
                }
                self.sides[face].1[usize::from(lower == 0)] = Some(cell);
                if lower == 0 && above.is_none() {
                    self.tagged.push((face, "top"));
                }
                above = Some(face);
            }
        }
        self.tagged.extend(above.map(|face| (face, "bottom")));
    }

    fn finish(mut self) -> (MeshData, Vec<usize>) {
        let kept: Vec<usize> = (0..self.number.len()).filter(|&cell| self.number[cell].is_some()).collect();
        let mut cells = vec![Vec::new(); kept.len()];
        for (face, (_, sides)) in self.sides.iter().enumerate() {
            sides.iter().flatten().filter_map(|&cell| self.number[cell]).for_each(|cell| cells[cell].push(face));
        }
        if self.section {
            self.vertices.iter_mut().for_each(|x| *x = Vec3::new(x.x, x.z, 0.0));
        }
        let dim = if self.section { 2 } else { 3 };
        let mut data = MeshData::unnamed(dim, self.vertices, self.faces.lists, cells.into_iter().collect());
        for (face, tag) in self.tagged {
            data.face_tag[face] = Some(data.tag(tag));
        }
        for fault in &self.grid.faults {
            let number = data.fracture(&fault.name);
            for (face, &(axis, sides)) in self.sides.iter().enumerate() {
                if let (true, [Some(lower), Some(higher)]) = (axis == fault.axis, sides)
                    && fault.holds(self.grid.place(if fault.upper { lower } else { higher }))
                {
                    data.face_fracture[face] = Some(number);
                }
            }
        }
        (data, kept)
    }
}
