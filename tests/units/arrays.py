"""What the units have in common: arrays as FMI variables, and a state that can be gone back to."""

import sys
from functools import partial

import numpy as np
import pythonfmu3.variables
from pythonfmu3 import Dimension, Float64, Fmi3Causality, Fmi3SlaveBase, Fmi3Status, Fmi3StepResult, Fmi3Variability
from pythonfmu3 import String, Unit

# pythonfmu3 0.3.4 cuts starts that are longer than this to their first letter.
pythonfmu3.variables.MAX_LENGTH = sys.maxsize

DONE = Fmi3StepResult()
DISCARDED = Fmi3StepResult(status=Fmi3Status.discard)

UNITS = {
    "1": {},
    "s": dict(s=1),
    "m": dict(m=1),
    "Pa": dict(kg=1, m=-1, s=-2),
    "1/Pa": dict(kg=-1, m=1, s=2),
    "m/Pa": dict(kg=-1, m=2, s=2),
    "m2/s": dict(m=2, s=-1),
}


class Arrays(Fmi3SlaveBase):
    """A unit whose variables are `self.values[name]`, and that keeps `self.memory[name]` from one time step to the next.

    Both are arrays of floats (scalars have one entry) and are all that its future depends on: they are its FMU state.
    """

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.values, self.memory = {}, {}
        self.register_units([Unit(name, **base) for name, base in UNITS.items()])
        time = dict(causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous)
        self.register_variable(Float64("time", unit="s", getter=lambda: 0.0, **time), nested=False)

    def input(self, name, unit, start, description):
        """An input; `start` is an array, or a number for a scalar."""
        self._add(name, unit, start, description, Fmi3Causality.input, Fmi3Variability.continuous)

    def parameter(self, name, unit, start, description):
        """A number that the host may set before the start."""
        self._add(name, unit, start, description, Fmi3Causality.parameter, Fmi3Variability.fixed)

    def output(self, name, unit, start, description):
        """An output with its value at the start."""
        self._add(name, unit, start, description, Fmi3Causality.output, Fmi3Variability.continuous)

    def text(self, name, value, description):
        """A text that never changes."""
        kind = dict(causality=Fmi3Causality.output, variability=Fmi3Variability.discrete)
        self.register_variable(String(name, description=description, getter=lambda: value, **kind), nested=False)

    def scalar(self, name):
        """The value of a scalar."""
        return self.values[name].item()

    def put(self, name, values):
        """Takes values for a variable, or fails with its name."""
        values = np.atleast_1d(np.array(values, dtype=float))
        if values.shape != self.values[name].shape:
            raise ValueError(f"{name} has {self.values[name].size} entries, not {values.size}")
        # Minus infinity is a magnitude without slip.
        if np.isnan(values).any() or np.isposinf(values).any():
            raise ValueError(f"{name} must not be NaN or infinite")
        self.values[name] = values

    def _add(self, name, unit, start, description, causality, variability):
        start = np.array(start, dtype=float)
        self.values[name] = np.atleast_1d(start)

        def get():
            values = self.values[name].tolist()
            return values if start.ndim else values[0]

        variable = Float64(
            name,
            unit=unit,
            description=description,
            causality=causality,
            variability=variability,
            dimensions=[Dimension(start=str(n)) for n in start.shape],
            getter=get,
            # The host must not set outputs.
            setter=None if causality == Fmi3Causality.output else partial(self.put, name),
        )
        self.register_variable(variable, nested=False)

    def _get_fmu_state(self):
        return [{name: array.tolist() for name, array in part.items()} for part in (self.values, self.memory)]

    def _set_fmu_state(self, state):
        self.values, self.memory = ({name: np.array(array) for name, array in part.items()} for part in state)
