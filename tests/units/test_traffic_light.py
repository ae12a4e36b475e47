"""The traffic light: thresholds with hysteresis, and a fault that does not slip."""

import csv
import subprocess
import time

import numpy as np
import pytest
from conftest import Instance, build, run
from fmpy.validation import validate_fmu
from pack import ROOT, orchestrator

MODEL = ROOT / "models" / "traffic-light"
# Where the model looks for it.
FMU = ROOT / "target" / "units" / "traffic-light.fmu"


@pytest.fixture(scope="module")
def light():
    build("traffic-light")
    return FMU


def series(folder):
    with open(folder / "series.csv", newline="") as file:
        head, *rows = csv.reader(file)
    return dict(zip((name.split(" [")[0] for name in head), np.array(rows, dtype=float).T))


def test_the_unit_is_valid(light):
    assert validate_fmu(str(light)) == []


def test_the_light_goes_up_at_once_and_down_late(light, tmp_path):
    unit = Instance(light, tmp_path / "a").start(full_rate=4.0, yellow=0.8, red=0.9, hysteresis=0.05)
    seen = []
    for signal in [-np.inf, 0.79, 0.8, 0.76, 0.74, 0.9, 0.86, 0.84, 0.76, 0.74, 0.95, 0.7]:
        unit.set("signal", signal)
        unit.fmu.doStep(0.0, 1.0)
        seen.append((int(unit.get("light")[0]), unit.get("rate")[0]))
    assert [light for light, _ in seen] == [0, 0, 1, 1, 0, 2, 2, 1, 1, 0, 2, 0]
    assert all(rate == [4.0, 2.0, 0.0][light] for light, rate in seen)


def test_thresholds_in_the_wrong_order_are_refused(light, tmp_path):
    unit = Instance(light, tmp_path / "a")
    with pytest.raises(Exception, match="ExitInitializationMode"):
        unit.start(yellow=0.9, red=0.8)
    assert "yellow must be below red" in unit.log[-1]


def test_the_fault_slips_without_the_light_and_not_with_it(light, tmp_path):
    held = series(run(MODEL, tmp_path / "held"))
    controlled = series(run(MODEL, tmp_path / "controlled", "--variant", "controlled"))
    assert held["slip.max"][-1] > 3e-3 and held["seismic_moment"][-1] > 5e8
    assert (controlled["slip.max"] == 0).all() and (controlled["seismic_moment"] == 0).all()
    # A rate holds for a whole time step, in which the signal goes on.
    assert controlled["slip_tendency.max"].max() < 0.93
    tendency, lit = controlled["slip_tendency.max"], controlled["light"]
    assert ((tendency >= 0.92) <= (lit == 2)).all() and ((tendency < 0.85) <= (lit == 0)).all()
    assert set(lit) == {0, 1, 2}
    assert (controlled["rate"] == 1.5e-4 * np.array([1, 0.5, 0])[lit.astype(int)]).all()


def test_a_killed_run_goes_on_with_the_light_as_it_was(light, tmp_path):
    options = ["--variant", "controlled", "--set", "time.step=8640"]
    whole = run(MODEL, tmp_path / "whole", *options)
    killed = tmp_path / "killed"
    process = subprocess.Popen([orchestrator(), "run", MODEL, "--output", killed, "--quiet", *options])
    # Until it is well on its way.
    written, part = killed / "journal", (whole / "journal").stat().st_size / 3
    while not (written.exists() and written.stat().st_size > part):
        assert process.poll() is None
        time.sleep(0.001)
    process.kill()
    process.wait()
    assert not (killed / "summary.json").exists()
    subprocess.run([orchestrator(), "resume", killed, "--quiet"], check=True)
    assert (killed / "series.csv").read_bytes() == (whole / "series.csv").read_bytes()
