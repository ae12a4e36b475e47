//! Studies of the flow: prints tables, and writes CSV files and SVG plots to results/flow.
//!
//! `cargo run --release -p tests --bin flow-study -- <study>`; `--help` lists the studies.
//!
//! The published curves of the benchmarks are not part of the project. Where `--reference DIR` names a directory that
//! holds them, under the names that their authors gave them, they are compared with; otherwise the finest mesh is.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Parser, Subcommand};
use flow_fmu::{
    Boundary, Condition, Control, Flow, FlowModel, Fluid, Fracture, Rock, SpaceTimeFunction, Tensor, Well, WellIndex,
    WellPlace,
};
use mesh::generate::{Triangles, agglomerate, cartesian, dual, perturb, simplices};
use mesh::{Mesh, MeshData, Vec3};
use tests::plot::{Curve, Outcome, order, plot, table};

#[derive(Parser)]
#[command(about = "Studies of the flow; tables go to the terminal, CSV and SVG to results/flow")]
struct Arguments {
    #[command(subcommand)]
    study: Study,
    /// Where results go.
    #[arg(long, default_value = "results/flow", global = true)]
    output: PathBuf,
}

#[derive(Subcommand)]
enum Study {
    /// Orders of a manufactured solution on all kinds of meshes.
    Manufactured,
    /// Orders at conducting and blocking fractures.
    Fractures,
    /// Regular network (conducting, blocking) and hydrocoin: Flemisch et al., Adv. Water Resour. 111, 2018.
    Benchmark2d {
        /// Holds mfd_geiger_conductive_y_eq_0.7.csv and so on.
        #[arg(long)]
        reference: Option<PathBuf>,
    },
    /// Single fracture: Berre et al., Adv. Water Resour. 147, 2021, case 1.
    Benchmark3d {
        /// Holds single_USTUTT_MPFA_5.csv, single_HFV_Disc_0.csv to _2.csv (dol_refinement files of the benchmark).
        #[arg(long)]
        reference: Option<PathBuf>,
    },
    /// A draining column: order in time, profiles.
    Consolidation,
    /// A well in an infinite layer.
    Theis,
}

fn main() -> Outcome<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.output)?;
    let output = &arguments.output;
    match &arguments.study {
        Study::Manufactured => manufactured(output),
        Study::Fractures => fractures(output),
        Study::Benchmark2d { reference } => benchmark_2d(output, reference.as_deref()),
        Study::Benchmark3d { reference } => benchmark_3d(output, reference.as_deref()),
        Study::Consolidation => consolidation(output),
        Study::Theis => theis(output),
    }
}

/// The value of a curve at `x`, between its points.
fn at(curve: &Curve, x: f64) -> f64 {
    let k = curve.partition_point(|p| p.0 < x).clamp(1, curve.len() - 1);
    let (a, b) = (curve[k - 1], curve[k]);
    if b.0 == a.0 { a.1 } else { a.1 + (b.1 - a.1) * ((x - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) }
}

/// ‖curve − reference‖ / ‖reference − its mean‖ over the points of `curve`, in L².
fn difference(curve: &Curve, reference: &Curve) -> f64 {
    let mean = curve.iter().map(|p| at(reference, p.0)).sum::<f64>() / curve.len() as f64;
    let sum = |f: &dyn Fn(&(f64, f64)) -> f64| curve.iter().map(|p| f(p).powi(2)).sum::<f64>();
    (sum(&|p| p.1 - at(reference, p.0)) / sum(&|p| at(reference, p.0) - mean)).sqrt()
}

/// Two columns of a CSV file; exponents may be written with a D.
fn read_curve(file: &Path, x: usize, y: usize) -> Outcome<Curve> {
    let text = std::fs::read_to_string(file).map_err(|e| format!("{}: {e}", file.display()))?;
    let mut curve = Curve::new();
    for line in text.lines() {
        let fields: Vec<Option<f64>> = line.split(',').map(|f| f.trim().replace('D', "e").parse().ok()).collect();
        if let (Some(Some(x)), Some(Some(y))) = (fields.get(x), fields.get(y))
            && y.is_finite()
        {
            curve.push((*x, *y));
        }
    }
    curve.sort_by(|a, b| a.0.total_cmp(&b.0));
    if curve.is_empty() { Err(format!("{}: no numbers", file.display()).into()) } else { Ok(curve) }
}

/// The affine pressure of each cell, along a straight line; only for convex cells.
fn along(flow: &Flow, permeability: impl Fn(usize) -> f64, from: Vec3, to: Vec3, samples: usize) -> Outcome<Curve> {
    let mesh = flow.mesh();
    let geometry = mesh.geometry();
    let fluxes = flow.fluxes()?;
    let mut curve = Curve::new();
    for k in 0..=samples {
        let s = k as f64 / samples as f64;
        let x = from.lerp(to, s);
        let outside = |cell: usize| {
            let faces = mesh.cell_faces(cell).iter().zip(mesh.cell_face_signs(cell));
            faces
                .map(|(&f, &sign)| sign * (x - geometry.face_center[f]).dot(geometry.face_normal(f)))
                .fold(f64::NEG_INFINITY, f64::max)
        };
        let near = |&cell: &usize| geometry.cell_center[cell].distance(x) <= geometry.cell_diameter[cell];
        let cell = (0..mesh.cell_count()).filter(near).min_by(|&a, &b| outside(a).total_cmp(&outside(b)));
        let cell = cell.ok_or("the line leaves the mesh")?;
        let slope = -fluxes.cell_velocity[cell] / permeability(cell);
        let p = flow.state().matrix_pressure[cell] + slope.dot(x - flow.space().cell_point(cell));
        curve.push((s * from.distance(to), p));
    }
    Ok(curve)
}

fn unit_fluid() -> Fluid {
    Fluid { viscosity: 1.0, density: 0.0, bulk_modulus: None }
}

/// A fracture by what the equations see of it for η = 1: its conductivity d_f³/12 and T_f = 2 K_n/d_f.
fn fracture(conductivity: f64, transmissivity: f64) -> Fracture {
    let aperture = (12.0 * conductivity).cbrt();
    Fracture { normal_permeability: 0.5 * transmissivity * aperture, aperture: aperture.into() }
}

fn steady(mesh: &Arc<Mesh>, model: FlowModel) -> Outcome<Flow> {
    let mut flow = Flow::new(mesh.clone(), model)?;
    let inputs = flow.inputs();
    flow.steady(&inputs)?;
    Ok(flow)
}

fn checked(data: MeshData) -> Outcome<Arc<Mesh>> {
    Ok(Arc::new(Mesh::new(data)?))
}

// ---- manufactured solution ----

fn family(name: &str, n: usize) -> Outcome<MeshData> {
    let unit = |n: [usize; 3]| cartesian(Vec3::ZERO, Vec3::ONE, n);
    Ok(match name {
        "triangles" => Triangles::rectangle([0.0, 0.0], [1.0, 1.0], 1.0 / n as f64).build()?,
        "perturbed squares" => perturb(&Mesh::new(unit([n, n, 0]))?, 0.2, 1),
        "polygons" => dual(&Mesh::new(family("triangles", n)?)?)?,
        "clumps of 24 triangles" => agglomerate(&Mesh::new(family("triangles", n)?)?, 24)?,
        "cubes" => unit([n, n, n]),
        "perturbed hexahedra" => perturb(&Mesh::new(unit([n, n, n]))?, 0.2, 1),
        "tetrahedra" => simplices(&Mesh::new(unit([n, n, n]))?)?,
        "perturbed tetrahedra" => simplices(&Mesh::new(family("perturbed hexahedra", n)?)?)?,
        "polyhedra" => dual(&Mesh::new(family("tetrahedra", n)?)?)?,
        _ => return Err(format!("no family {name}").into()),
    })
}

fn manufactured(output: &Path) -> Outcome<()> {
    const A: f64 = 2.0;
    const B: f64 = 1.5;
    let k = Tensor::from_cols_array(&[3.0, 0.8, -0.4, 0.8, 1.0, 0.3, -0.4, 0.3, 2.0]);
    let pressure = |x: Vec3| (A * x.x).sin() * (B * x.y).cos() * (0.5 * x.z).exp();
    let mut rows = Vec::new();
    let mut curves = Vec::new();
    let flat: &[usize] = &[8, 16, 32, 64, 128];
    let families: [(&str, &[usize]); 9] = [
        ("triangles", flat),
        ("perturbed squares", flat),
        ("polygons", flat),
        ("clumps of 24 triangles", flat),
        ("cubes", &[4, 8, 16, 32]),
        ("perturbed hexahedra", &[4, 8, 16, 24]),
        ("tetrahedra", &[4, 8, 16, 24]),
        ("perturbed tetrahedra", &[4, 8, 16, 24]),
        ("polyhedra", &[4, 8, 12, 16]),
    ];
    for (name, levels) in families {
        let (mut previous_p, mut previous_v) = (None, None);
        let (mut errors_p, mut errors_v) = (Curve::new(), Curve::new());
        for &n in levels {
            let mesh = checked(family(name, n)?)?;
            let dim = mesh.dim();
            let gradient = move |x: Vec3| {
                let ((s, c), (sy, cy)) = ((A * x.x).sin_cos(), (B * x.y).sin_cos());
                let z = if dim == 3 { 0.5 * s * cy } else { 0.0 };
                Vec3::new(A * c * cy, -B * s * sy, z) * (0.5 * x.z).exp()
            };
            let source = move |x: Vec3, _| {
                let ((s, c), (sy, cy)) = ((A * x.x).sin_cos(), (B * x.y).sin_cos());
                let mut sum =
                    -k.x_axis.x * A * A * s * cy - k.y_axis.y * B * B * s * cy - 2.0 * k.x_axis.y * A * B * c * sy;
                if dim == 3 {
                    sum += k.z_axis.z * 0.25 * s * cy + k.x_axis.z * A * c * cy - k.y_axis.z * B * s * sy;
                }
                -sum * (0.5 * x.z).exp()
            };
            let mut model = FlowModel::new(unit_fluid());
            model.rocks.push((
                "rock".into(),
                Rock { permeability: k, porosity: 0.0, biot_modulus: None, biot_coefficient: 0.0 },
            ));
            let given =
                |tag: &String| (tag.clone(), Boundary::pressure(SpaceTimeFunction::new(move |x, _| pressure(x))));
            model.boundaries = mesh.data().tags.iter().map(given).collect();
            model.matrix_source = Some(SpaceTimeFunction::new(source));
            let flow = steady(&mesh, model)?;
            let geometry = mesh.geometry();
            let [mut p, mut p_size, mut v, mut v_size] = [0.0; 4];
            for cell in 0..mesh.cell_count() {
                let measure = geometry.cell_measure[cell];
                let exact = pressure(flow.space().cell_point(cell));
                p += measure * (flow.state().matrix_pressure[cell] - exact).powi(2);
                p_size += measure * exact * exact;
                let exact = -(k * gradient(geometry.cell_center[cell]));
                let exact = if dim == 2 { exact.with_z(0.0) } else { exact };
                v += measure * flow.fluxes()?.cell_velocity[cell].distance_squared(exact);
                v_size += measure * exact.length_squared();
            }
            let h = (1.0 / mesh.cell_count() as f64).powf(1.0 / dim as f64);
            let (p, v) = ((p / p_size).sqrt(), (v / v_size).sqrt());
            rows.push(vec![
                name.to_owned(),
                mesh.cell_count().to_string(),
                flow.unknowns().to_string(),
                flow.space().unseen_cells().len().to_string(),
                format!("{p:.3e}"),
                order(previous_p, h, p),
                format!("{v:.3e}"),
                order(previous_v, h, v),
            ]);
            (previous_p, previous_v) = (Some((h, p)), Some((h, v)));
            errors_p.push((h, p));
            errors_v.push((h, v));
        }
        curves.push((format!("p, {name}"), errors_p));
        curves.push((format!("flux, {name}"), errors_v));
    }
    let head = ["mesh", "cells", "unknowns", "unseen", "error p", "order", "error flux", "order"];
    table(output, "manufactured", &head, &rows)?;
    plot(output, "manufactured", "Manufactured solution", ["h", "relative L2 error"], &curves, true)
}

// ---- closed-form fractures ----

/// On −1 < x < 1 with a fracture at x = 0: p_m = cos(κy) cosh(κ(1 − |x|)), p_f = (cosh κ + κ sinh κ/T) cos(κy), κ = π.
fn fractures(output: &Path) -> Outcome<()> {
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for (conductivity, transmissivity) in [(10.0, 1e6), (1.0, 1.0), (1e-6, 1e-2)] {
        let matrix = |x: Vec3| (PI * x.y).cos() * (PI * (1.0 - x.x.abs())).cosh();
        let amplitude = PI.cosh() + PI * PI.sinh() / transmissivity;
        let source = conductivity * PI * PI * amplitude + 2.0 * PI * PI.sinh();
        let mut previous = [None, None];
        let mut errors = [Curve::new(), Curve::new()];
        for n in [8, 16, 32, 64, 128] {
            let h = 1.0 / n as f64;
            let line = [[0.0, 0.0], [0.0, 1.0]];
            let mesh = checked(Triangles::rectangle([-1.0, 0.0], [1.0, 1.0], h).fracture("f", &line, h).build()?)?;
            let mut model = FlowModel::new(unit_fluid());
            model.rocks.push(("rock".into(), Rock::isotropic(1.0, 0.0, None)));
            model.fractures.push(("f".into(), fracture(conductivity, transmissivity)));
            for side in ["left", "right"] {
                model.boundaries.push((side.into(), Boundary::pressure(SpaceTimeFunction::new(move |x, _| matrix(x)))));
            }
            model.fracture_source = Some(SpaceTimeFunction::new(move |x, _| source * (PI * x.y).cos()));
            let flow = steady(&mesh, model)?;
            let (mut error, mut size) = ([0.0; 2], [0.0; 2]);
            let mut add = |k: usize, measure: f64, value: f64, exact: f64| {
                error[k] += measure * (value - exact).powi(2);
                size[k] += measure * exact * exact;
            };
            for (cell, &p) in flow.state().matrix_pressure.iter().enumerate() {
                add(0, mesh.geometry().cell_measure[cell], p, matrix(flow.space().cell_point(cell)));
            }
            for (i, &p) in flow.fracture_pressure().iter().enumerate() {
                add(1, h, p, amplitude * (PI * flow.space().fracture_point(i).y).cos());
            }
            let mut row = vec![format!("{conductivity:e}"), format!("{transmissivity:e}"), n.to_string()];
            for k in 0..2 {
                let e = (error[k] / size[k]).sqrt();
                row.extend([format!("{e:.3e}"), order(previous[k], h, e)]);
                previous[k] = Some((h, e));
                errors[k].push((h, e));
            }
            rows.push(row);
        }
        let [matrix_errors, fracture_errors] = errors;
        curves.push((format!("matrix, C = {conductivity:e}, T = {transmissivity:e}"), matrix_errors));
        curves.push((format!("fracture, C = {conductivity:e}, T = {transmissivity:e}"), fracture_errors));
    }
    let head = ["C_f", "T_f", "1/h", "error p_m", "order", "error p_f", "order"];
    table(output, "fractures", &head, &rows)?;
    plot(output, "fractures", "Flow along and across a fracture", ["h", "relative L2 error"], &curves, true)
}

// ---- published benchmarks in 2D ----

/// The regular network: unit inflow on the left, p = 1 on the right; aperture 1e-4, permeability 1e4 or 1e-4.
fn regular(n: usize, k: f64) -> Outcome<Flow> {
    let aperture = 1e-4;
    let lines: [[f64; 4]; 6] = [
        [0.0, 0.5, 1.0, 0.5],
        [0.5, 0.0, 0.5, 1.0],
        [0.5, 0.75, 1.0, 0.75],
        [0.75, 0.5, 0.75, 1.0],
        [0.5, 0.625, 0.75, 0.625],
        [0.625, 0.5, 0.625, 0.75],
    ];
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [n, n, 0]);
    let mut model = FlowModel::new(unit_fluid());
    for (i, [x0, y0, x1, y1]) in lines.into_iter().enumerate() {
        let name = format!("f{i}");
        data.mark_fracture(&name, |p| (x0..=x1).contains(&p.x) && (y0..=y1).contains(&p.y));
        model.fractures.push((name, fracture(k * aperture, 2.0 * k / aperture)));
    }
    model.rocks.push(("rock".into(), Rock::isotropic(1.0, 0.0, None)));
    let into_fracture = Some(Condition::Inflow(aperture.into()));
    model.boundaries = vec![
        ("left".into(), Boundary { matrix: Condition::Inflow(1.0.into()), fracture: into_fracture }),
        ("right".into(), Boundary::pressure(1.0)),
    ];
    steady(&checked(data)?, model)
}

/// Hydrocoin: the head is the height on the surface; two fracture zones that cross.
fn hydrocoin(h: f64) -> Outcome<Flow> {
    let corners = [
        [0.0, 150.0],
        [400.0, 100.0],
        [800.0, 150.0],
        [1200.0, 100.0],
        [1600.0, 150.0],
        [1600.0, -1000.0],
        [1500.0, -1000.0],
        [1000.0, -1000.0],
        [0.0, -1000.0],
    ];
    let crossing = [500.0 + 7500.0 / 13.0, -7500.0 / 13.0];
    let one = [[400.0, 100.0], crossing, [1500.0, -1000.0]];
    let other = [[1200.0, 100.0], crossing, [1000.0, -1000.0]];
    let tags = ["top", "top", "top", "top"];
    let mesh = Triangles::polygon(&corners, &tags, h).fracture("one", &one, h).fracture("other", &other, h).build()?;
    let mut model = FlowModel::new(unit_fluid());
    model.rocks.push(("rock".into(), Rock::isotropic(1e-8, 0.0, None)));
    for (name, width) in [("one", 5.0 * 2f64.sqrt()), ("other", 33.0 / 5f64.sqrt())] {
        model.fractures.push((name.into(), fracture(1e-6 * width, 2.0 * 1e-6 / width)));
    }
    model.boundaries.push(("top".into(), Boundary::pressure(SpaceTimeFunction::new(|x, _| x.y))));
    steady(&checked(mesh)?, model)
}

/// Compares curves of growing resolution with a published one, or with the last of them.
fn compare(
    output: &Path,
    name: &str,
    title: &str,
    unknown: &str,
    curves: Vec<(usize, Curve)>,
    reference: Option<(String, Curve)>,
    rows: &mut Vec<Vec<String>>,
) -> Outcome<()> {
    let own = curves.last().ok_or("no curve")?.clone();
    let against = reference.clone().unwrap_or((format!("own, {} cells", own.0), own.1));
    for (cells, curve) in &curves {
        let e = difference(curve, &against.1);
        rows.push(vec![name.to_owned(), cells.to_string(), format!("{e:.2e}"), against.0.clone()]);
    }
    let mut csv = String::from("s,p,cells\n");
    for (cells, curve) in &curves {
        curve.iter().try_for_each(|(s, p)| writeln!(csv, "{s},{p},{cells}"))?;
    }
    std::fs::write(output.join(format!("{name}-curves.csv")), csv)?;
    let mut drawn: Vec<(String, Curve)> = reference.into_iter().collect();
    drawn.extend(curves.into_iter().map(|(cells, curve)| (format!("{cells} cells"), curve)));
    plot(output, name, title, ["arc length (m)", unknown], &drawn, false)
}

fn benchmark_2d(output: &Path, reference: Option<&Path>) -> Outcome<()> {
    let mut rows = Vec::new();
    let v = |x: f64, y: f64| Vec3::new(x, y, 0.0);
    let read = |file: &str, x: usize| -> Outcome<Option<(String, Curve)>> {
        let curve = reference.map(|dir| read_curve(&dir.join(file), x, 0)).transpose()?;
        Ok(curve.map(|c| (format!("published MFD ({file})"), c)))
    };
    for (name, k, from, to, file) in [
        ("regular-conducting-y7", 1e4, v(0.0, 0.7), v(1.0, 0.7), "mfd_geiger_conductive_y_eq_0.7.csv"),
        ("regular-conducting-x5", 1e4, v(0.5, 0.0), v(0.5, 1.0), "mfd_geiger_conductive_x_eq_0.5.csv"),
        ("regular-blocking", 1e-4, v(0.0, 0.1), v(0.9, 1.0), "mfd_geiger_blocking_0_0.1_to_0.9_1.csv"),
    ] {
        let mut curves = Vec::new();
        for n in [32, 64, 128, 256] {
            let flow = regular(n, k)?;
            curves.push((flow.mesh().cell_count(), along(&flow, |_| 1.0, from, to, 400)?));
        }
        compare(output, name, name, "p", curves, read(file, 5)?, &mut rows)?;
    }
    let mut curves = Vec::new();
    for h in [100.0, 50.0, 25.0, 12.5, 6.25] {
        let flow = hydrocoin(h)?;
        let curve = along(&flow, |_| 1e-8, v(0.0, -200.0), v(1600.0, -200.0), 400)?;
        curves.push((flow.mesh().cell_count(), curve));
    }
    compare(
        output,
        "hydrocoin",
        "hydrocoin, y = -200 m",
        "head (m)",
        curves,
        read("mfd_hydrocoin_200.csv", 3)?,
        &mut rows,
    )?;
    table(output, "benchmark2d", &["case", "cells", "difference", "from"], &rows)
}

// ---- published benchmark in 3D ----

/// The single fracture 3x + 5z = 400 in a cube of 100 m: `n` layers below and above it, thin layers at both ends.
fn single(n: usize) -> Outcome<Flow> {
    let (end, columns) = (n.div_ceil(4), 2 * n);
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [columns, columns, 2 * (n + end)]);
    let layers = [(0.0, 0.0), (0.0, 10.0), (0.6, 20.0), (0.0, 90.0), (0.0, 100.0)];
    let counts = [end, n, n, end];
    // Height at x: slope × (100 − x) + offset for each of the surfaces.
    let height = |surface: usize, x: f64| layers[surface].0 * (100.0 - x) + layers[surface].1;
    let total = (2 * (n + end)) as f64;
    for vertex in &mut data.vertices {
        let mut level = (vertex.z * total).round() as usize;
        let x = 100.0 * vertex.x;
        let mut part = 0;
        while part < 3 && level > counts[part] {
            level -= counts[part];
            part += 1;
        }
        let s = level as f64 / counts[part] as f64;
        let z = height(part, x) * (1.0 - s) + height(part + 1, x) * s;
        *vertex = Vec3::new(x, 100.0 * vertex.y, z);
    }
    data.mark_fracture("f", |x| (3.0 * x.x + 5.0 * x.z - 400.0).abs() < 1e-6);
    let low = data.region("low");
    // In thirds of the height of a cell, the mean of its faces is inside it.
    for cell in 0..data.cells.len() {
        let faces = data.cells.get(cell);
        let z = faces.iter().map(|&f| data.face_mean(f).z).sum::<f64>() / faces.len() as f64;
        if z < 10.0 {
            data.cell_region[cell] = low;
        }
    }
    for tag in &mut data.face_tag {
        *tag = None;
    }
    data.tag_boundary(|x| match () {
        () if x.x.abs() < 1e-9 && x.z > 90.0 => Some("inlet"),
        () if x.y.abs() < 1e-9 && x.z < 10.0 => Some("outlet"),
        () => None,
    });
    let mut model = FlowModel::new(unit_fluid());
    model.rocks.push(("rock".into(), Rock::isotropic(1e-6, 0.0, None)));
    model.rocks.push(("low".into(), Rock::isotropic(1e-5, 0.0, None)));
    // Aperture 1e-2, permeability 0.1 along and across.
    model.fractures.push(("f".into(), fracture(1e-3, 2.0 * 0.1 / 1e-2)));
    model.boundaries.push(("inlet".into(), Boundary::pressure(4.0)));
    model.boundaries.push(("outlet".into(), Boundary::pressure(1.0)));
    steady(&checked(data)?, model)
}

fn benchmark_3d(output: &Path, reference: Option<&Path>) -> Outcome<()> {
    let mut rows = Vec::new();
    let mut curves = Vec::new();
    let (from, to) = (Vec3::new(0.0, 100.0, 100.0), Vec3::new(100.0, 0.0, 0.0));
    for n in [4, 8, 12, 20] {
        let flow = single(n)?;
        let k = |cell: usize| if flow.mesh().data().cell_region[cell] == 0 { 1e-6 } else { 1e-5 };
        curves.push((flow.mesh().cell_count(), along(&flow, k, from, to, 400)?));
    }
    let mut published = None;
    if let Some(dir) = reference {
        let fine = read_curve(&dir.join("single_USTUTT_MPFA_5.csv"), 0, 1)?;
        // What another code of the same method published, from the same reference.
        for k in 0..3 {
            let curve = read_curve(&dir.join(format!("single_HFV_Disc_{k}.csv")), 0, 1)?;
            let e = difference(&curve, &fine);
            let name = "published HFV, discontinuous".to_owned();
            rows.push(vec![name, ["1134", "10108", "103544"][k].to_owned(), format!("{e:.2e}"), "published".into()]);
        }
        published = Some(("published, finest (USTUTT MPFA 5)".to_owned(), fine));
    }
    compare(output, "single", "single fracture", "head (m)", curves, published, &mut rows)?;
    table(output, "benchmark3d", &["case", "cells", "difference", "from"], &rows)
}

// ---- transients ----

/// Excess pressure 1 in a column of length 1 that drains at x = 1; D = 1. Fourier series of the exact solution.
fn consolidation(output: &Path) -> Outcome<()> {
    let n = 400;
    let exact = |x: f64, t: f64| -> f64 {
        let term = |k: usize| {
            let m = (k as f64 + 0.5) * PI;
            2.0 * if k.is_multiple_of(2) { 1.0 } else { -1.0 } / m * (m * x).cos() * (-m * m * t).exp()
        };
        (0..200).map(term).sum()
    };
    let mesh = checked(cartesian(Vec3::ZERO, Vec3::new(1.0, 0.01, 0.0), [n, 1, 0]))?;
    let new = || -> Outcome<Flow> {
        let mut model = FlowModel::new(unit_fluid());
        model.rocks.push(("rock".into(), Rock::isotropic(1.0, 0.1, Some(1.0))));
        model.boundaries.push(("right".into(), Boundary::pressure(0.0)));
        model.initial_pressure = 1.0.into();
        Ok(Flow::new(mesh.clone(), model)?)
    };
    let (mut rows, mut curve, mut previous) = (Vec::new(), Curve::new(), None);
    let mut profiles = Vec::new();
    for steps in [10, 20, 40, 80, 160, 320] {
        let mut flow = new()?;
        let inputs = flow.inputs();
        let dt = 0.2 / f64::from(steps);
        let mut worst: f64 = 0.0;
        for step in 1..=steps {
            let report = flow.step(dt, &inputs)?;
            worst = worst.max(report.balance.total);
            if steps == 320 && [16, 80, 320].contains(&step) {
                let t = dt * f64::from(step);
                let x = |cell| flow.space().cell_point(cell).x;
                let own = (0..n).map(|c| (x(c), flow.state().matrix_pressure[c])).collect();
                profiles.push((format!("t = {t:.2}, 320 time steps"), own));
                profiles.push((format!("t = {t:.2}, exact"), (0..n).map(|c| (x(c), exact(x(c), t))).collect()));
            }
        }
        let error = |c: usize| flow.state().matrix_pressure[c] - exact(flow.space().cell_point(c).x, 0.2);
        let e = ((0..n).map(|c| error(c).powi(2)).sum::<f64>() / n as f64).sqrt();
        rows.push(vec![steps.to_string(), format!("{e:.3e}"), order(previous, dt, e), format!("{worst:.1e}")]);
        previous = Some((dt, e));
        curve.push((dt, e));
    }
    table(output, "consolidation", &["time steps", "error at t = 0.2", "order", "volume error"], &rows)?;
    plot(
        output,
        "consolidation-order",
        "Order in time",
        ["time step", "L2 error"],
        &[(String::from("error"), curve)],
        true,
    )?;
    plot(output, "consolidation", "A draining column", ["x", "p"], &profiles, false)
}

/// E₁(u), by its series up to 1 and its continued fraction beyond (Abramowitz, Stegun, 5.1.11 and 5.1.22).
fn exponential_integral(u: f64) -> f64 {
    const EULER: f64 = 0.577_215_664_901_532_9;
    if u <= 1.0 {
        let (mut sum, mut term) = (-EULER - u.ln(), -1.0);
        for k in 1..40 {
            term *= -u / f64::from(k);
            sum += term / f64::from(k);
        }
        sum
    } else {
        let fraction = (1..60).rev().fold(0.0, |f, k| f64::from(k) / (1.0 + f64::from(k) / (u + f)));
        (-u).exp() / (u + fraction)
    }
}

/// A well of 1e-5 m²/s in a layer of K/η = 1e-12/1e-3, storage 1e-10 1/Pa: p = q η/(4πK) E₁(r² η S/(4 K t)).
fn theis(output: &Path) -> Outcome<()> {
    let (k, eta, storage, q, end) = (1e-12, 1e-3, 1e-10, 1e-5, 2e4);
    let exact = |r: f64, t: f64| q * eta / (4.0 * PI * k) * exponential_integral(r * r * eta * storage / (4.0 * k * t));
    let (mut rows, mut curves, mut previous) = (Vec::new(), Vec::new(), None);
    for level in 0..4 {
        let fine = 0.5f64.powi(level);
        let size = move |x: Vec3| fine * (1.0 + 0.15 * x.length());
        let data = Triangles::rectangle([-3000.0, -3000.0], [3000.0, 3000.0], 400.0 * fine).size(size).build()?;
        let mesh = checked(data)?;
        let mut model = FlowModel::new(Fluid { viscosity: eta, density: 0.0, bulk_modulus: None });
        model.rocks.push(("rock".into(), Rock::isotropic(k, 0.1, Some(1.0 / storage))));
        model.wells.push(Well {
            name: "well".into(),
            place: WellPlace::Cell(Vec3::ZERO),
            index: Some(WellIndex::upright(0.01)),
            control: Control::Rate(q),
            limit: None,
        });
        let mut flow = Flow::new(mesh.clone(), model)?;
        let inputs = flow.inputs();
        // Time steps that grow with time, halved with the mesh.
        let steps = 20 << level;
        let growth = 1e3f64.powf(1.0 / f64::from(steps));
        let mut t = end / 1e3;
        flow.step(t, &inputs)?;
        let mut worst: f64 = 0.0;
        for _ in 0..steps {
            let report = flow.step(t * (growth - 1.0), &inputs)?;
            worst = worst.max(report.balance.total / q);
            t *= growth;
        }
        let cells = (0..mesh.cell_count()).map(|c| (flow.space().cell_point(c).length(), c));
        let mut own: Curve = cells.map(|(r, c)| (r, flow.state().matrix_pressure[c])).filter(|p| p.0 > 5.0).collect();
        own.retain(|p| p.0 < 1500.0);
        own.sort_by(|a, b| a.0.total_cmp(&b.0));
        let top = exact(5.0, end);
        let e = own.iter().map(|p| (p.1 - exact(p.0, end)).abs()).fold(0.0, f64::max) / top;
        rows.push(vec![
            mesh.cell_count().to_string(),
            steps.to_string(),
            format!("{e:.3e}"),
            order(previous, fine, e),
            format!("{worst:.1e}"),
        ]);
        previous = Some((fine, e));
        if level == 0 || level == 3 {
            curves.push((format!("{} triangles, {steps} time steps", mesh.cell_count()), own));
        }
    }
    let radii = (0..200).map(|k| 5.0 * 300f64.powf(f64::from(k) / 199.0));
    curves.push(("Theis".into(), radii.map(|r| (r, exact(r, end))).collect()));
    table(output, "theis", &["triangles", "time steps", "largest error, 5 to 1500 m", "order", "volume error"], &rows)?;
    plot(output, "theis", "A well in an infinite layer, t = 2e4 s", ["r (m)", "p (Pa)"], &curves, false)
}
