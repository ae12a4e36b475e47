//! What must not change a solution: motion of the whole, numbering, sides, units; and repeating a step.

use std::sync::Arc;

use mechanics_fmu::{BoundaryPoint, Bubbles, Mechanics, Neumann, Outcome, Partner, PartnerResponse, State};
use mesh::{Mesh, MeshData, Vec3};

use crate::common::{coulomb, fractured, hold, largest, mesh, model, start, step};

const FAMILIES: [&str; 4] = ["triangles", "polygons", "tetrahedra", "perturbed hexahedra"];

/// Of jumps and tractions, as part of the largest: a tenth of what Newton's method leaves, and round-off.
const ROUND_OFF: f64 = 1e-8;

/// x ↦ length R x + shift; tractions and moduli are multiplied by `pressure`.
#[derive(Clone, Copy)]
struct Frame {
    axis: Vec3,
    angle: f64,
    shift: Vec3,
    length: f64,
    pressure: f64,
}

const PLAIN: Frame = Frame { axis: Vec3::Z, angle: 0.0, shift: Vec3::ZERO, length: 1.0, pressure: 1.0 };

impl Frame {
    fn mesh(&self, mut data: MeshData) -> MeshData {
        data.scale(self.length);
        data.move_rigidly(self.axis, self.angle, self.shift);
        data
    }

    fn turn(&self, v: Vec3) -> Vec3 {
        let (s, c) = self.angle.sin_cos();
        let k = self.axis.normalize();
        c * v + s * k.cross(v) + (1.0 - c) * k.dot(v) * k
    }

    fn back(&self, v: Vec3) -> Vec3 {
        Self { angle: -self.angle, ..*self }.turn(v)
    }
}

/// Sheared and pressed in two steps, with body force, tractions, and pressures.
fn problem(mesh: &Arc<Mesh>, frame: Frame, bubbles: Bubbles) -> Mechanics {
    let d = mesh.dim();
    let mut model = model(mesh, &coulomb(0.4, 1e5 * frame.pressure));
    model.bubbles = bubbles;
    model.newton.tolerance = 1e-11;
    model.materials.values_mut().for_each(|m| m.young_modulus *= frame.pressure);
    let top = move |p: &BoundaryPoint, t: f64| {
        let x = frame.back(p.at - frame.shift) / frame.length;
        let turn = 3e-3 * (x.x - 0.4) * t;
        let u = if d == 2 { Vec3::new(1e-3 * t, -turn, 0.0) } else { Vec3::new(1e-3 * t, 0.4e-3 * t * x.y, turn) };
        frame.length * frame.turn(u)
    };
    hold(&mut model, d, &["bottom"], |_, _| Vec3::ZERO);
    hold(&mut model, d, &["top"], top);
    let load = frame.pressure * frame.turn(Vec3::new(3e6, -1e6, 0.0));
    model.neumann.push(Neumann { tag: "left".into(), traction: Arc::new(move |_, _| load) });
    let force = frame.pressure / frame.length * frame.turn(Vec3::new(1e6, -2e6, 0.0));
    model.body_force = Some(Arc::new(move |_, _| force));
    start(mesh, model)
}

fn solve(mechanics: &mut Mechanics, frame: Frame) -> (State, usize) {
    let mut state = mechanics.rest(0.0);
    let mut iterations = 0;
    for t in [1.0, 2.0] {
        let mesh = Arc::clone(mechanics.mesh());
        let mut partner = Partner::uniform(&mesh, 1e6 * t * frame.pressure);
        partner.fracture_pressure.fill(1.5e6 * frame.pressure);
        let (next, report) = step(mechanics, &state, t, &partner);
        (state, iterations) = (next, iterations + report.newton.iterations);
    }
    (state, iterations)
}

/// Compares with the plain solution; `number` gives the new number of each fracture face.
fn compare(
    at: &str,
    plain: &(Mechanics, State, usize),
    other: &(Mechanics, State, usize),
    frame: Frame,
    number: impl Fn(usize) -> usize,
) {
    let ((a, old, iterations), (b, new, others)) = (plain, other);
    // The last one may be for round-off.
    assert!(iterations.abs_diff(*others) <= 1, "{at}: {iterations} and {others} Newton iterations");
    let vectors = |m: &Mechanics, v: &[f64], i| crate::common::vector(m, i, v);
    let (jump, lambda) = (old.jump(a.space()), &old.multiplier);
    let (size, load) = (largest(jump.iter().copied()), largest(lambda.iter().copied()));
    assert!(size > 1e-5 && load > 1e5, "{at}: {size} {load}");
    for i in 0..a.space().face_count() {
        let j = number(i);
        assert_eq!(old.contact[i], new.contact[j], "{at}: state of face {i}");
        // Jump and multiplier change sign with the sides.
        let normal = frame.turn(a.space().basis(i)[0]);
        let sign = normal.dot(b.space().basis(j)[0]).signum();
        let g = sign * frame.length * frame.turn(vectors(a, jump, i));
        let g = vectors(b, new.jump(b.space()), j).distance(g);
        assert!(g <= ROUND_OFF * size * frame.length, "{at}: jump of face {i} differs by {g} of {size}");
        let l = sign * frame.pressure * frame.turn(vectors(a, lambda, i));
        let l = vectors(b, &new.multiplier, j).distance(l);
        assert!(l <= 10.0 * ROUND_OFF * load * frame.pressure, "{at}: λ of face {i} differs by {l} of {load}");
    }
}

fn solved(mesh: &Arc<Mesh>, frame: Frame, bubbles: Bubbles) -> (Mechanics, State, usize) {
    let mut mechanics = problem(mesh, frame, bubbles);
    let (state, iterations) = solve(&mut mechanics, frame);
    (mechanics, state, iterations)
}

/// Which side is plus depends on the position in space: bubbles are on both.
#[test]
fn motion_of_the_whole() {
    for family in FAMILIES {
        let plain = mesh(fractured(family));
        let axis = if plain.dim() == 2 { Vec3::Z } else { Vec3::new(0.3, -0.5, 0.8) };
        let shift = if plain.dim() == 2 { Vec3::new(2.0, -1.0, 0.0) } else { Vec3::new(2.0, -1.0, 3.0) };
        let frame = Frame { axis, angle: 0.4, shift, ..PLAIN };
        let moved = mesh(frame.mesh(fractured(family)));
        let number = |i: usize| moved.network().number_of_face[plain.network().faces[i]].unwrap();
        let [a, b] = [(&plain, PLAIN), (&moved, frame)].map(|(m, f)| solved(m, f, Bubbles::TwoSided));
        compare(family, &a, &b, frame, number);
    }
}

#[test]
fn units() {
    for family in FAMILIES {
        let plain = mesh(fractured(family));
        let a = solved(&plain, PLAIN, Bubbles::TwoSided);
        // Kilometres and megapascals; millimetres and gigapascals.
        for (length, pressure) in [(1e-3, 1e-6), (1e3, 1e-9)] {
            let frame = Frame { length, pressure, ..PLAIN };
            let scaled = mesh(frame.mesh(fractured(family)));
            compare(family, &a, &solved(&scaled, frame, Bubbles::TwoSided), frame, |i| i);
        }
    }
}

#[test]
fn numbering() {
    for family in FAMILIES {
        let plain = mesh(fractured(family));
        let (data, new) = fractured(family).renumbered(7);
        let other = mesh(data);
        let number = |i: usize| other.network().number_of_face[new.faces[plain.network().faces[i]]].unwrap();
        let [a, b] = [&plain, &other].map(|m| solved(m, PLAIN, Bubbles::OneSided));
        compare(family, &a, &b, PLAIN, number);
        let (old_porosity, porosity) = (a.0.porosity_change(&a.1), b.0.porosity_change(&b.1));
        let size = largest(old_porosity.iter().copied());
        let error = largest(old_porosity.iter().enumerate().map(|(k, p)| p - porosity[new.cells[k]]));
        assert!(error < ROUND_OFF * size, "{family}: porosity differs by {error} of {size}");
    }
}

/// One-sided bubbles are on the plus side, so that there exchanging the sides makes another discretisation: how far it agrees
/// is in tests/single_crack.rs.
#[test]
fn sides() {
    for family in FAMILIES {
        let plain = mesh(fractured(family));
        let swapped = Arc::new(Mesh::with_swapped_sides(fractured(family)).unwrap());
        let [a, b] = [&plain, &swapped].map(|m| solved(m, PLAIN, Bubbles::TwoSided));
        for i in 0..a.0.space().face_count() {
            assert!(a.0.space().basis(i)[0].dot(b.0.space().basis(i)[0]) < 0.0, "{family}: the sides are the same");
        }
        compare(family, &a, &b, PLAIN, |i| i);
    }
}

/// A translation presses nothing, though every prescribed force is large.
#[test]
fn a_translation_is_no_load() {
    for family in FAMILIES {
        let mesh = mesh(fractured(family));
        let mut model = model(&mesh, &coulomb(0.4, 0.0));
        let shift = Vec3::new(0.3, -0.2, 0.1);
        hold(&mut model, mesh.dim(), &["bottom", "top", "left"], move |_, _| shift);
        let mut mechanics = start(&mesh, model);
        let rest = mechanics.rest(0.0);
        let (state, report) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
        assert!(largest(state.jump(mechanics.space()).iter().copied()) < 1e-12, "{family}");
        assert!(largest(state.multiplier.iter().copied()) < 1e-12 * 10e9 / 0.05, "{family}: {report:?}");
    }
}

fn bits(state: &State) -> Vec<u64> {
    let all = [&state.unknowns, &state.multiplier, &state.initial_divergence, &state.initial_jump];
    all.iter().flat_map(|v| v.iter().map(|x| x.to_bits())).collect()
}

/// Whatever was done in between: other pressures, other factorisations, a step that is refused.
#[test]
fn a_step_repeated_from_a_saved_state_gives_the_same_bits() {
    for family in FAMILIES {
        let mesh = mesh(fractured(family));
        let mut mechanics = problem(&mesh, PLAIN, Bubbles::OneSided);
        let (saved, _) = solve(&mut mechanics, PLAIN);
        let before = bits(&saved);
        let partner = Partner::uniform(&mesh, 2e6);
        let (first, report) = step(&mut mechanics, &saved.clone(), 3.0, &partner);
        let (cells, faces) = (mesh.cell_count(), mesh.network().face_count());
        let response = PartnerResponse {
            matrix_pressure_stiffness: vec![5e9; cells],
            porosity_change: vec![0.0; cells],
            fracture_pressure_stiffness: vec![1e10; faces],
            aperture: vec![1e-4; faces],
        };
        let (other, _) = step(&mut mechanics, &saved, 4.0, &Partner { response: Some(response), ..partner.clone() });
        assert_ne!(bits(&other), bits(&first));
        let mut broken = partner.clone();
        broken.matrix_pressure[0] = f64::NAN;
        assert!(mechanics.step(&saved, 3.0, &broken).is_err());
        mechanics.response(&first, &vec![1.0; cells], &vec![0.0; faces]).unwrap();
        let (second, again) = step(&mut mechanics, &saved, 3.0, &partner);
        assert_eq!(bits(&first), bits(&second), "{family}");
        assert_eq!(first.contact, second.contact);
        assert_eq!((report.newton, report.energy), (again.newton, again.energy), "{family}");
        assert_eq!(bits(&saved), before);
        let Ok(Outcome::Converged(fresh, _)) = problem(&mesh, PLAIN, Bubbles::OneSided).step(&saved, 3.0, &partner)
        else {
            panic!("{family}: another instance gives up")
        };
        assert_eq!(bits(&first), bits(&fresh), "{family}: another instance");
    }
}
