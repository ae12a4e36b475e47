//! The error of a pass, however its x was made.
//!
//! Near the solution x*, G is linear, and the residual r = G(x) − x is (I − G′) e with the error e = x* − x. What r leaves
//! unsaid is how much I − G′ makes of an error: .0002 where the split contracts by .9998 in a pass. Two passes show it in the
//! direction between them, −Δr = (I − G′) Δx, and if that of r is like it
//!
//! ```text
//! |x* − G(x)| ≈ |ΔG| |r| / |Δr|,    ΔG = Δx + Δr
//! ```
//!
//! For a plain iteration of contraction ρ that is ρ/(1 − ρ) |r|. A field whose residual has grown is on its way in a direction that
//! no pass has gone in yet, as a pressure in the pass after a load has reached the other unit: it may contract as slowly as
//! anything. Within a field such directions stay unseen until its faster modes have died out, and so does
//! everything in the first pass of a time step. A step of Newton's method goes in all directions that GMRES has seen: after it
//! only a field that it has left where it was counts as unknown.

use super::Fields;

/// No contraction that is seen is taken for slower: residuals that do not shrink any more are round-off.
const SLOWEST: f64 = 0.9999;
/// Errors in a direction that is not known are taken to be so many times the residual: as much as round-off of the units,
/// which goes in all directions, allows.
const UNKNOWN: f64 = 1e3;

/// The last pass of an attempt at a time step.
#[derive(Default)]
pub(super) struct Estimate {
    last: Option<[Fields; 2]>,
}

impl Estimate {
    /// The error of each of the fields that a pass made, up to its sign, from their residual and what the last pass made; none in
    /// the first pass. The next pass depends on the fields `used`, of which each has its own contraction; all others go with
    /// these together, in the norm with a `weight` for each. After a step of Newton's method only directions that it has
    /// not gone in have one.
    pub(super) fn see(
        &mut self,
        fields: &Fields,
        residual: &Fields,
        used: &[usize],
        weight: &dyn Fn(usize) -> f64,
        newton: bool,
    ) -> Option<Fields> {
        let now = [fields.clone(), residual.clone()];
        let [before, last] = self.last.replace(now)?;
        let (grown, change) = (difference(fields, &before), difference(residual, &last));
        let step = difference(&grown, &change);
        let norm = |of: &Fields, fields: &[usize]| {
            let entries = fields.iter().flat_map(|&f| of[f].iter().map(move |v| v * weight(f)));
            entries.map(|v| v * v).sum::<f64>().sqrt()
        };
        let error = |f: usize| -> Vec<f64> {
            let own = [f];
            let of = if used.contains(&f) { &own[..] } else { used };
            let size = norm(residual, of);
            let is_new = size >= norm(&last, of) && (!newton || size >= UNKNOWN * norm(&step, of));
            if is_new && used.contains(&f) {
                return residual[f].iter().map(|r| UNKNOWN * r).collect();
            }
            let factor = size / norm(&change, of).max((1.0 - SLOWEST) * size).max(f64::MIN_POSITIVE);
            grown[f].iter().map(|g| if newton { 0.0 } else { factor * g }).collect()
        };
        Some((0..fields.len()).map(error).collect())
    }
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
                error = estimate.see(&fields, &vec![r.to_vec(), vec![5.0 * x[1] - y]], &[0], &|_| 1.0, false);
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

    /// A residual that stays as it is does not make an endless error, and none makes none.
    #[test]
    fn round_off_is_not_amplified_without_end() {
        let after = |r: [f64; 2]| {
            let mut estimate = Estimate::default();
            estimate.see(&vec![vec![1.0]], &vec![vec![r[0]]], &[0], &|_| 1.0, false);
            estimate.see(&vec![vec![1.0 + r[0]]], &vec![vec![r[1]]], &[0], &|_| 1.0, false).unwrap()[0][0]
        };
        assert!((after([1e-12, 1e-12 - 1e-20]) / 1e-8 - 1.0).abs() < 1e-3);
        assert!((after([1e-12, 1e-12]) / 1e-9 - 1.0).abs() < 1e-3);
        assert_eq!(after([0.0, 0.0]), 0.0);
    }
}
