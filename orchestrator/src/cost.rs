//! Where the wall time of a unit went.

use coupling::Work;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::unit::{Calls, Unit};

/// The calls of a unit, and its computing in them where it tells of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Name of the unit.
    pub unit: String,
    /// Calls as the orchestrator sees them.
    pub calls: Calls,
    /// Computing as the unit sees it.
    pub work: Option<Work>,
}

impl Cost {
    /// That of a unit up to now.
    pub fn of(unit: &mut dyn Unit) -> Self {
        // Before the work is asked for, which is a call too.
        let calls = unit.calls();
        Self { unit: unit.name().to_owned(), calls, work: unit.work() }
    }

    /// Wall seconds by parts, which add up to those of all calls: those of its computing; `loading`, the rest of its start,
    /// in which it reads its resources; `interface`, the rest of all else, in which values and states are copied. A unit that
    /// says nothing has one part.
    pub fn parts(&self) -> Vec<(&'static str, f64)> {
        let all = self.calls.seconds();
        let Some(work) = self.work else { return vec![("all", all)] };
        let loading = self.calls.start.seconds - self.calls.start_computing;
        let Work { total, analysis, assembly, factorisation, solves, newton, .. } = work;
        vec![
            ("analysis", analysis),
            ("assembly", assembly),
            ("factorisation", factorisation),
            ("triangular solves", solves),
            ("contact", newton),
            ("other computing", total - analysis - assembly - factorisation - solves - newton),
            ("loading", loading),
            ("interface", all - total - loading),
        ]
    }

    /// Milliseconds of a time step, of a directional derivative and of a triangular solve.
    pub fn milliseconds(&self) -> [Option<f64>; 3] {
        let each = |seconds: f64, count: f64| (count > 0.0).then(|| 1e3 * seconds / count);
        let of = |calls: crate::unit::Tally| each(calls.seconds, calls.count as f64);
        let solve = self.work.and_then(|w| each(w.solves, w.solve_count));
        [of(self.calls.step), of(self.calls.derivative), solve]
    }

    /// All of several, by the names of the units.
    pub fn by_unit(costs: &[Self]) -> Value {
        costs.iter().map(|cost| (cost.unit.clone(), cost.to_json())).collect::<serde_json::Map<_, _>>().into()
    }

    /// All of it.
    fn to_json(&self) -> Value {
        let Calls { start, set, get, step, derivative, state, .. } = self.calls;
        let parts: serde_json::Map<_, _> = self.parts().into_iter().map(|(name, s)| (name.into(), json!(s))).collect();
        let count = |of: fn(&Work) -> f64| self.work.as_ref().map(of);
        let [step_ms, derivative_ms, solve_ms] = self.milliseconds();
        json!({
            "time_steps": step.count,
            "derivatives": derivative.count,
            "factorisations": count(|w| w.factorisations),
            "triangular_solves": count(|w| w.solve_count),
            "ms": { "time_step": step_ms, "derivative": derivative_ms, "triangular_solve": solve_ms },
            "seconds": parts,
            "call_seconds": {
                "start": start.seconds, "set": set.seconds, "get": get.seconds, "time_steps": step.seconds,
                "derivatives": derivative.seconds, "states": state.seconds,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::unit::Tally;

    #[test]
    fn parts_add_up_to_the_calls() {
        let calls = Calls {
            start: Tally { count: 1, seconds: 0.5 },
            start_computing: 0.375,
            step: Tally { count: 4, seconds: 2.0 },
            get: Tally { count: 8, seconds: 0.25 },
            ..Calls::default()
        };
        let work = Work { total: 2.25, factorisation: 1.5, solves: 0.5, solve_count: 4.0, ..Work::default() };
        let cost = Cost { unit: "flow".into(), calls, work: Some(work) };
        let parts = cost.parts();
        assert_eq!(parts.iter().map(|part| part.1).sum::<f64>(), 2.75);
        assert_eq!(parts[5..], [("other computing", 0.25), ("loading", 0.125), ("interface", 0.375)]);
        assert_eq!(cost.milliseconds(), [Some(500.0), None, Some(125.0)]);
        assert_eq!(Cost { work: None, ..cost }.parts(), [("all", 2.75)]);
    }
}
