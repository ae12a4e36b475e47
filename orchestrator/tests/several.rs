//! One unit alone, and units that follow those that are coupled.

#[allow(dead_code, reason = "other tests use the rest of it")]
mod toys;

use std::collections::BTreeMap;

use model::{Coupling, Number, Split, Time};
use orchestrator::fmi::Conversion;
use orchestrator::{
    AttemptOutcome, Checkpoint, Connection, CouplingError, FLOW, Interface, MECHANICS, Run, Settings, StepOutcome,
    Unit, UnitError,
};
use toys::{Column, Toy};

const FOLLOWER: usize = 2;

/// Adds up what it is given over time: `sum` grows by step · `given`.
struct Follower {
    values: BTreeMap<&'static str, f64>,
    kept: BTreeMap<&'static str, f64>,
    rejects_above: f64,
    rolls_back: bool,
}

impl Follower {
    fn new() -> Self {
        let values: BTreeMap<_, _> = [("given", 0.0), ("sum", 0.0)].into();
        Self { kept: values.clone(), values, rejects_above: f64::INFINITY, rolls_back: true }
    }
}

impl Unit for Follower {
    fn name(&self) -> &str {
        "follower"
    }

    fn has(&self, variable: &str) -> bool {
        self.values.contains_key(variable)
    }

    fn set(&mut self, variable: &str, values: &[f64]) -> Result<(), UnitError> {
        *self.values.get_mut(variable).unwrap() = values[0];
        Ok(())
    }

    fn get(&mut self, variable: &str, values: &mut Vec<f64>) -> Result<(), UnitError> {
        *values = vec![self.values[variable]];
        Ok(())
    }

    fn step(&mut self, _: f64, step: f64) -> Result<StepOutcome, UnitError> {
        if step > self.rejects_above {
            return Ok(StepOutcome::Discarded { reason: "too long".into() });
        }
        *self.values.get_mut("sum").unwrap() += step * self.values["given"];
        Ok(StepOutcome::Done)
    }

    fn can_roll_back(&self) -> bool {
        self.rolls_back
    }

    fn save(&mut self) -> Result<(), UnitError> {
        self.kept = self.values.clone();
        Ok(())
    }

    fn restore(&mut self) -> Result<(), UnitError> {
        self.values = self.kept.clone();
        Ok(())
    }

    fn serialise(&mut self) -> Result<Vec<u8>, UnitError> {
        Ok([self.values["given"], self.values["sum"]].iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    fn deserialise(&mut self, bytes: &[u8]) -> Result<(), UnitError> {
        let number = |i: usize| f64::from_le_bytes(bytes[8 * i..][..8].try_into().unwrap());
        self.values = [("given", number(0)), ("sum", number(1))].into();
        Ok(())
    }

    fn newton_iterations(&mut self) -> Option<u64> {
        Some(7)
    }
}

fn settings(steps: usize) -> Settings {
    Settings {
        scheme: Split::FixedStress.into(),
        coupling: Coupling::default(),
        time: Time { end: Number(0.1 * steps as f64), step: Some(Number(0.1)), ..Time::default() },
        output_times: Vec::new(),
    }
}

fn column() -> Column {
    Column { leakage: 1e-9, ..Column::of_strength(2.0) }
}

fn connection(from: (usize, &str), to: (usize, &str), factor: f64) -> Connection {
    let end = |(unit, name): (usize, &str)| (unit, name.to_owned());
    Connection { from: end(from), to: end(to), conversion: Conversion { factor, offset: 0.0 } }
}

/// Flow whose porosity falls by what a follower has added up of its pressure.
fn looped(follower: Follower, steps: usize) -> Result<Run, CouplingError> {
    let flow = Toy::new(true, &[column()]);
    let interface = Interface {
        connections: vec![
            connection((0, "matrix.pressure"), (1, "given"), 1e-6),
            connection((1, "sum"), (0, "matrix.porosity_change"), -1e-3),
        ],
        ..Interface::single()
    };
    Run::new([Box::new(flow) as Box<dyn Unit>, Box::new(follower)], interface, settings(steps))
}

fn value(run: &mut Run, unit: usize, variable: &str) -> f64 {
    let mut values = Vec::new();
    run.units()[unit].get(variable, &mut values).unwrap();
    values[0]
}

#[test]
fn one_unit_takes_one_pass_and_need_not_roll_back() {
    let mut alone = Toy::new(false, &[column()]);
    let mut same = Toy::new(false, &[column()]);
    alone.rolls_back = false;
    let mut run = Run::new([Box::new(alone) as Box<dyn Unit>], Interface::single(), settings(4)).unwrap();
    while !run.is_finished() {
        let time = run.time();
        let record = run.advance().unwrap();
        assert_eq!((record.attempts.len(), record.iterations().len()), (1, 1));
        let iteration = &record.iterations()[0];
        assert!(iteration.residuals.is_empty() && iteration.seconds.len() == 1 && iteration.ratio() == 0.0);
        same.step(time, run.time() - time).unwrap();
        let mut expected = Vec::new();
        same.get("matrix.porosity_change", &mut expected).unwrap();
        assert_eq!(value(&mut run, 0, "matrix.porosity_change").to_bits(), expected[0].to_bits());
    }
}

#[test]
fn a_single_unit_that_discards_is_tried_again_with_half() {
    let mut flow = Toy::new(true, &[column()]);
    flow.rejects_above = 0.06;
    let mut run = Run::new([Box::new(flow) as Box<dyn Unit>], Interface::single(), settings(1)).unwrap();
    let record = run.advance().unwrap();
    assert_eq!(record.attempts.iter().map(|a| a.step).collect::<Vec<_>>(), [0.1, 0.05]);
}

/// What a follower gives holds for the whole of the next time step, and it is given what holds at the end of its own.
#[test]
fn a_follower_steps_once_after_the_others() {
    let mut run = looped(Follower::new(), 5).unwrap();
    let mut flow = Toy::new(true, &[column()]);
    let mut sum = 0.01;
    run.units()[1].set("sum", &[sum]).unwrap();
    for _ in 0..5 {
        let time = run.time();
        let record = run.advance().unwrap();
        let step = run.time() - time;
        flow.set("matrix.porosity_change", &[-1e-3 * sum]).unwrap();
        flow.step(time, step).unwrap();
        let mut pressure = Vec::new();
        flow.get("matrix.pressure", &mut pressure).unwrap();
        sum += step * (1e-6 * pressure[0]);
        assert!(pressure[0] > 0.0);
        assert_eq!(value(&mut run, 0, "matrix.pressure").to_bits(), pressure[0].to_bits());
        assert_eq!(value(&mut run, 1, "sum").to_bits(), sum.to_bits());
        assert_eq!(record.iterations()[0].newton, [None, Some(7)]);
    }
}

#[test]
fn a_follower_that_discards_takes_all_units_back() {
    let with = |rolls_back| {
        let mut follower = Follower::new();
        (follower.rejects_above, follower.rolls_back) = (0.06, rolls_back);
        let mut run = looped(follower, 1).unwrap();
        run.units()[1].set("sum", &[0.01]).unwrap();
        run.advance().map(|record| (record, value(&mut run, 0, "matrix.pressure")))
    };
    let (record, pressure) = with(true).unwrap();
    assert!(matches!(&record.attempts[0].outcome, AttemptOutcome::Discarded { unit, .. } if unit == "follower"));
    assert_eq!(record.attempts[1].step, 0.05);
    let mut flow = Toy::new(true, &[column()]);
    flow.set("matrix.porosity_change", &[-1e-5]).unwrap();
    flow.step(0.0, 0.05).unwrap();
    let mut expected = Vec::new();
    flow.get("matrix.pressure", &mut expected).unwrap();
    assert_eq!(pressure.to_bits(), expected[0].to_bits());
    // One that cannot go back cannot be tried again.
    let Err(CouplingError::Failed(failure)) = with(false) else { panic!() };
    assert_eq!((failure.attempts.len(), failure.minimum), (1, None));
}

#[test]
fn a_pair_with_a_follower_is_the_pair_and_resumes_to_the_same_bits() {
    let columns = [column()];
    let start = |interface: Interface| -> (Vec<Box<dyn Unit>>, Interface) {
        let mut units: Vec<Box<dyn Unit>> =
            vec![Box::new(Toy::new(true, &columns)), Box::new(Toy::new(false, &columns))];
        if !interface.connections.is_empty() {
            units.push(Box::new(Follower::new()));
        }
        (units, interface)
    };
    let followed = Interface {
        connections: vec![connection((FLOW, "matrix.pressure"), (FOLLOWER, "given"), 1.0)],
        ..Interface::poroelastic()
    };
    let (units, interface) = start(Interface::poroelastic());
    let mut pair = Run::new(units, interface, settings(4)).unwrap();
    let (units, interface) = start(followed.clone());
    let mut three = Run::new(units, interface, settings(4)).unwrap();
    let mut bytes = Vec::new();
    while !pair.is_finished() {
        let (a, b) = (pair.advance().unwrap(), three.advance().unwrap());
        assert_eq!(a.iterations().len(), b.iterations().len());
        assert_eq!(a.iterations()[0].residuals, b.iterations()[0].residuals);
        // The follower's work is in the last iteration.
        let counts: Vec<_> = b.iterations().iter().map(|i| i.newton[FOLLOWER]).collect();
        assert!(counts.len() > 1 && counts[0].is_none() && counts.last() == Some(&Some(7)), "{counts:?}");
        assert_eq!(pair.fields(), three.fields());
        if b.number == 2 {
            bytes = three.checkpoint().unwrap().to_bytes().unwrap();
        }
    }
    assert!(value(&mut three, MECHANICS, "matrix.porosity_change") < 0.0);
    let checkpoint = Checkpoint::from_bytes(&bytes).unwrap();
    let (units, interface) = start(followed.clone());
    let mut resumed = Run::resume(units, interface, settings(4), &checkpoint).unwrap();
    while !resumed.is_finished() {
        resumed.advance().unwrap();
    }
    assert_eq!(resumed.fields(), three.fields());
    let sums = [&mut resumed, &mut three].map(|run| value(run, FOLLOWER, "sum").to_bits());
    assert_eq!(sums[0], sums[1]);
    // A checkpoint of three units is none of two.
    let (mut units, _) = start(followed.clone());
    units.pop();
    let error = Run::resume(units, followed, settings(4), &checkpoint).unwrap_err();
    assert!(matches!(error, CouplingError::Checkpoint { .. }), "{error}");
}
