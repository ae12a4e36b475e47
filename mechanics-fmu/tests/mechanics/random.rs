//! Random problems: fractures of all families with random laws, loads and pressures.

use std::sync::{Arc, LazyLock};

use mechanics_fmu::{Bubbles, Dilation, FractureLaw, Friction, Mechanics, Partner, PartnerResponse};
use mesh::{Mesh, Vec3};
use proptest::prelude::*;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

use crate::common::{coulomb, fractured, hold, mesh, model, start};

/// Size of the smallest faces (m).
pub(crate) const SMALLEST: f64 = 0.03;

static MESHES: LazyLock<Vec<(&str, Arc<Mesh>)>> = LazyLock::new(|| {
    let families = ["triangles", "polygons", "perturbed squares", "cubes", "tetrahedra"];
    families.into_iter().map(|family| (family, mesh(fractured(family)))).collect()
});

#[derive(Clone, Debug)]
pub(crate) struct Load {
    top: Vec3,
    matrix_pressure: f64,
    fracture_pressure: f64,
}

/// What is random of a fracture's law.
#[derive(Clone, Debug)]
pub(crate) struct Law {
    friction: Friction,
    dilation_angle: f64,
    dilation: Dilation,
    dilation_limit: Option<f64>,
    normal_stiffness: Option<f64>,
    largest_closure: Option<f64>,
}

#[derive(Clone, Debug)]
pub(crate) struct Case {
    mesh: usize,
    laws: Vec<Law>,
    two_sided: bool,
    /// Stiffnesses (Pa, Pa/m) with which pressures follow.
    pub(crate) follow: Option<(f64, f64)>,
    pub(crate) loads: Vec<Load>,
}

fn load() -> impl Strategy<Value = Load> {
    let part = -1e-3..1e-3;
    (part.clone(), part, -1e-3..3e-4, 0.0..5e6, 0.0..5e6).prop_map(|(x, y, up, matrix_pressure, fracture_pressure)| {
        Load { top: Vec3::new(x, y, up), matrix_pressure, fracture_pressure }
    })
}

/// Dilation of the aperture and linear closure.
pub(crate) fn plain(friction: impl Strategy<Value = Friction>) -> impl Strategy<Value = Law> {
    let stiffness = prop_oneof![2 => Just(None), 1 => (1e10..1e12).prop_map(Some)];
    (friction, 0.0..0.4, stiffness).prop_map(|(friction, dilation_angle, normal_stiffness)| Law {
        friction,
        dilation_angle,
        dilation: Dilation::Hydraulic,
        dilation_limit: None,
        normal_stiffness,
        largest_closure: None,
    })
}

/// Coulomb's law on joints that dilate either way, with and without limit, and close by all laws.
pub(crate) fn joints() -> impl Strategy<Value = Law> {
    let dilation = prop_oneof![1 => Just(Dilation::Hydraulic), 3 => Just(Dilation::Mechanical)];
    let limit = prop_oneof![1 => Just(None), 1 => (1e-5..3e-4).prop_map(Some)];
    let closure = prop_oneof![
        1 => Just((None, None)),
        1 => (1e10..1e12).prop_map(|k| (Some(k), None)),
        2 => (1e9..1e12, 1e-6..9e-5).prop_map(|(k, largest)| (Some(k), Some(largest))),
    ];
    (0.1..0.9_f64, 0.0..0.95_f64, 0.0..1e6_f64, dilation, limit, closure).prop_map(
        |(coefficient, part, cohesion, dilation, dilation_limit, (normal_stiffness, largest_closure))| Law {
            friction: Friction::Coulomb { coefficient, cohesion: (cohesion - 5e5).max(0.0) },
            dilation_angle: (part * coefficient).atan(),
            dilation,
            dilation_limit,
            normal_stiffness,
            largest_closure,
        },
    )
}

pub(crate) fn case(law: impl Strategy<Value = Law>) -> impl Strategy<Value = Case> {
    let laws = prop::collection::vec(law, 2);
    let follow = prop_oneof![3 => Just(None), 1 => (0.0..1e10, 0.0..1e10).prop_map(Some)];
    (0..MESHES.len(), laws, any::<bool>(), follow, prop::collection::vec(load(), 3))
        .prop_map(|(mesh, laws, two_sided, follow, loads)| Case { mesh, laws, two_sided, follow, loads })
}

/// Calls `check` with `cases` cases, always the same.
pub(crate) fn for_all(
    cases: u32,
    strategy: impl Strategy<Value = Case>,
    check: impl Fn(Case) -> Result<(), TestCaseError>,
) {
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    if let Err(e) = runner.run(&strategy, check) {
        panic!("{e}");
    }
}

/// The mechanics of a case, to this tolerance of Newton's method.
pub(crate) fn prepare(case: &Case, tolerance: f64) -> Mechanics {
    let mesh = &MESHES[case.mesh].1;
    let d = mesh.dim();
    let mut model = model(mesh, &coulomb(0.0, 0.0));
    model.newton.tolerance = tolerance;
    for (law, random) in model.fractures.values_mut().zip(&case.laws) {
        let Law { friction, dilation_angle, dilation, dilation_limit, normal_stiffness, largest_closure } = *random;
        *law = FractureLaw {
            friction,
            dilation_angle,
            dilation,
            dilation_limit,
            normal_stiffness,
            largest_closure,
            ..law.clone()
        };
    }
    model.bubbles = if case.two_sided { Bubbles::TwoSided } else { Bubbles::OneSided };
    hold(&mut model, d, &["bottom"], |_, _| Vec3::ZERO);
    let loads = case.loads.clone();
    hold(&mut model, d, &["top"], move |_, t| {
        let v = loads[t as usize - 1].top;
        if d == 2 { Vec3::new(v.x, v.z, 0.0) } else { v }
    });
    start(mesh, model)
}

pub(crate) fn partner(mesh: &Mesh, load: &Load, follow: Option<(f64, f64)>) -> Partner {
    let (cells, faces) = (mesh.cell_count(), mesh.network().face_count());
    let response = follow.map(|(matrix, fracture)| PartnerResponse {
        matrix_pressure_stiffness: vec![matrix; cells],
        porosity_change: vec![0.0; cells],
        fracture_pressure_stiffness: vec![fracture; faces],
        aperture: vec![1e-4; faces],
    });
    let fracture_pressure = vec![load.fracture_pressure; faces];
    Partner { fracture_pressure, response, ..Partner::uniform(mesh, load.matrix_pressure) }
}
