//! How mechanics answers to pressures, and takes account of pressures that answer.

use std::sync::Arc;

use mechanics_fmu::{
    Bubbles, ContactState, Dirichlet, FractureLaw, Friction, Mechanics, Neumann, Partner, PartnerResponse, State,
};
use mesh::Vec3;
use mesh::generate::cartesian;

use crate::common::{coulomb, fractured, hold, initial, largest, mesh, model, rock, start, step};

/// Some numbers between −1 and 1.
fn pattern(n: usize, seed: f64) -> Vec<f64> {
    (0..n).map(|k| (12.9898 * (k as f64 + seed)).sin()).collect()
}

/// A sheared body in which some faces slip and some open, and at strong friction of the upright fracture some stick.
fn sheared(family: &str, law: &FractureLaw, upright: f64, bubbles: Bubbles) -> (Mechanics, Partner) {
    let mesh = mesh(fractured(family));
    let d = mesh.dim();
    let mut model = model(&mesh, law);
    model.bubbles = bubbles;
    model.newton.tolerance = 1e-12;
    if let Some(law) = model.fractures.get_mut("upright") {
        law.friction = Friction::Coulomb { coefficient: upright, cohesion: 0.0 };
    }
    hold(&mut model, d, &["bottom"], |_, _| Vec3::ZERO);
    if d == 3 {
        for (tag, sign) in [("left", 1.0), ("right", -1.0)] {
            let traction = Arc::new(move |_, _| Vec3::new(sign * 20e6, 0.0, 0.0));
            model.neumann.push(Neumann { tag: tag.into(), traction });
        }
    }
    // The top turns: it pulls at one end and presses at the other.
    hold(&mut model, d, &["top"], move |p, t| {
        let turn = 4e-3 * (p.at.x - 0.4);
        t * if d == 2 { Vec3::new(1.2e-3, -turn, 0.0) } else { Vec3::new(0.8e-3 * p.at.y, 0.1e-3, turn) }
    });
    let (cells, faces) = (mesh.cell_count(), mesh.network().face_count());
    let around = |p: f64, n: usize, seed: f64| pattern(n, seed).iter().map(|v| p * (1.0 + 0.1 * v)).collect();
    let partner = Partner {
        matrix_pressure: around(1e6, cells, 0.3),
        fracture_pressure: around(2e6, faces, 0.7),
        response: None,
    };
    (start(&mesh, model), partner)
}

fn laws() -> [(&'static str, FractureLaw); 3] {
    let plain = coulomb(0.4, 0.0);
    [
        ("Coulomb", plain.clone()),
        ("dilation", FractureLaw { dilation_angle: 0.2, ..plain.clone() }),
        ("normal stiffness", FractureLaw { normal_stiffness: Some(1e11), dilation_angle: 0.1, ..coulomb(0.3, 0.0) }),
    ]
}

fn follow(mechanics: &Mechanics, aperture: f64) -> PartnerResponse {
    let (cells, faces) = (mechanics.mesh().cell_count(), mechanics.mesh().network().face_count());
    PartnerResponse {
        matrix_pressure_stiffness: pattern(cells, 0.1).iter().map(|v| 8e9 * (1.0 + 0.5 * v)).collect(),
        porosity_change: pattern(cells, 0.5).iter().map(|v| 1e-5 * v).collect(),
        fracture_pressure_stiffness: pattern(faces, 0.9).iter().map(|v| 5e9 * (1.0 + 0.5 * v)).collect(),
        aperture: pattern(faces, 0.2).iter().map(|v| aperture * (1.0 + 0.1 * v)).collect(),
    }
}

/// Pressures that follow are those that, given, lead to the same deformation.
#[test]
fn a_step_with_a_response_is_monolithic() {
    for family in ["triangles", "tetrahedra"] {
        for (name, law) in laws() {
            let (mut mechanics, given) = sheared(family, &law, 1.0, Bubbles::OneSided);
            let before = initial(&mut mechanics, 1.0, &given);
            let response = follow(&mechanics, 1.5e-4);
            let partner = Partner { response: Some(response.clone()), ..given.clone() };
            let (together, report) = step(&mut mechanics, &before, 2.0, &partner);
            let (phi, aperture) = (mechanics.porosity_change(&together), mechanics.aperture(&together));
            let pressures = Partner {
                matrix_pressure: (0..phi.len())
                    .map(|k| {
                        given.matrix_pressure[k]
                            - response.matrix_pressure_stiffness[k] * (phi[k] - response.porosity_change[k])
                    })
                    .collect(),
                fracture_pressure: (0..aperture.len())
                    .map(|i| {
                        given.fracture_pressure[i]
                            - response.fracture_pressure_stiffness[i] * (aperture[i] - response.aperture[i])
                    })
                    .collect(),
                response: None,
            };
            let (alone, other) = step(&mut mechanics, &before, 2.0, &pressures);
            let at = format!("{family}, {name}");
            let off = |a: &[f64], b: &[f64]| largest(a.iter().zip(b).map(|(a, b)| a - b)) / largest(b.iter().copied());
            assert_eq!(together.contact, alone.contact, "{at}");
            assert!(
                off(&together.unknowns, &alone.unknowns) < 1e-9,
                "{at}: {}",
                off(&together.unknowns, &alone.unknowns)
            );
            let traction = off(&together.multiplier, &alone.multiplier);
            assert!(traction < 1e-7, "{at}: λ differs by {traction}");
            let (a, b) = (report.energy, other.energy);
            let terms = [
                (a.elastic, b.elastic),
                (a.external_work, b.external_work),
                (a.pressure_work, b.pressure_work),
                (a.friction, b.friction),
            ];
            for (x, y) in terms {
                assert!((x - y).abs() < 1e-7 * (a.elastic + b.elastic), "{at}: {a:?} and {b:?}");
            }
            assert!(together.count(ContactState::Slip) > 0, "{at}: nothing slips");
        }
    }
}

/// A column between rollers with pressure that follows its porosity: E_oed + b² S in place of E_oed.
#[test]
fn an_undrained_column_is_stiffer() {
    let mesh = mesh(cartesian(Vec3::ZERO, Vec3::new(0.5, 0.5, 2.0), [1, 1, 4]));
    let mut model = model(&mesh, &coulomb(0.0, 0.0));
    for (tag, component) in [("left", 0), ("right", 0), ("front", 1), ("back", 1), ("bottom", 2)] {
        model.dirichlet.push(Dirichlet::zero(tag, component));
    }
    let load = 4e6;
    model.neumann.push(Neumann { tag: "top".into(), traction: Arc::new(move |_, _| Vec3::new(0.0, 0.0, -load)) });
    let mut mechanics = start(&mesh, model);
    let (p, stiffness, phi, b) = (1e6, 7e9, -1e-4, rock().biot_coefficient);
    let response = PartnerResponse {
        matrix_pressure_stiffness: vec![stiffness; mesh.cell_count()],
        porosity_change: vec![phi; mesh.cell_count()],
        ..PartnerResponse::default()
    };
    let partner = Partner { response: Some(response), ..Partner::uniform(&mesh, p) };
    let rest = mechanics.rest(0.0);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
    // −load = E_oed ε − b (p − S (b ε − φ*))
    let strain = (-load + b * (p + stiffness * phi)) / (rock().lambda() + 2.0 * rock().mu() + b * b * stiffness);
    for div in mechanics.divergence(&state) {
        assert!((div - strain).abs() < 1e-10 * strain.abs(), "{div}, not {strain}");
    }
    assert_eq!(mechanics.factorisations(), 2);
    let again = step(&mut mechanics, &state, 2.0, &partner);
    assert_eq!((mechanics.factorisations(), again.1.newton.iterations), (2, 0));
}

fn difference(
    mechanics: &mut Mechanics,
    before: &State,
    time: f64,
    partner: &Partner,
    change: &[Vec<f64>; 2],
) -> ([Vec<f64>; 3], Vec<ContactState>) {
    let mut side = |sign: f64| {
        let mut partner = partner.clone();
        partner.matrix_pressure.iter_mut().zip(&change[0]).for_each(|(p, c)| *p += sign * c);
        partner.fracture_pressure.iter_mut().zip(&change[1]).for_each(|(p, c)| *p += sign * c);
        let (state, _) = step(mechanics, before, time, &partner);
        let values =
            [mechanics.porosity_change(&state), mechanics.aperture(&state), state.jump(mechanics.space()).to_vec()];
        (values, state.contact)
    };
    let ((plus, states), (minus, others)) = (side(1.0), side(-1.0));
    assert_eq!(states, others, "the contact states change");
    let half = |k: usize| plus[k].iter().zip(&minus[k]).map(|(p, m)| 0.5 * (p - m)).collect();
    ([half(0), half(1), half(2)], states)
}

#[test]
fn the_response_is_the_derivative() {
    for family in ["triangles", "tetrahedra"] {
        for (name, law) in laws() {
            for follows in [false, true] {
                let at = format!("{family}, {name}, following: {follows}");
                let (mut mechanics, mut partner) = sheared(family, &law, 3.0, Bubbles::TwoSided);
                let before = initial(&mut mechanics, 1.0, &partner);
                if follows {
                    partner.response = Some(follow(&mechanics, 1.5e-4));
                }
                let (state, _) = step(&mut mechanics, &before, 2.0, &partner);
                for wanted in [ContactState::Open, ContactState::Stick, ContactState::Slip] {
                    assert!(state.count(wanted) > 0, "{at}: no face is in state {wanted:?}");
                }
                let (cells, faces) = (mechanics.mesh().cell_count(), mechanics.mesh().network().face_count());
                let change = [(cells, 0.4), (faces, 0.6)]
                    .map(|(n, seed)| pattern(n, seed).iter().map(|v| 50.0 * v).collect::<Vec<_>>());
                let (found, states) = difference(&mut mechanics, &before, 2.0, &partner, &change);
                assert_eq!(states, state.contact, "{at}");
                let response = mechanics.response(&state, &change[0], &change[1]).unwrap();
                let pairs = [
                    ("porosity", &response.porosity_change, &found[0]),
                    ("aperture", &response.aperture, &found[1]),
                    ("jump", &response.jump, &found[2]),
                ];
                for (what, a, b) in pairs {
                    let size = largest(b.iter().copied());
                    let error = largest(a.iter().zip(b).map(|(a, b)| a - b));
                    assert!(size > 0.0 && error < 1e-5 * size, "{at}: {what} off by {error} of {size}");
                }
            }
        }
    }
}

#[test]
fn the_aperture_compliance_is_the_response_to_one_pascal() {
    for family in ["triangles", "tetrahedra"] {
        let (mut mechanics, partner) = sheared(family, &coulomb(0.4, 0.0), 1.0, Bubbles::OneSided);
        let rest = mechanics.rest(0.0);
        let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
        let compliance = mechanics.aperture_compliance(&state).unwrap();
        let (cells, faces) = (mechanics.mesh().cell_count(), compliance.len());
        let response = mechanics.response(&state, &vec![0.0; cells], &vec![1.0; faces]).unwrap();
        let size = largest(compliance.iter().copied());
        let error = largest(compliance.iter().zip(&response.aperture).map(|(a, b)| a - b));
        assert!(size > 0.0 && error < 1e-9 * size, "{family}: off by {error} of {size}");
        for (c, contact) in compliance.iter().zip(&state.contact) {
            assert!(*contact == ContactState::Open || *c == 0.0, "{family}: a closed face gives {c}");
        }
        // E′ and the length of the fracture give the size: a pressurised crack opens by up to 4 (L/2)/E′ per pascal.
        let scale = mechanics.aperture_compliance_scale();
        assert!(size < 4.0 * largest(scale.iter().copied()), "{family}: {size}, {scale:?}");
    }
}

/// Sneddon: a crack of length 2ℓ under pressure p opens by 4 p √(ℓ² − s²)/E′ in an infinite plane.
#[test]
fn a_pressurised_crack_opens_as_its_compliance_says() {
    let (half, side) = (0.5, 40.0);
    let data = mesh::generate::Triangles::rectangle([-side / 2.0; 2], [side / 2.0; 2], 2.0)
        .fracture("crack", &[[-half, 0.0], [half, 0.0]], half / 40.0)
        .growth(0.2)
        .build();
    let mesh = mesh(data.unwrap());
    let mut model = model(&mesh, &coulomb(0.5, 0.0));
    hold(&mut model, 2, &["left", "right", "bottom", "top"], |_, _| Vec3::ZERO);
    let mut mechanics = start(&mesh, model);
    let mut partner = Partner::uniform(&mesh, 0.0);
    partner.fracture_pressure.fill(2e6);
    let rest = mechanics.rest(0.0);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &partner);
    let compliance = mechanics.aperture_compliance(&state).unwrap();
    let (mut error, mut size) = (0.0, 0.0);
    for (i, &face) in mesh.network().faces.iter().enumerate() {
        let s = mesh.geometry().face_center[face].x;
        let exact = 4.0 * (half * half - s * s).sqrt() / rock().plane_strain_modulus();
        error += (compliance[i] - exact).powi(2);
        size += exact * exact;
        let opening = -state.jump(mechanics.space())[2 * i];
        assert!((opening - 2e6 * compliance[i]).abs() < 1e-8 * 2e6 * exact, "face {i} opens by {opening}");
    }
    let error = f64::sqrt(error / size);
    assert!(error < 0.04, "{error}");
}
