"""What the tests share: packed units, instances of them under FMPy, and runs of the orchestrator."""

import shutil
import subprocess
import sys
import zipfile
from math import prod
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "two-point")]

from pack import ROOT, orchestrator  # noqa: E402

SIX = ROOT / "models" / "six-fractures"
# A coarse mesh of triangles.
COARSE = ["--set", "mesh.triangles.size=0.2", "--set", "mesh.triangles.fracture_size=0.1"]
ALL_TIMES = ["--set", f"output.times={[100 * i for i in range(1, 21)]}"]


class Instance:
    """An instance of an FMU whose variables are known by their names, and what it has logged."""

    def __init__(self, fmu, folder):
        description = fmpy.read_model_description(str(fmu))
        self.variables = {v.name: v for v in description.modelVariables}
        self.log = []
        shutil.unpack_archive(fmu, folder, "zip")
        self.fmu = FMU3Slave(
            guid=description.instantiationToken,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="unit",
        )
        self.fmu.instantiate(loggingOn=True, logMessage=lambda _e, _s, _c, message: self.log.append(message.decode()))

    def start(self, **values):
        self.fmu.enterInitializationMode(startTime=0.0)
        for name, value in values.items():
            self.set(name.replace("__", "."), value)
        self.fmu.exitInitializationMode()
        return self

    def size(self, name):
        return prod(d.start for d in self.variables[name].dimensions)

    def get(self, name):
        return np.array(self.fmu.getFloat64([self.variables[name].valueReference], nValues=self.size(name)))

    def set(self, name, values):
        values = np.broadcast_to(values, self.size(name)).tolist()
        self.fmu.setFloat64([self.variables[name].valueReference], values)


def run(model, output, *options, check=True):
    """A run of the orchestrator; gives the folder of its results, or the process where it may fail."""
    command = [orchestrator(), "run", model, "--output", output, "--quiet", *options]
    process = subprocess.run(command, capture_output=True, text=True)
    if check:
        assert process.returncode == 0, process.stderr
        return output
    return process


def build(unit, *arguments):
    subprocess.run([HERE / unit / "build", *arguments], check=True)


def resources(fmu, folder):
    """Unpacks the resources of an FMU."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder, [name for name in archive.namelist() if name.startswith("resources/")])
    return folder / "resources"


def on_bisectors(folder, size):
    """The six fractures on a mesh for two-point fluxes, in a folder with the model and the unit for it."""
    subprocess.run([sys.executable, HERE / "two-point" / "bisectors.py", SIX, str(size), folder], check=True)
    build("two-point", folder, folder / "two-point.fmu")
    return folder


@pytest.fixture(scope="session")
def bisectors(tmp_path_factory):
    return on_bisectors(tmp_path_factory.mktemp("bisectors"), 0.08)


@pytest.fixture(scope="session")
def record(tmp_path_factory):
    """A run whose pressures are recorded after each time step, and the unit that plays them."""
    folder = tmp_path_factory.mktemp("recorded")
    run(SIX, folder / "run", *COARSE, *ALL_TIMES)
    build("recorded", folder / "run", folder / "recorded.fmu")
    return folder


@pytest.fixture(params=["two-point", "recorded"])
def unit(request):
    """Each flow unit."""
    if request.param == "two-point":
        return request.getfixturevalue("bisectors") / "two-point.fmu"
    return request.getfixturevalue("record") / "recorded.fmu"
