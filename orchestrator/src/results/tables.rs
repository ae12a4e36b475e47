//! The small tables as CSV, appended to after each time step. Units of measure stand in the heads, in brackets; numbers
//! have all the digits that they need.

use std::fmt::Write as _;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::journal::Entry;
use super::{Manifest, ResultsError, Snapshot, files};
use crate::record::{AttemptOutcome, StepRecord};

/// Names of the tables, without `.csv`.
const NAMES: [&str; 4] = ["series", "attempts", "iterations", "timings"];

/// The tables of a run.
#[derive(Debug)]
pub(crate) struct Tables {
    files: Vec<(PathBuf, File)>,
}

impl Tables {
    /// Replaces the tables by those of some entries.
    pub(crate) fn create(
        folder: &Path,
        manifest: &Manifest,
        scalars: &Snapshot,
        rows: &[String; 4],
    ) -> Result<Self, ResultsError> {
        let heads = heads(manifest, scalars);
        let make = |((name, head), rows): ((&&str, String), &String)| -> Result<_, ResultsError> {
            let path = folder.join(name).with_extension("csv");
            files::replace(&path, (head + rows).as_bytes())?;
            let file = OpenOptions::new().append(true).open(&path).map_err(ResultsError::io(&path))?;
            Ok((path, file))
        };
        let files = NAMES.iter().zip(heads).zip(rows).map(make).collect::<Result<_, _>>()?;
        Ok(Self { files })
    }

    /// Says where the tables are after their folder was moved.
    pub(crate) fn moved_to(&mut self, folder: &Path) {
        for ((path, _), name) in self.files.iter_mut().zip(NAMES) {
            *path = folder.join(name).with_extension("csv");
        }
    }

    pub(crate) fn append(&mut self, rows: &[String; 4]) -> Result<(), ResultsError> {
        for ((path, file), rows) in self.files.iter_mut().zip(rows) {
            file.write_all(rows.as_bytes()).map_err(ResultsError::io(path))?;
        }
        Ok(())
    }
}

fn heads(manifest: &Manifest, scalars: &Snapshot) -> [String; 4] {
    let mut series = String::from("time_step,time [s]");
    for scalar in &scalars.scalars {
        series += &format!(",{}", cell(&format!("{} [{}]", scalar.name, scalar.unit)));
    }
    let mut iterations = String::from("time_step,attempt,iteration");
    for field in &manifest.fields {
        let (name, unit) = (&field.name, &field.unit);
        for head in [
            format!("{name}.residual [{unit}]"),
            format!("{name}.limit [{unit}]"),
            format!("{name}.ratio [1]"),
            format!("{name}.worst"),
        ] {
            iterations += &format!(",{}", cell(&head));
        }
    }
    let mut timings = String::from("time_step,attempt,iteration");
    for unit in &manifest.units {
        iterations += &format!(",{}", cell(&format!("{}.newton_iterations", unit.name)));
        timings += &format!(",{}", cell(&format!("{} [s]", unit.name)));
    }
    iterations += ",derivatives";
    let attempts = String::from("time_step,attempt,step [s],iterations,outcome,reason");
    [series, attempts, iterations, timings].map(|head| head + "\n")
}

/// The rows of a time step in each table.
pub(crate) fn rows(record: &StepRecord, snapshot: &Snapshot) -> [String; 4] {
    let [mut series, mut attempts, mut iterations, mut timings] = <[String; 4]>::default();
    // Writing to a string cannot fail.
    let _ = write!(series, "{},{:?}", record.number, snapshot.time);
    snapshot.scalars.iter().for_each(|scalar| series += &format!(",{:?}", scalar.value));
    series.push('\n');
    for (a, attempt) in (1..).zip(&record.attempts) {
        let key = format!("{},{a}", record.number);
        let reason = match &attempt.outcome {
            AttemptOutcome::Discarded { unit, reason } => format!("{unit}: {reason}"),
            _ => String::new(),
        };
        let (count, outcome) = (attempt.iterations.len(), outcome(&attempt.outcome));
        let _ = writeln!(attempts, "{key},{:?},{count},{outcome},{}", attempt.step, cell(&reason));
        for (i, iteration) in (1..).zip(&attempt.iterations) {
            let _ = write!(iterations, "{key},{i}");
            for residual in &iteration.residuals {
                let worst = residual.worst.map_or(String::new(), |w| w.to_string());
                let _ = write!(iterations, ",{:?},{:?},{:?},{worst}", residual.norm, residual.limit, residual.ratio());
            }
            for newton in &iteration.newton {
                iterations += &format!(",{}", newton.map_or(String::new(), |n| n.to_string()));
            }
            let _ = writeln!(iterations, ",{}", iteration.derivatives);
            let _ = write!(timings, "{key},{i}");
            iteration.seconds.iter().for_each(|seconds| timings += &format!(",{seconds:?}"));
            timings.push('\n');
        }
    }
    [series, attempts, iterations, timings]
}

/// The rows of entries, one after the other.
pub(crate) fn add(all: &mut [String; 4], entry: &Entry) {
    for (all, rows) in all.iter_mut().zip(rows(&entry.record, &entry.snapshot)) {
        *all += &rows;
    }
}

/// An outcome in a word.
pub(crate) fn outcome(outcome: &AttemptOutcome) -> &'static str {
    match outcome {
        AttemptOutcome::Converged => "converged",
        AttemptOutcome::NotConverged => "not_converged",
        AttemptOutcome::Diverged => "diverged",
        AttemptOutcome::NotFinite => "not_finite",
        AttemptOutcome::Discarded { .. } => "discarded",
        AttemptOutcome::RoundOff => "round_off",
    }
}

/// Text as a cell of a table.
pub(crate) fn cell(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}
