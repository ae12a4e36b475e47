//! The generalised minimal residual method.

/// What [`gmres`] did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Krylov {
    /// Iterations, each a product with A and one with M⁻¹.
    pub iterations: usize,
    /// ‖b − A x‖₂ at the end, computed anew from the products.
    pub residual: f64,
}

/// Solves A x = b by GMRES without restarts with right preconditioning (Saad, Schultz, SIAM J. Sci. Stat. Comput. 1986),
/// starting from 0.
///
/// `apply(v, y)` sets y = A v, `precondition(v)` replaces v by M⁻¹ v. Stops when ‖b − A x‖₂ ≤ `target` as far as the
/// recurrence knows, or after `max_iterations`. `x` is left as it was where something that is not finite turned up.
pub fn gmres(
    apply: &dyn Fn(&[f64], &mut [f64]),
    precondition: &dyn Fn(&mut [f64]),
    b: &[f64],
    x: &mut [f64],
    target: f64,
    max_iterations: usize,
) -> Krylov {
    let n = b.len();
    let beta = norm(b);
    if !beta.is_finite() {
        return Krylov { iterations: 0, residual: beta };
    }
    // The basis V, M⁻¹ V and A M⁻¹ V: keeping them saves two products at the end.
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let mut directions: Vec<[Vec<f64>; 2]> = Vec::new();
    // Column k of the Hessenberg matrix, already rotated to a triangle, and the rotations.
    let mut columns: Vec<Vec<f64>> = Vec::new();
    let mut rotations: Vec<(f64, f64)> = Vec::new();
    let mut g = vec![beta];
    let mut next = b.to_vec();
    let mut length = beta;
    while g[columns.len()].abs() > target && length > 0.0 && columns.len() < max_iterations {
        let k = columns.len();
        next.iter_mut().for_each(|v| *v /= length);
        let mut z = next.clone();
        basis.push(next);
        precondition(&mut z);
        next = vec![0.0; n];
        apply(&z, &mut next);
        directions.push([z, next.clone()]);
        let mut h = Vec::with_capacity(k + 2);
        for v in &basis {
            let along = dot(v, &next);
            next.iter_mut().zip(v).for_each(|(w, v)| *w -= along * v);
            h.push(along);
        }
        length = norm(&next);
        h.push(length);
        for (i, &(c, s)) in rotations.iter().enumerate() {
            (h[i], h[i + 1]) = (c * h[i] + s * h[i + 1], c * h[i + 1] - s * h[i]);
        }
        let r = h[k].hypot(h[k + 1]);
        if !r.is_finite() || r == 0.0 {
            return Krylov { iterations: k + 1, residual: beta };
        }
        let (c, s) = (h[k] / r, h[k + 1] / r);
        h[k] = r;
        h.pop();
        rotations.push((c, s));
        g.push(-s * g[k]);
        g[k] *= c;
        columns.push(h);
    }
    let used = columns.len();
    let mut y = g;
    y.truncate(used);
    for i in (0..used).rev() {
        y[i] /= columns[i][i];
        for j in 0..i {
            y[j] -= columns[i][j] * y[i];
        }
    }
    let (mut solution, mut rest) = (vec![0.0; n], b.to_vec());
    for ([z, image], y) in directions.iter().zip(&y) {
        solution.iter_mut().zip(z).for_each(|(u, z)| *u += y * z);
        rest.iter_mut().zip(image).for_each(|(r, a)| *r -= y * a);
    }
    if !solution.iter().all(|u| u.is_finite()) {
        return Krylov { iterations: used, residual: beta };
    }
    x.copy_from_slice(&solution);
    Krylov { iterations: used, residual: norm(&rest) }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Independent sums, since one would wait for itself.
    const LANES: usize = 16;
    let mut sums = [0.0; LANES];
    let whole = a.len() / LANES * LANES;
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    sums.iter().sum::<f64>() + a[whole..].iter().zip(&b[whole..]).map(|(a, b)| a * b).sum::<f64>()
}

fn norm(v: &[f64]) -> f64 {
    dot(v, v).sqrt()
}

#[cfg(test)]
mod tests {
    use super::gmres;

    #[test]
    fn as_many_iterations_as_distinct_eigenvalues() {
        let diagonal = [1.0, 2.0, 2.0, 5.0, 1.0, 5.0];
        let b = [3.0, -1.0, 4.0, 1.0, -5.0, 9.0];
        let apply = |v: &[f64], y: &mut [f64]| y.iter_mut().enumerate().for_each(|(i, y)| *y = diagonal[i] * v[i]);
        let mut x = [0.0; 6];
        let done = gmres(&apply, &|_| {}, &b, &mut x, 1e-12, 10);
        assert_eq!(done.iterations, 3);
        assert!(done.residual < 1e-12);
        for i in 0..6 {
            assert!((x[i] - b[i] / diagonal[i]).abs() < 1e-12);
        }
        assert_eq!(gmres(&apply, &|_| {}, &[0.0; 6], &mut x, 0.0, 10).iterations, 0);
        assert_eq!(x, [0.0; 6]);
    }

    #[test]
    fn a_preconditioner_that_is_the_inverse_needs_one() {
        let apply = |v: &[f64], y: &mut [f64]| {
            y[0] = 4.0 * v[0] + v[1];
            y[1] = -2.0 * v[0] + 3.0 * v[1];
        };
        let inverse = |v: &mut [f64]| {
            let (a, b) = (v[0], v[1]);
            v[0] = (3.0 * a - b) / 14.0;
            v[1] = (2.0 * a + 4.0 * b) / 14.0;
        };
        let mut x = [0.0; 2];
        assert_eq!(gmres(&apply, &inverse, &[6.0, 4.0], &mut x, 1e-13, 5).iterations, 1);
        assert!((x[0] - 1.0).abs() < 1e-14 && (x[1] - 2.0).abs() < 1e-14);
    }

    #[test]
    fn a_singular_system_is_not_solved() {
        let apply = |v: &[f64], y: &mut [f64]| {
            y[0] = v[0];
            y[1] = 0.0;
        };
        let mut x = [0.0; 2];
        assert!(gmres(&apply, &|_| {}, &[1.0, 1.0], &mut x, 1e-10, 5).residual > 0.9);
    }
}
