"""Packs a unit in Python as an FMU: pack.py SOURCE.py FMU [--model MODEL OPTION...] [--add FILE]...

With a model, its description and mesh travel in the FMU; options are those of `orchestrator pack`. Files in HDF5 become
NumPy archives with the same entries.
"""

import argparse
import os
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pythonfmu3
from pythonfmu3 import FmuBuilder

import mesh

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
SHARED = [HERE / name for name in ("arrays.py", "flow.py", "mesh.py")]
PLATFORM = "binaries/x86_64-linux"


def orchestrator():
    """The program: that of the environment, or the one that was built last."""
    built = [ROOT / "target" / profile / "orchestrator" for profile in ("debug", "release")]
    built = sorted((path for path in built if path.exists()), key=lambda path: path.stat().st_mtime)
    return os.environ.get("ORCHESTRATOR") or built[-1]


def resources(model, options, folder):
    """What a model gives to its units: `model.toml` and `mesh.h5` in `folder`."""
    subprocess.run([orchestrator(), "pack", model, "--output", folder, *options], check=True, stdout=subprocess.DEVNULL)
    (fmu,) = folder.glob("*flow.fmu")
    with zipfile.ZipFile(fmu) as archive:
        for name in ("model.toml", "mesh.h5"):
            (folder / name).write_bytes(archive.read(f"resources/{name}"))
    return [folder / "model.toml", folder / "mesh.h5"]


def link(wrapper, target):
    """A library that brings Python along, and has the FMI functions of pythonfmu3's `wrapper` beside it."""
    folder, name, system = (sysconfig.get_config_var(name) for name in ("LIBDIR", "INSTSONAME", "MULTIARCH"))
    looked = [Path(folder) / name, Path(folder) / (system or "") / name]
    library = next((path for path in looked if path.exists()), None)
    if library is None:
        sys.exit(f"Python's library is needed (Debian: libpython3.11), and is not in {looked[0]} or {looked[1]}")
    define = [f'-DPYTHON_LIBRARY="{name}"', f'-DPYTHON_PACKAGES="{sysconfig.get_path("purelib")}"']
    include = Path(pythonfmu3.__file__).parent / "pythonfmu-export/src/fmi"
    search = [f"-Wl,-rpath,{library.parent}", "-Wl,-rpath,$ORIGIN", "-Wl,--no-as-needed", "-Wl,-z,nodelete"]
    command = ["cc", "-shared", "-fPIC", *define, f"-I{include}", "-o", target, HERE / "loader.c", *search]
    subprocess.run([*command, wrapper, library], check=True)


def pack(source, fmu, files):
    """Writes `fmu` from the unit in `source`, under a temporary name first."""
    fmu.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=fmu.parent) as folder:
        folder = Path(folder)
        added = [*SHARED]
        for path in files:
            if path.suffix == ".h5":
                np.savez(folder / f"{path.stem}.npz", **mesh.read(path))
                path = folder / f"{path.stem}.npz"
            added.append(path)
        names = ("canGetAndSetFMUState", "canSerializeFMUState", "canHandleVariableCommunicationStepSize")
        options = dict.fromkeys(names, True)
        built = FmuBuilder.build_FMU(source, folder, added, **options)
        wrapper = folder / "libpythonfmu-export.so"
        name = f"{PLATFORM}/{built.stem}.so"
        part = folder / "part.fmu"
        with zipfile.ZipFile(built) as archive, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as whole:
            wrapper.write_bytes(archive.read(name))
            link(wrapper, folder / "library.so")
            for item in archive.namelist():
                if not item.startswith("binaries/"):
                    whole.writestr(item, archive.read(item))
            whole.write(wrapper, f"{PLATFORM}/{wrapper.name}")
            whole.write(folder / "library.so", name)
        part.replace(fmu)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path)
    parser.add_argument("fmu", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--add", type=Path, action="append", default=[])
    arguments, options = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as folder:
        own = resources(arguments.model, options, Path(folder)) if arguments.model else []
        pack(arguments.source, arguments.fmu, [*own, *arguments.add])


if __name__ == "__main__":
    main()
