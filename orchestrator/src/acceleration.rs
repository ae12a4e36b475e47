//! Acceleration of the fixed-point iteration x ← G(x) with the residual r = G(x) − x.
//!
//! | method | next iterate | source |
//! |---|---|---|
//! | none | x + r | |
//! | relaxation | x + ω r | |
//! | Aitken | x + ω_k r_k, ω_k = −ω_{k−1} r_{k−1}·Δr_k/\|Δr_k\|², Δr_k = r_k − r_{k−1} | Irons, Tuck 1969; Küttler, Wall 2008 (44) |
//! | Anderson(m) | x + β r + Σ_j c_j (Δx_j + β Δr_j), c minimising \|r + Σ_j c_j Δr_j\|, the last m differences | Walker, Ni 2011 |
//! | IQN-ILS | the same with β = 1 and all differences of this time step and the last few | Degroote, Bathe, Vierendeels 2009 |
//!
//! Anderson's mixing and IQN-ILS are one algorithm (Degroote's V and W are Δr and Δx + Δr); they differ in which
//! differences they keep. The norm weighs every entry by the inverse of its field's scale, so that pressures and
//! apertures count alike.

use model::Acceleration;
use serde::{Deserialize, Serialize};

/// A difference is left out of the least squares where less than this part of it is new to those before it (the
/// filter "QR2" of Haelterman, Bogaers, Scheufele, Uekermann, Mehl, Comput. Struct. 171, 2016): some way above the
/// round-off of the units' solvers.
const NEW: f64 = 1e-6;

/// What is kept from iteration to iteration, and, for IQN-ILS, from time step to time step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Accelerator {
    omega: f64,
    last: Option<Difference>,
    /// Of this time step, newest first.
    differences: Vec<Difference>,
    /// Of earlier time steps, the newest first.
    earlier: Vec<Vec<Difference>>,
}

/// x and r, or a change of both.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Difference {
    pub(crate) x: Vec<f64>,
    pub(crate) r: Vec<f64>,
}

impl Accelerator {
    /// Starts a time step, or tries it again.
    pub(crate) fn begin(&mut self) {
        self.last = None;
        self.differences.clear();
    }

    /// A time step was accepted: its differences may be used in the next ones.
    pub(crate) fn accept(&mut self, method: Acceleration) {
        if let Acceleration::IqnIls { reuse, .. } = method {
            // A time step that took one iteration has nothing to offer.
            if !self.differences.is_empty() {
                self.earlier.insert(0, std::mem::take(&mut self.differences));
            }
            self.earlier.truncate(reuse);
        }
        self.begin();
    }

    /// Replaces x by the next iterate.
    pub(crate) fn next(&mut self, method: Acceleration, x: &mut [f64], r: Vec<f64>, weights: &[f64]) {
        let dot =
            |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).zip(weights).map(|((a, b), w)| (a * w) * (b * w)).sum() };
        let add = |x: &mut [f64], factor: f64, r: &[f64]| x.iter_mut().zip(r).for_each(|(x, r)| *x += factor * r);
        let here = Difference { x: x.to_vec(), r };
        let change = self.last.as_ref().map(|last| Difference {
            x: here.x.iter().zip(&last.x).map(|(a, b)| a - b).collect(),
            r: here.r.iter().zip(&last.r).map(|(a, b)| a - b).collect(),
        });
        match method {
            // Newton's method needs the units: see `run`. Without them there is the split.
            Acceleration::None | Acceleration::NewtonKrylov { .. } => add(x, 1.0, &here.r),
            Acceleration::Relaxation { factor } => add(x, factor.0, &here.r),
            Acceleration::Aitken { initial } => {
                self.omega = match (&self.last, &change) {
                    (Some(last), Some(change)) => {
                        let length = dot(&change.r, &change.r);
                        if length > 0.0 { -self.omega * dot(&last.r, &change.r) / length } else { self.omega }
                    }
                    _ => initial.0,
                };
                add(x, self.omega, &here.r);
            }
            Acceleration::Anderson { depth, mixing } => {
                self.differences.splice(0..0, change);
                self.differences.truncate(depth);
                self.quasi_newton(x, &here.r, mixing.0, dot);
            }
            Acceleration::IqnIls { initial, .. } => {
                self.differences.splice(0..0, change);
                let known = !self.differences.is_empty() || self.earlier.iter().any(|step| !step.is_empty());
                self.quasi_newton(x, &here.r, if known { 1.0 } else { initial.0 }, dot);
            }
        }
        self.last = Some(here);
    }

    fn quasi_newton(&self, x: &mut [f64], r: &[f64], mixing: f64, dot: impl Fn(&[f64], &[f64]) -> f64) {
        let columns = self.differences.iter().chain(self.earlier.iter().flatten());
        let rest = Difference { x: x.to_vec(), r: r.to_vec() }.least(columns, dot);
        for (x, (a, b)) in x.iter_mut().zip(rest.x.iter().zip(&rest.r)) {
            *x = a + mixing * b;
        }
    }
}

impl Difference {
    /// x and r with the multiple of each column added that makes r the least in the norm of `dot`. Columns that are all but combinations
    /// of those before them, or of another length, are left out.
    pub(crate) fn least<'a>(
        mut self,
        columns: impl Iterator<Item = &'a Self>,
        dot: impl Fn(&[f64], &[f64]) -> f64,
    ) -> Self {
        // Modified Gram-Schmidt; what each direction does to x and r goes along.
        let mut basis: Vec<Self> = Vec::new();
        for column in columns.filter(|c| c.r.len() == self.r.len()) {
            let mut rest = column.clone();
            let length = dot(&rest.r, &rest.r).sqrt();
            for q in &basis {
                rest.subtract(dot(&q.r, &rest.r), q);
            }
            let left = dot(&rest.r, &rest.r).sqrt();
            if left > NEW * length {
                rest.x.iter_mut().chain(&mut rest.r).for_each(|v| *v /= left);
                basis.push(rest);
            }
        }
        for q in &basis {
            self.subtract(dot(&q.r, &self.r), q);
        }
        self
    }

    fn subtract(&mut self, factor: f64, other: &Self) {
        self.x.iter_mut().zip(&other.x).for_each(|(a, b)| *a -= factor * b);
        self.r.iter_mut().zip(&other.r).for_each(|(a, b)| *a -= factor * b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Number;

    /// x ← A x + b with a known solution; gives the number of evaluations until |r| < 1e-10.
    fn evaluations(method: Acceleration, a: &[&[f64]], steps: usize) -> Vec<usize> {
        let mut accelerator = Accelerator::default();
        let n = a.len();
        (0..steps)
            .map(|step| {
                let solution: Vec<f64> = (0..n).map(|i| 1.0 + (i + step) as f64).collect();
                let image = |x: &[f64], i: usize| -> f64 { (0..n).map(|j| a[i][j] * (x[j] - solution[j])).sum() };
                let mut x = vec![0.0; n];
                accelerator.begin();
                for k in 1..200 {
                    let r: Vec<f64> = (0..n).map(|i| solution[i] + image(&x, i) - x[i]).collect();
                    if r.iter().all(|r| r.abs() < 1e-10) {
                        accelerator.accept(method);
                        return k;
                    }
                    accelerator.next(method, &mut x, r, &vec![1.0; n]);
                }
                200
            })
            .collect()
    }

    const SCALAR: &[&[f64]] = &[&[-3.0]];
    const THREE: &[&[f64]] = &[&[0.5, 0.2, 0.0], &[0.1, -2.0, 0.3], &[0.0, 0.4, 0.9]];
    const ONE: Number = Number(1.0);

    #[test]
    fn linear_problems_take_the_known_number() {
        // The plain iteration diverges for both.
        assert_eq!(evaluations(Acceleration::None, SCALAR, 1), [200]);
        // Relaxation by 1/(1 − a) is exact for a scalar.
        assert_eq!(evaluations(Acceleration::Relaxation { factor: Number(0.25) }, SCALAR, 1), [2]);
        // Two evaluations give the slope; the third confirms.
        assert_eq!(evaluations(Acceleration::Aitken { initial: Number(0.1) }, SCALAR, 1), [3]);
        assert_eq!(evaluations(Acceleration::Anderson { depth: 1, mixing: ONE }, SCALAR, 1), [3]);
        // n differences span the space: n + 1 evaluations, and one confirms.
        for mixing in [1.0, 0.3] {
            assert_eq!(evaluations(Acceleration::Anderson { depth: 3, mixing: Number(mixing) }, THREE, 1), [5]);
        }
        assert!(evaluations(Acceleration::Anderson { depth: 1, mixing: ONE }, THREE, 1)[0] > 5);
        assert_eq!(evaluations(Acceleration::IqnIls { reuse: 0, initial: Number(0.5) }, THREE, 2), [5, 5]);
    }

    #[test]
    fn reuse_of_earlier_steps_is_exact_from_the_second_on() {
        assert_eq!(evaluations(Acceleration::IqnIls { reuse: 3, initial: Number(0.5) }, THREE, 4), [5, 2, 2, 2]);
        // Those of the first time step stay: the later ones, of one iteration each, have none to replace them.
        assert_eq!(evaluations(Acceleration::IqnIls { reuse: 1, initial: Number(0.5) }, THREE, 4), [5, 2, 2, 2]);
    }

    #[test]
    fn weights_make_units_of_measure_not_matter() {
        let run = |scale: f64| {
            let mut accelerator = Accelerator::default();
            let mut x = vec![0.0, 0.0];
            for _ in 0..3 {
                // A nonlinear map of (u, v/scale).
                let (u, v) = (x[0], x[1] / scale);
                let r = vec![(0.3 * v * v + 1.0) - u, ((0.5 * u).sin() - v) * scale];
                let method = Acceleration::Anderson { depth: 1, mixing: ONE };
                accelerator.next(method, &mut x, r, &[1.0, 1.0 / scale]);
            }
            [x[0], x[1] / scale]
        };
        let (a, b) = (run(1.0), run(1e6));
        assert!((a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-12, "{a:?} {b:?}");
    }
}
