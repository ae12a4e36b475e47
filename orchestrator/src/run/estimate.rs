//! The error of a pass, however its x was made.
//!
//! Near the solution x*, G is linear, and the residual r = G(x) − x is (I − G′) e with the error e = x* − x. What r leaves
//! unsaid is how much I − G′ makes of an error: .0002 where the split contracts by .9998 in a pass. The changes from each pass
//! to the next show it in the directions between them, −Δr = (I − G′) Δx. What of r is a combination of them, the error is of
//! their images, as in the step of a quasi-Newton method (`acceleration`):
//!
//! ```text
//! x* − G(x) ≈ Σ c ΔG,    c minimising |r + Σ c Δr|,    ΔG = Δx + Δr
//! ```
//!
//! All passes of an attempt count, since over the last two alone a mode that an acceleration has just stirred up hides one that
//! hardly contracts. But in that norm all fields count alike, and what is left in one may lie below the round-off of another.
//! So each field that is iterated is asked for its own contraction too, as if r were like its last change:
//!
//! ```text
//! |x* − G(x)| ≈ |ΔG| |r| / |Δr|
//! ```
//!
//! For a plain iteration of contraction ρ both are ρ/(1 − ρ) |r|. Each entry has the larger one. A field whose residual has grown beyond
//! all before is on its way in a direction that no pass has gone in yet, as a pressure in the pass after a load has reached the other
//! unit: it may contract as slowly as anything. All in the first pass of a time step stays unseen. A step of
//! Newton's method goes in all directions that GMRES has seen: after it only a field that it has left where it was counts as unknown.

use super::Fields;
use crate::acceleration::Difference;

/// So many changes are looked at, the newest ones: as many as there are modes to be told apart.
const CHANGES: usize = 12;
/// No contraction that is seen is taken for slower: residuals that do not shrink any more are round-off.
const SLOWEST: f64 = 0.9999;
/// Errors in a direction that is not known are taken to be so many times the residual: as much as round-off of the units,
/// which goes in all directions, allows.
const UNKNOWN: f64 = 1e3;

/// The last passes of an attempt at a time step.
#[derive(Default)]
pub(super) struct Estimate {
    /// What each made, and its residual; the newest first.
    passes: Vec<[Fields; 2]>,
}

impl Estimate {
    /// Takes note of a pass.
    pub(super) fn see(&mut self, fields: &Fields, residual: &Fields, newton: bool) {
        self.passes.truncate(if newton { 1 } else { CHANGES });
        self.passes.insert(0, [fields.clone(), residual.clone()]);
    }

    /// The error of each of the fields that the last pass made, up to its sign; none in the first pass. The next pass depends on
    /// the fields `used`; all others go with these together. The norm has a `weight` for each field. After a step of Newton's method
    /// only directions that it has not gone in have one.
    pub(super) fn error(&self, used: &[usize], weight: &dyn Fn(usize) -> f64, newton: bool) -> Option<Fields> {
        let [[fields, residual], [before, last], ..] = &self.passes[..] else { return None };
        let (grown, change) = (difference(fields, before), difference(residual, last));
        let step = difference(&grown, &change);
        let norm = |of: &Fields, fields: &[usize]| {
            let entries = fields.iter().flat_map(|&f| of[f].iter().map(move |v| v * weight(f)));
            entries.map(|v| v * v).sum::<f64>().sqrt()
        };
        let largest = |size: f64| size / (1.0 - SLOWEST);
        let mut error = if newton { zeros(fields) } else { self.together(used, weight) };
        if !newton {
            let (size, most) = (norm(&error, used), largest(norm(residual, used)));
            if size > most {
                error.iter_mut().flatten().for_each(|e| *e *= most / size);
            }
        }
        for (f, error) in error.iter_mut().enumerate() {
            let own = [f];
            let of = if used.contains(&f) { &own[..] } else { used };
            let size = norm(residual, of);
            let is_new = used.contains(&f)
                && self.passes[1..].iter().all(|[_, earlier]| size >= norm(earlier, of))
                && (!newton || size >= UNKNOWN * norm(&step, of));
            let by: Vec<f64> = if is_new {
                residual[f].iter().map(|r| UNKNOWN * r).collect()
            } else if newton {
                continue;
            } else {
                let factor = size / norm(&change, of).max(size / largest(1.0)).max(f64::MIN_POSITIVE);
                grown[f].iter().map(|g| factor * g).collect()
            };
            error.iter_mut().zip(by).for_each(|(e, by)| *e = e.abs().max(by.abs()));
        }
        Some(error)
    }

    /// The error by all changes.
    fn together(&self, used: &[usize], weight: &dyn Fn(usize) -> f64) -> Fields {
        let flat = |fields: &Fields, residual: &Fields| Difference {
            x: fields.concat(),
            r: used.iter().flat_map(|&f| residual[f].iter().map(move |r| r * weight(f))).collect(),
        };
        let changes: Vec<Difference> = (self.passes.windows(2))
            .map(|pair| flat(&difference(&pair[0][0], &pair[1][0]), &difference(&pair[0][1], &pair[1][1])))
            .collect();
        let [fields, residual] = &self.passes[0];
        let mut error = zeros(fields);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum();
        let found = flat(&error, residual).least(changes.iter(), dot).x;
        error.iter_mut().flatten().zip(found).for_each(|(e, found)| *e = found);
        error
    }
}

fn zeros(like: &Fields) -> Fields {
    like.iter().map(|field| vec![0.0; field.len()]).collect()
}

fn difference(a: &Fields, b: &Fields) -> Fields {
    a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mode of contraction .9998 beside a fast one, and a field that goes with them but is not iterated.
    #[test]
    fn a_slow_mode_is_seen_once_the_fast_one_is_gone() {
        let rho = [0.1, 0.9998];
        for omega in [1.0, 0.5, 1.05] {
            let (mut estimate, mut error) = (Estimate::default(), None);
            let (mut x, mut y) = ([1.0, 1.0], 0.0);
            for k in 0..80 {
                let image = [0, 1].map(|i| rho[i] * x[i]);
                let r = [0, 1].map(|i| image[i] - x[i]);
                let fields = vec![image.to_vec(), vec![5.0 * x[1]]];
                estimate.see(&fields, &vec![r.to_vec(), vec![5.0 * x[1] - y]], false);
                error = estimate.error(&[0], &|_| 1.0, false);
                assert_eq!(error.is_some(), k > 0);
                (x, y) = ([0, 1].map(|i| x[i] + omega * r[i]), 5.0 * x[1]);
            }
            // The solution is 0, and x is one step further than the last pass.
            let error = error.unwrap();
            let last = x[1] / (1.0 + omega * (rho[1] - 1.0));
            assert!((error[0][1].abs() / (rho[1] * last) - 1.0).abs() < 1e-6, "{omega}: {error:?}");
            assert!((error[1][0].abs() / (5.0 * last) - 1.0).abs() < 1e-3, "{omega}: {error:?}");
        }
    }

    /// As Aitken's relaxation does: a step that takes much of the slow mode away stirs up a fast one, behind which the last two passes do
    /// not show it.
    #[test]
    fn a_slow_mode_is_not_forgotten_behind_a_fast_one() {
        let rho = [0.3, 0.98];
        let (mut estimate, mut x, mut r) = (Estimate::default(), [1.0, 1.0], [0.0, 0.0]);
        for omega in [1.0, 1.0, 1.0, 1.0, 1.0, 40.0, 1.0, 1.0] {
            let image = [0, 1].map(|i| rho[i] * x[i]);
            r = [0, 1].map(|i| image[i] - x[i]);
            estimate.see(&vec![image.to_vec()], &vec![r.to_vec()], false);
            x = [0, 1].map(|i| x[i] + omega * r[i]);
        }
        // The solution is 0, and x is the last image.
        assert!(r[0].abs() > 3.0 * r[1].abs() && x[1].abs() > 20.0 * x[0].abs());
        let error = &estimate.error(&[0], &|_| 1.0, false).unwrap()[0];
        assert!((error[1] / x[1].abs() - 1.0).abs() < 1e-6 && error[0] >= x[0].abs(), "{error:?} {x:?}");
    }

    /// A residual that stays as it is does not make an endless error, and none makes none.
    #[test]
    fn round_off_is_not_amplified_without_end() {
        let after = |r: [f64; 2]| {
            let mut estimate = Estimate::default();
            estimate.see(&vec![vec![1.0]], &vec![vec![r[0]]], false);
            estimate.see(&vec![vec![1.0 + r[0]]], &vec![vec![r[1]]], false);
            estimate.error(&[0], &|_| 1.0, false).unwrap()[0][0]
        };
        assert!((after([1e-12, 1e-12 - 1e-20]) / 1e-8 - 1.0).abs() < 1e-3);
        assert!((after([1e-12, 1e-12]) / 1e-9 - 1.0).abs() < 1e-3);
        assert_eq!(after([0.0, 0.0]), 0.0);
    }
}
