//! Which cell a point lies in.

use std::f64::consts::PI;

use crate::{Mesh, Vec3};

/// Cells per leaf of the tree.
const LEAF: usize = 4;
/// Points that lie outside of a cell by less than this part of its diameter count as on its surface: round-off of
/// coordinates that were computed on it.
const SURFACE: f64 = 1e-9;

struct Branch {
    low: Vec3,
    high: Vec3,
    first: usize,
    last: usize,
    /// The second of its two parts; the first follows it. `None` in a leaf.
    second: Option<usize>,
}

/// Finds the cell of a point, by a tree of boxes around the cells.
pub struct Locator<'a> {
    mesh: &'a Mesh,
    cells: Vec<usize>,
    branches: Vec<Branch>,
}

impl Mesh {
    /// Prepares to find the cells of many points.
    pub fn locator(&self) -> Locator<'_> {
        let boxes: Vec<(Vec3, Vec3)> = (0..self.cell_count())
            .map(|cell| {
                let points = || self.cell_vertices(cell).iter().map(|&v| self.vertices()[v]);
                let slack = Vec3::splat(SURFACE * self.geometry().cell_diameter[cell]);
                let low = points().fold(Vec3::INFINITY, Vec3::min) - slack;
                (low, points().fold(Vec3::NEG_INFINITY, Vec3::max) + slack)
            })
            .collect();
        let mut locator = Locator { mesh: self, cells: (0..boxes.len()).collect(), branches: Vec::new() };
        locator.split(&boxes, 0, boxes.len());
        locator
    }

    /// The cell that `point` lies in; `None` outside of the mesh. On a face it is that of the cells there of which
    /// most lies around the point. For many points use [`locator`](Self::locator).
    pub fn locate(&self, point: Vec3) -> Option<usize> {
        choose(self, point, 0..self.cell_count())
    }

    /// Which part of a small ball around `point` lies in the mesh: 1 inside, ½ on a flat boundary, 0 outside.
    pub fn part_inside(&self, point: Vec3) -> f64 {
        /// Round-off of the sum of angles.
        const ROUND_OFF: f64 = 1e-6;
        let near = |&cell: &usize| {
            let geometry = self.geometry();
            geometry.cell_center[cell].distance(point) <= geometry.cell_diameter[cell] * (1.0 + SURFACE)
        };
        let filled: f64 = (0..self.cell_count()).filter(near).map(|cell| surroundings(self, cell, point).0).sum();
        if filled > 1.0 - ROUND_OFF { 1.0 } else { filled.max(0.0) }
    }
}

impl Locator<'_> {
    /// As [`Mesh::locate`].
    pub fn locate(&self, point: Vec3) -> Option<usize> {
        let mut found = Vec::new();
        let mut stack = vec![0];
        while let Some(b) = stack.pop() {
            let branch = &self.branches[b];
            if point.cmplt(branch.low).any() || point.cmpgt(branch.high).any() {
                continue;
            }
            match branch.second {
                None => found.extend(&self.cells[branch.first..branch.last]),
                Some(second) => stack.extend([second, b + 1]),
            }
        }
        found.sort_unstable();
        choose(self.mesh, point, found)
    }

    fn split(&mut self, boxes: &[(Vec3, Vec3)], first: usize, last: usize) {
        let own = &mut self.cells[first..last];
        let low = own.iter().fold(Vec3::INFINITY, |m, &c| m.min(boxes[c].0));
        let high = own.iter().fold(Vec3::NEG_INFINITY, |m, &c| m.max(boxes[c].1));
        let b = self.branches.len();
        self.branches.push(Branch { low, high, first, last, second: None });
        if last - first > LEAF {
            let axis = (high - low).max_position();
            let middle = (last - first) / 2;
            let key = |c: usize| boxes[c].0[axis] + boxes[c].1[axis];
            own.select_nth_unstable_by(middle, |&p, &q| key(p).total_cmp(&key(q)).then(p.cmp(&q)));
            self.split(boxes, first, first + middle);
            self.branches[b].second = Some(self.branches.len());
            self.split(boxes, first + middle, last);
        }
    }
}

/// The cell which `point` lies in or on: of several the one that fills most of its surroundings.
fn choose(mesh: &Mesh, point: Vec3, cells: impl IntoIterator<Item = usize>) -> Option<usize> {
    if !point.is_finite() || (mesh.dim() == 2 && point.z != 0.0) {
        return None;
    }
    let mut best: Option<(f64, usize)> = None;
    for cell in cells {
        let slack = SURFACE * mesh.geometry().cell_diameter[cell];
        let x = |v: &usize| mesh.vertices()[*v];
        let reach = mesh.geometry().cell_diameter[cell] + slack;
        if point.distance(x(&mesh.cell_vertices(cell)[0])) > reach {
            continue;
        }
        let (filled, distance) = surroundings(mesh, cell, point);
        if (filled > 0.5 || distance <= slack) && best.is_none_or(|(most, _)| filled > most) {
            best = Some((filled, cell));
        }
    }
    best.map(|(_, cell)| cell)
}

/// Which part of a small ball around `point` a cell fills (1 inside, 0 outside, between on the surface), and the
/// distance from its surface (m).
fn surroundings(mesh: &Mesh, cell: usize, point: Vec3) -> (f64, f64) {
    let slack = SURFACE * mesh.geometry().cell_diameter[cell];
    let mut filled = 0.0;
    let mut distance = f64::INFINITY;
    // A plane through the point has no side to it, whatever round-off says.
    let mut see = |angle: f64, away: f64| {
        filled += if away <= slack { 0.0 } else { angle };
        distance = distance.min(away);
    };
    for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
        let list = mesh.face_vertices(face);
        let x = |i: usize| mesh.vertices()[list[i % list.len()]] - point;
        if mesh.dim() == 2 {
            let (a, b) = (x(0), x(1));
            let t = (b - a) * (-a.dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            see(sign * a.cross(b).z.atan2(a.dot(b)) / (2.0 * PI), (a + t).length());
        } else {
            let m = (0..list.len()).map(x).sum::<Vec3>() / list.len() as f64;
            for i in 0..list.len() {
                let (a, b) = (x(i), x(i + 1));
                see(sign * solid_angle(m, a, b) / (4.0 * PI), distance_from_triangle(m, a, b));
            }
        }
    }
    (filled, distance)
}

/// The solid angle under which a triangle is seen from the origin (van Oosterom, Strackee, 1983); positive where it
/// is counter-clockwise seen from behind.
fn solid_angle(a: Vec3, b: Vec3, c: Vec3) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let volume = a.dot(b.cross(c));
    2.0 * volume.atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
}

/// The distance of a triangle from the origin.
fn distance_from_triangle(a: Vec3, b: Vec3, c: Vec3) -> f64 {
    let normal = (b - a).cross(c - a);
    let inside = [(a, b), (b, c), (c, a)].iter().all(|&(p, q)| (q - p).cross(-p).dot(normal) >= 0.0);
    if inside && normal != Vec3::ZERO {
        return a.dot(normal.normalize()).abs();
    }
    let segment = |p: Vec3, q: Vec3| {
        let t = (-p.dot(q - p) / (q - p).length_squared()).clamp(0.0, 1.0);
        (p + (q - p) * t).length()
    };
    segment(a, b).min(segment(b, c)).min(segment(c, a))
}
