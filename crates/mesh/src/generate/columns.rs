//! Layers displaced along a fault.

use super::{InputError, InputProblem};
use crate::{MeshData, Vec3};

/// A vertical section in columns (a corner-point grid) whose layers are displaced along a fault.
///
/// The fault runs straight from the bottom to the top of the section; between its two ends (m, the lower one first)
/// it is the fracture `fault`, beyond them only a line of the mesh. On either side the columns follow it, and
/// the layers are horizontal. Where the layers of both sides do not meet, the faces on the fault are split.
pub struct Columns<'a> {
    /// Lower left corner (m).
    pub low: [f64; 2],
    /// Upper right corner (m).
    pub high: [f64; 2],
    /// The two ends of the fault (m), the lower one first.
    pub fault: [[f64; 2]; 2],
    /// Heights between the layers on both sides (m), ascending, from bottom to top of the section.
    pub levels: [&'a [f64]; 2],
    /// Number of columns on both sides.
    pub columns: [usize; 2],
}

impl Columns<'_> {
    /// Makes the mesh: region `rock`, tags `left`, `right`, `bottom`, `top`, and the fracture `fault`. Columns are
    /// numbered from the left, cells within them upward.
    ///
    /// # Errors
    /// Levels that do not ascend or do not end at the bottom and top; a fault that leaves the section.
    pub fn build(&self) -> Result<MeshData, InputError> {
        let mut problems = Vec::new();
        let [[x0, z0], [x1, z1]] = [self.low, self.high];
        for levels in self.levels {
            for (index, &value) in levels.iter().enumerate() {
                let bound = if index == 0 { value == z0 } else { value > levels[index - 1] };
                if !(bound && value.is_finite() && (index + 1 < levels.len() || value == z1)) {
                    problems.push(InputProblem::Levels { index, value });
                }
            }
            if levels.len() < 2 {
                problems.push(InputProblem::Levels { index: levels.len(), value: f64::NAN });
            }
        }
        for count in self.columns.into_iter().filter(|&count| count == 0) {
            problems.push(InputProblem::NotPositive { what: "the number of columns".into(), value: count as f64 });
        }
        let [[fx0, fz0], [fx1, fz1]] = self.fault;
        let on_fault = |z: f64| fx0 + (fx1 - fx0) * (z - fz0) / (fz1 - fz0);
        for (x, y) in [(on_fault(z0), z0), (on_fault(z1), z1), (fx0, fz0), (fx1, fz1)] {
            if !(x > x0 && x < x1 && y >= z0 && y <= z1 && fz1 > fz0) {
                problems.push(InputProblem::Outside { what: "the fault".into(), x, y });
            }
        }
        InputError::check(problems)?;

        // Levels that differ by less are one.
        let tolerance = 1e-9 * (z1 - z0);
        let mut shared: Vec<f64> = self.levels.concat();
        shared.extend([fz0, fz1]);
        shared.sort_by(f64::total_cmp);
        shared.dedup_by(|b, a| *b - *a < tolerance);
        let place = |x: f64, z: f64| Vec3::new(x, z, 0.0);
        let mut vertices: Vec<Vec3> = shared.iter().map(|&z| place(on_fault(z), z)).collect();
        let near = |z: f64| shared.partition_point(|&s| s < z - tolerance);
        let mut cells: Vec<Vec<usize>> = Vec::new();
        for (side, levels) in self.levels.into_iter().enumerate() {
            let n = self.columns[side];
            // Pillars from left to right; the one on the fault is shared.
            let fault = if side == 0 { n } else { 0 };
            let first = vertices.len();
            let outer = if side == 0 { x0 } else { x1 };
            for pillar in (0..=n).filter(|&p| p != fault) {
                let t = pillar.abs_diff(fault) as f64 / n as f64;
                vertices.extend(levels.iter().map(|&z| place(on_fault(z) + t * (outer - on_fault(z)), z)));
            }
            // The vertices of a pillar between two of its levels, upward.
            let along = |pillar: usize, layer: usize| -> Vec<usize> {
                if pillar == fault {
                    (near(levels[layer])..=near(levels[layer + 1])).collect()
                } else {
                    let row = first + (if pillar > fault { pillar - 1 } else { pillar }) * levels.len();
                    vec![row + layer, row + layer + 1]
                }
            };
            for column in 0..n {
                for layer in 0..levels.len() - 1 {
                    let left = along(column, layer).into_iter().rev();
                    cells.push(left.chain(along(column + 1, layer)).collect());
                }
            }
        }
        let count = shared.len();
        let mut data = MeshData::from_polygons(vertices, cells);
        let fault = data.fracture("fault");
        for face in 0..data.faces.len() {
            let list = data.faces.get(face);
            if list.iter().all(|&v| v < count) {
                let z = data.face_mean(face).y;
                data.face_fracture[face] = (z > fz0 && z < fz1).then_some(fault);
            }
        }
        super::tag_box(&mut data, place(x0, z0), place(x1, z1));
        Ok(data)
    }
}
