//! Closed solutions of poroelasticity, as functions that expressions can use.
//!
//! Terzaghi's column (K. Terzaghi 1923; with storage H. F. Wang, Theory of Linear Poroelasticity, 2000, section 6.3): a
//! column of height H, drained at its top and loaded there at t = 0. With ζ = y/H from the sealed bottom and τ = c t/H²,
//!
//! ```text
//! p/p₀ = (4/π) Σ_{k≥0} (−1)^k/(2k+1) cos((2k+1) π ζ/2) exp(−(2k+1)² π² τ/4)
//! ```
//!
//! Mandel's slab (J. Mandel, Géotechnique 3, 1953; A. H.-D. Cheng, E. Detournay, Int. J. Numer. Anal. Methods Geomech. 12,
//! 1988, section 4; Y. Abousleiman et al., Géotechnique 46, 1996): a slab −a < x < a between rigid smooth plates, pressed
//! by a force 2F, drained at its sides. With ξ = x/a, τ = c t/a², κ = (1−ν)/(ν_u−ν), α_i > 0 the roots of tan α = κ α, and
//! w_i = exp(−α_i² τ)/(α_i − sin α_i cos α_i),
//!
//! ```text
//! p   = B(1+ν_u)F/(3a) P,   P = 2 Σ w_i sin α_i (cos(α_i ξ) − cos α_i)
//! u_x = (F ν/(2μ) − F ν_u/μ E) ξ + F/μ D,   E = Σ w_i sin α_i cos α_i,   D = Σ w_i cos α_i sin(α_i ξ)
//! u_y = (−F(1−ν)/(2μ) + F(1−ν_u)/μ E) y/a
//! ```

use std::f64::consts::PI;

/// Terms of a series at most: they are needed only where τ is below about 1e-6.
const TERMS: usize = 2000;
/// Exponents from here on add nothing to a sum of order one.
const VANISHED: f64 = 40.0;

/// p/p₀ of Terzaghi's column at ζ in 0..1 and τ > 0; the initial value, 1, at τ ≤ 0.
pub fn terzaghi_pressure(zeta: f64, tau: f64) -> f64 {
    if tau <= 0.0 {
        return 1.0;
    }
    let mut sum = 0.0;
    for k in 0..TERMS {
        let odd = (2 * k + 1) as f64;
        let exponent = (0.5 * odd * PI).powi(2) * tau;
        if exponent > VANISHED {
            break;
        }
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        sum += sign / odd * (0.5 * odd * PI * zeta).cos() * (-exponent).exp();
    }
    4.0 / PI * sum
}

/// P of Mandel's slab, p divided by its undrained value, at ξ in 0..1 and τ > 0; 1 at τ ≤ 0.
pub fn mandel_pressure(xi: f64, tau: f64, kappa: f64) -> f64 {
    if tau <= 0.0 {
        return 1.0;
    }
    2.0 * mandel(tau, kappa, |alpha| alpha.sin() * ((alpha * xi).cos() - alpha.cos()))
}

/// E of Mandel's slab, on which its strains depend, at τ > 0; its undrained value 1/(2(κ−1)) at τ ≤ 0.
pub fn mandel_strain(tau: f64, kappa: f64) -> f64 {
    if tau <= 0.0 {
        return 0.5 / (kappa - 1.0);
    }
    mandel(tau, kappa, |alpha| alpha.sin() * alpha.cos())
}

/// D of Mandel's slab, the uneven part of u_x, at ξ in 0..1 and τ > 0; its undrained value ξ/(2(κ−1)) at τ ≤ 0.
pub fn mandel_displacement(xi: f64, tau: f64, kappa: f64) -> f64 {
    if tau <= 0.0 {
        return 0.5 * xi / (kappa - 1.0);
    }
    mandel(tau, kappa, |alpha| alpha.cos() * (alpha * xi).sin())
}

/// Σ w_i f(α_i).
fn mandel(tau: f64, kappa: f64, f: impl Fn(f64) -> f64) -> f64 {
    let mut sum = 0.0;
    for i in 0..TERMS {
        let alpha = mandel_root(i, kappa);
        let exponent = alpha * alpha * tau;
        if exponent > VANISHED {
            break;
        }
        sum += f(alpha) * (-exponent).exp() / (alpha - alpha.sin() * alpha.cos());
    }
    sum
}

/// The root of tan α = κ α, κ > 1, in (iπ, iπ + π/2), by bisection of sin α − κ α cos α, which has no pole.
fn mandel_root(i: usize, kappa: f64) -> f64 {
    let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
    let value = |alpha: f64| sign * (alpha.sin() - kappa * alpha * alpha.cos());
    // At α = 0 there is a root of no interest; right behind it the function is negative.
    let (mut low, mut high) = (i as f64 * PI + if i == 0 { 1e-6 } else { 0.0 }, (i as f64 + 0.5) * PI);
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return middle;
        }
        if value(middle) < 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KAPPA: f64 = 0.8 / 0.24;

    /// Largest |∂g/∂τ − ∂²g/∂ξ²| over some points, by central differences.
    fn diffusion(g: impl Fn(f64, f64) -> f64) -> f64 {
        let h = 1e-3;
        let residual = |x: f64, tau: f64| {
            let rate = (g(x, tau + h * h) - g(x, tau - h * h)) / (2.0 * h * h);
            rate - (g(x + h, tau) - 2.0 * g(x, tau) + g(x - h, tau)) / (h * h)
        };
        [(0.1, 0.05), (0.5, 0.2), (0.8, 0.02)].map(|(x, tau)| residual(x, tau).abs()).into_iter().fold(0.0, f64::max)
    }

    #[test]
    fn terzaghi_solves_its_problem() {
        assert!(diffusion(terzaghi_pressure) < 1e-4);
        for tau in [1e-4, 0.01, 0.3] {
            assert!(terzaghi_pressure(1.0, tau).abs() < 1e-12, "drained top");
            let slope = (terzaghi_pressure(1e-4, tau) - terzaghi_pressure(0.0, tau)) / 1e-4;
            assert!(slope.abs() < 1e-3, "sealed bottom: {slope}");
        }
        // As long as the bottom feels nothing, the solution is that of a half-space: erf(d/(2√τ)), d = 1 − ζ from the top.
        for (depth, tau, erf) in [(0.1, 0.0025, 0.842_700_792_949_715), (0.05, 0.0025, 0.520_499_877_813_047)] {
            assert!((terzaghi_pressure(1.0 - depth, tau) - erf).abs() < 1e-12);
        }
        // The mean pressure falls to one half at τ = 0.1967 (degree of consolidation 50 %; textbook value 0.197).
        let mean = |tau| (0..1000).map(|k| terzaghi_pressure((f64::from(k) + 0.5) / 1000.0, tau)).sum::<f64>() / 1000.0;
        assert!((mean(0.1967) - 0.5).abs() < 1e-3, "{}", mean(0.1967));
    }

    #[test]
    fn mandel_solves_its_problem() {
        for i in [0, 1, 7] {
            let alpha = mandel_root(i, KAPPA);
            assert!((alpha.tan() - KAPPA * alpha).abs() < 1e-9 * alpha.tan().powi(2), "{alpha}");
        }
        // Up to a function of time, p solves the diffusion equation.
        assert!(diffusion(|xi, tau| mandel_pressure(xi, tau, KAPPA) + 2.0 * mandel_strain(tau, KAPPA)) < 1e-4);
        for tau in [1e-3, 0.1, 1.0] {
            assert!(mandel_pressure(1.0, tau, KAPPA).abs() < 1e-12, "drained side");
        }
        // Undrained limits, from Skempton's answer to the load.
        assert!((mandel_pressure(0.3, 1e-5, KAPPA) - 1.0).abs() < 1e-2);
        assert!((mandel_strain(1e-6, KAPPA) - mandel_strain(0.0, KAPPA)).abs() < 2e-3);
        assert!((mandel_displacement(0.5, 1e-6, KAPPA) - mandel_displacement(0.5, 0.0, KAPPA)).abs() < 2e-3);
        // Mandel and Cryer: the middle first rises above its initial value, then drains.
        assert!(mandel_pressure(0.0, 0.05, KAPPA) > 1.02);
        assert!(mandel_pressure(0.0, 2.0, KAPPA) < 0.05);
    }

    /// With E, ν, B, ν_u: the total vertical stress carries the force F at all times, and the horizontal one vanishes.
    #[test]
    fn mandel_is_in_equilibrium() {
        let (nu, nu_u, biot, mu) = (0.2_f64, 0.44_f64, 1.0_f64, 1.0_f64);
        let lambda = 2.0 * mu * nu / (1.0 - 2.0 * nu);
        let skempton = 3.0 * (nu_u - nu) / (biot * (1.0 - 2.0 * nu) * (1.0 + nu_u));
        let (force, tau) = (1.0, 0.1);
        let e_y = -force * (1.0 - nu) / (2.0 * mu) + force * (1.0 - nu_u) / mu * mandel_strain(tau, KAPPA);
        let u_x = |xi: f64| {
            (force * nu / (2.0 * mu) - force * nu_u / mu * mandel_strain(tau, KAPPA)) * xi
                + force / mu * mandel_displacement(xi, tau, KAPPA)
        };
        let n = 400;
        let mut carried = 0.0;
        for k in 0..n {
            let xi = (f64::from(k) + 0.5) / f64::from(n);
            let e_x = (u_x(xi + 1e-4) - u_x(xi - 1e-4)) / 2e-4;
            let p = skempton * (1.0 + nu_u) / 3.0 * force * mandel_pressure(xi, tau, KAPPA);
            let s_x = 2.0 * mu * e_x + lambda * (e_x + e_y) - biot * p;
            assert!(s_x.abs() < 1e-5, "{s_x} at {xi}");
            carried += (2.0 * mu * e_y + lambda * (e_x + e_y) - biot * p) / f64::from(n);
        }
        assert!((carried + force).abs() < 1e-5, "{carried}");
    }
}
