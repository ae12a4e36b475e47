//! Triangles that conform to any set of lines.
//!
//! 1. The lines are cut where they meet one another and the boundary ([`Arrangement`]).
//! 2. Every piece is split into edges of equal length relative to the size that is wanted there. These edges
//!    are final: where one size is asked for, they have it but for rounding their number.
//! 3. Points are laid out from there in layers, each proposing six more at the wanted distance around it,
//!    which are taken where no other point or edge is too close.
//! 4. Constrained Delaunay triangulation (crate `spade`); points are added in triangles that are too large.
//! 5. Free points are moved to where their neighbours want them, with a triangulation after each round.

use std::f64::consts::FRAC_PI_3;

use glam::DVec2;
use rustc_hash::{FxHashMap, FxHashSet};
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation as _};

use super::arrangement::{Arrangement, contains, nearest};
use super::size::SizeField;
use super::{InputError, InputProblem};
use crate::{MeshData, Vec3};

/// Points closer than this part of the domain's diameter are one: far above the round-off of crossing points
/// and far below any face.
const SNAP: f64 = 1e-9;
/// Two points must keep this part of the mean of their sizes.
const SPACING: f64 = 0.75;
/// A point must keep this part of the length of an edge of the outline from that edge.
const CLEARANCE: f64 = 0.45;
/// A triangle is too large where its circumradius exceeds this part of the size; 0.58 would be equilateral.
const TOO_LARGE: f64 = 0.85;
/// Rounds of triangulation, and of movement in each.
const ROUNDS: usize = 6;
const MOVES: usize = 3;
/// No mesh that one machine can use has more, inside and on lines.
const MAX_VERTICES: usize = 20_000_000;
const MAX_ON_LINES: usize = 1_000_000;
/// Largest coordinate (m): products of two fit.
const MAX_COORDINATE: f64 = 1e60;

/// A line that the triangles conform to.
struct Line {
    name: String,
    points: Vec<DVec2>,
    /// Wanted edge length (m).
    size: Option<f64>,
    is_fracture: bool,
}

impl Line {
    fn title(&self) -> String {
        if self.is_fracture { format!("fracture \"{}\"", self.name) } else { format!("line \"{}\"", self.name) }
    }
}

/// Makes a mesh of triangles that conforms to fractures and other lines.
///
/// Lines may cross, meet in T, L and X, touch, branch, and end on the boundary. Points closer to one another
/// than 10⁻⁹ of the domain's diameter are taken as one, and ends of lines that close to another line as lying
/// on it ([`snap`](Self::snap) changes it).
///
/// The size (edge length) at x is the least of that far away, the size function, and the sizes of all lines,
/// each grown by `growth` times the distance to the line. Edges on lines have this size, rounded so that a
/// whole number fits between two points where lines bend or meet.
///
/// ```
/// use mesh::{Mesh, generate::Triangles};
/// let data = Triangles::rectangle([0.0, 0.0], [2.0, 1.0], 0.2)
///     .fracture("a", &[[0.5, 0.5], [1.5, 0.5]], 0.05)
///     .fracture("b", &[[1.0, 0.2], [1.0, 0.5]], 0.05) // a T
///     .growth(0.2)
///     .build()?;
/// let mesh = Mesh::new(data)?;
/// assert_eq!(mesh.network().face_count(), 26);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Triangles<'a> {
    corners: Vec<DVec2>,
    tags: Vec<String>,
    lines: Vec<Line>,
    far: f64,
    growth: f64,
    snap: Option<f64>,
    size: Option<SizeFunction<'a>>,
}

type SizeFunction<'a> = Box<dyn Fn(Vec3) -> f64 + 'a>;

impl<'a> Triangles<'a> {
    /// The rectangle from `low` to `high` (m), tagged `left`, `right`, `bottom` and `top`, with triangles of
    /// size `far` (m) away from lines.
    pub fn rectangle(low: [f64; 2], high: [f64; 2], far: f64) -> Self {
        let corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
        Self::polygon(&corners, &["bottom", "right", "top", "left"], far)
    }

    /// A polygon with `corners` (m) in order, either sense. Its edge from corner i to the next carries the
    /// boundary tag `tags[i]`; edges beyond the end of `tags` carry none.
    pub fn polygon(corners: &[[f64; 2]], tags: &[&str], far: f64) -> Self {
        Self {
            corners: corners.iter().copied().map(DVec2::from).collect(),
            tags: tags.iter().map(|&t| t.to_owned()).collect(),
            lines: Vec::new(),
            far,
            growth: 0.2,
            snap: None,
            size: None,
        }
    }

    /// Adds a fracture along a polyline (m) whose faces have length `size` (m).
    pub fn fracture(mut self, name: &str, points: &[[f64; 2]], size: f64) -> Self {
        let points = points.iter().copied().map(DVec2::from).collect();
        self.lines.push(Line { name: name.into(), points, size: Some(size), is_fracture: true });
        self
    }

    /// Adds a polyline (m) that faces follow without being fracture faces, as between two regions. The name
    /// is for messages. Without a `size` (m) the edges have that of the surroundings.
    pub fn interface(mut self, name: &str, points: &[[f64; 2]], size: Option<f64>) -> Self {
        let points = points.iter().copied().map(DVec2::from).collect();
        self.lines.push(Line { name: name.into(), points, size, is_fracture: false });
        self
    }

    /// How fast sizes grow with the distance from lines: metres per metre, 0.2 unless told, at most 1.
    pub fn growth(mut self, growth: f64) -> Self {
        self.growth = growth;
        self
    }

    /// Limits the size (m) to `size(x)`, also on lines. It should vary slowly: by at most half the distance.
    pub fn size(mut self, size: impl Fn(Vec3) -> f64 + 'a) -> Self {
        self.size = Some(Box::new(size));
        self
    }

    /// Points closer than this (m) are one.
    pub fn snap(mut self, distance: f64) -> Self {
        self.snap = Some(distance);
        self
    }

    /// Makes the mesh: one region `rock`, the boundary tags, the fractures by name.
    ///
    /// # Errors
    /// All problems of the input: sizes, names, coordinates, lines without length, outside of the domain or
    /// overlapping.
    pub fn build(&self) -> Result<MeshData, InputError> {
        let tolerance = self.check()?;
        let outline = self.outline(tolerance)?;
        let limit = |x: DVec2| self.size.as_ref().map_or(f64::INFINITY, |size| size(x.extend(0.0)));
        let mut cloud = Cloud::of(&outline, &self.corners, self.growth, self.far, &limit)?;
        cloud.fill()?;
        let constraints: Vec<[usize; 2]> = outline.edges.iter().map(|e| e.ends).collect();
        let is_boundary: FxHashSet<[usize; 2]> =
            outline.edges.iter().filter(|e| e.owner < self.corners.len()).map(|e| sorted(e.ends)).collect();
        let mut triangles = cloud.triangulate(&constraints, &is_boundary);
        for round in 0..ROUNDS {
            if round < 2 && cloud.refine(&triangles)? {
                triangles = cloud.triangulate(&constraints, &is_boundary);
            }
            cloud.smooth(&triangles);
            triangles = cloud.triangulate(&constraints, &is_boundary);
        }
        // Cells with vertices in common are near each other in memory too.
        triangles.sort_unstable_by_key(|t| {
            let mut key = *t;
            key.sort_unstable();
            key
        });
        Ok(self.name(&cloud.points, &triangles, &outline))
    }

    /// Names of boundary tags and fractures.
    fn name(&self, points: &[DVec2], triangles: &[[usize; 3]], outline: &Outline) -> MeshData {
        let mut data = MeshData::from_polygons(points.iter().map(|p| p.extend(0.0)).collect(), triangles);
        let owner: FxHashMap<[usize; 2], usize> = outline.edges.iter().map(|e| (sorted(e.ends), e.owner)).collect();
        let tags: Vec<Option<usize>> =
            (0..self.corners.len()).map(|i| self.tags.get(i).map(|tag| data.tag(tag))).collect();
        let fractures: Vec<Option<usize>> =
            self.lines.iter().map(|line| line.is_fracture.then(|| data.fracture(&line.name))).collect();
        for face in 0..data.faces.len() {
            let list = data.faces.get(face);
            if let Some(&owner) = owner.get(&sorted([list[0], list[1]])) {
                if owner < self.corners.len() {
                    data.face_tag[face] = tags[owner];
                } else {
                    data.face_fracture[face] = fractures[owner - self.corners.len()];
                }
            }
        }
        data
    }

    /// Checks all that needs no geometry; gives the snapping distance.
    fn check(&self) -> Result<f64, InputError> {
        let mut problems = Vec::new();
        let mut positive = |what: String, value: f64| {
            if !(value.is_finite() && value > 0.0) {
                problems.push(InputProblem::NotPositive { what, value });
            }
        };
        positive("the size far away".into(), self.far);
        positive("the growth".into(), self.growth);
        self.snap.into_iter().for_each(|snap| positive("the snapping distance".into(), snap));
        for line in &self.lines {
            line.size.into_iter().for_each(|size| positive(format!("the size of {}", line.title()), size));
        }
        let mut names = FxHashSet::default();
        for line in self.lines.iter().filter(|line| line.is_fracture) {
            if line.name.is_empty() || !names.insert(&line.name) {
                problems.push(InputProblem::Name { name: line.name.clone() });
            }
        }
        let domain = [("the domain".to_owned(), &self.corners, 3)];
        let lists = self.lines.iter().map(|line| (line.title(), &line.points, 2));
        for (what, points, least) in domain.into_iter().chain(lists) {
            if points.len() < least {
                problems.push(InputProblem::TooFewPoints { what: what.clone(), count: points.len(), least });
            }
            for (index, p) in points.iter().enumerate() {
                if !(p.abs().max_element() < MAX_COORDINATE && p.is_finite()) {
                    problems.push(InputProblem::Coordinate { what: what.clone(), index, x: p.x, y: p.y });
                }
            }
        }
        InputError::check(problems)?;
        let low = self.corners.iter().fold(DVec2::INFINITY, |m, &p| m.min(p));
        let high = self.corners.iter().fold(DVec2::NEG_INFINITY, |m, &p| m.max(p));
        Ok(self.snap.unwrap_or((high - low).length() * SNAP).max(f64::MIN_POSITIVE))
    }

    /// Boundary and lines, cut and split into edges.
    fn outline(&self, tolerance: f64) -> Result<Outline, InputError> {
        let mut problems = Vec::new();
        // Segments with their owner: an edge of the domain, or behind those, a line.
        let n = self.corners.len();
        let mut segments: Vec<([DVec2; 2], usize)> =
            (0..n).map(|i| ([self.corners[i], self.corners[(i + 1) % n]], i)).collect();
        for (k, line) in self.lines.iter().enumerate() {
            segments.extend(line.points.windows(2).map(|pair| ([pair[0], pair[1]], n + k)));
        }
        let title = |owner: usize| {
            owner.checked_sub(n).map_or("the boundary of the domain".into(), |line| self.lines[line].title())
        };
        let mut index = 0;
        for (i, ([a, b], owner)) in segments.iter().enumerate() {
            index = if *owner < n || (i > 0 && segments[i - 1].1 == *owner) { index + 1 } else { 0 };
            if a.distance(*b) <= tolerance {
                let index = if *owner < n { *owner } else { index };
                problems.push(InputProblem::ZeroLength { what: title(*owner), index, x: a.x, y: a.y });
            }
        }
        InputError::check(std::mem::take(&mut problems))?;

        let inside = |p: DVec2| {
            contains(&self.corners, p)
                || segments[..n].iter().any(|([a, b], _)| nearest(*a, *b, p).distance(p) <= tolerance)
        };
        for (k, line) in self.lines.iter().enumerate() {
            for &p in line.points.iter().filter(|&&p| !inside(p)) {
                problems.push(InputProblem::Outside { what: title(n + k), x: p.x, y: p.y });
            }
        }
        let arrangement = Arrangement::new(&segments.iter().map(|s| s.0).collect::<Vec<_>>(), tolerance);
        let points = arrangement.points;
        let mut of_pair: FxHashMap<[usize; 2], usize> = FxHashMap::default();
        let mut pieces: Vec<([usize; 2], usize)> = Vec::new();
        let mut edges_at = vec![0; points.len()];
        for ((ends, owner), along) in segments.iter().zip(&arrangement.along) {
            for pair in along.windows(2) {
                let pair = [pair[0], pair[1]];
                let [from, to] = pair.map(|k| points[k]);
                if let Some(other) = of_pair.insert(sorted(pair), *owner) {
                    let (first, second) = (title(other), title(*owner));
                    problems.push(InputProblem::Overlap { first, second, from: from.into(), to: to.into() });
                }
                let middle = 0.5 * (from + to);
                if *owner < n {
                    pair.iter().for_each(|&k| edges_at[k] += 1);
                } else if !inside(middle) && ends.iter().all(|&p| inside(p)) {
                    problems.push(InputProblem::Outside { what: title(*owner), x: middle.x, y: middle.y });
                }
                pieces.push((pair, *owner));
            }
        }
        for (p, _) in points.iter().zip(edges_at).filter(|&(_, count)| count > 2) {
            problems.push(InputProblem::DomainCrosses { x: p.x, y: p.y });
        }
        InputError::check(problems)?;
        self.split(points, &pieces)
    }

    /// Splits the pieces into edges. Along a piece the edges have equal lengths relative to the wanted size.
    fn split(&self, mut points: Vec<DVec2>, pieces: &[([usize; 2], usize)]) -> Result<Outline, InputError> {
        let sources: Vec<(DVec2, DVec2, f64)> = (pieces.iter())
            .filter_map(|&([a, b], owner)| {
                let line = self.lines.get(owner.checked_sub(self.corners.len())?)?;
                Some((points[a], points[b], line.size?))
            })
            .collect();
        let size = |x: DVec2| -> Result<f64, InputError> {
            let lines = (sources.iter())
                .map(|&(a, b, size)| size + self.growth.min(1.0) * nearest(a, b, x).distance(x))
                .fold(self.far, f64::min);
            Ok(match &self.size {
                None => lines,
                Some(limit) => lines.min(checked(limit(x.extend(0.0)), x)?),
            })
        };
        let mut edges = Vec::new();
        for &([first, last], owner) in pieces {
            let (a, b) = (points[first], points[last]);
            let length = a.distance(b);
            // Number of edges up to each of some points along the piece: the integral of 1/size.
            let mut table = vec![(0.0, 0.0)];
            let (mut at, mut here) = (0.0, size(a)?);
            while at < length {
                let next = if length - at < 0.15 * here { length } else { at + 0.1 * here };
                let there = size(a.lerp(b, next / length))?;
                let count = table[table.len() - 1].1 + (next - at) * 0.5 * (1.0 / here + 1.0 / there);
                table.push((next, count));
                if count > MAX_ON_LINES as f64 || next <= at {
                    return Err(InputProblem::TooFine { limit: MAX_ON_LINES }.into());
                }
                (at, here) = (next, there);
            }
            let total = table[table.len() - 1].1;
            let n = total.round().max(1.0) as usize;
            let uniform = table[1..].windows(2).all(|w| {
                let (ds, dn) = (w[1].0 - w[0].0, w[1].1 - w[0].1);
                (dn * length - ds * total).abs() < 1e-9 * length * dn
            });
            let mut previous = first;
            let mut row = 0;
            for i in 1..n {
                let s = if uniform {
                    i as f64 / n as f64
                } else {
                    let wanted = total * i as f64 / n as f64;
                    while table[row + 1].1 < wanted {
                        row += 1;
                    }
                    let ((s0, n0), (s1, n1)) = (table[row], table[row + 1]);
                    (s0 + (s1 - s0) * (wanted - n0) / (n1 - n0)) / length
                };
                points.push(a.lerp(b, s));
                edges.push(Edge { ends: [previous, points.len() - 1], owner });
                previous = points.len() - 1;
            }
            edges.push(Edge { ends: [previous, last], owner });
            if points.len() > MAX_ON_LINES {
                return Err(InputProblem::TooFine { limit: MAX_ON_LINES }.into());
            }
        }
        Ok(Outline { points, edges })
    }
}

/// A value of the size function, refused where it is no size.
fn checked(value: f64, x: DVec2) -> Result<f64, InputError> {
    if value > 0.0 {
        Ok(value)
    } else {
        Err(InputProblem::NotPositive { what: format!("the size function at ({}, {})", x.x, x.y), value }.into())
    }
}

fn sorted([a, b]: [usize; 2]) -> [usize; 2] {
    [a.min(b), a.max(b)]
}

/// An edge that the triangles must have.
struct Edge {
    ends: [usize; 2],
    /// An edge of the domain, or behind those, a line.
    owner: usize,
}

/// The edges that the triangles must have.
struct Outline {
    points: Vec<DVec2>,
    edges: Vec<Edge>,
}

/// The points of the mesh, of which the first are those of the outline and do not move.
struct Cloud<'a> {
    points: Vec<DVec2>,
    /// Wanted size at each point, and the point of the field that sets it.
    sizes: Vec<(f64, usize)>,
    fixed: usize,
    polygon: &'a [DVec2],
    /// Direction of an edge of the outline at each of its points.
    heading: Vec<f64>,
    field: SizeField,
    limit: &'a dyn Fn(DVec2) -> f64,
    /// Points by their place on a grid whose spacing is the power of two below their size.
    grid: FxHashMap<(i32, i64, i64), Vec<usize>>,
    /// Edges of the outline where points may come too close to them, on a grid by their length.
    edges: FxHashMap<(i32, i64, i64), Vec<[DVec2; 2]>>,
    levels: Vec<i32>,
}

impl<'a> Cloud<'a> {
    fn of(
        outline: &Outline,
        polygon: &'a [DVec2],
        growth: f64,
        far: f64,
        limit: &'a dyn Fn(DVec2) -> f64,
    ) -> Result<Self, InputError> {
        let points = outline.points.clone();
        let mut own = vec![f64::INFINITY; points.len()];
        let mut heading = vec![0.0; points.len()];
        for edge in &outline.edges {
            let along = points[edge.ends[1]] - points[edge.ends[0]];
            for &k in &edge.ends {
                own[k] = own[k].min(along.length());
                heading[k] = along.to_angle();
            }
        }
        let field = SizeField::new(points.iter().copied().zip(own).collect(), growth.min(1.0), far);
        let fixed = points.len();
        let mut edges: FxHashMap<_, Vec<_>> = FxHashMap::default();
        let mut levels = Vec::new();
        for edge in &outline.edges {
            let [a, b] = edge.ends.map(|k| points[k]);
            let level = Self::level(a.distance(b));
            levels.push(level);
            let reach = DVec2::splat(CLEARANCE * a.distance(b));
            let (_, i0, j0) = Self::bucket(a.min(b) - reach, level);
            let (_, i1, j1) = Self::bucket(a.max(b) + reach, level);
            for i in i0..=i1 {
                (j0..=j1).for_each(|j| edges.entry((level, i, j)).or_default().push([a, b]));
            }
        }
        levels.sort_unstable();
        levels.dedup();
        let (none, sizes, grid) = Default::default();
        let mut cloud = Self { points: none, sizes, fixed, polygon, heading, field, limit, grid, edges, levels };
        for p in points {
            let size = cloud.size(p, usize::MAX)?;
            cloud.add(p, size);
        }
        Ok(cloud)
    }

    fn size(&self, x: DVec2, hint: usize) -> Result<(f64, usize), InputError> {
        let (size, source) = self.field.at(x, hint);
        Ok((size.min(checked((self.limit)(x), x)?), source))
    }

    fn bucket(p: DVec2, level: i32) -> (i32, i64, i64) {
        let q = (p / f64::from(level).exp2()).floor();
        (level, q.x as i64, q.y as i64)
    }

    fn level(size: f64) -> i32 {
        size.log2().floor() as i32
    }

    fn add(&mut self, p: DVec2, size: (f64, usize)) {
        self.grid.entry(Self::bucket(p, Self::level(size.0))).or_default().push(self.points.len());
        self.points.push(p);
        self.sizes.push(size);
    }

    /// Whether a point of this size may stand at `p`.
    fn is_free(&self, p: DVec2, size: f64) -> bool {
        for &level in &self.levels {
            for &[a, b] in self.edges.get(&Self::bucket(p, level)).into_iter().flatten() {
                if nearest(a, b, p).distance_squared(p) < CLEARANCE * CLEARANCE * a.distance_squared(b) {
                    return false;
                }
            }
        }
        let level = Self::level(size);
        // A neighbour's size differs by less than a factor of two.
        for level in level - 1..=level + 1 {
            let reach = SPACING * 0.5 * (size + f64::from(level + 1).exp2());
            let (_, i0, j0) = Self::bucket(p - reach, level);
            let (_, i1, j1) = Self::bucket(p + reach, level);
            for i in i0..=i1 {
                for j in j0..=j1 {
                    for &k in self.grid.get(&(level, i, j)).into_iter().flatten() {
                        let wanted = SPACING * 0.5 * (size + self.sizes[k].0);
                        if self.points[k].distance_squared(p) < wanted * wanted {
                            return false;
                        }
                    }
                }
            }
        }
        true
    }

    /// Lays out points from those there are.
    fn fill(&mut self) -> Result<(), InputError> {
        // The direction in which each point was reached: its neighbours continue the pattern.
        let mut heading = std::mem::take(&mut self.heading);
        let mut next = 0;
        while next < self.points.len() {
            let (p, (size, source), angle) = (self.points[next], self.sizes[next], heading[next]);
            for k in 0..6 {
                let direction = angle + f64::from(k) * FRAC_PI_3;
                let ray = DVec2::from_angle(direction);
                let (there, _) = self.size(p + size * ray, source)?;
                let c = p + 0.5 * (size + there) * ray;
                if !contains(self.polygon, c) {
                    continue;
                }
                let there = self.size(c, source)?;
                if self.is_free(c, there.0) {
                    self.add(c, there);
                    heading.push(direction);
                }
            }
            next += 1;
            if self.points.len() > MAX_VERTICES {
                return Err(InputProblem::TooFine { limit: MAX_VERTICES }.into());
            }
        }
        Ok(())
    }

    /// The Delaunay triangles, counter-clockwise, that have all `edges` and lie inside the boundary.
    fn triangulate(&self, edges: &[[usize; 2]], is_boundary: &FxHashSet<[usize; 2]>) -> Vec<[usize; 3]> {
        // spade refuses coordinates so small that products underflow.
        let clean = |x: f64| if x.abs() < 1e-40 { 0.0 } else { x };
        let vertices = self.points.iter().map(|p| Point2::new(clean(p.x), clean(p.y))).collect();
        let cdt = ConstrainedDelaunayTriangulation::<Point2<f64>>::bulk_load_cdt(vertices, edges.to_vec())
            .unwrap_or_else(|error| unreachable!("coordinates were checked: {error}"));
        debug_assert_eq!(cdt.num_vertices(), self.points.len());
        // Between the boundary and the convex hull: what is reached from outside.
        let mut outside = vec![false; cdt.num_all_faces()];
        let mut queue = vec![cdt.outer_face().fix()];
        outside[queue[0].index()] = true;
        while let Some(face) = queue.pop() {
            let edges: Vec<_> = match cdt.face(face).as_inner() {
                Some(inner) => inner.adjacent_edges().to_vec(),
                None => cdt.convex_hull().collect(),
            };
            for edge in edges {
                let next = edge.rev().face().fix();
                if !is_boundary.contains(&sorted(edge.vertices().map(|v| v.index()))) && !outside[next.index()] {
                    outside[next.index()] = true;
                    queue.push(next);
                }
            }
        }
        (cdt.inner_faces().filter(|f| !outside[f.fix().index()])).map(|f| f.vertices().map(|v| v.index())).collect()
    }

    /// Adds points in triangles that are too large; says whether there were any.
    fn refine(&mut self, triangles: &[[usize; 3]]) -> Result<bool, InputError> {
        let before = self.points.len();
        self.grid.clear();
        for (k, (&p, size)) in self.points.iter().zip(&self.sizes).enumerate() {
            self.grid.entry(Self::bucket(p, Self::level(size.0))).or_default().push(k);
        }
        for t in triangles {
            let [a, b, c] = t.map(|k| self.points[k]);
            let (u, v) = (b - a, c - a);
            let w = (u.perp() * -v.length_squared() + v.perp() * u.length_squared()) / (2.0 * v.perp_dot(u));
            let center = a + w;
            if !center.is_finite() || !contains(self.polygon, center) {
                continue;
            }
            let size = self.size(center, self.sizes[t[0]].1)?;
            if w.length() > TOO_LARGE * size.0 && self.is_free(center, size.0) {
                self.add(center, size);
            }
        }
        Ok(self.points.len() > before)
    }

    /// Moves the free points, each to the mean of the places that its neighbours want it at. A move that
    /// spoils the worst triangle at the point is not made.
    fn smooth(&mut self, triangles: &[[usize; 3]]) {
        let star: Vec<Vec<usize>> = {
            let mut star = vec![Vec::new(); self.points.len()];
            for (i, t) in triangles.iter().enumerate() {
                t.iter().filter(|&&k| k >= self.fixed).for_each(|&k| star[k].push(i));
            }
            star
        };
        for _ in 0..MOVES {
            for k in self.fixed..self.points.len() {
                let x = self.points[k];
                let mut sum = DVec2::ZERO;
                let mut count = 0.0;
                for &i in &star[k] {
                    // Each neighbour is met in two triangles.
                    for &other in triangles[i].iter().filter(|&&other| other != k) {
                        let y = self.points[other];
                        let wanted = 0.5 * (self.sizes[k].0 + self.sizes[other].0);
                        sum += y + (x - y).normalize_or_zero() * wanted;
                        count += 1.0;
                    }
                }
                let moved = sum / count;
                let worst = |p: DVec2| {
                    (star[k].iter())
                        .map(|&i| quality(triangles[i].map(|v| if v == k { p } else { self.points[v] })))
                        .fold(f64::INFINITY, f64::min)
                };
                if count > 0.0 && worst(moved) >= worst(x).min(0.5) {
                    self.points[k] = moved;
                }
            }
        }
        for k in self.fixed..self.points.len() {
            if let Ok(size) = self.size(self.points[k], self.sizes[k].1) {
                self.sizes[k] = size;
            }
        }
    }
}

/// Area over the sum of squared edges, scaled to 1 for an equilateral triangle; negative if inverted.
fn quality([a, b, c]: [DVec2; 3]) -> f64 {
    let squares = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
    2.0 * 3.0_f64.sqrt() * (b - a).perp_dot(c - a) / squares
}
