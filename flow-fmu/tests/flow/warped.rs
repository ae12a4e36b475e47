//! Fracture faces that are not planar, as of faults on skew pillars: what stays exact, and how far off the rest is.

use flow_fmu::{Boundary, FlowModel, Fluid, Fracture, Rock, SpaceTimeFunction, Tensor};
use mesh::{Mesh, MeshData, Vec3};

use super::common::*;

/// Parts of the edge by which vertices are moved.
const WARPS: [f64; 3] = [0.02, 0.05, 0.1];

/// Hexahedra of which all faces inside, and a fracture through the middle, are warped.
fn warped(warp: f64, n: usize) -> MeshData {
    let mut data = unit([n, n, 4]);
    data.mark_fracture("f", |x| x.z == 0.5);
    let mut count = 0;
    data.map_vertices(|x| {
        count += 1;
        let is_inside = x.z > 0.0 && x.z < 1.0;
        let height = f64::from(u8::from(is_inside)) * warp / n as f64 * (7.3 * f64::from(count)).sin();
        x + height * Vec3::Z
    });
    data
}

fn area(mesh: &Mesh) -> f64 {
    mesh.network().faces.iter().map(|&face| mesh.geometry().face_measure[face]).sum()
}

/// p_m = p_f stays as it is, and what apertures and pores take up is what the units exchange: Σ |K| φ and Σ |σ| d_f with the
/// measures of the mesh, the counterparts of div and jump in mechanics.
#[test]
fn a_uniform_pressure_stays_and_volumes_are_those_of_the_mesh() {
    for warp in WARPS {
        let mesh = mesh(warped(warp, 4));
        let mut model = FlowModel::new(Fluid { viscosity: 1e-3, density: 1000.0, bulk_modulus: Some(2e9) });
        model.rocks.push(("rock".into(), Rock::isotropic(1e-15, 0.1, Some(1e10))));
        model.fractures.push(("f".into(), Fracture { normal_permeability: 1e-12, aperture: 1e-4.into() }));
        model.initial_pressure = 1e6.into();
        model.boundaries.push(("top".into(), Boundary::pressure(1e6)));
        let mut flow = flow_fmu::Flow::new(mesh.clone(), model).unwrap();
        let mut inputs = flow.inputs();
        flow.step(1e4, &inputs).unwrap();
        let off = |flow: &flow_fmu::Flow| {
            let pressures = flow.state().matrix_pressure.iter().chain(flow.fracture_pressure());
            pressures.map(|p| (p - 1e6).abs()).fold(0.0, f64::max)
        };
        assert!(off(&flow) < 1e-7, "{warp}: off by {:e} Pa", off(&flow));
        // The fracture opens by 1e-6 m and the rock around it closes by as much: the whole takes up nothing.
        let before = flow.fluid_in_place();
        let taken = 1e-6 * area(&mesh);
        inputs.aperture.iter_mut().for_each(|d| *d += 1e-6);
        let volume: f64 = mesh.geometry().cell_measure.iter().sum();
        inputs.porosity_change.iter_mut().for_each(|change| *change -= taken / volume);
        let report = flow.step(1e-6, &inputs).unwrap();
        let after = flow.fluid_in_place();
        assert!((after.fracture - before.fracture - taken).abs() < 1e-12 * before.fracture);
        assert!(report.balance.total < 1e-8 * report.balance.throughput, "{:?}", report.balance);
    }
}

#[test]
fn hydrostatic_rest_is_kept() {
    for warp in WARPS {
        let mut data = warped(warp, 4);
        data.map_vertices(|x| 1000.0 * x);
        let mesh = mesh(data);
        let mut model = FlowModel::new(Fluid { viscosity: 1e-3, density: 1000.0, bulk_modulus: Some(2.18e9) });
        model.gravity = -10.0 * Vec3::Z;
        model.rocks.push(("rock".into(), Rock::isotropic(1e-15, 0.1, Some(1e10))));
        model.fractures.push(("f".into(), Fracture { normal_permeability: 1e-12, aperture: 1e-4.into() }));
        model.initial_pressure = model.hydrostatic(5e6, 1000.0 * Vec3::Z);
        model.boundaries.push(("right".into(), Boundary::pressure(model.initial_pressure.clone())));
        let mut flow = flow_fmu::Flow::new(mesh, model).unwrap();
        let before = flow.state().matrix_pressure.clone();
        let inputs = flow.inputs();
        flow.step(1e5, &inputs).unwrap();
        flow.steady(&inputs).unwrap();
        assert!(distance(&before, &flow.state().matrix_pressure) < 1e-12 * 1.5e7);
        // Gravity alone would drive K/η ρ g = 1e-8 m/s.
        let fastest = flow.fluxes().unwrap().cell_velocity.iter().map(|v| v.length()).fold(0.0, f64::max);
        assert!(fastest < 1e-12 * 1e-8, "{fastest:e} m/s");
    }
}

/// An affine pressure across a fracture that nobody feels: all facets of a face exchange at the same rate per area, so that the
/// velocity beside it is off by less than a twentieth of the warp, the pressure by a hundredth. Exact without warp.
#[test]
fn an_affine_pressure_is_off_by_less_than_the_warp() {
    let gradient = Vec3::new(0.7, -1.3, 2.1);
    for warp in [0.0, 0.02, 0.05, 0.1] {
        for n in [4, 8] {
            let mesh = mesh(warped(warp, n));
            let exact = SpaceTimeFunction::new(move |x, _| gradient.dot(x));
            let mut model = all_pressure(&mesh, Tensor::IDENTITY, exact);
            model.fractures.push(("f".into(), fracture(1e-8, 1e8)));
            let (flow, _) = steady(&mesh, model);
            for cell in 0..mesh.cell_count() {
                let p = (flow.state().matrix_pressure[cell] - gradient.dot(flow.space().cell_point(cell))).abs();
                let v = (flow.fluxes().unwrap().cell_velocity[cell] + gradient).length();
                let scale = gradient.length();
                assert!(v < (0.05 * warp + 1e-6) * scale, "warp {warp}, cell {cell}: velocity off by {v:e}");
                assert!(p < (0.01 * warp + 1e-7) * scale, "warp {warp}, cell {cell}: pressure off by {p:e}");
            }
        }
    }
}
