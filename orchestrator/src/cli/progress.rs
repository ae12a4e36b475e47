//! What a run says while it goes.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Write};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use orchestrator::{IterationRecord, StepRecord, counted};
use serde_json::json;

use super::error::CliError;

/// How a run speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Voice {
    /// A progress bar on standard error, a summary on standard output.
    Bar,
    /// A line for each time step on standard output, and a summary.
    Lines,
    /// The same as JSON.
    Json,
    /// Not at all.
    Quiet,
}

/// Length of the bar: parts of the simulated time.
const PARTS: u64 = 10_000;

pub(crate) struct Progress {
    voice: Voice,
    times: [f64; 2],
    bar: ProgressBar,
    number: usize,
    names: Vec<String>,
    /// Lines that units have said.
    said: BTreeSet<String>,
}

impl Progress {
    /// From the present `time` to the `end` (s); `number` time steps are done. `names` are those of the units.
    pub(crate) fn new(voice: Voice, time: f64, end: f64, number: usize, names: Vec<String>) -> Self {
        let bar = if voice == Voice::Bar { ProgressBar::new(PARTS) } else { ProgressBar::hidden() };
        if let Ok(style) = ProgressStyle::with_template("{bar:20} {percent:>3} % {eta:>4} left  {wide_msg}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        Self { voice, times: [time, end], bar, number, names, said: BTreeSet::new() }
    }

    /// After a coupling iteration of the time step that ends at `end` (s).
    pub(crate) fn iteration(&self, end: f64, iteration: usize, record: &IterationRecord) {
        if self.voice == Voice::Bar {
            let number = self.number + 1;
            let ratio = record.ratio();
            self.bar.set_message(format!(
                "time step {number} to {end} s, coupling iteration {iteration} (residual/limit {ratio:.1e})"
            ));
        }
    }

    /// After a time step.
    pub(crate) fn step(&mut self, record: &StepRecord) -> Result<(), CliError> {
        self.number = record.number;
        let [start, end] = self.times;
        self.bar.set_position(((record.time - start) / (end - start) * PARTS as f64) as u64);
        let iterations = record.iterations();
        let seconds = seconds(record);
        let step = record.attempts.last().map_or(0.0, |a| a.step);
        let line = match self.voice {
            Voice::Lines => format!(
                "time step {}: t = {} s, step {step} s, {}, {}, {:.2} s",
                record.number,
                record.time,
                counted(iterations.len(), "coupling iteration"),
                counted(record.attempts.len(), "attempt"),
                seconds.iter().sum::<f64>(),
            ),
            Voice::Json => json!({
                "number": record.number,
                "time": record.time,
                "step": step,
                "attempts": record.attempts.len(),
                "iterations": iterations.len(),
                "residual_ratio": iterations.last().map(IterationRecord::ratio),
                "newton_iterations": newton(record),
                "seconds": self.names.iter().zip(seconds).collect::<BTreeMap<_, _>>(),
            })
            .to_string(),
            Voice::Bar | Voice::Quiet => return Ok(()),
        };
        writeln!(io::stdout(), "{line}").map_err(CliError::Output)
    }

    /// Shows what a unit says, once.
    pub(crate) fn message(&mut self, unit: &str, text: String) {
        let line = format!("{unit}: {text}");
        if self.voice != Voice::Quiet && !self.said.contains(&line) {
            self.bar.suspend(|| eprintln!("{line}"));
            self.said.insert(line);
        }
    }

    /// Takes the bar away.
    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// Wall seconds in each unit, over all attempts.
pub(crate) fn seconds(record: &StepRecord) -> Vec<f64> {
    let mut sum = Vec::new();
    for iteration in record.attempts.iter().flat_map(|a| &a.iterations) {
        sum.resize(iteration.seconds.len(), 0.0);
        sum.iter_mut().zip(&iteration.seconds).for_each(|(sum, seconds)| *sum += seconds);
    }
    sum
}

/// Newton iterations of all units, over all attempts.
pub(crate) fn newton(record: &StepRecord) -> u64 {
    record.attempts.iter().flat_map(|a| &a.iterations).flat_map(|i| &i.newton).flatten().sum()
}
