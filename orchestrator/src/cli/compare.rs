//! Runs a model with every combination of some choices, each in a process of its own, and compares them.
//!
//! | in the folder | content |
//! |---|---|
//! | `runs/NUMBER` | a link in the order of the runs: the folder of each, in `kept` |
//! | `kept/HASH/model.toml` | the model of a run, with its choices in it |
//! | `kept/HASH/outcome` | what it left, once it has ended |
//! | the rest | see [`orchestrator::comparison`] |
//!
//! HASH is that of the model and of the programs. A run that has an outcome is not repeated: a comparison that was
//! killed goes on where it was, and one with further choices makes only the runs that are new.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use mesh::Mesh;
use model::{Document, Model, ModelError, Number};
use orchestrator::comparison::{Choice, Comparison, Entry, FigureSpec, Outcome};
use orchestrator::results::Quantity;
use orchestrator::{CouplingError, counted};
use serde::Deserialize;
use serde_json::json;
use sha2::{Digest, Sha256};

use super::case::Case;
use super::error::CliError;
use super::progress::Voice;
use super::run::{Fmus, fmus, start};

const KEPT: &str = "kept";
const RUNS: &str = "runs";
const UNITS: &str = "units";
const OUTCOME: &str = "outcome";
const MODEL: &str = "model.toml";
const MESH: &str = "mesh.h5";
const FMUS: &str = "fmus.json";
const STUDY: &str = "comparison.json";

#[derive(Args)]
pub(crate) struct CompareArguments {
    /// Folder with a model.toml, or the name of one in models/
    #[arg(required_unless_present = "study", conflicts_with = "study")]
    model: Option<PathBuf>,
    /// A file with model, choices and plots, as models/NAME/studies/*.toml
    #[arg(long, value_name = "FILE", conflicts_with_all = ["variant", "split", "acceleration", "dt", "set", "steps", "cut"])]
    study: Option<PathBuf>,
    /// Variants, as default,h0.02; a+b lays b over a
    #[arg(long, value_name = "NAME,…", default_value = "", hide_default_value = true)]
    variant: String,
    /// Splits: fixed_stress, undrained, drained, fixed_strain
    #[arg(long, value_name = "NAME,…", default_value = "", hide_default_value = true)]
    split: String,
    /// Accelerations, with their settings if need be, as none,aitken,anderson:depth=2,iqn_ils:reuse=0
    #[arg(long, value_name = "NAME,…", default_value = "", hide_default_value = true)]
    acceleration: String,
    /// Time steps (s)
    #[arg(long, value_name = "NUMBER,…", default_value = "", hide_default_value = true)]
    dt: String,
    /// Values of a key of the model, as coupling.extrapolation=constant,linear; can be given several times
    #[arg(long, value_name = "KEY=VALUE,…")]
    set: Vec<String>,
    /// Ends each run after so many time steps
    #[arg(long, value_name = "NUMBER")]
    steps: Option<usize>,
    /// Tries smaller time steps after failures, as `run` does; otherwise a failure ends the run of a model without adaptive time steps
    #[arg(long)]
    cut: bool,
    /// Folder for the results [default: results/compare-NAME]
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Makes all runs anew
    #[arg(long)]
    overwrite: bool,
    /// Runs at a time [default: number of cores]
    #[arg(short, long)]
    jobs: Option<usize>,
}

/// A file that describes a comparison.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Study {
    title: Option<String>,
    question: String,
    /// Relative to the file. Left out: the folder above that of the file.
    model: Option<PathBuf>,
    variant: Vec<String>,
    split: Vec<String>,
    acceleration: Vec<String>,
    dt: Vec<toml::Value>,
    steps: Option<usize>,
    cut: bool,
    /// As on the command line.
    set: Vec<String>,
    /// Choices of another kind.
    choice: Vec<OwnChoice>,
    reference: BTreeMap<String, String>,
    figure: Vec<FigureSpec>,
}

/// A choice whose values are put for `{}` into changes of the model.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OwnChoice {
    name: String,
    label: Option<String>,
    values: Vec<toml::Value>,
    set: Vec<String>,
}

/// An option of a choice: its name, and what it makes of the model.
struct Taken {
    name: String,
    variants: Vec<String>,
    changes: Vec<String>,
}

/// A run to be made.
struct Planned {
    options: Vec<usize>,
    case: Case,
    /// The whole model.
    toml: String,
    /// Name of its folder in `kept`.
    hash: String,
    /// Number of the units that it needs.
    units: usize,
}

/// Units that several runs share.
struct Shared {
    folder: PathBuf,
    /// How many runs will still need them; whether they are there, once it was tried.
    state: Mutex<(usize, Option<Result<(), String>>)>,
}

/// `orchestrator compare`.
pub(crate) fn compare(arguments: &CompareArguments, voice: Voice) -> Result<ExitCode, CliError> {
    let study = study(arguments)?;
    let model = study.model.clone().unwrap_or_default();
    let choices = choices(&study)?;
    let mut comparison = comparison_of(&study, &choices);
    check_study(&comparison)?;
    let mut planned = plan(&model, &study, &choices)?;
    let case = planned.first().map(|p| &p.case);
    let name = case.map_or_else(String::new, |case| case.name.clone());
    if let (None, Some(case)) = (&study.title, case) {
        comparison.title = format!("Comparison: {}", case.document.model.title);
    }
    let output = arguments.output.clone().unwrap_or_else(|| {
        let own = arguments.study.as_ref().and_then(|file| file.file_stem());
        let own = own.map_or_else(|| format!("compare-{name}"), |own| format!("{name}-{}", own.to_string_lossy()));
        PathBuf::from("results").join(own)
    });
    let lock = open(&output, arguments.overwrite)?;
    let shared = share(&mut planned, &output)?;
    for run in &planned {
        let folder = output.join(KEPT).join(&run.hash);
        fs::create_dir_all(&folder).map_err(CliError::file(&folder))?;
        write(&folder.join(MODEL), run.toml.as_bytes())?;
    }
    write(&output.join(STUDY), format!("{:#}\n", json!(comparison)).as_bytes())?;
    number(&output, &planned)?;

    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let jobs = arguments.jobs.unwrap_or(cores).clamp(1, planned.len().max(1));
    let entries = make(&comparison, &planned, &shared, &output, jobs, (cores / jobs).max(1), voice)?;
    // Nothing to do about what cannot be removed: the next comparison removes it.
    let _ = fs::remove_dir_all(output.join(UNITS));
    let page = comparison.write(&output, &entries)?;
    match voice {
        Voice::Quiet => {}
        Voice::Json => {
            for entry in &entries {
                say(&comparison.json(&entries, entry).to_string())?;
            }
            let errors = entries.iter().filter(|e| e.outcome.is_err()).count();
            let results = output.display().to_string();
            say(&json!({ "summary": { "runs": entries.len(), "errors": errors, "results": results } }).to_string())?;
        }
        Voice::Bar | Voice::Lines => {
            say(&comparison.text(&entries))?;
            say(&format!("results: {} (see {})", output.display(), page.display()))?;
        }
    }
    drop(lock);
    let has_errors = entries.iter().any(|e| e.outcome.is_err());
    Ok(if has_errors { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// `orchestrator compare-run`: one of the runs. Ends when the process that started it does.
pub(crate) fn run(folder: &Path, units: &Path, arrays: bool) -> Result<(), CliError> {
    std::thread::spawn(|| {
        // Standard input ends with the process that holds its other end.
        let _ = io::stdin().read_to_end(&mut Vec::new());
        std::process::exit(1);
    });
    let document = Document::load(folder, &[], &[])?;
    let file = units.join(MESH);
    let unsound = |error| ModelError::Mesh { place: file.display().to_string(), error };
    let mesh = Mesh::new(mesh_io::read_hdf5(&file)?).map_err(unsound)?;
    let file = units.join(FMUS);
    let text = fs::read_to_string(&file).map_err(CliError::file(&file))?;
    let paths: Fmus = serde_json::from_str(&text)
        .map_err(|error| CliError::File { path: file, error: io::Error::new(io::ErrorKind::InvalidData, error) })?;
    let clock = Instant::now();
    let (mut run, mut series) = start(&paths, &document, &mesh)?.run()?;
    let mut outcome = Outcome {
        units: paths.iter().map(|(name, _)| name.clone()).collect(),
        fields: Vec::new(),
        measures: if arrays { Outcome::measures_of(&mesh) } else { Default::default() },
        records: Vec::new(),
        snapshots: Vec::new(),
        failure: None,
        seconds: 0.0,
    };
    let fields = &run.interface().fields;
    outcome.fields = fields.iter().map(|f| Quantity { name: f.name.clone(), unit: f.unit.clone() }).collect();
    let mut outside = Duration::ZERO;
    loop {
        let before = Instant::now();
        let mut snapshot = series.of(&mut run)?;
        if !arrays {
            snapshot.arrays.clear();
        }
        outcome.snapshots.push(snapshot);
        outside += before.elapsed();
        if run.is_finished() {
            break;
        }
        match run.advance() {
            Ok(record) => outcome.records.push(record),
            Err(CouplingError::Failed(report)) => {
                outcome.failure = Some(*report);
                break;
            }
            Err(error) => return Err(error.into()),
        }
    }
    outcome.seconds = (clock.elapsed() - outside).as_secs_f64();
    Ok(outcome.write(&folder.join(OUTCOME))?)
}

/// What is asked for, from a file or from the command line.
fn study(arguments: &CompareArguments) -> Result<Study, CliError> {
    if let Some(file) = &arguments.study {
        return read_study(file);
    }
    Ok(Study {
        model: arguments.model.clone(),
        variant: list(&arguments.variant),
        split: list(&arguments.split),
        acceleration: list(&arguments.acceleration),
        dt: list(&arguments.dt).into_iter().map(toml::Value::String).collect(),
        set: arguments.set.clone(),
        steps: arguments.steps,
        cut: arguments.cut,
        ..Study::default()
    })
}

fn read_study(file: &Path) -> Result<Study, CliError> {
    let text = fs::read_to_string(file).map_err(CliError::file(file))?;
    let unfit = |error: toml::de::Error| CliError::Unfit(format!("{}: {error}", file.display()));
    let mut study: Study = toml::from_str(&text).map_err(unfit)?;
    let folder = file.parent().unwrap_or(Path::new(""));
    study.model = Some(folder.join(study.model.as_deref().unwrap_or(Path::new(".."))));
    Ok(study)
}

/// What is compared, but for its title where the study gives none.
fn comparison_of(study: &Study, choices: &[(Choice, Vec<Taken>)]) -> Comparison {
    Comparison {
        title: study.title.clone().unwrap_or_default(),
        question: study.question.clone(),
        command: std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect(),
        choices: choices.iter().map(|c| c.0.clone()).collect(),
        reference: study.reference.clone(),
        figures: study.figure.clone(),
    }
}

/// The parts of a list, separated by commas that stand in no brackets or quotes.
fn list(text: &str) -> Vec<String> {
    let (mut parts, mut depth, mut quote) = (vec![String::new()], 0, None);
    for c in text.chars() {
        match (quote, c) {
            (Some(q), _) if c == q => quote = None,
            (None, '"' | '\'') => quote = Some(c),
            (None, '[' | '{' | '(') => depth += 1,
            (None, ']' | '}' | ')') => depth -= 1,
            (None, ',') if depth == 0 => {
                parts.push(String::new());
                continue;
            }
            _ => {}
        }
        parts.iter_mut().last().into_iter().for_each(|part| part.push(c));
    }
    let trimmed = parts.into_iter().map(|part| part.trim().to_owned());
    if text.trim().is_empty() { Vec::new() } else { trimmed.collect() }
}

/// The choices, each with its options.
fn choices(study: &Study) -> Result<Vec<(Choice, Vec<Taken>)>, CliError> {
    let mut all: Vec<(Choice, Vec<Taken>)> = Vec::new();
    let mut problems = Vec::new();
    let mut add = |name: &str, label: &str, options: Vec<Taken>| {
        let names: Vec<String> = options.iter().map(|o| o.name.clone()).collect();
        let distinct: BTreeSet<&String> = names.iter().collect();
        if distinct.len() < names.len() {
            problems.push(format!("{name}: an option stands there twice: {}", names.join(", ")));
        }
        if all.iter().any(|(choice, _)| choice.name == name) {
            problems.push(format!("{name}: it is chosen twice"));
        }
        if !options.is_empty() {
            all.push((Choice { name: name.into(), label: label.into(), options: names }, options));
        }
    };
    let variant = |text: &String| {
        let variants = if text == "default" { Vec::new() } else { text.split('+').map(str::to_owned).collect() };
        Taken { name: text.clone(), variants, changes: Vec::new() }
    };
    let change = |text: &str, changes: Vec<String>| Taken { name: text.to_owned(), variants: Vec::new(), changes };
    add("variant", "variant", study.variant.iter().map(variant).collect());
    let split = |text: &String| change(text, vec![format!("coupling.split=\"{text}\"")]);
    add("split", "split", study.split.iter().map(split).collect());
    add("acceleration", "acceleration", study.acceleration.iter().map(|a| change(a, acceleration(a))).collect());
    let dt = |value: &toml::Value| {
        let text = plain(value);
        change(&text, vec![format!("time.step={text}")])
    };
    add("dt", "time step (s)", study.dt.iter().map(dt).collect());
    let mut wrong = Vec::new();
    for set in &study.set {
        match set.split_once('=') {
            Some((key, values)) if !list(values).is_empty() => {
                let of = |value: &String| change(value.trim_matches(['"', '\'']), vec![format!("{key}={value}")]);
                add(key.trim(), key.trim(), list(values).iter().map(of).collect());
            }
            _ => wrong.push(format!("{set}: KEY=VALUE,VALUE,… is expected, as time.step=10,100")),
        }
    }
    for own in &study.choice {
        let of = |value: &toml::Value| {
            let text = plain(value);
            change(&text, own.set.iter().map(|set| set.replace("{}", &text)).collect())
        };
        add(&own.name, own.label.as_ref().unwrap_or(&own.name), own.values.iter().map(of).collect());
    }
    problems.extend(wrong);
    report(problems)?;
    Ok(all)
}

/// A value without the quotes of a text.
fn plain(value: &toml::Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// The changes for `name`, or `name:key=value:key=value`. The first takes away what the model has.
fn acceleration(text: &str) -> Vec<String> {
    let none = "coupling.acceleration=\"none\"".to_owned();
    let (name, settings) = text.split_once(':').unwrap_or((text, ""));
    if name == "none" {
        return vec![none];
    }
    vec![none, format!("coupling.acceleration.{name}={{{}}}", settings.replace(':', ", "))]
}

/// Fails on problems.
fn report(problems: impl IntoIterator<Item = String>) -> Result<(), CliError> {
    let problems: Vec<String> = problems.into_iter().collect();
    match &problems[..] {
        [] => Ok(()),
        [one] => Err(CliError::Unfit(one.clone())),
        _ => Err(CliError::Unfit(format!("{} problems:\n  {}", problems.len(), problems.join("\n  ")))),
    }
}

fn check_study(comparison: &Comparison) -> Result<(), CliError> {
    let mut problems = Vec::new();
    for (name, option) in &comparison.reference {
        match comparison.choices.iter().find(|c| c.name == *name) {
            None => {
                let known: Vec<_> = comparison.choices.iter().map(|c| c.name.as_str()).collect();
                problems.push(format!("reference: \"{name}\" is no choice; known: {}", known.join(", ")));
            }
            Some(choice) if !choice.options.contains(option) => {
                let known = choice.options.join(", ");
                problems.push(format!("reference: {name} has no option \"{option}\"; known: {known}"));
            }
            Some(_) => {}
        }
    }
    problems.extend(comparison.figures.iter().flat_map(|figure| figure.problems(&comparison.choices)));
    report(problems)
}

/// All combinations, the last choice first. Fails with everything that is wrong with any of them.
fn plan(model: &Path, study: &Study, choices: &[(Choice, Vec<Taken>)]) -> Result<Vec<Planned>, CliError> {
    let programs = programs()?;
    let total: usize = choices.iter().map(|c| c.1.len()).product();
    let mut problems = BTreeSet::new();
    let mut list = Vec::new();
    for index in 0..total {
        let mut rest = index;
        let mut options = vec![0; choices.len()];
        for (c, (_, taken)) in choices.iter().enumerate().rev() {
            options[c] = rest % taken.len();
            rest /= taken.len();
        }
        let taken = || choices.iter().zip(&options).map(|((_, taken), &i)| &taken[i]);
        let variants: Vec<String> = taken().flat_map(|t| t.variants.clone()).collect();
        let changes: Vec<String> = taken().flat_map(|t| t.changes.clone()).collect();
        match Case::load(model, &variants, &changes) {
            Ok(mut case) => {
                adapt(&mut case, study)?;
                let toml = case.document.to_toml();
                let arrays: &[u8] = if study.reference.is_empty() { b"" } else { b"arrays" };
                let mut digest = Sha256::new().chain_update(&programs).chain_update(arrays).chain_update(&toml);
                for unit in case.document.model.units.values() {
                    digest.update(fs::read(&unit.fmu).map_err(CliError::file(&unit.fmu))?);
                }
                let digest = digest.finalize();
                let hash = digest[..8].iter().map(|byte| format!("{byte:02x}")).collect();
                list.push(Planned { options, case, toml, hash, units: 0 });
            }
            Err(CliError::Model(ModelError::Invalid(found))) => {
                problems.extend(found.0.iter().map(ToString::to_string));
            }
            Err(error) => return Err(error),
        }
    }
    report(problems)?;
    Ok(list)
}

/// What a comparison changes in every model.
fn adapt(case: &mut Case, study: &Study) -> Result<(), CliError> {
    let Model { time, output, mesh, .. } = &mut case.document.model;
    let step = time.step.map_or(time.end.0 - time.start.0, |step| step.0);
    if let Some(steps) = study.steps {
        time.end = Number(time.start.0 + steps as f64 * step);
        // They may lie beyond the end, and would cut time steps.
        output.times.clear();
    }
    if !study.cut && time.adaptive.is_none() {
        time.minimum = Some(Number(step));
    }
    let files = [mesh.file.as_mut(), mesh.corner_point.as_mut().map(|grid| &mut grid.file)];
    for file in files.into_iter().flatten() {
        // Relative to the model's folder, which the run does not know.
        let path = case.folder.join(&*file);
        *file = path.canonicalize().map_err(CliError::file(&path))?;
    }
    Ok(())
}

/// Digest of this program and of all that packs units beside it: other programs may have other results.
fn programs() -> Result<Vec<u8>, CliError> {
    let own = std::env::current_exe().map_err(CliError::file(Path::new("this program")))?;
    let mut files = vec![own.clone()];
    let beside = own.parent().into_iter().flat_map(|folder| {
        ["flow", "mechanics"].into_iter().flat_map(super::pack::files_of).map(|name| folder.join(name))
    });
    files.extend(beside.filter(|path| path.is_file()));
    let mut digest = Sha256::new();
    for path in files {
        digest.update(fs::read(&path).map_err(CliError::file(&path))?);
    }
    Ok(digest.finalize().to_vec())
}

/// Makes or opens the folder; the file that is given back locks it.
fn open(output: &Path, overwrite: bool) -> Result<File, CliError> {
    let is_ours = output.join(STUDY).is_file();
    if !is_ours && fs::read_dir(output).is_ok_and(|mut list| list.next().is_some()) {
        let reason =
            format!("{} holds something else than a comparison; --output names another folder", output.display());
        return Err(CliError::Unfit(reason));
    }
    fs::create_dir_all(output).map_err(CliError::file(output))?;
    let path = output.join("lock");
    let lock = File::create(&path).map_err(CliError::file(&path))?;
    lock.try_lock().map_err(|error| match error {
        TryLockError::WouldBlock => CliError::Unfit(format!("{} is in use by another process", output.display())),
        TryLockError::Error(error) => CliError::File { path, error },
    })?;
    let mut gone = vec![UNITS, RUNS];
    if overwrite {
        gone.push(KEPT);
    }
    for name in gone {
        let path = output.join(name);
        match fs::remove_dir_all(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(CliError::file(&path)(error)),
            _ => {}
        }
    }
    // A comparison from now on, however early it is killed.
    if !is_ours {
        write(&output.join(STUDY), b"{}\n")?;
    }
    Ok(lock)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    fs::write(path, bytes).map_err(CliError::file(path))
}

/// Links to the runs in their order.
fn number(output: &Path, planned: &[Planned]) -> Result<(), CliError> {
    let runs = output.join(RUNS);
    fs::create_dir_all(&runs).map_err(CliError::file(&runs))?;
    for (n, run) in (1..).zip(planned) {
        let link = runs.join(format!("{n:04}"));
        let target = Path::new("..").join(KEPT).join(&run.hash);
        #[cfg(unix)]
        std::os::unix::fs::symlink(target, &link).map_err(CliError::file(&link))?;
        #[cfg(not(unix))]
        write(&link, target.to_string_lossy().as_bytes())?;
    }
    Ok(())
}

/// The units that the runs need: those of models that differ in more than coupling, time steps and output.
fn share(planned: &mut [Planned], output: &Path) -> Result<Vec<Shared>, CliError> {
    let mut known = BTreeMap::<String, usize>::new();
    let mut list: Vec<Shared> = Vec::new();
    for run in planned {
        let mut document = run.case.document.clone();
        let model = &mut document.model;
        // Of the coupling, units know the sensitivities; flow probes the first with the time step.
        model.coupling = model::Coupling { sensitivity: model.coupling.sensitivity.clone(), ..Default::default() };
        let model::Time { start, end, step, .. } = model.time;
        model.time = model::Time { start, end, step, ..Default::default() };
        model.output = Default::default();
        run.units = *known.entry(document.to_toml()).or_insert_with(|| {
            let folder = output.join(UNITS).join(list.len().to_string());
            list.push(Shared { folder, state: Mutex::new((0, None)) });
            list.len() - 1
        });
        lock(&list[run.units].state).0 += 1;
    }
    Ok(list)
}

/// Held while a process starts and while files are written that HDF5 locks: a process that starts has all open files for a
/// moment, and with them their locks.
static STARTING: Mutex<()> = Mutex::new(());

/// What a panic elsewhere leaves is as good as any.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

impl Shared {
    /// Packs the units, for the first run that needs them.
    fn ready(&self, case: &Case) -> Result<(), String> {
        let pack = || -> Result<(), CliError> {
            fs::create_dir_all(&self.folder).map_err(CliError::file(&self.folder))?;
            let mesh = case.mesh()?;
            let _starting = lock(&STARTING);
            mesh_io::write_hdf5(self.folder.join(MESH), mesh.data())?;
            let fmus = fmus(&case.document, &mesh, &self.folder)?;
            write(&self.folder.join(FMUS), json!(fmus).to_string().as_bytes())
        };
        lock(&self.state).1.get_or_insert_with(|| pack().map_err(|error| error.to_string())).clone()
    }

    /// A run is done with them; the last one removes them.
    fn done(&self) {
        let mut state = lock(&self.state);
        state.0 -= 1;
        if state.0 == 0 {
            // The next comparison removes what cannot be removed now.
            let _ = fs::remove_dir_all(&self.folder);
        }
    }
}

/// Makes the runs that have no outcome yet.
fn make(
    comparison: &Comparison,
    planned: &[Planned],
    shared: &[Shared],
    output: &Path,
    jobs: usize,
    threads: usize,
    voice: Voice,
) -> Result<Vec<Entry>, CliError> {
    let program = std::env::current_exe().map_err(CliError::file(Path::new("this program")))?;
    let place = |run: &Planned| output.join(KEPT).join(&run.hash);
    // What cannot be read is made again.
    let mut results: Vec<Option<Result<Outcome, String>>> =
        planned.iter().map(|run| Outcome::read(&place(run).join(OUTCOME)).ok().map(Ok)).collect();
    let missing: Vec<usize> = (0..planned.len()).filter(|&i| results[i].is_none()).collect();
    for (run, _) in planned.iter().zip(&results).filter(|r| r.1.is_some()) {
        shared[run.units].done();
    }
    let total = planned.len();
    let kept = total - missing.len();
    let speaks = matches!(voice, Voice::Lines | Voice::Bar);
    if speaks {
        let total = counted(total, "run");
        say(&format!("{}: {total}, {kept} of them made before, {jobs} at a time", comparison.title))?;
    }
    let bar = if voice == Voice::Bar { ProgressBar::new(total as u64) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos} of {len} runs  {eta} left  {msg}") {
        bar.set_style(style);
    }
    bar.set_position(kept as u64);
    bar.enable_steady_tick(Duration::from_millis(200));

    let next = AtomicUsize::new(0);
    let (send, receive) = std::sync::mpsc::channel();
    std::thread::scope(|scope| -> Result<(), CliError> {
        for _ in 0..jobs.min(missing.len()) {
            let (send, next, missing, program) = (send.clone(), &next, &missing, &program);
            scope.spawn(move || {
                while let Some(&i) = missing.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let run = &planned[i];
                    let units = &shared[run.units];
                    let arrays = !comparison.reference.is_empty();
                    let result = (units.ready(&run.case))
                        .and_then(|()| call(program, &place(run), &units.folder, arrays, threads));
                    units.done();
                    // Nobody listens any more where the output is closed.
                    if send.send((i, result)).is_err() {
                        return;
                    }
                }
            });
        }
        drop(send);
        for (i, result) in receive {
            let entry = Entry { number: i + 1, options: planned[i].options.clone(), outcome: result };
            bar.inc(1);
            if voice == Voice::Lines {
                let name = comparison.name_of(&entry);
                say(&format!("run {} of {total}, {name}: {}", entry.number, entry.summary()))?;
            }
            results[i] = Some(entry.outcome);
        }
        Ok(())
    })?;
    bar.finish_and_clear();
    let lost = || Err("it was not made".to_owned());
    let entries = (1..).zip(planned).zip(results).map(|((number, run), outcome)| Entry {
        number,
        options: run.options.clone(),
        outcome: outcome.unwrap_or_else(lost),
    });
    Ok(entries.collect())
}

/// Makes a run in a process of its own.
fn call(program: &Path, folder: &Path, units: &Path, arrays: bool, threads: usize) -> Result<Outcome, String> {
    const THREADS: &str = "RAYON_NUM_THREADS";
    let mut command = Command::new(program);
    command.arg("compare-run").arg(folder).arg(units);
    if arrays {
        command.arg("--arrays");
    }
    if std::env::var_os(THREADS).is_none() {
        command.env(THREADS, threads.to_string());
    }
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
    let spawned = {
        let _starting = lock(&STARTING);
        command.spawn()
    };
    let mut child = spawned.map_err(|error| format!("{}: {error}", program.display()))?;
    // Held open until the run has ended.
    let stdin = child.stdin.take();
    let output = child.wait_with_output().map_err(|error| format!("{}: {error}", program.display()))?;
    drop(stdin);
    if output.status.success() {
        return Outcome::read(&folder.join(OUTCOME)).map_err(|error| error.to_string());
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let text = text.trim().strip_prefix("error: ").unwrap_or(text.trim());
    Err(if text.is_empty() { output.status.to_string() } else { text.to_owned() })
}

fn say(text: &str) -> Result<(), CliError> {
    writeln!(io::stdout(), "{text}").map_err(CliError::Output)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_split_where_no_bracket_is_open() {
        assert_eq!(list("a, b"), ["a", "b"]);
        assert_eq!(list("[1, 2],'x,y',{a = 1, b = 2}"), ["[1, 2]", "'x,y'", "{a = 1, b = 2}"]);
        assert!(list("").is_empty());
        // An empty option is there, to be refused.
        assert_eq!(list("1,"), ["1", ""]);
    }

    #[test]
    fn accelerations_replace_that_of_the_model() {
        assert_eq!(acceleration("none"), ["coupling.acceleration=\"none\""]);
        let changes = acceleration("anderson:depth=2:mixing=0.5");
        assert_eq!(changes[1], "coupling.acceleration.anderson={depth=2, mixing=0.5}");
    }

    #[test]
    fn studies_fit_their_models() {
        let models = fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../models")).unwrap();
        let folders = models.filter_map(|model| fs::read_dir(model.unwrap().path().join("studies")).ok());
        let mut count = 0;
        for file in folders.flatten().map(|file| file.unwrap().path()) {
            let study = read_study(&file).unwrap();
            let choices = choices(&study).unwrap();
            let comparison = comparison_of(&study, &choices);
            check_study(&comparison).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            let runs = plan(study.model.as_deref().unwrap(), &study, &choices);
            let runs = runs.unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            assert!(runs.len() > 1, "{}", file.display());
            count += 1;
        }
        assert!(count > 0);
    }

    #[test]
    fn units_are_shared_by_splits_but_not_by_time_steps() {
        let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/six-fractures");
        let text = |value: f64| toml::Value::String(value.to_string());
        let split = vec!["drained".to_owned(), "undrained".to_owned()];
        let study = Study { split, dt: vec![text(1.0), text(10.0)], ..Study::default() };
        let mut runs = plan(&model, &study, &choices(&study).unwrap()).unwrap();
        share(&mut runs, Path::new("")).unwrap();
        assert_eq!(runs.iter().map(|run| run.units).collect::<Vec<_>>(), [0, 1, 0, 1]);
    }

    #[test]
    fn options_that_stand_twice_are_refused() {
        let study = Study { split: vec!["drained".into(); 2], set: vec!["time.end".into()], ..Study::default() };
        let Err(error) = choices(&study) else { panic!() };
        let text = error.to_string();
        assert!(text.contains("2 problems") && text.contains("twice") && text.contains("KEY=VALUE"), "{text}");
    }
}
