//! Identities of the local operators on every cell of the zoo.

use mechanics_fmu::{Bubbles, Elasticity, Space, Stabilisation};
use mesh::generate::cartesian;
use mesh::{Mesh, Side, Vec3};

use crate::common::{BOTH, animals};

/// Of sums that would cancel without round-off, as part of their terms.
const ROUND_OFF: f64 = 1e-12;

/// Rows of the gradient of the linear field u = A x + c; the third row and column are not used in 2D.
const A: [Vec3; 3] = [Vec3::new(0.3, -0.7, 0.2), Vec3::new(0.5, 1.1, -0.4), Vec3::new(-0.6, 0.8, 0.9)];
const C: Vec3 = Vec3::new(0.2, -0.4, 0.7);

fn linear(dim: usize, x: Vec3) -> Vec3 {
    let u = C + Vec3::new(A[0].dot(x), A[1].dot(x), A[2].dot(x));
    if dim == 2 { u.with_z(0.0) } else { u }
}

fn each(mut test: impl FnMut(&str, &Mesh, &Space, usize)) {
    for (name, mesh) in animals() {
        for bubbles in BOTH {
            for normal in [false, true] {
                let space = Space::with_normal_bubbles(&mesh, bubbles, |_| normal);
                (0..mesh.cell_count()).for_each(|cell| test(name, &mesh, &space, cell));
            }
        }
    }
}

#[test]
fn linear_fields_are_reproduced() {
    each(|name, mesh, space, cell| {
        let (d, at) = (mesh.dim(), format!("{name}, cell {cell}"));
        let o = space.operators(mesh, cell);
        let (list, center) = (mesh.cell_vertices(cell), mesh.geometry().cell_center[cell]);
        let x = |k: usize| mesh.vertices()[list[k]];
        let n = o.vertex_count;
        assert_eq!(n, list.len());
        // What the sums below are small against: |G| is large where cells are thin.
        let lever = o.gradient[..n].iter().map(|g| g.length()).sum::<f64>();
        let size = (0..n).map(|k| x(k).length()).fold(1.0, f64::max);
        let sum: Vec3 = o.gradient[..n].iter().sum();
        assert!(sum.length() <= ROUND_OFF * lever, "{at}: Σ G = {sum}");
        let mean: Vec3 = (0..n).map(|k| o.weight[k] * x(k)).sum();
        assert!(mean.distance(center) <= ROUND_OFF * size, "{at}: mean {mean}, centre {center}");
        assert!(o.weight[n..].iter().all(|&w| w == 0.0), "{at}: a bubble has a mean");
        for c in 0..d {
            let row: Vec3 = (0..n).map(|k| linear(d, x(k))[c] * o.gradient[k]).sum();
            let wanted = if d == 2 { A[c].with_z(0.0) } else { A[c] };
            assert!(row.distance(wanted) <= ROUND_OFF * lever * size * 4.0, "{at}: gradient {row}, not {wanted}");
            let m = o.vector_count;
            for (s, residual) in o.residual.chunks_exact(m).enumerate() {
                let rest: f64 = (0..n).map(|k| linear(d, x(k))[c] * residual[k]).sum();
                let terms = 4.0 * size * (1.0 + lever * o.diameter);
                assert!(rest.abs() <= ROUND_OFF * terms, "{at}: u − Πu is {rest} at vertex {s}");
            }
        }
    });
}

/// ∫ v·n over a face, where v is affine on its triangles (edge, mean of the face's vertices).
fn flux(mesh: &Mesh, face: usize, v: impl Fn(usize) -> Vec3) -> (f64, f64) {
    let list = mesh.face_vertices(face);
    let x = |v: usize| mesh.vertices()[v];
    let n = list.len();
    if n == 2 {
        let t = x(list[1]) - x(list[0]);
        let normal = Vec3::new(t.y, -t.x, 0.0);
        return (0.5 * (v(list[0]) + v(list[1])).dot(normal), t.length());
    }
    let mean = |f: &dyn Fn(usize) -> Vec3| list.iter().map(|&k| f(k)).sum::<Vec3>() / n as f64;
    let (center, middle) = (mean(&x), mean(&v));
    let triangles = (0..n).map(|i| (list[i], list[(i + 1) % n])).map(|(a, b)| {
        let area = 0.5 * (x(a) - center).cross(x(b) - center);
        ((v(a) + v(b) + middle).dot(area) / 3.0, area.length())
    });
    triangles.fold((0.0, 0.0), |(f, s), (g, t)| (f + g, s + t))
}

#[test]
fn the_divergence_theorem_holds_with_bubbles() {
    // Any values will do.
    let value = |k: usize| {
        let k = k as f64;
        Vec3::new((3.1 * k).sin(), (1.7 * k + 1.0).cos(), (0.9 * k + 2.0).sin())
    };
    each(|name, mesh, space, cell| {
        let o = space.operators(mesh, cell);
        let flat = |v: Vec3| if mesh.dim() == 2 { v.with_z(0.0) } else { v };
        let own = |v: usize| flat(value(v));
        let list = mesh.cell_vertices(cell);
        let bubble = |k: usize| flat(value(1000 + k));
        let mut inside: f64 = o.gradient[..o.vertex_count].iter().zip(list).map(|(g, &v)| g.dot(own(v))).sum();
        let vectors = &o.gradient[o.vertex_count..o.vector_count];
        inside += vectors.iter().enumerate().map(|(k, g)| g.dot(bubble(k))).sum::<f64>();
        let through = |face: usize| (0.7 * face as f64).sin();
        let normal: Vec<_> = space.normal_bubbles(mesh, cell).collect();
        for ((g, n), &(_, face, _)) in o.gradient[o.vector_count..].iter().zip(&o.direction).zip(&normal) {
            inside += through(face) * g.dot(*n);
        }
        inside *= o.measure;
        let (mut outside, mut terms) = (0.0, 0.0);
        for (&face, &sign) in mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell)) {
            let (f, size) = flux(mesh, face, own);
            outside += sign * f;
            terms += size;
        }
        let bubbles: Vec<_> = space.bubble_sides(cell).collect();
        assert_eq!(bubbles.len(), o.vector_count - o.vertex_count);
        assert_eq!(normal.len(), o.gradient.len() - o.vector_count);
        for (_, face, sign) in normal {
            outside += sign * mesh.geometry().face_vector[face].length() * through(face);
        }
        for (k, (i, side)) in bubbles.into_iter().enumerate() {
            let sign = if side == Side::Plus { 1.0 } else { -1.0 };
            outside += sign * mesh.geometry().face_vector[mesh.network().faces[i]].dot(bubble(k));
        }
        assert!(
            (inside - outside).abs() <= ROUND_OFF * terms,
            "{name}, cell {cell}: {inside} inside, {outside} outside"
        );
    });
}

#[test]
fn the_stiffness_of_a_linear_field_is_that_of_its_stress() {
    let (lambda, mu) = (1.5, 0.75);
    each(|name, mesh, space, cell| {
        let d = mesh.dim();
        let o = space.operators(mesh, cell);
        let a = Elasticity { lambda, extra: 0.0, mu, stabilisation: Stabilisation::Matched }.stiffness(d, &o);
        let width = o.vector_count * d + o.direction.len();
        let scale = a.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let mut field = vec![0.0; width];
        for (k, &v) in mesh.cell_vertices(cell).iter().enumerate() {
            field[k * d..][..d].copy_from_slice(&linear(d, mesh.vertices()[v]).to_array()[..d]);
        }
        let trace: f64 = (0..d).map(|c| A[c][c]).sum();
        let stress = |b: usize, c: usize| mu * (A[b][c] + A[c][b]) + if b == c { lambda * trace } else { 0.0 };
        let size = field.iter().fold(0.0f64, |m, v| m.max(v.abs())) * width as f64;
        for row in 0..width {
            let force: f64 = (0..width).map(|k| a[row * width + k] * field[k]).sum();
            let strained = |g: Vec3, b: usize| (0..d).map(|c| o.measure * stress(b, c) * g[c]).sum::<f64>();
            let wanted: f64 = match row.checked_sub(o.vector_count * d) {
                None => strained(o.gradient[row / d], row % d),
                Some(k) => (0..d).map(|b| o.direction[k][b] * strained(o.gradient[o.vector_count + k], b)).sum(),
            };
            let at = format!("{name}, cell {cell}, row {row}");
            assert!((force - wanted).abs() <= ROUND_OFF * scale * size, "{at}: {force}, not {wanted}");
            for column in 0..row {
                assert_eq!(a[row * width + column], a[column * width + row], "{at}: not symmetric");
            }
        }
    });
}

#[test]
fn bubbles_follow_from_jumps() {
    for (name, mesh) in animals() {
        for bubbles in BOTH {
            let space = Space::new(&mesh, bubbles);
            let d = mesh.dim();
            // A linear field on both sides with the jump g and, if there is one, the bubble w on the minus side.
            let (g, w) = (Vec3::new(-0.3, 0.2, 0.5), Vec3::new(0.4, -0.1, 0.6));
            let vertex = mesh.nodes().vertices();
            let value = |entity: usize| {
                let v = if entity < space.node_count() {
                    linear(d, mesh.vertices()[vertex[entity]])
                } else if entity < space.first_jump() {
                    w
                } else {
                    g
                };
                v.to_array().into_iter().take(d)
            };
            for cell in 0..mesh.cell_count() {
                let unknowns = space.unknowns(&mesh, cell);
                let Some(p) = unknowns.bubbles else { continue };
                let own: Vec<f64> = unknowns.entities.iter().flat_map(|&e| value(e as usize)).collect();
                let functions: Vec<f64> =
                    p.chunks_exact(own.len()).map(|row| row.iter().zip(&own).map(|(p, v)| p * v).sum()).collect();
                let first = mesh.cell_vertices(cell).len();
                for (k, (i, side)) in space.bubble_sides(cell).enumerate() {
                    let jump: Vec3 = (0..d).map(|c| g[c] * space.basis(i)[c]).sum();
                    let minus = if bubbles == Bubbles::TwoSided { w } else { Vec3::ZERO };
                    // The normal jump is a flux over |σ|.
                    let (face, n) = (mesh.network().faces[i], space.basis(i)[0]);
                    let warp = mesh.geometry().face_measure[face] / mesh.geometry().face_vector[face].length();
                    let wanted = if side == Side::Plus { jump + (warp - 1.0) * g.x * n + minus } else { minus };
                    for c in 0..d {
                        let found = functions[(first + k) * d + c];
                        assert!((found - wanted[c]).abs() <= 1e-14 * 10.0, "{name}: bubble {found}, not {}", wanted[c]);
                    }
                }
            }
        }
    }
}

/// The stabilisation gives a square or cube the shear energy of ξη c as a bi- or trilinear function, in the mean over the
/// directions of c (by Gauss' rule with two points a direction, which is exact).
#[test]
fn the_stabilisation_of_a_cube_is_that_of_trilinear_functions() {
    let (size, mu) = (0.3, 7e9);
    for dim in [2, 3] {
        let cells = if dim == 2 { [1, 1, 0] } else { [1; 3] };
        let mesh = Mesh::new(cartesian(Vec3::ZERO, Vec3::splat(size), cells)).unwrap();
        let operators = Space::new(&mesh, Bubbles::OneSided).operators(&mesh, 0);
        let elasticity = Elasticity { lambda: 0.0, extra: 0.0, mu, stabilisation: Stabilisation::Matched };
        let stiffness = elasticity.stiffness(dim, &operators);
        let center = mesh.geometry().cell_center[0];
        let value = |x: Vec3| (x.x - center.x) * (x.y - center.y);
        let n = operators.vertex_count;
        let u: Vec<f64> = mesh.cell_vertices(0).iter().map(|&v| value(mesh.vertices()[v])).collect();
        let entry = |i: usize, j: usize, c: usize| stiffness[(i * dim + c) * n * dim + j * dim + c];
        let direction = |c: usize| (0..n * n).map(|k| u[k / n] * u[k % n] * entry(k / n, k % n, c)).sum::<f64>();
        let found = (0..dim).map(direction).sum::<f64>() / dim as f64;
        let mut wanted = 0.0;
        let points = 1 << dim;
        for k in 0..points {
            let at = |axis: usize| 0.5 * size / 3.0_f64.sqrt() * if k >> axis & 1 == 0 { 1.0 } else { -1.0 };
            let gradient = Vec3::new(at(1), at(0), 0.0);
            for c in 0..dim {
                // 2μ ε:ε = μ (|∇ψ|² + (∂ψ/∂x_c)²) for u = ψ e_c.
                let density = mu * (gradient.length_squared() + gradient[c].powi(2));
                wanted += density * size.powi(dim as i32) / f64::from(points) / dim as f64;
            }
        }
        assert!((found - wanted).abs() < 1e-12 * wanted, "{dim}D: {found}, not {wanted}");
    }
}
