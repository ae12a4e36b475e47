//! The tables of a comparison.
//!
//! `comparison.h5`:
//!
//! | entry | type | shape | meaning |
//! |---|---|---|---|
//! | attribute `version` | u32 | scalar | version of this layout, 1 |
//! | attribute `comparison` | text | scalar | title, question, command and choices, as JSON |
//! | `runs/COLUMN` | text or f64 | runs | a column of `runs.csv`; NaN where there is none |
//! | `iterations/run`, `…/time_step`, `…/attempt`, `…/iteration` | i64 | iterations | keys |
//! | `iterations/FIELD/residual`, `…/limit` | f64 | iterations | norm, and what it must not exceed (unit of the field) |
//! | `iterations/UNIT/seconds` | f64 | iterations | wall seconds in the unit |

use std::fmt::Write as _;
use std::path::Path;

use hdf5_metno::File;
use hdf5_metno::types::VarLenUnicode;
use serde_json::json;

use super::{Choice, Comparison, Measures, Row};
use crate::record::IterationRecord;
use crate::results::hdf5::{floats, integers, put, text as attribute};
use crate::results::tables::{cell, outcome};
use crate::results::{ResultsError, chart, files};

const VERSION: u32 = 1;

/// A number of what was measured.
type Measure = fn(&Measures) -> f64;

/// A cell.
#[derive(Clone, Debug, PartialEq)]
enum Cell {
    Text(String),
    Number(Option<f64>),
}

impl Cell {
    fn number(value: impl Into<Option<f64>>) -> Self {
        Self::Number(value.into())
    }

    fn csv(&self) -> String {
        match self {
            Self::Text(text) => cell(text),
            Self::Number(value) => value.map_or_else(String::new, |v| v.to_string()),
        }
    }

    fn json(&self) -> serde_json::Value {
        match self {
            Self::Text(text) => json!(text),
            Self::Number(Some(v)) if v.fract() == 0.0 && v.abs() < 1e15 => json!(*v as i64),
            Self::Number(value) => json!(value),
        }
    }
}

/// Names and unit of measure of the columns of `runs.csv`, and the cells of each run. What does not vary is in
/// `comparison.json`.
fn columns(comparison: &Comparison, rows: &[Row<'_>]) -> Vec<(String, Vec<Cell>)> {
    let mut list: Vec<(String, Vec<Cell>)> = Vec::new();
    let mut add = |name: String, of: &dyn Fn(&Row<'_>) -> Cell| list.push((name, rows.iter().map(of).collect()));
    add("run".into(), &|row| Cell::number(row.entry.number as f64));
    for (c, choice) in comparison.choices.iter().enumerate().filter(|c| c.1.varies()) {
        let is_number = choice.numbers().is_some();
        add(head(choice), &|row| {
            let option = &choice.options[row.entry.options[c]];
            if is_number { Cell::number(option.parse().ok()) } else { Cell::Text(option.clone()) }
        });
    }
    add("outcome".into(), &|row| Cell::Text(row.state().into()));
    let measured: [(&str, Measure); 8] = [
        ("reached [s]", |m| m.reached),
        ("time_steps", |m| m.time_steps as f64),
        ("failed_attempts", |m| m.failed_attempts as f64),
        ("coupling_iterations", |m| m.iterations as f64),
        ("mean_iterations", |m| m.mean),
        ("largest_iterations", |m| m.largest as f64),
        ("derivatives", |m| m.derivatives as f64),
        ("total [s]", |m| m.total),
    ];
    for (name, of) in measured {
        add(name.into(), &|row| Cell::number(row.measures.as_ref().map(of)));
    }
    let first = rows.iter().find_map(|row| row.entry.outcome.as_ref().ok());
    for (u, unit) in first.iter().flat_map(|o| &o.units).enumerate() {
        add(format!("{unit} [s]"), &|row| Cell::number(row.measures.as_ref().map(|m| m.seconds[u])));
        add(format!("{unit}.newton_iterations"), &|row| {
            Cell::number(row.measures.as_ref().and_then(|m| m.newton[u]).map(|n| n as f64))
        });
    }
    // The fields of all runs are the same: they are of one model.
    for (f, field) in first.iter().flat_map(|o| &o.fields).enumerate() {
        add(format!("{}.contraction", field.name), &|row| {
            Cell::number(row.measures.as_ref().and_then(|m| m.contraction[f]))
        });
        if !comparison.reference.is_empty() {
            add(format!("{}.error", field.name), &|row| Cell::number(row.measures.as_ref().and_then(|m| m.errors[f])));
        }
    }
    // Many readers take a line for a row.
    add("reason".into(), &|row| Cell::Text(row.reason().replace('\n', " ")));
    list
}

/// Name of the column of a choice, with its unit of measure where it has one.
fn head(choice: &Choice) -> String {
    if choice.name == "dt" { "dt [s]".into() } else { choice.name.clone() }
}

/// `runs.csv`.
pub(crate) fn runs(comparison: &Comparison, rows: &[Row<'_>]) -> String {
    let columns = columns(comparison, rows);
    let mut text = columns.iter().map(|c| cell(&c.0)).collect::<Vec<_>>().join(",") + "\n";
    for i in 0..rows.len() {
        text += &(columns.iter().map(|c| c.1[i].csv()).collect::<Vec<_>>().join(",") + "\n");
    }
    text
}

/// A run.
pub(crate) fn json(comparison: &Comparison, row: &Row<'_>) -> serde_json::Value {
    let columns = columns(comparison, std::slice::from_ref(row));
    columns.into_iter().map(|(name, cells)| (name, cells[0].json())).collect::<serde_json::Map<_, _>>().into()
}

/// `attempts.csv`.
pub(crate) fn attempts(comparison: &Comparison, rows: &[Row<'_>]) -> String {
    let mut text = String::from("run");
    let varying = || comparison.choices.iter().enumerate().filter(|c| c.1.varies());
    varying().for_each(|(_, choice)| text += &format!(",{}", cell(&head(choice))));
    text += ",time_step,step [s],iterations,outcome,residual_ratio\n";
    for row in rows {
        let Ok(run) = &row.entry.outcome else { continue };
        let mut key = row.entry.number.to_string();
        for (c, choice) in varying() {
            key += &format!(",{}", cell(&choice.options[row.entry.options[c]]));
        }
        for (number, attempt) in run.attempts() {
            let ratio = attempt.iterations.last().map_or_else(String::new, |i| i.ratio().to_string());
            let (n, outcome) = (attempt.iterations.len(), outcome(&attempt.outcome));
            // Writing to text cannot fail.
            let _ = writeln!(text, "{key},{number},{},{n},{outcome},{ratio}", attempt.step);
        }
    }
    text
}

/// `comparison.h5`.
pub(crate) fn hdf5(path: &Path, comparison: &Comparison, rows: &[Row<'_>]) -> Result<(), ResultsError> {
    let refused = |source| ResultsError::Hdf5 { path: path.into(), source };
    files::replace_with(path, |part| {
        let file = File::with_options().with_fapl(|access| access.libver_v110()).create(part).map_err(refused)?;
        fill(&file, comparison, rows).and_then(|()| file.close()).map_err(refused)
    })
}

fn fill(file: &File, comparison: &Comparison, rows: &[Row<'_>]) -> hdf5_metno::Result<()> {
    file.new_attr::<u32>().create("version")?.write_scalar(&VERSION)?;
    attribute(file, "comparison", &json!(comparison).to_string())?;
    let runs = file.create_group("runs")?;
    for (name, cells) in columns(comparison, rows) {
        let (name, unit) = name.strip_suffix(" [s]").map_or((name.as_str(), "1"), |name| (name, "s"));
        // A slash would make a group.
        let name = name.replace('/', "_");
        let numbers: Option<Vec<f64>> =
            (cells.iter()).map(|c| if let Cell::Number(v) = c { Some(v.unwrap_or(f64::NAN)) } else { None }).collect();
        match numbers {
            Some(numbers) => drop(floats(&runs, &name, unit, numbers.into_iter())?),
            None => {
                let texts = cells.iter().map(|c| if let Cell::Text(text) = c { text.as_str() } else { "" });
                let texts: Result<Vec<VarLenUnicode>, _> = texts.map(|text| text.replace('\0', "").parse()).collect();
                let texts = texts.map_err(|error| hdf5_metno::Error::from(format!("{name}: {error}")))?;
                put(&runs, &name, &texts, None)?;
            }
        }
    }
    let iterations = file.create_group("iterations")?;
    let mut keys: Vec<[usize; 4]> = Vec::new();
    let mut records: Vec<&IterationRecord> = Vec::new();
    for row in rows {
        let Ok(run) = &row.entry.outcome else { continue };
        let (mut last, mut a) = (0, 0);
        for (number, attempt) in run.attempts() {
            a = if number == last { a + 1 } else { 1 };
            last = number;
            for (i, record) in (1..).zip(&attempt.iterations) {
                keys.push([row.entry.number, number, a, i]);
                records.push(record);
            }
        }
    }
    for (k, name) in ["run", "time_step", "attempt", "iteration"].into_iter().enumerate() {
        integers(&iterations, name, keys.iter().map(|key| key[k]))?;
    }
    let Some(first) = rows.iter().find_map(|row| row.entry.outcome.as_ref().ok()) else { return Ok(()) };
    for (f, field) in first.fields.iter().enumerate() {
        let group = iterations.create_group(&field.name)?;
        floats(&group, "residual", &field.unit, records.iter().map(|r| r.residuals[f].norm))?;
        floats(&group, "limit", &field.unit, records.iter().map(|r| r.residuals[f].limit))?;
    }
    for (u, unit) in first.units.iter().enumerate() {
        floats(&iterations.create_group(unit)?, "seconds", "s", records.iter().map(|r| r.seconds[u]))?;
    }
    Ok(())
}

/// The table of the page and of the terminal: heads, whether a column is of numbers, and cells.
pub(crate) fn short(comparison: &Comparison, rows: &[Row<'_>]) -> (Vec<(String, bool)>, Vec<Vec<String>>) {
    let varying: Vec<usize> = (0..comparison.choices.len()).filter(|&c| comparison.choices[c].varies()).collect();
    let mut heads = vec![("run".to_owned(), true)];
    heads.extend(varying.iter().map(|&c| (comparison.choices[c].label.clone(), false)));
    heads.push(("outcome".into(), false));
    heads.extend(["steps", "iterations a step", "most"].map(|name| (name.to_owned(), true)));
    let has_derivatives = rows.iter().filter_map(|row| row.measures.as_ref()).any(|m| m.derivatives > 0);
    if has_derivatives {
        heads.push(("derivatives a step".into(), true));
    }
    heads.push(("contraction".into(), true));
    if !comparison.reference.is_empty() {
        heads.push(("largest error".into(), true));
    }
    heads.push(("seconds".into(), true));
    let of = |row: &Row<'_>| {
        let mut cells = vec![row.entry.number.to_string()];
        cells.extend(varying.iter().map(|&c| comparison.choices[c].options[row.entry.options[c]].clone()));
        cells.push(row.state().into());
        match &row.measures {
            Some(m) => {
                cells.push(m.time_steps.to_string());
                cells.push(format!("{:.1}", m.mean));
                // Of time steps that were done.
                cells.push(if m.time_steps > 0 { m.largest.to_string() } else { String::new() });
                if has_derivatives {
                    let mean = m.derivatives as f64 / m.time_steps.max(1) as f64;
                    cells.push(if m.derivatives > 0 { format!("{mean:.1}") } else { String::new() });
                }
                cells.push(worst(&m.contraction).map_or_else(String::new, |v| format!("{v:.3}")));
                if !comparison.reference.is_empty() {
                    cells.push(worst(&m.errors).map_or_else(String::new, chart::number));
                }
                cells.push(format!("{:.2}", m.total));
            }
            None => cells.resize(heads.len(), String::new()),
        }
        cells
    };
    let cells = rows.iter().map(of).collect();
    (heads, cells)
}

/// The largest of those that there are.
pub(crate) fn worst(values: &[Option<f64>]) -> Option<f64> {
    values.iter().flatten().copied().reduce(f64::max)
}

/// [`short`] as text, with the reasons of failures below.
pub(crate) fn text(comparison: &Comparison, rows: &[Row<'_>]) -> String {
    let (heads, cells) = short(comparison, rows);
    let width = |c: usize| {
        let widths = cells.iter().map(|row| row[c].chars().count());
        widths.chain([heads[c].0.chars().count()]).max().unwrap_or(0)
    };
    let line = |cells: &mut dyn Iterator<Item = (usize, &str)>| {
        let padded = cells.map(|(c, text)| {
            let room = " ".repeat(width(c) - text.chars().count());
            if heads[c].1 { room + text } else { text.to_owned() + &room }
        });
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let mut text = line(&mut heads.iter().map(|h| h.0.as_str()).enumerate());
    for row in &cells {
        text += &format!("\n{}", line(&mut row.iter().map(String::as_str).enumerate()));
    }
    for row in rows.iter().filter(|row| row.state() != "complete") {
        text += &format!("\nrun {} {}: {}", row.entry.number, row.state(), row.reason());
    }
    text
}
