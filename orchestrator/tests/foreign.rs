//! Units that others made: FMI 2.0 with scalars and other units of measure, without rollback, without sensitivities, of
//! one time step only.

#[allow(dead_code, reason = "other tests use the rest of it")]
mod toys;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use coupling::{Role, Sizes};
use model::{Acceleration, Coupling, Number, Parameter, Split, Time};
use orchestrator::fmi::{Fmu, FmuUnit, Version, adapted};
use orchestrator::{
    AttemptOutcome, Checkpoint, CouplingError, Interface, Run, Settings, StepOutcome, StepRecord, Unit, UnitError,
};
use toys::{Column, Toy};

const MODULUS: f64 = 1e9;

/// The columns of the C file.
fn columns() -> [Column; 3] {
    [1.0, 2.0, 3.0].map(|i| Column {
        biot_modulus: i * MODULUS,
        leakage: 1e-9,
        hardening: 1e16,
        ..Column::of_strength(0.5)
    })
}

fn platform() -> &'static str {
    match std::env::consts::OS {
        "macos" => "darwin64",
        "windows" => "win64",
        _ => "linux64",
    }
}

/// The library of the C file.
fn library(folder: &Path) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/flow2.c");
    let path = folder.join(format!("flow2{}", std::env::consts::DLL_SUFFIX));
    let output = Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).arg(&path).arg(source).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    path
}

/// What the unit says it can.
#[derive(Clone, Copy)]
struct Able {
    state: bool,
    serialise: bool,
    any_step: bool,
}

const ALL: Able = Able { state: true, serialise: true, any_step: true };

fn packed(folder: &Path, able: Able) -> Fmu {
    let mut variables = String::new();
    for i in 0..3 {
        let variable = |name: &str, reference: usize, causality: &str, unit: &str| {
            format!(
                r#"<ScalarVariable name="{name}[{i}]" valueReference="{}" causality="{causality}"><Real {unit}/></ScalarVariable>"#,
                reference + i
            )
        };
        variables += &variable("matrix.pressure", 0, "output", r#"declaredType="Pressure""#);
        variables += &variable("matrix.porosity_change", 10, "input", r#"unit="1" start="0""#);
    }
    let xml = format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Three columns" guid="token">
<CoSimulation modelIdentifier="flow2" canHandleVariableCommunicationStepSize="{}" canGetAndSetFMUstate="{}" canSerializeFMUstate="{}"/>
<UnitDefinitions><Unit name="1"><BaseUnit/></Unit><Unit name="bar"><BaseUnit kg="1" m="-1" s="-2" factor="1e5"/></Unit></UnitDefinitions>
<TypeDefinitions><SimpleType name="Pressure"><Real unit="bar"/></SimpleType></TypeDefinitions>
<ModelVariables>{variables}
<ScalarVariable name="modulus" valueReference="20" causality="parameter"><Real start="1"/></ScalarVariable>
<ScalarVariable name="newton.iterations" valueReference="0" causality="output"><Integer/></ScalarVariable>
<ScalarVariable name="strict" valueReference="0" causality="parameter"><Boolean start="false"/></ScalarVariable>
<ScalarVariable name="label" valueReference="0" causality="parameter"><String start=""/></ScalarVariable>
</ModelVariables></fmiModelDescription>"#,
        able.any_step, able.state, able.serialise
    );
    let path = folder.join("flow2.fmu");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    let options = zip::write::SimpleFileOptions::default();
    zip.start_file("modelDescription.xml", options).unwrap();
    zip.write_all(xml.as_bytes()).unwrap();
    let name = format!("binaries/{}/flow2{}", platform(), std::env::consts::DLL_SUFFIX);
    zip.start_file(name, options).unwrap();
    zip.write_all(&std::fs::read(library(folder)).unwrap()).unwrap();
    zip.finish().unwrap();
    let mut fmu = Fmu::open(&path).unwrap();
    let fit = fmu.fit(Role::Flow, Sizes { cells: 3, fracture_faces: 0, dim: 2 });
    assert_eq!(fit.problems, [""; 0]);
    assert_eq!(fit.lacking.len(), 3);
    fmu
}

fn instance(fmu: &Fmu, is_strict: bool) -> FmuUnit {
    let mut unit = fmu.instantiate("flow").unwrap();
    unit.set_start("modulus", &Parameter::Number(MODULUS)).unwrap();
    unit.set_start("strict", &Parameter::Flag(is_strict)).unwrap();
    unit.set_start("label", &Parameter::Text("a label".into())).unwrap();
    unit.set_start("matrix.porosity_change", &Parameter::Numbers(vec![0.0; 3])).unwrap();
    unit.initialise(0.0, 1.0).unwrap();
    unit
}

fn settings(step: f64) -> Settings {
    Settings {
        scheme: Split::FixedStress.into(),
        coupling: Coupling { max_iterations: 100, ..Coupling::default() },
        time: Time { end: Number(1.0), step: Some(Number(step)), ..Time::default() },
        output_times: Vec::new(),
    }
}

fn start(flow: Box<dyn Unit>, step: f64) -> (Vec<Box<dyn Unit>>, Interface, Settings, Option<String>) {
    let units: Vec<Box<dyn Unit>> = vec![flow, Box::new(Toy::new(false, &columns()))];
    let mut interface = Interface::poroelastic();
    interface.fields.retain(|field| field.name.starts_with("matrix."));
    for (field, partner) in interface.fields.iter_mut().zip([1, 0]) {
        field.criterion.tolerance = Number(1e-10);
        field.sensitivity.as_mut().unwrap().partner = partner;
    }
    let interface = interface.fitted(&units).unwrap();
    let (settings, note) = settings(step).fitted(&interface);
    (units, interface, settings, note)
}

fn run(flow: Box<dyn Unit>, step: f64) -> Result<(Run, Vec<StepRecord>), CouplingError> {
    let (units, interface, settings, _) = start(flow, step);
    let mut run = Run::new(units, interface, settings)?;
    let mut records = Vec::new();
    while !run.is_finished() {
        records.push(run.advance()?);
    }
    Ok((run, records))
}

fn bits(run: &Run) -> Vec<u64> {
    run.fields().iter().flatten().map(|v| v.to_bits()).collect()
}

/// Of the fields there are no sensitivities: fixed strain with relaxation gives what our own flow gives with fixed stress.
#[test]
fn scalars_of_fmi_2_in_bar_give_the_same_as_arrays_in_pascal() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = packed(folder.path(), ALL);
    assert_eq!(fmu.description().version, Version::Two);
    let unit = instance(&fmu, false);
    let (_, interface, adapted, note) = start(Box::new(unit), 0.1);
    assert!(interface.fields.iter().all(|f| f.sensitivity.is_none()));
    assert_eq!(
        (adapted.scheme, adapted.coupling.acceleration),
        (Split::FixedStrain.into(), Acceleration::Aitken { initial: Number(0.5) })
    );
    let note = note.unwrap();
    assert!(note.contains("fixed stress becomes fixed strain") && note.contains("Aitken"), "{note}");
    let (foreign, records) = run(Box::new(instance(&fmu, false)), 0.1).unwrap();
    assert!(records.iter().all(|record| record.iterations().len() > 3));
    let (own, _) = run(Box::new(Toy::new(true, &columns())), 0.1).unwrap();
    for (a, b) in foreign.fields().iter().flatten().zip(own.fields().iter().flatten()) {
        assert!((a - b).abs() < 1e-7 * b.abs(), "{a} {b}");
    }
}

/// Without rollback all earlier time steps are done again. Results and checkpoints are the same to the last bit.
#[test]
fn a_unit_that_cannot_go_back_is_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = packed(folder.path(), ALL);
    let (whole, records) = run(adapted(instance(&fmu, false), false), 0.1).unwrap();
    for able in
        [Able { state: false, ..ALL }, Able { serialise: false, ..ALL }, Able { state: false, serialise: false, ..ALL }]
    {
        let fmu = packed(folder.path(), able);
        let unit = || adapted(instance(&fmu, false), false);
        let (units, interface, settings, _) = start(unit(), 0.1);
        let mut run = Run::new(units, interface, settings).unwrap();
        let mut bytes = Vec::new();
        for record in &records {
            let own = run.advance().unwrap();
            assert_eq!(own.iterations().len(), record.iterations().len());
            // It counts its time steps: those before, and the last one.
            assert_eq!(own.iterations()[0].newton[0], Some(own.number as u64));
            if own.number == 4 {
                bytes = run.checkpoint().unwrap().to_bytes().unwrap();
            }
        }
        assert_eq!(bits(&run), bits(&whole));
        let (units, interface, settings, _) = start(unit(), 0.1);
        let mut resumed = Run::resume(units, interface, settings, &Checkpoint::from_bytes(&bytes).unwrap()).unwrap();
        while !resumed.is_finished() {
            resumed.advance().unwrap();
        }
        assert_eq!(bits(&resumed), bits(&whole));
    }
    // Without it, coupling is loose or not at all.
    let fmu = packed(folder.path(), Able { state: false, ..ALL });
    let error = run(adapted(instance(&fmu, false), true), 0.1).unwrap_err();
    assert!(matches!(error, CouplingError::RollBack { .. }), "{error}");
}

#[test]
fn a_unit_of_one_time_step_says_so_where_another_is_needed() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = packed(folder.path(), Able { any_step: false, ..ALL });
    let (whole, _) = run(Box::new(instance(&fmu, false)), 0.1).unwrap();
    assert_eq!(whole.time(), 1.0);
    // The last of these is shorter.
    let error = run(Box::new(instance(&fmu, false)), 0.3).unwrap_err().to_string();
    assert!(error.contains("flow: it takes time steps of one size only") && error.contains("0.3 s"), "{error}");
    let fmu = packed(folder.path(), ALL);
    assert!(run(Box::new(instance(&fmu, false)), 0.3).is_ok());
}

#[test]
fn what_it_says_and_discards_is_passed_on() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = packed(folder.path(), ALL);
    let mut unit = instance(&fmu, true);
    assert_eq!(unit.text("label").unwrap(), "a label");
    let outcome = unit.step(0.0, 0.2).unwrap();
    assert_eq!(outcome, StepOutcome::Discarded { reason: "this time step is too long".into() });
    assert_eq!(unit.step(0.0, 0.1), Ok(StepOutcome::Done));
    assert_eq!(unit.take_messages(), [""; 0]);
    assert_eq!(unit.step(0.1, 0.1), Ok(StepOutcome::Done));
    assert_eq!(unit.take_messages(), ["this is the second time step"]);
    // A message with values, of any length.
    assert_eq!(unit.step(0.2, 0.1), Ok(StepOutcome::Done));
    assert_eq!(unit.take_messages(), [format!("flow took step 3 to 0.30 s{:>1000}", ".")]);
    let refused = unit.set("matrix.pressure", &[0.0; 3]).unwrap_err();
    assert_eq!(refused, UnitError::Refused { message: "no such input".into() });
    let error = unit.set_start("label", &Parameter::Number(1.0)).unwrap_err();
    assert!(matches!(error, UnitError::Unsupported { .. }), "{error}");
    assert!(unit.set_start("modulus", &Parameter::Text("1".into())).is_err());
    assert!(unit.set("matrix.porosity_change", &[0.0]).unwrap_err().to_string().contains("has 3 entries"));

    // In a run the time step is cut, with rollback and by replaying.
    for able in [ALL, Able { state: false, ..ALL }] {
        let fmu = packed(folder.path(), able);
        let (_, records) = run(adapted(instance(&fmu, true), false), 0.25).unwrap();
        let first = &records[0].attempts;
        assert!(matches!(&first[0].outcome, AttemptOutcome::Discarded { unit, .. } if unit == "flow"));
        assert_eq!((first.len(), first[1].step), (2, 0.125));
    }
}

#[test]
fn several_instances_of_one_fmu_do_not_disturb_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = packed(folder.path(), ALL);
    let mut units: Vec<FmuUnit> = (0..3).map(|_| instance(&fmu, false)).collect();
    for (i, unit) in units.iter_mut().enumerate() {
        unit.set("matrix.porosity_change", &[-1e-4 * i as f64; 3]).unwrap();
    }
    units.iter_mut().for_each(|unit| assert_eq!(unit.step(0.0, 0.1), Ok(StepOutcome::Done)));
    let mut values = Vec::new();
    for (i, unit) in units.iter_mut().enumerate() {
        unit.get("matrix.pressure", &mut values).unwrap();
        let expected = 1e-4 * i as f64 / (1.0 / MODULUS + 0.1 * 1e-9);
        assert!((values[0] - expected).abs() <= 1e-9 * expected, "{} {expected}", values[0]);
    }
}
