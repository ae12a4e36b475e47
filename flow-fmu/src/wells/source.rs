//! The exact steady pressure around a well: a straight source of even strength in a homogeneous rock.
//!
//! ```text
//! −div(Λ ∇p) = λ δ_line,   Λ = C Cᵀ,   y = C⁻¹ (x − x₀),   −Δ_y p = λ' δ_line,   λ' = q/(ℓ' √det Λ)
//! endless:        p = −λ'/(2π) ln ρ
//! from a to b:    p =  λ'/(4π) (asinh((b − s)/ρ) − asinh((a − s)/ρ))
//! ```
//!
//! with s along the line, ρ the distance from it and ℓ' its length, all in y (Muskat, The Flow of Homogeneous Fluids through
//! Porous Media, 1937, chapters 4 and 5). A circle of radius r_w across the line is an ellipse there, and the mean of ln ρ over
//! an ellipse of semi-axes a and b is that of a circle of radius (a + b)/2 (Peaceman, SPE 10528, 1983).

use std::f64::consts::PI;

use mesh::{Mat3, Vec3};

use crate::Tensor;

/// A straight source. In 2D its direction is z, and Λ_zz = 1.
#[derive(Clone, Debug)]
pub(crate) struct LineSource {
    /// A point of the line: that at s = 0.
    origin: Vec3,
    /// C.
    factor: Mat3,
    /// C⁻¹.
    to_isotropic: Mat3,
    /// Unit vector along the line.
    direction: Vec3,
    /// Of C⁻¹ `direction`.
    stretch: f64,
    /// q per length in x, over √det Λ and the part of a full turn that the rock takes around the line.
    strength: f64,
    /// Where it begins and ends, along `direction` from `origin` (m); `None`: nowhere.
    ends: Option<[f64; 2]>,
}

impl LineSource {
    /// A source of so much (m³/s) per length into a part of a full turn.
    pub(crate) fn new(origin: Vec3, direction: Vec3, ends: Option<[f64; 2]>, tensor: Tensor, per_length: f64) -> Self {
        let factor = cholesky(tensor);
        let to_isotropic = factor.inverse();
        let stretch = (to_isotropic * direction).length();
        let strength = per_length / factor.determinant();
        Self { origin, factor, to_isotropic, direction, stretch, strength, ends }
    }

    /// Position along the line and vector from it, in y, and the unit vector along it there.
    fn place(&self, x: Vec3) -> (f64, Vec3, Vec3) {
        let y = self.to_isotropic * (x - self.origin);
        let along = self.to_isotropic * self.direction / self.stretch;
        let s = y.dot(along);
        (s, y - s * along, along)
    }

    /// Begin and end in y.
    fn scaled_ends(&self) -> Option<[f64; 2]> {
        self.ends.map(|ends| ends.map(|s| s * self.stretch))
    }

    /// λ'.
    fn scaled_strength(&self) -> f64 {
        self.strength / self.stretch
    }

    /// Distance of a point from the source, in y.
    pub(crate) fn distance(&self, x: Vec3) -> f64 {
        let (s, across, _) = self.place(x);
        let beyond = self.scaled_ends().map_or(0.0, |[a, b]| (a - s).max(s - b).max(0.0));
        across.length().hypot(beyond)
    }

    /// Length of a vector, in y.
    pub(crate) fn length(&self, vector: Vec3) -> f64 {
        (self.to_isotropic * vector).length()
    }

    /// p (Pa for η = 1 Pa s).
    pub(crate) fn pressure(&self, x: Vec3) -> f64 {
        let (s, across, _) = self.place(x);
        let rho = across.length();
        let integral = match self.scaled_ends() {
            None => -2.0 * rho.ln(),
            Some([a, b]) => {
                let (to_a, to_b) = (a - s, b - s);
                let (r_a, r_b) = (to_a.hypot(rho), to_b.hypot(rho));
                // Each without a difference of what is nearly equal.
                if to_a > 0.0 {
                    ((to_b + r_b) / (to_a + r_a)).ln()
                } else if to_b < 0.0 {
                    ((r_a - to_a) / (r_b - to_b)).ln()
                } else {
                    ((to_b + r_b) / rho * ((r_a - to_a) / rho)).ln()
                }
            }
        };
        self.scaled_strength() / (4.0 * PI) * integral
    }

    /// ∇p in y.
    fn gradient(&self, x: Vec3) -> Vec3 {
        let (s, across, along) = self.place(x);
        let rho = across.length();
        let (by_rho, by_s) = match self.scaled_ends() {
            None => (-2.0 / rho, 0.0),
            Some([a, b]) => {
                let (to_a, to_b) = (a - s, b - s);
                let (r_a, r_b) = (to_a.hypot(rho), to_b.hypot(rho));
                ((to_a / r_a - to_b / r_b) / rho, 1.0 / r_a - 1.0 / r_b)
            }
        };
        self.scaled_strength() / (4.0 * PI) * (by_rho * across / rho + by_s * along)
    }

    /// −Λ∇p · `vector` (m³/s for a measure times a normal).
    pub(crate) fn flux(&self, x: Vec3, vector: Vec3) -> f64 {
        -self.gradient(x).dot(self.factor.transpose() * vector)
    }

    /// Whether the line goes through a planar polygon, or through a segment's translates along the line where there are two
    /// corners.
    pub(crate) fn pierces(&self, corners: &[Vec3]) -> bool {
        /// Part of the polygon's size up to which the line counts as on its edge; and of a full turn, inside.
        const ON_EDGE: f64 = 1e-6;
        let seen: Vec<Vec3> =
            corners.iter().map(|&x| (x - self.origin).reject_from_normalized(self.direction)).collect();
        let size = corners.iter().map(|x| x.distance(corners[0])).fold(0.0, f64::max);
        if let (Some([a, b]), true) = (self.ends, corners.len() > 2) {
            let along = |x: &Vec3| (*x - self.origin).dot(self.direction);
            let slack = ON_EDGE * size;
            if corners.iter().all(|x| along(x) < a - slack) || corners.iter().all(|x| along(x) > b + slack) {
                return false;
            }
        }
        let (mut turn, mut distance) = (0.0, f64::INFINITY);
        for (i, &a) in seen.iter().enumerate() {
            let b = seen[(i + 1) % seen.len()];
            turn += self.direction.dot(a.cross(b)).atan2(a.dot(b));
            let t = if a == b { 0.0 } else { (-a.dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0) };
            distance = distance.min(a.lerp(b, t).length());
        }
        distance <= ON_EDGE * size || corners.len() > 2 && turn.abs() > PI
    }

    /// Mean of p over the wall of a well of radius `radius` (m) around the part of the line between two places on it (m).
    pub(crate) fn pressure_at_wall(&self, radius: f64, from: f64, to: f64) -> f64 {
        let u = self.direction.any_orthonormal_vector();
        let v = self.direction.cross(u);
        let along = self.to_isotropic * self.direction / self.stretch;
        let [p, q] = [u, v].map(|axis| (self.to_isotropic * axis).reject_from_normalized(along));
        // Half the sum of the singular values of (p, q).
        let rho = 0.5 * radius * (p.length_squared() + q.length_squared() + 2.0 * p.cross(q).length()).sqrt();
        let mean = match self.scaled_ends() {
            None => -2.0 * rho.ln(),
            Some([a, b]) => {
                let (from, to) = (from * self.stretch, to * self.stretch);
                // ∫ asinh(t/ρ) dt.
                let integral = |t: f64| t * (t / rho).asinh() - t.hypot(rho);
                (integral(b - from) - integral(b - to) + integral(to - a) - integral(from - a)) / (to - from)
            }
        };
        self.scaled_strength() / (4.0 * PI) * mean
    }

    /// The radius (m) at which the mean pressure is `difference` below that at `radius`, as for an endless line.
    pub(crate) fn radius_at(&self, radius: f64, difference: f64) -> f64 {
        radius * (2.0 * PI * difference / self.scaled_strength()).exp()
    }

    /// Λ.
    pub(crate) fn tensor(&self) -> Tensor {
        self.factor * self.factor.transpose()
    }
}

/// The lower triangular C of Λ = C Cᵀ.
fn cholesky(tensor: Tensor) -> Mat3 {
    let mut c = Mat3::ZERO;
    for j in 0..3 {
        for i in j..3 {
            let rest = tensor.col(j)[i] - (0..j).map(|k| c.col(k)[i] * c.col(k)[j]).sum::<f64>();
            c.col_mut(j)[i] = if i == j { rest.sqrt() } else { rest / c.col(j)[j] };
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tensor() -> Tensor {
        Tensor::from_cols_array(&[3.0, 0.8, -0.4, 0.8, 1.0, 0.3, -0.4, 0.3, 2.0])
    }

    fn sources() -> [LineSource; 2] {
        [None, Some([-0.4, 1.1])]
            .map(|ends| LineSource::new(Vec3::new(0.2, 0.1, -0.3), Vec3::new(0.6, 0.0, 0.8), ends, tensor(), 1.3))
    }

    /// Points on a box around the source, and the outward normal times the weight of each.
    fn surface(center: Vec3, half: f64, n: usize) -> Vec<(Vec3, Vec3)> {
        let at = |i: usize| half * ((2 * i + 1) as f64 / n as f64 - 1.0);
        let mut points = Vec::new();
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                    let mut x = Vec3::ZERO;
                    x[axis] = sign * half;
                    x[(axis + 1) % 3] = at(i);
                    x[(axis + 2) % 3] = at(j);
                    points.push((center + x, sign * Vec3::AXES[axis] * (2.0 * half / n as f64).powi(2)));
                }
            }
        }
        points
    }

    #[test]
    fn flux_is_that_of_the_pressure_and_sums_to_the_rate() {
        for source in sources() {
            for x in [Vec3::new(2.0, -1.0, 0.5), Vec3::new(-0.3, 0.4, 3.0), Vec3::new(-3.0, -0.4, -4.0)] {
                for axis in Vec3::AXES {
                    let h = 1e-5;
                    let slope =
                        Vec3::AXES.map(|e| (source.pressure(x + h * e) - source.pressure(x - h * e)) / (2.0 * h));
                    let expected = -(tensor() * Vec3::from_array(slope)).dot(axis);
                    assert!(
                        (source.flux(x, axis) - expected).abs() < 1e-8,
                        "{} is not {expected}",
                        source.flux(x, axis)
                    );
                }
            }
        }
        let [_, short] = sources();
        let total: f64 = surface(Vec3::ZERO, 2.0, 80).iter().map(|(x, v)| short.flux(*x, *v)).sum();
        assert!((total - 1.3 * 1.5).abs() < 1e-3, "{total}");
    }

    #[test]
    fn pressure_at_the_wall_is_its_mean_there() {
        let [endless, short] = sources();
        let (radius, n) = (0.05, 400);
        for (source, tolerance) in [(endless, 1e-9), (short, 1e-3)] {
            let (u, v) = (Vec3::Y, source.direction.cross(Vec3::Y));
            let mut mean = 0.0;
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let (t, s) = (2.0 * PI * i as f64 / n as f64, -0.1 + 0.7 * (j as f64 + 0.5) / n as f64);
                let x = source.origin + s * source.direction + radius * (t.cos() * u + t.sin() * v);
                mean += source.pressure(x) / (n * n) as f64;
            }
            let p = source.pressure_at_wall(radius, -0.1, 0.6);
            assert!((p / mean - 1.0).abs() < tolerance, "{p} is not {mean}");
        }
    }
}
