"""A flow that was recorded: the pressures of an earlier run, linear in time between its records.

With it mechanics can be studied alone, under pressures as they are: friction, bubbles, the contact solver. What comes from
mechanics is taken and has no effect. Before the first record the pressures are those of the first, after the last those of
the last.
"""

from pathlib import Path

import numpy as np
from pythonfmu3 import Fmi3Slave

from arrays import DONE, Arrays
from mesh import Mesh

PRESSURES = "matrix.pressure", "fracture.pressure"


class Recorded(Arrays, Fmi3Slave):
    """Pressures as a function of time alone: a step goes nowhere but to its end."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description = "Pressures of an earlier run"
        resources = Path(self.resources)
        mesh = Mesh(np.load(resources / "mesh.npz"))
        run = np.load(resources / "run.npz")
        # The groups of the fields are numbers of time steps, with the time as an attribute.
        groups = sorted(name.split("/")[1] for name in run if name.endswith("/matrix.pressure"))
        if not groups:
            raise ValueError("run.h5 holds no fields: the run must have output times")
        self.times = np.array([run[f"fields/{group}@time"] for group in groups], dtype=float)
        self.records = {name: np.array([run[f"fields/{group}/{name}"] for group in groups]) for name in PRESSURES}

        self.output("matrix.pressure", "Pa", self.records["matrix.pressure"][0], "Pressure in the rock")
        self.output("fracture.pressure", "Pa", self.records["fracture.pressure"][0], "Pressure in the fractures")
        self.input("matrix.porosity_change", "1", np.zeros(mesh.cell_count), "Has no effect")
        self.input("fracture.aperture", "m", np.zeros(len(mesh.fracture_faces)), "Has no effect")
        self.text("mesh.fingerprint", mesh.fingerprint, "Hash of the mesh's topology and coordinates")

    def setup_experiment(self, start_time):
        self._play(start_time)

    def do_step(self, current_time, step_size):
        self._play(current_time + step_size)
        return DONE

    def _play(self, time):
        after = int(np.clip(np.searchsorted(self.times, time), 1, len(self.times) - 1)) if len(self.times) > 1 else 0
        before = max(after - 1, 0)
        span = self.times[after] - self.times[before]
        weight = np.clip((time - self.times[before]) / span, 0, 1) if span > 0 else 0
        for name, records in self.records.items():
            self.values[name] = (1 - weight) * records[before] + weight * records[after]
