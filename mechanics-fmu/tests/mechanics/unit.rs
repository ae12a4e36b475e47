//! The unit behind the FMI: its derivatives by name, its states, and what it discards.

use fmi_unit::{Experiment, Log, StepOutcome, Type, Unit, Values, ValuesMut};
use mechanics_fmu::unit::MechanicsUnit;
use mesh::Mesh;
use model::Document;

use crate::common::largest;

/// Two blocks of rock with a fracture between them, its law, and what is prescribed.
fn unit(cells: [usize; 2], law: &str, mechanics: &str) -> MechanicsUnit {
    unit_on("low = [0, 0], high = [1, 2]", cells, law, mechanics)
}

fn unit_on(corners: &str, cells: [usize; 2], law: &str, mechanics: &str) -> MechanicsUnit {
    let text = format!(
        "title = 'blocks'
        mesh = {{ box = {{ {corners}, cells = [{}, {}] }}, fractures.f = 'y > 0.999 and y < 1.001' }}
        regions.rock = {{ young_modulus = 1e10, poisson_ratio = 0.25, biot_coefficient = 0.8 }}
        fractures.f = {{ contact_aperture = 1e-4, {law} }}
        {mechanics}
        time = {{ end = 1, step = 1 }}",
        cells[0], cells[1]
    );
    let document = Document::read("test", &text, &[], &[]).unwrap_or_else(|e| panic!("{e}"));
    let mesh: Mesh =
        document.mesh(std::path::Path::new("."), &|_, _| Err("no files".into())).unwrap_or_else(|e| panic!("{e}"));
    MechanicsUnit::new(&document, mesh, Log::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn get(unit: &mut MechanicsUnit, reference: u32, size: usize) -> Vec<f64> {
    let mut values = vec![0.0; size];
    unit.get(reference, ValuesMut::Float64(&mut values)).unwrap_or_else(|e| panic!("{e}"));
    values
}

fn named(unit: &mut MechanicsUnit, name: &str) -> Vec<f64> {
    let variable = unit.description().all_variables().find(|v| v.name() == name).unwrap();
    get(unit, variable.reference(), variable.size())
}

fn pattern(n: usize, seed: f64) -> Vec<f64> {
    (0..n).map(|k| (12.9898 * (k as f64 + seed)).sin()).collect()
}

/// Outputs of which there is no derivative: what mechanics believes, and what describes the last time step and no state.
const WITHOUT: [&str; 6] = [
    "fracture.aperture_compliance",
    "contact.violation",
    "energy.elastic",
    "energy.external_work",
    "energy.pressure_work",
    "energy.friction",
];

/// Each output against each input, those by which pressures follow included.
#[test]
fn all_outputs_have_their_derivatives_by_all_inputs() {
    let laws = [
        "friction.coulomb.coefficient = 0.3, dilation_angle = 0.2",
        "friction.coulomb.coefficient = 0.3, dilation_angle = 0.2, dilation = 'mechanical'",
        "friction.coulomb.coefficient = 0.3, normal_stiffness = 1e11, largest_closure = 8e-5",
        "friction.tresca.bound = 1e5, normal_stiffness = 1e11",
    ];
    let mechanics = "mechanics.displacement = [{ on = ['bottom'], x = 0, y = 0 }, { on = ['top'], x = '1e-3*x', y = '2e-4*(x - 0.6)' }]
        mechanics.newton.tolerance = 1e-13";
    for law in laws {
        for follows in [false, true] {
            let mut unit = unit([6, 6], law, mechanics);
            let variables: Vec<_> = unit.description().all_variables().collect();
            unit.initialize(&Experiment::default()).unwrap();
            let start = unit.save().unwrap();
            // Name, value, and size of the change.
            let size =
                |name: &str| variables.iter().find(|v| v.name() == name).map(|v| (v.reference(), v.size())).unwrap();
            let inputs = [
                ("matrix.pressure", 1e5, 300.0),
                ("fracture.pressure", 2e5, 300.0),
                ("matrix.pressure_stiffness", if follows { 8e9 } else { 0.0 }, 1e6),
                ("fracture.pressure_stiffness", if follows { 5e9 } else { 0.0 }, 1e6),
                ("matrix.porosity_change_reference", 1e-5, 1e-7),
                ("fracture.aperture_reference", 1.2e-4, 1e-8),
            ];
            let inputs = inputs.map(|(name, value, change)| {
                let (reference, n) = size(name);
                let values: Vec<f64> = pattern(n, 0.3).iter().map(|v| value * (1.0 + 0.1 * v)).collect();
                let change: Vec<f64> = pattern(n, 0.7).iter().map(|v| change * (1.5 + v)).collect();
                (name, reference, values, change)
            });
            let outputs: Vec<_> = (variables.iter())
                .filter(|v| v.ty() == Type::Float64 && !WITHOUT.contains(&v.name()) && is_output(v.name()))
                .map(|v| (v.name().to_owned(), v.reference(), v.size()))
                .collect();
            assert!(outputs.len() >= 14, "{outputs:?}");
            let run = |unit: &mut MechanicsUnit, moved: Option<(usize, f64)>| {
                unit.restore(&start).unwrap();
                for (i, (_, reference, values, change)) in inputs.iter().enumerate() {
                    let sign = moved.filter(|(number, _)| *number == i).map_or(0.0, |(_, sign)| sign);
                    let values: Vec<f64> = values.iter().zip(change).map(|(v, c)| v + sign * c).collect();
                    unit.set(*reference, Values::Float64(&values)).unwrap();
                }
                assert_eq!(unit.step(0.0, 1.0).unwrap(), StepOutcome::Completed);
                outputs.iter().map(|(_, reference, size)| get(unit, *reference, *size)).collect::<Vec<_>>()
            };
            // A stiffness of 0 cannot be lowered: a one-sided difference is not good enough, and steps of both signs are tested
            // where pressures follow.
            let moving = |name: &str| follows || !name.ends_with("stiffness");
            let mut table = Vec::new();
            for (i, (name, reference, _, change)) in inputs.iter().enumerate().filter(|(_, input)| moving(input.0)) {
                let (plus, minus) = (run(&mut unit, Some((i, 1.0))), run(&mut unit, Some((i, -1.0))));
                run(&mut unit, None);
                for (k, (output, of, size)) in outputs.iter().enumerate() {
                    let mut found = vec![0.0; *size];
                    unit.directional_derivative(&[*of], &[*reference], change, &mut found)
                        .unwrap_or_else(|e| panic!("{e}"));
                    let wanted: Vec<f64> = plus[k].iter().zip(&minus[k]).map(|(p, m)| 0.5 * (p - m)).collect();
                    table.push((*name, output.clone(), found, wanted));
                }
            }
            for (name, output, found, wanted) in &table {
                let of_output = table.iter().filter(|row| row.1 == *output);
                let size = largest(of_output.flat_map(|row| row.3.iter().copied()));
                let error = largest(found.iter().zip(wanted).map(|(f, w)| f - w));
                assert!(
                    error <= 1e-4 * size,
                    "{law}, following: {follows}: {output} by {name} is off by {error} of {size}"
                );
                let constant = ["matrix.porosity_compliance", "slip_tendency.max"].contains(&output.as_str());
                assert!(size > 0.0 || constant, "{law}: {output} does not move");
            }
        }
    }
}

/// Whether a variable is an output; the others are inputs, parameters and counters of work.
fn is_output(name: &str) -> bool {
    let input = name.ends_with("_reference") || name.ends_with("pressure") || name.ends_with("_stiffness");
    !(input || name.starts_with("work.") || name.ends_with(".factor") || name.ends_with(".floor") || name == "time")
}

#[test]
fn a_state_of_another_mesh_is_refused() {
    let held = "mechanics.displacement = [{ on = ['bottom'], x = 0, y = 0 }]";
    let make = |cells| unit(cells, "friction.coulomb.coefficient = 0.5", held);
    let [mut first, mut second] = [make([4, 4]), make([4, 8])];
    // As many cells, faces, vertices and fracture faces, but at other places.
    let mut third = unit_on("low = [0, 0], high = [1.5, 2]", [4, 4], "friction.coulomb.coefficient = 0.5", held);
    let state = first.save().unwrap();
    let bytes = first.serialize(&state).unwrap();
    assert!(first.deserialize(&bytes).is_ok());
    for unit in [&mut second, &mut third] {
        let error = unit.deserialize(&bytes).map(drop).unwrap_err().to_string();
        assert!(error.starts_with("the state belongs to another mesh: its fingerprint is"), "{error}");
    }
}

/// A joint that is too soft for its load: by default the aperture that is left is 1 % of that in contact; without it the step is
/// discarded, and the initial equilibrium refused, with what to do.
#[test]
fn no_aperture_of_nothing_is_published() {
    let loads = |equilibrium: bool| {
        format!(
            "mechanics.displacement = [{{ on = ['left', 'right'], x = 0 }}, {{ on = ['bottom'], y = 0 }}]
            mechanics.traction = [{{ on = ['top'], y = -1e7 }}]
            initial.equilibrium = {equilibrium}"
        )
    };
    let mut soft = unit([4, 8], "normal_stiffness = 1e10", &loads(false));
    soft.initialize(&Experiment::default()).unwrap();
    assert_eq!(soft.step(0.0, 1.0).unwrap(), StepOutcome::Completed);
    // The closure is 1 mm all the same.
    assert!((named(&mut soft, "fracture.displacement_jump")[0] - 1e-3).abs() < 1e-9);
    for name in ["aperture.min", "aperture.mean", "aperture.max"] {
        assert!((named(&mut soft, name)[0] - 1e-6).abs() < 1e-18, "{name}");
    }
    let mut hyperbolic = unit([4, 8], "normal_stiffness = 1e10, largest_closure = 9e-5", &loads(true));
    hyperbolic.initialize(&Experiment::default()).unwrap();
    let wanted = 1e-4 - 1e7 / (1e10 + 1e7 / 9e-5);
    assert!((named(&mut hyperbolic, "aperture.min")[0] - wanted).abs() < 1e-12);

    let without = "normal_stiffness = 1e10, residual_aperture = 0";
    let mut closed = unit([4, 8], without, &loads(false));
    closed.initialize(&Experiment::default()).unwrap();
    let why = "fracture \"f\" closes to an aperture of -9.000e-4 m at (";
    let remedies = "give it a largest_closure, which makes the law hyperbolic, or a residual_aperture above 0";
    match closed.step(0.0, 1.0).unwrap() {
        StepOutcome::Discarded(text) => {
            assert!(text.contains(why) && text.contains("4 such faces") && text.ends_with(remedies), "{text}");
        }
        other => panic!("{other:?}"),
    }
    // Nothing has changed.
    assert!((named(&mut closed, "aperture.min")[0] - 1e-4).abs() < 1e-18);
    let error = unit([4, 8], without, &loads(true)).initialize(&Experiment::default()).unwrap_err().to_string();
    assert!(
        error.starts_with("at the initial equilibrium ") && error.contains(why) && error.ends_with(remedies),
        "{error}"
    );
}
