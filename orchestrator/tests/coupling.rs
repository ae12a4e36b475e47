//! The coupling loop on analytic units.

mod toys;

use model::{Acceleration, Coupling, Criterion, Extrapolation, Number, Split, Time};
use orchestrator::{AttemptOutcome, Checkpoint, CouplingError, Interface, Run, Settings, StepRecord, Unit};
use toys::{Column, Toy};

fn settings(split: Split, steps: usize) -> Settings {
    Settings {
        scheme: split.into(),
        coupling: Coupling { split, acceleration: Acceleration::None, max_iterations: 100, ..Coupling::default() },
        time: Time { end: Number(0.1 * steps as f64), step: Some(Number(0.1)), ..Time::default() },
        output_times: Vec::new(),
    }
}

fn units(columns: &[Column]) -> [Box<dyn Unit>; 2] {
    [Box::new(Toy::new(true, columns)), Box::new(Toy::new(false, columns))]
}

/// The interface, with criteria on the scale of the columns.
fn interface(tolerance: f64) -> Interface {
    let mut interface = Interface::poroelastic();
    for (field, floor) in interface.fields.iter_mut().zip([1e6, 1e6, 1e-3, 1e-3]) {
        field.criterion = Criterion { tolerance: Number(tolerance), floor: Number(floor), ..field.criterion };
    }
    interface
}

fn run(columns: &[Column], settings: Settings, tolerance: f64) -> Result<(Run, Vec<StepRecord>), CouplingError> {
    let mut run = Run::new(units(columns), interface(tolerance), settings)?;
    let mut records = Vec::new();
    while !run.is_finished() {
        records.push(run.advance()?);
    }
    Ok((run, records))
}

/// Coupling iterations of each time step.
fn counts(records: &[StepRecord]) -> Vec<usize> {
    records.iter().map(|r| r.iterations().len()).collect()
}

/// Ratio of the last residuals of a field that are above round-off, in the first time step.
fn contraction(record: &StepRecord, field: usize) -> f64 {
    let norms: Vec<f64> = record.iterations().iter().map(|i| i.residuals[field].norm).collect();
    norms[4] / norms[3]
}

fn failure(result: Result<(Run, Vec<StepRecord>), CouplingError>) -> orchestrator::Failure {
    match result {
        Err(CouplingError::Failed(failure)) => *failure,
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("it converged"),
    }
}

/// p and φ of a linear column at time t, without leakage: φ = −p/M, K φ/b = σ + b p.
fn exact(c: Column, t: f64) -> (f64, f64) {
    let b = c.biot_coefficient;
    let porosity = b * toys::load(t) / (c.stiffness + b * b * c.biot_modulus);
    (-c.biot_modulus * porosity, porosity)
}

/// Kim, Tchelepi, Juanes 2011: fixed strain and drained contract by τ = b²M/K_dr, fixed stress and undrained are
/// exact for a scalar with the right sensitivity.
#[test]
fn splits_have_the_contraction_of_theory() {
    for tau in [0.3, 0.7] {
        for split in [Split::FixedStrain, Split::Drained] {
            let (run, records) =
                run(&[Column::of_strength(tau)], settings(split, 1), 1e-12).unwrap_or_else(|e| panic!("{e}"));
            for field in [0, 2] {
                let found = contraction(&records[0], field);
                assert!((found - tau).abs() < 1e-6, "{split:?} {tau}: {found}");
            }
            let (pressure, _) = exact(Column::of_strength(tau), 0.1);
            assert!((run.fields()[0][0] / pressure - 1.0).abs() < 1e-10);
        }
    }
    for tau in [0.3, 3.0, 300.0] {
        // The load enters by mechanics: flow learns of it in the second pass. The last pass confirms.
        for (split, passes) in [(Split::FixedStress, 3), (Split::Undrained, 2)] {
            let (run, records) =
                run(&[Column::of_strength(tau)], settings(split, 2), 1e-11).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(counts(&records), [passes; 2], "{split:?} {tau}");
            let (pressure, porosity) = exact(Column::of_strength(tau), 0.2);
            assert!((run.fields()[0][0] / pressure - 1.0).abs() < 1e-9);
            assert!((run.fields()[2][0] / porosity - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn fixed_strain_and_drained_diverge_above_one() {
    for split in [Split::FixedStrain, Split::Drained] {
        let failure = failure(run(&[Column::of_strength(1.5)], settings(split, 1), 1e-9));
        // All halved steps fail alike: the toy has no leakage.
        assert_eq!(failure.attempts.len(), 11);
        assert!(failure.attempts.iter().all(|a| a.outcome == AttemptOutcome::Diverged));
        assert_eq!((failure.time, failure.minimum), (0.0, Some(0.1 / 1024.0)));
        let found = contraction(&StepRecord { number: 1, time: 0.0, attempts: vec![failure.attempts[0].clone()] }, 2);
        assert!((found - 1.5).abs() < 1e-6);
        assert_eq!(failure.fields[0].name, "matrix.pressure");
        assert_eq!(failure.fields[0].entries[0].0, 0);
        let text = failure.to_string();
        for part in ["0.1 s: the coupling diverged; residual/limit", "matrix.porosity_change: residual", "Pa"] {
            assert!(text.contains(part), "{text}");
        }
    }
}

/// With C = f b²/K_dr the contraction is |1 − f| τ/(1 + f τ): below 1 for all τ from f = ½ on.
#[test]
fn fixed_stress_converges_from_half_the_compliance_on() {
    let with = |factor: f64, tau: f64| {
        let columns = [Column::of_strength(tau)];
        let mut mechanics = Toy::new(false, &columns);
        mechanics.compliance_factor = factor;
        let units: [Box<dyn Unit>; 2] = [Box::new(Toy::new(true, &columns)), Box::new(mechanics)];
        Run::new(units, interface(1e-8), settings(Split::FixedStress, 1)).unwrap().advance()
    };
    for (factor, tau) in [(0.5, 3.0), (0.5, 10.0), (2.0, 10.0), (0.4, 2.0)] {
        let record = with(factor, tau).unwrap_or_else(|e| panic!("{e}"));
        let wanted = (1.0_f64 - factor).abs() * tau / (1.0 + factor * tau);
        assert!((contraction(&record, 2) - wanted).abs() < 1e-5, "{factor} {tau}");
    }
    assert!(with(0.4, 20.0).is_err());
}

/// Acceleration makes the conditional splits converge, in the number of iterations known for linear problems.
#[test]
fn acceleration_is_independent_of_the_split() {
    let columns = [0.5, 2.0, 8.0].map(Column::of_strength);
    let one = Number(1.0);
    for split in [Split::FixedStrain, Split::Drained] {
        assert!(run(&columns, settings(split, 1), 1e-9).is_err());
        let count = |columns: &[Column], acceleration, steps| {
            let mut settings = settings(split, steps);
            settings.coupling.acceleration = acceleration;
            counts(&run(columns, settings, 1e-9).unwrap_or_else(|e| panic!("{e}")).1)
        };
        // A scalar: the slope is known from two evaluations. The fields that are only compared agree one pass later.
        assert_eq!(count(&columns[1..2], Acceleration::Aitken { initial: Number(0.5) }, 1), [4]);
        assert_eq!(count(&columns[1..2], Acceleration::Relaxation { factor: Number(1.0 / 3.0) }, 1), [3]);
        // Three eigenvalues: four evaluations span the space.
        assert_eq!(count(&columns, Acceleration::Anderson { depth: 3, mixing: one }, 1), [6]);
        let found = count(&columns, Acceleration::IqnIls { reuse: 1, initial: Number(0.1) }, 3);
        assert_eq!(found[0], 6);
        assert!(found[1..].iter().all(|&n| n <= 3), "{found:?}");
        let forgetful = count(&columns, Acceleration::IqnIls { reuse: 0, initial: Number(0.1) }, 3);
        assert_eq!(forgetful, [6; 3]);
    }
}

#[test]
fn nonlinear_columns_converge_for_every_split_and_acceleration() {
    let column = |tau, hardening| Column { hardening, leakage: 1e-9, ..Column::of_strength(tau) };
    let columns = [column(0.6, 1e14), column(2.0, 1e15), column(5.0, 0.0)];
    let one = Number(1.0);
    let mut reference: Option<Vec<f64>> = None;
    for split in [Split::FixedStrain, Split::Drained, Split::FixedStress, Split::Undrained] {
        for acceleration in [
            Acceleration::None,
            Acceleration::Aitken { initial: Number(0.2) },
            Acceleration::Anderson { depth: 4, mixing: one },
            Acceleration::IqnIls { reuse: 2, initial: Number(0.2) },
            Acceleration::default(),
        ] {
            let conditional = matches!(split, Split::FixedStrain | Split::Drained);
            if conditional && matches!(acceleration, Acceleration::None | Acceleration::Aitken { .. }) {
                continue;
            }
            let mut settings = settings(split, 5);
            settings.coupling.acceleration = acceleration;
            let (run, records) = run(&columns, settings, 1e-10).unwrap_or_else(|e| panic!("{split:?} {e}"));
            println!("{split:?} {acceleration:?} {:?}", counts(&records));
            assert!(records.iter().all(|r| r.iterations()[0].newton[1].is_some_and(|n| n >= 3)));
            let found = run.fields()[0].clone();
            let reference = reference.get_or_insert_with(|| found.clone());
            let error = found.iter().zip(&*reference).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
            assert!(error < 1e-8, "{split:?} {acceleration:?}: {error:e}");
        }
    }
}

/// Newton's method takes one step on a linear problem, or two where GMRES's reduction by 1000 is too little, however strong
/// the coupling and whatever the split. Differences of time steps do the same as derivatives.
#[test]
fn newton_krylov_is_exact_for_linear_columns() {
    for split in [Split::FixedStrain, Split::Drained, Split::FixedStress, Split::Undrained] {
        for differentiates in [true, false] {
            let columns = [0.3, 1.5, 300.0].map(Column::of_strength);
            let (mut flow, mut mechanics) = (Toy::new(true, &columns), Toy::new(false, &columns));
            flow.log = mechanics.log.clone();
            (flow.differentiates, mechanics.differentiates) = (differentiates, differentiates);
            let log = flow.log.clone();
            let mut settings = settings(split, 1);
            settings.coupling.acceleration = Acceleration::default();
            let units: [Box<dyn Unit>; 2] = [Box::new(flow), Box::new(mechanics)];
            let mut run = Run::new(units, interface(1e-6), settings).unwrap();
            let record = run.advance().unwrap_or_else(|e| panic!("{split:?} {e}"));
            let passes = record.iterations().len();
            assert!(passes <= 4, "{split:?} {differentiates}: {passes}");
            for (i, column) in columns.iter().enumerate() {
                let (pressure, _) = exact(*column, 0.1);
                assert!((run.fields()[0][i] / pressure - 1.0).abs() < 1e-5, "{split:?} {i}");
            }
            // What the record counts is what the units did.
            let derivatives: usize = record.iterations().iter().map(|i| i.derivatives).sum();
            assert!(derivatives > 0);
            let log = log.lock().unwrap();
            let count = |what: &str| log.iter().filter(|line| **line == format!("toy flow {what}")).count();
            let wanted = if differentiates { (passes, derivatives) } else { (passes + derivatives, 0) };
            assert_eq!((count("step"), count("derivative")), wanted, "{split:?}");
        }
    }
}

/// Newton's step leads to porosities that flow refuses, a shorter one does not.
#[test]
fn newton_krylov_shortens_steps_that_a_unit_refuses() {
    let columns = [Column { hardening: 1e15, ..Column::of_strength(5.0) }];
    let run = |least: f64| {
        let mut flow = Toy::new(true, &columns);
        flow.least_porosity = least;
        let log = flow.log.clone();
        let units: [Box<dyn Unit>; 2] = [Box::new(flow), Box::new(Toy::new(false, &columns))];
        let mut settings = settings(Split::FixedStrain, 1);
        settings.coupling.acceleration = Acceleration::default();
        let mut run = Run::new(units, interface(1e-9), settings).unwrap();
        let record = run.advance().unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(record.attempts.len(), 1);
        let steps = log.lock().unwrap().iter().filter(|line| line.ends_with("step")).count();
        (run.fields()[2][0], steps - record.iterations().len())
    };
    let (porosity, refusals) = run(f64::NEG_INFINITY);
    assert_eq!(refusals, 0);
    let (same, refusals) = run(1.0001 * porosity);
    assert!(refusals > 0);
    assert!((same / porosity - 1.0).abs() < 1e-6, "{same} {porosity}");
}

/// Sensitivities that are ten thousand times too great contract by .9998, and make the error thousands of times the residual:
/// the criterion is for the error, whatever the acceleration. A plain iteration does not get there, and says so.
#[test]
fn a_slow_iteration_does_not_pass_for_a_converged_one() {
    const TOLERANCE: f64 = 1e-4;
    let one = Number(1.0);
    let column = Column::of_strength(1.0);
    for (acceleration, is_fast) in [
        (Acceleration::None, false),
        (Acceleration::Relaxation { factor: Number(1.5) }, false),
        (Acceleration::Aitken { initial: Number(0.5) }, true),
        (Acceleration::Aitken { initial: one }, true),
        (Acceleration::Anderson { depth: 5, mixing: one }, true),
        (Acceleration::IqnIls { reuse: 3, initial: one }, true),
        (Acceleration::default(), true),
    ] {
        let mut mechanics = Toy::new(false, &[column]);
        mechanics.compliance_factor = 1e4;
        let mut settings = settings(Split::FixedStress, 3);
        (settings.coupling.acceleration, settings.time.minimum) = (acceleration, settings.time.step);
        let units: [Box<dyn Unit>; 2] = [Box::new(Toy::new(true, &[column])), Box::new(mechanics)];
        let mut run = Run::new(units, interface(TOLERANCE), settings).unwrap();
        let mut passes = Vec::new();
        let result = (0..3).try_for_each(|_| run.advance().map(|record| passes.push(record.iterations().len())));
        println!("{acceleration:?}: {passes:?}");
        assert_eq!(result.is_ok(), is_fast, "{acceleration:?}: {passes:?}");
        let said = result.err().map(|error| error.to_string());
        assert!(said.is_none_or(|said| said.contains("shrink so slowly")), "{acceleration:?}");
        if is_fast {
            let (pressure, porosity) = exact(column, run.time());
            let error = [run.fields()[0][0] - pressure, run.fields()[2][0] - porosity];
            assert!(
                error[0].abs() < TOLERANCE * 1e6 && error[1].abs() < TOLERANCE * 1e-3,
                "{acceleration:?} {error:?}"
            );
        }
    }
}

/// Columns whose load is held after a second, and from which the fluid then leaks away: of each, the pressure falls by
/// S/(S + k δt) in a time step, S = b²/K + 1/M.
fn relaxing(background: f64) -> ([Column; 3], [f64; 3]) {
    const STEP: f64 = 0.1;
    let column = |tau: f64, leakage, background| Column { leakage, background, ..Column::of_strength(tau) };
    let columns = [column(0.7, 2e-9, background), column(2.0, 1.2e-9, 2.0 * background), column(0.4, 4e-9, background)];
    let factor = |c: Column| {
        let storage = c.biot_coefficient.powi(2) / c.stiffness + 1.0 / c.biot_modulus;
        storage / (storage + STEP * c.leakage)
    };
    (columns, columns.map(factor))
}

/// What is left of a pressure at the end is right to the tolerance, also where that is a millionth of what was there before.
/// One column alone, which has no range but in time, three that go to one pressure, and three that go back to where they were.
#[test]
fn criteria_follow_what_is_left() {
    const TOLERANCE: f64 = 1e-5;
    /// Of pressures (Pa).
    const FLOOR: f64 = 0.1;
    /// Passes are judged one by one: errors of many time steps, of a part of each other's size, add up to some times that.
    const ADDED: f64 = 5.0;
    for (background, count) in [(0.0, 1), (0.0, 3), (1e7, 3)] {
        let (columns, factors) = relaxing(background);
        for split in [Split::FixedStrain, Split::Drained, Split::FixedStress, Split::Undrained] {
            for acceleration in [
                Acceleration::default(),
                Acceleration::Aitken { initial: Number(0.5) },
                Acceleration::Anderson { depth: 4, mixing: Number(1.0) },
                Acceleration::IqnIls { reuse: 3, initial: Number(0.5) },
            ] {
                let mut toys = [true, false].map(|is_flow| Toy::new(is_flow, &columns[..count]));
                toys[1].held_from = 1.0;
                let [flow, mechanics] = toys;
                let units: [Box<dyn Unit>; 2] = [Box::new(flow), Box::new(mechanics)];
                let mut interface = Interface::poroelastic();
                for (field, floor) in interface.fields.iter_mut().zip([FLOOR, FLOOR, 1e-9 * FLOOR, 1e-9 * FLOOR]) {
                    field.criterion =
                        Criterion { tolerance: Number(TOLERANCE), floor: Number(floor), ..field.criterion };
                }
                let mut settings = settings(split, 120);
                settings.coupling.acceleration = acceleration;
                let mut run = Run::new(units, interface, settings).unwrap();
                (0..20).for_each(|_| drop(run.advance().unwrap_or_else(|e| panic!("{split:?} {acceleration:?} {e}"))));
                let mut wanted: Vec<f64> =
                    run.fields()[0].iter().zip(&columns).map(|(p, c)| p - c.background).collect();
                let first = wanted.clone();
                while !run.is_finished() {
                    run.advance().unwrap_or_else(|e| panic!("{split:?} {acceleration:?} {e}"));
                    wanted.iter_mut().zip(factors).for_each(|(p, factor)| *p *= factor);
                }
                let largest = |values: &[f64]| values.iter().fold(0.0f64, |m, v| m.max(v.abs()));
                let left = largest(&wanted);
                assert!(left < 1e-4 * largest(&first) && left > FLOOR, "{left}");
                for (i, (p, wanted)) in run.fields()[0].iter().zip(&wanted).enumerate() {
                    let error = (p - columns[i].background - wanted).abs();
                    assert!(
                        error <= ADDED * TOLERANCE * left,
                        "{background} {count} {split:?} {acceleration:?}: {error:e} of {left:e} Pa"
                    );
                }
            }
        }
    }
}

/// Tolerances down to nothing end at round-off and say so, whatever the acceleration; what is slow does not pass for that.
#[test]
fn tolerances_below_round_off_are_as_good_as_it_gets() {
    let (columns, _) = relaxing(1e7);
    let mut at_round_off = 0;
    for split in [Split::FixedStrain, Split::Drained, Split::FixedStress, Split::Undrained] {
        for acceleration in [
            Acceleration::None,
            Acceleration::default(),
            Acceleration::Aitken { initial: Number(0.5) },
            Acceleration::Anderson { depth: 4, mixing: Number(1.0) },
            Acceleration::IqnIls { reuse: 3, initial: Number(0.5) },
        ] {
            let conditional = matches!(split, Split::FixedStrain | Split::Drained);
            if conditional && acceleration == Acceleration::None {
                continue;
            }
            let mut settings = settings(split, 3);
            (settings.coupling.acceleration, settings.time.minimum) = (acceleration, settings.time.step);
            let mut outcomes = Vec::new();
            let mut run = Run::new(units(&columns), interface(1e-30), settings).unwrap();
            while !run.is_finished() {
                let record = run.advance().unwrap_or_else(|e| panic!("{split:?} {acceleration:?} {e}"));
                outcomes.extend(record.attempts.into_iter().map(|a| a.outcome));
            }
            // A residual of exactly 0 is allowed by any tolerance.
            assert!(outcomes.iter().all(AttemptOutcome::is_accepted), "{outcomes:?}");
            at_round_off += outcomes.iter().filter(|o| **o == AttemptOutcome::RoundOff).count();
            for (i, c) in columns.iter().enumerate() {
                // K φ/b = σ + b (p − p⁰)
                let [p, porosity] = [0, 2].map(|f| run.fields()[f][i]);
                let b = c.biot_coefficient;
                let defect = c.stiffness * porosity / b - toys::load(run.time()) - b * (p - c.background);
                assert!(defect.abs() < 1e-14 * 1e7, "{split:?} {acceleration:?}: {defect:e} Pa");
            }
        }
    }
    assert!(at_round_off > 10, "{at_round_off}");
    // A plain iteration that contracts by .9998 seems to stand still too.
    let column = Column::of_strength(1.0);
    let mut mechanics = Toy::new(false, &[column]);
    mechanics.compliance_factor = 1e4;
    let units: [Box<dyn Unit>; 2] = [Box::new(Toy::new(true, &[column])), Box::new(mechanics)];
    let mut settings = settings(Split::FixedStress, 1);
    (settings.time.minimum, settings.coupling.max_iterations) = (settings.time.step, 1000);
    let error = Run::new(units, interface(1e-30), settings).unwrap().advance().unwrap_err();
    assert!(matches!(error, CouplingError::Failed(_)), "{error}");
}

/// On a load that grows linearly, linear extrapolation guesses right from the second time step on.
#[test]
fn extrapolation_guesses() {
    let leaking = Column { hardening: 0.0, ..Column::of_strength(0.5) };
    let count = |extrapolation| {
        let mut settings = settings(Split::FixedStrain, 5);
        settings.coupling.extrapolation = extrapolation;
        let (_, records) = run(&[leaking], settings, 1e-6).unwrap();
        records.iter().map(|r| r.iterations()[0].residuals[2].norm).collect::<Vec<f64>>()
    };
    let [constant, linear, quadratic] =
        [Extrapolation::Constant, Extrapolation::Linear, Extrapolation::Quadratic].map(count);
    assert_eq!((constant[0], constant[1]), (linear[0], linear[1].max(constant[1])));
    assert!(linear[4] < 0.1 * constant[4], "{linear:?} {constant:?}");
    assert!(quadratic[4] < 0.1 * linear[4], "{quadratic:?} {linear:?}");
}

#[test]
fn a_discarded_step_is_tried_again_with_half() {
    let columns = [Column::of_strength(2.0)];
    let mut flow = Toy::new(true, &columns);
    (flow.rejects_above, flow.rejects_after) = (0.06, 0.15);
    let units: [Box<dyn Unit>; 2] = [Box::new(flow), Box::new(Toy::new(false, &columns))];
    let mut run = Run::new(units, interface(1e-9), settings(Split::Undrained, 3)).unwrap();
    let mut records = Vec::new();
    while !run.is_finished() {
        records.push(run.advance().unwrap());
    }
    assert_eq!(records[0].attempts.len(), 1);
    let outcome = &records[1].attempts[0].outcome;
    assert!(matches!(outcome, AttemptOutcome::Discarded { unit, .. } if unit == "toy flow"));
    let steps: Vec<f64> = records[1].attempts.iter().map(|a| a.step).collect();
    assert!(steps.len() == 2 && (steps[0] - 0.1).abs() + (steps[1] - 0.05).abs() < 1e-12, "{steps:?}");
    assert!((records[1].time - 0.15).abs() < 1e-12);
    assert_eq!(records.last().unwrap().time, run.time());
    // Rejected attempts leave no trace: the column has no memory but its balance.
    let (pressure, _) = exact(columns[0], run.time());
    assert!((run.fields()[0][0] / pressure - 1.0).abs() < 1e-9);
}

/// A unit refuses what a first relaxation by 1.9 makes of the fields, but not the fields as they came.
#[test]
fn a_pass_that_acceleration_spoils_is_made_without_it() {
    let columns = [Column::of_strength(0.5)];
    let mut flow = Toy::new(true, &columns);
    // 1.2 times what the first pass gives.
    flow.least_porosity = 1.2 * 0.8 * toys::load(0.1) / columns[0].stiffness;
    let units: [Box<dyn Unit>; 2] = [Box::new(flow), Box::new(Toy::new(false, &columns))];
    let mut settings = settings(Split::FixedStrain, 1);
    settings.coupling.acceleration = Acceleration::IqnIls { reuse: 0, initial: Number(1.9) };
    let mut run = Run::new(units, interface(1e-9), settings).unwrap();
    let record = run.advance().unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(record.attempts.len(), 1);
    let (pressure, _) = exact(columns[0], 0.1);
    assert!((run.fields()[0][0] / pressure - 1.0).abs() < 1e-7);
}

#[test]
fn a_field_that_is_not_finite_stops_the_run_with_a_report() {
    let columns = [Column::of_strength(2.0)];
    let mut mechanics = Toy::new(false, &columns);
    mechanics.breaks_at = 0.15;
    let units: [Box<dyn Unit>; 2] = [Box::new(Toy::new(true, &columns)), Box::new(mechanics)];
    let mut settings = settings(Split::FixedStress, 3);
    settings.time.minimum = Some(Number(0.05));
    let mut run = Run::new(units, interface(1e-9), settings).unwrap();
    run.advance().unwrap();
    let before = run.fields().to_vec();
    let Err(CouplingError::Failed(failure)) = run.advance() else { panic!() };
    let outcomes: Vec<_> = failure.attempts.iter().map(|a| a.outcome.clone()).collect();
    assert_eq!(outcomes, [AttemptOutcome::NotFinite, AttemptOutcome::NotFinite]);
    assert!(failure.fields.iter().any(|f| f.name == "matrix.porosity_change"));
    // The run stands where it was.
    assert_eq!((run.time(), run.fields()), (0.1, &before[..]));
    let mut pressure = Vec::new();
    run.units()[0].get("matrix.pressure", &mut pressure).unwrap();
    assert_eq!(pressure, before[0]);
}

#[test]
fn loose_coupling_needs_no_roll_back() {
    let columns = [Column { leakage: 1e-9, ..Column::of_strength(0.5) }];
    let rigid = || {
        let mut units = [Toy::new(true, &columns), Toy::new(false, &columns)];
        units.iter_mut().for_each(|u| u.rolls_back = false);
        let [flow, mechanics] = units;
        [Box::new(flow) as Box<dyn Unit>, Box::new(mechanics)]
    };
    let error = Run::new(rigid(), interface(1e-9), settings(Split::FixedStress, 1)).unwrap_err();
    assert!(matches!(error, CouplingError::RollBack { .. }), "{error}");
    let end = |steps: usize| {
        let mut settings = settings(Split::FixedStress, 1);
        settings.coupling.loose = true;
        settings.time = Time { end: Number(4.0), step: Some(Number(4.0 / steps as f64)), ..Time::default() };
        let mut run = Run::new(rigid(), interface(1e-9), settings).unwrap();
        while !run.is_finished() {
            assert_eq!(run.advance().unwrap().iterations().len(), 1);
        }
        run.fields()[0][0]
    };
    // First order in time against a fine run.
    let reference = end(4096);
    let errors = [end(16), end(32), end(64)].map(|p| (p - reference).abs());
    assert!(errors[0] / errors[1] > 1.8 && errors[1] / errors[2] > 1.8, "{errors:?}");
}

/// Without roll back a discarded step cannot be tried again.
#[test]
fn loose_coupling_stops_at_a_discarded_step() {
    let columns = [Column::of_strength(0.5)];
    let mut mechanics = Toy::new(false, &columns);
    (mechanics.rolls_back, mechanics.rejects_above) = (false, 0.01);
    let units: [Box<dyn Unit>; 2] = [Box::new(Toy::new(true, &columns)), Box::new(mechanics)];
    let mut settings = settings(Split::FixedStress, 1);
    settings.coupling.loose = true;
    let Err(CouplingError::Failed(failure)) = Run::new(units, interface(1e-9), settings).unwrap().advance() else {
        panic!()
    };
    assert_eq!((failure.attempts.len(), failure.minimum), (1, None));
    assert!(failure.to_string().contains("cannot roll back"));
}

#[test]
fn a_resumed_run_gives_the_same_bits() {
    let column = |tau, hardening| Column { hardening, leakage: 1e-9, ..Column::of_strength(tau) };
    let columns = [column(0.6, 1e14), column(2.0, 1e15), column(5.0, 0.0)];
    let mut settings = settings(Split::FixedStress, 8);
    settings.coupling.acceleration = Acceleration::IqnIls { reuse: 2, initial: Number(0.7) };
    settings.coupling.extrapolation = Extrapolation::Quadratic;
    settings.time.adaptive = Some(model::Adaptive::default());
    let bits = |run: &Run| -> Vec<u64> { run.fields().iter().flatten().map(|v| v.to_bits()).collect() };
    for stop in 1..5 {
        let mut whole = Run::new(units(&columns), interface(1e-9), settings.clone()).unwrap();
        (0..stop).for_each(|_| drop(whole.advance().unwrap()));
        let bytes = whole.checkpoint().unwrap().to_bytes().unwrap();
        let checkpoint = Checkpoint::from_bytes(&bytes).unwrap();
        assert_eq!((checkpoint.number(), checkpoint.time()), (stop, whole.time()));
        let mut resumed = Run::resume(units(&columns), interface(1e-9), settings.clone(), &checkpoint).unwrap();
        while !whole.is_finished() {
            let (a, b) = (whole.advance().unwrap(), resumed.advance().unwrap());
            assert_eq!((a.number, a.time.to_bits()), (b.number, b.time.to_bits()));
            assert_eq!(a.iterations().len(), b.iterations().len());
            assert_eq!(bits(&whole), bits(&resumed));
        }
        assert!(resumed.is_finished());
        // What is not this run is refused.
        let mut other = settings.clone();
        other.time.end = Number(2.0);
        assert!(Run::resume(units(&columns), interface(1e-9), other, &checkpoint).is_err());
        for broken in [&bytes[..bytes.len() - 1], &bytes[1..], &[], &bytes[..20]] {
            assert!(Checkpoint::from_bytes(broken).is_err());
        }
    }
}

/// Order of calls and sensitivities of each split.
#[test]
fn splits_are_an_order_and_what_is_connected() {
    for (split, first, wanted) in [
        (Split::FixedStrain, "toy flow", None),
        (Split::Drained, "toy mechanics", None),
        (Split::FixedStress, "toy flow", Some("toy flow set matrix.porosity_compliance")),
        (Split::Undrained, "toy mechanics", Some("toy mechanics set matrix.pressure_stiffness")),
    ] {
        let columns = [Column::of_strength(0.5)];
        let (mut flow, mechanics) = (Toy::new(true, &columns), Toy::new(false, &columns));
        flow.log = mechanics.log.clone();
        let log = flow.log.clone();
        let mut run = Run::new(
            [Box::new(flow) as Box<dyn Unit>, Box::new(mechanics)],
            Interface::poroelastic(),
            settings(split, 1),
        )
        .unwrap();
        run.advance().unwrap();
        let log = log.lock().unwrap();
        assert_eq!(log.iter().find(|l| l.ends_with("step")).unwrap(), &format!("{first} step"));
        let sensitivities: Vec<_> =
            log.iter().filter(|l| l.contains("compliance") || l.contains("stiffness")).collect();
        assert_eq!(!sensitivities.is_empty(), wanted.is_some(), "{split:?}");
        assert!(wanted.is_none_or(|w| log.iter().any(|l| l == w)), "{split:?} {log:?}");
        assert_eq!(log.iter().any(|l| l.contains("_reference")), wanted.is_some());
    }
}

#[test]
fn units_must_have_the_same_fields() {
    let mut interface = Interface::poroelastic();
    interface.fields[1].name = "fracture.temperature".into();
    let columns = [Column::of_strength(0.5)];
    let fitted = interface.clone().fitted(&units(&columns)).unwrap();
    // The aperture has lost its partner; the others have new numbers.
    let partners: Vec<_> = fitted.fields.iter().map(|f| f.sensitivity.as_ref().map(|s| s.partner)).collect();
    assert_eq!(partners, [Some(1), Some(0), None]);
    let mut flow = Toy::new(true, &columns);
    flow.set_new("fracture.temperature");
    let error = interface.fitted(&[Box::new(flow), Box::new(Toy::new(false, &columns))]).unwrap_err();
    assert_eq!(error.to_string(), "toy mechanics has no variable \"fracture.temperature\", but its partner has");
}

/// The note names the fields whose sensitivities the split connects, and no others.
#[test]
fn a_missing_sensitivity_is_told_where_the_split_connects_it() {
    let mut interface = Interface::poroelastic();
    (interface.fields[0].sensitivity, interface.fields[3].sensitivity) = (None, None);
    for (split, wanted) in [
        (
            Split::FixedStress,
            Some("of fracture.aperture: for these fields the split fixed stress becomes fixed strain"),
        ),
        (Split::Undrained, Some("of matrix.pressure: for these fields the split undrained becomes drained")),
        (Split::Drained, None),
    ] {
        let (fitted, note) = settings(split, 1).fitted(&interface);
        assert_eq!(note.is_some(), wanted.is_some());
        assert!(wanted.is_none_or(|wanted| note.as_ref().is_some_and(|note| note.contains(wanted))), "{note:?}");
        // The other field of the unit keeps its own.
        assert_eq!(fitted.scheme, split.into());
    }
    (interface.fields[2].sensitivity, interface.fields[3].sensitivity) = (None, None);
    assert_eq!(settings(Split::FixedStress, 1).fitted(&interface).0.scheme, Split::FixedStrain.into());
}

#[test]
fn wrong_use_is_an_error() {
    let columns = [Column::of_strength(0.5)];
    let one = || [Box::new(Toy::new(true, &columns)) as Box<dyn Unit>];
    let error = Run::new(one(), Interface::poroelastic(), settings(Split::FixedStress, 1)).unwrap_err();
    assert_eq!(error.to_string(), "the interface is between 2 units, not 1");
    let mut interface = Interface::poroelastic();
    interface.fields[0].name = "matrix.temperature".into();
    let error = Run::new(units(&columns), interface, settings(Split::FixedStress, 1)).unwrap_err();
    assert_eq!(error.to_string(), "toy flow: there is no variable \"matrix.temperature\"");
    let two = [Box::new(Toy::new(true, &columns)) as Box<dyn Unit>, Box::new(Toy::new(false, &[columns[0]; 2]))];
    let mut run = Run::new(two, Interface::poroelastic(), settings(Split::FixedStrain, 1)).unwrap();
    let error = run.advance().unwrap_err();
    assert_eq!(error.to_string(), "toy flow: \"matrix.porosity_change\" has 1 entries, not 2");
}
