//! Tries an FMU in a role: what it offers and lacks, whether it goes back, and a coupled time step.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use coupling::Role;
use orchestrator::fmi::{Description, Fmu, Version};
use orchestrator::{CouplingError, FLOW, MECHANICS, StepOutcome, Unit, UnitError};

use super::case::Case;
use super::error::CliError;
use super::pack;
use super::run::{fmus, sizes, start};

/// `orchestrator check-unit`.
pub(crate) fn check_unit(mut case: Case, path: PathBuf, role: Option<Role>) -> Result<ExitCode, CliError> {
    let mut out = io::stdout();
    let mut say = |line: &str| writeln!(out, "{line}").map_err(CliError::Output);
    let mesh = case.mesh()?;
    let fit = |role: Role| Fmu::open(&path).map(|mut fmu| fmu.fit(role, sizes(&mesh)));
    let role = match role {
        Some(role) => role,
        None => {
            let [flow, mechanics] = [fit(Role::Flow)?, fit(Role::Mechanics)?];
            if flow.problems.len() <= mechanics.problems.len() { Role::Flow } else { Role::Mechanics }
        }
    };
    let fmu = Fmu::open(&path)?;
    say(&describe(&path, fmu.description()))?;
    say(&format!("as the {} of \"{}\":", role.name(), case.document.model.title))?;
    let fit = fit(role)?;
    fit.offered.iter().try_for_each(|name| say(&format!("  has    {name}")))?;
    fit.lacking.iter().try_for_each(|name| say(&format!("  lacks  {name}, which is optional")))?;
    fit.problems.iter().try_for_each(|problem| say(&format!("  WRONG  {problem}")))?;
    if !fit.problems.is_empty() {
        return Ok(ExitCode::FAILURE);
    }
    case.put(role.name(), path);
    let temporary = pack::temporary("fmus-")?;
    let paths = fmus(&case.document, &mesh, temporary.path())?;
    let mut started = start(&paths, &case.document, &mesh)?;
    started.notes.iter().try_for_each(|note| say(&format!("  note   {note}")))?;
    let number = if started.interface.coupled == 1 || role == Role::Flow { FLOW } else { MECHANICS };
    let time = &case.document.model.time;
    let step = time.step.map_or(time.end.0 - time.start.0, |step| step.0);
    let trial = repeat(started.unit(number), time.start.0, step, &fit.offered);
    let trial = trial.map_err(|error| CouplingError::Unit { unit: role.name().into(), error })?;
    say(&format!("  {trial}"))?;
    let (mut run, _) = started.run()?;
    let record = run.advance()?;
    let last = record.attempts.last();
    let step = last.map_or(0.0, |a| a.step);
    let failed = record.attempts.iter().filter(|a| !a.outcome.is_accepted()).count();
    say(&format!(
        "  a coupled time step of {step} s: {} iterations, {failed} failed attempts before it",
        record.iterations().len()
    ))?;
    Ok(if trial.starts_with("WRONG") { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn describe(path: &Path, description: &Description) -> String {
    let version = if description.version == Version::Two { "2.0" } else { "3.0" };
    let abilities = [
        (description.has_state, "rollback"),
        (description.serialises_state, "serialisation"),
        (description.takes_any_step, "time steps of any size"),
        (description.has_derivatives, "directional derivatives"),
    ];
    let list = |wanted: bool| {
        let names: Vec<_> = abilities.iter().filter(|(able, _)| *able == wanted).map(|(_, name)| *name).collect();
        if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
    };
    format!(
        "{}: \"{}\", FMI {version}\n  can    {}\n  cannot {}",
        path.display(),
        description.model_name,
        list(true),
        list(false)
    )
}

/// Does a time step twice from the same state.
fn repeat(unit: &mut dyn Unit, time: f64, step: f64, variables: &[String]) -> Result<String, UnitError> {
    if !unit.can_roll_back() {
        return Ok("it does not go back, and is not asked to".into());
    }
    unit.save()?;
    let once = |unit: &mut dyn Unit| -> Result<_, UnitError> {
        if let StepOutcome::Discarded { reason } = unit.step(time, step)? {
            return Ok(Err(reason));
        }
        let mut bits = Vec::new();
        for variable in variables {
            let mut values = Vec::new();
            unit.get(variable, &mut values)?;
            bits.push((variable.clone(), values.into_iter().map(f64::to_bits).collect::<Vec<_>>()));
        }
        Ok(Ok(bits))
    };
    let first = once(unit)?;
    unit.restore()?;
    let second = once(unit)?;
    unit.restore()?;
    Ok(match (first, second) {
        (Err(reason), Err(_)) => format!("a time step of {step} s from its start is discarded: {reason}"),
        (Ok(first), Ok(second)) => match first.iter().zip(&second).find(|(a, b)| a != b) {
            None => format!("a time step of {step} s, taken back and done again, gives the same bits"),
            Some(((name, _), _)) => format!("WRONG  a time step of {step} s, done again, gives another {name}"),
        },
        _ => format!("WRONG  a time step of {step} s is discarded once, and done once, from the same state"),
    })
}
