//! `orchestrator compare`, as a user has it.

mod programs;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use programs::{COARSE, command, fail, succeed};

/// `compare` of the coarse six fractures for a few time steps.
fn compare<'a>(output: &'a str, choices: &[&'a str]) -> Vec<&'a str> {
    let fixed = ["compare", "models/six-fractures", "--steps", "3", "--output", output];
    [&fixed[..], &COARSE, choices].concat()
}

/// The columns of `runs.csv` by name, but for wall times. Cells have no commas in these tests, except for the mesh and
/// the reason.
fn runs(folder: &Path) -> Vec<BTreeMap<String, String>> {
    let text = fs::read_to_string(folder.join("runs.csv")).unwrap();
    let split = |line: &str| -> Vec<String> {
        let parts = line.split('"').enumerate();
        let safe: String =
            parts.map(|(i, part)| if i % 2 == 1 { part.replace(',', ";") } else { part.into() }).collect();
        safe.split(',').map(str::to_owned).collect()
    };
    let mut lines = text.lines().map(split);
    let head = lines.next().unwrap();
    let timed = |name: &str| ["total [s]", "flow [s]", "mechanics [s]"].contains(&name);
    lines.map(|cells| head.iter().cloned().zip(cells).filter(|(name, _)| !timed(name)).collect()).collect()
}

/// The outcomes that there are, with the time at which each was written.
fn outcomes(folder: &Path) -> BTreeMap<PathBuf, SystemTime> {
    let list = fs::read_dir(folder.join("kept")).into_iter().flatten();
    let files = list.map(|entry| entry.unwrap().path().join("outcome")).filter(|path| path.is_file());
    files.map(|path| (path.clone(), path.metadata().unwrap().modified().unwrap())).collect()
}

#[test]
fn two_by_two_are_the_runs_that_they_are_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let output = path("comparison");
    let choices = ["--split", "fixed_stress,drained", "--acceleration", "none,anderson:depth=2"];
    succeed(&compare(&output, &choices));
    let runs = runs(Path::new(&output));
    let chosen: Vec<(&str, &str)> = runs.iter().map(|r| (r["split"].as_str(), r["acceleration"].as_str())).collect();
    let expected = [("fixed_stress", "none"), ("fixed_stress", "anderson:depth=2")];
    assert_eq!(chosen[..2], expected);
    assert_eq!(chosen[2..], expected.map(|(_, acceleration)| ("drained", acceleration)));
    for (i, run) in runs.iter().enumerate() {
        assert_eq!((run["outcome"].as_str(), run["time_steps"].as_str()), ("complete", "3"));
        let alone = path(&format!("alone{i}"));
        let split = format!("coupling.split={}", run["split"]);
        let acceleration = match run["acceleration"].as_str() {
            "none" => "coupling.acceleration=none",
            _ => "coupling.acceleration.anderson={depth=2}",
        };
        let mut call = vec!["run", "models/six-fractures", "--quiet", "--output", &alone, "--set", &split];
        call.extend(["--set", "time.end=300", "--set", "output.times=[]"]);
        call.extend(["--set", "coupling.acceleration=none", "--set", acceleration]);
        succeed(&[&call[..], &COARSE].concat());
        let summary = fs::read_to_string(Path::new(&alone).join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
        assert_eq!(summary["coupling_iterations"].to_string(), run["coupling_iterations"], "{run:?}");
    }
    for file in ["index.html", "comparison.h5", "attempts.csv", "plots/residuals.svg", "runs/0004/model.toml"] {
        assert!(Path::new(&output).join(file).is_file(), "{file}");
    }
    assert!(!Path::new(&output).join("units").exists());

    // Again: nothing is made. With one more option: two more are.
    let before = outcomes(Path::new(&output));
    assert_eq!(before.len(), 4);
    assert!(succeed(&compare(&output, &choices)).contains("4 of them made before"));
    assert_eq!(outcomes(Path::new(&output)), before);
    let more = ["--split", "fixed_stress,drained", "--acceleration", "none,aitken,anderson:depth=2"];
    assert!(succeed(&compare(&output, &more)).contains("6 runs, 4 of them made before"));
    let after = outcomes(Path::new(&output));
    assert!(after.len() == 6 && before.iter().all(|(path, time)| after[path] == *time));
}

#[test]
fn a_comparison_that_is_killed_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, killed] = ["whole", "killed"].map(|name| folder.path().join(name).to_str().unwrap().to_owned());
    let choices = ["--split", "fixed_stress,drained", "--dt", "10,20,50,100", "--jobs", "1"];
    succeed(&compare(&whole, &choices));
    let mut child = command(&compare(&killed, &choices)).spawn().unwrap();
    let clock = Instant::now();
    while outcomes(Path::new(&killed)).len() < 2 {
        assert!(clock.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let before = outcomes(Path::new(&killed));
    assert!(before.len() < 8, "it was not killed in time");
    assert!(!Path::new(&killed).join("runs.csv").exists());
    succeed(&compare(&killed, &choices));
    let after = outcomes(Path::new(&killed));
    assert!(after.len() == 8 && before.iter().all(|(path, time)| after[path] == *time));
    assert_eq!(runs(Path::new(&killed)), runs(Path::new(&whole)));
    assert_eq!(runs(Path::new(&whole))[1]["dt [s]"], "20");
}

#[test]
fn runs_that_fail_do_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("comparison");
    let path = output.to_str().unwrap();
    // One coupling iteration is too few: the first time step of that run fails.
    succeed(&compare(path, &["--set", "coupling.max_iterations=1,50", "--set", "coupling.acceleration=none"]));
    let runs_of = || runs(&output);
    let [failed, complete] = &runs_of()[..] else { panic!() };
    assert_eq!((failed["outcome"].as_str(), failed["coupling_iterations"].as_str()), ("failed", "1"));
    assert!(failed["reason"].contains("t = 0 s") && failed["reason"].contains("did not converge"), "{failed:?}");
    assert_eq!((complete["outcome"].as_str(), complete["reason"].as_str()), ("complete", ""));

    // No such boundary in the mesh: that shows only when the mesh is made.
    let tags = "mechanics.displacement=[{on=[\"nowhere\"],x=0}],[{on=[\"bottom\"],x=0,y=0}]";
    fail(&compare(path, &["--set", tags]), 1);
    let [error, complete] = &runs_of()[..] else { panic!() };
    assert_eq!((error["outcome"].as_str(), complete["outcome"].as_str()), ("error", "complete"));
    assert!(error["reason"].contains("nowhere"), "{error:?}");
    let page = fs::read_to_string(output.join("index.html")).unwrap();
    assert!(page.contains("1 of 2 runs not complete") && page.contains("nowhere"));
}

#[test]
fn wrong_choices_are_said_at_once_and_nothing_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("comparison");
    let path = output.to_str().unwrap();
    let wrong = ["--split", "fixed_stress,fixed_stres", "--acceleration", "none,relaxation", "--dt", "10,-1"];
    let text = fail(&compare(path, &wrong), 2);
    for word in ["3 problems", "fixed_stres`", "undrained", "relaxation.factor", "time.step", "positive"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let text = fail(&compare(path, &["--variant", "default,h0", "--set", "coupling.splits=drained"]), 2);
    for word in ["h0.01", "splits", "`split`"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    assert!(fail(&compare(path, &["--dt", "10,10"]), 2).contains("twice"));
    assert!(!output.exists());
    // A folder with something else in it is left alone.
    fs::create_dir(&output).unwrap();
    fs::write(output.join("notes"), "mine").unwrap();
    assert!(fail(&compare(path, &["--dt", "10,20"]), 2).contains("something else"));
    assert_eq!(fs::read_dir(&output).unwrap().count(), 1);
}
