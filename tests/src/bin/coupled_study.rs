//! Studies of the coupled problem through the orchestrator, as a user has it: prints tables, and writes CSV files and SVG
//! plots to results/coupled.
//!
//! `cargo run --release -p tests --bin coupled-study -- <study>`; `--help` lists the studies. The orchestrator and the units'
//! libraries must lie beside this program: `cargo build --release -p orchestrator -p mechanics-unit -p flow-unit`.

use std::path::{Path, PathBuf};
use std::process::Command;

use clap::{Parser, Subcommand};
use hdf5_metno::File;
use mesh::{Mesh, Vec3};
use tests::plot::{Outcome, order, plot, slope, table};

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
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.output)?;
    match arguments.study {
        Study::SixFractures { variants, reference } => study_orders(&arguments.output, &variants, &reference),
        Study::Speed { variants } => study_speed(&arguments.output, &variants),
    }
}

/// Runs a variant of the six fractures into a folder; gives its summary.
fn run(variant: &str, folder: &Path, changes: &[&str]) -> Outcome<serde_json::Value> {
    let own = std::env::current_exe()?;
    let program = own.with_file_name(format!("orchestrator{}", std::env::consts::EXE_SUFFIX));
    if !program.is_file() {
        return Err(
            format!("{} is not there: build orchestrator, mechanics-unit and flow-unit", program.display()).into()
        );
    }
    let mut command = Command::new(program);
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
    let mut summary: serde_json::Value = serde_json::from_str(last)?;
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

fn study_speed(output: &Path, variants: &[String]) -> Outcome<()> {
    /// Parts of a run as its summary names them.
    const PARTS: [&str; 8] =
        ["mesh", "packing", "start of the units", "flow", "mechanics", "coupling", "results", "of which checkpoints"];
    let mut rows = Vec::new();
    let mut curve = Vec::new();
    for variant in variants {
        let folder = output.join("speed");
        let summary = run(variant, &folder, &[])?;
        let cells = Mesh::new(mesh_io::read_hdf5(folder.join("mesh.h5"))?)?.cell_count();
        let seconds = |part: &str| summary["seconds"][part].as_f64().unwrap_or(f64::NAN);
        let all: f64 = PARTS[..7].iter().map(|part| seconds(part)).sum();
        let number = |key: &str| summary[key].as_f64().unwrap_or(f64::NAN);
        let mut row = vec![variant.clone(), cells.to_string()];
        row.extend(PARTS.iter().map(|part| format!("{:.2}", seconds(part))));
        row.push(format!("{all:.2}"));
        row.push(format!("{:.1}", number("coupling_iterations") / number("time_steps")));
        row.push(format!("{:.0}", 1e3 * (seconds("flow") + seconds("mechanics")) / number("coupling_iterations")));
        row.push(format!("{:.0}", number("peak_memory") / 1e6));
        rows.push(row);
        curve.push((cells as f64, all));
    }
    let head = [
        "variant",
        "triangles",
        "mesh",
        "packing",
        "analysis and factorisation",
        "flow",
        "mechanics",
        "coupling",
        "results",
        "(checkpoints)",
        "all (s)",
        "iterations a step",
        "units (ms an iteration)",
        "memory (MB)",
    ];
    table(output, "speed", &head, &rows)?;
    let series = [("all".to_owned(), curve.clone()).into(), slope(1.0, &curve)];
    plot(output, "speed", "Seconds of a run", ["triangles", "seconds"], &series, true)
}
