//! Wells found in the mesh, and their indices.
//!
//! A well in the rock is a straight line through its cell: in 2D across the plane, in 3D along its direction, as long as the
//! cell is ([`Slab`]). In a fracture in 3D it goes across the face. Its index W in q = (W/η) (p_w − p_K) is such that the pressure p_w
//! is the mean on its wall of the exact pressure around it, while p_K is the scheme's for the same flow ([`patch`]): right on any
//! mesh and for any permeability, as Peaceman's is on squares.
//!
//! The exact pressure is that of a line of even strength in a homogeneous rock, that of the well's cell ([`LineSource`]), which goes on
//!
//! - endlessly, with radial flow, where both of its ends lie on the boundary of the mesh or at rock less permeable
//!   by [`TIGHT`]: a well through a mesh of one layer, or through one layer of sand;
//! - as far again beyond the end, where only one does: the flow is that of the mirror image;
//! - through the cells of other wells that follow it on the same line: the wells that perforate the layers of a mesh are one well;
//! - nowhere else: a well in one of many layers has flow around its ends, too.
//!
//! Where only a part of its surroundings is rock, as at a plane of symmetry, all that it injects flows into that part.

use std::f64::consts::PI;

use mesh::{Mesh, Vec3};

use crate::Tensor;
use crate::error::Problem;
use crate::model::{Well, WellIndex, WellPlace};
use crate::space::Space;

mod extent;
mod patch;
mod source;

use extent::Slab;
use source::LineSource;

/// Where a well acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spot {
    /// A cell.
    Cell(usize),
    /// A fracture face.
    FractureFace(usize),
}

/// A well with its place in the mesh.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub(crate) spot: Spot,
    /// W (m³, 2D: m²); one from the radius in a fracture face is over d_f³/12. `None` where only the rate is known. Negative for a
    /// well so wide, or in a cell so unlike the flow around it, that the pressure in it is beyond that of its cell.
    index: Option<f64>,
    scaled_by_aperture: bool,
}

impl Placed {
    /// Whether it can hold a pressure.
    pub(crate) fn can_hold_pressure(&self) -> bool {
        self.index.is_some_and(|index| index > 0.0)
    }

    /// W/η for the aperture (m) of the fracture face it is in; `None` for a well of which only the rate is known.
    pub(crate) fn mobility(&self, viscosity: f64, aperture: impl Fn(usize) -> f64) -> Option<f64> {
        let scale = match self.spot {
            Spot::FractureFace(i) if self.scaled_by_aperture => aperture(i).powi(3) / 12.0,
            _ => 1.0,
        };
        self.index.map(|index| index * scale / viscosity)
    }
}

/// A point counts as inside a fracture face from this part of a full turn on: half of one on an edge, less at a vertex.
const INSIDE: f64 = 1e-6;

/// A point counts as on a fracture face up to this part of the face's size from it.
const ON_FACE: f64 = 1e-6;

/// Rock is tight from this part of a well's permeability on: what flows into it does not change the pressure around the well by
/// more than about this part.
const TIGHT: f64 = 1e-2;

/// Finds the wells.
pub(crate) fn place(mesh: &Mesh, wells: &[Well], problems: &mut Vec<Problem>) -> Vec<Spot> {
    let mut spots = Vec::new();
    for well in wells {
        let (point, found, outside) = match well.place {
            WellPlace::Cell(x) => (x, mesh.locate(x).map(Spot::Cell), "outside the mesh"),
            WellPlace::FractureFace(x) => (x, fracture_face_at(mesh, x).map(Spot::FractureFace), "on no fracture face"),
        };
        match found {
            Some(spot) => spots.push(spot),
            None => {
                let Vec3 { x, y, z } = point;
                problems.push(Problem::WellOutside { well: well.name.clone(), outside, x, y, z });
            }
        }
    }
    spots
}

/// Gives the wells their indices. `permeability` (m²) is that of a cell; in 2D its K_zz is 1.
///
/// # Errors
/// Those of the linear solver.
pub(crate) fn connect(
    mesh: &Mesh,
    space: &Space,
    wells: &[Well],
    spots: &[Spot],
    permeability: &dyn Fn(usize) -> Tensor,
    problems: &mut Vec<Problem>,
) -> Result<Vec<Placed>, linear::Error> {
    let mut placed = Vec::new();
    for (number, (well, &spot)) in wells.iter().zip(spots).enumerate() {
        let mut fail = |reason| problems.push(Problem::WellIndex { well: well.name.clone(), reason });
        let index = match (well.index, spot) {
            (None, _) => None,
            (Some(WellIndex::Given(index)), _) => Some(index),
            (Some(WellIndex::Radius { .. }), Spot::FractureFace(_)) if mesh.dim() == 2 => {
                fail("a fracture in 2D has no radial flow: give the index instead of a radius".into());
                None
            }
            (Some(WellIndex::Radius { radius, direction }), _) => {
                let surroundings = Surroundings { mesh, space, wells, spots, permeability };
                let line = match spot {
                    Spot::Cell(cell) => surroundings.line(number, cell, radius, direction),
                    Spot::FractureFace(i) => surroundings.line_across(number, i),
                };
                let (index, equivalent) = surroundings.index(&line, radius)?;
                let wide = surroundings.radius_of(&line.parts[0]);
                if radius >= wide {
                    fail(format!(
                        "its radius of {radius} m is not below {wide:.3e} m, that of the cell or fracture face it is in"
                    ));
                } else if index <= 0.0 && well.holds_pressure() {
                    fail(format!(
                        "its radius of {radius} m is not below {equivalent:.3e} m, where the pressure around it is that of the cell \
                         or fracture face it is in: to hold a pressure, or to be limited by one, it needs a smaller radius, \
                         larger cells or an index"
                    ));
                }
                Some(index)
            }
        };
        let scaled_by_aperture = matches!(well.index, Some(WellIndex::Radius { .. }));
        placed.push(Placed { spot, index, scaled_by_aperture });
    }
    Ok(placed)
}

/// What is around the wells.
struct Surroundings<'a> {
    mesh: &'a Mesh,
    space: &'a Space,
    wells: &'a [Well],
    spots: &'a [Spot],
    permeability: &'a dyn Fn(usize) -> Tensor,
}

/// A cell or fracture face that a line goes through, and the part of the line that its well takes (m).
type LinePart = (Spot, [f64; 2]);

/// The line that a well is part of.
struct WellLine {
    /// What it goes through, the well's own first.
    parts: Vec<LinePart>,
    /// The exact pressure for a strength of 1 m³/s per metre.
    source: LineSource,
}

/// An end of a line.
struct LineEnd {
    /// Its place (m).
    at: f64,
    /// Whether it lies on the boundary of the mesh or of the permeable rock.
    is_closed: bool,
}

impl Surroundings<'_> {
    /// The line of a well in a cell.
    fn line(&self, number: usize, cell: usize, radius: f64, direction: Vec3) -> WellLine {
        let WellPlace::Cell(x) = self.wells[number].place else { unreachable!("it is in a cell") };
        let (direction, parts, ends) = if self.mesh.dim() == 2 {
            (Vec3::Z, vec![(Spot::Cell(cell), [0.0, 1.0])], None)
        } else {
            let direction = direction.normalize();
            let (parts, ends) = self.length(number, cell, radius, direction);
            (direction, parts, ends)
        };
        let middle = if self.mesh.dim() == 2 {
            x
        } else {
            let [from, to] = parts[0].1;
            x.reject_from_normalized(direction) + 0.5 * (from + to) * direction
        };
        // Away from the boundary, what enters a cell evenly is seen from afar at the cell's point.
        let turn = self.mesh.part_inside(middle);
        let center = if turn < 1.0 { x } else { self.space.cell_point(cell) };
        let origin = center.reject_from_normalized(direction);
        let tensor = (self.permeability)(cell);
        WellLine { parts, source: LineSource::new(origin, direction, ends, tensor, turn.recip()) }
    }

    /// The parts of the line that a well in a cell in 3D is part of, its own first, and where the source ends.
    fn length(&self, number: usize, cell: usize, radius: f64, direction: Vec3) -> (Vec<LinePart>, Option<[f64; 2]>) {
        let (WellPlace::Cell(x) | WellPlace::FractureFace(x)) = self.wells[number].place;
        let own = self.part(number, cell, direction);
        let mut parts = vec![(Spot::Cell(cell), own)];
        let [mut low, mut high] = own;
        let follower = |parts: &[LinePart], reach| {
            let follows = |&other: &usize| self.follows(other, x, direction, radius, reach, parts);
            (0..self.wells.len()).find(follows)
        };
        while let Some(other) = follower(&parts, [low, high]) {
            let (Spot::Cell(place) | Spot::FractureFace(place)) = self.spots[other];
            let part = self.part(other, place, direction);
            parts.push((self.spots[other], part));
            (low, high) = (low.min(part[0]), high.max(part[1]));
        }
        let middle = 0.5 * (low + high);
        let [low, high] =
            [low, high].map(|end| self.end(cell, x.reject_from_normalized(direction), direction, [middle, end]));
        parts.iter_mut().for_each(|part| part.1 = part.1.map(|s| s.clamp(low.at, high.at)));
        let length = high.at - low.at;
        let ends = match (low.is_closed, high.is_closed) {
            (true, true) => None,
            (true, false) => Some([low.at - length, high.at]),
            (false, true) => Some([low.at, high.at + length]),
            (false, false) => Some([low.at, high.at]),
        };
        (parts, ends)
    }

    /// The end of a line from `middle` to `to` along `direction` from `origin`: there, or where it leaves the mesh or the rock that is
    /// open to a well in `cell`.
    fn end(&self, cell: usize, origin: Vec3, direction: Vec3, [middle, to]: [f64; 2]) -> LineEnd {
        /// It is closed if the rock is, so far beyond it in parts of the line's half.
        const BEYOND: f64 = 1e-3;
        /// A closed end is found to this part of the line's half.
        const BISECTIONS: usize = 40;
        let is_open = self.is_open(cell);
        let is_rock = |s: f64| self.mesh.locate(origin + s * direction).is_some_and(&is_open);
        let beyond = to + BEYOND * (to - middle);
        if is_rock(beyond) {
            return LineEnd { at: to, is_closed: false };
        }
        let (mut inside, mut outside) = (middle, beyond);
        for _ in 0..BISECTIONS {
            let s = 0.5 * (inside + outside);
            *(if is_rock(s) { &mut inside } else { &mut outside }) = s;
        }
        LineEnd { at: inside, is_closed: true }
    }

    /// The line across a fracture face in 3D: radial flow in the fracture.
    fn line_across(&self, number: usize, fracture_face: usize) -> WellLine {
        let (mesh, network) = (self.mesh, self.mesh.network());
        let WellPlace::FractureFace(x) = self.wells[number].place else { unreachable!("it is in a fracture face") };
        let fracture = |i: usize| network.fracture[i];
        let around = (0..network.face_count()).filter(|&i| fracture(i) == fracture(fracture_face));
        let turn: f64 = around.filter_map(|i| part_around(mesh, i, x)).sum();
        let turn = if turn < 1.0 - INSIDE { turn } else { 1.0 };
        let normal = mesh.geometry().face_normal(network.faces[fracture_face]);
        let center = if turn < 1.0 { x } else { self.space.fracture_point(fracture_face) };
        WellLine {
            parts: vec![(Spot::FractureFace(fracture_face), [0.0, 1.0])],
            source: LineSource::new(center, normal, None, Tensor::IDENTITY, turn.recip()),
        }
    }

    /// The part of the line along `direction` that a well in a cell in 3D takes, as long as the cell.
    fn part(&self, number: usize, cell: usize, direction: Vec3) -> [f64; 2] {
        let (WellPlace::Cell(x) | WellPlace::FractureFace(x)) = self.wells[number].place;
        Slab::around(self.mesh, cell, direction).chord(x).map(|s| s + x.dot(direction))
    }

    /// Whether another well goes on where those between two places end, in a cell of its own.
    fn follows(
        &self,
        other: usize,
        x: Vec3,
        direction: Vec3,
        radius: f64,
        [low, high]: [f64; 2],
        parts: &[LinePart],
    ) -> bool {
        /// Directions are the same up to this angle, ends meet up to this part of the length of a well.
        const SAME: f64 = 1e-6;
        let well = &self.wells[other];
        let (WellPlace::Cell(at), Some(WellIndex::Radius { radius: its_radius, direction: its })) =
            (well.place, well.index)
        else {
            return false;
        };
        let spot = self.spots[other];
        let Spot::Cell(cell) = spot else { return false };
        let is_new = parts.iter().all(|part| part.0 != spot);
        let apart = (at - x).reject_from_normalized(direction).length();
        if !is_new || its.normalize().cross(direction).length() > SAME || apart > radius.max(its_radius) {
            return false;
        }
        let [from, to] = self.part(other, cell, direction);
        let slack = SAME * (high - low);
        from <= high + slack && to >= low - slack
    }

    /// Whether other cells let the flow through that a well in `cell` causes.
    fn is_open(&self, cell: usize) -> impl Fn(usize) -> bool {
        let mean = |cell: usize| (self.permeability)(cell).determinant().powf(1.0 / self.mesh.dim() as f64);
        let least = TIGHT * mean(cell);
        move |other| mean(other) > least
    }

    /// Radius (m) of the circle with the cell's mean cross-section, or with the area of the fracture face.
    fn radius_of(&self, &(spot, [from, to]): &LinePart) -> f64 {
        let geometry = self.mesh.geometry();
        let measure = match spot {
            Spot::Cell(cell) => geometry.cell_measure[cell],
            Spot::FractureFace(i) => geometry.face_measure[self.mesh.network().faces[i]],
        };
        (measure / (to - from) / PI).sqrt()
    }

    /// W, and the radius (m) for which it would be infinite.
    fn index(&self, line: &WellLine, radius: f64) -> Result<(f64, f64), linear::Error> {
        let rates = rates(&line.parts);
        let numbers: Vec<usize> = line
            .parts
            .iter()
            .map(|part| match part.0 {
                Spot::Cell(i) | Spot::FractureFace(i) => i,
            })
            .collect();
        let pressures = match line.parts[0].0 {
            Spot::Cell(cell) => {
                let is_open = self.is_open(cell);
                let rock = patch::Rock { mesh: self.mesh, space: self.space, is_open: &is_open };
                patch::pressures(&rock, &line.source, &numbers, &rates)?
            }
            Spot::FractureFace(_) => {
                let faces = patch::FractureFaces { mesh: self.mesh, space: self.space };
                patch::pressures(&faces, &line.source, &numbers, &rates)?
            }
        };
        let [from, to] = line.parts[0].1;
        let difference = line.source.pressure_at_wall(radius, from, to) - pressures[0];
        Ok((rates[0] / difference, line.source.radius_at(radius, difference)))
    }
}

/// What enters through each part of a line (m³/s for 1 m³/s per metre): where several parts overlap they share it.
fn rates(parts: &[LinePart]) -> Vec<f64> {
    let mut places: Vec<f64> = parts.iter().flat_map(|part| part.1).collect();
    places.sort_by(f64::total_cmp);
    let mut rates = vec![0.0; parts.len()];
    for piece in places.windows(2) {
        let middle = 0.5 * (piece[0] + piece[1]);
        let inside: Vec<usize> =
            (0..parts.len()).filter(|&i| parts[i].1[0] < middle && middle < parts[i].1[1]).collect();
        for &i in &inside {
            rates[i] += (piece[1] - piece[0]) / inside.len() as f64;
        }
    }
    rates
}

/// The fracture face that a point lies on: of several the one that takes most of a turn around it.
fn fracture_face_at(mesh: &Mesh, x: Vec3) -> Option<usize> {
    let mut best = (INSIDE, None);
    for i in 0..mesh.network().face_count() {
        if let Some(part) = part_around(mesh, i, x)
            && part > best.0 * (1.0 + INSIDE)
        {
            best = (part, Some(i));
        }
    }
    best.1
}

/// The part of a full turn around a point on its plane that a fracture face takes; `None` where the point is not on its plane.
fn part_around(mesh: &Mesh, fracture_face: usize, x: Vec3) -> Option<f64> {
    let face = mesh.network().faces[fracture_face];
    let (normal, center) = (mesh.geometry().face_normal(face), mesh.geometry().face_center[face]);
    let size = mesh.geometry().face_measure[face].powf(1.0 / (mesh.dim() - 1) as f64);
    let height = (x - center).dot(normal);
    if height.abs() > ON_FACE * size {
        return None;
    }
    let list = mesh.face_vertices(face);
    let at = |k: usize| {
        let to = mesh.vertices()[list[k % list.len()]] - (x - height * normal);
        to - to.dot(normal) * normal
    };
    if mesh.dim() == 2 {
        let (a, b) = (at(0), at(1));
        return Some(if a.dot(b) <= (ON_FACE * size).powi(2) { 1.0 } else { 0.0 });
    }
    let angle = |k| {
        let (a, b): (Vec3, Vec3) = (at(k), at(k + 1));
        a.cross(b).dot(normal).atan2(a.dot(b))
    };
    Some((0..list.len()).map(angle).sum::<f64>() / (2.0 * PI))
}
