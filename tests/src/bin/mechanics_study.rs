//! Studies of the mechanics: prints tables, and writes CSV files and SVG plots to results/mechanics.
//!
//! `cargo run --release -p tests --bin mechanics-study -- <study>`; `--help` lists the studies.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::{Parser, Subcommand};
use mechanics_fmu::{Bubbles, ContactState, Mechanics, Model, NormalBubbles, Outcome as StepOutcome, Partner, State};
use mesh::Mesh;
use tests::contact_cases::{manufactured, network_3d, single_crack, solve_dry};
use tests::locking::{Because, cantilever, incompressible, penny};
use tests::plot::{Curve, Outcome, Series, order, plot, slope, table};

#[derive(Parser)]
#[command(about = "Studies of the mechanics; tables go to the terminal, CSV and SVG to results/mechanics")]
struct Arguments {
    #[command(subcommand)]
    study: Study,
    /// Where results go.
    #[arg(long, default_value = "results/mechanics", global = true)]
    output: PathBuf,
}

#[derive(Subcommand)]
enum Study {
    /// C1: orders of a manufactured frictionless contact on all kinds of meshes.
    Manufactured {
        /// Levels of each family.
        #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=5))]
        levels: u8,
    },
    /// C2: slip and traction of a crack under compression.
    SingleCrack {
        /// Largest number of faces on the crack.
        #[arg(long, default_value_t = 800)]
        faces: usize,
    },
    /// C4: contact states and jumps of a network of four fractures, with bubbles on one and on both sides.
    #[command(name = "network-3d")]
    Network3d {
        /// Meshes to run, of about 5 000, 10 000 and 47 000 cells.
        #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=3))]
        meshes: u8,
    },
    /// Nearly incompressible and undrained rock with and without normal bubbles: orders, a cantilever, a penny-shaped crack.
    Locking {
        /// Levels of each family.
        #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=3))]
        levels: u8,
    },
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.output)?;
    let output = &arguments.output;
    match arguments.study {
        Study::Manufactured { levels } => study_manufactured(output, levels.into()),
        Study::SingleCrack { faces } => study_single_crack(output, faces),
        Study::Network3d { meshes } => study_network_3d(output, meshes.into()),
        Study::Locking { levels } => study_locking(output, levels.into()),
    }
}

fn study_manufactured(output: &Path, levels: usize) -> Outcome<()> {
    let mut rows = Vec::new();
    let mut curves = [const { Vec::<Series>::new() }; 3];
    for (family, sizes) in manufactured::FAMILIES {
        let mut points = [const { Curve::new() }; 3];
        for &n in &sizes[..levels] {
            let mesh = manufactured::mesh(family, n);
            let (h, cells) = (manufactured::size(&mesh), mesh.cell_count());
            let clock = Instant::now();
            let (mechanics, state, report) = solve_dry(mesh, manufactured::model());
            let seconds = clock.elapsed().as_secs_f64();
            let e = manufactured::errors(&mechanics, &state);
            let mut row = vec![family.to_owned(), cells.to_string(), format!("{h:.4}")];
            for (curve, error) in points.iter_mut().zip([e.displacement, e.gradient, e.multiplier]) {
                row.extend([format!("{error:.3e}"), order(curve.last().copied(), h, error)]);
                curve.push((h, error));
            }
            row.extend([report.newton.iterations.to_string(), format!("{seconds:.1}")]);
            rows.push(row);
        }
        for (series, points) in curves.iter_mut().zip(points) {
            series.push((family.to_owned(), points).into());
        }
    }
    let head = ["family", "cells", "h", "u", "order", "grad u", "order", "lambda", "order", "Newton", "seconds"];
    table(output, "manufactured", &head, &rows)?;
    let names = [
        ("displacement", "Displacement", "relative L2 error", 2.0),
        ("gradient", "Gradient", "relative L2 error", 1.0),
        ("multiplier", "Multiplier", "L2 error (Pa m)", 1.0),
    ];
    for (mut series, (name, title, axis, expected)) in curves.into_iter().zip(names) {
        let reference = slope(expected, &series[0].points);
        series.push(reference);
        let title = format!("Manufactured frictionless contact: {title}");
        plot(output, &format!("manufactured-{name}"), &title, ["h (m)", axis], &series, true)?;
    }
    Ok(())
}

fn study_single_crack(output: &Path, largest: usize) -> Outcome<()> {
    let mut rows = Vec::new();
    let mut errors: Vec<(String, Curve)> = Vec::new();
    let mut profiles = [const { Vec::<Series>::new() }; 2];
    let loaded: &[usize] = &[50, 100, 200, 400, 800];
    let exact: &[usize] = &[40, 80, 160, 320];
    use Bubbles::{OneSided, TwoSided};
    let cases = [
        ("320 m, load", "triangles", OneSided, loaded),
        ("40 m, exact field", "triangles", OneSided, exact),
        ("40 m, exact field", "triangles", TwoSided, exact),
        ("40 m, exact field", "polygons", OneSided, exact),
        ("40 m, exact field", "polygons", TwoSided, exact),
    ];
    for (domain, cells, bubbles, sizes) in cases {
        let is_loaded = domain.starts_with("320");
        let name = format!("{domain}, {cells}, {}", side(bubbles));
        let mut curves = [const { Curve::new() }; 2];
        for &faces in sizes.iter().filter(|&&f| f <= largest) {
            let make = if cells == "triangles" { single_crack::triangles } else { single_crack::polygons };
            let extent = if is_loaded { 320.0 } else { 40.0 };
            let mesh = Arc::new(make(extent, faces, single_crack::growth(faces)));
            let count = mesh.cell_count();
            let clock = Instant::now();
            let mut model = if is_loaded { single_crack::model(extent) } else { single_crack::model_in_exact_field() };
            model.bubbles = bubbles;
            let (mechanics, state, report) = solve_dry(mesh, model);
            let seconds = clock.elapsed().as_secs_f64();
            let profile = single_crack::profile(&mechanics, &state);
            let h = 2.0 * single_crack::HALF_LENGTH / faces as f64;
            let e = single_crack::errors(&profile);
            let mut row: Vec<String> = [domain, cells, side(bubbles)].map(str::to_owned).into();
            row.extend([profile.len().to_string(), count.to_string()]);
            for (curve, error) in curves.iter_mut().zip([e.slip, e.traction]) {
                row.extend([format!("{error:.3e}"), order(curve.last().copied(), h, error)]);
                curve.push((h, error));
            }
            row.extend([e.slip_function, e.slip_least].map(|error| format!("{error:.3e}")));
            row.extend([report.newton.iterations.to_string(), format!("{seconds:.1}")]);
            rows.push(row);
            if is_loaded && [100, 400].contains(&faces) {
                for (k, series) in profiles.iter_mut().enumerate() {
                    let value = |f: &single_crack::FaceResult| [1e3 * f.slip, 1e-6 * f.traction][k];
                    let points = profile.iter().map(|f| (f.at, value(f))).collect();
                    series.push((format!("{faces} faces"), points).into());
                }
            }
        }
        for (what, curve) in ["slip", "traction"].into_iter().zip(curves) {
            errors.push((format!("{what}: {name}"), curve));
        }
    }
    let head = [
        "domain", "cells", "bubbles", "faces", "number", "slip", "order", "traction", "order", "slip, L2", "least",
        "Newton", "seconds",
    ];
    table(output, "single-crack", &head, &rows)?;
    for (k, what) in ["slip", "traction"].into_iter().enumerate() {
        let mut series: Vec<Series> = errors.iter().skip(k).step_by(2).cloned().map(Into::into).collect();
        series.push(slope(1.0, &errors[k].1));
        let (name, title) = (format!("single-crack-{what}-errors"), format!("A crack under compression: {what}"));
        plot(output, &name, &title, ["h (m)", "relative L2 error"], &series, true)?;
    }
    let along = |f: &dyn Fn(f64) -> f64| (0..=400).map(|k| f64::from(k) / 200.0 - 1.0).map(|x| (x, f(x))).collect();
    let exact: [Curve; 2] =
        [along(&|x| 1e3 * single_crack::slip(x)), along(&|_| 1e-6 * single_crack::normal_multiplier())];
    let names = [("slip", "slip (mm)"), ("traction", "normal multiplier (MPa)")];
    for ((mut series, exact), (name, axis)) in profiles.into_iter().zip(exact).zip(names) {
        series.push(Series::reference("exact", exact));
        let title = "A crack under compression";
        plot(output, &format!("single-crack-{name}"), title, ["distance from the middle (m)", axis], &series, false)?;
    }
    Ok(())
}

/// λ/μ of the study of locking: Poisson's ratio .25, .495, .49995, .4999995.
const RATIOS: [f64; 4] = [1.0, 1e2, 1e4, 1e6];
const SPACES: [(&str, NormalBubbles); 2] = [("no", NormalBubbles::None), ("all", NormalBubbles::All)];

fn study_locking(output: &Path, levels: usize) -> Outcome<()> {
    let mut rows = Vec::new();
    // Of each space: u, ∇u, p.
    let mut curves = [const { [const { Vec::<Series>::new() }; 3] }; 2];
    for (family, sizes) in incompressible::FAMILIES {
        let meshes: Vec<_> = sizes[..levels].iter().map(|&n| incompressible::mesh(family, n)).collect();
        for ((bubbles, normal), curves) in SPACES.into_iter().zip(&mut curves) {
            for because in [Because::Drained, Because::Undrained] {
                for ratio in RATIOS.into_iter().filter(|&r| because == Because::Drained || r > 1.0) {
                    let mut points = [const { Curve::new() }; 3];
                    for mesh in &meshes {
                        let (h, cells) = (incompressible::size(mesh), mesh.cell_count());
                        let e = incompressible::solve(mesh, because, ratio, normal);
                        let because = if because == Because::Drained { "drained" } else { "undrained" };
                        let mut row = [family, bubbles, because].map(str::to_owned).to_vec();
                        row.extend([format!("{ratio:e}"), cells.to_string(), format!("{h:.4}")]);
                        for (curve, error) in points.iter_mut().zip([e.displacement, e.gradient, e.pressure]) {
                            row.extend([format!("{error:.3e}"), order(curve.last().copied(), h, error)]);
                            curve.push((h, error));
                        }
                        rows.push(row);
                    }
                    if because == Because::Undrained && ratio == 1e6 {
                        for (series, points) in curves.iter_mut().zip(points) {
                            series.push((family.to_owned(), points).into());
                        }
                    }
                }
            }
        }
    }
    let head = ["family", "bubbles", "rock", "lambda/mu", "cells", "h", "u", "order", "grad u", "order", "p", "order"];
    table(output, "locking", &head, &rows)?;
    for ((bubbles, _), curves) in SPACES.into_iter().zip(curves) {
        for (series, name) in curves.into_iter().zip(["displacement", "gradient", "pressure"]) {
            let title = format!("Undrained rock, λ/μ = 1e6, normal bubbles on {bubbles} faces: {name}");
            let file = format!("locking-{name}-{bubbles}");
            plot(output, &file, &title, ["h (m)", "relative L2 error"], &series, true)?;
        }
    }

    let mut rows = Vec::new();
    for family in ["squares", "triangles", "polygons", "cubes", "tetrahedra"] {
        for n in [2, 4] {
            for (bubbles, normal) in SPACES {
                let mesh = cantilever::mesh(family, n);
                let cells = mesh.cell_count();
                let [tip, oscillation] = cantilever::solve(mesh, normal);
                rows.push(vec![
                    family.into(),
                    cells.to_string(),
                    bubbles.into(),
                    format!("{tip:.3}"),
                    format!("{oscillation:.3}"),
                ]);
            }
        }
    }
    table(output, "locking-cantilever", &["family", "cells", "bubbles", "tip/exact", "error of p"], &rows)?;

    let mut rows = Vec::new();
    for faces in [4, 6, 8] {
        let tetrahedra = Arc::new(penny::tetrahedra(faces));
        let dual = Arc::new(Mesh::new(mesh::generate::dual(&tetrahedra)?)?);
        for (family, mesh) in [("tetrahedra", tetrahedra), ("dual polyhedra", dual)] {
            for (normal, on) in SPACES {
                let volume = penny::solve(Arc::clone(&mesh), Bubbles::OneSided, on);
                let counts = [mesh.cell_count(), mesh.network().face_count()].map(|n| n.to_string());
                let [cells, faces] = counts;
                rows.push(vec![family.to_owned(), cells, faces, normal.to_owned(), format!("{volume:.3}")]);
            }
        }
    }
    table(output, "locking-penny", &["family", "cells", "faces", "bubbles", "volume/exact"], &rows)
}

fn side(bubbles: Bubbles) -> &'static str {
    if bubbles == Bubbles::OneSided { "one-sided" } else { "two-sided" }
}

fn study_network_3d(output: &Path, meshes: usize) -> Outcome<()> {
    let mut rows = Vec::new();
    let mut slips: Vec<Series> = Vec::new();
    for (size, layers) in [(0.09, 10), (0.07, 15), (0.04, 25)].into_iter().take(meshes) {
        let mesh = Arc::new(network_3d::tetrahedra(size, layers));
        for bubbles in [Bubbles::OneSided, Bubbles::TwoSided] {
            let series = network(&mesh, network_3d::model(bubbles), bubbles, &mut rows)?;
            slips.push((format!("{} cells, {}", mesh.cell_count(), side(bubbles)), series).into());
        }
    }
    let head = [
        "cells",
        "faces",
        "bubbles",
        "t (s)",
        "open",
        "stick",
        "slip",
        "t1 min (mm)",
        "t1 mean",
        "t1 max",
        "t2 min (mm)",
        "t2 mean",
        "t2 max",
        "Newton",
        "seconds",
    ];
    table(output, "network-3d", &head, &rows)?;
    plot(output, "network-3d", "Network in 3D", ["t (s)", "mean tangential jump (mm)"], &slips, false)
}

/// Twenty steps; the mean length of the tangential jump (mm) in time.
fn network(mesh: &Arc<Mesh>, model: Model, bubbles: Bubbles, rows: &mut Vec<Vec<String>>) -> Outcome<Curve> {
    const STEPS: usize = 20;
    let partner = Partner::uniform(mesh, network_3d::PRESSURE);
    let clock = Instant::now();
    let mut mechanics = Mechanics::new(Arc::clone(mesh), model)?;
    // Slip and porosity count from the rest under the initial pressure.
    let mut state = mechanics.rest(0.0);
    let mut iterations = 0;
    let mut curve = vec![(0.0, 0.0)];
    for k in 1..=STEPS {
        let time = network_3d::END * k as f64 / STEPS as f64;
        let StepOutcome::Converged(next, report) = mechanics.step(&state, time, &partner)? else {
            return Err(format!("Newton's method gave up at t = {time} s").into());
        };
        iterations += report.newton.iterations;
        state = next;
        let measures: f64 = mesh.network().faces.iter().map(|&f| mesh.geometry().face_measure[f]).sum();
        let jump = state.jump(mechanics.space());
        let mean: f64 = (jump.chunks_exact(3).zip(&mesh.network().faces))
            .map(|(g, &f)| mesh.geometry().face_measure[f] * g[1].hypot(g[2]))
            .sum();
        curve.push((time, 1e3 * mean / measures));
        if k == STEPS / 2 || k == STEPS {
            let mut row = vec![mesh.cell_count().to_string(), mesh.network().face_count().to_string()];
            row.push(side(bubbles).to_owned());
            row.push(format!("{time:.0}"));
            let states = [ContactState::Open, ContactState::Stick, ContactState::Slip];
            row.extend(states.map(|s| state.count(s).to_string()));
            row.extend((1..3).flat_map(|c| statistics(&mechanics, &state, c)));
            row.extend([iterations.to_string(), format!("{:.1}", clock.elapsed().as_secs_f64())]);
            rows.push(row);
        }
    }
    Ok(curve)
}

/// Least, mean and largest value of a component of the jump (mm), the mean by area.
fn statistics(mechanics: &Mechanics, state: &State, component: usize) -> [String; 3] {
    let mesh = mechanics.mesh();
    let values: Vec<f64> = state.jump(mechanics.space()).iter().skip(component).step_by(3).copied().collect();
    let areas: Vec<f64> = mesh.network().faces.iter().map(|&f| mesh.geometry().face_measure[f]).collect();
    let mean = values.iter().zip(&areas).map(|(v, a)| v * a).sum::<f64>() / areas.iter().sum::<f64>();
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    [low, mean, high].map(|v| format!("{:.4}", 1e3 * v))
}
