//! C3 straight from the libraries.

use tests::six_fractures::{Coupled, triangles};

#[test]
fn means() {
    let mut coupled = Coupled::new(triangles(0.04));
    println!("{} cells", coupled.mechanics.mesh().cell_count());
    for _ in 0..20 {
        let r = coupled.step(100.0, 0.0);
        println!(
            "{} {:.4e} {:.4e} {:.4e} its {} newton {} states {:?} {:?}",
            r.time, r.means[0], r.means[1], r.means[2], r.iterations, r.newton, r.states, r.mechanics.energy
        );
    }
}
