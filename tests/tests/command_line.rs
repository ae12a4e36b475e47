//! The programs, as a user has them: six fractures (C3) through the units' FMUs, kills, wrong input.
//!
//! They are built here where they are not yet, beside this test's folder.

mod programs;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use programs::{COARSE, call, command, fail, program, root, succeed};
use tests::monolithic;
use tests::six_fractures::{Coupled, triangles};

/// A scalar of `series.csv` against time (s).
fn column(folder: &Path, name: &str) -> Vec<(f64, f64)> {
    let text = fs::read_to_string(folder.join("series.csv")).unwrap();
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = |wanted: &str| head.iter().position(|h| h.split(' ').next() == Some(wanted)).unwrap();
    let (time, value) = (at("time"), at(name));
    let number = |line: &str, i: usize| line.split(',').nth(i).unwrap().parse().unwrap();
    lines.map(|line| (number(line, time), number(line, value))).collect()
}

const MEANS: [&str; 3] = ["aperture.mean", "fracture_pressure.mean", "matrix_pressure.mean"];

#[test]
fn six_fractures_agree_with_the_reference_and_with_the_libraries() {
    /// Coupling ends at residuals of 1e-5 of the ranges in one program, of 10 Pa and 0.1 µm in the other.
    const COUPLING: f64 = 1e-4;
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("results");
    let text = succeed(&["run", "models/six-fractures", "--output", results.to_str().unwrap(), "--json"]);
    let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 21);
    let iterations: Vec<u64> = lines[..20].iter().map(|l| l["iterations"].as_u64().unwrap()).collect();
    assert!(lines[..20].iter().all(|l| l["attempts"] == 1), "{text}");
    assert!(iterations.iter().all(|&n| n <= 9), "{iterations:?}");
    assert_eq!(lines[20]["summary"]["time_steps"], 20);

    let table = fs::read_to_string(root().join("models/six-fractures/reference.csv")).unwrap();
    let mut compared = 0;
    for row in table.lines().filter_map(|line| line.strip_prefix("default,")) {
        let row: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
        for (name, expected) in MEANS.iter().zip(&row[1..]) {
            let found = column(&results, name).into_iter().find(|(t, _)| *t == row[0]).unwrap().1;
            assert!((found - expected).abs() <= 0.02 * expected, "{name} at {} s: {found}, {expected}", row[0]);
            compared += 1;
        }
    }
    assert_eq!(compared, 12);

    let mut coupled = Coupled::new(triangles(0.04));
    let means = MEANS.map(|name| column(&results, name));
    for step in 1..=20 {
        let record = coupled.step(100.0, 0.0);
        for (series, expected) in means.iter().zip(record.means) {
            let (time, found) = series[step];
            assert_eq!(time, record.time);
            assert!((found - expected).abs() <= COUPLING * expected, "at {time} s: {found}, {expected}");
        }
    }
    for file in
        ["index.html", "run.h5", "manifest.json", "summary.json", "fields/matrix.pvd", "plots/mean-aperture.svg"]
    {
        assert!(results.join(file).is_file(), "{file}");
    }
}

/// Three time steps of 10 s, in which most faces begin to slip, by each split and by Newton's method on the whole.
#[test]
fn every_split_agrees_with_a_monolithic_solve() {
    /// That of the criteria, which is for the residual of one pass.
    const COUPLING: f64 = 1e-5;
    let mut coupled = Coupled::new(triangles(0.1));
    let newton: Vec<usize> = (0..3).map(|_| monolithic::step(&mut coupled, 10.0)).collect();
    println!("monolithic: {newton:?} Newton iterations");
    let aperture = coupled.mechanics.aperture(&coupled.state);
    let extremes = |values: &[f64]| {
        values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &v| [low.min(v), high.max(v)])
    };
    let fields = [
        ("aperture", extremes(&aperture), 1e-5),
        ("fracture_pressure", extremes(coupled.flow.fracture_pressure()), 1e4),
        ("matrix_pressure", extremes(&coupled.flow.state().matrix_pressure), 1e4),
    ];
    let folder = tempfile::tempdir().unwrap();
    for split in ["fixed_stress", "undrained", "drained", "fixed_strain"] {
        let results = folder.path().join(split);
        let split = format!("coupling.split = \"{split}\"");
        let run = ["run", "models/six-fractures", "--quiet", "--output", results.to_str().unwrap(), "--set", &split];
        let times = ["--set", "time={end=30, step=10}", "--set", "output.times=[30]"];
        succeed(&[&run[..], &times, &COARSE].concat());
        for (name, wanted, floor) in fields {
            let scale = f64::max(wanted[1] - wanted[0], floor);
            for (end, wanted) in ["min", "max"].iter().zip(wanted) {
                let (time, found) = *column(&results, &format!("{name}.{end}")).last().unwrap();
                assert_eq!(time, 30.0);
                let error = (found - wanted).abs() / scale;
                println!("{split}, {name}.{end}: {error:.1e} of the range");
                assert!(error <= COUPLING, "{split}, {name}.{end}: {found}, {wanted}");
            }
        }
    }
}

/// The six fractures to the end, when of 2.6 MPa some hundred pascals are left: what is left is as right as what there was.
#[test]
fn what_is_left_of_a_pressure_agrees_with_a_monolithic_solve() {
    /// Five times that of the criteria, which are for residuals of a pass and of what was left a time step before.
    const COUPLING: f64 = 5e-5;
    let mut coupled = Coupled::new(triangles(0.1));
    for _ in 0..20 {
        monolithic::step(&mut coupled, 100.0);
    }
    let largest = |values: &[f64]| values.iter().fold(f64::NEG_INFINITY, |m, v| m.max(*v));
    let fields = [
        ("fracture_pressure", largest(coupled.flow.fracture_pressure())),
        ("matrix_pressure", largest(&coupled.flow.state().matrix_pressure)),
    ];
    let folder = tempfile::tempdir().unwrap();
    for split in ["fixed_stress", "undrained", "drained", "fixed_strain"] {
        let results = folder.path().join(split);
        let split = format!("coupling.split = \"{split}\"");
        let run = ["run", "models/six-fractures", "--quiet", "--output", results.to_str().unwrap(), "--set", &split];
        succeed(&[&run[..], &COARSE].concat());
        for (name, wanted) in fields {
            let (time, found) = *column(&results, &format!("{name}.max")).last().unwrap();
            assert_eq!(time, 2000.0);
            let left = wanted - 1e5;
            assert!(left < 1e3, "{left}");
            println!("{split}, {name}.max: {:.1e} Pa of {left:.1} Pa", (found - wanted).abs());
            assert!((found - wanted).abs() <= COUPLING * left, "{split}, {name}: {found}, {wanted}");
        }
    }
}

/// All files whose content does not depend on the clock.
fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for name in ["series.csv", "attempts.csv", "iterations.csv"] {
        found.insert(name.into(), fs::read(folder.join(name)).unwrap());
    }
    for entry in fs::read_dir(folder.join("fields")).unwrap() {
        let path = entry.unwrap().path();
        found.insert(path.file_name().unwrap().into(), fs::read(&path).unwrap());
    }
    found
}

#[test]
fn a_run_that_is_killed_again_and_again_leaves_the_same_bytes() {
    const KILLS: usize = 6;
    let folder = tempfile::tempdir().unwrap();
    let (whole, killed) = (folder.path().join("whole"), folder.path().join("killed"));
    let run = |output: &Path| {
        let run = ["run", "models/six-fractures", "--quiet", "--overwrite", "--set", "time.step=8", "--output"];
        command(&[&run[..], &[output.to_str().unwrap()], &COARSE].concat())
    };
    // Before the folder is there, there is nothing to go on from.
    let go_on = || match killed.join("manifest.json").is_file() {
        true => command(&["resume", killed.to_str().unwrap(), "--quiet"]),
        false => run(&killed),
    };
    let clock = SystemTime::now();
    let output = run(&whole).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let seconds = clock.elapsed().unwrap().as_secs_f64();

    let mut random = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as u64 | 1;
    let seed = random;
    let mut reached = Vec::new();
    for kill in 0..KILLS {
        let mut child = go_on().spawn().unwrap();
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        // The first kill is late enough that there is something to lose.
        let part = (random % 1000) as f64 / 1000.0;
        let wait = if kill == 0 { 0.3 + 0.2 * part } else { 0.3 * part };
        std::thread::sleep(Duration::from_secs_f64(seconds * wait));
        child.kill().unwrap();
        child.wait().unwrap();
        reached.push(fs::read_to_string(killed.join("series.csv")).map_or(0, |text| text.lines().count()));
    }
    println!("seed {seed}: lines of series.csv after the kills {reached:?}");
    let output = go_on().output().unwrap();
    assert!(output.status.success(), "seed {seed}: {}", String::from_utf8_lossy(&output.stderr));
    let (a, b) = (content(&whole), content(&killed));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>(), "seed {seed}");
    for (name, bytes) in a {
        assert!(b[&name] == bytes, "seed {seed}: {} differs", name.display());
    }
}

#[test]
fn everything_that_is_wrong_with_a_model_is_said_at_once() {
    let text =
        fail(&["check", "models/six-fractures", "--set", "time.step=-1", "--set", "regions.rock.poisson_ratio=0.7"], 2);
    assert!(text.contains("2 problems") && text.contains("time.step") && text.contains("poisson_ratio"), "{text}");
    let text = fail(&["run", "models/six-fractures", "--variant", "h0"], 2);
    assert!(text.contains("h0.01"), "{text}");
    let text = fail(&["check", "six-fracture"], 2);
    assert!(text.contains("six-fracture/model.toml") && text.contains("models/six-fracture/model.toml"), "{text}");
    // What only the units find.
    let text = fail(&["check", "models/six-fractures", "--set", "mechanics.displacement=[]"], 1);
    assert!(text.contains("pack-mechanics") && text.contains("leave 3 of 3 rigid motions free"), "{text}");
    let text = fail(&["run", "models/six-fractures", "--output", "nowhere", "--set", "time.step=1e-30"], 2);
    assert!(text.contains("time.step: 1e-30 s is too small") && text.contains("at least 2.000e-4 s"), "{text}");
    let unknown = "connections=[{from=\"mechanics.aperture.mean\", to=\"light.aperture\"}]";
    let text = fail(&["check", "models/six-fractures", "--set", unknown], 2);
    assert!(text.contains("light.aperture") && text.contains("flow, mechanics"), "{text}");
    let unknown = "connections=[{from=\"mechanics.aperture\", to=\"flow.matrix.porosity_change\"}]";
    let text = fail(&["run", "models/six-fractures", "--output", "nowhere", "--set", unknown], 2);
    assert!(text.contains("no variable \"aperture\"; its outputs are aperture.max"), "{text}");
    assert!(fail(&["resume", "nowhere"], 1).contains("nowhere"));
}

#[test]
fn claims_are_held_against_runs() {
    let text = succeed(&["verify", "six-fractures", "--variant", "default"]);
    assert!(text.lines().all(|line| !line.starts_with("FAIL")) && text.contains("21 of 21 claims hold"), "{text}");
    let changed = ["verify", "six-fractures", "--variant", "default", "--set", "regions.rock.young_modulus=5e9"];
    let output = call(&changed);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("FAIL  ") && text.contains("the model is changed"), "{text}");
}

/// Four fractures in a cube (C4), 4 944 cells, bubbles on one side and on both.
#[test]
fn a_network_in_3d_meets_its_claims() {
    let text = succeed(&["verify", "network-3d"]);
    assert!(text.contains("network-3d, two_sided") && text.contains("14 of 14 claims hold"), "{text}");
}

/// Order 2 in h of Terzaghi's column on its two coarsest levels, a claim that does not hold, and one that cannot be read.
/// C5 on a corner-point grid until it slips.
#[test]
fn a_fault_with_a_throw_slips() {
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("results");
    let run = ["run", "models/fault-reactivation", "--variant", "throw", "--quiet", "--output"];
    let times = ["--set", "time.end='9.5*day'", "--set", "output.times=[]"];
    succeed(&[&run[..], &[results.to_str().unwrap()], &times].concat());
    let last = |name| column(&results, name).last().unwrap().1;
    assert!(last("contact.slip") > 0.0);
    // As much flows in as the case says, through 100 m of the left side.
    assert!((last("boundary.inlet.inflow") - 2e-4).abs() < 1e-15);
    let worst = |name| column(&results, name).iter().fold(0.0, |worst: f64, (_, v)| worst.max(v.abs()));
    assert!(worst("mass_balance.error") < 1e-9 * 2e-4);
    // Of tractions of 10 MPa.
    assert!(worst("contact.violation") < 1.0);
    assert!(column(&results, "energy.slack_relative").iter().all(|(_, slack)| *slack > -1e-6));
}

#[test]
fn claims_are_orders_too_and_may_be_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("column");
    fs::create_dir(&model).unwrap();
    let own = root().join("models/terzaghi");
    fs::copy(own.join("model.toml"), model.join("model.toml")).unwrap();
    let name = model.to_str().unwrap();
    let text = fs::read_to_string(own.join("reference.toml")).unwrap();
    let levels = "variants = [\"level1\", \"level2\"]";
    let head = &text[..text.find("[[claims]]").unwrap()];
    let claims = |order: f64, value: &str| {
        let order =
            format!("says = \"its order\"\nvalue = \"error/size\"\nwhen = \"last\"\norder = {order}\nsize = \"h\"\n");
        let rest = format!("says = \"its errors\"\nvalue = \"{value}\"\nwhen = \"last\"\nat_most = 0.03\n");
        let text = format!("{head}[[claims]]\n{order}{levels}\n[[claims]]\n{rest}{levels}\n");
        fs::write(model.join("reference.toml"), text).unwrap();
    };
    claims(2.0, "error/size");
    let text = succeed(&["verify", name]);
    assert!(text.contains("3 of 3 claims hold") && text.contains("pass  its order"), "{text}");
    claims(2.2, "10*error/size");
    let output = call(&["verify", name]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!((output.status.code(), text.matches("FAIL").count()), (Some(1), 3), "{text}");
    claims(2.0, "eror/size");
    let text = fail(&["verify", name], 2);
    assert!(text.contains("its errors") && text.contains("\"eror\" is not known"), "{text}");
}

#[test]
fn a_model_of_one_unit_runs_alone_and_is_gone_on_with() {
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("results");
    let output = results.to_str().unwrap();
    let mesh = "mesh.box={low=[-1, -1, -1], high=[1, 1, 1], cells=[2, 2, 2]}";
    let text = succeed(&["run", "models/manufactured-contact", "--set", mesh, "--output", output]);
    assert!(text.contains("units: mechanics") && text.contains("coupling iterations 1.0 on average"), "{text}");
    assert_eq!(column(&results, "newton.iterations").len(), 2);
    let head = fs::read_to_string(results.join("timings.csv")).unwrap();
    assert!(head.starts_with("time_step,attempt,iteration,mechanics [s]\n"), "{head}");
    assert!(succeed(&["resume", output]).contains("0 time steps"));
}

#[test]
fn a_model_is_checked_and_summed_up() {
    let text = succeed(&["check", "six-fractures"]);
    assert!(text.contains("1240 cells") && text.contains("85 fracture faces") && text.contains("vertices"), "{text}");
    let text = succeed(&["check", "network-3d", "--set", "mesh.cells=dual"]);
    assert!(text.contains("not planar") && text.contains("splits"), "{text}");
    assert!(succeed(&["schema"]).contains("\"$schema\""));
    assert!(succeed(&["completions", "bash"]).contains("_orchestrator"));
    assert!(succeed(&["run", "--help"]).contains("Examples:"));
}

#[test]
fn a_program_without_units_says_where_it_looked() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("orchestrator");
    fs::copy(program(), &copy).unwrap();
    let output = Command::new(&copy).current_dir(root()).args(["pack", "models/six-fractures"]).output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    let place = folder.path().canonicalize().unwrap();
    for word in [place.to_str().unwrap(), "pack-mechanics", "pack-flow", "mechanics_unit", "flow_unit"] {
        assert!(text.contains(word), "{word}: {text}");
    }
}

#[test]
fn units_are_files_that_a_run_can_be_given() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (own, given) = (path("own"), path("given"));
    succeed(&[&["pack", "models/six-fractures", "--output", &path("")], &COARSE[..]].concat());
    succeed(&[&["run", "models/six-fractures", "--quiet", "--output", &own], &COARSE[..]].concat());
    let (mechanics, flow) = (path("six-fractures-mechanics.fmu"), path("six-fractures-flow.fmu"));
    let with =
        ["run", "models/six-fractures", "--quiet", "--output", &given, "--mechanics", &mechanics, "--flow", &flow];
    succeed(&[&with[..], &COARSE].concat());
    assert!(content(Path::new(&own)) == content(Path::new(&given)));

    // Results are not overwritten unless that is wanted.
    let text = fail(&[&with[..], &COARSE].concat(), 1);
    assert!(text.contains("exists") && text.contains("--overwrite"), "{text}");
    // Units of another mesh are refused.
    let text = fail(&[&with[..], &["--overwrite"]].concat(), 2);
    assert!(text.contains("another mesh"), "{text}");
    assert!(content(Path::new(&own)) == content(Path::new(&given)));
}

/// A third unit, a flow that is given what mechanics has found: it finds the pressures that the coupled one has.
#[test]
fn a_third_unit_is_wired_by_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    succeed(&[&["pack", "models/six-fractures", "--output", &path("")], &COARSE[..]].concat());
    let unit = format!("units.twin.fmu={:?}", path("six-fractures-flow.fmu"));
    let wires = ["matrix.porosity_change", "fracture.aperture"]
        .map(|name| format!("{{from=\"mechanics.{name}\", to=\"twin.{name}\"}}"));
    let wires = format!("connections=[{}]", wires.join(", "));
    // Coupled closely, so that both have been given the same.
    let tight = "coupling.criteria={\"fracture.aperture\"={tolerance=1e-9, floor=1e-5}, \
                 \"matrix.porosity_change\"={tolerance=1e-9, floor=1e-5}}";
    let (pair, three) = (path("pair"), path("three"));
    let run = ["run", "models/six-fractures", "--quiet", "--set", tight, "--output"];
    succeed(&[&run[..], &[&pair], &COARSE].concat());
    succeed(&[&run[..], &[&three], &COARSE, &["--set", &unit, "--set", &wires]].concat());
    let (pair, three) = (Path::new(&pair), Path::new(&three));
    for name in MEANS {
        assert_eq!(column(pair, name), column(three, name), "{name}");
    }
    for name in &MEANS[1..] {
        let twin = column(three, &format!("twin.{name}"));
        assert_eq!(twin.len(), 21);
        for ((_, found), (time, expected)) in twin.into_iter().zip(column(three, name)) {
            assert!((found / expected - 1.0).abs() < 1e-4, "{name} at {time} s: {found}, {expected}");
        }
    }
    // A wrong wire is found before anything is run.
    let wires = wires.replacen("twin.matrix.porosity_change", "twin.fracture.pressure", 1);
    let wrong = [&["check", "models/six-fractures"], &COARSE[..], &["--set", &unit, "--set", &wires]].concat();
    let text = fail(&wrong, 2);
    assert!(text.contains("twin.fracture.pressure: it is no input"), "{text}");
}

#[test]
fn a_unit_is_tried_in_its_role() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    succeed(&[&["pack", "models/six-fractures", "--output", &path("")], &COARSE[..]].concat());
    let fmu = path("six-fractures-mechanics.fmu");
    let text = succeed(&[&["check-unit", &fmu, "six-fractures"], &COARSE[..]].concat());
    for part in
        ["as the mechanics of", "has    fracture.aperture\n", "gives the same bits", "a coupled time step of 100 s"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("lacks") && !text.contains("WRONG"), "{text}");
    let output = call(&[&["check-unit", &fmu, "six-fractures", "--role", "flow"], &COARSE[..]].concat());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.code() == Some(1) && text.contains("WRONG  matrix.pressure is no output"), "{text}");
}

#[test]
fn a_failure_says_which_field_and_where_and_leaves_the_results() {
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("results");
    let plain = ["--set", "coupling.acceleration=none"];
    let limits = ["--set", "coupling.max_iterations=3", "--set", "time.minimum=60"];
    let run = ["run", "models/six-fractures", "--quiet", "--output", results.to_str().unwrap()];
    let text = fail(&[&run[..], &COARSE, &plain, &limits].concat(), 1);
    for word in ["t = ", "residual/limit", "matrix.pressure: residual", "of fracture", " is at (", "results up to"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    assert!(results.join("index.html").is_file());
}

#[test]
fn a_refused_guess_does_not_cut_the_time_step() {
    // Here pressures fall so far from the guess of time steps 4, 6 and 8 that probed compliances close a fracture.
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("results");
    let fine = ["--variant", "h0.01", "--set", "time.end=800", "--set", "output.times=[]", "--json"];
    let run = ["run", "models/six-fractures", "--output", results.to_str().unwrap()];
    let text = succeed(&[&run[..], &fine].concat());
    let attempts: Vec<_> = text.lines().filter(|line| line.contains("\"attempts\":1,")).collect();
    assert_eq!(attempts.len(), 8, "{text}");
    // Mechanics is factorised once, and solves once for the initial equilibrium, each time step and each derivative.
    let summary: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    let work = &summary["summary"]["units"]["mechanics"];
    let count = |what: &str| work[what].as_f64().unwrap();
    assert_eq!(count("factorisations"), 1.0);
    assert_eq!(count("triangular_solves"), 1.0 + count("time_steps") + count("derivatives"), "{work}");
}
