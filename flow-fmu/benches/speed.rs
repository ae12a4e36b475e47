//! Seconds and memory of one time step, and of bare faer on the same system: `cargo bench -p flow-fmu [-- WORD]` takes
//! the meshes whose names contain the word. See RESULTS.md.

use std::sync::Arc;
use std::time::Instant;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::cholesky::{CholeskySymbolicParams, SymmetricOrdering, factorize_symbolic_cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, Mat, Par, Side};
use flow_fmu::{Boundary, Flow, FlowModel, Fluid, Fracture, Rock};
use mesh::generate::{Triangles, cartesian, simplices};
use mesh::{Mesh, MeshData, Vec3};

/// Solves and factorisations are repeated, and the quickest counts.
const REPEATS: usize = 8;

fn main() {
    println!("| mesh | cells | unknowns | entries of the factor | factor (MB) |");
    println!("|---|---|---|---|---|");
    // Cargo adds an option of its own.
    let word = std::env::args().skip(1).find(|a| !a.starts_with('-')).unwrap_or_default();
    let chosen = meshes().into_iter().filter(|m| m.0.contains(&word));
    let results: Vec<_> = chosen.map(|(name, data)| (name, measure(name, data))).collect();
    println!("\n| mesh | what | flow (s) | bare faer (s) | ratio |");
    println!("|---|---|---|---|---|");
    for (name, rows) in results {
        for (what, own, bare) in rows {
            match bare {
                Some(bare) => println!("| {name} | {what} | {own:.4} | {bare:.4} | {:.2} |", own / bare),
                None => println!("| {name} | {what} | {own:.4} | | |"),
            }
        }
    }
}

/// The six fractures of C3 in triangles, and the four of C4 in tetrahedra.
fn meshes() -> Vec<(&'static str, MeshData)> {
    let h = 0.0114;
    let lines: [&[[f64; 2]]; 6] = [
        &[[0.2, 0.7], [0.5, 0.7], [0.8, 0.65]],
        &[[1.0, 0.3], [1.8, 0.4]],
        &[[0.2, 0.3], [0.6, 0.25]],
        &[[1.0, 0.4], [1.7, 0.85]],
        &[[1.5, 0.65], [2.0, 0.55]],
        &[[1.5, 0.05], [1.4, 0.25]],
    ];
    let mut flat = Triangles::rectangle([0.0, 0.0], [2.0, 1.0], h);
    for (name, line) in ["1", "2", "3", "4", "5", "6"].into_iter().zip(lines) {
        flat = flat.fracture(name, line, h);
    }
    let solid = |n: usize| {
        let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [n, n, n]);
        let near = |v: f64, at: f64| (v - at).abs() < 0.3 / n as f64;
        // Planes of the mesh near the places of C4.
        let at = |v: f64| (v * n as f64).round() / n as f64;
        let inside = move |v: f64| v > at(0.2) - 1e-9 && v < at(0.8) + 1e-9;
        data.mark_fracture("1", |x| near(x.y, at(0.5)) && inside(x.x) && inside(x.z));
        data.mark_fracture("2", |x| near(x.x, at(0.3)) && inside(x.y) && inside(x.z));
        data.mark_fracture("3", |x| near(x.x, at(0.5)) && inside(x.y) && inside(x.z));
        data.mark_fracture("4", |x| near(x.x, at(0.7)) && inside(x.y) && inside(x.z));
        simplices(&Mesh::new(data).unwrap()).unwrap()
    };
    vec![
        ("34 000 triangles", flat.build().unwrap()),
        ("47 000 tetrahedra", solid(20)),
        ("127 000 tetrahedra", solid(28)),
    ]
}

fn seconds<T>(repeats: usize, mut work: impl FnMut() -> T) -> (f64, T) {
    let mut run = || {
        let start = Instant::now();
        let result = work();
        (start.elapsed().as_secs_f64(), result)
    };
    let mut best = run();
    for _ in 1..repeats {
        let next = run();
        if next.0 < best.0 {
            best = next;
        }
    }
    best
}

type Row = (&'static str, f64, Option<f64>);

fn measure(name: &str, data: MeshData) -> Vec<Row> {
    let (mesh_time, mesh) = seconds(1, || Arc::new(Mesh::new(data.clone()).unwrap()));
    let mut model = FlowModel::new(Fluid::default());
    model.rocks.push(("rock".into(), Rock::isotropic(1e-15, 0.1, Some(1e10))));
    for fracture in &mesh.data().fractures {
        let properties = Fracture { normal_permeability: 1e-15, aperture: 1e-4.into() };
        model.fractures.push((fracture.clone(), properties));
    }
    model.boundaries.push(("left".into(), Boundary::pressure(1e5)));
    model.initial_pressure = 1e5.into();
    let (new_time, mut flow) = seconds(1, || Flow::new(mesh.clone(), model.clone()).unwrap());
    let mut inputs = flow.inputs();
    inputs.porosity_compliance.fill(2e-11);
    inputs.aperture_compliance.fill(1e-11);
    let start = flow.state().clone();
    let (first_time, _) = seconds(1, || flow.step(100.0, &inputs).unwrap());
    let mut dt = 100.0;
    let (step_time, _) = seconds(REPEATS, || {
        flow.set_state(start.clone()).unwrap();
        dt *= 1.1;
        flow.step(dt, &inputs).unwrap()
    });
    let before = flow.state().clone();
    let count = flow.step(dt, &inputs).unwrap().work.factorisations;
    flow.set_state(before).unwrap();
    let (iteration_time, report) = seconds(REPEATS, || {
        flow.set_state(start.clone()).unwrap();
        flow.step(dt, &inputs).unwrap()
    });
    assert!(report.work.factorisations <= count + 1, "coupling iterations keep the factor");
    let memory = flow.memory().unwrap();
    println!(
        "| {name} | {} | {} | {} | {:.0} (all: {:.0}) |",
        mesh.cell_count(),
        flow.unknowns(),
        memory.factor_entries,
        memory.factor_bytes as f64 / 1e6,
        memory.total_bytes as f64 / 1e6
    );

    let bare = bare(&flow);
    vec![
        ("mesh, checked", mesh_time, None),
        ("new flow: operators and analysis", new_time, None),
        ("analysis of the ordered system alone", bare.own_analysis, Some(bare.analysis)),
        ("first time step", first_time, None),
        ("assembly, factorisation, solve: a time step", step_time, Some(bare.factorisation + bare.solve)),
        ("a coupling iteration", iteration_time, None),
        ("factorisation alone", bare.own_factorisation, Some(bare.factorisation)),
        ("solve alone", bare.own_solve, Some(bare.solve)),
    ]
}

struct Bare {
    analysis: f64,
    factorisation: f64,
    solve: f64,
    own_analysis: f64,
    own_factorisation: f64,
    own_solve: f64,
}

/// faer's own interface on the same system, which has its order already.
fn bare(flow: &Flow) -> Bare {
    let system = flow.system();
    let pattern = system.pattern();
    let n = pattern.len();
    let (ptr, idx) = pattern.lower();
    let symbolic = SymbolicSparseColMatRef::new_checked(n, n, ptr, None, &idx);
    let matrix = SparseColMatRef::new(symbolic, system.values());
    // faer 0.24 does not take a lower triangle with `SymmetricOrdering::Identity`.
    let identity: Vec<u32> = (0..n as u32).collect();
    let (analysis, factor) = seconds(1, || {
        let order = SymmetricOrdering::Custom(faer::perm::PermRef::new_checked(&identity, &identity, n));
        factorize_symbolic_cholesky(symbolic, Side::Lower, order, CholeskySymbolicParams::default()).unwrap()
    });
    let par = Par::rayon(0);
    let mut values = vec![0.0; factor.len_val()];
    let scratch = factor.factorize_numeric_llt_scratch::<f64>(par, Default::default());
    let mut memory = MemBuffer::new(scratch);
    let (factorisation, _) = seconds(REPEATS, || {
        factor
            .factorize_numeric_llt(
                &mut values,
                matrix,
                Side::Lower,
                LltRegularization::default(),
                par,
                MemStack::new(&mut memory),
                Default::default(),
            )
            .map(|_| ())
            .unwrap();
    });
    let mut memory = MemBuffer::new(factor.solve_in_place_scratch::<f64>(1, par));
    let llt = faer::sparse::linalg::cholesky::LltRef::new(&factor, &values);
    let mut x = Mat::<f64>::from_fn(n, 1, |i, _| (i as f64).sin());
    let (solve, ()) = seconds(REPEATS, || {
        llt.solve_in_place_with_conj(Conj::No, x.as_mut(), par, MemStack::new(&mut memory));
    });
    let (own_analysis, own) = seconds(1, || Arc::new(linear::Symbolic::new(pattern).unwrap()));
    let mut own = linear::Cholesky::new(&own, system, par).unwrap();
    let (own_factorisation, ()) = seconds(REPEATS, || own.refactorise(system).unwrap());
    let (mut x, mut scratch) = (vec![1.0; n], linear::Scratch::default());
    let (own_solve, ()) = seconds(REPEATS, || own.solve(&mut x, &mut scratch).unwrap());
    Bare { analysis, factorisation, solve, own_analysis, own_factorisation, own_solve }
}
