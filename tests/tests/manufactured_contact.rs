//! C1: frictionless contact with a manufactured solution.

use std::sync::Arc;

use mesh::{Mesh, Vec3, generate::cartesian};
use tests::contact_cases::{manufactured, solve_dry};

#[test]
fn cartesian_boxes() {
    for n in [4, 8, 16, 24] {
        let mut data = cartesian(Vec3::splat(-1.0), Vec3::splat(1.0), [n; 3]);
        manufactured::mark(&mut data);
        let mesh = Arc::new(Mesh::new(data).unwrap());
        let (mechanics, state, report) = solve_dry(mesh, manufactured::model());
        println!("{n} {:?} {:?}", manufactured::errors(&mechanics, &state), report);
    }
}
