//! What a run of a comparison leaves, and what is measured of it.

use std::path::Path;

use mesh::Mesh;
use serde::{Deserialize, Serialize};

use crate::record::{Attempt, Failure, StepRecord};
use crate::results::{Quantity, ResultsError, Shape, Snapshot, files};

/// What a run leaves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Names of the units, in the order of their numbers.
    pub units: Vec<String>,
    /// The fields that they exchange, in the order of the interface.
    pub fields: Vec<Quantity>,
    /// Volumes of the cells and areas of the fracture faces: weights of the L² norms.
    pub measures: [Vec<f64>; 2],
    /// The accepted time steps.
    pub records: Vec<StepRecord>,
    /// The states at the start and after each of them; arrays where errors are wanted.
    pub snapshots: Vec<Snapshot>,
    /// Why it stopped before its end.
    pub failure: Option<Failure>,
    /// Wall seconds from the start of the units to the end.
    pub seconds: f64,
}

impl Outcome {
    /// Reads a file.
    ///
    /// # Errors
    /// [`ResultsError::Io`]; [`ResultsError::Damaged`].
    pub fn read(path: &Path) -> Result<Self, ResultsError> {
        let bytes = std::fs::read(path).map_err(ResultsError::io(path))?;
        postcard::from_bytes(&bytes).map_err(|error| ResultsError::damaged(path, error))
    }

    /// Writes a file (postcard), in one move.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn write(&self, path: &Path) -> Result<(), ResultsError> {
        let bytes = postcard::to_stdvec(self).map_err(|error| ResultsError::damaged(path, error))?;
        files::replace(path, &bytes)
    }

    /// Weights for [`measures`](Self::measures).
    pub fn measures_of(mesh: &Mesh) -> [Vec<f64>; 2] {
        let geometry = mesh.geometry();
        let faces = mesh.network().faces.iter().map(|&face| geometry.face_measure[face]);
        [geometry.cell_measure.clone(), faces.collect()]
    }

    /// All attempts, with the numbers of their time steps; those at the last one, which failed, too.
    pub(crate) fn attempts(&self) -> impl Iterator<Item = (usize, &Attempt)> {
        let done = self.records.iter().flat_map(|r| r.attempts.iter().map(|a| (r.number, a)));
        let given_up = self.failure.iter().flat_map(|f| &f.attempts).map(|a| (self.records.len() + 1, a));
        done.chain(given_up)
    }

    /// Measures it; errors are against `reference`.
    pub(crate) fn measure(&self, reference: Option<&Self>) -> Measures {
        let iterations = || self.attempts().flat_map(|(_, a)| &a.iterations);
        let newton = |u: usize| iterations().filter_map(|i| i.newton[u]).reduce(|a, b| a + b);
        let accepted = self.records.iter().map(|r| r.iterations().len());
        Measures {
            reached: self.snapshots.last().map_or(0.0, |s| s.time),
            time_steps: self.records.len(),
            failed_attempts: self.attempts().filter(|(_, a)| !a.outcome.is_accepted()).count(),
            iterations: iterations().count(),
            mean: iterations().count() as f64 / self.attempts().map(|(n, _)| n).max().unwrap_or(1) as f64,
            largest: accepted.max().unwrap_or(0),
            derivatives: iterations().map(|i| i.derivatives).sum(),
            newton: (0..self.units.len()).map(newton).collect(),
            contraction: (0..self.fields.len()).map(|f| contraction(self.attempts().map(|a| a.1), f)).collect(),
            seconds: (0..self.units.len()).map(|u| iterations().map(|i| i.seconds[u]).sum()).collect(),
            total: self.seconds,
            errors: self.fields.iter().map(|f| reference.and_then(|r| self.error(r, &f.name))).collect(),
        }
    }

    /// L² norm of the difference of a field from that of `reference`, the largest of all times at which both have it,
    /// over the largest L² norm of the reference; none on another mesh.
    fn error(&self, reference: &Self, field: &str) -> Option<f64> {
        /// Part of the time by which the same times may differ.
        const SAME: f64 = 1e-9;
        if self.measures != reference.measures {
            return None;
        }
        let of = |s: &Snapshot| s.arrays.iter().find(|a| a.name == field).map(|a| (a.shape, a.values.clone()));
        let mut error: Option<f64> = None;
        let mut scale = 0.0_f64;
        for there in reference.snapshots.iter().skip(1) {
            let same = |s: &&Snapshot| (s.time - there.time).abs() <= SAME * there.time.abs();
            let Some((_, a)) = self.snapshots.iter().find(same).and_then(of) else { continue };
            let Some((shape, b)) = of(there) else { continue };
            let weights = &self.measures[usize::from(shape != Shape::Cells)];
            let norm = |v: &mut dyn Iterator<Item = f64>| v.zip(weights).map(|(v, w)| w * v * v).sum::<f64>().sqrt();
            scale = scale.max(norm(&mut b.iter().copied()));
            let difference = norm(&mut a.iter().zip(&b).map(|(a, b)| a - b));
            error = Some(error.map_or(difference, |e| e.max(difference)));
        }
        error.filter(|_| scale > 0.0).map(|e| e / scale)
    }
}

/// Geometric mean of the ratios of successive residuals of a field, over the coupling iterations of all time steps. The
/// first residual of a time step is the change over it, no part of the sequence; residuals that vanish say nothing.
fn contraction<'a>(attempts: impl Iterator<Item = &'a Attempt>, field: usize) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0);
    for attempt in attempts {
        let norms: Vec<f64> = attempt.iterations.iter().map(|i| i.residuals[field].norm).collect();
        for pair in norms.windows(2).skip(1) {
            let ratio = (pair[1] / pair[0]).ln();
            if ratio.is_finite() {
                (sum, count) = (sum + ratio, count + 1);
            }
        }
    }
    (count > 0).then(|| (sum / f64::from(count)).exp())
}

/// What is measured of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measures {
    /// Time (s) that it reached.
    pub reached: f64,
    /// Accepted time steps.
    pub time_steps: usize,
    /// Attempts at time steps that failed.
    pub failed_attempts: usize,
    /// Coupling iterations of all attempts.
    pub iterations: usize,
    /// The same for each time step that was tried.
    pub mean: f64,
    /// Largest number of those of an accepted attempt.
    pub largest: usize,
    /// Directional derivatives of each coupled unit that the acceleration took.
    pub derivatives: usize,
    /// Newton iterations of each unit, where it tells.
    pub newton: Vec<Option<u64>>,
    /// Geometric mean of the ratios of successive residuals, for each field.
    pub contraction: Vec<Option<f64>>,
    /// Wall seconds in each unit.
    pub seconds: Vec<f64>,
    /// Wall seconds in all.
    pub total: f64,
    /// Relative error of each field against the reference.
    pub errors: Vec<Option<f64>>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{FieldResidual, IterationRecord};
    use crate::results::Array;

    fn outcome(norms: &[&[f64]], states: &[(f64, f64)]) -> Outcome {
        let iteration = |&norm: &f64| IterationRecord {
            residuals: vec![FieldResidual { norm, limit: 1.0, worst: Some(0) }],
            seconds: vec![0.25, 0.5],
            newton: vec![None, Some(2)],
            derivatives: 0,
        };
        let record = |(number, norms): (usize, &&[f64])| StepRecord {
            number,
            time: number as f64,
            attempts: vec![Attempt {
                step: 1.0,
                iterations: norms.iter().map(iteration).collect(),
                outcome: crate::AttemptOutcome::Converged,
            }],
        };
        let snapshot = |&(time, value): &(f64, f64)| Snapshot {
            time,
            scalars: Vec::new(),
            arrays: vec![Array::new("matrix.pressure", "Pa", Shape::Cells, vec![value, 2.0])],
        };
        Outcome {
            units: vec!["flow".into(), "mechanics".into()],
            fields: vec![Quantity { name: "matrix.pressure".into(), unit: "Pa".into() }],
            measures: [vec![3.0, 1.0], Vec::new()],
            records: (1..).zip(norms).map(record).collect(),
            snapshots: states.iter().map(snapshot).collect(),
            failure: None,
            seconds: 4.0,
        }
    }

    #[test]
    fn a_run_is_measured() {
        // Ratios ½ and ⅛: the first residual has no part in it, nor has one that vanishes.
        let run = outcome(&[&[4.0, 2.0, 1.0], &[3.0, 8.0, 1.0, 0.0]], &[(0.0, 9.0), (1.0, 1.0), (2.0, 2.0)]);
        let measures = run.measure(None);
        assert_eq!((measures.time_steps, measures.iterations, measures.mean, measures.largest), (2, 7, 3.5, 4));
        assert_eq!((measures.newton[0], measures.newton[1]), (None, Some(14)));
        assert_eq!((measures.seconds[0], measures.seconds[1], measures.total), (1.75, 3.5, 4.0));
        assert!((measures.contraction[0].unwrap() - 0.25).abs() < 1e-12, "{measures:?}");
        assert_eq!(measures.errors, [None]);
    }

    #[test]
    fn errors_are_weighted_and_taken_where_times_agree() {
        let coarse = outcome(&[], &[(0.0, 9.0), (1.0, 2.0), (2.0, 5.0)]);
        let fine = outcome(&[], &[(0.0, 0.0), (0.5, 100.0), (1.0, 3.0), (2.0, 7.0)]);
        // Differences 1 and 2 in the cell of measure 3; the largest norm of the reference is that at time 2.
        let expected = (3.0_f64 * 4.0).sqrt() / (3.0_f64 * 49.0 + 4.0).sqrt();
        assert!((coarse.measure(Some(&fine)).errors[0].unwrap() - expected).abs() < 1e-12);
        assert_eq!(fine.measure(Some(&fine)).errors, [Some(0.0)]);
        // On another mesh cells have nothing to do with one another.
        let mut other = outcome(&[], &[(0.0, 9.0), (1.0, 2.0)]);
        other.measures[0] = vec![1.0; 2];
        assert_eq!(other.measure(Some(&fine)).errors, [None]);
        // A run that ends in its first time step has reached its start.
        assert_eq!(outcome(&[], &[(5.0, 9.0)]).measure(None).reached, 5.0);
    }
}
