//! Rock that hardly changes its volume: cases with exact solutions that a space that locks misses.

use std::f64::consts::PI;
use std::sync::Arc;

use mechanics_fmu::{
    BoundaryPoint, Bubbles, Dirichlet, FractureLaw, Friction, Material, Mechanics, Model, Neumann, NormalBubbles,
    Outcome, Partner, PartnerResponse, Place, State,
};
use mesh::generate::{Triangles, agglomerate, cartesian, dual, extrude, perturb, simplices};
use mesh::{Mesh, MeshData, Vec3};

fn sound(data: MeshData) -> Mesh {
    Mesh::new(data).unwrap_or_else(|e| panic!("{e}"))
}

/// Why the rock keeps its volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Because {
    /// Poisson's ratio is near ½.
    Drained,
    /// Its pores (b = 1) hold a fluid that does not leave; drained, λ = μ.
    Undrained,
}

/// One time step from rest in which the matrix pressure follows the deformation, p_m = −S b div u (S in Pa).
///
/// # Panics
/// If the model is refused or Newton's method gives up.
fn solve_undrained(mesh: Arc<Mesh>, model: Model, stiffness: f64) -> (Mechanics, State) {
    let (cells, faces) = (mesh.cell_count(), mesh.network().face_count());
    let mut partner = Partner::uniform(&mesh, 0.0);
    partner.response = Some(PartnerResponse {
        matrix_pressure_stiffness: vec![stiffness; cells],
        porosity_change: vec![0.0; cells],
        fracture_pressure_stiffness: vec![0.0; faces],
        aperture: vec![1.0; faces],
    });
    let mut mechanics = Mechanics::new(mesh, model).unwrap_or_else(|e| panic!("{e}"));
    let rest = mechanics.rest(0.0);
    match mechanics.step(&rest, 1.0, &partner) {
        Ok(Outcome::Converged(state, _)) => (mechanics, state),
        Ok(Outcome::Discarded(why, report)) => panic!("{why}: {report:?}"),
        Err(e) => panic!("{e}"),
    }
}

/// u = u₀ + ∇φ/λ on the unit square or cube with div u₀ = 0 and Δφ = q, so that λ div u = q whatever λ is, with μ = 1:
///
/// ```text
/// q = Π sin πx_i,   u₀ = (sin πx cos πy, −cos πx sin πy)   or   (sin πx cos πy cos πz, cos πx sin πy cos πz, −2 cos πx cos πy sin πz)
/// ```
pub mod incompressible {
    use super::*;

    /// The families of meshes in 2D and 3D, and for each the boxes along an edge that they are made from, level by level.
    pub const FAMILIES: [(&str, [usize; 3]); 9] = [
        ("triangles", [8, 16, 32]),
        ("squares", [8, 16, 32]),
        ("perturbed squares", [8, 16, 32]),
        ("polygons", [8, 16, 32]),
        ("tetrahedra", [4, 8, 12]),
        ("cubes", [4, 8, 12]),
        ("perturbed hexahedra", [4, 8, 12]),
        ("dual polyhedra", [4, 6, 9]),
        ("agglomerated tetrahedra", [6, 9, 13]),
    ];

    /// A mesh of a family.
    ///
    /// # Panics
    /// If there is no such family.
    pub fn mesh(family: &str, n: usize) -> Arc<Mesh> {
        let boxes = |dim: usize| sound(cartesian(Vec3::ZERO, Vec3::ONE, if dim == 2 { [n, n, 0] } else { [n; 3] }));
        let triangles = || sound(Triangles::rectangle([0.0; 2], [1.0; 2], 1.0 / n as f64).build().unwrap_or_default());
        let tetrahedra = || sound(simplices(&sound(perturb(&boxes(3), 0.1, 2))).unwrap_or_default());
        Arc::new(match family {
            "triangles" => triangles(),
            "squares" => boxes(2),
            "perturbed squares" => sound(perturb(&boxes(2), 0.2, 1)),
            "polygons" => sound(dual(&triangles()).unwrap_or_default()),
            "tetrahedra" => tetrahedra(),
            "cubes" => boxes(3),
            "perturbed hexahedra" => sound(perturb(&boxes(3), 0.2, 1)),
            "dual polyhedra" => sound(dual(&tetrahedra()).unwrap_or_default()),
            "agglomerated tetrahedra" => sound(agglomerate(&tetrahedra(), 8).unwrap_or_default()),
            _ => panic!("there is no family {family}"),
        })
    }

    /// Mean size of the cells: that of equal squares or cubes.
    pub fn size(mesh: &Mesh) -> f64 {
        (1.0 / mesh.cell_count() as f64).powf(1.0 / mesh.dim() as f64)
    }

    fn waves(dim: usize, x: Vec3) -> ([f64; 3], [f64; 3]) {
        let mut waves = ([0.0, 0.0, 1.0], [1.0; 3]);
        for c in 0..dim {
            (waves.0[c], waves.1[c]) = (PI * x[c]).sin_cos();
        }
        waves
    }

    /// q.
    pub fn pressure(dim: usize, x: Vec3) -> f64 {
        waves(dim, x).0.iter().product()
    }

    /// ∇q/π.
    fn slope(dim: usize, x: Vec3) -> Vec3 {
        let (s, c) = waves(dim, x);
        let of = |k: usize| if k < dim { c[k] * s[(k + 1) % 3] * s[(k + 2) % 3] } else { 0.0 };
        Vec3::new(of(0), of(1), of(2))
    }

    /// u for λ.
    pub fn displacement(dim: usize, lambda: f64, x: Vec3) -> Vec3 {
        let (s, c) = waves(dim, x);
        let u0 = if dim == 2 {
            Vec3::new(s[0] * c[1], -c[0] * s[1], 0.0)
        } else {
            Vec3::new(s[0] * c[1] * c[2], c[0] * s[1] * c[2], -2.0 * c[0] * c[1] * s[2])
        };
        // φ = −q/(dπ²).
        u0 - slope(dim, x) / (dim as f64 * PI * lambda)
    }

    /// −div σ = −Δu₀ − (λ+2)/λ ∇q.
    fn force(dim: usize, lambda: f64, x: Vec3) -> Vec3 {
        let d = dim as f64;
        let u0 = displacement(dim, f64::INFINITY, x);
        d * PI * PI * u0 - (lambda + 2.0) / lambda * PI * slope(dim, x)
    }

    /// Relative L² errors: of u, of ∇u, and of q, the last from λ div_D u.
    #[derive(Clone, Copy, Debug)]
    pub struct Errors {
        /// ‖Πu_D − u‖/‖u‖.
        pub displacement: f64,
        /// ‖∇_D u − ∇u‖/‖∇u‖.
        pub gradient: f64,
        /// ‖λ div_D u − q‖/‖q‖, q at the cells' centres.
        pub pressure: f64,
    }

    /// Solves with Dirichlet data on all of the boundary.
    pub fn solve(mesh: &Arc<Mesh>, because: Because, lambda: f64, normal_bubbles: NormalBubbles) -> Errors {
        let dim = mesh.dim();
        let (own, added) = match because {
            Because::Drained => (lambda, 0.0),
            Because::Undrained => (1.0, lambda - 1.0),
        };
        let mut model = Model { normal_bubbles, ..Model::default() };
        model.materials.insert("rock".into(), Material::from_lame(own, 1.0, 1.0));
        model.undrained = Some(Arc::new(move |_, _| added));
        for tag in &mesh.data().tags {
            for component in 0..dim {
                let value = Arc::new(move |p: &BoundaryPoint, _| displacement(dim, lambda, p.at)[component]);
                model.dirichlet.push(Dirichlet { place: Place::Tag(tag.clone()), component, value });
            }
        }
        model.body_force = Some(Arc::new(move |x, _| force(dim, lambda, x)));
        let (mechanics, state) = solve_undrained(Arc::clone(mesh), model, added);
        errors(&mechanics, &state, lambda)
    }

    fn errors(mechanics: &Mechanics, state: &State, lambda: f64) -> Errors {
        let mesh = mechanics.mesh();
        let dim = mesh.dim();
        let gradients = mechanics.displacement_gradient(state);
        let means = mechanics.cell_displacement(state);
        let divergence = mechanics.divergence(state);
        let [mut eu, mut u2, mut eg, mut g2, mut ep, mut p2] = [0.0; 6];
        // Fourth-order differences of smooth functions: exact to 1e-9.
        let step = 1e-3;
        for cell in 0..mesh.cell_count() {
            let (center, measure) = (mesh.geometry().cell_center[cell], mesh.geometry().cell_measure[cell]);
            let q = pressure(dim, center);
            ep += measure * (lambda * divergence[cell] - q).powi(2);
            p2 += measure * q * q;
            for (x, w) in mesh.quadrature(cell) {
                let u = displacement(dim, lambda, x);
                let rows = gradients[cell];
                let arm = x - center;
                let linear = Vec3::new(rows[0].dot(arm), rows[1].dot(arm), rows[2].dot(arm));
                eu += w * (means[cell] + linear - u).length_squared();
                u2 += w * u.length_squared();
                for axis in 0..dim {
                    let at = |k: f64| {
                        let mut y = x;
                        y[axis] += k * step;
                        displacement(dim, lambda, y)
                    };
                    let column = (8.0 * (at(1.0) - at(-1.0)) - at(2.0) + at(-2.0)) / (12.0 * step);
                    for c in 0..dim {
                        eg += w * (rows[c][axis] - column[c]).powi(2);
                        g2 += w * column[c].powi(2);
                    }
                }
            }
        }
        Errors { displacement: (eu / u2).sqrt(), gradient: (eg / g2).sqrt(), pressure: (ep / p2).sqrt() }
    }
}

/// A cantilever in plane strain, 10 × 1 m, loaded by parabolic shear at its end (S. P. Timoshenko, J. N. Goodier, Theory of
/// Elasticity, section 21; the displacement at the clamped end is the exact one): E = 1, undrained with M = ∞.
pub mod cantilever {
    use super::*;

    const LENGTH: f64 = 10.0;
    const DEPTH: f64 = 1.0;
    /// Drained rock: E (Pa) and ν; λ added by the fluid: as good as none of it may leave.
    const YOUNG: f64 = 1.0;
    const POISSON: f64 = 0.25;
    const FLUID: f64 = 1e7;

    /// `n` cells over the depth: `squares`, `triangles`, `polygons`, `tetrahedra` or `cubes`; in 3D the beam is one metre thick.
    ///
    /// # Panics
    /// If there is no such family.
    pub fn mesh(family: &str, n: usize) -> Arc<Mesh> {
        let long = n * LENGTH as usize;
        let (low, high) = (Vec3::new(0.0, -0.5 * DEPTH, 0.0), Vec3::new(LENGTH, 0.5 * DEPTH, 1.0));
        let boxes = |cells| sound(cartesian(low, high, cells));
        let triangles = || {
            let made = Triangles::rectangle([0.0, low.y], [LENGTH, high.y], DEPTH / n as f64).build();
            sound(made.unwrap_or_default())
        };
        Arc::new(match family {
            "squares" => boxes([long, n, 0]),
            "triangles" => triangles(),
            "polygons" => sound(dual(&triangles()).unwrap_or_default()),
            "cubes" => boxes([long, n, n]),
            "tetrahedra" => sound(simplices(&boxes([long, n, n])).unwrap_or_default()),
            _ => panic!("there is no family {family}"),
        })
    }

    fn exact(x: Vec3) -> Vec3 {
        let drained = Material { young_modulus: YOUNG, poisson_ratio: POISSON, biot_coefficient: 1.0 };
        let undrained = Material::from_lame(drained.lambda() + FLUID, drained.mu(), 1.0);
        // Plane strain: E/(1 − ν²) and ν/(1 − ν) in the formulas of plane stress.
        let young = undrained.plane_strain_modulus();
        let nu = undrained.poisson_ratio / (1.0 - undrained.poisson_ratio);
        let inertia = DEPTH.powi(3) / 12.0;
        let scale = 1.0 / (6.0 * young * inertia);
        let (l, d2, y) = (LENGTH, DEPTH * DEPTH, x.y);
        Vec3::new(
            scale * y * ((6.0 * l - 3.0 * x.x) * x.x + (2.0 + nu) * (y * y - 0.25 * d2)),
            -scale * (3.0 * nu * y * y * (l - x.x) + 0.25 * (4.0 + 5.0 * nu) * d2 * x.x + (3.0 * l - x.x) * x.x * x.x),
            0.0,
        )
    }

    /// Deflection of the end over the exact one; and the standard deviation of the pressure from the exact one,
    /// over the largest.
    pub fn solve(mesh: Arc<Mesh>, normal_bubbles: NormalBubbles) -> [f64; 2] {
        let dim = mesh.dim();
        let rock = Material { young_modulus: YOUNG, poisson_ratio: POISSON, biot_coefficient: 1.0 };
        let mut model = Model { normal_bubbles, ..Model::default() };
        model.materials.insert("rock".into(), rock);
        model.undrained = Some(Arc::new(|_, _| FLUID));
        for component in 0..2 {
            let value = Arc::new(move |p: &BoundaryPoint, _| exact(p.at)[component]);
            model.dirichlet.push(Dirichlet { place: Place::Tag("left".into()), component, value });
        }
        if dim == 3 {
            model.dirichlet.extend(["bottom", "top"].map(|tag| Dirichlet::zero(tag, 2)));
        }
        let inertia = DEPTH.powi(3) / 12.0;
        // Its mean on faces of height h around x.
        let h = mesh.tagged_faces("right").map(|f| mesh.face_vertices(f));
        let height = |list: &[usize]| {
            let y = list.iter().map(|&v| mesh.vertices()[v].y);
            y.clone().fold(f64::NEG_INFINITY, f64::max) - y.fold(f64::INFINITY, f64::min)
        };
        let h = h.map(height).fold(0.0, f64::max);
        let shear = move |x: Vec3, _| {
            let mean = 0.25 * DEPTH * DEPTH - x.y * x.y - h * h / 12.0;
            Vec3::new(0.0, -mean / (2.0 * inertia), 0.0)
        };
        model.neumann.push(Neumann { tag: "right".into(), traction: Arc::new(shear) });
        let (mechanics, state) = solve_undrained(Arc::clone(&mesh), model, FLUID);
        let end = (mesh.nodes().vertices().iter().enumerate())
            .filter(|&(_, &v)| mesh.vertices()[v].x > LENGTH - 1e-9)
            .map(|(node, &v)| state.unknowns[node * dim + 1] / exact(mesh.vertices()[v]).y);
        let end: Vec<f64> = end.collect();
        // As ν_u → ½, p = −σ_xx/2.
        let exact_pressure = |x: Vec3| -0.5 * (LENGTH - x.x) * x.y / inertia;
        let divergence = mechanics.divergence(&state);
        let geometry = mesh.geometry();
        let [mut sum, mut size] = [0.0; 2];
        for (k, center) in geometry.cell_center.iter().enumerate() {
            sum += geometry.cell_measure[k] * (-FLUID * divergence[k] - exact_pressure(*center)).powi(2);
            size += geometry.cell_measure[k];
        }
        [end.iter().sum::<f64>() / end.len() as f64, (sum / size).sqrt() / exact_pressure(Vec3::new(0.0, -0.5, 0.0))]
    }
}

/// A penny-shaped crack of radius a = 1 m under pressure p in a large body (I. N. Sneddon, Proc. R. Soc. A 187, 1946): its volume
/// is 16 (1 − ν²) p a³/(3E). A quarter of it, with rollers on the planes of symmetry.
pub mod penny {
    use super::*;

    const POISSON: f64 = 0.25;
    const YOUNG: f64 = 1.0;
    const PRESSURE: f64 = 1e-3;

    /// Tetrahedra with `faces` edges along a radius; further out they grow with the distance.
    ///
    /// # Panics
    /// If the mesh cannot be made.
    pub fn tetrahedra(faces: usize) -> Mesh {
        let arc = (3 * faces).div_ceil(2);
        let point = |k: usize| {
            let (s, c) = (0.5 * PI * k as f64 / arc as f64).sin_cos();
            // Rounded ends would lie off the boundary.
            [if k == arc { 0.0 } else { c }, if k == 0 { 0.0 } else { s }]
        };
        let points: Vec<[f64; 2]> = (0..=arc).map(point).collect();
        let h = 1.0 / faces as f64;
        let plan = Triangles::rectangle([0.0; 2], [EXTENT; 2], EXTENT)
            .interface("front", &points, None)
            .size(move |x| h * x.length().max(1.0))
            .build();
        let plan = sound(plan.unwrap_or_else(|e| panic!("{e}")));
        // Layers grow with the distance from the crack.
        let mut levels = vec![0.0];
        while levels[levels.len() - 1] < EXTENT {
            let z: f64 = levels[levels.len() - 1];
            levels.push((z + h * (1.0 + z)).min(EXTENT));
        }
        let mut all: Vec<f64> = levels[1..].iter().rev().map(|z| -z).collect();
        all.extend(levels);
        let mut prisms = extrude(&plan, &all, |_, _| true).unwrap_or_else(|e| panic!("{e}"));
        prisms.mark_fracture("penny", |x| x.z.abs() < 1e-9 && x.x.hypot(x.y) < 1.0);
        sound(simplices(&sound(prisms)).unwrap_or_else(|e| panic!("{e}")))
    }

    /// The body reaches this far (m).
    const EXTENT: f64 = 6.0;

    /// The crack's volume over the exact one of the crack's area.
    pub fn solve(mesh: Arc<Mesh>, bubbles: Bubbles, normal_bubbles: NormalBubbles) -> f64 {
        let mut model = Model { bubbles, normal_bubbles, ..Model::default() };
        let rock = Material { young_modulus: YOUNG, poisson_ratio: POISSON, biot_coefficient: 0.0 };
        model.materials.insert("rock".into(), rock);
        let law = FractureLaw { friction: Friction::None, ..FractureLaw::coulomb(0.0, 1e-6) };
        model.fractures.insert("penny".into(), law);
        for (tag, component) in [("left", 0), ("front", 1), ("bottom", 2)] {
            model.dirichlet.push(Dirichlet::zero(tag, component));
        }
        let mut partner = Partner::uniform(&mesh, 0.0);
        partner.fracture_pressure.fill(PRESSURE);
        let mut mechanics = Mechanics::new(Arc::clone(&mesh), model).unwrap_or_else(|e| panic!("{e}"));
        let rest = mechanics.rest(0.0);
        let state = match mechanics.step(&rest, 1.0, &partner) {
            Ok(Outcome::Converged(state, _)) => state,
            other => panic!("{other:?}"),
        };
        let areas = mesh.network().faces.iter().map(|&f| mesh.geometry().face_measure[f]);
        let jump = state.jump(mechanics.space());
        let volume: f64 = areas.clone().zip(jump.chunks_exact(3)).map(|(a, g)| -a * g[0]).sum();
        let radius = (4.0 * areas.sum::<f64>() / PI).sqrt();
        4.0 * volume / (16.0 * (1.0 - POISSON * POISSON) * PRESSURE * radius.powi(3) / (3.0 * YOUNG))
    }
}
