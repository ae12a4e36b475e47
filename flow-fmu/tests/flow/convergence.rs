//! Orders of convergence of manufactured solutions: 2 for the pressure in the points x_K and 1 for the flux (Eymard,
//! Gallouët, Herbin, IMA J. Numer. Anal. 30, 2010, theorem 4.8; Droniou, Nataraj, IMA J. Numer. Anal. 38, 2018, for
//! the second order of the pressure).

use flow_fmu::SpaceTimeFunction;
use mesh::Vec3;

use super::common::*;

/// p = sin(Ax) cos(By) e^(z/2) in 3D, without the last factor in 2D.
const A: f64 = 2.0;
const B: f64 = 1.5;

fn pressure(x: Vec3) -> f64 {
    (A * x.x).sin() * (B * x.y).cos() * (0.5 * x.z).exp()
}

fn gradient(x: Vec3, dim: usize) -> Vec3 {
    let ((s, c), (sy, cy)) = ((A * x.x).sin_cos(), (B * x.y).sin_cos());
    let e = (0.5 * x.z).exp();
    let z = if dim == 3 { 0.5 * s * cy * e } else { 0.0 };
    Vec3::new(A * c * cy * e, -B * s * sy * e, z)
}

/// div(K ∇p), by the second derivatives.
fn divergence(x: Vec3, dim: usize) -> f64 {
    let ((s, c), (sy, cy)) = ((A * x.x).sin_cos(), (B * x.y).sin_cos());
    let e = (0.5 * x.z).exp();
    let k = full_tensor();
    let mut sum = k.x_axis.x * -A * A * s * cy - k.y_axis.y * B * B * s * cy - 2.0 * k.x_axis.y * A * B * c * sy;
    if dim == 3 {
        sum += k.z_axis.z * 0.25 * s * cy + k.x_axis.z * A * c * cy - k.y_axis.z * B * s * sy;
    }
    sum * e
}

/// Relative errors of pressure and flux, and the mesh size.
fn errors(name: &str, n: usize) -> (f64, f64, f64) {
    let mesh = mesh(family(name, n));
    let dim = mesh.dim();
    let mut model = all_pressure(&mesh, full_tensor(), SpaceTimeFunction::new(|x, _| pressure(x)));
    model.matrix_source = Some(SpaceTimeFunction::new(move |x, _| -divergence(x, dim)));
    let (flow, _) = steady(&mesh, model);
    let geometry = mesh.geometry();
    let (mut p, mut p_size, mut v, mut v_size) = (0.0, 0.0, 0.0, 0.0);
    for cell in 0..mesh.cell_count() {
        let measure = geometry.cell_measure[cell];
        let exact = pressure(flow.space().cell_point(cell));
        p += measure * (flow.state().matrix_pressure[cell] - exact).powi(2);
        p_size += measure * exact * exact;
        let k = full_tensor();
        let exact = -(k * gradient(geometry.cell_center[cell], dim));
        let exact = if dim == 2 { exact.with_z(0.0) } else { exact };
        v += measure * flow.fluxes().unwrap().cell_velocity[cell].distance_squared(exact);
        v_size += measure * exact.length_squared();
    }
    let h = (1.0 / mesh.cell_count() as f64).powf(1.0 / dim as f64);
    (h, (p / p_size).sqrt(), (v / v_size).sqrt())
}

fn check(name: &str, levels: [usize; 3]) {
    let results = levels.map(|n| errors(name, n));
    let sizes = results.map(|r| r.0);
    let (p, v) = (order(&sizes, &results.map(|r| r.1)), order(&sizes, &results.map(|r| r.2)));
    assert!(p >= 1.9, "{name}: order {p} of the pressure, {results:?}");
    assert!(v >= 0.9, "{name}: order {v} of the flux, {results:?}");
}

#[test]
fn on_triangles() {
    check("triangles", [8, 16, 32]);
}

#[test]
fn on_perturbed_squares() {
    check("perturbed squares", [16, 32, 64]);
}

#[test]
fn on_polygons() {
    check("polygons", [8, 16, 32]);
}

/// Up to one in seven of these cells is not seen whole from its centre.
#[test]
fn on_clumps_of_24_triangles() {
    check("large clumps of triangles", [32, 64, 128]);
}

#[test]
fn on_clumps_of_tetrahedra() {
    check("clumps of tetrahedra", [4, 8, 16]);
}

#[test]
fn on_tetrahedra() {
    check("tetrahedra", [8, 16, 24]);
}

#[test]
fn on_perturbed_hexahedra() {
    check("perturbed cubes", [4, 8, 16]);
}

#[test]
fn on_polyhedra() {
    check("polyhedra", [3, 6, 12]);
}
