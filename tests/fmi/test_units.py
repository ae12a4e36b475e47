"""Both units of the six fractures, each alone: results, arrays, rollback, states, derivatives, threads, memory."""

import os
import re
import shutil
import struct
import subprocess
import sys
import threading
from pathlib import Path

import couple
import fmpy
import numpy as np
import pytest
from conftest import CASE, Host
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from test_description import schema, xml

UNITS = "mechanics", "flow"
STEP = 100.0
# Work, not state: a repeated step takes less.
STATELESS = {"factorisations"}


class Unit(Host):
    """An unpacked unit with instances whose variables are known by their names."""

    def __init__(self, name, folder=CASE):
        super().__init__(str(folder / f"{name}.fmu"))
        self.name = name
        self.variables = {v.name: v for v in self.description.modelVariables}

    def size(self, name):
        return int(np.prod([d.start for d in self.variables[name].dimensions], dtype=int))

    def get(self, unit, name):
        variable = self.variables[name]
        getters = {"Float64": unit.getFloat64, "Int64": unit.getInt64, "Enumeration": unit.getInt64}
        getter = (getters | {"Boolean": unit.getBoolean})[variable.type]
        return getter([variable.valueReference], nValues=self.size(name))

    def set(self, unit, name, values):
        unit.setFloat64([self.variables[name].valueReference], list(values))

    def results(self, unit):
        """All numbers that the unit gives, as bytes."""
        names = [v.name for v in self.variables.values() if v.type not in ("String", "Boolean")]
        return {
            name: struct.pack(f"{self.size(name)}d", *self.get(unit, name))
            for name in names
            if name not in STATELESS and not name.startswith("work.")
        }

    def drive(self, unit, factor=1.0):
        """Inputs by which something happens in the next steps, different for each factor."""
        if self.name == "mechanics":
            pressure = 1e5 + 1e6 * factor * np.linspace(0.0, 1.0, self.size("fracture.pressure"))
            self.set(unit, "fracture.pressure", pressure)
            self.set(unit, "matrix.pressure", np.full(self.size("matrix.pressure"), 1e5 + 1e5 * factor))
        else:
            self.set(unit, "fracture.aperture", 1e-4 * (1 + factor * np.linspace(0.1, 0.5, self.size("fracture.aperture"))))
            self.set(unit, "matrix.porosity_change", np.full(self.size("matrix.porosity_change"), -1e-5 * factor))

    def stiffen(self, unit):
        """Connects the partner's sensitivities."""
        if self.name == "mechanics":
            self.set(unit, "matrix.pressure_stiffness", np.full(self.size("matrix.pressure_stiffness"), 1e10))
            self.set(unit, "fracture.pressure_stiffness", np.full(self.size("fracture.pressure_stiffness"), 1e10))
        else:
            self.set(unit, "matrix.porosity_compliance", np.full(self.size("matrix.porosity_compliance"), 3e-11))
            self.set(unit, "fracture.aperture_compliance", np.full(self.size("fracture.aperture_compliance"), 5e-11))


@pytest.fixture(scope="module", params=UNITS)
def module_host(request):
    host = Unit(request.param)
    yield host
    shutil.rmtree(host.folder)


@pytest.fixture
def host(module_host):
    module_host.log.clear()
    return module_host


def advance(unit, first, last):
    for step in range(first, last):
        unit.doStep(STEP * step, STEP)


@pytest.fixture(scope="session")
def direct():
    """What the libraries give without FMI, as bytes."""
    lines = (CASE / "direct.txt").read_text().splitlines()
    table = {name: digits for name, *digits in map(str.split, lines)}
    return {name: b"".join(bytes.fromhex(d)[::-1] for d in digits) for name, digits in table.items()}


# 1. Valid, and the same as the libraries.


@pytest.mark.parametrize("name", UNITS)
def test_fmpy_and_the_schemas_have_nothing_to_say(name):
    fmu = str(CASE / f"{name}.fmu")
    assert validate_fmu(fmu) == []
    for file, checker in (
        ("modelDescription.xml", "fmi3ModelDescription.xsd"),
        ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3TerminalsAndIcons.xsd"),
    ):
        checker = schema(checker)
        assert checker.validate(xml(fmu, file)), checker.error_log


@pytest.mark.parametrize("name", UNITS)
def test_simulate_fmu_gives_the_bits_of_the_library(name, direct):
    fmu = str(CASE / f"{name}.fmu")
    signals, scalars = None, ["aperture.mean", "contact.slip"]
    arrays = ["fracture.aperture", "matrix.porosity_change", "fracture.displacement_jump"]
    if name == "flow":
        host = Unit(name)
        unit = host.start()
        start = np.array(host.get(unit, "fracture.aperture"))
        unit.freeInstance()
        shutil.rmtree(host.folder)
        rows = [(STEP * k, (1 + 0.25 * k) * start) for k in range(6)]
        signals = np.array(rows, dtype=[("time", "f8"), ("fracture.aperture", "f8", start.shape)])
        arrays, scalars = ["matrix.pressure", "fracture.pressure", "energy.boundary"], ["matrix_pressure.mean"]
    result = fmpy.simulate_fmu(
        fmu, stop_time=5 * STEP, output_interval=STEP, step_size=STEP, input=signals, output=arrays + scalars
    )
    assert list(result["time"]) == [STEP * k for k in range(6)]
    for array in arrays:
        for step in range(1, 6):
            assert result[array][step].tobytes() == direct[f"{name}.{array}.{step}"], (array, step)
    assert result[arrays[0]][2].tobytes() != direct[f"{name}.{arrays[0]}.1"]
    assert np.isfinite([result[scalar][-1] for scalar in scalars]).all()


# 2. Arrays, and what is wrong.


def test_description_and_library_agree_on_every_size(host):
    """Neither FMPy nor the schemas look at this."""
    root = xml(str(CASE / f"{host.name}.fmu"), "modelDescription.xml")
    starts = {v.get("name"): v.get("start") for v in root.find("ModelVariables") if v.get("start")}
    unit = host.start()
    for name, variable in host.variables.items():
        size = host.size(name)
        if name in starts:
            given = np.array([{"false": 0, "true": 1}.get(v, v) for v in starts[name].split()], dtype=float)
            assert len(given) in (1, size), name
            if name != "time":
                assert (np.array(host.get(unit, name)) == given).all(), name
        if variable.type == "Float64":
            for wrong in (size - 1, size + 1):
                with pytest.raises(FMICallException):
                    unit.getFloat64([variable.valueReference], nValues=wrong)
                assert f"{wrong} values were given for {size}" in host.log[-1][2]
    assert "fracture.aperture" in starts or host.name == "mechanics"
    unit.freeInstance()


def test_arrays_come_back_as_they_were_set(host):
    unit = host.start()
    for name in [v.name for v in host.variables.values() if v.causality == "input"]:
        values = list(np.linspace(1.0, 2.0, host.size(name)))
        host.set(unit, name, values)
        assert host.get(unit, name) == values
    unit.freeInstance()


FIELD = {"mechanics": "fracture.pressure", "flow": "fracture.aperture"}
RESULT = {"mechanics": "fracture.aperture", "flow": "fracture.pressure"}


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda h, u: h.set(u, FIELD[h.name], [1.0]), "1 values were given for"),
        (lambda h, u: u.getFloat64([7777]), "no variable has the value reference 7777"),
        (lambda h, u: u.setInt64([h.variables[FIELD[h.name]].valueReference], [1]), "is of type Float64"),
        (lambda h, u: h.set(u, RESULT[h.name], [1.0] * h.size(RESULT[h.name])), "cannot be set in Step Mode"),
        (lambda h, u: u.exitInitializationMode(), "not allowed in Step Mode"),
        (lambda h, u: u.enterInitializationMode(), "not allowed in Step Mode"),
        (lambda h, u: u.doStep(50.0, 50.0), "the unit is at 0"),
        (lambda h, u: u.doStep(0.0, -1.0), "communicationStepSize is -1"),
        (lambda h, u: u.doStep(0.0, float("nan")), "communicationStepSize is NaN"),
        (
            lambda h, u: u.getDirectionalDerivative([h.variables["time"].valueReference], [0], [1.0], nSensitivity=1),
            "no derivative with respect to",
        ),
    ],
)
def test_what_is_wrong_is_an_error_with_a_message(host, call, message):
    unit = host.start()
    state, before = unit.getFMUState(), host.results(unit)
    with pytest.raises(FMICallException) as error:
        call(host, unit)
    assert error.value.status == 3
    assert (host.log[-1][:2], message in host.log[-1][2]) == ((3, "logStatusError"), True), host.log
    unit.setFMUState(state)
    assert host.results(unit) == before
    advance(unit, 0, 1)
    unit.freeInstance()


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_numbers_that_are_not_finite_are_refused_and_the_old_ones_kept(host, bad):
    unit = host.start()
    numbers = [v for v in host.variables.values() if v.type == "Float64"]
    inputs = [v.name for v in numbers if v.causality in ("input", "parameter")]
    assert len(inputs) >= 6
    for name in inputs:
        state, before = unit.getFMUState(), host.results(unit)
        values = host.get(unit, name)
        values[-1] = bad
        with pytest.raises(FMICallException):
            host.set(unit, name, values)
        assert f"{name}: " in host.log[-1][2] and "must be finite" in host.log[-1][2]
        assert host.results(unit) == before
        unit.setFMUState(state)
        unit.freeFMUState(state)
    unit.freeInstance()


@pytest.mark.parametrize("bad", [0.0, -1e-4])
def test_a_step_with_an_aperture_that_is_not_positive_is_discarded(bad):
    host = Unit("flow")
    unit = host.start()
    good = host.get(unit, "fracture.aperture")
    host.set(unit, "fracture.aperture", [*good[:-1], bad])
    before = host.results(unit)
    with pytest.raises(FMICallException) as error:
        unit.doStep(0.0, STEP)
    assert error.value.status == 2 and f"face {len(good) - 1}" in host.log[-1][2]
    assert host.results(unit) == before
    host.set(unit, "fracture.aperture", good)
    unit.doStep(0.0, STEP)
    unit.freeInstance()
    shutil.rmtree(host.folder)


def test_a_step_that_closes_a_fracture_is_discarded_and_changes_nothing():
    host = Unit("flow")
    unit = host.start()
    advance(unit, 0, 1)
    # Pressures far below the reference close a fracture of this compliance.
    host.set(unit, "fracture.aperture_compliance", [1e-9] * host.size("fracture.aperture"))
    host.set(unit, "fracture.pressure_reference", [1e9] * host.size("fracture.aperture"))
    state, before = unit.getFMUState(), host.results(unit)
    derivative = respond(host, unit)
    with pytest.raises(FMICallException) as error:
        unit.doStep(STEP, STEP)
    assert error.value.status == 2 and "would get an aperture of" in host.log[-1][2]
    assert host.results(unit) == before
    # The equations of the step that failed are not those of the state.
    assert respond(host, unit) == derivative
    unit.setFMUState(state)
    host.set(unit, "fracture.pressure_reference", [1e5] * host.size("fracture.aperture"))
    advance(unit, 1, 2)
    unit.freeInstance()
    shutil.rmtree(host.folder)


# 3. Rollback and states.


def test_a_repeated_step_has_the_same_bits(host):
    unit = host.start()
    host.drive(unit)
    advance(unit, 0, 1)
    host.stiffen(unit)
    state, before = unit.getFMUState(), host.results(unit)
    advance(unit, 1, 3)
    first = host.results(unit), respond(host, unit)
    assert first[0] != before
    unit.setFMUState(state)
    assert host.results(unit) == before
    # Something else in between leaves no trace.
    host.drive(unit, 0.5)
    unit.doStep(STEP, 0.5 * STEP)
    unit.setFMUState(state)
    advance(unit, 1, 3)
    assert (host.results(unit), respond(host, unit)) == first
    unit.freeFMUState(state)
    unit.freeInstance()


def respond(host, unit):
    """Some directional derivative, as bytes."""
    known, unknown = FIELD[host.name], RESULT[host.name]
    seed = list(np.linspace(1.0, 2.0, host.size(known)))
    product = unit.getDirectionalDerivative(
        [host.variables[unknown].valueReference],
        [host.variables[known].valueReference],
        seed,
        nSensitivity=host.size(unknown),
    )
    return struct.pack(f"{len(product)}d", *product)


CONTINUE = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import test_units as t
host = t.Unit(sys.argv[2])
units = [host.instantiate() for _ in range(2)]
for unit in units:
    unit.setFMUState(unit.deserializeFMUState(Path(sys.argv[3]).read_bytes()))
# Each without what the other has made ready.
response = t.respond(host, units[1])
unit = units[0]
print(host.results(unit), response)
t.advance(unit, 2, 4)
print(host.results(unit), t.respond(host, unit))
"""


def test_a_state_goes_on_in_another_process(host, tmp_path):
    unit = host.start()
    host.drive(unit)
    host.stiffen(unit)
    advance(unit, 0, 2)
    saved = tmp_path / "state"
    saved.write_bytes(unit.serializeFMUState(unit.getFMUState()))
    lines = [f"{host.results(unit)} {respond(host, unit)}"]
    advance(unit, 2, 4)
    lines.append(f"{host.results(unit)} {respond(host, unit)}")
    command = [sys.executable, "-c", CONTINUE, Path(__file__).parent, host.name, saved]
    other = subprocess.run(command, capture_output=True, text=True, check=True)
    assert other.stdout.splitlines() == lines
    assert lines[0] != lines[1]
    unit.freeInstance()


def test_corrupt_states_are_refused(host):
    unit = host.start()
    good = unit.serializeFMUState(unit.getFMUState())
    for bad in [b"", good[:-1], good[: len(good) // 2], good[:200] + b"x" + good[201:]]:
        with pytest.raises(FMICallException):
            unit.deserializeFMUState(bad)
        assert "corrupt" in host.log[-1][2]
        unit.reset()
    other = Unit("flow" if host.name == "mechanics" else "mechanics")
    stranger = other.instantiate()
    with pytest.raises(FMICallException):
        stranger.deserializeFMUState(good)
    assert "belongs to another model" in other.log[-1][2]
    stranger.freeInstance()
    shutil.rmtree(other.folder)
    unit.freeInstance()


def test_reset_begins_anew(host):
    unit = host.start()
    start = host.results(unit)
    host.drive(unit)
    host.stiffen(unit)
    advance(unit, 0, 2)
    assert host.results(unit) != start
    unit.reset()
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    assert host.results(unit) == start
    unit.freeInstance()


# 4. Instances, threads, memory.


def test_instances_in_threads_do_not_disturb_each_other(host):
    def run(factor, results):
        unit = host.start([])
        host.drive(unit, factor)
        advance(unit, 0, 10)
        results[factor] = host.results(unit)
        unit.fmi3FreeInstance(unit.component)

    alone, together = {}, {}
    for factor in (0.5, 1.0):
        run(factor, alone)
    assert alone[0.5] != alone[1.0]
    threads = [threading.Thread(target=run, args=(factor, together)) for factor in (0.5, 1.0)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert together == alone


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def test_many_instances_leave_no_memory(host):
    """200 cycles, or as many as UNIT_CYCLES says."""

    def cycle():
        unit = host.start([])
        host.drive(unit)
        states = [unit.getFMUState() for _ in range(10)]
        unit.serializeFMUState(states[0])
        advance(unit, 0, 1)
        unit.fmi3FreeInstance(unit.component)

    [cycle() for _ in range(50)]
    before = resident()
    [cycle() for _ in range(int(os.environ.get("UNIT_CYCLES", 200)))]
    # An instance takes some megabytes, a state some 20 kB: a leak of either in each cycle would be seen.
    assert resident() - before < 2_000_000


# 5. Directional derivatives.


def derivative_and_difference(host, known, unknown, direction, size):
    """Product of the Jacobian, and central differences of steps that are made again."""
    unit = host.start()
    host.drive(unit)
    advance(unit, 0, 2)
    state = unit.getFMUState()
    start = np.array(host.get(unit, known))

    def result(shift):
        unit.setFMUState(state)
        host.set(unit, known, start + shift * direction)
        unit.doStep(2 * STEP, STEP)
        return np.array(host.get(unit, unknown))

    difference = (result(size) - result(-size)) / (2 * size)
    result(0.0)
    states = host.get(unit, "fracture.contact_state") if host.name == "mechanics" else []
    refs = [host.variables[name].valueReference for name in (unknown, known)]
    product = unit.getDirectionalDerivative(refs[:1], refs[1:], list(direction), nSensitivity=host.size(unknown))
    unit.freeInstance()
    return np.array(product), difference, states


@pytest.mark.parametrize("unknown", ["fracture.aperture", "matrix.porosity_change", "fracture.displacement_jump"])
@pytest.mark.parametrize("known", ["matrix.pressure", "fracture.pressure"])
def test_derivatives_of_mechanics_agree_with_differences(known, unknown):
    host = Unit("mechanics")
    direction = np.sin(1.0 + np.arange(host.size(known)))
    product, difference, states = derivative_and_difference(host, known, unknown, direction, 100.0)
    # Open, sticking and slipping faces take part.
    assert set(states) == {0, 1, 2}
    scale = abs(difference).max()
    assert scale > 0
    assert abs(product - difference).max() < 1e-5 * scale
    shutil.rmtree(host.folder)


@pytest.mark.parametrize("unknown", ["matrix.pressure", "fracture.pressure"])
@pytest.mark.parametrize(
    "known", ["matrix.porosity_change", "fracture.aperture", "matrix.pressure_reference", "fracture.pressure_reference"]
)
def test_derivatives_of_flow_agree_with_differences(known, unknown):
    host = Unit("flow")
    started = host.start

    def start():
        unit = started()
        host.stiffen(unit)
        return unit

    host.start = start
    direction = np.sin(1.0 + np.arange(host.size(known)))
    size = {"matrix.porosity_change": 1e-6, "fracture.aperture": 1e-6}.get(known, 1e4)
    product, difference, _ = derivative_and_difference(host, known, unknown, direction, size)
    scale = abs(difference).max()
    assert scale > 0
    # A step is linear: only round-off differs.
    assert abs(product - difference).max() < 1e-8 * scale
    shutil.rmtree(host.folder)


# 6. Coupled.


def test_a_loop_in_python_couples_the_units(direct):
    """couple.py against the loop in Rust on the same mesh."""
    command = [sys.executable, Path(couple.__file__), CASE / "flow.fmu", CASE / "mechanics.fmu", "100", "500"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = [list(map(float, line.split())) for line in run.stdout.splitlines()]
    assert [row[0] for row in rows] == [100, 200, 300, 400, 500]
    for step in (1, 5):
        expected = struct.unpack("3d", direct[f"coupled.means.{step}"])
        # Both stop when the pressures change by a few Pa, of some 1e6 Pa.
        assert rows[step - 1][1:4] == pytest.approx(expected, rel=3e-5)
        assert rows[step - 1][4] < 30
    # Something has happened.
    assert rows[0][2] > 2e5 and rows[4][2] > 1.2 * rows[0][2]


def test_the_readme_shows_the_loop_that_is_run():
    text = Path(__file__).with_name("README.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert Path(couple.__file__).read_text() in blocks


# Resources that are not sound.


def spoil(change):
    def test(host, tmp_path):
        folder = tmp_path / "unit"
        shutil.copytree(host.folder, folder)
        resources = folder / "resources"
        expected = change(resources)
        log = []
        with pytest.raises(Exception, match="Failed to instantiate"):
            host.instantiate(log, unzipDirectory=str(folder))
        assert log[-1][0] == 3 and re.search(expected, log[-1][2]), log
        # The host is alive.
        unit = host.start()
        advance(unit, 0, 1)
        unit.freeInstance()

    return test


def truncate(resources):
    file = resources / "mesh.h5"
    file.write_bytes(file.read_bytes()[:2000])
    return "mesh.h5"


def cut_end(resources):
    file = resources / "mesh.h5"
    file.write_bytes(file.read_bytes()[:-100])
    return "mesh.h5"


def no_mesh(resources):
    (resources / "mesh.h5").unlink()
    return "mesh.h5"


def no_hdf5(resources):
    (resources / "mesh.h5").write_text("nothing")
    return "mesh.h5"


def other_version(resources):
    file = resources / "mesh.h5"
    content = file.read_bytes()
    assert VERSION.search(content)
    file.write_bytes(VERSION.sub(VERSION_CHANGED, content, count=1))
    return "version"


def other_mesh(resources):
    shutil.copy(CASE.parent / "c3-other" / "resources" / "mesh.h5", resources / "mesh.h5")
    return "token"


def broken_model(resources):
    (resources / "model.toml").write_text("title = [")
    return "model.toml"


def unknown_key(resources):
    file = resources / "model.toml"
    file.write_text("nonsense = 1\n" + file.read_text())
    return "nonsense"


def other_model(resources):
    file = resources / "model.toml"
    text = file.read_text()
    changed = text.replace("young_modulus = 10000000000.0", "young_modulus = 20000000000.0")
    assert changed != text
    file.write_text(changed)
    return "token"


def negative_modulus(resources):
    file = resources / "model.toml"
    file.write_text(file.read_text().replace("young_modulus = 10000000000.0", "young_modulus = -1.0"))
    return "young_modulus"


test_a_truncated_mesh_is_refused = spoil(truncate)
test_a_mesh_without_its_end_is_refused = spoil(cut_end)
test_a_missing_mesh_is_refused = spoil(no_mesh)
test_a_file_that_is_no_hdf5_is_refused = spoil(no_hdf5)
test_another_mesh_is_refused = spoil(other_mesh)
test_a_broken_model_is_refused = spoil(broken_model)
test_an_unknown_key_is_refused = spoil(unknown_key)
test_another_model_is_refused = spoil(other_model)
test_a_modulus_out_of_range_is_refused = spoil(negative_modulus)


# Wells, boundaries, gravity and sources, in 3D.


@pytest.fixture
def wells():
    host = Unit("flow", CASE.parent / "wells")
    yield host
    shutil.rmtree(host.folder)


def test_wells_are_known_by_their_names(wells):
    assert validate_fmu(str(CASE.parent / "wells" / "flow.fmu")) == []
    names = {v.name: v.causality for v in wells.variables.values() if v.name.startswith("wells.")}
    assert names == {
        "wells.inj_1.rate": "input",
        "wells.inj_1.pressure": "output",
        "wells.choked.rate": "input",
        "wells.choked.pressure": "output",
        "wells.choked.actual_rate": "output",
        "wells.choked.limited": "output",
        "wells.producer.pressure": "input",
        "wells.producer.rate": "output",
    }
    terminals = xml(str(CASE.parent / "wells" / "flow.fmu"), "terminalsAndIcons/terminalsAndIcons.xml")
    members = {m.get("variableName") for m in terminals.iter("TerminalMemberVariable")}
    assert set(names) < members


def test_wells_sources_and_boundaries_add_up(wells):
    unit = wells.start()
    def number(name):
        return wells.get(unit, name)[0]

    def in_place():
        return number("fluid_in_place.matrix") + number("fluid_in_place.fractures")

    assert number("wells.inj_1.rate") == 1e-4 and number("wells.producer.pressure") == 1.9e7
    assert number("wells.inj_1.pressure") == pytest.approx(2e7 - 1e4 * 7.5)
    unit.doStep(0.0, 10.0)
    # q/(W/η) ≈ 53 kPa above the cell, by Peaceman.
    assert 53e3 < number("wells.inj_1.pressure") - (2e7 - 1e4 * 7.5) < 90e3
    assert number("wells.producer.rate") < 0
    limited = unit.getBoolean([wells.variables["wells.choked.limited"].valueReference])
    assert limited == [True] and number("wells.choked.pressure") == 2.5e7
    assert 0 < number("wells.choked.actual_rate") < 1e-2
    # 40 m × 20 m at 1e-8 (1 + t) m/s at the end of the time step.
    assert number("boundary.right.inflow") == pytest.approx(800 * 1.1e-7)
    assert number("boundary.right.fracture_inflow") == 0.0
    assert abs(number("mass_balance.error")) < 1e-12
    energies = {n[7:]: number(n) for n in wells.variables if n.startswith("energy.")}
    gained = sum(energies.pop(n) for n in ("source", "boundary", "wells", "gravity"))
    assert sum(energies.values()) == pytest.approx(gained, rel=1e-9)
    # What is stored comes from outside. (Compressible: fluid in place is at the reference density.)
    before = in_place()
    for name in ("wells.inj_1.rate", "wells.choked.rate"):
        wells.set(unit, name, [0.0])
    unit.doStep(10.0, 10.0)
    assert in_place() != before
    assert number("wells.choked.actual_rate") == 0.0
    unit.freeInstance()


def test_pressures_and_apertures_at_the_start_are_those_of_the_model(wells):
    unit = wells.start()
    at_rest = wells.get(unit, "matrix.pressure")
    assert max(at_rest) - min(at_rest) == pytest.approx(15e4)
    # The fault is two faces high: the centres of all are half the largest distance from its edges.
    assert wells.get(unit, "fracture.aperture") == pytest.approx([1.5e-4] * wells.size("fracture.aperture"))
    unit.freeInstance()


def test_stiffnesses_are_capped(wells):
    unit = wells.start()
    wells.set(unit, "fracture_pressure_stiffness.cap", [1e30])
    # What leaks off makes it less than 1/(c d), 2e9 Pa over the aperture.
    natural = np.array(wells.get(unit, "fracture.pressure_stiffness"))
    assert min(natural) > 0
    assert max(natural * wells.get(unit, "fracture.aperture")) < 2e9
    cap = 0.5 * min(natural)
    wells.set(unit, "fracture_pressure_stiffness.cap", [cap])
    assert set(wells.get(unit, "fracture.pressure_stiffness")) == {cap}
    # 1/(1/M + φ c)
    assert wells.get(unit, "matrix.pressure_stiffness")[0] == pytest.approx(1 / (1e-10 + 0.2 / 2e9))
    wells.set(unit, "matrix_pressure_stiffness.cap", [1e8])
    assert set(wells.get(unit, "matrix.pressure_stiffness")) == {1e8}
    unit.freeInstance()


def test_apertures_set_before_the_start_are_those_of_the_start():
    host = Unit("flow")
    unit = host.instantiate()
    unit.enterInitializationMode()
    before = host.get(unit, "fluid_in_place.fractures")[0]
    start = np.array(host.get(unit, "fracture.aperture"))
    host.set(unit, "fracture.aperture", 2 * start)
    unit.exitInitializationMode()
    assert host.get(unit, "fluid_in_place.fractures")[0] == pytest.approx(2 * before)
    unit.doStep(0.0, 100.0)
    # Nothing has changed, so nothing flows.
    assert np.array(host.get(unit, "fracture.pressure")) == pytest.approx(1e5, rel=1e-9)
    unit.freeInstance()
    shutil.rmtree(host.folder)


def test_both_units_in_threads_at_once():
    """They share the HDF5 library."""
    hosts = [Unit(name) for name in UNITS]

    def run(host, count):
        for _ in range(20):
            unit = host.instantiate([])
            unit.fmi3FreeInstance(unit.component)
            count.append(1)

    done = []
    threads = [threading.Thread(target=run, args=(host, done)) for host in hosts for _ in range(2)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert len(done) == 80
    [shutil.rmtree(host.folder) for host in hosts]
