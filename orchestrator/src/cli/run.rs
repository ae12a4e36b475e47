//! Runs a model, and goes on with a run that was stopped.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use coupling::{Role, Sizes};
use mesh::Mesh;
use model::Document;
use orchestrator::fmi::{self, Fmu, FmuUnit};
use orchestrator::results::{Folder, Manifest, ResultsError, Snapshot, Summary, UnitVersion};
use orchestrator::ssp;
use orchestrator::{
    AttemptOutcome, Checkpoint, Cost, CouplingError, Interface, Run, Settings, StepRecord, Unit, counted,
};
use serde_json::json;

use super::case::{Case, as_strs};
use super::error::CliError;
use super::memory::Peaks;
use super::pack;
use super::places::places;
use super::progress::{Progress, Voice, newton};
use super::series::Series;

/// Units by name, in the order of their numbers.
pub(crate) type Fmus = Vec<(String, PathBuf)>;
/// Where the results keep the units that they came from.
const UNITS: &str = "units";
/// Checkpoints take about this part of the time: a run that is killed loses what was done in 20 times that of one.
const CHECKPOINTS: f64 = 0.05;

/// Wall seconds of the parts of a run, by name.
type Seconds = Vec<(String, f64)>;

/// Units at the start, and what is to be read from them.
pub(crate) struct Started {
    units: Vec<Box<dyn Unit>>,
    pub(crate) interface: Interface,
    pub(crate) series: Series,
    settings: Settings,
    versions: Vec<UnitVersion>,
    /// How the run is adapted to its units.
    pub(crate) notes: Vec<String>,
}

/// The FMUs of a model: those that it names, and its own, which are packed into `folder`.
pub(crate) fn fmus(document: &Document, mesh: &Mesh, folder: &Path) -> Result<Fmus, CliError> {
    let model = &document.model;
    let path = |name: &str| folder.join(name).with_extension("fmu");
    let is_own = |name: &&str| !model.units.contains_key(*name);
    let own: Vec<(&str, PathBuf)> =
        model.unit_names().into_iter().filter(is_own).map(|name| (name, path(name))).collect();
    pack::pack(document, mesh, &own)?;
    Ok(placed(document, &own))
}

/// The FMUs of a model with its own ones where they are.
pub(crate) fn placed(document: &Document, own: &[(&str, PathBuf)]) -> Fmus {
    let model = &document.model;
    let fmu = |name: &str| match model.units.get(name) {
        Some(unit) => unit.fmu.clone(),
        None => own.iter().find(|(own, _)| *own == name).map_or_else(PathBuf::new, |(_, path)| path.clone()),
    };
    model.unit_names().into_iter().map(|name| (name.to_owned(), fmu(name))).collect()
}

/// FMUs that fit the model.
pub(crate) struct Opened {
    /// In the order of their numbers.
    fmus: Vec<(String, PathBuf, Fmu)>,
    interface: Interface,
}

/// Loads units and compares their descriptions with the model.
pub(crate) fn open(paths: &Fmus, document: &Document, mesh: &Mesh) -> Result<Opened, CliError> {
    let model = &document.model;
    let (mut fmus, mut problems, mut coupled) = (Vec::new(), Vec::new(), 0);
    for (name, path) in paths {
        let mut fmu = Fmu::open(path)?;
        if let Some(role) = [Role::Flow, Role::Mechanics].into_iter().find(|role| role.name() == name) {
            let fit = fmu.fit(role, sizes(mesh));
            problems.extend(fit.problems.iter().map(|problem| format!("\n  {name}: {problem}")));
            coupled += 1;
        }
        if !fmu.description().takes_any_step && model.time.adaptive.is_some() {
            problems.push(format!("\n  {name}: it takes time steps of one size only, and those of the model adapt"));
        }
        for (variable, value) in model.units.get(name).iter().flat_map(|unit| &unit.parameters) {
            let problem = fmu.description().start_problem(variable, value);
            problems.extend(problem.map(|problem| format!("\n  {name}: the parameter {variable} {problem}")));
        }
        fmus.push((name.clone(), path.clone(), fmu));
    }
    let mut interface = if coupled == 2 { Interface::poroelastic() } else { Interface::single() };
    let descriptions: Vec<_> = fmus.iter().map(|(name, _, fmu)| (name.as_str(), fmu.description())).collect();
    match fmi::connections(&model.connections, &interface, &descriptions) {
        Ok(connections) => interface.connections = connections,
        Err(error) => problems.extend(error.problems.iter().map(|problem| format!("\n  {problem}"))),
    }
    if problems.is_empty() {
        Ok(Opened { fmus, interface })
    } else {
        Err(CliError::Unfit(format!("the units do not fit the model:{}", problems.concat())))
    }
}

impl Opened {
    /// What each unit says of itself.
    pub(crate) fn about(&self) -> impl Iterator<Item = String> {
        self.fmus.iter().map(|(name, _, fmu)| format!("{name}: {}", fmu.description().about))
    }

    /// Writes the units and their wiring as an SSP archive.
    pub(crate) fn write_ssp(&self, name: &str, document: &Document, path: &Path) -> Result<(), CliError> {
        let model = &document.model;
        // In their own units of measure, not in those of their roles.
        let component = |(name, fmu, _): &(String, PathBuf, Fmu)| -> Result<_, CliError> {
            let description = Fmu::open(fmu)?.description().clone();
            let parameters = fmi::parameters(name, &description, model);
            Ok(ssp::Component { name: name.clone(), fmu: fmu.clone(), description, parameters })
        };
        let components = self.fmus.iter().map(component).collect::<Result<Vec<_>, _>>()?;
        let has = |unit: usize, variable: &str| components[unit].description.variables.contains_key(variable);
        let interface = self.interface.clone().fitted_by(&has, &|unit| components[unit].name.clone())?;
        let (settings, _) = Settings::of(model).fitted(&interface);
        let span = [model.time.start.0, model.time.end.0];
        let title = &model.title;
        let system = ssp::System { name, title, components, interface: &interface, scheme: settings.scheme, span };
        system.write(path).map_err(CliError::file(path))
    }
}

/// Loads and initialises units.
pub(crate) fn start(paths: &Fmus, document: &Document, mesh: &Mesh) -> Result<Started, CliError> {
    let model = &document.model;
    let Opened { fmus, interface } = open(paths, document, mesh)?;
    let mut notes = Vec::new();
    let descriptions: Vec<_> = fmus.iter().map(|(name, _, fmu)| (name.as_str(), fmu.description())).collect();
    let mut units = fmus.iter().map(|(name, _, fmu)| fmu.instantiate(name)).collect::<Result<Vec<_>, _>>()?;
    fmi::start(&mut units, &interface, model)?;
    let iterates = interface.coupled > 1 && !model.coupling.loose;
    for (number, unit) in units.iter_mut().enumerate() {
        check_mesh(unit, mesh)?;
        let name = unit.name();
        if iterates && number < interface.coupled && !unit.can_roll_back() {
            notes.push(format!(
                "{name} cannot go back: its time steps are done again from the start in every coupling iteration, which \
                 takes time with the square of their number; --set coupling.loose=true --set \
                 coupling.acceleration=none does without"
            ));
        }
        if !iterates && number < interface.coupled && !unit.can_serialise() {
            notes.push(format!("the state of {name} cannot be kept: resuming this run starts it anew"));
        }
    }
    let coupled = interface.coupled;
    let adapt = |(number, unit)| fmi::adapted(unit, !iterates && number < coupled);
    let units: Vec<_> = units.into_iter().enumerate().map(adapt).collect();
    let interface = interface.with_criteria(&model.coupling.criteria).fitted(&units)?;
    let (settings, note) = Settings::of(model).fitted(&interface);
    notes.extend(note);
    let series = Series::new(&descriptions, &interface, mesh, settings.clone());
    let version = |(name, description): &(&str, &fmi::Description)| UnitVersion {
        name: (*name).to_owned(),
        version: format!("{}, token {}", description.model_name, description.token),
    };
    let versions = descriptions.iter().map(version).collect();
    Ok(Started { units, interface, settings, series, versions, notes })
}

/// Sizes of arrays on a mesh.
pub(crate) fn sizes(mesh: &Mesh) -> Sizes {
    Sizes { cells: mesh.cell_count(), fracture_faces: mesh.network().face_count(), dim: mesh.dim() }
}

/// Refuses a unit that says it is on another mesh than the model.
fn check_mesh(unit: &mut FmuUnit, mesh: &Mesh) -> Result<(), CliError> {
    let expected = mesh.fingerprint();
    match fmi::fingerprint(unit)? {
        Some(found) if found != expected => {
            let name = unit.name();
            Err(CliError::Unfit(format!("{name} is on another mesh than the model: {found} and {expected}")))
        }
        _ => Ok(()),
    }
}

impl Started {
    /// A unit, to be tried.
    pub(crate) fn unit(&mut self, number: usize) -> &mut dyn Unit {
        self.units[number].as_mut()
    }

    /// The run from its start.
    pub(crate) fn run(self) -> Result<(Run, Series), CliError> {
        Ok((Run::new(self.units, self.interface, self.settings)?, self.series))
    }
}

/// `orchestrator run`.
pub(crate) fn run(case: &Case, output: &Path, overwrite: bool, voice: Voice) -> Result<(), CliError> {
    // What would be found out at the end of the packing anyway.
    if !overwrite && std::fs::read_dir(output).is_ok_and(|mut list| list.next().is_some()) {
        return Err(ResultsError::Exists(output.to_owned()).into());
    }
    let (mut parts, mut peaks) = (Seconds::new(), Peaks::default());
    let mesh = timed(&mut parts, "mesh", || case.mesh())?;
    peaks.take("mesh");
    say(voice, &case.describe(&mesh))?;
    let temporary = pack::temporary("fmus-")?;
    let paths = timed(&mut parts, "packing", || fmus(&case.document, &mesh, temporary.path()))?;
    peaks.take("packing");
    let mut started = timed(&mut parts, "start of the units", || start(&paths, &case.document, &mesh))?;
    peaks.take("start of the units");
    let (variants, changes) = (as_strs(&case.variants), as_strs(&case.changes));
    let versions = started.versions.clone();
    let mut manifest =
        Manifest::new(&case.name, &case.document, &variants, &changes, &mesh, &started.interface, versions);
    manifest.notes.clone_from(&started.notes);
    started.notes.iter().try_for_each(|note| say(voice, &format!("note: {note}")))?;
    let snapshot = started.series.snapshot(case.document.model.time.start.0, &mut started.units)?;
    let mut folder = Folder::create(output, &manifest, mesh, &snapshot, overwrite)?;
    keep(&paths, folder.path())?;
    drop(temporary);
    let (run, series) = started.run()?;
    drive(run, series, &mut folder, voice, parts, peaks)
}

/// `orchestrator resume`.
pub(crate) fn resume(path: &Path, voice: Voice) -> Result<(), CliError> {
    let checkpoint = Folder::read_checkpoint(path)?.map(|bytes| Checkpoint::from_bytes(&bytes)).transpose()?;
    let (mut parts, mut peaks) = (Seconds::new(), Peaks::default());
    let number = checkpoint.as_ref().map_or(0, Checkpoint::number);
    let mut folder = timed(&mut parts, "reading", || Folder::reopen(path, Some(number)).map_err(CliError::from))?;
    let document = Document::read("manifest.json", &folder.manifest().model.toml, &[], &[])?;
    say(voice, &format!("{}: on from time step {number}", document.model.title))?;
    let temporary = pack::temporary("fmus-")?;
    let paths = timed(&mut parts, "packing", || kept(&folder, &document, temporary.path()))?;
    let mut started = timed(&mut parts, "start of the units", || start(&paths, &document, folder.mesh()))?;
    started.series.goes_on(folder.energy());
    peaks.take("start of the units");
    let (run, series) = match &checkpoint {
        Some(checkpoint) => {
            let Started { units, interface, settings, series, .. } = started;
            (Run::resume(units, interface, settings, checkpoint)?, series)
        }
        None => started.run()?,
    };
    drive(run, series, &mut folder, voice, parts, peaks)
}

/// Copies the units into the results, so that they can be gone on with even where other ones lie beside the program.
fn keep(paths: &Fmus, folder: &Path) -> Result<(), CliError> {
    let units = folder.join(UNITS);
    match std::fs::remove_dir_all(&units) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(CliError::file(&units)(error)),
        _ => {}
    }
    // The folder appears when all are in it.
    let part = folder.join(format!("{UNITS}.part"));
    std::fs::create_dir_all(&part).map_err(CliError::file(&part))?;
    for (name, path) in paths {
        let copy = part.join(format!("{name}.fmu"));
        std::fs::copy(path, &copy).map_err(CliError::file(&copy))?;
    }
    std::fs::rename(&part, &units).map_err(CliError::file(&units))
}

/// The units in the results. Where a run was killed before they were there, they are packed again.
fn kept(folder: &Folder, document: &Document, temporary: &Path) -> Result<Fmus, CliError> {
    let units = folder.path().join(UNITS);
    let manifest = folder.manifest();
    if units.is_dir() {
        let path = |name: &str| units.join(format!("{name}.fmu"));
        return Ok(manifest.units.iter().map(|unit| (unit.name.clone(), path(&unit.name))).collect());
    }
    if !document.model.units.is_empty() {
        let reason = format!("{} has lost its units, which are not those of the model", folder.path().display());
        return Err(CliError::Unfit(reason));
    }
    fmus(document, folder.mesh(), temporary)
}

fn timed<T>(parts: &mut Seconds, name: &str, act: impl FnOnce() -> Result<T, CliError>) -> Result<T, CliError> {
    let clock = Instant::now();
    let result = act();
    parts.push((name.to_owned(), clock.elapsed().as_secs_f64()));
    result
}

fn say(voice: Voice, text: &str) -> Result<(), CliError> {
    match voice {
        Voice::Bar | Voice::Lines => writeln!(io::stdout(), "{text}").map_err(CliError::Output),
        Voice::Json | Voice::Quiet => Ok(()),
    }
}

/// Takes a run to its end.
fn drive(
    mut run: Run,
    mut series: Series,
    folder: &mut Folder,
    voice: Voice,
    mut parts: Seconds,
    mut peaks: Peaks,
) -> Result<(), CliError> {
    let model = &folder.manifest().model.toml;
    let end = Document::read("manifest.json", model, &[], &[])?.model.time.end.0;
    let mut totals = Totals { first: folder.last(), ..Totals::default() };
    let names: Vec<String> = folder.manifest().units.iter().map(|unit| unit.name.clone()).collect();
    let mut progress = Progress::new(voice, run.time(), end, folder.last(), names.clone());
    let clock = Instant::now();
    let (mut checkpointed, mut between) = (clock, Duration::ZERO);
    let (before, mut checkpoints) = (folder.seconds(), 0.0);
    let mut failure = None;
    while !run.is_finished() {
        match run.advance_watched(&mut |end, iteration, record| progress.iteration(end, iteration, record)) {
            Ok(record) => {
                let snapshot: Snapshot = series.of(&mut run)?;
                folder.append(&record, &snapshot)?;
                let is_due = checkpointed.elapsed() >= between || run.is_finished();
                if is_due && run.has_checkpoints() {
                    let clock = Instant::now();
                    folder.checkpoint(&run.checkpoint()?.to_bytes()?)?;
                    checkpointed = Instant::now();
                    between = (checkpointed - clock).div_f64(CHECKPOINTS);
                    checkpoints += (checkpointed - clock).as_secs_f64();
                }
                for unit in run.units() {
                    let messages = unit.take_messages();
                    messages.into_iter().for_each(|message| progress.message(unit.name(), message));
                }
                totals.add(&record);
                progress.step(&record)?;
            }
            Err(CouplingError::Failed(report)) => {
                failure = Some(report);
                break;
            }
            Err(error) => {
                progress.finish();
                let left = format!("\nwhat was done is in {}; `orchestrator resume` goes on", folder.path().display());
                return Err(CliError::Coupling { error, places: String::new(), left });
            }
        }
    }
    progress.finish();
    peaks.take("time steps");
    let units: Vec<Cost> = run.units().iter_mut().map(|unit| Cost::of(unit.as_mut())).collect();
    let in_units: Vec<f64> = units.iter().map(|cost| cost.calls.seconds() - cost.calls.start.seconds).collect();
    let inside: f64 = in_units.iter().sum();
    let results = folder.seconds() - before;
    let other = (clock.elapsed().as_secs_f64() - inside - results).max(0.0);
    parts.push(("coupling".into(), other));
    let summary = Summary { failure: failure.as_deref().cloned(), seconds: parts.clone(), units };
    let page = folder.finish(&summary)?;
    peaks.take("page and plots");
    if let Some(report) = failure {
        let places = places(&report, folder.mesh());
        let remedy = run.remedy().map_or_else(String::new, |remedy| format!("\n{remedy}"));
        let left = format!("{remedy}\nresults up to t = {} s are in {}", report.time, folder.path().display());
        return Err(CliError::Coupling { error: CouplingError::Failed(report), places, left });
    }
    parts.extend(names.into_iter().zip(in_units));
    parts.extend([("results".into(), folder.seconds()), ("of which checkpoints".into(), checkpoints)]);
    match voice {
        Voice::Quiet => Ok(()),
        Voice::Json => {
            let seconds: serde_json::Map<_, _> = parts.into_iter().map(|(name, s)| (name, json!(s))).collect();
            let line = json!({ "summary": {
                "time_steps": totals.steps,
                "coupling_iterations": totals.iterations,
                "largest_coupling_iterations": totals.largest,
                "derivatives": totals.derivatives,
                "newton_iterations": totals.newton,
                "time_steps_at_round_off": totals.at_round_off,
                "seconds": seconds,
                "units": Cost::by_unit(&summary.units),
                "peak_memory": peaks.largest(),
                "peak_memory_of_parts": peaks.of_parts(),
                "results": folder.path().display().to_string(),
            }});
            writeln!(io::stdout(), "{line}").map_err(CliError::Output)
        }
        Voice::Bar | Voice::Lines => say(voice, &totals.text(&parts, &summary.units, &peaks, folder.path(), &page)),
    }
}

/// What the time steps of this process took.
#[derive(Default)]
struct Totals {
    /// Time steps done before.
    first: usize,
    steps: usize,
    attempts: usize,
    iterations: usize,
    largest: usize,
    newton: u64,
    derivatives: usize,
    /// Time steps in which tolerances lay below round-off.
    at_round_off: usize,
}

impl Totals {
    fn add(&mut self, record: &StepRecord) {
        let iterations = record.iterations().len();
        self.steps += 1;
        self.attempts += record.attempts.len();
        self.iterations += iterations;
        self.largest = self.largest.max(iterations);
        self.newton += newton(record);
        self.at_round_off += usize::from(record.attempts.iter().any(|a| a.outcome == AttemptOutcome::RoundOff));
        self.derivatives += record.iterations().iter().map(|iteration| iteration.derivatives).sum::<usize>();
    }

    fn text(&self, parts: &Seconds, units: &[Cost], peaks: &Peaks, folder: &Path, page: &Path) -> String {
        let from = if self.first > 0 { format!(" after the first {}", self.first) } else { String::new() };
        let mean = self.iterations as f64 / self.steps.max(1) as f64;
        let mut text = format!(
            "{}{from} ({}), coupling iterations {mean:.1} on average, {} at most, {}, {} Newton iterations",
            counted(self.steps, "time step"),
            counted(self.attempts, "attempt"),
            self.largest,
            counted(self.derivatives, "directional derivative"),
            self.newton
        );
        if self.at_round_off > 0 {
            let n = counted(self.at_round_off, "time step");
            text += &format!("; {n} as good as it gets, not to the tolerance");
        }
        text += "\nseconds:";
        for (i, (name, seconds)) in parts.iter().enumerate() {
            text += &format!("{} {name} {seconds:.2}", if i == 0 { "" } else { "," });
        }
        for cost in units {
            text += &format!("\n{}:", cost.unit);
            let names = ["a time step", "a derivative", "a triangular solve"];
            let each = names.into_iter().zip(cost.milliseconds()).filter_map(|(name, ms)| Some((name, ms?)));
            let each: Vec<String> = each.map(|(name, ms)| format!("{name} {ms:.1} ms")).collect();
            let parts = cost.parts().into_iter().filter(|part| part.1 != 0.0);
            let parts: Vec<String> = parts.map(|(name, s)| format!("{name} {s:.2}")).collect();
            text += &format!(" {}; seconds: {}", each.join(", "), parts.join(", "));
        }
        if let Some(bytes) = peaks.largest() {
            text += &format!("\npeak memory: {:.0} MB", bytes as f64 / 1e6);
        }
        text += &format!("\nresults: {} (see {})", folder.display(), page.display());
        text
    }
}
