"""The example unit driven by FMPy: results, arrays, rollback, states, derivatives, threads, memory."""

import struct
import subprocess
import sys
import threading
from pathlib import Path

import fmpy
import numpy as np
import pytest
from conftest import AMBIENT, BLOB, ENABLED, FAULT, HEAT, HOTTEST, LABEL, LOSS, PHASE, STEPS, TEMPERATURE
from fmpy.fmi1 import FMICallException


def reference(heat, steps, step, ambient=300.0, cells=4):
    """The example's equations, in the same order of operations."""
    t = np.full((len(heat), cells), ambient)
    for _ in range(steps):
        left, right = np.roll(t, 1, 1), np.roll(t, -1, 1)
        left[:, 0], right[:, -1] = t[:, 0], t[:, -1]
        source = np.zeros_like(t)
        source[:, 0] = heat
        t = t + step / 10.0 * (0.5 * (left - 2.0 * t + right) + source)
    return t


def bits(values):
    return struct.pack(f"{len(values)}d", *values)


def temperatures(unit):
    return unit.getFloat64([TEMPERATURE], nValues=12)


def advance(unit, times, step=0.5):
    for time in times:
        unit.doStep(time, step)


def test_simulate_fmu_records_scalars_and_arrays(fmu):
    heat = np.array([1.0, 2.0, 3.0])
    signals = np.array([(0.0, heat), (10.0, heat)], dtype=[("time", "f8"), ("bars.heat", "f8", (3,))])
    result = fmpy.simulate_fmu(
        fmu,
        stop_time=10.0,
        output_interval=0.5,
        start_values={"ambient": 290.0},
        input=signals,
        output=["hottest", "steps", "bars.temperature", "bars.phase"],
    )
    expected = reference(heat, 20, 0.5, ambient=290.0)
    assert result["time"][-1] == 10.0
    assert result["steps"][-1] == 20
    assert bits(result["bars.temperature"][-1].ravel()) == bits(expected.ravel())
    assert result["hottest"][-1] == expected.max()


def test_arrays_in_and_out(host):
    unit = host.start()
    unit.setFloat64([HEAT], [10.0, 20.0, 30.0])
    advance(unit, [0.0, 0.5])
    expected = reference(np.array([10.0, 20.0, 30.0]), 2, 0.5)
    assert bits(temperatures(unit)) == bits(expected.ravel())
    # Two variables in one call.
    assert unit.getFloat64([HOTTEST, HEAT], nValues=4) == [expected.max(), 10.0, 20.0, 30.0]
    assert unit.getInt64([PHASE], nValues=3) == [1, 1, 1]
    assert unit.getUInt64([STEPS]) == [2]
    unit.terminate()
    assert unit.getUInt64([STEPS]) == [2]
    unit.freeInstance()


def test_other_types(host):
    unit = host.instantiate()
    unit.setString([LABEL], ["größer"])
    unit.setBinary([BLOB], [b"\0\1\2"])
    unit.setBoolean([ENABLED], [False])
    assert unit.getString([LABEL]) == ["größer"]
    assert unit.getBinary([BLOB]) == [b"\0\1\2"]
    assert unit.getBoolean([ENABLED]) == [False]
    unit.freeInstance()


def test_a_repeated_step_has_the_same_bits(host):
    unit = host.start(heat=[1.0, 2.0, 3.0])
    advance(unit, [0.0])
    state = unit.getFMUState()
    advance(unit, [0.5, 1.0])
    first = bits(temperatures(unit))
    # Something else in between leaves no trace.
    unit.setFMUState(state)
    unit.setFloat64([HEAT], [9.0, 9.0, 9.0])
    advance(unit, [0.5])
    unit.setFMUState(state)
    advance(unit, [0.5, 1.0])
    assert bits(temperatures(unit)) == first
    unit.freeFMUState(state)
    unit.freeInstance()


def test_reset_begins_anew(host):
    unit = host.start(heat=[1.0, 2.0, 3.0])
    advance(unit, [0.0, 0.5])
    unit.reset()
    assert unit.getFloat64([HEAT], nValues=3) == [0.0] * 3
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    advance(unit, [0.0])
    assert unit.getUInt64([STEPS]) == [1]
    unit.freeInstance()


CONTINUE = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from conftest import Host
from test_simulation import advance, bits, temperatures
unit = Host(sys.argv[2]).instantiate()
state = unit.deserializeFMUState(Path(sys.argv[3]).read_bytes())
unit.setFMUState(state)
advance(unit, [1.0, 1.5])
print(bits(temperatures(unit)).hex())
"""


def test_a_state_goes_on_in_another_process(host, fmu, tmp_path):
    unit = host.start(heat=[1.0, 2.0, 3.0])
    advance(unit, [0.0, 0.5])
    saved = tmp_path / "state"
    saved.write_bytes(unit.serializeFMUState(unit.getFMUState()))
    advance(unit, [1.0, 1.5])
    command = [sys.executable, "-c", CONTINUE, Path(__file__).parent, fmu, saved]
    other = subprocess.run(command, capture_output=True, text=True, check=True)
    assert other.stdout.strip() == bits(temperatures(unit)).hex()
    unit.freeInstance()


def test_corrupt_states_are_refused(host):
    unit = host.start()
    good = unit.serializeFMUState(unit.getFMUState())
    for bad in [b"", good[:-1], good[: len(good) // 2], good[:100] + b"x" + good[101:], bytes(len(good))]:
        with pytest.raises(FMICallException):
            unit.deserializeFMUState(bad)
        assert "corrupt" in host.log[-1][2]
        unit.reset()
        unit.setFMUState(unit.deserializeFMUState(good))
    advance(unit, [0.0])
    unit.freeInstance()


def test_directional_derivatives_agree_with_differences(host):
    unit = host.start()
    heat, direction, h = np.array([100.0, 200.0, 300.0]), np.array([1.0, -2.0, 0.5]), 1e-3

    def loss(q):
        unit.setFloat64([HEAT], list(q))
        return np.array(unit.getFloat64([LOSS], nValues=3))

    difference = (loss(heat + h * direction) - loss(heat - h * direction)) / (2 * h)
    loss(heat)
    product = unit.getDirectionalDerivative([LOSS], [HEAT], list(direction), nSensitivity=3)
    assert product == pytest.approx(difference, rel=1e-6)
    transposed = unit.getAdjointDerivative([LOSS], [HEAT], [1.0, 1.0, 1.0], nSensitivity=3)
    assert np.dot(transposed, direction) == pytest.approx(np.sum(product))
    unit.freeInstance()


def test_a_discarded_step_can_be_tried_again(host):
    unit = host.start(heat=[1.0, 2.0, 3.0])
    before = bits(temperatures(unit))
    with pytest.raises(FMICallException) as error:
        unit.doStep(0.0, 20.0)
    assert error.value.status == 2
    assert host.log[-1] == (2, "logStatusDiscard", "20 s is longer than 10 s")
    assert bits(temperatures(unit)) == before
    unit.doStep(0.0, 10.0)
    unit.freeInstance()


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda u: u.getFloat64([TEMPERATURE], nValues=11), "11 values were given for 12"),
        (lambda u: u.getFloat64([TEMPERATURE], nValues=13), "13 values were given for 12"),
        (lambda u: u.setFloat64([HEAT], [1.0, 2.0]), "2 values were given for 3"),
        (lambda u: u.getFloat64([77]), "no variable has the value reference 77"),
        (lambda u: u.getFloat64([STEPS]), "`steps` is of type UInt64"),
        (lambda u: u.setFloat64([HOTTEST], [1.0]), "`hottest` (continuous output) cannot be set"),
        (lambda u: u.setFloat64([AMBIENT], [1.0]), "`ambient` (fixed parameter) cannot be set in Step Mode"),
        (lambda u: u.setInt64([FAULT], [9]), "no enumeration item 9"),
        (lambda u: u.exitInitializationMode(), "not allowed in Step Mode"),
        (lambda u: u.enterEventMode(), "no event mode"),
        (lambda u: u.getClock([1]), "no clocks"),
        (lambda u: u.enterConfigurationMode(), "no structural parameters"),
        (lambda u: u.getOutputDerivatives([HOTTEST], [1]), "no time derivatives"),
        (lambda u: u.doStep(3.0, 0.5), "the unit is at 0"),
        (lambda u: u.doStep(0.0, -0.5), "communicationStepSize is -0.5"),
        (lambda u: u.setDebugLogging(True, ["nonsense"]), "no category"),
        (lambda u: u.setFMUState(12345), "not one of this instance"),
        (lambda u: (u.setInt64([FAULT], [2]), u.doStep(0.0, 0.5)), "the bars have a fault"),
    ],
)
def test_what_is_wrong_is_an_error_with_a_message(host, call, message):
    unit = host.start()
    state = unit.getFMUState()
    with pytest.raises(FMICallException) as error:
        call(unit)
    assert error.value.status == 3
    assert (host.log[-1][:2], message in host.log[-1][2]) == ((3, "logStatusError"), True), host.log
    # The host is alive, and a state leads back.
    unit.setFMUState(state)
    unit.doStep(0.0, 0.5)
    unit.freeInstance()


def test_a_panic_is_an_error_and_ends_only_its_instance(host):
    broken, sound = host.start(), host.start()
    broken.setInt64([FAULT], [1])
    with pytest.raises(FMICallException):
        broken.doStep(0.0, 0.5)
    assert "the unit panicked: the bars have a fault" in host.log[-1][2]
    with pytest.raises(FMICallException):
        broken.getUInt64([STEPS])
    broken.terminate()
    sound.doStep(0.0, 0.5)
    broken.fmi3FreeInstance(broken.component)
    sound.freeInstance()


@pytest.mark.parametrize(
    "change, message",
    [({"guid": "other"}, "token is `other`"), ({"instanceName": " "}, "instanceName is empty")],
)
def test_refused_instances_leave_a_message(host, change, message):
    with pytest.raises(Exception, match="Failed to instantiate"):
        host.instantiate(**change)
    assert message in host.log[-1][2]


@pytest.mark.parametrize("content", ["", "3", "three four", "3 5", "99999999999 99999999999", "\0"])
def test_changed_resources_are_refused(host, content):
    Path(host.folder, "resources", "size.txt").write_text(content)
    with pytest.raises(Exception, match="Failed to instantiate"):
        host.instantiate()
    assert host.log[-1][0] == 3


def test_other_interface_types_are_refused(host):
    unit = host.start()
    log = unit.logMessage
    assert not unit.fmi3InstantiateModelExchange(b"a", b"b", None, False, True, None, log)
    assert "for co-simulation" in host.log[-1][2]
    unit.freeInstance()


def test_instances_in_threads_do_not_disturb_each_other(host):
    def run(heat, results):
        log = []
        unit = host.start(log, heat=[heat] * 3)
        advance(unit, [0.5 * i for i in range(500)])
        results[heat] = bits(temperatures(unit)), len(log)
        unit.fmi3FreeInstance(unit.component)

    alone, together = {}, {}
    for heat in (1.0, 2.0):
        run(heat, alone)
    threads = [threading.Thread(target=run, args=(heat, together)) for heat in (1.0, 2.0)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert together == alone


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def test_a_thousand_instances_leave_no_memory(host):
    def cycle():
        unit = host.start([], heat=[1.0, 2.0, 3.0])
        states = [unit.getFMUState() for _ in range(10)]
        unit.serializeFMUState(states[0])
        advance(unit, [0.0, 0.5])
        # The states are freed with their instance. The library stays loaded.
        unit.fmi3FreeInstance(unit.component)

    [cycle() for _ in range(200)]
    before = resident()
    [cycle() for _ in range(1000)]
    # One instance with its ten states takes some 20 kB: a leak would be 20 MB.
    assert resident() - before < 2_000_000

