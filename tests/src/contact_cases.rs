//! The mechanical cases of the literature: mesh, model and exact solution.

use std::f64::consts::PI;
use std::sync::Arc;

use mechanics_fmu::{
    Dirichlet, FractureLaw, Friction, Material, Mechanics, Model, Outcome, Partner, Place, State, StepReport,
};
use mesh::{Mesh, MeshData, Vec3};

use crate::norms::cell_quadrature;

/// Frictionless contact on a T in (−1, 1)³ with vanishing tractions (Droniou, Enchéry, Faille, Haidar, Masson, CMAME
/// 2024, section 5.1): μ = λ = 1, Dirichlet data on the whole boundary.
pub mod manufactured {
    use super::*;

    /// Marks the fractures `horizontal` {z = 0} and `vertical` {x = 0, z < 0} on a mesh of (−1, 1)³ that conforms to them.
    pub fn mark(data: &mut MeshData) {
        data.mark_fracture("horizontal", |x| x.z.abs() < 1e-9);
        data.mark_fracture("vertical", |x| x.x.abs() < 1e-9 && x.z < 1e-9);
    }

    /// p, p′, p″, p‴ of P = c zⁿ.
    fn power(c: f64, n: i32, z: f64) -> [f64; 4] {
        let n_f = f64::from(n);
        let third = if n < 3 { 0.0 } else { c * n_f * (n_f - 1.0) * (n_f - 2.0) * z.powi(n - 3) };
        [c * z.powi(n), c * n_f * z.powi(n - 1), c * n_f * (n_f - 1.0) * z.powi(n - 2), third]
    }

    fn profile(x: Vec3, upper: bool, right: bool) -> [f64; 4] {
        match (upper, right) {
            (true, _) => power(1.0, 2, x.z),
            (false, false) => power(1.0, 4, x.z),
            (false, true) => power(2.0, 4, x.z),
        }
    }

    /// Displacement and its gradient (rows are components), as continued from the block that `center` lies in.
    pub fn exact(x: Vec3, center: Vec3) -> (Vec3, [Vec3; 3]) {
        let upper = center.z > 0.0;
        let [p, p1, p2, _] = profile(x, upper, center.x > 0.0);
        let (k, s, c) = (PI / 2.0, (PI / 2.0 * x.x).sin(), (PI / 2.0 * x.x).cos());
        if upper {
            let (sy, cy) = (k * x.y).sin_cos();
            let (g, gx, gy) = (-s * cy, -k * c * cy, k * s * sy);
            (
                Vec3::new(g * p, p, x.x * x.x * p),
                [Vec3::new(gx * p, gy * p, g * p1), Vec3::new(0.0, 0.0, p1), Vec3::new(2.0 * x.x * p, 0.0, x.x * x.x * p1)],
            )
        } else {
            let (h, h1, int) = (c, -k * s, s / k);
            (
                Vec3::new(h * p, h * p1, -int * p1),
                [Vec3::new(h1 * p, 0.0, h * p1), Vec3::new(h1 * p1, 0.0, h * p2), Vec3::new(-h * p1, 0.0, -int * p2)],
            )
        }
    }

    /// f = −div σ(u) for μ = λ = 1: −Δu − 2 ∇ div u.
    pub fn force(x: Vec3) -> Vec3 {
        let [p, p1, p2, p3] = profile(x, x.z > 0.0, x.x > 0.0);
        let (k, s, c) = (PI / 2.0, (PI / 2.0 * x.x).sin(), (PI / 2.0 * x.x).cos());
        let (laplace, grad_div) = if x.z > 0.0 {
            let (sy, cy) = (k * x.y).sin_cos();
            let (g, gx, gxy) = (-s * cy, -k * c * cy, k * k * c * sy);
            (
                Vec3::new(-2.0 * k * k * g * p + g * p2, p2, 2.0 * p + x.x * x.x * p2),
                Vec3::new(-k * k * g * p + 2.0 * x.x * p1, gxy * p, gx * p1 + x.x * x.x * p2),
            )
        } else {
            let (h, h1, h2, int) = (c, -k * s, -k * k * c, s / k);
            (
                Vec3::new(h2 * p + h * p2, h2 * p1 + h * p3, -h1 * p1 - int * p3),
                Vec3::new(h2 * p - h * p2, 0.0, h1 * p1 - int * p3),
            )
        };
        -laplace - 2.0 * grad_div
    }

    /// The model on a mesh with [`mark`]ed fractures and the tags of a box.
    pub fn model() -> Model {
        let mut model = Model::default();
        model.materials.insert("rock".into(), Material::from_lame(1.0, 1.0, 0.0));
        for name in ["horizontal", "vertical"] {
            let law = FractureLaw { friction: Friction::None, ..FractureLaw::coulomb(0.0, 1.0) };
            model.fractures.insert(name.into(), law);
        }
        for tag in ["left", "right", "front", "back", "bottom", "top"] {
            for component in 0..3 {
                model.dirichlet.push(Dirichlet {
                    place: Place::Tag(tag.into()),
                    component,
                    value: Arc::new(move |p, _| exact(p.at, p.cell).0[component]),
                });
            }
        }
        model.body_force = Some(Arc::new(|x, _| force(x)));
        model
    }

    /// Errors in L²: of u and ∇u relative, of λ absolute (its exact value is 0).
    #[derive(Clone, Copy, Debug)]
    pub struct Errors {
        /// ‖Πu_D − u‖/‖u‖.
        pub displacement: f64,
        /// ‖∇_D u − ∇u‖/‖∇u‖.
        pub gradient: f64,
        /// ‖λ_D‖ (Pa √m²).
        pub multiplier: f64,
    }

    /// Errors of a solution.
    pub fn errors(mechanics: &Mechanics, state: &State) -> Errors {
        let mesh = mechanics.mesh();
        let gradients = mechanics.displacement_gradient(state);
        let means = mechanics.cell_displacement(state);
        let [mut eu, mut u2, mut eg, mut g2] = [0.0; 4];
        for cell in 0..mesh.cell_count() {
            let center = mesh.geometry().cell_center[cell];
            for (x, w) in cell_quadrature(mesh, cell) {
                let (u, gradient) = exact(x, center);
                let arm = x - center;
                let rows = gradients[cell];
                let linear = Vec3::new(rows[0].dot(arm), rows[1].dot(arm), rows[2].dot(arm));
                eu += w * (means[cell] + linear - u).length_squared();
                u2 += w * u.length_squared();
                for c in 0..3 {
                    eg += w * (rows[c] - gradient[c]).length_squared();
                    g2 += w * gradient[c].length_squared();
                }
            }
        }
        Errors {
            displacement: (eu / u2).sqrt(),
            gradient: (eg / g2).sqrt(),
            multiplier: multiplier_norm(mesh, &state.multiplier),
        }
    }
}

/// (Σ_σ |σ| |λ_σ|²)^½.
pub fn multiplier_norm(mesh: &Mesh, multiplier: &[f64]) -> f64 {
    let d = mesh.dim();
    let sum = (mesh.network().faces.iter().zip(multiplier.chunks_exact(d)))
        .map(|(&face, l)| mesh.geometry().face_measure[face] * l.iter().map(|x| x * x).sum::<f64>());
    sum.sum::<f64>().sqrt()
}

/// Takes one step without pressure from the body at rest.
///
/// # Panics
/// If the model is refused or Newton's method gives up.
pub fn solve_dry(mesh: Arc<Mesh>, model: Model) -> (Mechanics, State, StepReport) {
    let partner = Partner::uniform(&mesh, 0.0);
    let mut mechanics = Mechanics::new(mesh, model).unwrap_or_else(|e| panic!("{e}"));
    let rest = mechanics.rest(0.0);
    match mechanics.step(&rest, 1.0, &partner) {
        Ok(Outcome::Converged(state, report)) => (mechanics, state, report),
        Ok(Outcome::NotConverged(report)) => panic!("Newton's method gave up: {report:?}"),
        Err(e) => panic!("{e}"),
    }
}
