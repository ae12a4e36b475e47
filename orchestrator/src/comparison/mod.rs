//! Runs of one model with different choices, side by side: what was measured of them, as tables, plots and a page.
//!
//! | file | content |
//! |---|---|
//! | `runs.csv` | a line for each run: its choices, how it ended, iterations, contraction, seconds, errors |
//! | `attempts.csv` | a line for each attempt at a time step of each run |
//! | `comparison.h5` | both, and the residuals of every coupling iteration (layout: see the source of `comparison/tables.rs`) |
//! | `plots/` | SVG |
//! | `index.html` | a page with all this, in one piece |
//!
//! The contraction of a field is the geometric mean of the ratios of its successive residuals, from the second coupling
//! iteration of each time step on: below 1 they fall. Errors are L² norms against a run that is named as the reference.

mod figures;
mod outcome;
mod page;
mod tables;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use figures::{FigureSpec, Kind, Value};
pub use outcome::{Measures, Outcome};

use crate::counted;
use crate::results::{ResultsError, files};

/// What is compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// What it is called.
    pub title: String,
    /// What is to be found out.
    pub question: String,
    /// The command with its arguments.
    pub command: Vec<String>,
    /// What there is to choose.
    pub choices: Vec<Choice>,
    /// Options by the name of their choice: errors of a run are against the run that has these, and its own for all else.
    pub reference: BTreeMap<String, String>,
    /// Plots to draw; none: those that fit the choices.
    pub figures: Vec<FigureSpec>,
}

/// A choice between options.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Choice {
    /// Its name.
    pub name: String,
    /// What plots call it.
    pub label: String,
    /// Its options.
    pub options: Vec<String>,
}

impl Choice {
    /// Whether there is anything to choose.
    pub fn varies(&self) -> bool {
        self.options.len() > 1
    }

    /// The options as numbers, where all are.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        self.options.iter().map(|o| o.parse().ok()).collect()
    }
}

/// A run.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Its number, from 1.
    pub number: usize,
    /// The number of the option taken of each choice.
    pub options: Vec<usize>,
    /// What it left, or why it left nothing.
    pub outcome: Result<Outcome, String>,
}

impl Entry {
    /// How it ended, in a line.
    pub fn summary(&self) -> String {
        let row = Row { entry: self, measures: self.outcome.as_ref().ok().map(|o| o.measure(None)) };
        match &row.measures {
            Some(m) if row.state() == "complete" => {
                format!("{:.1} coupling iterations a time step, {:.2} s", m.mean, m.total)
            }
            _ => format!("{} {}", row.state(), row.reason()),
        }
    }
}

/// An entry with what was measured.
#[derive(Debug)]
pub(crate) struct Row<'a> {
    pub(crate) entry: &'a Entry,
    pub(crate) measures: Option<Measures>,
}

impl Row<'_> {
    /// How it ended, in a word.
    pub(crate) fn state(&self) -> &'static str {
        match &self.entry.outcome {
            Err(_) => "error",
            Ok(outcome) if outcome.failure.is_some() => "failed",
            Ok(_) => "complete",
        }
    }

    /// Why it is not complete; empty where it is.
    pub(crate) fn reason(&self) -> String {
        match &self.entry.outcome {
            Err(error) => error.clone(),
            Ok(outcome) => outcome.failure.as_ref().map_or_else(String::new, |failure| {
                let last = failure.attempts.last();
                let what = last.map_or_else(String::new, |a| {
                    format!(": {} ({})", a.outcome, counted(a.iterations.len(), "coupling iteration"))
                });
                format!("at t = {} s{what}", failure.time)
            }),
        }
    }
}

impl Comparison {
    /// Number of the combination `options` with others taken for some choices.
    fn reference_of<'a>(&self, entries: &'a [Entry], entry: &Entry) -> Option<&'a Outcome> {
        if self.reference.is_empty() {
            return None;
        }
        let mut options = entry.options.clone();
        for (c, choice) in self.choices.iter().enumerate() {
            if let Some(label) = self.reference.get(&choice.name) {
                options[c] = choice.options.iter().position(|o| o == label)?;
            }
        }
        entries.iter().find(|e| e.options == options).and_then(|e| e.outcome.as_ref().ok())
    }

    fn rows<'a>(&self, entries: &'a [Entry]) -> Vec<Row<'a>> {
        let measure = |entry: &'a Entry| {
            let reference = self.reference_of(entries, entry);
            Row { entry, measures: entry.outcome.as_ref().ok().map(|o| o.measure(reference)) }
        };
        entries.iter().map(measure).collect()
    }

    /// The options of a run that others do not share: "split drained, dt 10".
    pub fn name_of(&self, entry: &Entry) -> String {
        let pick = |(choice, &i): (&Choice, &usize)| {
            choice.varies().then(|| format!("{} {}", choice.label, choice.options[i]))
        };
        let parts: Vec<String> = self.choices.iter().zip(&entry.options).filter_map(pick).collect();
        if parts.is_empty() { "the model as it is".into() } else { parts.join(", ") }
    }

    /// What was measured, as a table in text.
    pub fn text(&self, entries: &[Entry]) -> String {
        tables::text(self, &self.rows(entries))
    }

    /// A run in a line of JSON.
    pub fn json(&self, entries: &[Entry], entry: &Entry) -> serde_json::Value {
        let rows = self.rows(entries);
        let found = rows.iter().find(|row| row.entry.number == entry.number);
        found.map_or(serde_json::Value::Null, |row| tables::json(self, row))
    }

    /// Writes tables, plots and page into a folder. Gives the path of the page.
    ///
    /// # Errors
    /// Those of files and of drawing.
    pub fn write(&self, folder: &Path, entries: &[Entry]) -> Result<PathBuf, ResultsError> {
        let rows = self.rows(entries);
        files::replace(&folder.join("runs.csv"), tables::runs(self, &rows).as_bytes())?;
        files::replace(&folder.join("attempts.csv"), tables::attempts(self, &rows).as_bytes())?;
        tables::hdf5(&folder.join("comparison.h5"), self, &rows)?;
        let figures = figures::draw(self, &rows)?;
        let plots = folder.join("plots");
        fs::create_dir_all(&plots).map_err(ResultsError::io(&plots))?;
        files::remove(&plots, |name| name.ends_with(".svg"))?;
        for figure in &figures {
            files::replace(&plots.join(format!("{}.svg", figure.name)), figure.svg.as_bytes())?;
        }
        let page = folder.join("index.html");
        files::replace(&page, page::page(self, &rows, &figures).as_bytes())?;
        Ok(page)
    }
}
