"""Random C calls against both units: any order, sizes, references, pointers that are null, instances that are gone."""

import ctypes
import os
import random
from collections import Counter
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint8, c_uint32, c_void_p

import pytest
from test_units import UNITS, Unit

# Random calls per unit, unless UNIT_FUZZ_CALLS says another number; the seed is UNIT_FUZZ_SEED.
CALLS = 4000
ROOM = 2000
OK, WARNING, DISCARD, ERROR = range(4)
CALLBACK = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


class Fuzz:
    def __init__(self, name, seed):
        self.host = Unit(name)
        probe = self.host.instantiate()
        # FMPy names the file; the calls go past its checks.
        self.library = ctypes.CDLL(probe.dll._name)
        probe.freeInstance()
        self.library.fmi3InstantiateCoSimulation.restype = c_void_p
        self.random = random.Random(seed)
        self.messages = []
        self.callback = CALLBACK(lambda _e, status, _c, text: self.messages.append((status, text)))
        self.live, self.gone, self.states, self.bytes = [], [], [], b""
        self.floats = (c_double * ROOM)()
        self.others = (c_double * ROOM)()
        self.longs = (c_int64 * ROOM)()
        self.reached = Counter()

    def instantiate(self):
        r = self.random
        token = self.host.description.instantiationToken if r.random() < 0.9 else "other"
        resources = os.path.join(self.host.folder, "resources", "") if r.random() < 0.95 else "/nowhere/"
        unit = self.library.fmi3InstantiateCoSimulation(
            b"unit", token.encode(), resources.encode(), c_bool(False), c_bool(r.random() < 0.5), c_bool(False),
            c_bool(False), None, c_size_t(0), None, self.callback, None
        )
        if unit:
            self.live.append(unit)
        else:
            assert self.messages, "no instance and no message"

    def free(self, unit):
        self.library.fmi3FreeInstance(c_void_p(unit))
        if unit in self.live:
            self.live.remove(unit)
            self.gone.append(unit)

    def begin(self, unit):
        unit = c_void_p(unit)
        self.library.fmi3EnterInitializationMode(unit, c_bool(False), c_double(0), c_double(0), c_bool(False), c_double(0))
        self.library.fmi3ExitInitializationMode(unit)

    def number(self):
        r = self.random
        if r.random() < 0.02:
            return r.choice([float("nan"), float("inf"), -1.0, 0.0, 1e300, -1e300, 5e-324])
        return 10 ** r.uniform(-6, 6)

    def instance(self):
        r = self.random.random()
        if r < 0.02:
            return self.random.choice([0, 1, 12345, *self.gone])
        return self.random.choice(self.live)

    def call(self):
        r, lib = self.random, self.library
        unit = self.instance()
        i = c_void_p(unit)
        variable = r.choice(list(self.host.variables.values()))
        reference = variable.valueReference if r.random() < 0.97 else r.getrandbits(32)
        count = 1 if r.random() < 0.95 else r.choice([0, 2])
        refs = (c_uint32 * 2)(reference, r.randrange(40))
        size = self.host.size(variable.name) if r.random() < 0.95 else r.randrange(ROOM)
        if variable.causality == "input" and "aperture" in variable.name:
            values = [10 ** r.uniform(-6, -3) if r.random() < 0.999 else self.number() for _ in range(size)]
        else:
            values = [self.number() if r.random() < 0.01 else r.uniform(0, 1e6) for _ in range(size)]
        if "compliance" in variable.name or "porosity" in variable.name:
            values = [1e-16 * v for v in values]
        self.floats[:size] = values
        floats = None if r.random() < 0.02 else self.floats
        refs_in = None if r.random() < 0.02 else refs
        n = c_size_t(size)
        state = c_void_p(r.choice([0, 1, *self.states[-5:]]))
        operation = self.operation = r.choice(
            ["get", "get", "set", "set", "set", "step", "step", "step", "save", "restore", "restore", "drop", "bytes",
             "load", "derivative", "int", "reset", "enter", "exit", "terminate", "string"]
        )
        if operation in ("reset", "enter", "exit", "terminate") and r.random() < 0.7:
            operation = self.operation = "step"
        if operation == "get":
            return unit, lib.fmi3GetFloat64(i, refs_in, c_size_t(count), floats, n)
        if operation == "set":
            return unit, lib.fmi3SetFloat64(i, refs_in, c_size_t(count), floats, n)
        if operation == "int":
            return unit, lib.fmi3GetInt64(i, refs_in, c_size_t(count), self.longs, n)
        if operation == "string":
            texts = (c_char_p * ROOM)()
            return unit, lib.fmi3GetString(i, refs_in, c_size_t(count), texts, n)
        if operation == "step":
            now = (c_double * 1)(0.0)
            lib.fmi3GetFloat64(i, (c_uint32 * 1)(0), c_size_t(1), now, c_size_t(1))
            flags, last = [c_bool() for _ in range(3)], c_double()
            step = self.number() if r.random() < 0.05 else 10 ** r.uniform(-2, 4)
            time = self.number() if r.random() < 0.02 else now[0]
            return unit, lib.fmi3DoStep(
                i, c_double(time), c_double(step), c_bool(True), *map(byref, flags), byref(last) if r.random() < 0.98 else None
            )
        if operation == "save":
            place = c_void_p(state.value if r.random() < 0.3 else None)
            status = lib.fmi3GetFMUState(i, byref(place))
            if status == OK and place.value not in self.states:
                self.states.append(place.value)
            return unit, status
        if operation == "restore":
            return unit, lib.fmi3SetFMUState(i, state)
        if operation == "drop":
            return unit, lib.fmi3FreeFMUState(i, byref(state))
        if operation == "bytes":
            size = c_size_t()
            status = lib.fmi3SerializedFMUStateSize(i, state, byref(size))
            if status == OK:
                room = (c_uint8 * size.value)()
                status = lib.fmi3SerializeFMUState(i, state, room, size)
                self.bytes = bytes(room)
            return unit, status
        if operation == "load":
            content = bytearray(self.bytes)
            spoilt = bool(content) and r.random() < 0.5
            if spoilt:
                content[r.randrange(len(content))] ^= 1 + r.randrange(255)
            place = c_void_p()
            status = lib.fmi3DeserializeFMUState(
                i, (c_uint8 * len(content)).from_buffer(content) if content else None, c_size_t(len(content)), byref(place)
            )
            assert not spoilt or status == ERROR
            if status == OK:
                self.states.append(place.value)
            return unit, status
        if operation == "derivative":
            fields = ["fracture.aperture", "fracture.pressure", "matrix.pressure", "matrix.porosity_change"]
            known, unknown = (self.host.variables[r.choice(fields)] for _ in range(2))
            return unit, lib.fmi3GetDirectionalDerivative(
                i, (c_uint32 * 1)(unknown.valueReference), c_size_t(1), (c_uint32 * 1)(known.valueReference), c_size_t(1),
                self.floats, c_size_t(self.host.size(known.name)), self.others, c_size_t(self.host.size(unknown.name))
            )
        if operation == "reset":
            return unit, lib.fmi3Reset(i)
        if operation == "enter":
            return unit, lib.fmi3EnterInitializationMode(
                i, c_bool(False), c_double(0), c_double(self.number()), c_bool(False), c_double(0)
            )
        if operation == "exit":
            return unit, lib.fmi3ExitInitializationMode(i)
        return unit, lib.fmi3Terminate(i)


@pytest.mark.parametrize("name", UNITS)
def test_random_calls_do_no_harm(name):
    calls = int(os.environ.get("UNIT_FUZZ_CALLS", CALLS))
    fuzz = Fuzz(name, int(os.environ.get("UNIT_FUZZ_SEED", 1)))
    seen = [0] * 5
    for _ in range(calls):
        while len(fuzz.live) < 2:
            fuzz.messages.clear()
            fuzz.instantiate()
        if len(fuzz.live) > 4 or fuzz.random.random() < 0.002:
            fuzz.free(fuzz.random.choice(fuzz.live))
            continue
        if fuzz.random.random() < 0.01:
            fuzz.instantiate()
        fuzz.messages.clear()
        unit, status = fuzz.call()
        seen[status] += 1
        fuzz.reached[fuzz.operation] += status == OK
        if status == ERROR and unit in fuzz.live:
            assert any(s == ERROR and text.startswith(b"fmi3") for s, text in fuzz.messages), "an error without a message"
            assert not any(b"panicked" in text for _, text in fuzz.messages), fuzz.messages
            # An error ends a run: begin again, so that something is left to try.
            if fuzz.random.random() < 0.8:
                assert fuzz.library.fmi3Reset(c_void_p(unit)) == OK
                fuzz.begin(unit)
    assert seen[OK] > calls / 10 and seen[ERROR] > calls / 20 and seen[4] == 0, seen
    # Each kind of call has also done what it is for.
    assert all(fuzz.reached[o] >= 3 for o in ("step", "set", "save", "restore", "bytes", "load", "derivative")), fuzz.reached
    for unit in list(fuzz.live):
        fuzz.free(unit)
    # The library still works.
    unit = fuzz.host.start()
    unit.doStep(0.0, 100.0)
    unit.freeInstance()
