"""Two-point fluxes: exact where they are consistent, conservative, and near to our flow on the six fractures."""

import numpy as np
import pytest
from conftest import ALL_TIMES, COARSE, SIX, Instance, build, on_bisectors, resources, run
from compare import difference, means
from two_point import TwoPoint


def made(fmu, folder):
    return TwoPoint(instance_name="unit", resources=str(resources(fmu, folder)))


def flux_error(unit, point):
    """Largest error of the fluxes of an affine pressure through inner faces, over the largest flux."""
    mesh, gradient = unit.mesh, np.array([0.3, -0.7])
    first, second, transmissivity = unit.in_rock
    order = np.argsort(mesh.pair_face, kind="stable")
    face = mesh.pair_face[order]
    inner = face[1:][face[1:] == face[:-1]]
    inner = inner[mesh.face_fracture[inner] < 0]
    pressure = point @ gradient
    normal = mesh.face_normal[inner]
    outward = np.sign(np.sum(normal * (point[second] - point[first]), axis=1))[:, None] * normal
    normal_flow = np.einsum("fi,fij,j->f", outward, unit.permeability[first], gradient) / unit.viscosity
    exact = -mesh.face_measure[inner] * normal_flow
    return np.abs(transmissivity * (pressure[first] - pressure[second]) - exact).max() / np.abs(exact).max()


def test_fluxes_are_exact_on_bisector_meshes_and_not_on_triangles(bisectors, tmp_path):
    unit = made(bisectors / "two-point.fmu", tmp_path / "bisectors")
    assert flux_error(unit, np.load(bisectors / "points.npy")) < 1e-9
    build("two-point", SIX, tmp_path / "triangles.fmu", *COARSE)
    unit = made(tmp_path / "triangles.fmu", tmp_path / "triangles")
    assert flux_error(unit, unit.mesh.cell_center) > 0.1


def test_a_pressure_at_the_meeting_point_gives_the_same_fluxes(tmp_path, bisectors):
    # Three fracture faces of different apertures meet at a vertex; one ends on a boundary where a pressure is held.
    unit = made(bisectors / "two-point.fmu", tmp_path)
    rng = np.random.default_rng(1)
    n = len(unit.mesh.fracture_faces)
    aperture, pressure = rng.uniform(1e-4, 3e-4, n), rng.uniform(1e5, 1e6, n)
    unit.ends = [([0, 5, 9], np.nan), ([2], 3e5), ([4], np.nan)]
    first, second, t, held, to_held, held_pressure = unit._connections(aperture)
    cells = unit.mesh.cell_count
    inflow = np.zeros(n)
    on_fractures = (first >= cells) & (second >= cells)
    flux = t[on_fractures] * (pressure[second[on_fractures] - cells] - pressure[first[on_fractures] - cells])
    np.add.at(inflow, first[on_fractures] - cells, flux)
    np.add.at(inflow, second[on_fractures] - cells, -flux)
    own = held >= cells
    np.add.at(inflow, held[own] - cells, to_held[own] * (held_pressure[own] - pressure[held[own] - cells]))
    length = unit.mesh.face_measure[unit.mesh.fracture_faces]
    half = aperture**3 / (12 * unit.viscosity) / (length / 2)
    wanted, star = np.zeros(n), [0, 5, 9]
    meeting = (half[star] * pressure[star]).sum() / half[star].sum()
    wanted[star] = half[star] * (meeting - pressure[star])
    wanted[2] = half[2] * (3e5 - pressure[2])
    assert np.abs(inflow - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_fluid_is_conserved(bisectors, tmp_path):
    unit = made(bisectors / "two-point.fmu", tmp_path / "made")
    instance = Instance(bisectors / "two-point.fmu", tmp_path / "fmu").start(fracture__aperture=1e-4)
    mesh, step = unit.mesh, 40.0
    length = mesh.face_measure[mesh.fracture_faces]
    aperture, porosity_change = 1.2e-4 + 1e-5 * np.sin(np.arange(len(length))), -1e-4 * np.ones(mesh.cell_count)
    compliance = {"matrix.porosity_compliance": 3e-11, "fracture.aperture_compliance": 1e-11}
    deformation = {"matrix.porosity_change": porosity_change, "fracture.aperture": aperture}
    for name, values in (deformation | compliance).items():
        instance.set(name, values)
    pressures = lambda: (instance.get("matrix.pressure"), instance.get("fracture.pressure"))
    start, inflow = pressures(), 0.0
    # What is stored at the end of a time step counts in the next.
    for time, reference in [(0.0, 1e5), (step, 2e5)]:
        instance.set("matrix.pressure_reference", reference)
        instance.set("fracture.pressure_reference", reference)
        instance.fmu.doStep(time, step)
        rock, fracture = pressures()
        cell, half, held = unit.on_boundary
        inflow += step * (half * (held - rock[cell])).sum()
    stored = mesh.cell_measure @ (porosity_change + 3e-11 * (rock - reference) + 1e-10 * (rock - start[0]))
    stored += length @ (aperture + 1e-11 * (fracture - reference) - 1e-4)
    assert abs(stored - inflow) < 1e-9 * abs(inflow)
    assert inflow < 0


def test_an_aperture_that_is_not_positive_discards_the_step(bisectors, tmp_path):
    instance = Instance(bisectors / "two-point.fmu", tmp_path / "a").start(fracture__aperture=1e-4)
    before = instance.get("fracture.pressure")
    instance.set("fracture.aperture", -1e-6)
    with pytest.raises(Exception, match="DoStep failed with status 2"):
        instance.fmu.doStep(0.0, 10.0)
    assert "not positive" in instance.log[-1]
    assert (instance.get("fracture.pressure") == before).all()
    instance.set("fracture.aperture", 1e-4)
    instance.fmu.doStep(0.0, 10.0)


def test_the_six_fractures_agree_with_our_flow_the_better_the_finer(bisectors, tmp_path):
    fine = on_bisectors(tmp_path / "fine", 0.04)
    found = []
    for folder in (bisectors, fine):
        ours = means(run(folder, tmp_path / f"{folder.name}-ours", *ALL_TIMES))
        theirs = means(run(folder, tmp_path / f"{folder.name}-theirs", *ALL_TIMES, "--flow", folder / "two-point.fmu"))
        found.append(difference(theirs, ours))
    # Aperture, pressures in fractures and rock, over their ranges.
    assert (found[0] < [2e-3, 5e-3, 5e-3]).all(), found
    assert (found[1] < 0.85 * found[0]).all(), found
