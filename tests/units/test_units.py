"""What holds for every unit in Python, under FMPy and in the orchestrator."""

import signal
import subprocess
import time

import fmpy
import h5py
import numpy as np
import pytest
from conftest import COARSE, SIX, Instance, build, run
from fmpy.validation import validate_fmu
from pack import orchestrator

STEPS = [(0.0, 50.0), (50.0, 100.0), (150.0, 30.0)]


def started(fmu, folder):
    return Instance(fmu, folder).start(fracture__aperture=1e-4)


def test_the_unit_is_valid(unit):
    assert validate_fmu(str(unit)) == []


def test_arrays_have_the_sizes_and_units_of_the_interface(unit, tmp_path):
    variables = {v.name: v for v in fmpy.read_model_description(str(unit)).modelVariables}
    with h5py.File(unit.parent / ("mesh.h5" if "two-point" in unit.name else "run/mesh.h5")) as mesh:
        cells, faces = len(mesh["cells/region"]), (mesh["faces/fracture"][:] >= 0).sum()
    wanted = {
        "matrix.pressure": ("output", "Pa", cells),
        "fracture.pressure": ("output", "Pa", faces),
        "matrix.porosity_change": ("input", "1", cells),
        "fracture.aperture": ("input", "m", faces),
    }
    for name, (causality, measure, size) in wanted.items():
        variable = variables[name]
        assert (variable.causality, variable.unit) == (causality, measure)
        assert [d.start for d in variable.dimensions] == [size]


def test_a_state_that_is_gone_back_to_gives_the_same_bits(unit, tmp_path):
    a, b = started(unit, tmp_path / "a"), started(unit, tmp_path / "b")
    a.fmu.doStep(*STEPS[0])
    b.fmu.doStep(*STEPS[0])
    state = a.fmu.getFMUState()
    # Astray, and back.
    a.set("matrix.porosity_change", 1e-3)
    a.fmu.doStep(50.0, 7.0)
    a.fmu.setFMUState(state)
    # The same from bytes, in an instance that has gone elsewhere.
    c = started(unit, tmp_path / "c")
    c.set("fracture.aperture", 3e-4)
    c.fmu.doStep(0.0, 11.0)
    c.fmu.setFMUState(c.fmu.deserializeFMUState(a.fmu.serializeFMUState(state)))
    for step in STEPS[1:]:
        for instance in (a, b, c):
            instance.set("matrix.porosity_change", -1e-4)
            instance.fmu.doStep(*step)
        for name in ("matrix.pressure", "fracture.pressure"):
            assert (a.get(name) == b.get(name)).all() and (c.get(name) == b.get(name)).all()
    assert np.ptp(a.get("matrix.pressure")) > 0


def test_a_wrong_length_is_refused(unit, tmp_path):
    instance = started(unit, tmp_path / "a")
    reference = instance.variables["fracture.aperture"].valueReference
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        instance.fmu.setFloat64([reference], [1e-4, 1e-4])
    assert "fracture.aperture has" in instance.log[-1]


def test_another_mesh_is_refused(unit, tmp_path):
    process = run(SIX, tmp_path / "run", "--flow", unit, "--set", "mesh.triangles.size=0.3", check=False)
    assert process.returncode == 2
    assert "flow: matrix.pressure has" in process.stderr and "another mesh" in process.stderr
    # One of the same size, with vertices elsewhere.
    model, options = (unit.parent, []) if "two-point" in unit.name else (SIX, COARSE)
    moved = ["--set", "mesh.perturb={ amplitude = 0.05, seed = 1 }"]
    process = run(model, tmp_path / "run", "--flow", unit, *options, *moved, check=False)
    assert process.returncode == 1
    assert "the units are on different meshes" in process.stderr


def test_control_c_ends_the_run(record, tmp_path):
    # The interpreter in the unit does not take the signal.
    options = ["--flow", record / "recorded.fmu", "--set", "time.step=0.01"]
    command = [orchestrator(), "run", SIX, "--output", tmp_path / "run", "--quiet", *COARSE, *options]
    # Started in the background of a shell, this test would hand on that the signal is ignored.
    process = subprocess.Popen(command, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    for _ in range(600):
        if (tmp_path / "run" / "checkpoint").exists():
            break
        time.sleep(0.05)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == -signal.SIGINT


def test_a_model_that_the_unit_does_not_know_is_refused_with_the_reason(tmp_path):
    change = ["--set", "flow.fluid.bulk_modulus=2e9"]
    with pytest.raises(subprocess.CalledProcessError):
        build("two-point", SIX, tmp_path / "two-point.fmu", *COARSE, *change)
    assert not (tmp_path / "two-point.fmu").exists()
