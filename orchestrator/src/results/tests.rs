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
    let mesh = document.mesh(&models(), &|_, _| unreachable!()).unwrap();
    let units = ["flow", "mechanics"].map(|name| UnitVersion { name: name.into(), version: "0.1.0".into() }).to_vec();
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
        let ratio = |f: usize| {
            1e4 * 10_f64.powf((seed % 5) as f64 / 4.0 - 1.0 - (0.5 + 0.015 * ((7 * seed) % 20 + f) as f64) * i as f64)
        };
        let mut residuals: Vec<FieldResidual> = (0..4)
            .map(|f| FieldResidual { norm: 0.1 * ratio(f), limit: 0.1, worst: (f > 0).then_some(seed + i) })
            .collect();
        if outcome == AttemptOutcome::NotFinite && i == count {
            residuals[1].norm = f64::NAN;
        }
        let newton = vec![None, Some(2 + (seed % 3) as u64)];
        IterationRecord { residuals, seconds: vec![0.001 * i as f64, 0.002], newton, derivatives: 2 * i }
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
    Summary { failure: None, seconds: vec![("packing".into(), 0.31), ("total".into(), 2.6)], units: Vec::new() }
}

/// All files of a folder with their content, but for those that hold wall times or dates (those of HDF5).
fn content(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for folder in [path.to_owned(), path.join("fields"), path.join("plots")] {
        for entry in fs::read_dir(&folder).into_iter().flatten() {
            let file = entry.unwrap().path();
            let name = file.strip_prefix(path).unwrap().to_string_lossy().into_owned();
            if file.is_file() && !["mesh.h5", "run.h5", "index.html", "summary.json"].contains(&name.as_str()) {
                files.insert(name, fs::read(&file).unwrap());
            }
        }
    }
    files
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

fn assert_same(a: &Path, b: &Path) {
    let [a, b] = [content(a), content(b)];
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    let different: Vec<_> = a.iter().filter(|(name, bytes)| b[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(different.is_empty(), "{different:?} differ");
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

fn kinds(error: ResultsError) -> &'static str {
    match error {
        ResultsError::Io { .. } => "io",
        ResultsError::Exists(_) => "exists",
        ResultsError::Foreign(_) => "foreign",
        ResultsError::InUse(_) => "in use",
        ResultsError::Damaged { .. } => "damaged",
        ResultsError::Incomplete { .. } => "incomplete",
        ResultsError::Content { .. } => "content",
        _ => "other",
    }
}

#[test]
fn a_journal_that_is_cut_or_damaged_in_its_last_entry_loses_that_entry_only() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    let before = {
        drop(run_to(&path, coarse(), 3));
        fs::read(path.join(JOURNAL)).unwrap()
    };
    let all = {
        go_on(&mut Folder::reopen(&path, None).unwrap(), 4);
        fs::read(path.join(JOURNAL)).unwrap()
    };
    assert!(all.starts_with(&before) && all.len() > before.len() + 40);
    let file = temporary.path().join(JOURNAL);
    let last = |bytes: &[u8]| {
        fs::write(&file, bytes).unwrap();
        let mut numbers = Vec::new();
        Journal::reopen(&file, None, |entry| {
            assert_eq!(
                entry.record,
                if entry.record.number == 0 { start_record() } else { record(entry.record.number) }
            );
            numbers.push(entry.record.number);
            Ok(())
        })
        .unwrap();
        (numbers, fs::read(&file).unwrap())
    };
    assert_eq!(last(&all), (vec![0, 1, 2, 3, 4], all.clone()));
    for end in before.len()..all.len() {
        assert_eq!(last(&all[..end]), (vec![0, 1, 2, 3], before.clone()), "cut after {end} bytes");
    }
    for at in (before.len()..all.len()).step_by(7) {
        let mut damaged = all.clone();
        damaged[at] ^= 0x10;
        assert_eq!(last(&damaged), (vec![0, 1, 2, 3], before.clone()), "byte {at} is wrong");
    }
    // The folder as a whole is then that of the shorter run.
    let shorter = temporary.path().join("shorter");
    let (mut manifest, mesh) = coarse();
    manifest.started = Manifest::read(&path.join(MANIFEST)).unwrap().started;
    drop(run_to(&shorter, (manifest, mesh), 3));
    fs::write(path.join(JOURNAL), &all[..all.len() - 1]).unwrap();
    assert_eq!(Folder::reopen(&path, None).unwrap().last(), 3);
    assert_same(&path, &shorter);
}

fn start_record() -> StepRecord {
    StepRecord { number: 0, time: 0.0, attempts: Vec::new() }
}

#[test]
fn a_run_that_was_killed_and_resumed_leaves_the_same_files() {
    let temporary = tempfile::tempdir().unwrap();
    let [whole, resumed] = ["whole", "resumed"].map(|name| temporary.path().join(name));
    let case = coarse();
    run_to(&whole, case.clone(), STEPS).finish(&summary()).unwrap();
    // Killed after 12 time steps, while files were being written; the checkpoint is that of time step 8.
    run_to(&resumed, case, 12).finish(&summary()).unwrap();
    fs::write(resumed.join("checkpoint.part"), "half").unwrap();
    fs::write(resumed.join("fields/matrix-000011.vtu.4711.part"), "half").unwrap();
    fs::write(resumed.join("series.csv"), "half").unwrap();
    let mut folder = Folder::reopen(&resumed, Some(8)).unwrap();
    assert_eq!(folder.last(), 8);
    assert!(!resumed.join(PAGE).exists() && !resumed.join(RUN).exists());
    assert!(!resumed.join("fields/matrix-000010.vtu").exists(), "a field beyond the checkpoint");
    go_on(&mut folder, STEPS);
    folder.finish(&summary()).unwrap();
    assert_same(&whole, &resumed);
    let whole_files = content(&whole);
    for name in ["journal", "series.csv", "iterations.csv", "fields/fractures-000010.vtu", "plots/contact-000005.svg"] {
        assert!(whole_files.contains_key(name), "{name}");
    }
    drop(folder);
    assert_eq!(kinds(Folder::reopen(&resumed, Some(STEPS + 1)).unwrap_err()), "incomplete");
}

#[test]
fn hdf5_and_tables_hold_what_the_journal_holds() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    let mut folder = run_to(&path, coarse(), 5);
    folder.finish(&summary()).unwrap();
    let entries: Vec<Entry> = Entries::open(&path.join(JOURNAL)).unwrap().map(Result::unwrap).collect();
    assert_eq!(entries.len(), 6);
    assert_eq!(entries[3].snapshot, snapshot(folder.mesh(), 3));

    let file = hdf5_metno::File::open(path.join(RUN)).unwrap();
    let floats = |name: &str| file.dataset(name).unwrap().read_raw::<f64>().unwrap();
    let integers = |name: &str| file.dataset(name).unwrap().read_raw::<i64>().unwrap();
    let unit = |name: &str| {
        let attribute = file.dataset(name).unwrap().attr("unit").unwrap();
        attribute.read_scalar::<hdf5_metno::types::VarLenUnicode>().unwrap().to_string()
    };
    assert_eq!(integers("series/time_step"), [0, 1, 2, 3, 4, 5]);
    assert_eq!(floats("series/time"), [0.0, 100.0, 200.0, 300.0, 400.0, 500.0]);
    for (i, scalar) in entries[0].snapshot.scalars.iter().enumerate() {
        let name = format!("series/{}", scalar.name);
        assert_eq!(floats(&name), entries.iter().map(|e| e.snapshot.scalars[i].value).collect::<Vec<_>>());
        assert_eq!(unit(&name), scalar.unit);
    }
    assert_eq!(integers("attempts/time_step"), [1, 2, 3, 4, 5, 5, 5]);
    assert_eq!(integers("attempts/attempt"), [1, 1, 1, 1, 1, 2, 3]);
    assert_eq!(integers("attempts/outcome"), [0, 0, 0, 0, 3, 4, 0]);
    assert_eq!(integers("attempts/iterations"), [7, 8, 6, 7, 4, 0, 8]);
    let iterations: Vec<&IterationRecord> =
        entries.iter().flat_map(|e| &e.record.attempts).flat_map(|a| &a.iterations).collect();
    let bits = |list: Vec<f64>| list.into_iter().map(f64::to_bits).collect::<Vec<_>>();
    for (f, field) in folder.manifest().fields.iter().enumerate() {
        let of = |get: fn(&FieldResidual) -> f64| iterations.iter().map(|i| get(&i.residuals[f])).collect::<Vec<_>>();
        let name = |what: &str| format!("iterations/{}/{what}", field.name);
        assert_eq!(bits(floats(&name("residual"))), bits(of(|r| r.norm)));
        assert_eq!(floats(&name("limit")), of(|r| r.limit));
        assert_eq!(unit(&name("limit")), field.unit);
        let worst = |i: &&IterationRecord| i.residuals[f].worst.map_or(-1, |w| w as i64);
        assert_eq!(integers(&name("worst")), iterations.iter().map(worst).collect::<Vec<_>>());
    }
    assert!(floats("iterations/fracture.pressure/residual").iter().any(|v| v.is_nan()));
    assert!(integers("iterations/flow/newton_iterations").iter().all(|&n| n == -1));
    assert_eq!(floats("iterations/mechanics/seconds"), vec![0.002; iterations.len()]);
    let derivatives = iterations.iter().map(|i| i.derivatives as i64).collect::<Vec<_>>();
    assert_eq!(integers("iterations/derivatives"), derivatives);
    for number in [0, 1, 5] {
        let group = format!("fields/{number:06}");
        let time = file.group(&group).unwrap().attr("time").unwrap().read_scalar::<f64>().unwrap();
        assert_eq!(time, entries[number].snapshot.time);
        for array in &entries[number].snapshot.arrays {
            let name = format!("{group}/{}", array.name);
            assert_eq!(floats(&name), array.values);
            let shape = file.dataset(&name).unwrap().shape();
            assert_eq!(shape.len(), if array.shape == Shape::FractureVectors { 2 } else { 1 });
        }
    }
    assert_eq!(file.group("fields").unwrap().len(), 3);

    let table = |name: &str| -> Vec<Vec<String>> {
        let text = fs::read_to_string(path.join(name)).unwrap();
        text.lines().map(|line| line.split(',').map(String::from).collect()).collect()
    };
    let series = table("series.csv");
    assert_eq!(series.len(), 1 + entries.len());
    assert_eq!(series[0][5], "aperture.mean [m]");
    for (row, entry) in series[1..].iter().zip(&entries) {
        assert_eq!(row[0], entry.record.number.to_string());
        let values: Vec<f64> = row[2..].iter().map(|v| v.parse().unwrap()).collect();
        assert_eq!(values, entry.snapshot.scalars.iter().map(|s| s.value).collect::<Vec<_>>());
    }
    let rows = table("iterations.csv");
    assert_eq!(rows.len(), 1 + iterations.len());
    assert_eq!(rows[0].len(), 3 + 4 * 4 + 2 + 1);
    assert_eq!(rows[0][7], "fracture.pressure.residual [Pa]");
    for (row, iteration) in rows[1..].iter().zip(&iterations) {
        assert_eq!(row.len(), rows[0].len());
        assert_eq!(row.last().unwrap().parse::<usize>().unwrap(), iteration.derivatives);
        assert_eq!(row[7].parse::<f64>().unwrap().to_bits(), iteration.residuals[1].norm.to_bits());
        assert_eq!((row[6].as_str(), row[19].as_str()), ("", ""), "no worst entry, no Newton iterations");
        assert_eq!(row[20], iteration.newton[1].unwrap().to_string());
    }
    assert_eq!(table("timings.csv").len(), 1 + iterations.len());
    let attempts = fs::read_to_string(path.join("attempts.csv")).unwrap();
    assert!(
        attempts.contains(
            "5,2,200.0,0,discarded,\"mechanics: contact did not converge in 50 iterations, \"\"face 3\"\"\"\n"
        ),
        "{attempts}"
    );
}

#[test]
fn nothing_is_overwritten_silently() {
    let temporary = tempfile::tempdir().unwrap();
    let create = |path: &Path, overwrite: bool| {
        let (manifest, mesh) = coarse();
        let start = snapshot(&mesh, 0);
        Folder::create(path, &manifest, mesh, &start, overwrite)
    };
    let notes = temporary.path().join("notes");
    fs::create_dir(&notes).unwrap();
    fs::write(notes.join("thoughts.txt"), "mine").unwrap();
    assert_eq!(kinds(create(&notes, false).unwrap_err()), "exists");
    assert_eq!(kinds(create(&notes, true).unwrap_err()), "foreign");
    assert_eq!(fs::read_to_string(notes.join("thoughts.txt")).unwrap(), "mine");
    assert_eq!(fs::read_dir(&notes).unwrap().count(), 1);
    let file = notes.join("thoughts.txt");
    assert_eq!(kinds(create(&file, false).unwrap_err()), "exists");
    let error = create(&file.join("run"), false).unwrap_err();
    assert!(error.to_string().contains("thoughts.txt"), "{error}");
    assert_eq!(kinds(error), "io");

    let path = temporary.path().join("deep/run");
    fs::create_dir_all(&path).unwrap();
    let folder = run_to(&path, coarse(), 2);
    assert_eq!(kinds(create(&path, true).unwrap_err()), "in use");
    assert_eq!(kinds(Folder::reopen(&path, None).unwrap_err()), "in use");
    drop(folder);
    assert_eq!(kinds(create(&path, false).unwrap_err()), "exists");
    assert_eq!(Folder::reopen(&path, None).unwrap().last(), 2);
    assert_eq!(create(&path, true).unwrap().last(), 0);
    assert_eq!(Folder::reopen(&path, None).unwrap().last(), 0);
    assert_eq!(fs::read_dir(temporary.path().join("deep")).unwrap().count(), 1, "nothing is left beside it");
}

#[test]
fn what_does_not_fit_is_refused_and_leaves_no_trace() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    let (manifest, mesh) = coarse();
    let mut wrong = snapshot(&mesh, 0);
    wrong.arrays[0].values.clear();
    assert_eq!(kinds(Folder::create(&path, &manifest, mesh, &wrong, false).unwrap_err()), "content");
    assert_eq!(fs::read_dir(temporary.path()).unwrap().count(), 0);
    // What a killed process leaves is no obstacle.
    fs::create_dir(temporary.path().join("run.part")).unwrap();
    fs::write(temporary.path().join("run.part/manifest.json.part"), "half").unwrap();

    let mut folder = run_to(&path, coarse(), 1);
    let before = content(&path);
    let good = snapshot(folder.mesh(), 5);
    assert_eq!(kinds(folder.append(&record(3), &good).unwrap_err()), "content");
    let mut short = good.clone();
    short.arrays[4].values.pop();
    assert_eq!(kinds(folder.append(&record(2), &short).unwrap_err()), "content");
    let mut renamed = good.clone();
    renamed.scalars[0].unit = "MPa".into();
    assert_eq!(kinds(folder.append(&record(2), &renamed).unwrap_err()), "content");
    let mut residuals = record(2);
    residuals.attempts[0].iterations[1].residuals.pop();
    assert_eq!(kinds(folder.append(&residuals, &good).unwrap_err()), "content");
    assert!(content(&path) == before);
    folder.append(&record(2), &good).unwrap();
    drop(folder);

    fs::write(path.join(JOURNAL), "a letter to a friend").unwrap();
    assert_eq!(kinds(Folder::reopen(&path, None).unwrap_err()), "damaged");
    let text = fs::read_to_string(path.join(MANIFEST)).unwrap();
    fs::write(path.join(MANIFEST), text.replacen("\"version\": 1", "\"version\": 2", 1)).unwrap();
    assert_eq!(kinds(Folder::reopen(&path, None).unwrap_err()), "damaged");
}

#[test]
fn another_mesh_is_noticed() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    drop(run_to(&path, coarse(), 0));
    let (_, other) = case("six-fractures", &["mesh.triangles = { size = 0.2, fracture_size = 0.1 }"]);
    mesh_io::write_hdf5(path.join(MESH), other.data()).unwrap();
    assert_eq!(Folder::reopen(&path, None).map(|_| ()).map_err(kinds), Err("damaged"));
}

#[test]
fn a_checkpoint_is_replaced_as_a_whole() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    let mut folder = run_to(&path, coarse(), 1);
    assert_eq!(Folder::read_checkpoint(&path).unwrap(), None);
    folder.checkpoint(b"first").unwrap();
    folder.checkpoint(b"second").unwrap();
    assert_eq!(Folder::read_checkpoint(&path).unwrap().unwrap(), b"second");
    // The temporary file cannot be made.
    fs::create_dir(path.join("checkpoint.part")).unwrap();
    assert_eq!(kinds(folder.checkpoint(b"third").unwrap_err()), "io");
    assert_eq!(Folder::read_checkpoint(&path).unwrap().unwrap(), b"second");
}

#[test]
fn plots_show_all_curves_and_name_them() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    let mut folder = run_to(&path, coarse(), STEPS);
    folder.finish(&summary()).unwrap();
    let plot = |name: &str| fs::read_to_string(path.join(PLOTS).join(name).with_extension("svg")).unwrap();
    let count = |text: &str, part: &str| text.matches(part).count();
    let polylines =
        |text: &str, color: &str| count(text, &format!("<polyline fill=\"none\" opacity=\"1\" stroke=\"{color}\""));
    let says = |text: &str, label: &str| text.lines().any(|line| line == label);

    let pressures = plot("mean-pressure");
    for (color, label) in [("#0072B2", "matrix"), ("#D55E00", "fractures")] {
        assert_eq!(polylines(&pressures, color), 2, "{label}: in the legend and as a curve");
        assert!(says(&pressures, label));
    }
    assert_eq!(count(&pressures, "<circle "), 2 * (STEPS + 1));
    assert!(says(&pressures, "time (s)") && says(&pressures, "pressure (kPa)") && says(&pressures, "2000"));
    assert!(says(&plot("mean-aperture"), "aperture (µm)"));
    assert!(["open", "stick", "slip", "fracture faces"].iter().all(|label| says(&plot("contact-counts"), label)));

    // On the map each run of faces in one state is one line.
    let (_, mesh) = coarse();
    let network = mesh.network();
    let states: Vec<f64> = snapshot(&mesh, 5).arrays[3].values.clone();
    let map = plot("contact-000005");
    for (state, label, color) in [(0.0, "open", "#0072B2"), (1.0, "stick", "#828282"), (2.0, "slip", "#D55E00")] {
        let faces: Vec<usize> = (0..states.len()).filter(|&f| states[f] == state).collect();
        assert!(says(&map, &format!("{label}: {}", faces.len())));
        let mut runs = 0;
        for fracture in 0..6 {
            let mut ends = BTreeMap::new();
            let own = || faces.iter().filter(|&&f| network.fracture[f] == fracture);
            own().flat_map(|&f| mesh.face_vertices(network.faces[f])).for_each(|v| *ends.entry(v).or_insert(0) += 1);
            runs += ends.values().filter(|&&n| n == 1).count() / 2;
        }
        // Grey is also the outline.
        assert_eq!(polylines(&map, color), runs + usize::from(state == 1.0), "{label}");
    }
    assert!(says(&map, "Contact states at t = 500 s") && says(&map, "x (m)") && says(&map, "y (m)"));
    for number in [1, 5, 10, 20] {
        assert!(path.join(format!("plots/contact-{number:06}.svg")).exists());
    }

    let bars = plot("coupling-iterations");
    assert_eq!(count(&bars, "fill=\"#0072B2\""), STEPS + 1);
    assert_eq!(count(&bars, "fill=\"#E69F00\""), 2, "the legend and time step 5");
    let convergence = plot("coupling-convergence");
    let colors: std::collections::BTreeSet<&str> = convergence
        .split("<polyline ")
        .skip(1)
        .filter_map(|p| p.split("stroke=\"").nth(1)?.split('"').next())
        .collect();
    assert!(colors.len() >= STEPS + 2, "{} colours for {STEPS} time steps, failed ones and the limit", colors.len());
    assert!(["time step 1", "11", "20", "failed", "limit"].iter().all(|label| says(&convergence, label)));
    // That of time step 5, in dashes, and those of the failure, which are more.
    let dashes = polylines(&convergence, "#E69F00");
    assert!(dashes > 6, "{dashes}");
    folder.finish(&Summary { failure: Some(failure()), ..summary() }).unwrap();
    assert!(polylines(&plot("coupling-convergence"), "#E69F00") > 2 * dashes);
}

#[test]
fn profiles_and_projections_are_drawn_where_they_make_sense() {
    let temporary = tempfile::tempdir().unwrap();
    let names = |path: &Path| {
        let mut names: Vec<String> =
            fs::read_dir(path.join(PLOTS)).unwrap().map(|f| f.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    let path = temporary.path().join("plane");
    let (mut manifest, mesh) = coarse();
    manifest.plots = vec![model::Plot::FractureProfiles];
    run_to(&path, (manifest, mesh), 10).finish(&summary()).unwrap();
    assert_eq!(names(&path).len(), 12);
    let profile = fs::read_to_string(path.join("plots/traction-fracture-2.svg")).unwrap();
    assert!(
        ["100 s", "500 s", "1000 s", "tangential", "traction (MPa)", "along the fracture (m)"]
            .iter()
            .all(|l| profile.contains(l))
    );

    let path = temporary.path().join("space");
    let case = case("network-3d", &[]);
    let faces = case.1.network().face_count();
    run_to(&path, case, 5).finish(&summary()).unwrap();
    let map = fs::read_to_string(path.join("plots/contact-000005.svg")).unwrap();
    assert_eq!(map.matches("<polygon").count(), faces);
    assert!(["x: 1 m", "y: 1 m", "z: 1 m"].iter().all(|label| map.contains(label)));
}

/// A crack that opens has no tractions but round-off, which is drawn as the zero that it is; one unit alone does not
/// iterate; the slack is that of time steps, and the start is none.
#[test]
fn what_is_no_signal_is_not_drawn_as_one() {
    let temporary = tempfile::tempdir().unwrap();
    let (mut manifest, mesh) = coarse();
    manifest.plots = [model::Plot::FractureProfiles, model::Plot::CouplingConvergence, model::Plot::Energy].into();
    manifest.fields.clear();
    let noisy = |number: usize| {
        let mut snapshot = snapshot(&mesh, number);
        let traction = snapshot.arrays.iter_mut().find(|a| a.name == "fracture.traction").unwrap();
        traction.values.iter_mut().for_each(|v| *v *= 1e-17);
        snapshot.scalars.push(Scalar::new("contact.violation", "Pa", 1e-10));
        snapshot.scalars.push(Scalar::new("energy.slack_relative", "1", number as f64));
        snapshot
    };
    let path = temporary.path().join("run");
    let mut folder = Folder::create(&path, &manifest, coarse().1, &noisy(0), false).unwrap();
    let mut record = record(1);
    record.attempts[0].iterations.iter_mut().for_each(|iteration| iteration.residuals.clear());
    folder.append(&record, &noisy(1)).unwrap();
    let page = fs::read_to_string(folder.finish(&summary()).unwrap()).unwrap();
    let plot = |name: &str| fs::read_to_string(path.join(PLOTS).join(name));
    let says = |text: &str, label: &str| text.lines().any(|line| line == label);
    let traction = plot("traction-fracture-2.svg").unwrap();
    assert!(says(&traction, "traction (Pa)") && says(&traction, "−1.0"), "{traction}");
    let jump = plot("displacement-jump-fracture-2.svg").unwrap();
    assert!(["normal", "tangential"].iter().all(|label| says(&jump, label)));
    let slack = plot("energy-slack.svg").unwrap();
    assert_eq!(slack.matches("<circle ").count(), 1);
    assert!(plot("coupling-iterations.svg").is_err() && plot("coupling-convergence.svg").is_err());
    assert!(!page.contains("coupling iterations") && page.contains("<b>1</b><span>time step</span>"));
}

#[test]
fn the_page_is_whole_and_needs_no_other_file() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    let (mut manifest, mesh) = coarse();
    manifest.model.title = "Cracks & \"faults\" <i>".into();
    manifest.model.changes = vec!["mesh.triangles.size = 0.4 # <>&".into()];
    let fingerprint = mesh.fingerprint();
    let mut folder = run_to(&path, (manifest, mesh), STEPS);
    let page = folder.finish(&Summary { failure: Some(failure()), ..summary() }).unwrap();
    let text = fs::read_to_string(&page).unwrap();

    let mut reader = quick_xml::Reader::from_str(&text);
    let (mut open, mut plots) = (0, 0);
    loop {
        match reader.read_event().unwrap() {
            Event::Start(tag) => {
                open += 1;
                plots += usize::from(tag.name().as_ref() == "svg");
                tag.attributes().for_each(|attribute| assert!(attribute.is_ok(), "{tag:?}"));
            }
            Event::End(_) => open -= 1,
            Event::Eof => break,
            _ => {}
        }
    }
    assert_eq!(open, 0);
    assert_eq!(plots, fs::read_dir(path.join(PLOTS)).unwrap().count());
    assert_eq!(plots, 9);
    let foreign = text.matches("http").count() - text.matches("http://www.w3.org/").count();
    assert_eq!((foreign, text.matches("src=").count(), text.matches("url(").count()), (0, 0, 0));
    for link in text.split("href=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        assert!(path.join(link).exists(), "{link}");
    }
    for part in [
        "<title>Cracks &amp; &quot;faults&quot; &lt;i&gt;</title>",
        "stopped at t = 2000 s",
        "no time step could be done at t = 2000 s",
        "orchestrator run six-fractures",
        "mesh.triangles.size = 0.4 # &lt;&gt;&amp;",
        &fingerprint,
        "1: 4; 2: 4",
        "contact did not converge in 50 iterations",
        "mechanics 0.1.0",
        "unit flow",
        "packing",
        "young_modulus",
    ] {
        assert!(text.contains(part), "{part}");
    }
    let summary: serde_json::Value = serde_json::from_slice(&fs::read(path.join(SUMMARY)).unwrap()).unwrap();
    assert_eq!(summary["complete"], false);
    assert_eq!(summary["time_steps"], STEPS);
    assert_eq!(summary["failed_attempts"], 4);
    let iterations: usize = (1..=STEPS).map(|n| 6 + n % 3).sum();
    assert_eq!(summary["coupling_iterations"], iterations + 4 + 30 + 4);

    folder.finish(&self::summary()).unwrap();
    let text = fs::read_to_string(&page).unwrap();
    assert!(text.contains("complete up to t = 2000 s") && !text.contains("Why it stopped"));
}

#[test]
fn a_run_without_fractures_steps_or_scalars_leaves_a_page_too() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("run");
    let (mut manifest, mesh) = case("terzaghi", &[]);
    manifest.plots.clear();
    let start = Snapshot { time: 0.0, scalars: Vec::new(), arrays: Vec::new() };
    let mut folder = Folder::create(&path, &manifest, mesh, &start, false).unwrap();
    let page = folder.finish(&Summary::default()).unwrap();
    assert!(fs::read_to_string(page).unwrap().contains("complete up to t = 0 s"));
    assert_eq!(fs::read_dir(path.join(PLOTS)).unwrap().count(), 0);
    let mut folder = {
        drop(folder);
        Folder::reopen(&path, Some(0)).unwrap()
    };
    let record = StepRecord { attempts: Vec::new(), ..record(1) };
    let pressure = Array::new("matrix.pressure", "Pa", Shape::Cells, vec![f64::NAN; folder.mesh().cell_count()]);
    folder.append(&record, &Snapshot { time: 1.0, arrays: vec![pressure], ..start }).unwrap();
    folder.finish(&Summary::default()).unwrap();
    assert!(path.join("fields/matrix-000001.vtu").exists() && !path.join("fields/fractures.pvd").exists());
}

#[test]
fn vectors_on_fractures_are_turned_into_space() {
    let (_, mesh) = coarse();
    let n = mesh.network().face_count();
    let (normal, tangential) = (3.0, -4.0);
    let array = Array::new("jump", "m", Shape::FractureVectors, [normal, tangential].repeat(n));
    let fields = fields::Parts::new(&mesh, &array);
    let vectors = fields.vectors();
    for (v, &face) in vectors.iter().zip(&mesh.network().faces) {
        let n = mesh.geometry().face_normal(face);
        assert!((v.dot(n) - normal).abs() < 1e-12 && (v.x * -n.y + v.y * n.x - tangential).abs() < 1e-12);
        assert!((v.length() - 5.0).abs() < 1e-12);
    }
    assert_eq!(vectors.len(), n);
}

#[test]
fn segments_become_lines_and_loops() {
    let lengths = |segments: &[[usize; 2]]| {
        let mut lengths: Vec<usize> = plots::chains(segments).iter().map(Vec::len).collect();
        lengths.sort_unstable();
        lengths
    };
    assert_eq!(plots::chains(&[[2, 3], [1, 2], [4, 3]]), [[(1, 1, 2), (0, 2, 3), (2, 3, 4)]]);
    assert_eq!(lengths(&[[0, 1], [1, 2], [2, 0], [5, 6]]), [1, 3]);
    // A branch: three lines that meet at 1.
    assert_eq!(lengths(&[[0, 1], [1, 2], [2, 3], [1, 4]]), [1, 1, 2]);
    assert!(plots::chains(&[]).is_empty());
}

#[test]
fn numbers_units_and_dates_are_printed_for_people() {
    use chart::{number, power, pretty, scaled, time};
    assert_eq!(
        [0.0, 0.25, 312_001.0, -1.5e-7, 7.0546, 1234.5, f64::NEG_INFINITY].map(number),
        ["0", "0.25", "3.12 × 10⁵", "−1.5 × 10⁻⁷", "7.055", "1234", "−∞"]
    );
    assert_eq!([-12, 0, 3].map(power), ["10⁻¹²", "1", "10³"]);
    assert_eq!(["m3/s", "N.m", "1", "m2"].map(pretty), ["m³/s", "N m", "", "m²"]);
    assert_eq!(scaled("Pa", 2.5e6), (1e-6, "MPa".into()));
    assert_eq!(scaled("m", 1e-4), (1e6, "µm".into()));
    assert_eq!(scaled("J", 3e7), (1e-7, "10⁷ J".into()));
    assert_eq!([90.0, 36_000.0, 864_000.0].map(time), ["90 s", "10 h", "10 days"]);
    let dates = [0, 951_782_400, 1_709_208_000, 4_102_444_799].map(manifest::date);
    assert_eq!(dates, ["1970-01-01T00:00:00Z", "2000-02-29T00:00:00Z", "2024-02-29T12:00:00Z", "2099-12-31T23:59:59Z"]);
}
