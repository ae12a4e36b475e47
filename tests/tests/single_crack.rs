//! C2: a crack under compression.

use std::sync::Arc;

use tests::contact_cases::{single_crack, solve_dry};

#[test]
fn slip_and_traction() {
    for faces in [50, 100, 200, 400, 800] {
        let t = std::time::Instant::now();
        let mesh = Arc::new(single_crack::triangles(320.0, faces, 0.1));
        println!("{faces} {} cells, mesh {:?}", mesh.cell_count(), t.elapsed());
        let t = std::time::Instant::now();
        let (mechanics, state, report) = solve_dry(mesh, single_crack::model(320.0));
        println!(
            "{:?} {:?} {} {:?}",
            single_crack::errors(&single_crack::profile(&mechanics, &state)),
            report.newton,
            mechanics.setup().factor_entries,
            t.elapsed()
        );
    }
}
