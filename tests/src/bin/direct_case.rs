//! Runs a case straight from the libraries: `direct-case RESOURCES FILE`.
//!
//! What the FMUs of the same resources give is held against it. `FILE` gets a line for each array: name, and numbers as
//! the 16 hexadecimal digits of their bits. Five time steps each of 100 s: mechanics alone at the initial pressure, flow
//! alone with apertures that grow by a quarter in each step after the first, and, by [`tests::six_fractures`], both by fixed stress
//! (means of aperture and pressures, and the arrays at the end).

use std::error::Error;
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;

use mechanics_fmu::{Mechanics, Outcome, Partner};
use tests::six_fractures::{Coupled, INITIAL_PRESSURE};

const STEP: f64 = 100.0;
const STEPS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [resources, file] = &arguments[..] else { return Err("two arguments are needed".into()) };
    let read = || coupling::read_resources(Path::new(resources)).map_err(|e| e.to_string());
    let mut text = String::new();
    let mut note = |name: &str, values: &[f64]| {
        let digits: Vec<String> = values.iter().map(|v| format!("{:016x}", v.to_bits())).collect();
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{name} {}", digits.join(" "));
    };

    let (document, mesh) = read()?;
    let mesh = Arc::new(mesh);
    let problem = mechanics_fmu::unit::problem(&document, &mesh).map_err(|e| e.to_string())?;
    let mut mechanics = Mechanics::new(Arc::clone(&mesh), problem)?;
    let partner = Partner::uniform(&mesh, INITIAL_PRESSURE);
    let Outcome::Converged(mut state, _) = mechanics.initial_equilibrium(0.0, &partner)? else {
        return Err("mechanics has no equilibrium at the initial pressure".into());
    };
    for step in 1..=STEPS {
        match mechanics.step(&state, step as f64 * STEP, &partner)? {
            Outcome::Converged(next, _) => state = next,
            Outcome::Discarded(why, _) => return Err(why.to_string().into()),
        }
        note(&format!("mechanics.fracture.aperture.{step}"), &mechanics.aperture(&state));
        note(&format!("mechanics.matrix.porosity_change.{step}"), &mechanics.porosity_change(&state));
        note(&format!("mechanics.fracture.displacement_jump.{step}"), state.jump(mechanics.space()));
    }

    let problem = flow_fmu::unit::flow_model(&document, &mesh).map_err(|e| e.to_string())?;
    let mut flow = flow_fmu::Flow::new(Arc::clone(&mesh), problem)?;
    let mut inputs = flow.inputs();
    let aperture = inputs.aperture.clone();
    for step in 1..=STEPS {
        // Apertures that grow drive the flow; else nothing would happen.
        let growth = 1.0 + 0.25 * (step - 1) as f64;
        inputs.aperture = aperture.iter().map(|d| d * growth).collect();
        let report = flow.step(STEP, &inputs)?;
        note(&format!("flow.matrix.pressure.{step}"), &flow.state().matrix_pressure);
        note(&format!("flow.fracture.pressure.{step}"), flow.fracture_pressure());
        note(&format!("flow.energy.boundary.{step}"), &[report.energy.boundary]);
    }

    let mut coupled = Coupled::new(read()?.1);
    for step in 1..=STEPS {
        let record = coupled.step(STEP, 0.0);
        note(&format!("coupled.means.{step}"), &record.means);
        println!(
            "{} s: {:?}, {} coupling iterations, {:?}",
            record.time, record.means, record.iterations, record.states
        );
    }
    note("coupled.fracture.aperture", &coupled.mechanics.aperture(&coupled.state));
    note("coupled.fracture.pressure", coupled.flow.fracture_pressure());
    note("coupled.matrix.pressure", &coupled.flow.state().matrix_pressure);
    std::fs::write(file, text)?;
    Ok(())
}
