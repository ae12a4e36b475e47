//! The local operator of hybrid finite volumes, in any dimension.
//!
//! In a cell K with a point x_K, facets of centre x_i, measure |σ_i| and outward normal n_i, a tensor Λ, and
//! v_i = |σ_i| (x_i − x_K)·n_i / d, the flux out of K through the facet i of a potential ψ is
//!
//! ```text
//! F_Ki = Σ_j T_ij (ψ_K − ψ_j),   T_ij = Σ_l G_lj·Λ G_li / v_l,
//! G_ij = (v_i/|K|) |σ_j| n_j + (1/√d) B_ij n_i,   B_ij = |σ_i| δ_ij − |σ_i| |σ_j| n_j·(x_i − x_K)/|K|
//! ```
//!
//! (Eymard, Gallouët, Herbin, IMA J. Numer. Anal. 30, 2010, equations 2.19 to 2.26; Brenner, Hennicker, Masson,
//! Samier, IMA J. Numer. Anal. 2016, section 4.) As Σ_l |σ_l| n_l = 0 and Σ_l |σ_l| n_l ⊗ (x_l − x_K) = |K| I,
//! Σ_l n_l B_li = 0: the mixed terms vanish, and what is evaluated here is
//!
//! ```text
//! T_ij = |σ_i| |σ_j| n_i·Λ n_j / |K| + Σ_l (|σ_l| n_l·Λ n_l / δ_l) R_li R_lj,
//! R_li = B_li / |σ_l|,   δ_l = (x_l − x_K)·n_l
//! ```
//!
//! x_K is the centre of mass: with another point the source of a cell acts beside its centre, a dipole of the order of h, and
//! the pressure falls short of its second order (Droniou, Nataraj, IMA J. Numer. Anal. 38, 2018).
//!
//! Deviation: where x_K does not see all facets, δ_l is bounded from below ([`UNSEEN_DISTANCE`]). T stays symmetric,
//! positive definite but for constants, and exact for affine ψ, for these rest on R alone: the scheme is then
//! another member of the hybrid mimetic mixed family (Droniou, Eymard, Gallouët, Herbin, M3AS 20, 2010).

use mesh::Vec3;

/// A symmetric tensor, by columns.
pub type Tensor = glam::DMat3;

/// A planar facet of a cell: its measure times its outward normal, and its centre.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    pub(crate) vector: Vec3,
    pub(crate) center: Vec3,
}

/// A point sees a facet if it lies behind its plane by this part of |K| / Σ_i |σ_i| (about the radius of the largest
/// ball inside, over d). Closer to it the operator would stiffen without gain.
const LEAST_DISTANCE: f64 = 1e-3;

/// Where x_K does not see all facets, their distances count as at least this part of |K| / Σ_i |σ_i|: about what they are
/// in round cells.
const UNSEEN_DISTANCE: f64 = 0.5;

/// (x_i − x)·n_i over the least distance, for the worst facet. At least 1 where `x` sees the cell whole.
pub(crate) fn visibility(measure: f64, x: Vec3, facets: &[Facet]) -> f64 {
    let surface: f64 = facets.iter().map(|f| f.vector.length()).sum();
    let worst = (facets.iter()).map(|f| (f.center - x).dot(f.vector.normalize())).fold(f64::INFINITY, f64::min);
    worst * surface / (measure * LEAST_DISTANCE)
}

/// Writes T by rows (facets × facets) to `out`.
pub(crate) fn transmissivity(measure: f64, x: Vec3, facets: &[Facet], tensor: Tensor, out: &mut [f64]) {
    let m = facets.len();
    let surface: f64 = facets.iter().map(|f| f.vector.length()).sum();
    let sees = visibility(measure, x, facets) >= 1.0;
    let least = if sees { 0.0 } else { UNSEEN_DISTANCE * measure / surface };
    let mut residual = vec![0.0; m];
    for i in 0..m {
        for j in 0..m {
            out[i * m + j] = facets[i].vector.dot(tensor * facets[j].vector) / measure;
        }
    }
    for (l, facet) in facets.iter().enumerate() {
        let area = facet.vector.length();
        let normal = facet.vector / area;
        let to = facet.center - x;
        for (j, r) in residual.iter_mut().enumerate() {
            *r = f64::from(u8::from(l == j)) - facets[j].vector.dot(to) / measure;
        }
        let scale = area * normal.dot(tensor * normal) / to.dot(normal).max(least);
        for i in 0..m {
            for j in 0..m {
                out[i * m + j] += scale * residual[i] * residual[j];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The spec's form with G and B, on a cell for which v_l > 0.
    fn as_published(d: f64, measure: f64, x: Vec3, facets: &[Facet], tensor: Tensor) -> Vec<f64> {
        let m = facets.len();
        let area: Vec<f64> = facets.iter().map(|f| f.vector.length()).collect();
        let normal: Vec<Vec3> = facets.iter().map(|f| f.vector.normalize()).collect();
        let v: Vec<f64> = (0..m).map(|i| area[i] * (facets[i].center - x).dot(normal[i]) / d).collect();
        let g = |i: usize, j: usize| {
            let delta = if i == j { area[i] } else { 0.0 };
            let b = delta - area[i] * area[j] * normal[j].dot(facets[i].center - x) / measure;
            v[i] / measure * area[j] * normal[j] + b / d.sqrt() * normal[i]
        };
        let entry = |i, j| (0..m).map(|l| g(l, j).dot(tensor * g(l, i)) / v[l]).sum();
        (0..m * m).map(|k| entry(k / m, k % m)).collect()
    }

    fn quadrilateral() -> (f64, Vec<Facet>) {
        let p = [(0.0, 0.0), (2.0, 0.1), (1.7, 1.3), (-0.2, 0.9)].map(|(x, y)| Vec3::new(x, y, 0.0));
        let mut measure = 0.0;
        let facets = (0..4).map(|i| {
            let (a, b) = (p[i], p[(i + 1) % 4]);
            measure += 0.5 * (a.x * b.y - b.x * a.y);
            Facet { vector: Vec3::new(b.y - a.y, a.x - b.x, 0.0), center: 0.5 * (a + b) }
        });
        let facets = facets.collect();
        (measure, facets)
    }

    #[test]
    fn is_the_published_operator() {
        let (measure, facets) = quadrilateral();
        let tensor = Tensor::from_cols_array(&[2.0, 0.7, 0.0, 0.7, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let x = Vec3::new(0.9, 0.55, 0.0);
        let mut t = vec![0.0; 16];
        transmissivity(measure, x, &facets, tensor, &mut t);
        let reference = as_published(2.0, measure, x, &facets, tensor);
        for (a, b) in t.iter().zip(&reference) {
            assert!((a - b).abs() < 1e-13 * 10.0, "{a} is not {b}");
        }
    }

    #[test]
    fn in_one_dimension_it_is_two_half_transmissivities() {
        let t = Vec3::new(0.6, 0.8, 0.0);
        let facets = [Facet { vector: -t, center: -1.5 * t }, Facet { vector: t, center: 1.5 * t }];
        let mut out = [0.0; 4];
        transmissivity(3.0, Vec3::ZERO, &facets, Tensor::IDENTITY * 5.0, &mut out);
        for (value, expected) in out.iter().zip([5.0 / 1.5, 0.0, 0.0, 5.0 / 1.5]) {
            assert!((value - expected).abs() < 1e-14 * 5.0);
        }
    }

    #[test]
    fn stays_definite_where_no_point_sees_all() {
        // A U: nothing sees both legs.
        let p = [(0., 0.), (3., 0.), (3., 3.), (2., 3.), (2., 1.), (1., 1.), (1., 3.), (0., 3.)]
            .map(|(x, y)| Vec3::new(x, y, 0.0));
        let n = p.len();
        let facets: Vec<Facet> = (0..n)
            .map(|i| {
                let (a, b) = (p[i], p[(i + 1) % n]);
                Facet { vector: Vec3::new(b.y - a.y, a.x - b.x, 0.0), center: 0.5 * (a + b) }
            })
            .collect();
        let x = p.iter().sum::<Vec3>() / 8.0;
        assert!(visibility(7.0, x, &facets) < 1.0);
        let mut t = vec![0.0; n * n];
        transmissivity(7.0, x, &facets, Tensor::IDENTITY, &mut t);
        let gradient = Vec3::new(0.3, -1.2, 0.0);
        for i in 0..n {
            let flux: f64 = (0..n).map(|j| -t[i * n + j] * gradient.dot(facets[j].center - x)).sum();
            assert!((flux + gradient.dot(facets[i].vector)).abs() < 1e-10);
            let energy: f64 = (0..n).map(|j| (0..n).map(|k| t[j * n + k]).sum::<f64>()).sum();
            assert!(energy > 0.0 && t[i * n + i] > 0.0);
        }
    }
}
