//! When a pass has converged, and when it cannot get any better.
//!
//! ```text
//! norm(residual), norm(estimated error) ≤ tolerance · max(floor, range)
//! ```
//!
//! for each field. The range is that of what is left of it, the least of these:
//!
//! | range of | small where |
//! |---|---|
//! | all values at the times up to now | the run has just begun |
//! | the values at the start of the time step and after the pass | all of it goes to one value, as in a column that is drained |
//! | the same, less those at the start of the run | it goes back to the start, whatever gravity makes of it there |
//!
//! Only accepted time steps count for the first one, so that iterates that diverge do not excuse themselves.
//!
//! Where residuals do not shrink any more, a pass from the same x, in which the last digits of all that units are given are changed,
//! shows how much of a field is round-off. Residuals of that size are as good as it gets, whatever the tolerance.

use model::Norm;

use super::{Fields, Run};
use crate::record::{FieldResidual, IterationRecord};

/// Last digits are changed by this part of each value.
const NUDGE: f64 = 4.0 * f64::EPSILON;
/// A residual of so many times the change that nudges make in a field is round-off: each is one draw of it.
const ROUND_OFF: f64 = 20.0;
/// So many passes without half the residual are a standstill.
const STANDSTILL: usize = 4;
/// A residual above this part of the largest value of its field is no round-off, and nothing is tried.
const LARGE: f64 = 1e-6;

impl Run {
    /// Scale of each field for the error of a pass that made `fields`.
    pub(super) fn scales(&self, fields: &Fields) -> Vec<f64> {
        let before = self.state.history.last().map(|(_, fields)| fields);
        (0..fields.len()).map(|f| self.scale(f, before.into_iter().chain([fields]))).collect()
    }

    /// Scale of each field to weigh them by, the same in all passes of a time step: of the last two times.
    pub(super) fn weighing(&self) -> Vec<f64> {
        let last = self.state.history.iter().rev().take(2).map(|(_, fields)| fields);
        (0..self.interface.fields.len()).map(|f| self.scale(f, last.clone())).collect()
    }

    fn scale<'a>(&self, f: usize, at: impl Iterator<Item = &'a Fields>) -> f64 {
        let [mut values, mut changes] = [NONE; 2];
        let initial = &self.state.initial[f];
        for fields in at {
            values = wider(values, fields[f].iter().copied());
            changes = wider(changes, fields[f].iter().zip(initial).map(|(v, start)| v - start));
        }
        let range = [self.state.ranges[f], values, changes].map(|[low, high]| high - low);
        // A range that is not a number, as that of a pass with such values, is none.
        range.into_iter().fold(f64::INFINITY, f64::min).max(self.interface.fields[f].criterion.floor.0)
    }

    /// How far fields are from their criteria.
    pub(super) fn residuals(&self, residual: &Fields, scales: &[f64]) -> Vec<FieldResidual> {
        let of = |f: usize| {
            let (criterion, r) = (self.interface.fields[f].criterion, &residual[f]);
            let worst = (0..r.len()).max_by(|&a, &b| r[a].abs().total_cmp(&r[b].abs()));
            FieldResidual { norm: norm(criterion.norm, r), limit: criterion.tolerance.0 * scales[f], worst }
        };
        (0..residual.len()).map(of).collect()
    }

    /// 1/(scale √entries) for each accelerated entry: all fields count alike.
    pub(super) fn weights(&self, accelerated: &[usize], fields: &Fields, scales: &[f64]) -> Vec<f64> {
        let of = |&f: &usize| {
            let n = fields[f].len();
            let scale = scales[f] * (n as f64).sqrt();
            std::iter::repeat_n(if scale > 0.0 { 1.0 / scale } else { 1.0 }, n)
        };
        accelerated.iter().flat_map(of).collect()
    }

    /// Whether all that the criteria do not allow is round-off, after two passes from the same x, one of them nudged, made
    /// `fields` and `before`. `holds`: of each field.
    pub(super) fn is_round_off(
        &self,
        record: &IterationRecord,
        holds: &[bool],
        fields: &Fields,
        before: &Fields,
    ) -> bool {
        record.residuals.iter().enumerate().filter(|&(f, _)| !holds[f]).all(|(f, r)| {
            let change: Vec<f64> = fields[f].iter().zip(&before[f]).map(|(a, b)| a - b).collect();
            let noise = norm(self.interface.fields[f].criterion.norm, &change);
            r.norm <= ROUND_OFF * noise.max(f64::EPSILON * largest(&fields[f]))
        })
    }
}

/// Looks for residuals that do not shrink any more.
pub(super) struct Standstill {
    /// Least part of the values of a field that the residual has been, of the worst one.
    least: f64,
    since: usize,
}

impl Default for Standstill {
    fn default() -> Self {
        Self { least: f64::INFINITY, since: 0 }
    }
}

impl Standstill {
    /// Whether after this pass it is worth while to look how large round-off is. `holds`: of each field.
    pub(super) fn see(&mut self, record: &IterationRecord, holds: &[bool], fields: &Fields) -> bool {
        let part = |(f, r): (usize, &FieldResidual)| r.norm / largest(&fields[f]);
        let parts = record.residuals.iter().enumerate().filter(|&(f, _)| !holds[f]).map(part);
        let worst = parts.fold(0.0, f64::max);
        if worst < 0.5 * self.least {
            *self = Self { least: worst, since: 0 };
            return false;
        }
        self.since += 1;
        let stands = self.since >= STANDSTILL && worst <= LARGE;
        if stands {
            self.since = 0;
        }
        stands
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// Fields with other last digits, up or down without order.
pub(super) fn nudge(fields: &Fields) -> Fields {
    /// 2⁶⁴ over the golden ratio: the highest bit of its multiples is without order.
    const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
    let nudged = |(i, value): (u64, &f64)| {
        let is_up = GOLDEN.wrapping_mul(i * i) >> 63 == 0;
        value + if is_up { NUDGE } else { -NUDGE } * value
    };
    fields.iter().map(|field| (1..).zip(field).map(nudged).collect()).collect()
}

/// The range of no values.
pub(crate) const NONE: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

/// A range widened to hold values.
pub(super) fn wider(range: [f64; 2], values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold(range, |[low, high], v| [low.min(v), high.max(v)])
}

fn norm(of: Norm, values: &[f64]) -> f64 {
    match of {
        Norm::Largest => values.iter().fold(0.0, |m, v| if v.abs() <= m { m } else { v.abs() }),
        Norm::RootMeanSquare => (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt(),
    }
}
