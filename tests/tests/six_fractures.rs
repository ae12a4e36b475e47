//! C3 straight from the libraries, against the reference of a prototype of the same scheme on other triangles.

use tests::six_fractures::{Coupled, triangles};

/// Time (s), mean d_f (m), mean p_f and p_m (Pa), for fracture faces of 0.04 m.
const REFERENCE: [[f64; 4]; 4] = [
    [100.0, 9.279e-5, 9.476e5, 8.578e5],
    [500.0, 1.0113e-4, 1.918e6, 1.707e6],
    [1000.0, 9.866e-5, 2.113e5, 1.967e5],
    [2000.0, 9.849e-5, 1.0042e5, 1.0036e5],
];

#[test]
fn means_iterations_and_energy() {
    let mut coupled = Coupled::new(triangles(0.04));
    let (mut compared, mut elastic) = (0, 0.0);
    for _ in 0..20 {
        let r = coupled.step(100.0, 0.0);
        for row in REFERENCE.iter().filter(|row| row[0] == r.time) {
            for k in 0..3 {
                let off = r.means[k] / row[k + 1] - 1.0;
                assert!(off.abs() < 0.02, "t = {} s, mean {k}: {} against {}", r.time, r.means[k], row[k + 1]);
                compared += 1;
            }
        }
        assert!(r.iterations <= 9, "{} coupling iterations at {} s", r.iterations, r.time);
        let [open, stick, slip] = r.states;
        if r.time <= 500.0 {
            assert!(slip > stick, "most faces slip at {} s: {:?}", r.time, r.states);
        } else {
            assert!(slip == 0 && open > 0, "closed faces stick at {} s: {:?}", r.time, r.states);
        }
        // What loads and pressures did goes into elastic energy and friction; an implicit step loses more than it must.
        let e = r.mechanics.energy;
        assert!(e.friction >= -1e-9 * e.elastic, "{e:?}");
        let gained = e.elastic - std::mem::replace(&mut elastic, e.elastic);
        assert!(gained + e.friction <= e.external_work + e.pressure_work + 1e-9 * e.elastic, "{} s: {e:?}", r.time);
    }
    assert_eq!(compared, 12);
}
