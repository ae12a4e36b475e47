//! The next time step.

use std::collections::BTreeMap;

use model::{Adaptive, Time};
use serde::{Deserialize, Serialize};

/// A time step that ends closer to a stop than this part of it ends there.
const NEAR: f64 = 1e-6;
/// Least factor from one time step to the next where steps adapt, and after a failure.
const CUT: f64 = 0.5;
/// Where the settings give no smallest step: this part of the first.
const SMALLEST: f64 = 1.0 / 1024.0;

/// Chooses time steps. All stops (multiples of the step where it is fixed, output times, the end) are met exactly.
#[derive(Clone, Debug)]
pub(crate) struct TimeControl {
    settings: Time,
    /// Output times and the end (s), ascending.
    stops: Vec<f64>,
}

/// What it remembers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pace {
    /// The time step (s) that is wanted next, where no stop comes before.
    pub(crate) wanted: f64,
}

impl TimeControl {
    pub(crate) fn new(settings: Time, output_times: &[f64]) -> Self {
        let (start, end) = (settings.start.0, settings.end.0);
        let mut stops: Vec<f64> = output_times.iter().copied().filter(|&t| t > start && t < end).collect();
        stops.push(end);
        stops.sort_by(f64::total_cmp);
        Self { settings, stops }
    }

    /// The step (s) of the settings.
    fn step(&self) -> f64 {
        self.settings.step.map_or(self.settings.end.0 - self.settings.start.0, |s| s.0)
    }

    /// What time steps that start at `time` (s) adapt by; `None` where they are fixed.
    fn adaptive(&self, time: f64) -> Option<&Adaptive> {
        self.settings.adaptive.as_ref().filter(|adaptive| adaptive.from.is_none_or(|from| time >= from.0))
    }

    /// Smallest step (s).
    pub(crate) fn minimum(&self) -> f64 {
        self.settings.minimum.map_or(SMALLEST * self.step(), |s| s.0)
    }

    pub(crate) fn first(&self) -> Pace {
        Pace { wanted: self.step() }
    }

    pub(crate) fn is_finished(&self, time: f64) -> bool {
        time >= self.settings.end.0
    }

    /// The end (s) of the next time step of at most `pace.wanted`.
    pub(crate) fn next(&self, time: f64, pace: Pace) -> f64 {
        let end = self.settings.end.0;
        let mut stop = self.stops.iter().copied().find(|&s| s > time).unwrap_or(end);
        if self.adaptive(time).is_none() {
            let (start, step) = (self.settings.start.0, self.step());
            let passed = ((time - start) / step + NEAR).floor();
            stop = stop.min(start + (passed + 1.0) * step);
        }
        if time + pace.wanted * (1.0 + NEAR) >= stop { stop } else { time + pace.wanted }
    }

    /// After a time step of `step` (s) to `time` (s) with so many coupling iterations and such changes of fields.
    pub(crate) fn accepted(
        &self,
        pace: Pace,
        time: f64,
        step: f64,
        iterations: usize,
        changes: &BTreeMap<&str, f64>,
    ) -> Pace {
        let Some(adaptive) = self.adaptive(time) else {
            // After a cut, back to the fixed step.
            let base = pace.wanted.max(step);
            return Pace { wanted: (2.0 * base).min(self.step()) };
        };
        let mut factor = adaptive.target_iterations.0 / iterations.max(1) as f64;
        for (name, limit) in &adaptive.largest_change {
            if let Some(&change) = changes.get(name.as_str())
                && change > 0.0
            {
                factor = factor.min(limit.0 / change);
            }
        }
        let factor = factor.clamp(CUT, adaptive.growth.0);
        // A step that a stop cut short says nothing against longer ones.
        let base = if factor >= 1.0 { pace.wanted.max(step) } else { step };
        let wanted = (base * factor).max(self.minimum());
        Pace { wanted: adaptive.maximum.map_or(wanted, |m| wanted.min(m.0)) }
    }

    /// After a time step of `step` (s) failed; `None` where no smaller one is allowed.
    pub(crate) fn failed(&self, step: f64) -> Option<Pace> {
        let wanted = CUT * step;
        (wanted >= self.minimum() * (1.0 - NEAR)).then_some(Pace { wanted })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Number;

    fn settings(end: f64, step: f64) -> Time {
        Time { end: Number(end), step: Some(Number(step)), ..Time::default() }
    }

    #[test]
    fn fixed_steps_meet_all_stops_and_recover_after_a_cut() {
        let control = TimeControl::new(settings(1.0, 0.3), &[0.5]);
        let (mut time, mut pace) = (0.0, control.first());
        let mut times = Vec::new();
        while !control.is_finished(time) {
            let mut end = control.next(time, pace);
            if times.len() == 1 {
                pace = control.failed(end - time).unwrap();
                end = control.next(time, pace);
            }
            pace = control.accepted(pace, end, end - time, 9, &BTreeMap::new());
            time = end;
            times.push(time);
        }
        let wanted = [0.3, 0.4, 0.5, 0.6, 0.9, 1.0];
        assert_eq!(times.len(), wanted.len(), "{times:?}");
        assert!(times.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{times:?}");
        assert_eq!(times[5], 1.0);
    }

    #[test]
    fn failures_end_at_the_minimum() {
        let control = TimeControl::new(Time { minimum: Some(Number(0.25)), ..settings(1.0, 1.0) }, &[]);
        assert_eq!(control.failed(1.0), Some(Pace { wanted: 0.5 }));
        assert_eq!(control.failed(0.5), Some(Pace { wanted: 0.25 }));
        assert_eq!(control.failed(0.25), None);
    }

    #[test]
    fn adaptive_steps_follow_iterations_and_changes() {
        let adaptive = Adaptive {
            maximum: Some(Number(4.0)),
            growth: Number(2.0),
            largest_change: [("p".to_owned(), Number(10.0))].into(),
            ..Adaptive::default()
        };
        let control = TimeControl::new(Time { adaptive: Some(adaptive), ..settings(100.0, 1.0) }, &[]);
        let next = |iterations, change| {
            control.accepted(Pace { wanted: 1.0 }, 1.0, 1.0, iterations, &[("p", change)].into()).wanted
        };
        assert_eq!(next(1, 0.0), 2.0);
        assert_eq!(next(4, 1.0), 1.5);
        assert_eq!(next(4, 8.0), 1.25);
        assert_eq!(next(50, 1.0), 0.5);
        assert_eq!(control.accepted(Pace { wanted: 3.0 }, 3.0, 3.0, 1, &BTreeMap::new()).wanted, 4.0);
        // A step cut short by a stop.
        assert_eq!(control.accepted(Pace { wanted: 2.0 }, 0.1, 0.1, 4, &BTreeMap::new()).wanted, 3.0);
    }

    #[test]
    fn steps_are_fixed_until_they_adapt() {
        let adaptive = Adaptive { from: Some(Number(3.0)), growth: Number(2.0), ..Adaptive::default() };
        let control = TimeControl::new(Time { adaptive: Some(adaptive), ..settings(20.0, 1.0) }, &[0.5]);
        let (mut time, mut pace) = (0.0, control.first());
        let mut times = Vec::new();
        while !control.is_finished(time) {
            let end = control.next(time, pace);
            pace = control.accepted(pace, end, end - time, 2, &BTreeMap::new());
            time = end;
            times.push(time);
        }
        assert_eq!(times, [0.5, 1.0, 2.0, 3.0, 5.0, 9.0, 17.0, 20.0]);
    }
}
