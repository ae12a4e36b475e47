"""What the FMI layer costs beside a time step: overhead.py FOLDER with mechanics.fmu and flow.fmu.

Calls of the C functions with ready arrays; the least of several repetitions. `get` of outputs counts in full, although
the unit computes some of them.
"""

import ctypes
import sys
import time
from ctypes import byref, c_bool, c_double, c_size_t, c_uint32, c_void_p
from pathlib import Path

import numpy as np
from test_units import UNITS, Unit


def least(repeat, call):
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def pointer(values):
    return values.ctypes.data_as(ctypes.POINTER(c_double))


IN = {
    "mechanics": ["matrix.pressure", "fracture.pressure"],
    "flow": [
        "matrix.porosity_change", "fracture.aperture", "matrix.porosity_compliance", "fracture.aperture_compliance",
        "matrix.pressure_reference", "fracture.pressure_reference",
    ],
}
OUT = {"mechanics": ["matrix.porosity_change", "fracture.aperture"], "flow": ["matrix.pressure", "fracture.pressure"]}
FLAGS = [c_bool() for _ in range(3)]
LAST = c_double()

for name in UNITS:
    host = Unit(name, Path(sys.argv[1]))
    unit = host.start()
    library, i = unit.dll, c_void_p(unit.component)

    def ok(status, expected=0):
        assert status == expected, (status, host.log[-3:])

    def array(name):
        return np.empty(host.size(name)), (c_uint32 * 1)(host.variables[name].valueReference), c_size_t(host.size(name))

    def get(name, values, reference, size):
        ok(unit.fmi3GetFloat64(i, reference, 1, pointer(values), size))

    def put(name, values, reference, size):
        ok(unit.fmi3SetFloat64(i, reference, 1, pointer(values), size))

    def step(start, length):
        ok(unit.fmi3DoStep(i, start, length, True, *map(byref, FLAGS), byref(LAST)))

    inputs, outputs = ([(n, *array(n)) for n in names[name]] for names in (IN, OUT))
    for a in inputs:
        get(*a)
    host.drive(unit)
    step(0.0, 100.0)
    for a in inputs:
        get(*a)
    state = c_void_p()
    rows = {}
    rows["get inputs back"] = least(20, lambda: [get(*a) for a in inputs])
    rows["set inputs"] = least(20, lambda: [put(*a) for a in inputs])
    rows["get outputs"] = least(20, lambda: [get(*a) for a in outputs])
    rows["get state"] = least(20, lambda: ok(unit.fmi3GetFMUState(i, byref(state))))
    rows["set state"] = least(20, lambda: ok(unit.fmi3SetFMUState(i, state)))

    def repeat(factor=[1.0]):
        # Other inputs each time, as in a coupling iteration.
        ok(unit.fmi3SetFMUState(i, state))
        factor[0] *= 1.0001
        for n, values, *rest in inputs[:2]:
            put(n, values * factor[0], *rest)
        step(100.0, 100.0)

    rows["step (with set state)"] = least(5, repeat)
    layer = sum(rows[k] for k in ("set inputs", "get outputs", "get state", "set state"))
    print(f"{name}: {host.size(inputs[0][0])} cells, {host.size(inputs[1][0])} fracture faces")
    for what, t in rows.items():
        print(f"  {what:24} {t:9.3f} ms")
    print(f"  set, get, states together: {100 * layer / rows['step (with set state)']:.2f} % of a step")
