//! Speed of the mechanical unit on C2 and C4: `cargo bench -p tests --bench mechanics [-- c2-400]`.
//!
//! The floor of a mechanical solve is one triangular solve (`forward` and `backward`); all other parts are given as
//! multiples of it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use mechanics_fmu::{Bubbles, Mechanics, Model, Outcome, Partner, State, StepReport};
use mesh::Mesh;
use tests::contact_cases::{network_3d, single_crack};
use tests::memory::{peak, resident};

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    type Case = (&'static str, fn() -> (Mesh, Model));
    let cases: [Case; 5] = [
        ("c2-400", || (single_crack::triangles(320.0, 400, 0.06), single_crack::model(320.0))),
        ("c2-800", || (single_crack::triangles(320.0, 800, 0.035), single_crack::model(320.0))),
        ("c4-10k", || (network_3d::tetrahedra(0.085, 15), network_3d::model(Bubbles::OneSided))),
        ("c4-47k", || (network_3d::tetrahedra(0.048, 20), network_3d::model(Bubbles::OneSided))),
        ("c4-47k-two-sided", || (network_3d::tetrahedra(0.048, 20), network_3d::model(Bubbles::TwoSided))),
    ];
    for (name, make) in cases {
        if wanted.is_empty() || wanted.iter().any(|w| w == name) {
            run(name, make);
        }
    }
}

fn ms(t: Duration) -> f64 {
    1e3 * t.as_secs_f64()
}

fn run(name: &str, make: fn() -> (Mesh, Model)) {
    let start = Instant::now();
    let (mesh, model) = make();
    println!("{name}: {} cells, {} fracture faces", mesh.cell_count(), mesh.network().face_count());
    println!("  mesh            {:9.1} ms", ms(start.elapsed()));
    let partner = Partner::uniform(&mesh, 1e5);
    let before = resident();
    let start = Instant::now();
    let mut after = Vec::new();
    let mut ended = |_| after.push([resident(), peak()].map(|bytes| mb(bytes - before)));
    let mut mechanics = Mechanics::watched(Arc::new(mesh), model, &mut ended).unwrap_or_else(|e| panic!("{e}"));
    let total = start.elapsed();
    let s = *mechanics.setup();
    println!(
        "  set-up          {:9.1} ms, {} unknowns, {:.2} M in the factor",
        ms(total),
        s.unknowns,
        s.factor_entries as f64 / 1e6
    );
    let ratio = s.assembly.as_secs_f64() / s.factorisation.as_secs_f64();
    let stages = [
        ("analysis", s.analysis, String::new()),
        ("assembly", s.assembly, format!(", {ratio:.2} factorisations")),
        ("factorisation", s.factorisation, String::new()),
        ("condensation", s.condensation, String::new()),
    ];
    for ((name, time, more), [now, most]) in stages.into_iter().zip(after) {
        println!("    {name:13} {:9.1} ms{more}; {now:.1} MB above the mesh, at most {most:.1} so far", ms(time));
    }

    let mut state = mechanics.rest(0.0);
    let mut step = |label: &str, time: f64, state: &State, partner: &Partner| -> State {
        let clock = Instant::now();
        let outcome = mechanics.step(state, time, partner).unwrap_or_else(|e| panic!("{e}"));
        let Outcome::Converged(new, report) = outcome else { panic!("Newton's method gave up") };
        show(label, clock.elapsed(), &report);
        new
    };
    // C4 is driven in time; C2 has one load, so that its later steps only test the cost of a solve.
    for (k, time) in [100.0, 200.0, 300.0, 400.0].into_iter().enumerate() {
        state = step(&format!("step {}", k + 1), time, &state, &partner);
    }
    // What coupling iterations do: the same step under other pressures.
    for pressure in [1.0e5, 1.2e5, 1.21e5] {
        let faces = partner.fracture_pressure.len();
        let other = Partner { fracture_pressure: vec![pressure; faces], ..partner.clone() };
        step("coupling", 500.0, &state, &other);
    }
    let peak = peak();
    println!(
        "  memory: factor {:.0} MB, with all that goes with it {:.0} MB, peak above the mesh {:.1} MB = {:.3} factors",
        mb(s.factor_bytes[0]),
        mb(s.factor_bytes[1]),
        mb(peak - before),
        (peak - before) as f64 / s.factor_bytes[0] as f64
    );
}

fn show(label: &str, total: Duration, r: &StepReport) {
    let t = &r.times;
    let solve = (t.forward + t.backward).as_secs_f64();
    let newton = t.newton.as_secs_f64() / r.newton.iterations as f64;
    println!(
        "  {label:15} {:9.1} ms = {:5.1} triangular solves of {:.1} ms; loads {:.1} ms, energy {:.1} ms; {} Newton iterations of {:.1} ms = {:.1} solves, {} GMRES, {} dense factorisations",
        ms(total),
        total.as_secs_f64() / solve,
        1e3 * solve,
        ms(t.loads),
        ms(t.energy),
        r.newton.iterations,
        1e3 * newton,
        newton / solve,
        r.newton.linear_iterations,
        r.newton.face_factorisations,
    );
}

fn mb(bytes: usize) -> f64 {
    bytes as f64 / 1e6
}
