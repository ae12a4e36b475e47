//! What a joint does across itself: how it closes under compression, how slip makes it open, and its aperture.
//!
//! With the closure V, the opening by dilation D, and the slip s = |⟦u − u⁰⟧_τ| since the initial state:
//!
//! ```text
//! (1)  V(λ_n) = 0                          rigid
//! (2)  V(λ_n) = λ_n/k_n                    linear
//! (3)  V(λ_n) = λ_n/(k_n + λ_n/V_m)        hyperbolic: λ_n = k_n V/(1 − V/V_m)
//! (4)  D(s) = min(s tan ψ, D_m)
//! (5)  d_f = max(d_c − ⟦u⟧_n + D(s), d_r)  dilation of the aperture alone (hydraulic)
//! (6)  d_f = max(d_c − ⟦u⟧_n, d_r)         dilation that moves the sides (mechanical)
//! ```
//!
//! (3) is due to Bandis, Lumsden, Barton, IJRMMS 20, 1983: k_n is the stiffness at no stress (their K_ni) and V_m the largest
//! closure. (4) is the envelope of Plesha, IJNAMG 11, 1987, for asperities of one angle that slip past each other or shear off.
//!
//! Mechanical dilation makes non-penetration ⟦u⟧_n + D(s) ≤ V(λ_n) (see [`crate::contact`]); hydraulic dilation leaves the rock
//! where it is. The residual aperture d_r is that of the channels which stay open between sides in contact: it holds up the
//! aperture that the fluid sees, not the sides.

use crate::model::{Dilation, FractureLaw};

/// The closure of a joint in contact as a function of the normal multiplier λ_n.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Closure {
    /// (1).
    Rigid,
    /// (2).
    Linear {
        /// 1/k_n (m/Pa).
        compliance: f64,
    },
    /// (3).
    Hyperbolic {
        /// k_n (Pa/m) at λ_n = 0.
        stiffness: f64,
        /// V_m (m).
        largest: f64,
    },
}

/// The closure near a normal multiplier: λ_n = (V − offset)/compliance to first order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClosureTangent {
    /// ∂V/∂λ_n > 0 (m/Pa).
    pub(crate) compliance: f64,
    /// V − λ_n ∂V/∂λ_n (m).
    pub(crate) offset: f64,
}

impl Closure {
    pub(crate) fn new(law: &FractureLaw) -> Self {
        match (law.normal_stiffness, law.largest_closure) {
            (None, _) => Self::Rigid,
            (Some(k), None) => Self::Linear { compliance: 1.0 / k },
            (Some(stiffness), Some(largest)) => Self::Hyperbolic { stiffness, largest },
        }
    }

    /// V(λ_n) (m); below λ_n = 0 its tangent there, so that complementarity functions stay monotone.
    pub(crate) fn at(&self, lambda_n: f64) -> f64 {
        match *self {
            Self::Rigid => 0.0,
            Self::Linear { compliance } => compliance * lambda_n,
            Self::Hyperbolic { stiffness, largest } => lambda_n / (stiffness + lambda_n.max(0.0) / largest),
        }
    }

    /// ∂V/∂λ_n (m/Pa) where it is largest, at λ_n = 0.
    pub(crate) fn largest_compliance(&self) -> f64 {
        match *self {
            Self::Rigid => 0.0,
            Self::Linear { compliance } => compliance,
            Self::Hyperbolic { stiffness, .. } => 1.0 / stiffness,
        }
    }

    /// The tangent at λ_n; `None` where rigid.
    pub(crate) fn tangent(&self, lambda_n: f64) -> Option<ClosureTangent> {
        match *self {
            Self::Rigid => None,
            Self::Linear { compliance } => Some(ClosureTangent { compliance, offset: 0.0 }),
            Self::Hyperbolic { stiffness, largest } => {
                let pressed = lambda_n.max(0.0);
                let secant = stiffness + pressed / largest;
                let offset = (pressed / secant).powi(2) / largest;
                Some(ClosureTangent { compliance: stiffness / (secant * secant), offset })
            }
        }
    }

    /// The energy ∫₀^V λ_n dV (J/m²) that the joint holds at λ_n ≥ 0.
    pub(crate) fn energy(&self, lambda_n: f64) -> f64 {
        match *self {
            Self::Rigid => 0.0,
            Self::Linear { compliance } => 0.5 * lambda_n * lambda_n * compliance,
            Self::Hyperbolic { stiffness, largest } => {
                // k_n V_m² (−x − ln(1 − x)) with x = V/V_m; 1/(1 − x) = 1 + λ_n/(k_n V_m).
                let pressed = lambda_n.max(0.0) / (stiffness * largest);
                stiffness * largest * largest * (pressed.ln_1p() - pressed / (1.0 + pressed))
            }
        }
    }
}

/// How slip opens a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Opening {
    /// Whether the sides move apart, or the aperture alone grows.
    pub(crate) kind: Dilation,
    /// tan ψ.
    slope: f64,
    /// D_m (m), infinite for none.
    limit: f64,
}

impl Opening {
    pub(crate) fn new(law: &FractureLaw) -> Self {
        let limit = law.dilation_limit.unwrap_or(f64::INFINITY);
        Self { kind: law.dilation, slope: law.dilation_angle.tan(), limit }
    }

    /// The same joint without dilation.
    pub(crate) fn without(self) -> Self {
        Self { slope: 0.0, ..self }
    }

    /// D(s) (m).
    pub(crate) fn at(&self, slip: f64) -> f64 {
        (self.slope * slip).min(self.limit)
    }

    /// ∂D/∂s (1).
    pub(crate) fn rate(&self, slip: f64) -> f64 {
        if self.slope * slip < self.limit { self.slope } else { 0.0 }
    }

    /// Whether D is part of non-penetration.
    pub(crate) fn is_mechanical(&self) -> bool {
        self.kind == Dilation::Mechanical && self.slope > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HYPERBOLA: Closure = Closure::Hyperbolic { stiffness: 2e10, largest: 5e-5 };

    /// λ_n = k_n V/(1 − V/V_m), as the authors write it.
    #[test]
    fn the_hyperbola_is_that_of_bandis() {
        for closure in [1e-9, 1e-6, 1e-5, 4e-5, 4.99e-5] {
            let lambda = 2e10 * closure / (1.0 - closure / 5e-5);
            assert!((HYPERBOLA.at(lambda) - closure).abs() < 1e-12 * closure, "{closure}");
        }
        assert!(HYPERBOLA.at(1e12) < 5e-5 && HYPERBOLA.at(-1e6) == -5e-5);
    }

    /// The tangent against differences, and the energy against Simpson's rule over λ_n dV.
    #[test]
    fn tangents_and_energies_are_those_of_the_closure() {
        for law in [Closure::Linear { compliance: 5e-11 }, HYPERBOLA] {
            for lambda in [1e3, 1e5, 1e6, 2e7] {
                let step = 1e-4 * lambda;
                let difference = (law.at(lambda + step) - law.at(lambda - step)) / (2.0 * step);
                let tangent = law.tangent(lambda).unwrap();
                assert!((tangent.compliance / difference - 1.0).abs() < 1e-7, "{law:?} at {lambda}: {tangent:?}");
                let line = tangent.offset + tangent.compliance * lambda;
                assert!((line / law.at(lambda) - 1.0).abs() < 1e-12, "{law:?} at {lambda}: {tangent:?}");
                let n = 2000;
                let traction = |k: usize| lambda * k as f64 / n as f64;
                let energy: f64 = (0..n)
                    .map(|k| {
                        let middle = 0.5 * (traction(k) + traction(k + 1));
                        middle * (law.at(traction(k + 1)) - law.at(traction(k)))
                    })
                    .sum();
                let found = law.energy(lambda);
                assert!((found / energy - 1.0).abs() < 1e-5, "{law:?} at {lambda}: {found}, not {energy}");
            }
        }
    }
}
