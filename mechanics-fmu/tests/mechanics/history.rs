//! What later steps take from earlier ones, and the sensitivities that mechanics believes in.

use mechanics_fmu::{ContactState, Dirichlet, FractureLaw, Material, Partner};
use mesh::generate::{Triangles, cartesian};
use mesh::{MeshData, Vec3};

use crate::common::{coulomb, fractured, hold, initial, largest, mesh, model, rock, start, step};

/// d_f = d_c − ⟦u⟧_n + tan ψ |⟦u − u⁰⟧_τ|, where u⁰ is the initial state and neither rest nor the state before.
#[test]
fn the_slip_of_dilation_counts_from_the_initial_state() {
    for family in ["triangles", "tetrahedra"] {
        let mesh = mesh(fractured(family));
        let d = mesh.dim();
        let angle: f64 = 0.3;
        let mut model = model(&mesh, &FractureLaw { dilation_angle: angle, ..coulomb(0.2, 0.0) });
        hold(&mut model, d, &["bottom"], |_, _| Vec3::ZERO);
        hold(&mut model, d, &["top"], move |p, t| {
            let up = 2e-3 * (p.at.x - 0.7);
            t * if d == 2 { Vec3::new(1e-3, up, 0.0) } else { Vec3::new(1e-3, 0.5e-3, up) }
        });
        let mut mechanics = start(&mesh, model);
        let partner = Partner::uniform(&mesh, 0.0);
        let initial = initial(&mut mechanics, 1.0, &partner);
        let (middle, _) = step(&mut mechanics, &initial, 1.5, &partner);
        let (state, _) = step(&mut mechanics, &middle, 3.0, &partner);
        let jump = |state: &mechanics_fmu::State| state.jump(mechanics.space()).to_vec();
        let (from, to) = (jump(&initial), jump(&state));
        let mut largest_slip: f64 = 0.0;
        for (i, found) in mechanics.aperture(&state).into_iter().enumerate() {
            let slip = (1..d).map(|c| (to[i * d + c] - from[i * d + c]).powi(2)).sum::<f64>().sqrt();
            largest_slip = largest_slip.max(slip);
            let wanted = 1e-4 - to[i * d] + angle.tan() * slip;
            assert!((found - wanted).abs() < 1e-14, "{family}, face {i}: {found}, not {wanted}");
        }
        assert!(largest_slip > 1e-4, "{family}: {largest_slip}");
        assert!(mechanics.porosity_change(&initial).iter().all(|&p| p == 0.0), "{family}");
        let apertures = mechanics.aperture(&initial);
        for (i, found) in apertures.into_iter().enumerate() {
            assert!((found - (1e-4 - from[i * d])).abs() < 1e-15, "{family}, face {i}: {found} at the start");
        }
    }
}

/// Where loads grow in proportion to time and no face changes its state, a step of any length is foretold by the one before.
#[test]
fn motion_that_goes_on_is_foretold() {
    for family in ["triangles", "tetrahedra"] {
        let mesh = mesh(fractured(family));
        let d = mesh.dim();
        let mut model = model(&mesh, &coulomb(0.05, 0.0));
        hold(&mut model, d, &["bottom"], |_, _| Vec3::ZERO);
        hold(&mut model, d, &["top"], move |_, t| {
            t * if d == 2 { Vec3::new(1e-3, -1e-3, 0.0) } else { Vec3::new(1e-3, 0.5e-3, -1e-3) }
        });
        let mut mechanics = start(&mesh, model);
        let partner = Partner::uniform(&mesh, 0.0);
        let rest = mechanics.rest(0.0);
        let (first, found) = step(&mut mechanics, &rest, 1.0, &partner);
        let (second, foretold) = step(&mut mechanics, &first, 3.5, &partner);
        assert_eq!(first.contact, second.contact, "{family}");
        assert!(first.count(ContactState::Slip) > 0, "{family}");
        assert!(found.newton.iterations > 2 && foretold.newton.iterations <= 1, "{family}: {found:?} {foretold:?}");
    }
}

/// A body between rollers that is free to swell: its strain is b p/K_dr, and what it believes of a free body holds.
#[test]
fn a_free_body_swells_as_its_porosity_compliance_says() {
    for dim in [2, 3] {
        let mesh = mesh(cartesian(Vec3::ZERO, Vec3::ONE, [2, 2, if dim == 3 { 2 } else { 0 }]));
        let mut model = model(&mesh, &coulomb(0.0, 0.0));
        let rollers: &[&str] = if dim == 2 { &["left", "bottom"] } else { &["left", "front", "bottom"] };
        model.dirichlet.extend(rollers.iter().enumerate().map(|(component, tag)| Dirichlet::zero(tag, component)));
        let mut mechanics = start(&mesh, model);
        let rest = mechanics.rest(0.0);
        let found = mechanics.response(&rest, &vec![1.0; mesh.cell_count()], &[]).unwrap();
        let compliance = mechanics.porosity_compliance();
        let (lambda, mu, b) = (rock().lambda(), rock().mu(), rock().biot_coefficient);
        let wanted = b * b / (2.0 * mu / f64::from(dim) + lambda);
        for (found, believed) in found.porosity_change.iter().zip(&compliance) {
            assert!((found - wanted).abs() < 1e-12 * wanted, "{dim}D: {found}, not {wanted}");
            assert!((believed - wanted).abs() < 1e-14 * wanted, "{dim}D: {believed}, not {wanted}");
        }
    }
}

#[test]
fn lames_parameters_and_moduli_agree() {
    let (lambda, mu) = (3e9, 2e9);
    let rock = Material::from_lame(lambda, mu, 0.8);
    for (found, wanted) in
        [(rock.lambda(), lambda), (rock.mu(), mu), (rock.poisson_ratio, 0.3), (rock.young_modulus, 5.2e9)]
    {
        assert!((found - wanted).abs() < 1e-12 * wanted, "{found}, not {wanted}");
    }
    let mesh = mesh(fractured("triangles"));
    let mut model = model(&mesh, &coulomb(0.5, 0.0));
    model.materials.values_mut().for_each(|m| *m = rock);
    hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
    for found in start(&mesh, model).fracture_rigidity() {
        assert!((found - mu).abs() < 1e-12 * mu, "{found}");
    }
}

/// |λ_τ| over F λ_n + cohesion, both tangents counted.
#[test]
fn slip_tendency_of_stuck_faces_is_shear_over_bound() {
    let mesh = mesh(fractured("tetrahedra"));
    let (coefficient, cohesion) = (0.6, 1e5);
    let mut model = model(&mesh, &coulomb(coefficient, cohesion));
    hold(&mut model, 3, &["bottom"], |_, _| Vec3::ZERO);
    hold(&mut model, 3, &["top"], |_, _| Vec3::new(0.2e-3, 0.3e-3, -1e-3));
    let mut mechanics = start(&mesh, model);
    let rest = mechanics.rest(0.0);
    let (state, _) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
    let stuck = (0..state.contact.len()).filter(|&i| state.contact[i] == ContactState::Stick);
    let mut tested = 0;
    for i in stuck {
        let lambda = &state.multiplier[3 * i..][..3];
        let wanted = (lambda[1].powi(2) + lambda[2].powi(2)).sqrt() / (coefficient * lambda[0] + cohesion);
        let found = mechanics.slip_tendency(&state)[i];
        assert!((found - wanted).abs() < 1e-12, "face {i}: {found}, not {wanted}");
        tested += usize::from(lambda[1].abs() > 1e4 && lambda[2].abs() > 1e4);
    }
    assert!(tested > 3, "{tested}");
}

#[test]
fn a_state_of_another_mesh_is_refused() {
    let [mut small, large] = [[2, 2, 0], [2, 4, 0]].map(|n| {
        let mut data = cartesian(Vec3::ZERO, Vec3::ONE, n);
        data.mark_fracture("flat", |x| x.y == 0.5);
        let mesh = mesh(data);
        let mut model = model(&mesh, &coulomb(0.5, 0.0));
        hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
        start(&mesh, model)
    });
    assert!(small.load(small.rest(0.0)).is_ok());
    let (rest, partner) = (large.rest(0.0), Partner::uniform(small.mesh(), 0.0));
    let errors = [
        small.load(rest.clone()).map(drop),
        small.step(&rest, 1.0, &partner).map(drop),
        small.response(&rest, &[0.0; 4], &[0.0; 2]).map(drop),
        small.aperture_compliance(&rest).map(drop),
    ];
    for error in errors {
        assert_eq!(error.unwrap_err().to_string(), "displacement has 40 values; it needs 28");
    }
}

#[test]
fn the_scale_of_aperture_compliance_is_extent_over_plane_strain_modulus() {
    let data = Triangles::rectangle([0.0; 2], [4.0, 2.0], 0.5)
        .fracture("long", &[[0.5, 0.5], [3.5, 1.0]], 0.3)
        .fracture("bent", &[[1.0, 1.5], [2.0, 1.5], [2.0, 1.8]], 0.3)
        .build();
    let mesh = mesh(data.unwrap());
    let mechanics = {
        let mut model = model(&mesh, &coulomb(0.5, 0.0));
        hold(&mut model, 2, &["bottom"], |_, _| Vec3::ZERO);
        start(&mesh, model)
    };
    let extent = [f64::hypot(3.0, 0.5), f64::hypot(1.0, 0.3)];
    let modulus = rock().young_modulus / (1.0 - rock().poisson_ratio.powi(2));
    for (scale, &fracture) in mechanics.aperture_compliance_scale().iter().zip(&mesh.network().fracture) {
        let wanted = extent[fracture] / modulus;
        assert!((scale - wanted).abs() < 1e-12 * wanted, "fracture {fracture}: {scale}, not {wanted}");
    }
}

/// A block cut through by one fracture, and a crack in its lower part.
fn two_parts() -> MeshData {
    let mut data = cartesian(Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0), [8, 8, 0]);
    data.mark_fracture("through", |x| x.y == 0.75);
    data.mark_fracture("crack", |x| x.y == 0.25 && x.x >= 0.25 && x.x <= 0.75);
    data
}

/// Where some fracture is wide open, changes of the jump that count elsewhere are nothing beside it: tractions must obey their
/// laws all the same.
#[test]
fn a_small_load_beside_a_wide_gap_obeys_the_laws() {
    let mesh = mesh(two_parts());
    let mut model = model(&mesh, &coulomb(0.3, 0.0));
    hold(&mut model, 2, &["top"], |_, _| Vec3::new(0.0, 10.0, 0.0));
    hold(&mut model, 2, &["bottom"], |p, _| 1e-7 * Vec3::new(p.at.x, p.at.x * (1.0 - p.at.x), 0.0));
    let sides = |p: &mechanics_fmu::BoundaryPoint| if p.cell.y > 0.75 { Vec3::new(0.0, 10.0, 0.0) } else { Vec3::ZERO };
    hold(&mut model, 2, &["left", "right"], move |p, _| sides(p));
    let mut mechanics = start(&mesh, model);
    let rest = mechanics.rest(0.0);
    let (state, report) = step(&mut mechanics, &rest, 1.0, &Partner::uniform(&mesh, 0.0));
    let load = largest(state.multiplier.iter().copied());
    assert!(load > 1.0, "{load}");
    assert!(report.violation < 1e-2 * load, "{report:?}, {load}");
}
