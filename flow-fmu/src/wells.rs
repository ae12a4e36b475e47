//! Wells found in the mesh.

use std::f64::consts::PI;

use mesh::{Mesh, Vec3};

use crate::Tensor;
use crate::error::Problem;
use crate::model::{Well, WellIndex, WellPlace};

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
    /// W (m³, 2D: m²); for Peaceman's in a fracture face over d_f³/12.
    index: f64,
    scaled_by_aperture: bool,
}

impl Placed {
    /// W/η for the aperture (m) of the fracture face it is in.
    pub(crate) fn mobility(&self, viscosity: f64, aperture: impl Fn(usize) -> f64) -> f64 {
        match self.spot {
            Spot::FractureFace(i) if self.scaled_by_aperture => self.index * aperture(i).powi(3) / (12.0 * viscosity),
            _ => self.index / viscosity,
        }
    }
}

/// A point counts as inside a fracture face from this part of a full turn on: half of one on an edge, less at a vertex.
const INSIDE: f64 = 1e-6;

/// A point counts as on a fracture face up to this part of the face's size from it.
const ON_FACE: f64 = 1e-6;

pub(crate) fn place(
    mesh: &Mesh,
    wells: &[Well],
    permeability: impl Fn(usize) -> Tensor,
    problems: &mut Vec<Problem>,
) -> Vec<Placed> {
    let mut placed = Vec::new();
    for well in wells {
        let (point, found, outside) = match well.place {
            WellPlace::Cell(x) => (x, mesh.locate(x).map(Spot::Cell), "outside the mesh"),
            WellPlace::FractureFace(x) => (x, fracture_face_at(mesh, x).map(Spot::FractureFace), "on no fracture face"),
        };
        let Some(spot) = found else {
            let Vec3 { x, y, z } = point;
            problems.push(Problem::WellOutside { well: well.name.clone(), outside, x, y, z });
            continue;
        };
        match index(mesh, well.index, spot, &permeability) {
            Ok((index, scaled_by_aperture)) => placed.push(Placed { spot, index, scaled_by_aperture }),
            Err(reason) => problems.push(Problem::WellIndex { well: well.name.clone(), reason }),
        }
    }
    placed
}

/// W, and whether it is to be multiplied by d_f³/12. See [`WellIndex::Peaceman`].
fn index(
    mesh: &Mesh,
    index: WellIndex,
    spot: Spot,
    permeability: impl Fn(usize) -> Tensor,
) -> Result<(f64, bool), &'static str> {
    let radius = match index {
        WellIndex::Given(w) => return Ok((w, false)),
        WellIndex::Peaceman { radius } => radius,
    };
    let (strength, area, scaled) = match spot {
        Spot::Cell(cell) => {
            let heights = mesh.cell_vertices(cell).iter().map(|&v| mesh.vertices()[v].z);
            let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
            let height = if mesh.dim() == 3 { high - low } else { 1.0 };
            let k = permeability(cell);
            let mean = (k.x_axis.x * k.y_axis.y - k.x_axis.y * k.y_axis.x).sqrt();
            (mean * height, mesh.geometry().cell_measure[cell] / height, false)
        }
        Spot::FractureFace(_) if mesh.dim() == 2 => {
            return Err("a fracture in 2D has no radial flow: give the index instead of a radius");
        }
        Spot::FractureFace(i) => (1.0, mesh.geometry().face_measure[mesh.network().faces[i]], true),
    };
    let equivalent = 0.2 * area.sqrt();
    if radius >= equivalent {
        return Err("its radius is not below 0.2 √A, the radius at which a cell of area A feels its mean pressure");
    }
    Ok((2.0 * PI * strength / (equivalent / radius).ln(), scaled))
}

/// The fracture face that a point lies on.
fn fracture_face_at(mesh: &Mesh, x: Vec3) -> Option<usize> {
    let mut best = (INSIDE, None);
    for (i, &face) in mesh.network().faces.iter().enumerate() {
        let (normal, center) = (mesh.geometry().face_normal(face), mesh.geometry().face_center[face]);
        let size = mesh.geometry().face_measure[face].powf(1.0 / (mesh.dim() - 1) as f64);
        let height = (x - center).dot(normal);
        if height.abs() > ON_FACE * size {
            continue;
        }
        let list = mesh.face_vertices(face);
        let at = |k: usize| {
            let to = mesh.vertices()[list[k % list.len()]] - (x - height * normal);
            to - to.dot(normal) * normal
        };
        let part: f64 = if mesh.dim() == 2 {
            let (a, b) = (at(0), at(1));
            if a.dot(b) <= (ON_FACE * size).powi(2) { 1.0 } else { 0.0 }
        } else {
            let angle = |k| {
                let (a, b): (Vec3, Vec3) = (at(k), at(k + 1));
                a.cross(b).dot(normal).atan2(a.dot(b))
            };
            (0..list.len()).map(angle).sum::<f64>() / (2.0 * PI)
        };
        if part > best.0 * (1.0 + INSIDE) {
            best = (part, Some(i));
        }
    }
    best.1
}
