//! The next time step.

use std::collections::BTreeMap;

use model::{Adaptive, Time};
use serde::{Deserialize, Serialize};

/// Times that differ by no more than this part of a time step are one: 3 × 0.3 and 0.9, 100/3 and 33.333333.
const NEAR: f64 = 1e-6;
/// Nor are they told apart by so many units of round-off.
const ROUND_OFF: f64 = 16.0;
/// Least factor from one time step to the next where steps adapt, and after a failure.
const CUT: f64 = 0.5;
/// Where the settings give no smallest step: this part of the first.
const SMALLEST: f64 = 1.0 / 1024.0;

/// Chooses time steps. All stops (multiples of the step where it is fixed, output times, the end) are met exactly, of those that
/// are all but the same one: the end, else an output time, else a multiple. Between stops no time step is below the smallest one.
#[derive(Clone, Debug)]
pub(crate) struct TimeControl {
    settings: Time,
    /// Output times and the end (s), ascending, none near another.
    stops: Vec<f64>,
}

/// What it remembers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pace {
    /// The time step (s) that is wanted next, where no stop comes before.
    pub(crate) wanted: f64,
}

/// The step (s) of the settings.
fn given_step(settings: &Time) -> f64 {
    settings.step.map_or(settings.end.0 - settings.start.0, |s| s.0)
}

/// Smallest step (s) of the settings.
fn minimum(settings: &Time) -> f64 {
    settings.minimum.map_or(SMALLEST * given_step(settings), |s| s.0)
}

/// Whether two times (s) are all but the same.
pub(crate) fn are_near(settings: &Time, a: f64, b: f64) -> bool {
    let least = if settings.adaptive.is_some() { minimum(settings) } else { given_step(settings) };
    (a - b).abs() <= (NEAR * least).max(ROUND_OFF * f64::EPSILON * a.abs().max(b.abs()))
}

impl TimeControl {
    pub(crate) fn new(settings: Time, output_times: &[f64]) -> Self {
        let (start, end) = (settings.start.0, settings.end.0);
        let near = |a: f64, b: f64| are_near(&settings, a, b);
        let within = |&t: &f64| t > start && t < end && !near(t, start) && !near(t, end);
        let mut stops: Vec<f64> = output_times.iter().copied().filter(within).collect();
        stops.push(end);
        stops.sort_by(f64::total_cmp);
        stops.dedup_by(|later, earlier| near(*later, *earlier));
        Self { settings, stops }
    }

    /// What time steps that start at `time` (s) adapt by; `None` where they are fixed.
    fn adaptive(&self, time: f64) -> Option<&Adaptive> {
        self.settings.adaptive.as_ref().filter(|adaptive| adaptive.from.is_none_or(|from| time >= from.0))
    }

    /// Smallest step (s).
    pub(crate) fn minimum(&self) -> f64 {
        minimum(&self.settings)
    }

    pub(crate) fn first(&self) -> Pace {
        Pace { wanted: given_step(&self.settings) }
    }

    pub(crate) fn is_finished(&self, time: f64) -> bool {
        time >= self.settings.end.0
    }

    /// The end (s) of the next time step, of about `pace.wanted` at most.
    pub(crate) fn next(&self, time: f64, pace: Pace) -> f64 {
        let near = |a: f64, b: f64| are_near(&self.settings, a, b);
        let end = self.settings.end.0;
        let mut stop = self.stops.iter().copied().find(|&s| s > time && !near(s, time)).unwrap_or(end);
        let mut rest = NEAR * pace.wanted;
        if self.adaptive(time).is_none() {
            let (start, step) = (self.settings.start.0, given_step(&self.settings));
            let passed = ((time - start) / step + NEAR).floor();
            let multiple = start + (passed + 1.0) * step;
            if multiple < stop && !near(multiple, stop) {
                stop = multiple;
            }
        } else {
            // A rest that is no time step belongs to the last one.
            rest = rest.max(self.minimum() * (1.0 - NEAR));
        }
        let next = time + pace.wanted;
        if next + rest >= stop || near(next, stop) { stop } else { next }
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
            return Pace { wanted: (2.0 * base).min(given_step(&self.settings)) };
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

    /// The ends of all time steps.
    fn ends(control: &TimeControl) -> Vec<f64> {
        let (mut time, mut pace) = (control.settings.start.0, control.first());
        let mut times = Vec::new();
        while !control.is_finished(time) {
            let end = control.next(time, pace);
            pace = control.accepted(pace, end, end - time, 1, &BTreeMap::new());
            time = end;
            times.push(time);
        }
        times
    }

    /// Decimals whose multiples are not those of their nearest numbers: (step, end, number of time steps).
    #[test]
    fn numbers_that_differ_in_their_last_digit_make_no_time_step() {
        for (step, end, count) in
            [(0.3, 0.9, 3), (33.3, 99.9, 3), (2000.1, 6000.3, 3), (0.1, 0.3, 3), (100.0 / 3.0, 100.0, 3)]
        {
            assert_eq!(ends(&TimeControl::new(settings(end, step), &[])).len(), count, "{step} {end}");
            // The same as an output time, and as two.
            let later = settings(2.0 * end, step);
            let twice = [end, 3.0 * step, end + 1e-9 * step];
            for outputs in [&[end][..], &twice] {
                let found = ends(&TimeControl::new(later.clone(), outputs));
                assert_eq!(found.len(), 2 * count, "{step} {end}: {found:?}");
                assert!(outputs.contains(&found[count - 1]), "{step} {end}: {found:?}");
            }
        }
    }

    /// Random decimals for start, step, end and output times, the times reckoned in whole numbers.
    #[test]
    fn grids_of_decimals_have_the_time_steps_that_they_have_on_paper() {
        let mut random = Random(0x5eed);
        for case in 0..20_000 {
            // 10⁻ᵈ s each.
            let digits = random.below(7) as i32 - 3;
            let value = |count: i64| count as f64 / 10f64.powi(digits);
            let start = if random.below(2) == 0 { 0 } else { random.below(20_000) as i64 - 10_000 };
            let step = 1 + random.below(500) as i64;
            let end = start + 1 + random.below(20 * step as u64) as i64;
            let outputs: Vec<i64> = (0..random.below(6))
                .map(|_| match random.below(2) {
                    0 => start + step * random.below(22) as i64,
                    _ => start + random.below((end - start) as u64 + 3) as i64,
                })
                .collect();
            let mut wanted: Vec<i64> = (1..).map(|n| start + n * step).take_while(|&t| t < end).collect();
            wanted.extend(outputs.iter().filter(|&&t| t > start && t < end));
            wanted.push(end);
            wanted.sort_unstable();
            wanted.dedup();
            // Whoever computes a time may be off in the last digits.
            let mut off = |time: f64| match random.below(3) {
                0 => time,
                1 => time * (1.0 + f64::EPSILON),
                _ => time * (1.0 - 2.0 * f64::EPSILON),
            };
            let time = Time {
                start: Number(value(start)),
                end: Number(off(value(end))),
                step: Some(Number(off(value(step)))),
                ..Time::default()
            };
            let outputs: Vec<f64> = outputs.iter().map(|&t| off(value(t))).collect();
            let found = ends(&TimeControl::new(time.clone(), &outputs));
            assert_eq!(found.len(), wanted.len(), "case {case}: {time:?} {outputs:?} {found:?}");
            for (found, &wanted) in found.iter().zip(&wanted) {
                assert!((found - value(wanted)).abs() <= 1e-8 * value(step), "case {case}: {found} {wanted}");
            }
            assert_eq!(found.last(), Some(&time.end.0));
            // Times that are near another one are met as that one; all others as they are.
            let met = |t: &&f64| **t > time.start.0 && **t < time.end.0 && !are_near(&time, **t, time.start.0);
            for t in outputs.iter().filter(met) {
                assert!(found.iter().any(|f| are_near(&time, *t, *f)), "case {case}: {t} {found:?}");
            }
        }
    }

    /// Whatever happens to time steps, those that adapt meet all stops and are none below the smallest one but between stops
    /// that are closer.
    #[test]
    fn adaptive_steps_leave_no_crumbs() {
        let mut random = Random(0xc0ffee);
        for case in 0..2000 {
            let mut part = || random.below(1 << 20) as f64 / (1 << 20) as f64;
            let (start, span) = (1e4 * (part() - 0.5).floor(), 1.0 + 1e6 * part());
            let outputs: Vec<f64> = (0..5).map(|_| start + span * part()).collect();
            let step = span * (0.01 + 0.5 * part());
            let adaptive = Adaptive { from: None, growth: Number(1.1 + 2.0 * part()), ..Adaptive::default() };
            let time = Time {
                start: Number(start),
                end: Number(start + span),
                step: Some(Number(step)),
                minimum: (part() < 0.5).then_some(Number(0.02 * step)),
                adaptive: Some(adaptive),
            };
            let control = TimeControl::new(time.clone(), &outputs);
            let (mut now, mut pace, mut times) = (start, control.first(), vec![start]);
            while !control.is_finished(now) {
                let mut end = control.next(now, pace);
                while random.below(4) == 0
                    && let Some(shorter) = control.failed(end - now)
                {
                    pace = shorter;
                    end = control.next(now, pace);
                }
                pace = control.accepted(pace, end, end - now, 1 + random.below(30) as usize, &BTreeMap::new());
                now = end;
                times.push(now);
            }
            let stops: Vec<f64> = [start].into_iter().chain(control.stops.iter().copied()).collect();
            assert!(stops.iter().all(|s| times.contains(s)), "case {case}");
            for pair in times.windows(2) {
                let between = stops.windows(2).any(|s| *s == *pair);
                let least = control.minimum() * (1.0 - 1e-5);
                assert!(pair[1] - pair[0] >= least || between, "case {case}: {pair:?}, {least}");
            }
        }
    }

    /// Marsaglia's xorshift, Journal of Statistical Software 8 (14), 2003.
    struct Random(u64);

    impl Random {
        fn below(&mut self, n: u64) -> u64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            self.0 % n
        }
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
