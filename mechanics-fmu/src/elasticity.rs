//! The stiffness of a cell: linear elasticity on the functions of [`CellOperators`].
//!
//! ```text
//! a_K(u,v) = |K| (2μ ε:ε + λ div div) + s_K S_K(u,v) + 2 c μ |K|^{(d−2)/d} Σ_normal bubbles w_σ(u) w_σ(v),   c = 2
//! S_K(u,v) = Σ_s (u_Ks − Π^K u(x_s))·(v_Ks − Π^K v(x_s)) + Σ_vector bubbles u_Kσ·v_Kσ
//! s_K      = ⅔ (1 + 1/d) μ (h_K/(2√d))^{d−2}    or, as published,    h_K^{d−2} (2μ+λ)
//! ```
//!
//! (Droniou, Enchéry, Faille, Haidar, Masson, CMAME 2024, arXiv 2312.09319, section 3; without normal bubbles.)
//!
//! **s_K.** Any multiple of the published weight serves its theory, but it is far too stiff: 3 times in 2D and 12 times in 3D
//! at λ = μ. Ours is derived: on a square or cube, with a = h_K/(2√d) half its edge, S_K gives the functions ξη c, which
//! Π^K does not see, the shear energy that they have as (bi-, tri-)linear functions,
//!
//! ```text
//! ∫ 2μ ε(ξη c):ε(ξη c) = μ ∫ |∇ξη|² |c|² + (∇ξη·c)² = ⅔ 2^d a^{d−2} μ (1 + 1/d) |c|²   (mean over the directions of c),
//! ```
//!
//! where S_K(ξη c, ξη c) = 2^d |c|². Their change of volume is left out, as in reduced integration, so that nearly
//! incompressible rock does not lock.
//!
//! **Normal bubbles** get a weight of their own: S_K sees the nodes and vector bubbles only, for with normal ones in Π^K a
//! cell in 3D would be two to three times too stiff. The weight has the shear modulus alone, since it must stay bounded where
//! λ → ∞; |K|^{(d−2)/d} takes the place of h_K^{d−2}, which makes flat tetrahedra too stiff. A smaller c lets bubbles of opposite
//! faces, which cancel in ∇^K, grow large on polygons.

use crate::model::Stabilisation;
use crate::space::{CellOperators, first_with_residual};

/// c of the weight of normal bubbles.
const NORMAL_BUBBLES: f64 = 2.0;

/// The material of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elasticity {
    /// Lamé's first parameter λ (Pa) of the drained rock.
    pub lambda: f64,
    /// Added to λ in the consistent part (Pa), ≥ 0: of a pressure that follows the deformation.
    pub extra: f64,
    /// Shear modulus μ (Pa).
    pub mu: f64,
    /// s_K.
    pub stabilisation: Stabilisation,
}

impl Elasticity {
    /// a_K over the values of a cell's functions, d for each vector and one for each normal bubble: square, by rows.
    pub fn stiffness(&self, dim: usize, cell: &CellOperators) -> Vec<f64> {
        let mut a = Vec::new();
        self.fill_stiffness(dim, cell, &mut a);
        a
    }

    /// As [`stiffness`](Self::stiffness), in the storage of an earlier cell.
    pub(crate) fn fill_stiffness(&self, dim: usize, cell: &CellOperators, a: &mut Vec<f64>) {
        match dim {
            2 => self.fill::<2>(cell, a),
            _ => self.fill::<3>(cell, a),
        }
    }

    fn stabilisation_weight<const D: usize>(&self, diameter: f64) -> f64 {
        let d = D as f64;
        let power = D as i32 - 2;
        match self.stabilisation {
            Stabilisation::Matched => 2.0 / 3.0 * (1.0 + 1.0 / d) * self.mu * (diameter / (2.0 * d.sqrt())).powi(power),
            Stabilisation::Published => (2.0 * self.mu + self.lambda) * diameter.powi(power),
        }
    }

    fn fill<const D: usize>(&self, cell: &CellOperators, a: &mut Vec<f64>) {
        let m = cell.vector_count;
        let width = m * D + cell.direction.len();
        a.clear();
        a.resize(width * width, 0.0);
        let volume = cell.measure;
        let penalty = self.stabilisation_weight::<D>(cell.diameter);
        let [shear, consistent] = [volume * self.mu, volume * (self.lambda + self.extra)];
        let first = first_with_residual(D, cell.vertex_count);
        for i in 0..m {
            let gi = cell.gradient[i].to_array();
            for j in 0..=i {
                let gj = cell.gradient[j].to_array();
                let mut diagonal = shear * cell.gradient[i].dot(cell.gradient[j]);
                if j >= first {
                    let mut s = f64::from(i == j && i >= cell.vertex_count);
                    for row in cell.residual.chunks_exact(m) {
                        s += row[i] * row[j];
                    }
                    diagonal += penalty * s;
                }
                for b in 0..D {
                    for c in 0..D {
                        let mut v = shear * gi[c] * gj[b] + consistent * gi[b] * gj[c];
                        if b == c {
                            v += diagonal;
                        }
                        a[(i * D + b) * width + j * D + c] = v;
                        a[(j * D + c) * width + i * D + b] = v;
                    }
                }
            }
        }
        let own = 2.0 * NORMAL_BUBBLES * self.mu * volume.powf(1.0 - 2.0 / D as f64);
        for (k, (&n, &gk)) in cell.direction.iter().zip(&cell.gradient[m..]).enumerate() {
            let at = m * D + k;
            for (i, &gi) in cell.gradient[..m].iter().enumerate() {
                // (∇v + ∇vᵀ) n⊗G, and the traces.
                let row = shear * (gk.dot(gi) * n + gi.dot(n) * gk) + consistent * n.dot(gk) * gi;
                for (b, v) in row.to_array().into_iter().take(D).enumerate() {
                    a[at * width + i * D + b] = v;
                    a[(i * D + b) * width + at] = v;
                }
            }
            for (l, (&nl, &gl)) in cell.direction.iter().zip(&cell.gradient[m..]).enumerate().take(k + 1) {
                let mut v =
                    shear * (gk.dot(gl) * n.dot(nl) + gk.dot(nl) * gl.dot(n)) + consistent * n.dot(gk) * nl.dot(gl);
                if k == l {
                    v += own;
                }
                a[at * width + m * D + l] = v;
                a[(m * D + l) * width + at] = v;
            }
        }
    }
}
