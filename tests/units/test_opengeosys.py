"""OpenGeoSys as a flow unit. Its installation is large: these tests run where OPENGEOSYS is set."""

import os
import sys

import numpy as np
import pytest
from compare import OPEN, changes, difference, means, triangles
from conftest import ALL_TIMES, HERE, SIX, Instance, build, resources, run
from fmpy.validation import validate_fmu

pytestmark = pytest.mark.skipif("OPENGEOSYS" not in os.environ, reason="OPENGEOSYS is not set")

sys.path.insert(0, str(HERE / "opengeosys"))


@pytest.fixture(scope="module")
def opengeosys(tmp_path_factory):
    fmu = tmp_path_factory.mktemp("opengeosys") / "opengeosys.fmu"
    build("opengeosys", SIX, fmu, *changes(triangles(0.1)))
    return fmu


def test_the_unit_is_valid(opengeosys):
    assert validate_fmu(str(opengeosys)) == []


def test_a_state_that_is_gone_back_to_gives_the_same_bits(opengeosys, tmp_path):
    a, b = (Instance(opengeosys, tmp_path / name).start(fracture__aperture=1e-4) for name in "ab")
    for unit in (a, b):
        unit.fmu.doStep(0.0, 50.0)
    state = a.fmu.getFMUState()
    a.set("matrix.porosity_change", 1e-3)
    a.fmu.doStep(50.0, 7.0)
    a.fmu.setFMUState(a.fmu.deserializeFMUState(a.fmu.serializeFMUState(state)))
    for unit in (a, b):
        unit.set("matrix.porosity_change", -1e-4)
        unit.fmu.doStep(50.0, 30.0)
    assert (a.get("matrix.pressure") == b.get("matrix.pressure")).all()
    assert (a.get("fracture.pressure") == b.get("fracture.pressure")).all()
    assert np.ptp(a.get("matrix.pressure")) > 0
    for unit in (a, b):
        unit.fmu.terminate()


def test_what_deformation_displaces_is_stored_where_nothing_is_drained(opengeosys, tmp_path):
    from opengeosys import OpenGeoSys

    unit = OpenGeoSys(instance_name="unit", resources=str(resources(opengeosys, tmp_path)))
    unit.held = {}
    mesh = unit.mesh
    length = mesh.face_measure[mesh.fracture_faces]
    unit.values["fracture.aperture"] = 1e-4 + 0 * length
    unit.exit_initialization_mode()
    for step, (porosity_change, aperture) in [(40.0, (-1e-4, 1.2e-4)), (9.0, (2e-4, 0.9e-4))]:
        unit.values["matrix.porosity_change"] = porosity_change + np.zeros(mesh.cell_count)
        unit.values["fracture.aperture"] = aperture + 0 * length
        unit.values["matrix.porosity_compliance"] = 3e-11 + np.zeros(mesh.cell_count)
        unit.values["fracture.aperture_compliance"] = 1e-11 + 0 * length
        assert unit.do_step(0.0, step).status == 0
        excess = unit.values["matrix.pressure"] - 1e5, unit.values["fracture.pressure"] - 1e5
        stored = mesh.cell_measure @ (porosity_change + (1e-10 + 3e-11) * excess[0])
        stored += length @ (aperture - 1e-4 + 1e-11 * excess[1])
        assert abs(stored) < 1e-9 * abs(porosity_change) * mesh.cell_measure.sum()
    unit.terminate()


def test_the_six_fractures_agree_with_our_flow_the_better_the_finer(tmp_path):
    found = []
    for size in (0.08, 0.04):
        change = changes(triangles(size) + OPEN)
        build("opengeosys", SIX, tmp_path / f"{size}.fmu", *change)
        ours = means(run(SIX, tmp_path / f"ours-{size}", *ALL_TIMES, *change))
        theirs = means(run(SIX, tmp_path / f"{size}", *ALL_TIMES, *change, "--flow", tmp_path / f"{size}.fmu"))
        found.append(difference(theirs, ours))
    # First order: a continuous pressure is near to ours for a large K_n/d_f.
    assert (found[0] < 0.15).all() and (found[1] < 0.6 * found[0]).all(), found
