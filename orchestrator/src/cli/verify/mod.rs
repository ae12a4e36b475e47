//! Runs a model, in the variants that something is claimed of, and says of each claim whether it holds.

mod judge;
mod reference;

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use orchestrator::CouplingError;
use orchestrator::results::Snapshot;

use super::case::Case;
use super::error::CliError;
use super::pack;
use super::progress::newton;
use super::run::{fmus, start};
use judge::{Judge, Now, Verdict, order};
use reference::{DEFAULT, Reference};

/// `orchestrator verify`. Without `variants`, all those that something is claimed of.
pub(crate) fn verify(path: &Path, variants: &[String], changes: &[String]) -> Result<ExitCode, CliError> {
    let own: Vec<String> = variants.iter().filter(|v| *v != DEFAULT).cloned().collect();
    let folder = Case::load(path, &own, changes)?.folder;
    let mut out = io::stdout();
    let mut say = |line: &str| writeln!(out, "{line}").map_err(CliError::Output);
    let Some(reference) = Reference::load(&folder)? else {
        say("nothing was verified: this model has no reference.toml that says what must hold")?;
        return Ok(ExitCode::FAILURE);
    };
    if !changes.is_empty() {
        say("the model is changed; its claims are about the model as it is")?;
    }
    let chosen = if variants.is_empty() { reference.variants() } else { vec![variants.join("+")] };
    let [mut held, mut failed] = [0, 0];
    let mut judged = |holds: bool, text: &str| {
        *(if holds { &mut held } else { &mut failed }) += 1;
        writeln!(io::stdout(), "{}  {text}", if holds { "pass" } else { "FAIL" }).map_err(CliError::Output)
    };
    // Size and value of each order's claim, by its place in the reference and by variant.
    let mut levels: Vec<BTreeMap<&str, [f64; 2]>> = vec![BTreeMap::new(); reference.claims.len()];
    for variant in &chosen {
        let names: Vec<String> = variant.split('+').filter(|v| *v != DEFAULT).map(str::to_owned).collect();
        let case = Case::load(path, &names, changes)?;
        say(&format!("{}, {variant}", case.name))?;
        if let Some(failure) = run(&case, variant, &reference, &mut |verdict| {
            let number = reference.claims.iter().position(|claim| std::ptr::eq(claim, verdict.claim));
            if let (Some(number), Some(level)) = (number, verdict.level) {
                levels[number].insert(variant, level);
            }
            verdict.line().map_or(Ok(()), |(holds, text)| judged(holds, &text))
        })? {
            judged(false, &format!("it runs to its end: {failure}"))?;
        }
    }
    for (claim, levels) in reference.claims.iter().zip(&levels).filter(|(claim, _)| claim.order.is_some()) {
        let list: Vec<[f64; 2]> = claim.variants.iter().filter_map(|v| levels.get(v.as_str()).copied()).collect();
        if variants.is_empty() {
            let (holds, text) = order(claim, &list);
            judged(holds, &text)?;
        } else {
            writeln!(io::stdout(), "left out  {}: it takes {}", claim.says, claim.variants.join(", "))
                .map_err(CliError::Output)?;
        }
    }
    for line in &reference.elsewhere {
        writeln!(io::stdout(), "elsewhere  {line}").map_err(CliError::Output)?;
    }
    if held + failed == 0 {
        failed = 1;
        writeln!(io::stdout(), "nothing is claimed of {}", chosen.join(", ")).map_err(CliError::Output)?;
    } else {
        writeln!(io::stdout(), "{held} of {} claims hold", held + failed).map_err(CliError::Output)?;
    }
    Ok(if failed > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Runs a variant and passes on what was found of each claim; gives why the run stopped early, if it did.
fn run(
    case: &Case,
    variant: &str,
    reference: &Reference,
    found: &mut dyn FnMut(&Verdict) -> Result<(), CliError>,
) -> Result<Option<String>, CliError> {
    let mesh = case.mesh()?;
    let temporary = pack::temporary("fmus-")?;
    let paths = fmus(&case.document, &mesh, temporary.path())?;
    let (mut run, mut series) = start(&paths, &case.document, &mesh)?.run()?;
    let mut snapshot = series.of(&mut run)?;
    let fields: Vec<String> = series.fields().map(str::to_owned).collect();
    let (scalars, fields): (Vec<&str>, Vec<&str>) =
        (snapshot.scalars.iter().map(|s| s.name.as_str()).collect(), fields.iter().map(String::as_str).collect());
    let mut judge = Judge::new(reference, variant, &case.document.model, &mesh, &scalars, &fields)?;
    let numbers = |snapshot: &Snapshot| snapshot.scalars.iter().map(|s| s.value).collect::<Vec<_>>();
    let values = numbers(&snapshot);
    let nothing = Now {
        time: snapshot.time,
        step: 0.0,
        number: 0,
        iterations: 0,
        newton: 0,
        last: false,
        scalars: &values,
        field: &mut |_| Ok(Vec::new()),
    };
    judge.see(nothing)?;
    let mut failure = None;
    while !run.is_finished() {
        let record = match run.advance() {
            Ok(record) => record,
            Err(CouplingError::Failed(report)) => {
                failure = Some(report.to_string());
                break;
            }
            Err(error) => return Err(error.into()),
        };
        snapshot = series.of(&mut run)?;
        let values = numbers(&snapshot);
        judge.see(Now {
            time: record.time,
            step: record.attempts.last().map_or(0.0, |a| a.step),
            number: record.number,
            iterations: record.iterations().len(),
            newton: newton(&record),
            last: run.is_finished(),
            scalars: &values,
            field: &mut |name| Ok(series.field(name, run.units())?),
        })?;
    }
    judge.verdicts().iter().try_for_each(found)?;
    Ok(failure)
}
