//! Fractures that nothing leaves, filled with an incompressible fluid: flow alone knows how much they must open, and mechanics alone at
//! which pressure. By all four splits, with the defaults, from any pressure.
//!
//! Blocks of height 1 m between walls without friction, E = 10 GPa, ν = ¼: λ = μ = 4 GPa, K_v = λ + 2μ = 12 GPa.

mod programs;

use std::fs;
use std::path::Path;

use programs::{call, fail, succeed};

const SPLITS: [&str; 4] = ["fixed_stress", "undrained", "drained", "fixed_strain"];
const K_V: f64 = 12e9;
const MU: f64 = 4e9;
/// Aperture in contact (m).
const CLOSED: f64 = 1e-4;

const BLOCKS: &str = r#"
mesh={box={low=[0,0],high=[1,2],cells=[4,8]},fractures.f="y>0.999 and y<1.001"}
regions.rock={young_modulus=1e10,poisson_ratio=0.25,permeability=1e-30}
fractures.f={friction.coulomb.coefficient=0.5,contact_aperture=1e-4,normal_permeability=0}
mechanics.displacement=[{on=["left","right"],x=0},{on=["bottom","top"],y=0}]
flow={wells.inj={fracture_face=[0.5,1],rate=1e-6,index=1e-10},boundary={top.pressure=0,bottom.pressure=0}}
"#;

/// The last value of a scalar of `series.csv`.
fn last(folder: &Path, name: &str) -> f64 {
    let text = fs::read_to_string(folder.join("series.csv")).unwrap();
    let at = text.lines().next().unwrap().split(',').position(|h| h.split(' ').next() == Some(name)).unwrap();
    text.lines().last().unwrap().split(',').nth(at).unwrap().parse().unwrap()
}

/// Runs a model to 100 s in ten time steps, and holds the means at the end against (name, value, relative error allowed).
fn check(model: &str, splits: &[&str], pressures: &[f64], changes: &[&str], wanted: &[(&str, f64, f64)]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    fs::create_dir(&path).unwrap();
    fs::write(path.join("model.toml"), format!("title=\"sealed\"\ntime={{end=100,step=10}}\n{model}")).unwrap();
    for split in splits {
        for pressure in pressures {
            let results = folder.path().join("results");
            let (split, start) = (format!("coupling.split={split}"), format!("initial.pressure={pressure}"));
            let mut run = vec!["run", path.to_str().unwrap(), "--quiet", "--overwrite"];
            run.extend(["--output", results.to_str().unwrap(), "--set", &split, "--set", &start]);
            run.extend(changes.iter().flat_map(|change| ["--set", change]));
            succeed(&run);
            // No time step was cut.
            assert_eq!(
                fs::read_to_string(results.join("attempts.csv")).unwrap().lines().count(),
                11,
                "{split} {start}"
            );
            for &(name, value, error) in wanted {
                let found = last(&results, name);
                assert!((found - value).abs() <= error * value.abs(), "{split} {start}, {name}: {found}, {value}");
            }
        }
    }
}

/// Two blocks that a jump w shortens: p_f = K_v w/2.
#[test]
fn a_fracture_takes_all_that_is_injected() {
    let wanted = [("fracture_pressure.mean", K_V * 1e-4 / 2.0, 1e-6), ("aperture.mean", CLOSED + 1e-4, 1e-6)];
    check(BLOCKS, &SPLITS, &[0.0, 1e6, 1e9, -1e6], &[], &wanted);
    // In 3D the same.
    let cube = BLOCKS
        .replace("low=[0,0],high=[1,2],cells=[4,8]", "low=[0,0,0],high=[1,1,2],cells=[2,2,4]")
        .replace("y>0.999 and y<1.001", "z>0.999 and z<1.001")
        .replace(r#"{on=["bottom","top"],y=0}"#, r#"{on=["front","back"],y=0},{on=["bottom","top"],z=0}"#)
        .replace("[0.5,1]", "[0.5,0.5,1]");
    check(&cube, &SPLITS, &[1e6], &[], &wanted);
    // Next to nothing leaks; fluids that are next to incompressible.
    check(BLOCKS, &SPLITS, &[1e6], &["fractures.f.normal_permeability=1e-40"], &wanted);
    check(BLOCKS, &SPLITS, &[1e6], &["flow.fluid.bulk_modulus=1e16"], &wanted);
}

/// (wⁿ − wⁿ⁻¹) + dⁿ⁻¹ (pⁿ − pⁿ⁻¹)/K_f = q δt with p = K_v w/2, from p = 0.
#[test]
fn a_fluid_that_gives_way_takes_its_part() {
    for bulk in [2e9, 1e11] {
        let w = (0..10).fold(0.0, |w: f64, _| w + 1e-5 / (1.0 + (CLOSED + w) * K_V / (2.0 * bulk)));
        let wanted = [("fracture_pressure.mean", K_V * w / 2.0, 1e-6), ("aperture.mean", CLOSED + w, 1e-6)];
        check(BLOCKS, &SPLITS, &[0.0], &[&format!("flow.fluid.bulk_modulus={bulk}")], &wanted);
    }
}

/// Under a top that is pressed down by 1 mm a fracture must first be opened: p_f = K_v (w + 1 mm)/2.
#[test]
fn a_closed_fracture_is_opened() {
    let pressed = BLOCKS.replace(r#"{on=["bottom","top"],y=0}"#, r#"{on=["bottom"],y=0},{on=["top"],y=-1e-3}"#);
    let wanted = [("fracture_pressure.mean", K_V * 1.1e-3 / 2.0, 1e-6), ("aperture.mean", CLOSED + 1e-4, 1e-6)];
    check(&pressed, &SPLITS, &[0.0, 1e6], &[], &wanted);
}

/// After 45 s nothing is injected any more: what is in stays in.
#[test]
fn a_fracture_that_is_shut_in_holds_its_pressure() {
    let source = BLOCKS.replace(
        "wells.inj={fracture_face=[0.5,1],rate=1e-6,index=1e-10}",
        "fracture_source=\"1e-6*min(1, max(0, 45.5-t))\"",
    );
    let wanted = [("fracture_pressure.mean", K_V * 4e-5 / 2.0, 1e-6), ("aperture.mean", CLOSED + 4e-5, 1e-6)];
    check(&source, &SPLITS, &[1e6], &[], &wanted);
}

/// Two fractures that cross, the walls around them sealed too: all blocks are shortened by e in both directions, p = 2 (λ + μ) e, and
/// the volume is 2·1 e + 1·2 e. The fluid is viscous, and its pressure not quite the same everywhere.
#[test]
fn a_network_shares_its_pressure() {
    let crossing = BLOCKS
        .replace(
            r#"fractures.f="y>0.999 and y<1.001""#,
            r#"fractures={f="y>0.999 and y<1.001",g="x>0.499 and x<0.501"}"#,
        )
        .replace(
            "fractures.f={",
            "fractures.f={friction.coulomb.coefficient=0.5,contact_aperture=1e-4,normal_permeability=0}\nfractures.g={",
        )
        .replace("[0.5,1]", "[0.5,0.75]")
        .replace("permeability=1e-30", "permeability=1e-30,biot_modulus=1e10")
        .replace(",boundary={top.pressure=0,bottom.pressure=0}", "");
    let e = 1e-4 / 4.0;
    let wanted = [("fracture_pressure.mean", 4.0 * MU * e, 1e-3), ("aperture.mean", CLOSED + 1e-4 / 3.0, 1e-6)];
    check(&crossing, &SPLITS, &[0.0], &[], &wanted);
}

/// Rock that is undrained and incompressible, free to one side: e = w/2 in y, −e in x, σ_x = 2μe − p_m = 0, p_f = −σ_y = 4μe.
#[test]
fn rock_that_neither_drains_nor_gives_way_is_held_too() {
    let rock = BLOCKS
        .replace("permeability=1e-30", "permeability=1e-30,biot_coefficient=1")
        .replace(r#"on=["left","right"]"#, r#"on=["left"]"#);
    let e = 0.5e-4;
    let wanted = [
        ("fracture_pressure.mean", 4.0 * MU * e, 1e-6),
        ("matrix_pressure.mean", 2.0 * MU * e, 1e-6),
        ("aperture.mean", CLOSED + 1e-4, 1e-6),
    ];
    check(&rock, &SPLITS, &[0.0, 1e6], &[], &wanted);
}

/// A block between two sealed fractures is held by the pressures in both alone: at pressures that differ mechanics closes one of them, at
/// equal ones any place will do. Only a mechanics that knows how pressures follow apertures finds the place: the undrained split. The
/// others say so.
#[test]
fn a_block_between_two_fractures_takes_the_undrained_split() {
    // The pore fluid of the block between needs storage, for nothing else holds its pressure.
    let stacked = BLOCKS
        .replace("permeability=1e-30", "permeability=1e-30,biot_modulus=1e10")
        .replace(
            r#"fractures.f="y>0.999 and y<1.001""#,
            r#"fractures={f="y>0.499 and y<0.501",g="y>1.499 and y<1.501"}"#,
        )
        .replace(
            "fractures.f={",
            "fractures.g={friction.coulomb.coefficient=0.5,contact_aperture=1e-4,normal_permeability=0}\nfractures.f={",
        )
        .replace(
            "wells.inj={fracture_face=[0.5,1]",
            "wells.two={fracture_face=[0.5,1.5],rate=2e-6,index=1e-10},wells.inj={fracture_face=[0.5,0.5]",
        );
    let wanted = [("fracture_pressure.mean", K_V * 3e-4 / 2.0, 1e-6), ("aperture.mean", CLOSED + 1.5e-4, 1e-6)];
    check(&stacked, &["undrained"], &[0.0, 1e6], &[], &wanted);
    let folder = tempfile::tempdir().unwrap();
    fs::write(
        folder.path().join("model.toml"),
        format!("title=\"stacked\"\ntime={{end=10,step=10,minimum=10}}\n{stacked}"),
    )
    .unwrap();
    let results = folder.path().join("results");
    let text = fail(&["run", folder.path().to_str().unwrap(), "--quiet", "--output", results.to_str().unwrap()], 1);
    assert!(text.contains("coupling.split = \"undrained\""), "{text}");
}

/// Where nobody iterates, nothing can hold such a part, and the message says what and where.
#[test]
fn what_nothing_holds_is_refused_where_nobody_iterates() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("model.toml"), format!("title=\"loose\"\ntime={{end=10,step=10}}\n{BLOCKS}")).unwrap();
    let results = folder.path().join("results");
    let run = ["run", folder.path().to_str().unwrap(), "--quiet", "--output", results.to_str().unwrap()];
    let output = call(&[&run[..], &["--set", "coupling={loose=true, acceleration=\"none\"}"]].concat());
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    for part in
        ["nothing fixes the pressure in 4 fracture faces", "fracture \"f\" at (0.125, 1.000, 0.000) m", "bulk modulus"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
}
