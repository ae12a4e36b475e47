"""Mechanics under recorded pressures does what it did in the run they come from."""

import h5py
import numpy as np
from conftest import ALL_TIMES, COARSE, SIX, Instance, run


def test_mechanics_repeats_the_coupled_run_to_the_last_bit(record, tmp_path):
    again = run(SIX, tmp_path / "again", *COARSE, *ALL_TIMES, "--flow", record / "recorded.fmu")
    with h5py.File(record / "run" / "run.h5") as first, h5py.File(again / "run.h5") as second:
        assert len(first["fields"]) == 20
        for number, group in first["fields"].items():
            for name in group:
                assert (group[name][()] == second["fields"][number][name][()]).all(), (number, name)
        # A pass to follow the pressures, and what the acceleration needs to find that nothing changes.
        assert (second["attempts/iterations"][:] <= 3).all()


def test_pressures_are_linear_between_records(record, tmp_path):
    unit = Instance(record / "recorded.fmu", tmp_path / "a").start()
    with h5py.File(record / "run" / "run.h5") as file:
        at = {group.attrs["time"]: group["matrix.pressure"][:] for group in file["fields"].values()}
    for time, wanted in [(50.0, at[100.0]), (130.0, 0.7 * at[100.0] + 0.3 * at[200.0]), (2500.0, at[2000.0])]:
        unit.fmu.doStep(0.0, time)
        assert np.allclose(unit.get("matrix.pressure"), wanted, rtol=1e-14, atol=0)
