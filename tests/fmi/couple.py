"""Couples flow and mechanics by fixed stress: couple.py FLOW.fmu MECHANICS.fmu STEP END"""

import sys
from itertools import count
from math import prod

import numpy as np
from fmpy import extract, instantiate_fmu, read_model_description

# What is exchanged, and how closely it is to converge (Pa, Pa, 1, m).
PRESSURES = {"matrix.pressure": 1.0, "fracture.pressure": 1.0}
DEFORMATION = {"matrix.porosity_change": 1e-9, "fracture.aperture": 1e-10}
COMPLIANCES = "matrix.porosity_compliance", "fracture.aperture_compliance"


class Unit:
    """An FMU whose variables are known by their names."""

    def __init__(self, path, start):
        description = read_model_description(path)
        self.variables = {v.name: v for v in description.modelVariables}
        self.fmu = instantiate_fmu(extract(path), description)
        self.fmu.enterInitializationMode()
        for name, field in start.items():
            self.set(name, field)
        self.fmu.exitInitializationMode()

    def get(self, name):
        variable = self.variables[name]
        size = prod(d.start for d in variable.dimensions)
        return np.array(self.fmu.getFloat64([variable.valueReference], nValues=size))

    def set(self, name, values):
        self.fmu.setFloat64([self.variables[name].valueReference], values)


def values(unit, names):
    return {name: unit.get(name) for name in names}


def converged(new, old, tolerances):
    return all(abs(new[name] - old[name]).max() <= tolerance for name, tolerance in tolerances.items())


def advance(flow, mechanics, time, step):
    """One time step of both. Returns the number of coupling iterations."""
    start = [(unit.fmu, unit.fmu.getFMUState()) for unit in (flow, mechanics)]
    pressures, deformation = values(flow, PRESSURES), values(mechanics, DEFORMATION)
    compliances = values(mechanics, COMPLIANCES)
    for iteration in count(1):
        for fmu, state in start:
            fmu.setFMUState(state)
        references = {name + "_reference": p for name, p in pressures.items()}
        for name, field in (deformation | compliances | references).items():
            flow.set(name, field)
        flow.fmu.doStep(time, step)
        last, pressures = pressures, values(flow, PRESSURES)
        for name, field in pressures.items():
            mechanics.set(name, field)
        mechanics.fmu.doStep(time, step)
        before, deformation = deformation, values(mechanics, DEFORMATION)
        if converged(pressures, last, PRESSURES) and converged(deformation, before, DEFORMATION):
            break
    for fmu, state in start:
        fmu.freeFMUState(state)
    return iteration


if __name__ == "__main__":
    mechanics = Unit(sys.argv[2], {})
    flow = Unit(sys.argv[1], values(mechanics, DEFORMATION))
    step, end = float(sys.argv[3]), float(sys.argv[4])
    for time in np.arange(0, end, step):
        iterations = advance(flow, mechanics, time, step)
        means = [unit.get(f"{name}.mean")[0] for unit, name in (
            (mechanics, "aperture"), (flow, "fracture_pressure"), (flow, "matrix_pressure"))]
        print(time + step, *means, iterations)
