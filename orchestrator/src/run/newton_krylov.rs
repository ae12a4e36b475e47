//! Newton's method on the interface (Knoll, Keyes, J. Comput. Phys. 193, 2004, 357-397).
//!
//! A pass of the split makes fields G(x) of fields x. A Newton iteration for r(x) = G(x) − x = 0 is
//!
//! ```text
//! (I − G′(x)) s = r(x),   x ← x + λ s,   λ = 1, ½, ¼, …
//! ```
//!
//! solved by GMRES. G′(x) v goes through the units in the order of the pass, by their directional derivatives at its end, which
//! hold the contact states of that pass; a unit that has none is asked for differences of time steps. The split is the
//! preconditioner: where it is good, G′ is small. λ is halved while a unit refuses, and from the best place so far where
//! steps do not get below the residual there, as where contact states change back and forth.
//!
//! GMRES reduces the residual by η, the part of it by which r has shown not to be linear (Eisenstat, Walker, SIAM J. Sci. Comput. 17,
//! 1996, choice 1), but by no less than [`FORCING`]:
//!
//! ```text
//! η = | ‖r(x + s)‖ − ‖r(x) − (I − G′(x)) s‖ | / ‖r(x)‖
//! ```
//!
//! Where contact states stay as they are, η is 0 but for round-off, and a time step takes one Newton iteration.

use std::cell::RefCell;
use std::time::Instant;

use super::{Fields, Run};
use crate::error::CouplingError;
use crate::record::{FieldResidual, IterationRecord};
use crate::unit::StepOutcome;

/// GMRES reduces the residual by this much at least. Contact states seldom leave Newton's method more than that.
pub(super) const FORCING: f64 = 1e-3;
/// It is not asked for more than this: derivatives are not better.
const FINEST: f64 = 1e-8;
/// Below this part of the least tolerance of a field, GMRES has nothing to gain.
const NEGLIGIBLE: f64 = 0.1;
/// λ is not made smaller than this.
const SHORTEST: f64 = 0.125;
/// So many passes in a row may leave the residual above the least one. A step to where other faces slip lands where the
/// residual is another function, and mostly a greater one; the next step then gets it right. To shorten such a step is
/// to creep up to the place where the states change.
const PATIENCE: usize = 4;
/// Where more than this part of a residual answers to nothing, as below the pressure that opens a sealed fracture, it is followed in
/// strides, each so many times the one before, since it may be far to where something answers: (I − γ G′) s = r with γ = 1 − 1/stride
/// is s = stride · r where G′ s = s, and Newton's step elsewhere.
const STUCK: f64 = 0.5;
const STRIDE: f64 = 4.0;
/// A step that is so many times the residual comes of a derivative that is round-off.
const LONGEST: f64 = 1e10;
/// Differences change the fields by this part of their scales: the root of what units' solvers leave.
const DIFFERENCE: f64 = 1e-6;

/// Where Newton's method has been, and where it goes.
pub(super) struct Search {
    /// Where the residual was least.
    best: Option<Base>,
    /// The last one, with the trial that is being made.
    last: Option<Base>,
    /// Passes since the best one.
    waited: usize,
    /// η of the earlier time steps, and the largest one in this time step.
    earlier: f64,
    seen: Option<f64>,
    /// Times the residual, in the last passes that were stuck.
    stride: Option<f64>,
}

#[derive(Clone)]
struct Base {
    x: Vec<f64>,
    /// ‖r(x)‖.
    norm: f64,
    direction: Vec<f64>,
    /// ‖r(x) − (I − G′(x)) s‖ with the direction s.
    predicted: f64,
    factor: f64,
}

impl Search {
    /// In a new attempt at a time step, after one that left `forcing`.
    pub(super) fn new(forcing: f64) -> Self {
        Self { best: None, last: None, waited: 0, earlier: forcing, seen: None, stride: None }
    }

    /// What GMRES is to reduce residuals by, as far as is known.
    pub(super) fn forcing(&self) -> f64 {
        self.seen.unwrap_or(self.earlier).clamp(FINEST, FORCING)
    }

    /// How far to follow a residual that answers to nothing.
    fn stride(&mut self) -> f64 {
        *self.stride.insert(self.stride.map_or(1.0, |stride| STRIDE * stride))
    }

    /// Takes note of the residual that a pass has left.
    pub(super) fn see(&mut self, r: &[f64], weights: &[f64]) {
        let Some(last) = &self.last else { return };
        if last.predicted <= STUCK * last.norm {
            self.stride = None;
        }
        let part = if last.factor < 1.0 { 1.0 } else { (weighted(r, weights) - last.predicted).abs() / last.norm };
        self.seen = Some(self.seen.unwrap_or(0.0).max(part));
    }

    /// Goes on from x: the first trial, x + s.
    fn start(&mut self, x: Vec<f64>, norm: f64, direction: Vec<f64>, predicted: f64) -> Vec<f64> {
        let base = Base { x, norm, direction, predicted, factor: 1.0 };
        if self.best.as_ref().is_none_or(|best| norm < best.norm) {
            (self.best, self.waited) = (Some(base.clone()), 0);
        }
        self.last.insert(base).trial()
    }

    /// The next trial where a unit refused the last one; none where there was none, or is no shorter one.
    pub(super) fn shorten(&mut self) -> Option<Vec<f64>> {
        let base = self.last.as_mut().filter(|base| base.factor > SHORTEST)?;
        base.factor *= 0.5;
        Some(base.trial())
    }

    /// Where the residual has not become better for long, a shorter step from the best place.
    fn go_back(&mut self, norm: f64) -> Option<Vec<f64>> {
        if self.stride.is_some() {
            return None;
        }
        let best = self.best.as_mut().filter(|best| best.norm <= norm)?;
        self.waited += 1;
        if self.waited < PATIENCE || best.factor <= SHORTEST {
            return None;
        }
        self.waited = 0;
        best.factor *= 0.5;
        self.last = Some(best.clone());
        Some(best.trial())
    }
}

impl Base {
    fn trial(&self) -> Vec<f64> {
        self.x.iter().zip(&self.direction).map(|(x, s)| x + self.factor * s).collect()
    }
}

/// A pass: what it began with, what it made, and how long its time step (s) was.
pub(super) struct At<'a> {
    pub(super) x: &'a Fields,
    pub(super) fields: &'a Fields,
    pub(super) step: f64,
    /// The fields that the pass depends on.
    pub(super) accelerated: &'a [usize],
    /// Of their entries, one after the other, in the norm.
    pub(super) weights: &'a [f64],
    /// Of each field: the one that weights are made of, and that of the criterion.
    pub(super) scales: [&'a [f64]; 2],
}

impl Run {
    /// The next x after a pass, over the accelerated fields; `x` and `r` are the last one and the residual there. Work goes
    /// into `record`.
    pub(super) fn newton_krylov(
        &mut self,
        search: &mut Search,
        at: &At<'_>,
        x: Vec<f64>,
        r: &[f64],
        krylov: usize,
        record: &mut IterationRecord,
    ) -> Result<Vec<f64>, CouplingError> {
        // GMRES works on fields times their weights, so that it sees all of them alike.
        let b: Vec<f64> = r.iter().zip(at.weights).map(|(r, w)| r * w).collect();
        let norm = weighted(r, at.weights);
        if let Some(trial) = search.go_back(norm) {
            return Ok(trial);
        }
        let [weighing, scales] = at.scales;
        let limit = |(f, residual): (usize, &FieldResidual)| match at.accelerated.contains(&f) {
            true => self.interface.fields[f].criterion.tolerance.0 * scales[f] / weighing[f],
            // It follows the others, and shrinks as they do.
            false => norm / residual.ratio(),
        };
        let limits = record.residuals.iter().enumerate().map(limit).filter(|limit| limit.is_finite());
        let target = (search.forcing() * norm).max(NEGLIGIBLE * limits.reduce(f64::min).unwrap_or(0.0));
        let cell = RefCell::new((self, record, None));
        // (I − γ G′(x)) v
        let apply = |damping: f64, v: &[f64], out: &mut [f64]| {
            if v.iter().all(|&v| v == 0.0) {
                return out.fill(0.0);
            }
            let (run, record, error) = &mut *cell.borrow_mut();
            let mut change: Fields = at.x.iter().map(|field| vec![0.0; field.len()]).collect();
            scatter(at.accelerated, v.iter().zip(at.weights).map(|(v, w)| v / w), &mut change);
            record.derivatives += 1;
            match run.tangent(at, &change, record) {
                Ok(Some(image)) => {
                    let image = at.accelerated.iter().flat_map(|&f| &image[f]);
                    for (((out, v), g), w) in out.iter_mut().zip(v).zip(image).zip(at.weights) {
                        *out = v - damping * g * w;
                    }
                }
                // GMRES ends where something is not finite.
                Ok(None) => out.fill(f64::NAN),
                Err(failed) => {
                    *error = Some(failed);
                    out.fill(f64::NAN);
                }
            }
        };
        let solve = |damping: f64| {
            let mut scaled = vec![0.0; b.len()];
            let solved = linear::gmres(&|v, out| apply(damping, v, out), &|_| {}, &b, &mut scaled, target, krylov);
            (scaled, solved.residual)
        };
        let (mut scaled, mut left) = solve(1.0);
        if left > STUCK * norm || scaled.iter().any(|s| s.abs() > LONGEST * norm) {
            let stride = search.stride();
            (scaled, left) = (if stride > 1.0 { solve(1.0 - stride.recip()).0 } else { b.clone() }, norm);
        }
        if let Some(error) = cell.into_inner().2 {
            return Err(error);
        }
        let mut direction: Vec<f64> = scaled.iter().zip(at.weights).map(|(s, w)| s / w).collect();
        if direction.iter().all(|&s| s == 0.0) {
            // No derivative: the step of the split itself.
            direction = r.to_vec();
        }
        Ok(search.start(x, norm, direction, left))
    }

    /// G′(x) v for a change v of the fields. The units stand at the end of the pass. None where a unit refuses to be
    /// differenced.
    fn tangent(
        &mut self,
        at: &At<'_>,
        v: &Fields,
        record: &mut IterationRecord,
    ) -> Result<Option<Fields>, CouplingError> {
        let (mut given, mut change) = (at.x.clone(), v.clone());
        let first = self.settings.scheme.first;
        for unit in [first, 1 - first] {
            let clock = Instant::now();
            let own: Vec<usize> = self.interface.given_by(unit).collect();
            let Some(images) = self.unit_tangent(unit, &given, at, &change, v)? else { return Ok(None) };
            record.seconds[unit] += clock.elapsed().as_secs_f64();
            for (f, image) in own.into_iter().zip(images) {
                given[f].clone_from(&at.fields[f]);
                change[f] = image;
            }
        }
        Ok(Some(change))
    }

    /// The change of the fields that a unit gives, for a `change` of its partner's fields around `given`, and a change v
    /// of its own fields as references.
    fn unit_tangent(
        &mut self,
        unit: usize,
        given: &Fields,
        at: &At<'_>,
        change: &Fields,
        v: &Fields,
    ) -> Result<Option<Fields>, CouplingError> {
        let partner = 1 - unit;
        let fields = &self.interface.fields;
        let own: Vec<usize> = self.interface.given_by(unit).collect();
        let outputs: Vec<&str> = own.iter().map(|&f| fields[f].name.as_str()).collect();
        let references: Vec<(String, usize)> =
            self.references[unit].iter().map(|&f| (reference_of(&fields[f].name), f)).collect();
        let mut inputs: Vec<(&str, &[f64])> =
            self.interface.given_by(partner).map(|f| (fields[f].name.as_str(), &change[f][..])).collect();
        inputs.extend(references.iter().map(|(name, f)| (name.as_str(), &v[*f][..])));
        let acting = self.units[unit].as_mut();
        if let Some(images) =
            acting.derivative(&outputs, &inputs).map_err(|error| CouplingError::unit(acting, error))?
        {
            return Ok(Some(images));
        }
        let largest = |f: usize| {
            let size = change[f].iter().chain(&v[f]).fold(0.0f64, |m, c| m.max(c.abs()));
            size / at.scales[0][f]
        };
        let size = (0..fields.len()).map(largest).fold(0.0, f64::max);
        if size == 0.0 {
            return Ok(Some(own.iter().map(|&f| vec![0.0; at.fields[f].len()]).collect()));
        }
        let part = DIFFERENCE / size;
        let moved = |from: &Fields, by: &Fields| -> Fields {
            let sum = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| a + part * b).collect();
            from.iter().zip(by).map(sum).collect()
        };
        let (fields, reference) = (moved(given, change), moved(at.x, v));
        self.call(unit, |u| u.restore())?;
        self.set_inputs(unit, &fields, &reference, 1.0)?;
        let time = self.state.time;
        if let StepOutcome::Discarded { .. } = self.call(unit, |u| u.step(time, at.step))? {
            return Ok(None);
        }
        let mut new = at.fields.clone();
        self.get_outputs(unit, &mut new)?;
        let slope = |f: &usize| new[*f].iter().zip(&at.fields[*f]).map(|(a, b)| (a - b) / part).collect();
        Ok(Some(own.iter().map(slope).collect()))
    }
}

/// The norm of a residual.
fn weighted(r: &[f64], weights: &[f64]) -> f64 {
    r.iter().zip(weights).map(|(r, w)| (r * w).powi(2)).sum::<f64>().sqrt()
}

/// Name of the variable that takes the point at which a field was found.
pub(super) fn reference_of(field: &str) -> String {
    format!("{field}_reference")
}

/// Distributes values over some of the fields.
pub(super) fn scatter(to: &[usize], values: impl IntoIterator<Item = f64>, fields: &mut Fields) {
    let mut values = values.into_iter();
    for &f in to {
        fields[f].iter_mut().zip(&mut values).for_each(|(field, value)| *field = value);
    }
}

#[cfg(test)]
mod tests {
    use super::{FORCING, Search};

    /// Newton's method for r(x) = 0 from x = 3 with given derivative of r; gives the number of evaluations.
    fn evaluations(r: impl Fn(f64) -> f64, slope: impl Fn(f64) -> f64) -> usize {
        let (mut search, mut x) = (Search::new(FORCING), 3.0);
        for k in 1..100 {
            let norm = r(x).abs();
            if norm < 1e-10 {
                return k;
            }
            let next = search.go_back(norm).unwrap_or_else(|| search.start(vec![x], norm, vec![-r(x) / slope(x)], 0.0));
            x = next[0];
        }
        100
    }

    #[test]
    fn steps_that_lead_away_are_shortened() {
        // The plain method runs off from |x| > 1.39.
        assert!(evaluations(f64::atan, |x| 1.0 / (1.0 + x * x)) < 15);
        // Two pieces, the second 100 times as steep: the first step lands there with a greater residual, and that is well.
        let pieces = |x: f64| if x > 0.0 { 0.01 * x + 0.5 } else { x + 0.5 };
        assert_eq!(evaluations(pieces, |x| if x > 0.0 { 0.01 } else { 1.0 }), 3);
    }

    #[test]
    fn refused_trials_come_nearer_to_the_base() {
        let mut search = Search::new(FORCING);
        assert_eq!(search.shorten(), None);
        assert_eq!(search.start(vec![1.0], 1.0, vec![8.0], 0.0), [9.0]);
        let trials: Vec<f64> = std::iter::from_fn(|| search.shorten()).flatten().collect();
        assert_eq!(trials, [5.0, 3.0, 2.0]);
    }
}
