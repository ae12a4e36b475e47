//! The discrete energy estimate of a time step, from what units publish by name.
//!
//! Testing the mechanical equilibrium at tⁿ with δu = uⁿ − uⁿ⁻¹, and the balance of volume with p ∂t, gives two identities
//! (Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024, theorem 4.2), with δ the increment over the time step:
//!
//! ```text
//! mechanics   δE + R_m + friction = external + pressure work            R_m = ½ a(δu, δu) − ∫_Γ λ_n ⟦uⁿ⁻¹⟧_n ≥ 0
//! flow        δS + R_f + Darcy + deformation = sources + boundary + wells + gravity     R_f = ½ |δp|² in the storage norm ≥ 0
//! ```
//!
//! E is the elastic energy ½ a(u, u), that of normal stiffness included; S = ½ ∫ (1/M + φ c_f) p_m² + ½ ∫_Γ c_f d_f p_f²;
//! Darcy the dissipation in the rock, along fractures (conductivity of tⁿ⁻¹) and between them (transmissivity of tⁿ⁻¹);
//! friction ∫_Γ λ_τ·δ⟦u⟧_τ. R_m and R_f are what implicit Euler loses, and what a fracture that closes does not give
//! back. The pressures' work on the rock is ∫ b p_m δ(div u) − ∫_Γ p_f δ⟦u⟧_n, and what the fluid gives to it is
//! ∫ p_m δφ + ∫_Γ p_f δd_f. Without dilation these are the same in a converged time step; then the sum
//!
//! ```text
//! δE + δS + friction + Darcy ≤ external + sources + boundary + wells + gravity
//! ```
//!
//! holds, and right less left side is the *slack* R_m + R_f. With dilation the fluid gives ∫_Γ p_f tan ψ δ|slip| more than
//! the rock's equilibrium sees as work: that part stands in the *transfer error*, pressure work less deformation, and not in
//! the estimate. One unit alone has its own estimate, in which the work of its partner stands on the right side.

use crate::results::{Scalar, Snapshot};

/// The stored energy of which the increment counts.
const ELASTIC: &str = "energy.elastic";
/// What the rock gets from pressures, and what the fluid gives.
const TRANSFER: [&str; 2] = ["energy.pressure_work", "energy.deformation"];
/// Terms of a time step, each with its sign on the right side of the estimate.
const TERMS: [(&str, f64); 12] = [
    ("energy.external_work", 1.0),
    (TRANSFER[0], 1.0),
    ("energy.friction", -1.0),
    ("energy.source", 1.0),
    ("energy.boundary", 1.0),
    ("energy.wells", 1.0),
    ("energy.gravity", 1.0),
    ("energy.storage", -1.0),
    ("energy.matrix_dissipation", -1.0),
    ("energy.fracture_dissipation", -1.0),
    ("energy.exchange_dissipation", -1.0),
    (TRANSFER[1], -1.0),
];
/// Names of what is added.
pub(crate) const SLACK: [&str; 2] = ["energy.slack", "energy.slack_relative"];
const ERROR: &str = "energy.transfer_error";

/// Forms the estimate time step by time step.
#[derive(Clone, Debug, Default)]
pub struct EnergyEstimate {
    /// Elastic energy (J) at the end of the last time step; `None` before the start.
    elastic: Option<f64>,
    /// Largest term (J) of all time steps up to now.
    largest: f64,
}

impl EnergyEstimate {
    /// Takes note of the scalars of the start, or of the time step after the last one seen; gives right less left side of
    /// the estimate with the transfer error in it, R_m + R_f. `None` where no terms are published.
    pub fn see(&mut self, scalars: &[Scalar]) -> Option<f64> {
        let find = |name: &str| value(scalars, name);
        let mut terms: Vec<f64> = TERMS.iter().filter_map(|(name, sign)| Some(sign * find(name)?)).collect();
        if terms.is_empty() {
            return None;
        }
        let elastic = find(ELASTIC).unwrap_or(0.0);
        terms.push(self.elastic.unwrap_or(elastic) - elastic);
        self.elastic = Some(elastic);
        self.largest = terms.iter().fold(self.largest, |m, t| m.max(t.abs()));
        Some(terms.iter().sum())
    }

    /// Sees a snapshot and adds to its scalars `energy.slack` in the unit of the terms (J; in 2D J/m),
    /// `energy.slack_relative`, its part of the largest term of all time steps up to now (as coupling fields converge
    /// relative to their range up to now), and, where two units exchange work, `energy.transfer_error`. Nothing where no
    /// terms are published.
    pub fn add(&mut self, snapshot: &mut Snapshot) {
        let Some(losses) = self.see(&snapshot.scalars) else { return };
        let transfer = TRANSFER.map(|name| value(&snapshot.scalars, name));
        let error = if let [Some(work), Some(given)] = transfer { Some(work - given) } else { None };
        let slack = losses - error.unwrap_or(0.0);
        let relative = if self.largest > 0.0 { slack / self.largest } else { 0.0 };
        let is_term = |s: &&Scalar| TERMS.iter().any(|(name, _)| s.name == *name);
        let unit = snapshot.scalars.iter().find(is_term).map_or_else(String::new, |s| s.unit.clone());
        snapshot.scalars.push(Scalar::new(SLACK[0], unit.clone(), slack));
        snapshot.scalars.push(Scalar::new(SLACK[1], "1", relative));
        snapshot.scalars.extend(error.map(|error| Scalar::new(ERROR, unit, error)));
    }
}

fn value(scalars: &[Scalar], name: &str) -> Option<f64> {
    scalars.iter().find(|s| s.name == name).map(|s| s.value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot(terms: &[(&str, f64)]) -> Snapshot {
        let scalars = terms.iter().map(|(name, value)| Scalar::new(*name, "J", *value)).collect();
        Snapshot { time: 0.0, scalars, arrays: Vec::new() }
    }

    fn added(estimate: &mut EnergyEstimate, terms: &[(&str, f64)]) -> Vec<f64> {
        let mut snapshot = snapshot(terms);
        estimate.add(&mut snapshot);
        snapshot.scalars[terms.len()..].iter().map(|s| s.value).collect()
    }

    /// A spring of 2 N/m that is pulled from 1 m to 3 m by its end force of 6 N: work 12 J, gain 8 J, ½ k δ² = 4 J lost.
    #[test]
    fn a_spring_alone() {
        let mut estimate = EnergyEstimate::default();
        let spring =
            |elastic, work| [("energy.elastic", elastic), ("energy.external_work", work), ("energy.friction", 0.0)];
        assert_eq!(added(&mut estimate, &spring(1.0, 0.0)), [0.0, 0.0]);
        assert_eq!(added(&mut estimate, &spring(9.0, 12.0)), [4.0, 4.0 / 12.0]);
        // Relative to the largest term up to now.
        assert_eq!(added(&mut estimate, &spring(9.0, 0.0)), [0.0, 0.0]);
        assert_eq!(added(&mut estimate, &spring(10.0, 0.0)), [-1.0, -1.0 / 12.0]);
    }

    #[test]
    fn the_slack_has_the_unit_of_the_terms() {
        let mut plane =
            Snapshot { time: 0.0, scalars: vec![Scalar::new("energy.friction", "J/m", 1.0)], arrays: vec![] };
        EnergyEstimate::default().add(&mut plane);
        assert_eq!(plane.scalars.iter().map(|s| s.unit.as_str()).collect::<Vec<_>>(), ["J/m", "J/m", "1"]);
    }

    /// What one unit gives is what the other gets, up to the transfer error, which is no part of the slack.
    #[test]
    fn two_units() {
        let mut estimate = EnergyEstimate::default();
        let terms = |work, given| {
            [
                ("energy.elastic", 0.0),
                ("energy.external_work", 0.0),
                ("energy.pressure_work", work),
                ("energy.friction", 3.0),
                ("energy.deformation", given),
                ("energy.wells", 10.0),
                ("energy.storage", 1.0),
                ("energy.matrix_dissipation", 2.0),
            ]
        };
        let found = added(&mut estimate, &terms(5.0, 5.0));
        assert_eq!(found, [4.0, 0.4, 0.0]);
        let found = added(&mut estimate, &terms(5.5, 5.0));
        assert_eq!(found, [4.0, 0.4, 0.5]);
    }

    /// An estimate that has seen the same snapshots goes on in the same way.
    #[test]
    fn it_goes_on_from_what_was_recorded() {
        let terms = [("energy.elastic", 4.0), ("energy.external_work", 7.0)];
        let mut first = EnergyEstimate::default();
        let mut recorded = snapshot(&terms);
        first.add(&mut recorded);
        let mut second = EnergyEstimate::default();
        second.see(&recorded.scalars);
        let next = [("energy.elastic", 5.0), ("energy.external_work", 1.5)];
        assert_eq!(added(&mut first, &next), added(&mut second, &next));
        assert!(added(&mut first, &[("aperture.mean", 1.0)]).is_empty());
    }
}
