//! Problems whose solution is in the discrete space: it is found to round-off.

use std::sync::Arc;

use mechanics_fmu::{
    Bubbles, ContactState, Dirichlet, FractureLaw, Friction, Material, Mechanics, Neumann, NormalBubbles, Partner,
    State,
};
use mesh::generate::{Triangles, cartesian, perturb, simplices};
use mesh::{Mesh, Vec3};

use crate::common::{
    BOTH, animals, bounds, coulomb, fractured, hold, largest, mesh, model, rock, sides_without, start, step, vector,
};

/// Of displacements, as part of the largest: the condition number of flat and tiny cells times round-off.
const ROUND_OFF: f64 = 1e-8;

/// Contraction with a little shear and rotation: every plane is pressed, shear stays below 0.4 of the pressure.
const GRADIENT: [Vec3; 3] =
    [Vec3::new(-1.0e-3, 0.2e-3, -0.1e-3), Vec3::new(0.1e-3, -1.2e-3, 0.15e-3), Vec3::new(0.1e-3, 0.05e-3, -1.1e-3)];

fn linear(dim: usize, x: Vec3) -> Vec3 {
    let x = if dim == 2 { x.with_z(0.0) } else { x };
    let u = Vec3::new(GRADIENT[0].dot(x), GRADIENT[1].dot(x), GRADIENT[2].dot(x));
    if dim == 2 { u.with_z(0.0) } else { u }
}

/// σ(u) n of the linear field.
fn traction(dim: usize, n: Vec3) -> Vec3 {
    let (lambda, mu) = (rock().lambda(), rock().mu());
    let g = |a: usize, b: usize| if a < dim && b < dim { GRADIENT[a][b] } else { 0.0 };
    let trace = g(0, 0) + g(1, 1) + g(2, 2);
    let row = |a: usize| (0..dim).map(|b| mu * (g(a, b) + g(b, a)) * n[b]).sum::<f64>() + lambda * trace * n[a];
    let t = Vec3::new(row(0), row(1), row(2));
    if dim == 2 { t.with_z(0.0) } else { t }
}

fn node_errors(mechanics: &Mechanics, state: &State, exact: impl Fn(Vec3) -> Vec3) -> f64 {
    let mesh = mechanics.mesh();
    let d = mesh.dim();
    largest(
        mesh.nodes()
            .vertices()
            .iter()
            .enumerate()
            .flat_map(|(node, &v)| {
                let u = exact(mesh.vertices()[v]);
                (0..d).map(move |c| (node, c, u[c])).collect::<Vec<_>>()
            })
            .map(|(node, c, u)| state.unknowns[node * d + c] - u),
    )
}

/// Linear displacement, uniform pressures in rock and fractures, Dirichlet data but for the top, which has a traction.
fn press(name: &str, mesh: &Arc<Mesh>, bubbles: Bubbles, normal_bubbles: NormalBubbles, law: &FractureLaw) {
    let d = mesh.dim();
    let (p_m, p_f) = (2e6, 1e6);
    let mut model = model(mesh, law);
    (model.bubbles, model.normal_bubbles) = (bubbles, normal_bubbles);
    hold(&mut model, d, &sides_without(d, &["top"]), move |p, _| linear(d, p.at));
    let up = if d == 2 { Vec3::Y } else { Vec3::Z };
    let biot = rock().biot_coefficient;
    let top = traction(d, up) - biot * p_m * up;
    model.neumann.push(Neumann { tag: "top".into(), traction: Arc::new(move |_, _| top) });
    let mut mechanics = start(mesh, model);
    let mut partner = Partner::uniform(mesh, p_m);
    partner.fracture_pressure.fill(p_f);
    let rest = mechanics.rest(0.0);
    let (state, report) = step(&mut mechanics, &rest, 1.0, &partner);

    let size = largest(mesh.vertices().iter().map(|&x| linear(d, x).length()));
    let error = node_errors(&mechanics, &state, |x| linear(d, x));
    assert!(error <= ROUND_OFF * size, "{name}, {bubbles:?}: displacement off by {error} of {size}");
    assert_eq!(state.count(ContactState::Stick), mechanics.space().face_count(), "{name}: {report:?}");
    assert_eq!(largest(state.jump(mechanics.space()).iter().copied()), 0.0, "{name}");
    let load = traction(d, up).length();
    for i in 0..mechanics.space().face_count() {
        let n = mechanics.space().basis(i)[0];
        let wanted = -(traction(d, n) - biot * p_m * n + p_f * n);
        let found = vector(&mechanics, i, &state.multiplier);
        let error = found.distance(wanted);
        assert!(error <= ROUND_OFF * load * 100.0, "{name}, {bubbles:?}, face {i}: {found}, not {wanted}");
    }
    let stress = mechanics.stress(&state, &partner.matrix_pressure).unwrap();
    for s in stress {
        let wanted = top;
        let found = if d == 2 { Vec3::new(s[3], s[1], 0.0) } else { Vec3::new(s[5], s[4], s[2]) };
        assert!(found.distance(wanted) <= ROUND_OFF * load * 100.0, "{name}: stress {found}, not {wanted}");
    }
    for (found, &center) in mechanics.cell_displacement(&state).into_iter().zip(&mesh.geometry().cell_center) {
        let wanted = linear(d, center);
        assert!(found.distance(wanted) <= ROUND_OFF * size, "{name}: mean displacement {found}, not {wanted}");
    }
    let porosity = biot * (0..d).map(|c| GRADIENT[c][c]).sum::<f64>();
    let error = largest(mechanics.porosity_change(&state).into_iter().map(|v| v - porosity));
    assert!(error <= ROUND_OFF * 1e-3 * 100.0, "{name}: porosity change off by {error}");
}

#[test]
fn linear_displacement_with_fractures_stuck() {
    for (name, mesh) in animals() {
        for normal in [NormalBubbles::None, NormalBubbles::All] {
            BOTH.iter().for_each(|&bubbles| press(name, &mesh, bubbles, normal, &coulomb(1.0, 0.0)));
        }
    }
}

#[test]
fn linear_displacement_with_fractures_tied_by_cohesion() {
    for family in ["triangles", "polygons", "tetrahedra", "polyhedra"] {
        press(family, &mesh(fractured(family)), Bubbles::OneSided, NormalBubbles::None, &coulomb(0.0, 1e12));
        let law = FractureLaw { friction: Friction::Tresca { bound: 1e12 }, ..coulomb(0.0, 0.0) };
        press(family, &mesh(fractured(family)), Bubbles::TwoSided, NormalBubbles::All, &law);
    }
}

/// A column of two rocks between rollers under a load and a pressure: strain (−load + b p)/E_oed in each.
#[test]
fn layers_have_their_own_rock() {
    let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [1, 1, 4]);
    data.assign_regions(|x| (x.z > 0.5).then_some("sand"));
    let mesh = mesh(data);
    let mut model = model(&mesh, &coulomb(0.0, 0.0));
    let sand = Material { young_modulus: 2e9, poisson_ratio: 0.35, biot_coefficient: 0.9 };
    model.materials.insert("sand".into(), sand);
    for (tag, component) in [("left", 0), ("right", 0), ("front", 1), ("back", 1), ("bottom", 2)] {
        model.dirichlet.push(Dirichlet::zero(tag, component));
    }
    let (load, pressure) = (3e6, 1e6);
    model.neumann.push(Neumann { tag: "top".into(), traction: Arc::new(move |_, _| Vec3::new(0.0, 0.0, -load)) });
    let mut mechanics = start(&mesh, model);
    let rest = mechanics.rest(0.0);
    let partner = Partner::uniform(&mesh, pressure);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
    let stress = mechanics.stress(&state, &partner.matrix_pressure).unwrap();
    let (porosity, compliance) = (mechanics.porosity_change(&state), mechanics.porosity_compliance());
    for (cell, center) in mesh.geometry().cell_center.iter().enumerate() {
        let m = if center.z > 0.5 { sand } else { rock() };
        let b = m.biot_coefficient;
        let wanted = b * (-load + b * pressure) / (m.lambda() + 2.0 * m.mu());
        assert!((porosity[cell] - wanted).abs() < 1e-11 * wanted.abs(), "{center}: {}, not {wanted}", porosity[cell]);
        assert!((stress[cell][2] + load).abs() < 1e-9 * load, "{center}: {:?}", stress[cell]);
        let wanted = b * b / (m.lambda() + 2.0 * m.mu() / 3.0);
        assert!((compliance[cell] - wanted).abs() < 1e-14 * wanted, "{center}: {}, not {wanted}", compliance[cell]);
    }
}

/// The pieces that the fractures cut the body into: the number of each cell's, and the mean of each piece's vertices.
fn pieces(mesh: &Mesh) -> (Vec<usize>, Vec<Vec3>) {
    let mut piece = vec![usize::MAX; mesh.cell_count()];
    let mut middles = Vec::new();
    for start in 0..mesh.cell_count() {
        if piece[start] != usize::MAX {
            continue;
        }
        let (mut queue, mut sum, mut size) = (vec![start], Vec3::ZERO, 0.0);
        piece[start] = middles.len();
        while let Some(cell) = queue.pop() {
            let volume = mesh.geometry().cell_measure[cell];
            sum += volume * mesh.geometry().cell_center[cell];
            size += volume;
            for &face in mesh.cell_faces(cell) {
                if mesh.network().number_of_face[face].is_some() {
                    continue;
                }
                let (a, b) = mesh.face_cells(face);
                for next in [Some(a), b].into_iter().flatten() {
                    if piece[next] == usize::MAX {
                        piece[next] = middles.len();
                        queue.push(next);
                    }
                }
            }
        }
        middles.push(sum / size);
    }
    (piece, middles)
}

#[test]
fn pieces_that_move_apart_leave_constant_jumps_and_no_traction() {
    let mut tested = 0;
    for (name, mesh) in animals() {
        let d = mesh.dim();
        let (piece, middles) = pieces(&mesh);
        if middles.len() == 1 {
            continue;
        }
        tested += 1;
        let [low, high] = bounds(mesh.vertices());
        let extent = high.distance(low);
        let slender = (high - low).to_array().into_iter().take(d).fold(extent, f64::min) / extent;
        // Apart, and turned a little: by an angle that closes nothing.
        let motion = {
            let middles = middles.clone();
            move |piece: usize, x: Vec3| {
                let turn = if d == 2 { Vec3::Z } else { Vec3::new(0.3, -0.2, 1.0) };
                let angle = 1e-5 * slender * (piece as f64 - 1.0);
                1e-3 * (middles[piece] - low) + angle * turn.cross(x - middles[piece])
            }
        };
        let centers = mesh.geometry().cell_center.clone();
        let piece_of = move |cell: Vec3| {
            let nearest = (0..centers.len())
                .min_by(|&a, &b| centers[a].distance_squared(cell).total_cmp(&centers[b].distance_squared(cell)));
            piece[nearest.unwrap()]
        };
        for bubbles in BOTH {
            let mut model = model(&mesh, &coulomb(0.6, 1e5));
            model.bubbles = bubbles;
            let (here, moved) = (piece_of.clone(), motion.clone());
            hold(&mut model, d, &sides_without(d, &[]), move |p, _| moved(here(p.cell), p.at));
            let mut mechanics = start(&mesh, model);
            let rest = mechanics.rest(0.0);
            let (state, report) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
            let jump = state.jump(mechanics.space());
            let stiffness = rock().young_modulus / extent;
            for (i, &face) in mesh.network().faces.iter().enumerate() {
                let (plus, minus) = mesh.face_cells(face);
                let center = |cell: usize| mesh.geometry().cell_center[cell];
                let side = |cell: usize| motion(piece_of(center(cell)), mesh.geometry().face_center[face]);
                let wanted = side(plus) - side(minus.unwrap());
                let found = vector(&mechanics, i, jump);
                let at = format!("{name}, {bubbles:?}, face {i}");
                assert!(found.distance(wanted) <= ROUND_OFF * 1e-3 * extent, "{at}: jump {found}, not {wanted}");
                let lambda = vector(&mechanics, i, &state.multiplier).length();
                let thin = extent / mesh.geometry().face_measure[face].powf(1.0 / (d as f64 - 1.0));
                assert!(lambda <= ROUND_OFF * 1e-3 * extent * stiffness * thin, "{at}: λ = {lambda}");
                if wanted.length() > 1e-9 * extent {
                    assert_eq!(state.contact[i], ContactState::Open, "{at}: {report:?}");
                }
            }
        }
    }
    assert!(tested >= 10, "{tested}");
}

/// Rock at rest in its pore fluid: with b = 1, the pressure −f·x of simplices balances the weight f, and neither vertices nor normal
/// bubbles move. (Vertices of other cells do, by the order of the method.)
#[test]
fn weight_and_hydrostatic_pressure_balance() {
    let boxes = perturb(&mesh(cartesian(Vec3::ZERO, Vec3::ONE, [4; 3])), 0.15, 1);
    let triangles = Triangles::rectangle([0.0; 2], [1.0; 2], 0.15).build().unwrap();
    for data in [triangles, simplices(&mesh(boxes)).unwrap()] {
        let mesh = mesh(data);
        let d = mesh.dim();
        let weight = Vec3::new(2e3, -2.5e4, if d == 3 { 1e3 } else { 0.0 });
        let mut model = model(&mesh, &coulomb(0.0, 0.0));
        model.materials.values_mut().for_each(|m| m.biot_coefficient = 1.0);
        model.normal_bubbles = NormalBubbles::All;
        hold(&mut model, d, &sides_without(d, &[]), |_, _| Vec3::ZERO);
        model.body_force = Some(Arc::new(move |_, _| weight));
        let mut mechanics = start(&mesh, model);
        assert!(mechanics.space().normal_bubble_count() > 100);
        let mut partner = Partner::uniform(&mesh, 0.0);
        partner.matrix_pressure = mesh.geometry().cell_center.iter().map(|x| weight.dot(*x)).collect();
        let rest = mechanics.rest(0.0);
        let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
        let (size, moved) = (weight.length() / rock().young_modulus, largest(state.unknowns.iter().copied()));
        assert!(moved <= ROUND_OFF * size, "{d}D: moved by {moved} of {size}");
    }
}

/// A clamped box of warped hexahedra under the same pressure in rock (b = 1) and fracture is in balance: the fracture takes up as
/// much as its sides give, whatever its shape.
#[test]
fn a_warped_fracture_under_one_pressure_neither_slips_nor_opens() {
    for warp in [0.0, 0.02, 0.05, 0.1] {
        let n = 4;
        let mut data = cartesian(Vec3::ZERO, Vec3::ONE, [n; 3]);
        data.mark_fracture("middle", |x| (x.x - 0.5).abs() < 1e-9 && x.y > 0.24 && x.y < 0.76);
        let h = 1.0 / n as f64;
        for (k, x) in data.vertices.iter_mut().enumerate() {
            if [x.x, x.y, x.z].iter().all(|c| *c > 1e-9 && *c < 1.0 - 1e-9) {
                x.x += warp * h * if k % 2 == 0 { 1.0 } else { -1.0 };
                x.y += 0.3 * warp * h * (k as f64).sin();
            }
        }
        let mesh = mesh(data);
        for bubbles in BOTH {
            let pressure = 1e7;
            let mut model = model(&mesh, &coulomb(0.1, 0.0));
            model.bubbles = bubbles;
            model.materials.values_mut().for_each(|m| m.biot_coefficient = 1.0);
            hold(&mut model, 3, &sides_without(3, &[]), |_, _| Vec3::ZERO);
            let mut mechanics = start(&mesh, model);
            let partner = Partner::uniform(&mesh, pressure);
            let rest = mechanics.rest(0.0);
            let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
            let moved = largest(state.unknowns.iter().copied());
            assert!(moved <= 1e-13 * pressure / rock().young_modulus * 1e3, "{warp}, {bubbles:?}: moved by {moved} m");
            // Volume of rock and fracture together, of any displacement: this one opens it.
            let mut opened = Partner::uniform(&mesh, 0.0);
            opened.fracture_pressure.fill(pressure);
            let (state, _) = step(&mut mechanics, &rest, 1.0, &opened);
            let rock: f64 =
                mechanics.divergence(&state).iter().zip(&mesh.geometry().cell_measure).map(|(d, v)| d * v).sum();
            let faces = mesh.network().faces.iter().map(|&f| mesh.geometry().face_measure[f]);
            let fracture: f64 =
                faces.zip(state.jump(mechanics.space()).chunks_exact(3)).map(|(area, g)| -area * g[0]).sum();
            assert!(fracture > 1e-5, "{fracture}");
            assert!((rock + fracture).abs() <= 1e-12 * fracture, "{warp}: {rock} and {fracture}");
        }
    }
}
