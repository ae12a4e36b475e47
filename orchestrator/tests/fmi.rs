//! Units behind the C interface do what the same units do in this process.

#[allow(unreachable_pub, reason = "public where it is a library")]
#[path = "../examples/column.rs"]
mod column;

use std::path::{Path, PathBuf};

use column::ColumnUnit;
use column::toys::Toy;
use model::{Acceleration, Coupling, Number, Split, Time};
use orchestrator::fmi::Fmu;
use orchestrator::{Checkpoint, Interface, Run, Settings, StepOutcome, Unit};

const STRENGTHS: [f64; 3] = [0.6, 2.0, 5.0];

/// The library that was built with the tests.
fn library() -> PathBuf {
    let target = std::env::current_exe().unwrap();
    let name = format!("{}column{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    target.parent().unwrap().parent().unwrap().join("examples").join(name)
}

fn packed(folder: &Path, side: &str) -> Fmu {
    let resources = folder.join(side);
    std::fs::create_dir_all(&resources).unwrap();
    std::fs::write(resources.join("columns.txt"), format!("{side} {STRENGTHS:?}").replace(['[', ']', ','], " "))
        .unwrap();
    let path = folder.join(format!("{side}.fmu"));
    let contents =
        fmi_unit::Contents { library: library(), resources: Some(resources), ..fmi_unit::Contents::default() };
    fmi_unit::pack::<ColumnUnit>(&path, &contents).unwrap();
    Fmu::open(&path).unwrap()
}

fn settings() -> Settings {
    Settings {
        scheme: Split::FixedStress.into(),
        coupling: Coupling {
            acceleration: Acceleration::IqnIls { reuse: 2, initial: Number(1.0) },
            ..Coupling::default()
        },
        // The units discard the first step.
        time: Time { end: Number(1.0), step: Some(Number(0.2)), ..Time::default() },
        output_times: Vec::new(),
    }
}

fn units(fmus: &[Fmu; 2]) -> [Box<dyn Unit>; 2] {
    let make = |i: usize| {
        let mut unit = fmus[i].instantiate(["flow", "mechanics"][i]).unwrap();
        unit.initialise(0.0, 1.0).unwrap();
        Box::new(unit) as Box<dyn Unit>
    };
    [make(0), make(1)]
}

/// Units without fractures leave out what is on them.
fn interface(fmus: &[Fmu; 2]) -> Interface {
    let interface = Interface::poroelastic().fitted(&units(fmus)).unwrap();
    assert_eq!(interface.fields.len(), 2);
    assert_eq!(interface.fields[1].sensitivity.as_ref().unwrap().partner, 0);
    interface
}

fn bits(run: &Run) -> Vec<u64> {
    run.fields().iter().flatten().map(|v| v.to_bits()).collect()
}

#[test]
fn a_coupled_run_has_the_same_bits_as_without_fmi() {
    let folder = tempfile::tempdir().unwrap();
    let fmus = [packed(folder.path(), "flow"), packed(folder.path(), "mechanics")];
    let columns = STRENGTHS.map(column::column);
    let toys = [true, false].map(|is_flow| {
        let mut toy = Toy::new(is_flow, &columns);
        toy.rejects_above = 0.15;
        Box::new(toy) as Box<dyn Unit>
    });
    let mut direct = Run::new(toys, Interface::poroelastic(), settings()).unwrap();
    let mut run = Run::new(units(&fmus), interface(&fmus), settings()).unwrap();
    let mut stopped = None;
    while !direct.is_finished() {
        let (a, b) = (direct.advance().unwrap(), run.advance().unwrap());
        assert_eq!(a.attempts.len(), b.attempts.len());
        assert_eq!(a.iterations().len(), b.iterations().len());
        assert_eq!(a.iterations()[0].newton, b.iterations()[0].newton);
        assert_eq!(bits(&direct), bits(&run));
        if b.number == 2 {
            stopped = Some(run.checkpoint().unwrap().to_bytes().unwrap());
        }
    }
    assert!(run.is_finished() && run.fields()[0].iter().all(|p| *p > 1e5));
    // Other instances go on from the checkpoint.
    let checkpoint = Checkpoint::from_bytes(&stopped.unwrap()).unwrap();
    let mut resumed = Run::resume(units(&fmus), interface(&fmus), settings(), &checkpoint).unwrap();
    while !resumed.is_finished() {
        resumed.advance().unwrap();
    }
    assert_eq!(bits(&resumed), bits(&run));
}

#[test]
fn what_is_wrong_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = packed(folder.path(), "flow");
    let mut unit = fmu.instantiate("flow").unwrap();
    unit.initialise(0.0, 1.0).unwrap();
    let say = |e: orchestrator::UnitError| e.to_string();
    assert!(say(unit.set("pressure", &[1.0]).unwrap_err()).contains("no variable \"pressure\""));
    assert!(say(unit.set("matrix.porosity_change", &[1.0]).unwrap_err()).contains("has 3 entries, not 1"));
    assert!(matches!(unit.step(0.0, 0.5), Ok(StepOutcome::Discarded { reason }) if reason.contains("too long")));
    assert!(say(unit.restore().unwrap_err()).contains("no state was kept"));
    assert!(say(unit.deserialise(&[1, 2, 3]).unwrap_err()).len() > 10);
    assert_eq!(unit.derivative(&["matrix.pressure"], &[("matrix.porosity_change", &[0.0; 3])]), Ok(None));

    let path = folder.path().join("none.fmu");
    assert!(Fmu::open(&path).unwrap_err().to_string().contains("none.fmu"));
    std::fs::write(&path, "no archive").unwrap();
    assert!(Fmu::open(&path).unwrap_err().to_string().contains("it is no FMU"));
    // Corrupt resources.
    let bad = folder.path().join("bad");
    std::fs::create_dir_all(&bad).unwrap();
    std::fs::write(bad.join("columns.txt"), "flow 1").unwrap();
    let contents = fmi_unit::Contents { library: library(), resources: Some(bad), ..Default::default() };
    fmi_unit::pack::<ColumnUnit>(&path, &contents).unwrap();
    let fmu = Fmu::open(&path).unwrap();
    assert!(fmu.instantiate("bad").is_ok());
}

#[test]
fn instances_come_and_go() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = packed(folder.path(), "flow");
    for _ in 0..100 {
        let mut unit = fmu.instantiate("flow").unwrap();
        unit.initialise(0.0, 1.0).unwrap();
        unit.save().unwrap();
        assert_eq!(unit.step(0.0, 0.1), Ok(StepOutcome::Done));
        unit.restore().unwrap();
    }
}

/// The interface is that of the table from which the units have their variables.
#[test]
fn names_are_those_of_the_units() {
    let exchanged = |name: &str, referenced: bool| {
        let quantity = coupling::QUANTITIES.iter().find(|q| q.name == name && q.exchanged);
        quantity.filter(|q| q.referenced == referenced).map(|q| (q.unit, q.from == coupling::Role::Mechanics))
    };
    for field in Interface::poroelastic().fields {
        let from_mechanics = field.from == orchestrator::MECHANICS;
        assert_eq!(exchanged(&field.name, true), Some((field.unit.as_str(), from_mechanics)));
        let sensitivity = field.sensitivity.unwrap().variable;
        assert_eq!(exchanged(&sensitivity, false).unwrap().1, from_mechanics, "{sensitivity}");
    }
    assert_eq!(coupling::QUANTITIES.iter().filter(|q| q.exchanged).count(), 8);
}
