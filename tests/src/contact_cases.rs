//! The mechanical cases of the literature: mesh, model and exact solution.

use std::f64::consts::PI;
use std::sync::Arc;

use mechanics_fmu::{
    BoundaryPoint, Bubbles, Dirichlet, FractureLaw, Friction, Material, Mechanics, Model, Neumann, Outcome, Partner,
    Place, State, StepReport,
};
use mesh::generate::{Triangles, agglomerate, cartesian, dual, extrude, perturb, simplices};
use mesh::{Mesh, MeshData, Vec3};

/// Frictionless contact on a T in (−1, 1)³ with vanishing tractions (Droniou, Enchéry, Faille, Haidar, Masson, CMAME
/// 2024, section 5.1): μ = λ = 1, Dirichlet data on the whole boundary.
pub mod manufactured {
    use super::*;

    /// Marks the fractures `horizontal` {z = 0} and `vertical` {x = 0, z < 0} on a mesh of (−1, 1)³ that conforms to them.
    pub fn mark(data: &mut MeshData) {
        data.mark_fracture("horizontal", |x| x.z.abs() < 1e-9);
        data.mark_fracture("vertical", |x| x.x.abs() < 1e-9 && x.z < 1e-9);
    }

    /// The families of meshes, and for each the cells along an edge of the boxes that they are made from, level by level.
    pub const FAMILIES: [(&str, [usize; 5]); 6] = [
        ("Cartesian", [8, 12, 16, 24, 32]),
        ("perturbed hexahedra", [8, 12, 16, 24, 32]),
        ("tetrahedra", [6, 8, 12, 16, 24]),
        ("dual polyhedra", [6, 8, 12, 16, 20]),
        ("agglomerated tetrahedra", [6, 8, 12, 16, 24]),
        ("prisms over polygons", [6, 8, 12, 16, 24]),
    ];

    /// A mesh of a family, made from n³ boxes, or from n layers over triangles of edge 2/n; n is even.
    ///
    /// # Panics
    /// If there is no such family.
    pub fn mesh(family: &str, n: usize) -> Arc<Mesh> {
        let sound = |data: MeshData| Mesh::new(data).unwrap_or_else(|e| panic!("{e}"));
        let mut boxes = cartesian(Vec3::splat(-1.0), Vec3::ONE, [n; 3]);
        mark(&mut boxes);
        let tetrahedra = || sound(simplices(&sound(boxes.clone())).unwrap_or_else(|e| panic!("{e}")));
        let data = match family {
            "Cartesian" => boxes,
            "perturbed hexahedra" => perturb(&sound(boxes), 0.2, 1),
            "tetrahedra" => return Arc::new(tetrahedra()),
            "dual polyhedra" => dual(&tetrahedra()).unwrap_or_else(|e| panic!("{e}")),
            "agglomerated tetrahedra" => agglomerate(&tetrahedra(), 8).unwrap_or_else(|e| panic!("{e}")),
            "prisms over polygons" => {
                let size = 2.0 / n as f64;
                let plan = Triangles::rectangle([-1.0; 2], [1.0; 2], size);
                let plan = plan.fracture("vertical", &[[0.0, -1.0], [0.0, 1.0]], size).build();
                let plan = dual(&sound(plan.unwrap_or_else(|e| panic!("{e}"))));
                let levels: Vec<f64> = (0..=n).map(|k| k as f64 * size - 1.0).collect();
                let plan = sound(plan.unwrap_or_else(|e| panic!("{e}")));
                let mut prisms = extrude(&plan, &levels, |_, layer| 2 * layer < n).unwrap_or_else(|e| panic!("{e}"));
                prisms.mark_fracture("horizontal", |x| x.z.abs() < 1e-9);
                prisms
            }
            _ => panic!("there is no family {family}"),
        };
        Arc::new(sound(data))
    }

    /// Mean size of the cells (m): that of equal cubes.
    pub fn size(mesh: &Mesh) -> f64 {
        (8.0 / mesh.cell_count() as f64).cbrt()
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
                [
                    Vec3::new(gx * p, gy * p, g * p1),
                    Vec3::new(0.0, 0.0, p1),
                    Vec3::new(2.0 * x.x * p, 0.0, x.x * x.x * p1),
                ],
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
            for (x, w) in mesh.quadrature(cell) {
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

/// A crack under compression in a large plane (Phan, Napier, Gray, Kaplan, IJNME 2003): E = 25 GPa, ν = 0.25,
/// 100 MPa along x, half-length 1 m at 20° to x, F = 1/√3.
pub mod single_crack {
    use super::*;

    /// Young's modulus (Pa).
    pub const YOUNG: f64 = 25e9;
    /// Poisson's ratio.
    pub const POISSON: f64 = 0.25;
    /// Compression along x (Pa).
    pub const COMPRESSION: f64 = 100e6;
    /// Angle of the crack to x (rad).
    pub const ANGLE: f64 = PI / 9.0;
    /// Half-length (m).
    pub const HALF_LENGTH: f64 = 1.0;
    /// Friction coefficient, 1/√3.
    pub const FRICTION: f64 = 0.577_350_269_189_625_8;

    /// Triangles of a square of side `side` (m), `faces` equal ones of them along the crack, growing by `growth` metres per
    /// metre.
    ///
    /// # Panics
    /// If the mesh cannot be made.
    pub fn triangles(side: f64, faces: usize, growth: f64) -> Mesh {
        let (s, c) = ANGLE.sin_cos();
        let tip = [HALF_LENGTH * c, HALF_LENGTH * s];
        let half = side / 2.0;
        let data = Triangles::rectangle([-half; 2], [half; 2], side / 16.0)
            .fracture("crack", &[[-tip[0], -tip[1]], tip], 2.0 * HALF_LENGTH / faces as f64)
            .growth(growth)
            .build();
        Mesh::new(data.unwrap_or_else(|e| panic!("{e}"))).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Polygons: the dual of [`triangles`], with one face more on the crack, of which those at the tips are half as long.
    ///
    /// # Panics
    /// If the mesh cannot be made.
    pub fn polygons(side: f64, faces: usize, growth: f64) -> Mesh {
        let data = dual(&triangles(side, faces, growth)).unwrap_or_else(|e| panic!("{e}"));
        Mesh::new(data).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Growth of the triangles (m/m) that refines the far field as the crack: its error is of second order in the growth. About
    /// 50 000 triangles at 400 faces, 200 000 at 800.
    pub fn growth(faces: usize) -> f64 {
        (1.2 / (faces as f64).sqrt()).min(24.0 / faces as f64)
    }

    fn frame() -> Model {
        let mut model = Model::default();
        let rock = Material { young_modulus: YOUNG, poisson_ratio: POISSON, biot_coefficient: 0.0 };
        model.materials.insert("rock".into(), rock);
        model.fractures.insert("crack".into(), FractureLaw::coulomb(FRICTION, 1e-4));
        model
    }

    /// The model: the load as traction, rigid motions removed at three ends of the symmetry axes.
    pub fn model(side: f64) -> Model {
        let mut model = frame();
        for (tag, sign) in [("left", 1.0), ("right", -1.0)] {
            let traction = Vec3::new(sign * COMPRESSION, 0.0, 0.0);
            model.neumann.push(Neumann { tag: tag.into(), traction: Arc::new(move |_, _| traction) });
        }
        // Not more than three: vertices beside the axes would be held against the strain.
        for (x, y, component) in [(0.0, -0.5, 0), (0.0, 0.5, 0), (-0.5, 0.0, 1)] {
            let place = Place::Point(side * Vec3::new(x, y, 0.0));
            model.dirichlet.push(Dirichlet { place, component, value: Arc::new(|_, _| 0.0) });
        }
        model
    }

    /// The model with the exact displacement of the infinite plane on all of the boundary, so that only the mesh errs.
    pub fn model_in_exact_field() -> Model {
        let mut model = frame();
        for tag in ["left", "right", "bottom", "top"] {
            for component in 0..2 {
                let value = Arc::new(move |p: &BoundaryPoint, _| displacement(p.at)[component]);
                model.dirichlet.push(Dirichlet { place: Place::Tag(tag.into()), component, value });
            }
        }
        model
    }

    /// Exact displacement (m) in the infinite plane, off the crack: that of the uniform stress, and Westergaard's of a crack
    /// (Z = τ (z/√(z² − ℓ²) − 1), mode II) from which friction takes the rest of the shear.
    pub fn displacement(x: Vec3) -> Vec3 {
        let (s, c) = ANGLE.sin_cos();
        let compliance = COMPRESSION * (1.0 + POISSON) / YOUNG;
        let uniform = Vec3::new(-(1.0 - POISSON) * compliance * x.x, POISSON * compliance * x.y, 0.0);
        let shear = COMPRESSION * s * (c - FRICTION * s);
        let (along, across) = (c * x.x + s * x.y, c * x.y - s * x.x);
        // √(z² − ℓ²) = √(z − ℓ) √(z + ℓ), cut along the crack.
        let polar = |a: f64| ((along + a).hypot(across), across.atan2(along + a));
        let ((r1, t1), (r2, t2)) = (polar(-HALF_LENGTH), polar(HALF_LENGTH));
        let (radius, angle) = ((r1 * r2).sqrt(), 0.5 * (t1 + t2));
        let root = [radius * angle.cos(), radius * angle.sin()];
        let norm = root[0] * root[0] + root[1] * root[1];
        let ratio = [(along * root[0] + across * root[1]) / norm, (across * root[0] - along * root[1]) / norm];
        let z = [shear * (ratio[0] - 1.0), shear * ratio[1]];
        let integral = [shear * (root[0] - along), shear * (root[1] - across)];
        let kappa = 3.0 - 4.0 * POISSON;
        let double_mu = YOUNG / (1.0 + POISSON);
        let u = (0.5 * (kappa + 1.0) * integral[1] + across * z[0]) / double_mu;
        let v = (-0.5 * (kappa - 1.0) * integral[0] - across * z[1]) / double_mu;
        uniform + Vec3::new(c * u - s * v, s * u + c * v, 0.0)
    }

    /// Normal multiplier λ_n = σ̄ sin²ψ (Pa).
    pub fn normal_multiplier() -> f64 {
        COMPRESSION * ANGLE.sin().powi(2)
    }

    /// Slip (m) at the distance `from_center` (m) from the middle of the crack.
    pub fn slip(from_center: f64) -> f64 {
        let (s, c) = ANGLE.sin_cos();
        let stress = COMPRESSION * s * (c - FRICTION * s);
        4.0 * (1.0 - POISSON.powi(2)) / YOUNG * stress * (HALF_LENGTH.powi(2) - from_center.powi(2)).max(0.0).sqrt()
    }

    /// A face of the crack and what was found on it.
    #[derive(Clone, Copy, Debug)]
    pub struct FaceResult {
        /// Distance of its middle from that of the crack (m, signed).
        pub at: f64,
        /// Its length (m).
        pub length: f64,
        /// Slip (m).
        pub slip: f64,
        /// λ_n (Pa).
        pub traction: f64,
    }

    /// All faces, ordered along the crack.
    pub fn profile(mechanics: &Mechanics, state: &State) -> Vec<FaceResult> {
        let mesh = mechanics.mesh();
        let geometry = mesh.geometry();
        let along = Vec3::new(ANGLE.cos(), ANGLE.sin(), 0.0);
        let jump = state.jump(mechanics.space());
        let mut profile: Vec<_> = (mesh.network().faces.iter().enumerate())
            .map(|(i, &face)| FaceResult {
                at: geometry.face_center[face].dot(along),
                length: geometry.face_measure[face],
                slip: jump[2 * i + 1].abs(),
                traction: state.multiplier[2 * i],
            })
            .collect();
        profile.sort_by(|a, b| a.at.total_cmp(&b.at));
        profile
    }

    /// Relative errors in L²(crack).
    #[derive(Clone, Copy, Debug)]
    pub struct Errors {
        /// Of the slip, by the values at the faces' middles.
        pub slip: f64,
        /// Of the slip as a piecewise constant function.
        pub slip_function: f64,
        /// The least that any piecewise constant function has: that of the exact means over the faces.
        pub slip_least: f64,
        /// Of λ_n without 5 % of the crack at each tip.
        pub traction: f64,
    }

    /// Errors of a solution.
    pub fn errors(profile: &[FaceResult]) -> Errors {
        // ∫ √(ℓ² − x²), in units of ℓ.
        let primitive = |x: f64| 0.5 * (x * (1.0 - x * x).sqrt() + x.asin());
        let total = slip(0.0).powi(2) * 4.0 / 3.0 * HALF_LENGTH;
        let (mut at_middles, mut middles, mut of_means, mut means) = (0.0, 0.0, 0.0, 0.0);
        for face in profile {
            let exact = slip(face.at);
            at_middles += face.length * (face.slip - exact).powi(2);
            middles += face.length * exact.powi(2);
            let [a, b] = [-0.5, 0.5].map(|e| ((face.at + e * face.length) / HALF_LENGTH).clamp(-1.0, 1.0));
            let mean = slip(0.0) * HALF_LENGTH / face.length * (primitive(b) - primitive(a));
            of_means += face.length * (face.slip - mean).powi(2);
            means += face.length * mean.powi(2);
        }
        let inner = profile.iter().filter(|face| face.at.abs() < 0.9 * HALF_LENGTH);
        let (error, size) = inner.fold((0.0, 0.0), |(error, size), face| {
            (error + face.length * (face.traction / normal_multiplier() - 1.0).powi(2), size + face.length)
        });
        Errors {
            slip: (at_middles / middles).sqrt(),
            slip_function: ((total - means + of_means) / total).sqrt(),
            slip_least: ((total - means) / total).sqrt(),
            traction: (error / size).sqrt(),
        }
    }
}

/// Four crossing vertical fractures in the unit cube, sheared and pressed from the top (Droniou, Enchéry, Faille, Haidar,
/// Masson, CMAME 2024, section 5.3; traces chosen).
pub mod network_3d {
    use super::*;

    /// Pressure of all pores (Pa).
    pub const PRESSURE: f64 = 1e5;
    /// End of the case (s).
    pub const END: f64 = 2000.0;

    const TRACES: [[[f64; 2]; 2]; 4] =
        [[[0.1, 0.5], [0.9, 0.5]], [[0.15, 0.7], [0.4, 0.2]], [[0.45, 0.3], [0.6, 0.8]], [[0.6, 0.2], [0.8, 0.8]]];

    /// Tetrahedra: prisms over triangles of size `size` (m) on the traces, with `layers` layers (a multiple of 5), split.
    ///
    /// # Panics
    /// If the mesh cannot be made.
    pub fn tetrahedra(size: f64, layers: usize) -> Mesh {
        let names = ["1", "2", "3", "4"];
        let mut triangles = Triangles::rectangle([0.0; 2], [1.0; 2], 1.13 * size).growth(0.3);
        for (name, trace) in names.iter().zip(&TRACES) {
            triangles = triangles.fracture(name, trace, size);
        }
        let flat = Mesh::new(triangles.build().unwrap_or_else(|e| panic!("{e}"))).unwrap_or_else(|e| panic!("{e}"));
        let levels: Vec<f64> = (0..=layers).map(|k| k as f64 / layers as f64).collect();
        let inside = |layer: usize| 5 * layer >= layers && 5 * (layer + 1) <= 4 * layers;
        let prisms = extrude(&flat, &levels, |_, layer| inside(layer)).unwrap_or_else(|e| panic!("{e}"));
        let prisms = Mesh::new(prisms).unwrap_or_else(|e| panic!("{e}"));
        Mesh::new(simplices(&prisms).unwrap_or_else(|e| panic!("{e}"))).unwrap_or_else(|e| panic!("{e}"))
    }

    /// The mechanical model.
    pub fn model(bubbles: Bubbles) -> Model {
        let mut model = Model { bubbles, ..Model::default() };
        let rock = Material { young_modulus: 10e9, poisson_ratio: 0.2, biot_coefficient: 0.5 };
        model.materials.insert("rock".into(), rock);
        for name in ["1", "2", "3", "4"] {
            model.fractures.insert(name.into(), FractureLaw::coulomb(0.5, 1e-3));
        }
        for (component, top) in [5e-3, 2e-3, -2e-3].into_iter().enumerate() {
            model.dirichlet.push(Dirichlet::zero("bottom", component));
            let value = move |_: &BoundaryPoint, t: f64| top * (2.0 * t / END).min(1.0);
            model.dirichlet.push(Dirichlet { place: Place::Tag("top".into()), component, value: Arc::new(value) });
        }
        model
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
        Ok(Outcome::Discarded(why, report)) => panic!("{why}: {report:?}"),
        Err(e) => panic!("{e}"),
    }
}
