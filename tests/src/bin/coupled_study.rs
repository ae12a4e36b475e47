//! Studies of the coupled problem through the orchestrator, as a user has it: prints tables, and writes CSV files and SVG
//! plots to results/coupled.
//!
//! `cargo run --release -p tests --bin coupled-study -- <study>`; `--help` lists the studies. The orchestrator and the units'
//! libraries must lie beside this program: `cargo build --release -p orchestrator -p mechanics-unit -p flow-unit`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use clap::{Parser, Subcommand};
use flow_fmu::Flow;
use hdf5_metno::File;
use mechanics_fmu::{Mechanics, Outcome as Found, Partner};
use mesh::{Mesh, Vec3};
use serde_json::Value;
use tests::memory::{forget_peak, peak, peak_of, watch};
use tests::plot::{Outcome, order, plot, slope, table};
use tests::six_fractures::{INITIAL_PRESSURE, flow_model, mechanics_model};

#[derive(Parser)]
#[command(about = "Studies of the coupled problem; tables go to the terminal, CSV and SVG to results/coupled")]
struct Arguments {
    #[command(subcommand)]
    study: Study,
    /// Where results go.
    #[arg(long, default_value = "results/coupled", global = true)]
    output: PathBuf,
}

#[derive(Subcommand)]
enum Study {
    /// C3: errors of pressure and displacement against a fine mesh.
    SixFractures {
        /// Variants, from coarse to fine, `default` for none.
        #[arg(long, value_delimiter = ',', default_value = "default,h0.02,h0.01")]
        variants: Vec<String>,
        /// The variant that stands for the exact solution.
        #[arg(long, default_value = "h0.005")]
        reference: String,
    },
    /// C3: seconds and memory against the number of triangles.
    Speed {
        /// Variants, `default` for none.
        #[arg(long, value_delimiter = ',', default_value = "default,h0.02,h0.01,h0.006,h0.003")]
        variants: Vec<String>,
    },
    /// Peak memory of parts on a mesh, for `speed`.
    #[command(hide = true)]
    Memory {
        /// Its file.
        mesh: PathBuf,
    },
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.output)?;
    match arguments.study {
        Study::SixFractures { variants, reference } => study_orders(&arguments.output, &variants, &reference),
        Study::Speed { variants } => study_speed(&arguments.output, &variants),
        Study::Memory { mesh } => print_memory(&mesh),
    }
}

/// A program beside this one.
fn beside(name: &str) -> Outcome<PathBuf> {
    let program = std::env::current_exe()?.with_file_name(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    if program.is_file() {
        Ok(program)
    } else {
        Err(format!("{} is not there: build orchestrator, mechanics-unit and flow-unit", program.display()).into())
    }
}

/// Runs a variant of the six fractures into a folder; gives its summary.
fn run(variant: &str, folder: &Path, changes: &[&str]) -> Outcome<Value> {
    let mut command = Command::new(beside("orchestrator")?);
    command.args(["run", "models/six-fractures", "--overwrite", "--json", "--output"]).arg(folder);
    if variant != "default" {
        command.args(["--variant", variant]);
    }
    for change in changes {
        command.args(["--set", change]);
    }
    let output = command.output()?;
    if !output.status.success() {
        return Err(format!("{variant}: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let text = String::from_utf8(output.stdout)?;
    let last = text.lines().last().ok_or("the orchestrator says nothing")?;
    let mut summary: Value = serde_json::from_str(last)?;
    Ok(summary["summary"].take())
}

/// Pressure (Pa) and displacement (m) of each cell at some times.
struct Solution {
    mesh: Mesh,
    times: Vec<f64>,
    pressure: Vec<Vec<f64>>,
    displacement: Vec<Vec<f64>>,
}

impl Solution {
    /// Reads the fields that a run has left.
    fn read(folder: &Path) -> Outcome<Self> {
        let mesh = Mesh::new(mesh_io::read_hdf5(folder.join("mesh.h5"))?)?;
        let fields = File::open(folder.join("run.h5"))?.group("fields")?;
        let mut solution = Self { mesh, times: Vec::new(), pressure: Vec::new(), displacement: Vec::new() };
        for name in fields.member_names()? {
            let group = fields.group(&name)?;
            solution.times.push(group.attr("time")?.read_scalar()?);
            solution.pressure.push(group.dataset("matrix.pressure")?.read_raw()?);
            solution.displacement.push(group.dataset("matrix.displacement")?.read_raw()?);
        }
        Ok(solution)
    }

    /// Gradient of a cell's values by least squares over its neighbours through faces that are no fracture.
    fn gradient(&self, values: &dyn Fn(usize) -> f64, cell: usize) -> Vec3 {
        let (geometry, network) = (self.mesh.geometry(), self.mesh.network());
        let (mut a, mut b) = ([0.0; 3], [0.0; 2]);
        for &face in self.mesh.cell_faces(cell).iter().filter(|&&f| network.number_of_face[f].is_none()) {
            let (first, second) = self.mesh.face_cells(face);
            let Some(second) = second else { continue };
            let other = if first == cell { second } else { first };
            let x = geometry.cell_center[other] - geometry.cell_center[cell];
            let (w, v) = (1.0 / x.length_squared(), values(other) - values(cell));
            a = [a[0] + w * x.x * x.x, a[1] + w * x.x * x.y, a[2] + w * x.y * x.y];
            b = [b[0] + w * x.x * v, b[1] + w * x.y * v];
        }
        let determinant = a[0] * a[2] - a[1] * a[1];
        // Fewer than two directions do not tell a gradient.
        if determinant <= 1e-6 * (a[0] + a[2]).powi(2) {
            return Vec3::ZERO;
        }
        Vec3::new(a[2] * b[0] - a[1] * b[1], a[0] * b[1] - a[1] * b[0], 0.0) / determinant
    }
}

/// Squares of the error and of the reference of a field with `columns` values a cell, in the L² norm by the values at the
/// cells' centres; there the reference is taken from its own cell and gradient.
fn squares(
    solution: &Solution,
    reference: &Solution,
    places: &[usize],
    columns: usize,
    [found, exact]: [&[f64]; 2],
) -> [f64; 2] {
    let (geometry, fine) = (solution.mesh.geometry(), reference.mesh.geometry());
    let mut sums = [0.0; 2];
    for (cell, &place) in places.iter().enumerate() {
        let arm = geometry.cell_center[cell] - fine.cell_center[place];
        for c in 0..columns {
            let value = |k: usize| exact[k * columns + c];
            let wanted = value(place) + reference.gradient(&value, place).dot(arm);
            sums[0] += geometry.cell_measure[cell] * (found[cell * columns + c] - wanted).powi(2);
            sums[1] += geometry.cell_measure[cell] * wanted.powi(2);
        }
    }
    sums
}

fn study_orders(output: &Path, variants: &[String], reference: &str) -> Outcome<()> {
    let solve = |variant: &String| -> Outcome<Solution> {
        let folder = output.join(format!("six-fractures-{variant}"));
        run(variant, &folder, &["output.times=[]"])?;
        Solution::read(&folder)
    };
    let exact = solve(&reference.to_owned())?;
    let locator = exact.mesh.locator();
    let (mut rows, mut curves) = (Vec::new(), [Vec::new(), Vec::new()]);
    let mut last: Option<[f64; 3]> = None;
    for variant in variants {
        let solution = solve(variant)?;
        if solution.times != exact.times {
            return Err(format!("{variant} has other time steps than {reference}").into());
        }
        let centers = &solution.mesh.geometry().cell_center;
        let places = centers.iter().map(|&x| locator.locate(x).ok_or("a cell lies outside of the reference"));
        let places = places.collect::<Result<Vec<_>, _>>()?;
        let size = (2.0 / solution.mesh.cell_count() as f64).sqrt();
        // Over all time steps, and at the end of the movement of the plate.
        let mut sums = [[0.0; 2]; 2];
        let mut at_500 = [0.0; 2];
        for (k, &time) in solution.times.iter().enumerate().skip(1) {
            let found = [
                squares(&solution, &exact, &places, 1, [&solution.pressure[k], &exact.pressure[k]]),
                squares(&solution, &exact, &places, 2, [&solution.displacement[k], &exact.displacement[k]]),
            ];
            for i in 0..2 {
                sums[i] = [sums[i][0] + found[i][0], sums[i][1] + found[i][1]];
                if time == 500.0 {
                    at_500[i] = (found[i][0] / found[i][1]).sqrt();
                }
            }
        }
        let errors = sums.map(|s| (s[0] / s[1]).sqrt());
        let orders = |i: usize| order(last.map(|l| (l[2], l[i])), size, errors[i]);
        let mut row = vec![variant.clone(), solution.mesh.cell_count().to_string()];
        for i in 0..2 {
            row.extend([format!("{:.3e}", errors[i]), orders(i), format!("{:.3e}", at_500[i])]);
            curves[i].push((size, errors[i]));
        }
        rows.push(row);
        last = Some([errors[0], errors[1], size]);
    }
    let head = ["variant", "triangles", "p", "order", "p at 500 s", "u", "order", "u at 500 s"];
    table(output, "six-fractures", &head, &rows)?;
    let [pressure, displacement] = curves;
    let series = [
        ("p".to_owned(), pressure.clone()).into(),
        ("u".to_owned(), displacement.clone()).into(),
        slope(1.5, &pressure),
        slope(1.5, &displacement),
    ];
    let axes = ["size of the cells (m)", "relative error in L²"];
    plot(output, "six-fractures", &format!("Six fractures against {reference}"), axes, &series, true)
}

/// Tables of where time and memory go: parts of runs, of their coupling iterations, and the peak memory of parts.
fn study_speed(output: &Path, variants: &[String]) -> Outcome<()> {
    let [mut parts, mut iterations, mut memory] = [const { Vec::new() }; 3];
    let mut curve = Vec::new();
    for variant in variants {
        let folder = output.join("speed");
        let summary = run(variant, &folder, &[])?;
        let mesh = folder.join("mesh.h5");
        let cells = Mesh::new(mesh_io::read_hdf5(&mesh)?)?.cell_count();
        let start = [variant.clone(), cells.to_string()];
        let (row, all) = parts_of_run(&summary);
        parts.push([&start[..], &row].concat());
        iterations.push([&start[..], &costs_of_iterations(&summary)].concat());
        memory.push([&start[..], &memory_of_run(output, variant, &mesh, &summary)?].concat());
        curve.push((cells as f64, all));
    }
    let head = [&["variant", "triangles", "mesh", "packing", "loading"][..], &PARTS, &REST].concat();
    table(output, "speed", &head, &parts)?;
    println!();
    table(output, "speed-iterations", &[&["variant", "triangles"][..], &ITERATIONS].concat(), &iterations)?;
    println!();
    let stages = [&["variant", "triangles", "mesh", "packing"][..], &STAGES, &["run, all"]].concat();
    table(output, "speed-memory", &stages, &memory)?;
    let series = [("all".to_owned(), curve.clone()).into(), slope(1.0, &curve)];
    plot(output, "speed", "Seconds of a run", ["triangles", "seconds"], &series, true)
}

/// A number in a summary.
fn number(value: &Value, path: &[&str]) -> f64 {
    path.iter().fold(value, |value, key| &value[*key]).as_f64().unwrap_or(f64::NAN)
}

/// Computing of both units, by parts as they tell.
const PARTS: [&str; 7] =
    ["analysis", "assembly", "factorisation", "triangular solves", "contact", "other computing", "interface"];
const REST: [&str; 4] = ["coupling", "results", "(checkpoints)", "all (s)"];

/// Seconds of the parts of a run, and all.
fn parts_of_run(summary: &Value) -> (Vec<String>, f64) {
    let both =
        |path: &[&str]| -> f64 { ["flow", "mechanics"].iter().map(|unit| number(&summary["units"][unit], path)).sum() };
    let part = |name: &str| number(&summary["seconds"], &[name]);
    // The start of the units but for what they compute in it.
    let loading = part("start of the units") - both(&["call_seconds", "start"]) + both(&["seconds", "loading"]);
    let mut seconds = vec![part("mesh"), part("packing"), loading];
    seconds.extend(PARTS.map(|name| both(&["seconds", name])));
    seconds.extend(["coupling", "results"].map(part));
    let all = seconds.iter().sum();
    seconds.extend([part("of which checkpoints"), all]);
    (seconds.into_iter().map(|s| format!("{s:.2}")).collect(), all)
}

const ITERATIONS: [&str; 10] = [
    "passes a step",
    "derivatives a step",
    "flow: factorisation (ms a step)",
    "flow: pass (ms)",
    "mechanics: pass (ms)",
    "flow: derivative (ms)",
    "mechanics: derivative (ms)",
    "flow: triangular solve (ms)",
    "mechanics: triangular solve (ms)",
    "pass, derivative (triangular solves)",
];

/// What coupling iterations take beside triangular solves. A pass is a time step of both units, without the factorisation that
/// flow makes once a time step.
fn costs_of_iterations(summary: &Value) -> Vec<String> {
    let steps = number(summary, &["time_steps"]);
    let passes = number(summary, &["coupling_iterations"]) / steps;
    let unit = |name: &str| {
        let unit = &summary["units"][name];
        let factorisation = number(unit, &["seconds", "factorisation"]) + number(unit, &["seconds", "assembly"]);
        // Mechanics factorises at its start.
        let factorisation = if name == "flow" { factorisation } else { 0.0 };
        let pass = (number(unit, &["call_seconds", "time_steps"]) - factorisation) / number(unit, &["time_steps"]);
        let ms = |what: &str| number(unit, &["ms", what]);
        [1e3 * factorisation / steps, 1e3 * pass, ms("derivative"), ms("triangular_solve")]
    };
    let [flow, mechanics] = ["flow", "mechanics"].map(unit);
    let solves = flow[3] + mechanics[3];
    let [pass, derivative] = [1, 2].map(|k| (flow[k] + mechanics[k]) / solves);
    let ms = [flow[0], flow[1], mechanics[1], flow[2], mechanics[2], flow[3], mechanics[3]];
    let mut row = vec![format!("{passes:.1}"), format!("{:.1}", number(summary, &["derivatives"]) / steps)];
    row.extend(ms.map(|ms| format!("{ms:.1}")));
    row.push(format!("{pass:.1}, {derivative:.1}"));
    row
}

/// Parts whose memory is looked at in a process that uses the libraries as the units do, in this order.
const STAGES: [&str; 7] = [
    "flow: analysis",
    "mechanics: analysis",
    "assembly",
    "factorisation",
    "Schur complement",
    "first solve",
    "flow: factorisation, solve",
];

/// Peak memory (MB) of the parts of a run.
fn memory_of_run(output: &Path, variant: &str, mesh: &Path, summary: &Value) -> Outcome<Vec<String>> {
    let stages = Command::new(std::env::current_exe()?).arg("memory").arg(mesh).output()?;
    if !stages.status.success() {
        return Err(String::from_utf8_lossy(&stages.stderr).into());
    }
    let stages: Vec<usize> = serde_json::from_slice(&stages.stdout)?;
    let part = |name: &str| summary["peak_memory_of_parts"][name].as_u64().unwrap_or(0) as usize;
    let mut row = vec![part("mesh"), packing_memory(output, variant)?];
    row.extend(stages);
    row.push(summary["peak_memory"].as_u64().unwrap_or(0) as usize);
    Ok(row.into_iter().map(|bytes| format!("{:.0}", bytes as f64 / 1e6)).collect())
}

/// Peak memory (bytes) of the larger one of the programs that pack units.
fn packing_memory(output: &Path, variant: &str) -> Outcome<usize> {
    let (packed, resources) = (output.join("packed"), output.join("resources"));
    let mut pack = Command::new(beside("orchestrator")?);
    pack.args(["pack", "models/six-fractures", "--output"]).arg(&packed).stdout(Stdio::null());
    if variant != "default" {
        pack.args(["--variant", variant]);
    }
    if !pack.status()?.success() {
        return Err("packing fails".into());
    }
    std::fs::create_dir_all(&resources)?;
    for file in ["model.toml", "mesh.h5"] {
        std::fs::copy(packed.join(format!("six-fractures-{file}")), resources.join(file))?;
    }
    let mut largest = 0;
    for unit in ["flow", "mechanics"] {
        let mut pack = Command::new(beside(&format!("pack-{unit}"))?);
        let mut child = pack.arg(&resources).arg(output.join("packed.fmu")).stdout(Stdio::null()).spawn()?;
        let (status, bytes) = watch(&mut child)?;
        if !status.success() {
            return Err(format!("packing of {unit} fails").into());
        }
        largest = largest.max(bytes);
    }
    Ok(largest)
}

/// Prints the peak memory (bytes) of [`STAGES`].
fn print_memory(mesh: &Path) -> Outcome<()> {
    let mesh = Arc::new(Mesh::new(mesh_io::read_hdf5(mesh)?)?);
    let (flow, mut peaks) = {
        let (flow, bytes) = peak_of(|| Flow::new(Arc::clone(&mesh), flow_model()))?;
        (flow?, vec![bytes])
    };
    forget_peak()?;
    let mut mechanics = Mechanics::watched(Arc::clone(&mesh), mechanics_model(), &mut |_| {
        peaks.push(peak());
        // It worked before.
        let _ = forget_peak();
    })?;
    let partner = Partner::uniform(&mesh, INITIAL_PRESSURE);
    let rest = mechanics.rest(0.0);
    let (outcome, bytes) = peak_of(|| mechanics.step(&rest, 0.0, &partner))?;
    let Found::Converged(state, _) = outcome? else { return Err("no equilibrium at the initial pressure".into()) };
    peaks.push(bytes);
    let mut flow = flow;
    flow.set_state(flow_fmu::FlowState { aperture: mechanics.aperture(&state), ..flow.state().clone() })?;
    let inputs = flow.inputs();
    let (report, bytes) = peak_of(|| flow.step(100.0, &inputs))?;
    report?;
    peaks.push(bytes);
    println!("{}", serde_json::to_string(&peaks)?);
    Ok(())
}
