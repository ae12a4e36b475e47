//! The loop over time steps and coupling iterations.

mod criterion;
mod estimate;
mod newton_krylov;

use std::time::Instant;

use model::{Acceleration, Coupling, Extrapolation, Number, Refresh, Time};

use crate::acceleration::Accelerator;
use crate::checkpoint::Checkpoint;
use crate::error::CouplingError;
use crate::interface::{Connection, Field, Interface, Scheme};
use crate::record::{Attempt, AttemptOutcome, FailedField, Failure, FieldResidual, IterationRecord, StepRecord};
use crate::time::{Pace, TimeControl, are_near};
use crate::unit::{StepOutcome, Unit, UnitError};
use criterion::{NONE, Standstill, nudge, wider};
use estimate::Estimate;
use newton_krylov::{At, Search, reference_of, scatter};

/// The values of all fields of an interface.
pub type Fields = Vec<Vec<f64>>;

/// A residual that has grown by this factor over the least of its time step will not come back.
const DIVERGED: f64 = 1e8;
/// Factors on the sensitivities with which a pass is tried where the unit that goes first refuses: from a guess that is
/// far off, what it believes of its partner leads too far, as to apertures below zero. Sensitivities have no part in the
/// solution, and a smaller time step would be another solution.
const TRUST: [f64; 4] = [0.5, 0.25, 0.125, 0.0];
/// A unit says by the first whether it has parts that only references of its own fields can hold, and is told by the second that these
/// follow.
const REFERENCES: [&str; 2] = ["pressure_references.needed", "pressure_references.follow"];
/// Entries that the report of a failure names for each field.
const REPORTED: usize = 5;

/// How a run is to go.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Order and connected sensitivities.
    pub scheme: Scheme,
    /// Acceleration, extrapolation, limits. The split in it is not looked at: `scheme` says it.
    pub coupling: Coupling,
    /// Time steps.
    pub time: Time,
    /// Times (s) that are met exactly.
    pub output_times: Vec<f64>,
}

impl Settings {
    /// Those of a model.
    pub fn of(model: &model::Model) -> Self {
        Self {
            scheme: model.coupling.split.into(),
            coupling: model.coupling.clone(),
            time: model.time.clone(),
            output_times: model.output.times.iter().map(|t| t.0).collect(),
        }
    }

    /// Whether fields are written at a time (s): at the output times, or always where there are none.
    pub fn is_output_time(&self, time: f64) -> bool {
        self.output_times.is_empty() || self.output_times.iter().any(|&t| are_near(&self.time, t, time))
    }
}

impl Settings {
    /// Adapts the coupling to units that lack sensitivities which the split connects, and says how.
    #[must_use]
    pub fn fitted(mut self, interface: &Interface) -> (Self, Option<String>) {
        let connected = self.scheme.connected;
        let lacks = |f: &&Field| connected[f.from] && f.sensitivity.is_none();
        let lacking: Vec<&str> = interface.fields.iter().filter(lacks).map(|f| f.name.as_str()).collect();
        self.scheme = self.scheme.fitted(interface);
        if lacking.is_empty() {
            return (self, None);
        }
        let [before, now] =
            if self.scheme.first == crate::FLOW { ["fixed stress", "fixed strain"] } else { ["undrained", "drained"] };
        let mut note = format!(
            "the units do not both have the sensitivities of {}: for these fields the split {before} becomes {now}",
            lacking.join(", "),
        );
        // Such a unit has no derivatives as a rule, and Newton's method would repeat its time steps for their differences.
        let plain = [Acceleration::None, Acceleration::default()].contains(&self.coupling.acceleration);
        if plain && !self.coupling.loose {
            self.coupling.acceleration = Acceleration::Aitken { initial: Number(0.5) };
            note += ", with Aitken's relaxation";
        }
        (self, Some(note))
    }
}

/// Units on their way through time: those that are coupled first, one or two, then those that follow them.
#[derive(Debug)]
pub struct Run {
    units: Vec<Box<dyn Unit>>,
    interface: Interface,
    settings: Settings,
    /// The own fields of each coupled unit that it is given as references, the point at which its partner was evaluated.
    references: [Vec<usize>; 2],
    /// Whether each coupled unit has parts that only its references hold.
    needs_references: [bool; 2],
    control: TimeControl,
    pub(crate) state: State,
}

/// All that the next time step depends on, apart from the units.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct State {
    /// Number of time steps done.
    pub(crate) number: usize,
    pub(crate) time: f64,
    pub(crate) pace: Pace,
    /// Times and fields, the newest last; at most three.
    pub(crate) history: Vec<(f64, Fields)>,
    /// The fields at the start of the run.
    pub(crate) initial: Fields,
    /// Smallest and largest value that each field has had.
    pub(crate) ranges: Vec<[f64; 2]>,
    /// The sensitivities last published, for each field; empty where they are not connected.
    pub(crate) sensitivities: Fields,
    pub(crate) accelerator: Accelerator,
    /// How far GMRES is to reduce a residual in the first Newton iteration of the next time step.
    pub(crate) forcing: f64,
}

impl State {
    /// Widens the ranges to hold the values of fields.
    fn widen(&mut self, fields: &Fields) {
        for (range, field) in self.ranges.iter_mut().zip(fields) {
            *range = wider(*range, field.iter().copied());
        }
    }
}

/// How a pass through the coupled units ended.
enum Pass {
    Done { fields: Fields, record: IterationRecord },
    Discarded { unit: usize, reason: String },
}

impl Run {
    /// Starts from units that stand at the start time, in the order of the interface's numbers.
    ///
    /// # Errors
    /// [`CouplingError::Units`] where there are fewer than the interface is between; [`CouplingError::RollBack`] where one of two coupled units cannot roll back and coupling is not loose;
    /// [`CouplingError::Unit`]; [`CouplingError::Length`].
    pub fn new(
        units: impl Into<Vec<Box<dyn Unit>>>,
        interface: Interface,
        settings: Settings,
    ) -> Result<Self, CouplingError> {
        let time = settings.time.start.0;
        let mut run = Self::with_state(units.into(), interface, settings, None)?;
        let mut fields = vec![Vec::new(); run.interface.fields.len()];
        for unit in 0..run.interface.coupled {
            run.get_outputs(unit, &mut fields)?;
        }
        run.state.widen(&fields);
        run.state.initial.clone_from(&fields);
        run.state.history.push((time, fields));
        Ok(run)
    }

    /// Goes on from a checkpoint, with units that were made as at the start and settings as they were.
    ///
    /// # Errors
    /// Those of [`new`](Self::new), and [`CouplingError::Checkpoint`] where the settings are not those of the
    /// checkpoint.
    pub fn resume(
        units: impl Into<Vec<Box<dyn Unit>>>,
        interface: Interface,
        settings: Settings,
        checkpoint: &Checkpoint,
    ) -> Result<Self, CouplingError> {
        let units = units.into();
        checkpoint.check(&interface, &settings, units.len())?;
        let mut run = Self::with_state(units, interface, settings, Some(checkpoint.state.clone()))?;
        for (unit, bytes) in run.units.iter_mut().zip(&checkpoint.units) {
            unit.deserialise(bytes).map_err(|error| CouplingError::unit(unit.as_ref(), error))?;
        }
        Ok(run)
    }

    fn with_state(
        units: Vec<Box<dyn Unit>>,
        interface: Interface,
        settings: Settings,
        state: Option<State>,
    ) -> Result<Self, CouplingError> {
        let connected = interface.connections.iter().map(|c| c.from.0.max(c.to.0) + 1);
        let expected = connected.fold(interface.coupled, usize::max);
        if units.len() < expected {
            return Err(CouplingError::Units { expected, found: units.len() });
        }
        let iterates = interface.coupled > 1 && !settings.coupling.loose;
        if let Some(unit) = units[..interface.coupled].iter().find(|unit| iterates && !unit.can_roll_back()) {
            return Err(CouplingError::RollBack { unit: unit.name().into() });
        }
        let control = TimeControl::new(settings.time.clone(), &settings.output_times);
        let state = state.unwrap_or_else(|| State {
            number: 0,
            time: settings.time.start.0,
            pace: control.first(),
            history: Vec::new(),
            initial: Vec::new(),
            ranges: vec![NONE; interface.fields.len()],
            sensitivities: vec![Vec::new(); interface.fields.len()],
            accelerator: Accelerator::default(),
            forcing: newton_krylov::FORCING,
        });
        let (references, needs_references) = Default::default();
        let mut run = Self { units, interface, settings, references, needs_references, control, state };
        for unit in 0..run.interface.coupled {
            run.references[unit] = run.find_references(unit, iterates)?;
        }
        Ok(run)
    }

    /// The fields that a unit is given as references: those around which its partner's sensitivities are, and all where it needs them and
    /// the coupling iterates.
    fn find_references(&mut self, unit: usize, iterates: bool) -> Result<Vec<usize>, CouplingError> {
        let [needed, follow] = REFERENCES;
        let mut needs = Vec::new();
        if iterates && self.units[unit].has(needed) && self.units[unit].has(follow) {
            self.call(unit, |u| u.get(needed, &mut needs))?;
        }
        if needs == [1.0] {
            self.needs_references[unit] = true;
            self.call(unit, |u| u.set(follow, &needs))?;
            let own = self.interface.given_by(unit);
            return Ok(own.filter(|&f| self.units[unit].has(&reference_of(&self.interface.fields[f].name))).collect());
        }
        let partner = 1 - unit;
        let given = self.interface.given_by(partner).filter(|_| self.settings.scheme.connected[partner]);
        Ok(given.filter_map(|f| Some(self.interface.fields[f].sensitivity.as_ref()?.partner)).collect())
    }

    /// Whether [`checkpoint`](Self::checkpoint) works.
    pub fn has_checkpoints(&self) -> bool {
        self.units.iter().all(|unit| unit.can_serialise())
    }

    /// Everything needed to go on from here.
    ///
    /// # Errors
    /// [`CouplingError::Unit`] where a unit cannot serialise its state.
    pub fn checkpoint(&mut self) -> Result<Checkpoint, CouplingError> {
        let mut bytes = Vec::new();
        for unit in &mut self.units {
            bytes.push(unit.serialise().map_err(|error| CouplingError::unit(unit.as_ref(), error))?);
        }
        Ok(Checkpoint::new(&self.interface, &self.settings, self.state.clone(), bytes))
    }

    /// Time (s) up to which the run has got.
    pub fn time(&self) -> f64 {
        self.state.time
    }

    /// What may help where a time step fails, beside what the report says.
    pub fn remedy(&self) -> Option<&'static str> {
        let connected = self.settings.scheme.connected;
        let is_held = |unit: usize| self.needs_references[unit] && !connected[unit];
        is_held(crate::FLOW).then_some(
            "the flow has parts whose pressure only the rock's answer fixes, as sealed fractures with an incompressible fluid. Where a \
             block of rock is held by nothing but the pressures in them, mechanics has no one answer to given pressures, and only \
             coupling.split = \"undrained\" gets there",
        )
    }

    /// Whether the end is reached.
    pub fn is_finished(&self) -> bool {
        self.control.is_finished(self.state.time)
    }

    /// The fields at [`time`](Self::time), in the order of the interface.
    pub fn fields(&self) -> &[Vec<f64>] {
        self.state.history.last().map_or(&[], |(_, fields)| fields)
    }

    /// What the units exchange.
    pub fn interface(&self) -> &Interface {
        &self.interface
    }

    /// The units, to get other variables from.
    pub fn units(&mut self) -> &mut [Box<dyn Unit>] {
        &mut self.units
    }

    /// Does one time step: attempts, with halved steps after failures, until one is accepted.
    ///
    /// # Errors
    /// [`CouplingError::Failed`] with a report where no allowed time step can be done; [`CouplingError::Unit`] where a
    /// unit fails for good; [`CouplingError::Length`].
    pub fn advance(&mut self) -> Result<StepRecord, CouplingError> {
        self.advance_watched(&mut |_, _, _| {})
    }

    /// As [`advance`](Self::advance). `watch` is told of each coupling iteration: the end of the time step (s), its
    /// number from 1, and its record.
    ///
    /// # Errors
    /// As there.
    pub fn advance_watched(
        &mut self,
        watch: &mut dyn FnMut(f64, usize, &IterationRecord),
    ) -> Result<StepRecord, CouplingError> {
        let coupled = self.interface.coupled;
        (0..coupled).try_for_each(|unit| self.carry_to(unit))?;
        self.where_possible(|unit| unit.save())?;
        if self.refreshes(Refresh::TimeStep) || self.state.number == 0 {
            (0..coupled).try_for_each(|unit| self.get_sensitivities(unit))?;
        }
        let sensitivities = self.state.sensitivities.clone();
        let mut attempts = Vec::new();
        let mut pace = self.state.pace;
        loop {
            let end = self.control.next(self.state.time, pace);
            let step = end - self.state.time;
            let (mut attempt, fields, residual) = self.attempt(end, watch)?;
            let mut moved = coupled;
            if attempt.outcome.is_accepted() {
                moved = self.follow(step, &mut attempt)?;
            }
            let is_accepted = attempt.outcome.is_accepted();
            attempts.push(attempt);
            if is_accepted {
                return Ok(self.accept(end, pace, fields, attempts));
            }
            let can_roll_back = self.units[..moved].iter().all(|unit| unit.can_roll_back());
            self.where_possible(|unit| unit.restore())?;
            self.state.sensitivities.clone_from(&sensitivities);
            match self.control.failed(step).filter(|_| can_roll_back) {
                Some(shorter) => pace = shorter,
                None => return Err(self.failure(attempts, &residual, can_roll_back).into()),
            }
        }
    }

    /// Lets the units that follow the coupled ones do the time step once, one after the other, with what they are given
    /// at its end. Gives the number of units that were asked to move; where one discards, the attempt is discarded.
    fn follow(&mut self, step: f64, attempt: &mut Attempt) -> Result<usize, CouplingError> {
        for unit in self.interface.coupled..self.units.len() {
            let clock = Instant::now();
            self.carry_to(unit)?;
            let time = self.state.time;
            if let StepOutcome::Discarded { reason } = self.call(unit, |u| u.step(time, step))? {
                let name = self.units[unit].name().to_owned();
                attempt.outcome = AttemptOutcome::Discarded { unit: name, reason };
                return Ok(unit + 1);
            }
            if let Some(last) = attempt.iterations.last_mut() {
                last.seconds[unit] = clock.elapsed().as_secs_f64();
                last.newton[unit] = self.units[unit].newton_iterations();
            }
        }
        Ok(self.units.len())
    }

    /// Sets the inputs of a unit that are connected to outputs outside the coupling.
    fn carry_to(&mut self, unit: usize) -> Result<(), CouplingError> {
        let to_it = |c: &&Connection| c.to.0 == unit;
        for connection in self.interface.connections.iter().filter(to_it).cloned().collect::<Vec<_>>() {
            let Connection { from, to, conversion } = connection;
            let mut values = Vec::new();
            self.call(from.0, |u| u.get(&from.1, &mut values))?;
            conversion.apply(&mut values);
            self.call(unit, |u| u.set(&to.1, &values))?;
        }
        Ok(())
    }

    fn accept(&mut self, end: f64, pace: Pace, fields: Fields, attempts: Vec<Attempt>) -> StepRecord {
        let mut changes = std::collections::BTreeMap::new();
        if let Some((_, before)) = self.state.history.last() {
            for ((field, new), old) in self.interface.fields.iter().zip(&fields).zip(before) {
                let change = new.iter().zip(old).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                changes.insert(field.name.as_str(), change);
            }
        }
        let iterations = attempts.last().map_or(0, |a| a.iterations.len());
        let state = &mut self.state;
        state.pace = self.control.accepted(pace, end, end - state.time, iterations, &changes);
        state.accelerator.accept(self.settings.coupling.acceleration);
        state.widen(&fields);
        state.history.push((end, fields));
        if state.history.len() > 3 {
            state.history.remove(0);
        }
        state.time = end;
        state.number += 1;
        StepRecord { number: state.number, time: end, attempts }
    }

    /// Attempts to reach `end`: what happened, the fields, and their last residual.
    fn attempt(
        &mut self,
        end: f64,
        watch: &mut dyn FnMut(f64, usize, &IterationRecord),
    ) -> Result<(Attempt, Fields, Fields), CouplingError> {
        let coupling = &self.settings.coupling;
        let (loose, acceleration) = (coupling.loose, coupling.acceleration);
        let max_iterations = if loose { 1 } else { coupling.max_iterations };
        let step = end - self.state.time;
        let mut x = self.guess(end);
        let mut residual = Vec::new();
        let mut attempt = Attempt { step, iterations: Vec::new(), outcome: AttemptOutcome::NotConverged };
        self.state.accelerator.begin();
        let accelerated = self.accelerated();
        let mut least = f64::INFINITY;
        // The last fields as they came, for where a unit refuses what acceleration made of them.
        let mut plain = None;
        let mut search = Search::new(self.state.forcing);
        let mut estimate = Estimate::default();
        let (mut standstill, mut before_nudge) = (Standstill::default(), None::<Fields>);
        let weighing = self.weighing();
        for iteration in 1..=max_iterations {
            if iteration > 1 {
                self.each_coupled(|unit| unit.restore())?;
            }
            let (pass, trust) = self.careful_pass(&x, step, plain.is_none(), before_nudge.is_some())?;
            let (fields, mut record) = match pass {
                Pass::Done { fields, record } => (fields, record),
                Pass::Discarded { unit, reason } => {
                    if let Some(trial) = search.shorten() {
                        scatter(&accelerated, trial, &mut x);
                        continue;
                    }
                    if let Some(fields) = plain.take() {
                        x = fields;
                        self.state.accelerator.begin();
                        continue;
                    }
                    let unit = self.units[unit].name().to_owned();
                    attempt.outcome = AttemptOutcome::Discarded { unit, reason };
                    return Ok((attempt, x, residual));
                }
            };
            residual = (fields.iter().zip(&x)).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect();
            let scales = self.scales(&fields);
            record.residuals = self.residuals(&residual, &scales);
            let ratio = record.ratio();
            let newton = matches!(acceleration, Acceleration::NewtonKrylov { .. });
            let weights = self.weights(&accelerated, &fields, &weighing);
            let r: Vec<f64> = accelerated.iter().flat_map(|&f| residual[f].iter().copied()).collect();
            if before_nudge.is_none() {
                estimate.see(&fields, &residual, newton);
                search.see(&r, &weights);
            }
            let mut holds: Vec<bool> = record.residuals.iter().map(FieldResidual::holds).collect();
            if before_nudge.is_some() || holds.iter().all(|&holds| holds) {
                let weight = |f: usize| 1.0 / weighing[f] / (fields[f].len() as f64).sqrt();
                if let Some(error) = estimate.error(&accelerated, &weight, newton) {
                    let errors = self.residuals(&error, &scales);
                    holds.iter_mut().zip(errors).for_each(|(holds, error)| *holds &= error.holds());
                }
            }
            watch(end, iteration, &record);
            let finite = fields.iter().flatten().all(|v| v.is_finite());
            least = least.min(ratio);
            let outcome = if !finite {
                Some(AttemptOutcome::NotFinite)
            } else if loose || holds.iter().all(|&holds| holds) {
                Some(AttemptOutcome::Converged)
            } else if before_nudge.take().is_some_and(|before| self.is_round_off(&record, &holds, &fields, &before)) {
                Some(AttemptOutcome::RoundOff)
            } else {
                (ratio > DIVERGED * least).then_some(AttemptOutcome::Diverged)
            };
            if let Some(outcome) = outcome {
                attempt.iterations.push(record);
                attempt.outcome = outcome;
                self.state.forcing = search.forcing();
                return Ok((attempt, fields, residual));
            }
            if trust < 1.0 {
                attempt.iterations.push(record);
                // A pass with other sensitivities says nothing about those to come.
                self.state.accelerator.begin();
                estimate = Estimate::default();
                (plain, x) = (None, fields);
                continue;
            }
            if standstill.see(&record, &holds, &fields) {
                attempt.iterations.push(record);
                before_nudge = Some(fields);
                continue;
            }
            let mut flat: Vec<f64> = accelerated.iter().flat_map(|&f| x[f].iter().copied()).collect();
            if let Acceleration::NewtonKrylov { krylov } = acceleration {
                let scales = [&weighing[..], &scales];
                let at = At { x: &x, fields: &fields, step, accelerated: &accelerated, weights: &weights, scales };
                flat = self.newton_krylov(&mut search, &at, flat, &r, krylov, &mut record)?;
            } else {
                self.state.accelerator.next(acceleration, &mut flat, r, &weights);
            }
            // Fields that are not accelerated are only compared.
            attempt.iterations.push(record);
            plain = (acceleration != Acceleration::None).then(|| fields.clone());
            x = fields;
            scatter(&accelerated, flat, &mut x);
        }
        Ok((attempt, x, residual))
    }

    /// The first guess of the fields at `time`: Lagrange's polynomial through the last times.
    fn guess(&self, time: f64) -> Fields {
        let points = match self.settings.coupling.extrapolation {
            Extrapolation::Constant => 1,
            Extrapolation::Linear => 2,
            Extrapolation::Quadratic => 3,
        };
        let history = &self.state.history;
        let used = &history[history.len().saturating_sub(points)..];
        let mut guess: Fields =
            used.last().map_or_else(Vec::new, |(_, f)| f.iter().map(|f| vec![0.0; f.len()]).collect());
        for (i, (t, fields)) in used.iter().enumerate() {
            let others = used.iter().enumerate().filter(|&(j, _)| j != i);
            let weight: f64 = others.map(|(_, (s, _))| (time - s) / (t - s)).product();
            for (guess, field) in guess.iter_mut().zip(fields) {
                guess.iter_mut().zip(field).for_each(|(g, v)| *g += weight * v);
            }
        }
        guess
    }

    /// The fields that a pass depends on: what the first unit is given, and, where it has references, the point at which that was
    /// found.
    fn accelerated(&self) -> Vec<usize> {
        let first = self.settings.scheme.first;
        let mut list: Vec<usize> = self.interface.given_by(1 - first).collect();
        if !self.references[first].is_empty() {
            list.extend(self.interface.given_by(first));
        }
        list
    }

    /// A pass, with as much of the sensitivities as it takes; gives that part too.
    fn careful_pass(
        &mut self,
        x: &Fields,
        step: f64,
        is_plain: bool,
        nudged: bool,
    ) -> Result<(Pass, f64), CouplingError> {
        let scheme = self.settings.scheme;
        let can_try = is_plain && self.interface.coupled > 1 && scheme.connected[1 - scheme.first];
        let mut trust = TRUST.into_iter();
        let mut now = 1.0;
        loop {
            let pass = self.pass(x, step, now, nudged)?;
            // The unit that goes second has not been asked yet: both are as before.
            let is_refused = matches!(&pass, Pass::Discarded { unit, .. } if *unit == scheme.first);
            match trust.next().filter(|_| is_refused && can_try) {
                Some(less) => now = less,
                None => return Ok((pass, now)),
            }
        }
    }

    /// Lets the coupled units do the time step, each from the state it is in. `nudged`: what they are given differs in its last
    /// digits.
    fn pass(&mut self, x: &Fields, step: f64, trust: f64, nudged: bool) -> Result<Pass, CouplingError> {
        let mut fields = x.clone();
        let units = self.units.len();
        let (seconds, newton) = (vec![0.0; units], vec![None; units]);
        let mut record = IterationRecord { residuals: Vec::new(), seconds, newton, derivatives: 0 };
        let (first, coupled) = (self.settings.scheme.first, self.interface.coupled);
        for unit in [first, 1 - first].into_iter().filter(|&unit| unit < coupled) {
            let clock = Instant::now();
            if nudged {
                self.set_inputs(unit, &nudge(&fields), &nudge(x), trust)?;
            } else {
                self.set_inputs(unit, &fields, x, trust)?;
            }
            let time = self.state.time;
            let outcome = self.call(unit, |u| u.step(time, step))?;
            if let StepOutcome::Discarded { reason } = outcome {
                return Ok(Pass::Discarded { unit, reason });
            }
            self.get_outputs(unit, &mut fields)?;
            if self.refreshes(Refresh::Iteration) {
                self.get_sensitivities(unit)?;
            }
            record.seconds[unit] = clock.elapsed().as_secs_f64();
            record.newton[unit] = self.units[unit].newton_iterations();
        }
        Ok(Pass::Done { fields, record })
    }

    /// Gives a unit its partner's `fields`, with sensitivities around `reference`, its own fields at which its partner
    /// was evaluated. `trust` is a factor on the sensitivities.
    fn set_inputs(
        &mut self,
        unit: usize,
        fields: &Fields,
        reference: &Fields,
        trust: f64,
    ) -> Result<(), CouplingError> {
        let partner = 1 - unit;
        for f in self.interface.given_by(partner).collect::<Vec<_>>() {
            let field = self.interface.fields[f].clone();
            self.call(unit, |u| u.set(&field.name, &fields[f]))?;
            if self.settings.scheme.connected[partner]
                && let Some(sensitivity) = &field.sensitivity
            {
                let values = std::mem::take(&mut self.state.sensitivities[f]);
                if trust == 1.0 {
                    self.call(unit, |u| u.set(&sensitivity.variable, &values))?;
                } else {
                    let reduced: Vec<f64> = values.iter().map(|v| trust * v).collect();
                    self.call(unit, |u| u.set(&sensitivity.variable, &reduced))?;
                }
                self.state.sensitivities[f] = values;
            }
        }
        for f in self.references[unit].clone() {
            let own = reference_of(&self.interface.fields[f].name);
            self.call(unit, |u| u.set(&own, &reference[f]))?;
        }
        Ok(())
    }

    fn get_outputs(&mut self, unit: usize, fields: &mut Fields) -> Result<(), CouplingError> {
        for f in self.interface.given_by(unit).collect::<Vec<_>>() {
            let name = self.interface.fields[f].name.clone();
            let expected = self.state.history.last().map(|(_, fields)| fields[f].len());
            self.call(unit, |u| u.get(&name, &mut fields[f]))?;
            let found = fields[f].len();
            if let Some(expected) = expected.filter(|&e| e != found) {
                return Err(CouplingError::Length { field: name, found, expected });
            }
        }
        Ok(())
    }

    fn refreshes(&self, when: Refresh) -> bool {
        self.settings.coupling.sensitivity.refresh == when
    }

    /// Asks a unit for the sensitivities that are passed on.
    fn get_sensitivities(&mut self, unit: usize) -> Result<(), CouplingError> {
        if !self.settings.scheme.connected[unit] {
            return Ok(());
        }
        for f in self.interface.given_by(unit).collect::<Vec<_>>() {
            if let Some(sensitivity) = self.interface.fields[f].sensitivity.clone() {
                let mut values = std::mem::take(&mut self.state.sensitivities[f]);
                self.call(unit, |u| u.get(&sensitivity.variable, &mut values))?;
                self.state.sensitivities[f] = values;
            }
        }
        Ok(())
    }

    fn call<T>(
        &mut self,
        unit: usize,
        act: impl FnOnce(&mut dyn Unit) -> Result<T, UnitError>,
    ) -> Result<T, CouplingError> {
        let unit = self.units[unit].as_mut();
        act(unit).map_err(|error| CouplingError::unit(unit, error))
    }

    fn each_coupled(&mut self, act: impl Fn(&mut dyn Unit) -> Result<(), UnitError>) -> Result<(), CouplingError> {
        (0..self.interface.coupled).try_for_each(|unit| self.call(unit, &act))
    }

    /// Acts on all units that can roll back.
    fn where_possible(&mut self, act: impl Fn(&mut dyn Unit) -> Result<(), UnitError>) -> Result<(), CouplingError> {
        (0..self.units.len())
            .try_for_each(|unit| if self.units[unit].can_roll_back() { self.call(unit, &act) } else { Ok(()) })
    }

    fn failure(&self, attempts: Vec<Attempt>, residual: &Fields, can_roll_back: bool) -> Failure {
        let last = attempts.last().and_then(|a| a.iterations.last());
        let mut fields = Vec::new();
        for (f, &of) in last.iter().flat_map(|i| &i.residuals).enumerate().filter(|(_, r)| !r.holds()) {
            let mut entries: Vec<(usize, f64)> = residual[f].iter().copied().enumerate().collect();
            entries.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
            entries.truncate(REPORTED);
            let field = &self.interface.fields[f];
            fields.push(FailedField { name: field.name.clone(), unit: field.unit.clone(), residual: of, entries });
        }
        let minimum = can_roll_back.then(|| self.control.minimum());
        Failure { time: self.state.time, minimum, attempts, fields }
    }
}
