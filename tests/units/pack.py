"""Packs a unit in Python as an FMU: pack.py SOURCE.py FMU RESOURCE...

Resources in HDF5 are packed as NumPy archives with the same entries.
"""

import shutil
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

HERE = Path(__file__).parent
SHARED = [HERE / "arrays.py", HERE / "mesh.py"]
PLATFORM = "binaries/x86_64-linux"


def link(wrapper, target):
    """A library that brings Python along, and has the FMI functions of pythonfmu3's `wrapper` beside it."""
    folder, library = (sysconfig.get_config_var(name) for name in ("LIBDIR", "INSTSONAME"))
    define = [f'-DPYTHON_LIBRARY="{library}"', f'-DPYTHON_PACKAGES="{sysconfig.get_path("purelib")}"']
    include = Path(pythonfmu3.__file__).parent / "pythonfmu-export/src/fmi"
    search = [f"-Wl,-rpath,{folder}", "-Wl,-rpath,$ORIGIN", "-Wl,--no-as-needed", "-Wl,-z,nodelete"]
    command = ["cc", "-shared", "-fPIC", *define, f"-I{include}", "-o", target, HERE / "loader.c", *search]
    subprocess.run([*command, wrapper, Path(folder) / library], check=True)


def pack(source, fmu, resources):
    """Writes `fmu` from the unit in `source`, under a temporary name first."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for i, path in enumerate(resources):
            if path.suffix == ".h5":
                resources[i] = folder / f"{path.stem}.npz"
                np.savez(resources[i], **mesh.read(path))
        options = dict(canGetAndSetFMUState=True, canSerializeFMUState=True, needsExecutionTool=True)
        built = FmuBuilder.build_FMU(source, folder, [*SHARED, *resources], **options)
        wrapper = folder / "libpythonfmu-export.so"
        name = f"{PLATFORM}/{built.stem}.so"
        with zipfile.ZipFile(built) as archive:
            wrapper.write_bytes(archive.read(name))
            link(wrapper, folder / "library.so")
            part = folder / "part.fmu"
            with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as whole:
                for item in archive.namelist():
                    if not item.startswith("binaries/"):
                        whole.writestr(item, archive.read(item))
                whole.write(wrapper, f"{PLATFORM}/{wrapper.name}")
                whole.write(folder / "library.so", name)
        fmu.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(part, fmu)


if __name__ == "__main__":
    pack(Path(sys.argv[1]), Path(sys.argv[2]), [Path(name) for name in sys.argv[3:]])
