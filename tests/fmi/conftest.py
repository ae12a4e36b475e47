"""What the tests share: the packed example unit, and instances of it."""

import shutil
import threading
from pathlib import Path

import fmpy
import pytest
from fmpy.fmi3 import FMU3Slave

FOLDER = Path(__file__).parents[2] / "target" / "fmi"
# Both units of the six fractures on a coarse mesh.
CASE = FOLDER / "c3"
HEAT, ENABLED, TEMPERATURE, LOSS, HOTTEST, PHASE, STEPS = range(1, 8)
AMBIENT, MAX_STEP, LABEL, BLOB, FAULT = range(8, 13)
# FMPy changes the working directory of the process while it loads a library.
LOADING = threading.Lock()


class Host:
    """An unpacked FMU, its instances and what they have logged."""

    def __init__(self, fmu):
        self.description = fmpy.read_model_description(fmu)
        self.folder = fmpy.extract(fmu)
        self.log = []

    def instantiate(self, log=None, **changes):
        def told(_environment, status, category, message):
            (self.log if log is None else log).append((status, category.decode(), message.decode()))

        arguments = dict(
            guid=self.description.instantiationToken,
            unzipDirectory=self.folder,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="bars",
        )
        with LOADING:
            unit = FMU3Slave(**(arguments | changes))
        unit.instantiate(loggingOn=True, logMessage=told)
        return unit

    def start(self, log=None, **settings):
        """An instance in Step Mode."""
        unit = self.instantiate(log)
        unit.enterInitializationMode()
        for name, values in settings.items():
            unit.setFloat64([globals()[name.upper()]], values)
        unit.exitInitializationMode()
        return unit


@pytest.fixture(scope="session")
def fmu():
    return str(FOLDER / "heated_bars.fmu")


@pytest.fixture
def host(fmu):
    host = Host(fmu)
    yield host
    shutil.rmtree(host.folder)
