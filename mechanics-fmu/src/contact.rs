//! The contact laws of a fracture face and their linearisation.
//!
//! With β > 0, the increment δ⟦u⟧_τ = ⟦u − u^{n−1}⟧_τ, the closure V of a joint and the opening D by mechanical dilation (see
//! `joint.rs`; both 0 in the standard case) the laws are complementarity conditions (method: Alart, Curnier, CMAME 1991; as
//! used by Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024, section 4.3, where V = D = 0):
//!
//! ```text
//! (1)  g = ⟦u⟧_n + D(|⟦u − u⁰⟧_τ|) − V(λ_n)
//! (2)  b_n = λ_n + β g,   b_τ = λ_τ + β δ⟦u⟧_τ
//! (3)  bound = F b_n + cohesion (Coulomb) or fixed (Tresca)
//! (4)  open  (b_n ≤ 0):            λ = 0
//! (5)  stick (|b_τ| ≤ bound):      g = 0,  δ⟦u⟧_τ = 0
//! (6)  slip  (otherwise):          g = 0,  λ_τ = bound b_τ/|b_τ|
//! ```
//!
//! (4) to (6) say g ≤ 0 ≤ λ_n with λ_n g = 0, |λ_τ| ≤ F λ_n + cohesion, and slip only at the bound and along λ_τ. The flow rule
//! is not associated: slip does not take its direction from dilation. What the fracture dissipates in a time step is friction
//! less the work of dilation against compression,
//!
//! ```text
//! (7)  ∫ λ_τ·δ⟦u⟧_τ − ∫ λ_n δD ≥ ∫ (F − tan ψ) λ_n |δ⟦u⟧_τ| ≥ 0   for tan ψ ≤ F,
//! ```
//!
//! so mechanical dilation needs Coulomb friction with F ≥ tan ψ.
//!
//! Tresca's bound and cohesion c end at once where a face opens, and then there may be no equilibrium: closed it would be
//! pulled, open it would overlap. For such a step (and no other) they fade as the pressure does, over a small λ_0 > 0:
//!
//! ```text
//! (8)  bound = F b_n + c min(1, b_n/λ_0),   λ_0 = c/10
//! ```
//!
//! In the limit λ_0 → 0 a face may touch, λ_n = ⟦u⟧_n = 0, under any |λ_τ| ≤ c.
//!
//! All vectors are in the basis (n⁺, t₁, t₂) of the face.

use serde::{Deserialize, Serialize};

use crate::joint::{Closure, Opening};
use crate::model::{Dilation, FractureLaw, Friction};

/// A vector in the basis of a fracture face; in 2D the last component is 0.
pub(crate) type Local = [f64; 3];

/// What a fracture face does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum ContactState {
    /// The sides do not touch: no traction.
    Open = 0,
    /// The sides are in contact and do not move against each other.
    Stick = 1,
    /// The sides are in contact and move against each other, at the bound of friction.
    Slip = 2,
}

/// A fracture face as the contact problem sees it.
#[derive(Clone, Debug)]
pub(crate) struct Face {
    /// Length or area.
    pub(crate) measure: f64,
    /// β (Pa/m).
    pub(crate) beta: f64,
    /// Of the bulk against a jump of this face alone (Pa/m).
    pub(crate) stiffness: f64,
    pub(crate) friction: Friction,
    pub(crate) closure: Closure,
    pub(crate) opening: Opening,
    /// Aperture in contact d_c (m).
    pub(crate) contact_aperture: f64,
    /// Residual aperture d_r (m); `None` where nothing holds the aperture up.
    pub(crate) residual_aperture: Option<f64>,
    /// λ_0 as a part of Tresca's bound or cohesion; `None` where these do not fade.
    pub(crate) fading: Option<f64>,
}

/// How a face's pressure follows its aperture: p_f = p* − S_f (d_f − d*).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct FacePartner {
    /// p* + S_f d* (Pa).
    pub(crate) offset: f64,
    /// S_f ≥ 0 (Pa/m).
    pub(crate) stiffness: f64,
}

/// The law of a face linearised at an increment δ of its jump: corrections of δ that are given, and for each other
/// component i the equation Σ_j T_ij (force of the bulk on the face)_j + Σ_j H_ij (correction)_j + h_i = 0, where the sums
/// run over the components of the face and the force is (S δ)_j − r_j after the correction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Linearised {
    /// The correction of each component that is given; `None` for an unknown.
    pub(crate) given: [Option<f64>; 3],
    /// Where the normal correction is given, what the unknown ones add to it: −∂D/∂⟦u⟧.
    pub(crate) carried: Local,
    pub(crate) t: [Local; 3],
    pub(crate) h: [Local; 3],
    pub(crate) constant: Local,
}

/// A stiffness across the slip that is as good as rigid, as a multiple of that of the bulk. An infinite one, where a slip
/// has only begun, would drown the stiffness along it in single precision.
const RIGID: f64 = 1e4;

/// Length and components (m) of the slip since `origin`.
fn slip(jump: &Local, origin: &Local) -> (f64, [f64; 2]) {
    let components = [jump[1] - origin[1], jump[2] - origin[2]];
    (norm(&components), components)
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// β in series with the fracture where it is softest, so that β ∂V/∂λ_n < 1 and b_n grows with λ_n.
fn in_series(beta: f64, compliance: f64) -> f64 {
    beta / (1.0 + beta * compliance)
}

impl Face {
    /// `stiffness` is that of the bulk against a jump of this face alone (Pa/m), β the part `beta_factor` of it.
    pub(crate) fn new(
        law: &FractureLaw,
        measure: f64,
        stiffness: f64,
        beta_factor: f64,
        contact_aperture: f64,
    ) -> Self {
        let closure = Closure::new(law);
        Self {
            measure,
            beta: in_series(beta_factor * stiffness, closure.largest_compliance()),
            stiffness,
            friction: law.friction,
            closure,
            opening: Opening::new(law),
            contact_aperture,
            residual_aperture: law.kept_aperture(contact_aperture),
            fading: None,
        }
    }

    /// The same face with bounds that fade (λ_0 as a part of them) or not, and with `beta` times the β, for another path to
    /// the same solution.
    pub(crate) fn altered(&self, fading: Option<f64>, beta: f64) -> Self {
        let beta = match beta {
            1.0 => self.beta,
            times => in_series(times * self.beta, self.closure.largest_compliance()),
        };
        Self { beta, fading, ..self.clone() }
    }

    /// Aperture d_f (m), equation (5) or (6) of `joint.rs`, with the slip counted from `origin`.
    pub(crate) fn aperture(&self, jump: &Local, origin: &Local) -> f64 {
        let open = self.free_aperture(jump, origin);
        self.residual_aperture.map_or(open, |residual| open.max(residual))
    }

    /// The aperture (m) if nothing held it up.
    fn free_aperture(&self, jump: &Local, origin: &Local) -> f64 {
        let grows = match self.opening.kind {
            Dilation::Hydraulic => self.opening.at(slip(jump, origin).0),
            Dilation::Mechanical => 0.0,
        };
        self.contact_aperture - jump[0] + grows
    }

    /// ∂d_f/∂⟦u⟧; where there is no slip yet, that in the direction in which it would begin (a unit vector, or 0).
    pub(crate) fn aperture_gradient(&self, jump: &Local, origin: &Local, begins: [f64; 2]) -> Local {
        if self.is_residual(jump, origin) {
            return [0.0; 3];
        }
        match self.opening.kind {
            Dilation::Hydraulic => {
                let [x, y] = self.opening_gradient(jump, origin, begins);
                [-1.0, x, y]
            }
            Dilation::Mechanical => [-1.0, 0.0, 0.0],
        }
    }

    /// Whether the aperture is held up.
    pub(crate) fn is_residual(&self, jump: &Local, origin: &Local) -> bool {
        self.residual_aperture.is_some_and(|residual| self.free_aperture(jump, origin) < residual)
    }

    /// ∂D/∂⟦u⟧_τ; where there is no slip yet, that in the direction in which it would begin.
    fn opening_gradient(&self, jump: &Local, origin: &Local, begins: [f64; 2]) -> [f64; 2] {
        let (length, [x, y]) = slip(jump, origin);
        let direction = if length > 0.0 { [x / length, y / length] } else { begins };
        direction.map(|e| self.opening.rate(length) * e)
    }

    /// D (m) where it is part of non-penetration, else 0.
    pub(crate) fn mechanical_opening(&self, jump: &Local, origin: &Local) -> f64 {
        if self.opening.is_mechanical() { self.opening.at(slip(jump, origin).0) } else { 0.0 }
    }

    /// |λ_τ| may not exceed this (Pa) at the normal multiplier λ_n.
    pub(crate) fn bound(&self, lambda_n: f64) -> f64 {
        let [fixed, slope] = self.bound_parts(lambda_n);
        fixed + slope * lambda_n
    }

    /// The derivative of the bound by λ_n (1).
    pub(crate) fn bound_slope(&self, lambda_n: f64) -> f64 {
        self.bound_parts(lambda_n)[1]
    }

    /// a and k of bound = a + k λ_n (Pa, 1) around a normal multiplier.
    fn bound_parts(&self, lambda_n: f64) -> [f64; 2] {
        let (fixed, slope) = match self.friction {
            Friction::None => (0.0, 0.0),
            Friction::Tresca { bound } => (bound, 0.0),
            Friction::Coulomb { coefficient, cohesion } => (cohesion, coefficient),
        };
        match self.fading {
            Some(part) if lambda_n < part * fixed => [0.0, slope + 1.0 / part],
            _ => [fixed, slope],
        }
    }

    /// Whether the bound drops at once where the face opens.
    pub(crate) fn drops(&self) -> bool {
        self.fading.is_none() && self.bound(0.0) > 0.0
    }

    /// b_n, b_τ of (2) at a jump and a multiplier.
    fn augmented(&self, jump: &Local, lambda: &Local, previous: &Local, origin: &Local) -> Local {
        let beta = self.beta;
        let gap = jump[0] + self.mechanical_opening(jump, origin) - self.closure.at(lambda[0]);
        [lambda[0] + beta * gap, lambda[1] + beta * (jump[1] - previous[1]), lambda[2] + beta * (jump[2] - previous[2])]
    }

    /// The state at a jump, a multiplier, the jump at the previous time and that from which slip counts: (4) to (6).
    pub(crate) fn state(&self, jump: &Local, lambda: &Local, previous: &Local, origin: &Local) -> ContactState {
        // Round-off of b_τ: a face at the bound to this part sticks, where slip has no direction of its own.
        const AT_BOUND: f64 = 1e-12;
        let b = self.augmented(jump, lambda, previous, origin);
        if b[0] <= 0.0 {
            ContactState::Open
        } else if self.friction != Friction::None && norm(&b[1..]) <= self.bound(b[0]) * (1.0 + AT_BOUND) {
            ContactState::Stick
        } else {
            ContactState::Slip
        }
    }

    /// How far jump and multiplier are from the law, as a traction (Pa): the largest component of λ − P(b).
    pub(crate) fn violation(&self, jump: &Local, lambda: &Local, previous: &Local, origin: &Local) -> f64 {
        let b = self.augmented(jump, lambda, previous, origin);
        let mut target = [0.0; 3];
        if b[0] > 0.0 {
            target[0] = b[0];
            let (length, bound) = (norm(&b[1..]), self.bound(b[0]));
            let factor = if length <= bound { 1.0 } else { bound / length };
            target[1] = factor * b[1];
            target[2] = factor * b[2];
        }
        (0..3).map(|c| (lambda[c] - target[c]).abs()).fold(0.0, f64::max)
    }

    /// The law linearised at a jump and a multiplier, in a given state.
    ///
    /// The multiplier is eliminated through |σ| λ = r − S δ − |σ| c n, where c = −S_f d_f is the part of the fracture
    /// pressure that follows the aperture.
    pub(crate) fn linearise(
        &self,
        dim: usize,
        state: ContactState,
        jump: &Local,
        lambda: &Local,
        previous: &Local,
        partner: &FacePartner,
        origin: &Local,
    ) -> Linearised {
        let size = self.measure;
        let mut law = Linearised::default();
        // |σ| c here, and its derivative.
        let follows = -size * partner.stiffness * self.aperture(jump, origin);
        let b = self.augmented(jump, lambda, previous, origin);
        let length = norm(&b[1..]);
        let e = if length > 0.0 { [b[1] / length, b[2] / length] } else { [0.0; 2] };
        let begins = if state == ContactState::Slip { e } else { [0.0; 2] };
        let slope = self.aperture_gradient(jump, origin, begins).map(|g| -size * partner.stiffness * g);
        if state == ContactState::Open {
            for c in 0..dim {
                law.t[c][c] = 1.0;
            }
            (law.h[0], law.constant[0]) = (slope, follows);
            return law;
        }
        // A face that sticks has the dilation that it had; of one that slips it grows with the slip.
        let (closes, gradient) = if !self.opening.is_mechanical() {
            (jump[0], [0.0; 2])
        } else if state == ContactState::Stick {
            (jump[0] + self.mechanical_opening(previous, origin), [0.0; 2])
        } else {
            (jump[0] + self.mechanical_opening(jump, origin), self.opening_gradient(jump, origin, begins))
        };
        match self.closure.tangent(lambda[0]) {
            Some(tangent) => {
                let stiffness = size / tangent.compliance;
                law.t[0][0] = 1.0;
                law.h[0] = slope;
                law.h[0][0] += stiffness;
                (1..dim).for_each(|c| law.h[0][c] += stiffness * gradient[c - 1]);
                law.constant[0] = follows + stiffness * (closes - tangent.offset);
            }
            None => {
                law.given[0] = Some(-closes);
                (1..dim).for_each(|c| law.carried[c] = -gradient[c - 1]);
            }
        }
        if state == ContactState::Stick {
            for c in 1..dim {
                law.given[c] = Some(previous[c] - jump[c]);
            }
            return law;
        }
        // λ_τ = bound e + κ (1 − e eᵀ) δg_τ: the exact derivative of bound b_τ/|b_τ|, solved for λ_τ.
        let ratio = if length > 0.0 { self.bound(b[0]) / length } else { 0.0 };
        let kappa = (self.beta * ratio / (1.0 - ratio)).min(RIGID * self.stiffness);
        let [fixed_bound, f] = self.bound_parts(b[0]);
        for i in 1..dim {
            let ei = e[i - 1];
            law.t[i][i] = 1.0;
            law.t[i][0] = -f * ei;
            law.constant[i] = size * fixed_bound * ei - f * ei * follows;
            for j in 0..dim {
                law.h[i][j] = -f * ei * slope[j];
            }
            for j in 1..dim {
                let across = size * kappa * (f64::from(i == j) - ei * e[j - 1]);
                law.h[i][j] += across;
                law.constant[i] += across * (jump[j] - previous[j]);
            }
        }
        law
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each law broken by itself, and by how much: tractions in units of 1e6 Pa, β = 1e8 Pa/m.
    #[test]
    fn the_violation_tells_how_far_each_law_is_broken() {
        let law = FractureLaw::coulomb(0.5, 1e-4);
        let face = Face::new(&law, 0.5, 1e10, 0.01, 1e-4);
        let previous = [0.0, 0.01, -0.02];
        let shear = 0.34_f64.sqrt();
        let across = 0.5 / 0.26_f64.sqrt();
        use ContactState::{Open, Slip, Stick};
        let cases = [
            ("stuck", [0.0; 3], [1.0, 0.3, 0.1], 0.0, Stick),
            ("slipping along the traction", [0.0, 3e-3, 4e-3], [1.0, 0.3, 0.4], 0.0, Slip),
            ("open", [-1e-3, 2e-3, 1e-3], [0.0; 3], 0.0, Open),
            ("penetrating", [1e-3, 0.0, 0.0], [1.0, 0.1, 0.0], 0.1, Stick),
            ("pulled", [0.0; 3], [-0.2, 0.0, 0.0], 0.2, Open),
            ("open and sheared", [-1e-2, 0.0, 0.0], [0.0, 0.0, 0.3], 0.3, Open),
            ("sheared beyond the bound", [0.0; 3], [1.0, 0.3, 0.5], 0.5 * (1.0 - 0.5 / shear), Slip),
            ("slipping below the bound", [0.0, 0.0, -1e-3], [1.0, 0.1, -0.1], 0.1, Stick),
            ("slipping across the traction", [0.0, 0.0, 1e-3], [1.0, 0.5, 0.0], across * 0.1, Slip),
            ("slipping against the traction", [0.0, -2e-2, 0.0], [1.0, 0.5, 0.0], 1.0, Slip),
        ];
        for (what, slip, lambda, wanted, state) in cases {
            let jump: Local = std::array::from_fn(|c| slip[c] + previous[c]);
            let lambda = lambda.map(|l| 1e6 * l);
            let found = face.violation(&jump, &lambda, &previous, &previous);
            assert!((found - 1e6 * wanted).abs() < 1.0, "{what}: {found}");
            assert_eq!(face.state(&jump, &lambda, &previous, &previous), state, "{what}");
        }
    }
}
