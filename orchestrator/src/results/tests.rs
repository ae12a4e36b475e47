use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use mesh::Mesh;
use model::Document;
use quick_xml::events::Event;

use super::*;
use crate::record::{Attempt, AttemptOutcome, FailedField, FieldResidual, IterationRecord};
use crate::{Interface, StepRecord};

const STEPS: usize = 20;

fn models() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../models")
}

/// A model with its mesh, and the manifest of a run of it.
fn case(name: &str, changes: &[&str]) -> (Manifest, Mesh) {
    let document = Document::load(&models().join(name), &[], changes).unwrap();
    let mesh = document.mesh(&models(), &|_| unreachable!()).unwrap();
    let units = ["flow", "mechanics"].map(|name| UnitVersion { name: name.into(), version: "0.1.0".into() });
    let interface = Interface::poroelastic();
    let mut manifest = Manifest::new(name, &document, &[], changes, &mesh, &interface, units);
    manifest.command = ["orchestrator", "run", name].map(String::from).to_vec();
    (manifest, mesh)
}

fn coarse() -> (Manifest, Mesh) {
    case("six-fractures", &["mesh.triangles = { size = 0.4, fracture_size = 0.2 }"])
}

/// Invented but plausible: the top moves until 500 s, fractures open and slip, then pressures drain.
fn snapshot(mesh: &Mesh, number: usize) -> Snapshot {
    let time = 100.0 * number as f64;
    let (ramp, drained) = ((time / 500.0).min(1.0), (-(time - 500.0).max(0.0) / 600.0).exp());
    let network = mesh.network();
    let d = mesh.dim();
    let mut list: Vec<[f64; 6]> = Vec::new();
    for (f, &face) in network.faces.iter().enumerate() {
        let c = mesh.geometry().face_center[face];
        let load = ramp * (0.4 + 0.6 * (3.0 * c.x + 2.0 * c.y + network.fracture[f] as f64).sin().abs());
        let state = if load > 0.85 {
            0.0
        } else if load > 0.45 {
            2.0
        } else {
            1.0
        };
        let opening = if state == 0.0 { 2e-3 * (load - 0.85) } else { 0.0 };
        let slip = if state == 1.0 { 0.0 } else { 1.5e-3 * (load - 0.45) };
        let pressure = 1e5 + 9e5 * ramp * drained * (0.5 + 0.25 * c.x);
        list.push([state, 1e-4 + opening, pressure, -opening, slip, -1e7 * (1.0 - load).max(0.0)]);
    }
    let mean = |k: usize| list.iter().map(|l| l[k]).sum::<f64>() / list.len() as f64;
    let count = |s: f64| list.iter().filter(|l| l[0] == s).count() as f64;
    let matrix: Vec<f64> =
        (mesh.geometry().cell_center.iter()).map(|c| 1e5 + 4e5 * ramp * drained * (0.5 * c.x).min(1.0)).collect();
    let scalars = vec![
        Scalar::new("matrix_pressure.mean", "Pa", matrix.iter().sum::<f64>() / matrix.len() as f64),
        Scalar::new("fracture_pressure.mean", "Pa", mean(2)),
        Scalar::new("fluid_in_place.matrix", "m2", 0.2 + 1e-5 * time),
        Scalar::new("aperture.mean", "m", mean(1)),
        Scalar::new("contact.open", "1", count(0.0)),
        Scalar::new("contact.stick", "1", count(1.0)),
        Scalar::new("contact.slip", "1", count(2.0)),
        Scalar::new("seismic_moment", "N.m", 4e9 * mean(4)),
    ];
    let mut arrays = Vec::new();
    if number == 0 || [1, 5, 10, 20].contains(&number) {
        let vectors = |n: usize, t: usize, sign: f64| {
            list.iter().flat_map(|l| [l[n], sign * l[t], 0.0].into_iter().take(d)).collect::<Vec<_>>()
        };
        let column = |k: usize| list.iter().map(|l| l[k]).collect::<Vec<_>>();
        arrays = vec![
            Array::new("matrix.pressure", "Pa", Shape::Cells, matrix),
            Array::new("fracture.pressure", "Pa", Shape::FractureFaces, column(2)),
            Array::new("fracture.aperture", "m", Shape::FractureFaces, column(1)),
            Array::new("fracture.contact_state", "1", Shape::FractureFaces, column(0)),
            Array::new("fracture.displacement_jump", "m", Shape::FractureVectors, vectors(3, 4, 1.0)),
            Array::new("fracture.traction", "Pa", Shape::FractureVectors, vectors(5, 5, -0.5)),
        ];
    }
    Snapshot { time, scalars, arrays }
}

fn attempt(step: f64, seed: usize, count: usize, outcome: AttemptOutcome) -> Attempt {
    let iteration = |i: usize| {
        let ratio = |f: usize| 1e4 * 10_f64.powf(-(0.68 + 0.02 * ((seed + f) % 4) as f64) * i as f64);
        let mut residuals: Vec<FieldResidual> = (0..4)
            .map(|f| FieldResidual { norm: 0.1 * ratio(f), limit: 0.1, worst: (f > 0).then_some(seed + i) })
            .collect();
        if outcome == AttemptOutcome::NotFinite && i == count {
            residuals[1].norm = f64::NAN;
        }
        let newton = [None, Some(2 + (seed % 3) as u64)];
        IterationRecord { residuals, seconds: [0.001 * i as f64, 0.002], newton }
    };
    Attempt { step, iterations: (1..=count).map(iteration).collect(), outcome }
}

fn record(number: usize) -> StepRecord {
    let mut attempts = Vec::new();
    if number == 5 {
        let reason = "contact did not converge in 50 iterations, \"face 3\"".into();
        attempts.push(attempt(200.0, 3, 4, AttemptOutcome::NotFinite));
        attempts.push(attempt(200.0, 3, 0, AttemptOutcome::Discarded { unit: "mechanics".into(), reason }));
    }
    attempts.push(attempt(100.0, number, 6 + number % 3, AttemptOutcome::Converged));
    StepRecord { number, time: 100.0 * number as f64, attempts }
}

/// A folder with the time steps up to `last`.
fn run_to(path: &Path, (manifest, mesh): (Manifest, Mesh), last: usize) -> Folder {
    let start = snapshot(&mesh, 0);
    let mut folder = Folder::create(path, &manifest, mesh, &start, false).unwrap();
    go_on(&mut folder, last);
    folder
}

fn go_on(folder: &mut Folder, last: usize) {
    for number in folder.last() + 1..=last {
        let snapshot = snapshot(folder.mesh(), number);
        folder.append(&record(number), &snapshot).unwrap();
    }
}

fn summary() -> Summary {
    Summary { failure: None, seconds: vec![("packing".into(), 0.31), ("total".into(), 2.6)] }
}

/// All files of a folder with their content, but for those that hold wall times or what was packed by HDF5.
fn content(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for folder in [path.to_owned(), path.join("fields"), path.join("plots")] {
        for entry in fs::read_dir(&folder).into_iter().flatten() {
            let file = entry.unwrap().path();
            let name = file.strip_prefix(path).unwrap().to_string_lossy().into_owned();
            if file.is_file() && !["run.h5", "index.html", "summary.json"].contains(&name.as_str()) {
                files.insert(name, fs::read(&file).unwrap());
            }
        }
    }
    files
}

#[test]
#[ignore = "leaves folders to look at in the folder that RESULTS_EXAMPLE names"]
fn examples_to_look_at() {
    let root = PathBuf::from(std::env::var_os("RESULTS_EXAMPLE").unwrap());
    for (name, base, changes, failed) in [
        ("plane", "six-fractures", &[][..], false),
        ("profiles", "six-fractures", &["output.plots = [\"fracture_profiles\", \"pressure_profiles\"]"][..], true),
        ("space", "network-3d", &[][..], false),
    ] {
        let path = root.join(name);
        if path.exists() {
            fs::remove_dir_all(&path).unwrap();
        }
        let mut folder = run_to(&path, case(base, changes), STEPS);
        folder.finish(&Summary { failure: failed.then(failure), ..summary() }).unwrap();
    }
}

fn failure() -> Failure {
    let residual = FieldResidual { norm: 3.2e4, limit: 12.0, worst: Some(17) };
    let field = FailedField {
        name: "fracture.pressure".into(),
        unit: "Pa".into(),
        residual,
        entries: vec![(17, 3.2e4), (18, -2.9e4)],
    };
    let attempts =
        vec![attempt(100.0, 1, 30, AttemptOutcome::NotConverged), attempt(50.0, 1, 4, AttemptOutcome::Diverged)];
    Failure { time: 2000.0, minimum: Some(25.0), attempts, fields: vec![field] }
}
