"""Flow units of others against ours on the six fractures (C3), as meshes are refined: compare.py [SIZE]...

Sizes of fracture faces (m), 0.04 0.02 0.01 if none are given. Runs go to results/units, tables and plots to this folder.
"""

import csv
import subprocess
import sys

import h5py
import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np

from mesh import Mesh, read
from pack import HERE, ROOT, orchestrator

# The same numbers make the same file.
matplotlib.rcParams["svg.hashsalt"] = "units"
RESULTS = ROOT / "results" / "units"
PLOTS = HERE / "plots"
TIMES = [100 * i for i in range(1, 21)]
# Where the exchange between rock and fractures does not hinder flow: K_n/d_f is a million times that of C3.
OPEN = [f"fractures.{i}.normal_permeability=1e-9" for i in range(1, 7)]
STYLES = ["o-", "s-", "x-", "+:"]
MEANS = "mean aperture", "mean pressure in fractures", "mean pressure in rock"


def triangles(size):
    return [f"mesh.triangles.size={2 * size}", f"mesh.triangles.fracture_size={size}"]


def changes(list):
    return [word for change in list for word in ("--set", change)]


def run(name, model, change, unit=None):
    """Runs a model, with the unit of a folder in place of our flow; the folder of the results."""
    folder = RESULTS / name
    if (folder / "run.h5").exists():
        return folder
    given = []
    if unit:
        given = ["--flow", RESULTS / f"{name}.fmu"]
        subprocess.run([HERE / unit / "build", model, given[1], *changes(change)], check=True)
    change = [*change, f"output.times={TIMES}"]
    command = [orchestrator(), "run", model, "--output", folder, "--overwrite", "--quiet", *given, *changes(change)]
    subprocess.run(command, check=True)
    return folder


def means(folder):
    """The means (rows: aperture, fracture pressure, matrix pressure) at all times."""
    mesh = Mesh(read(folder / "mesh.h5"))
    length = mesh.face_measure[mesh.fracture_faces]
    with h5py.File(folder / "run.h5") as file:
        groups = [file["fields"][number] for number in sorted(file["fields"])]
        rows = [
            (
                np.average(group["fracture.aperture"], weights=length),
                np.average(group["fracture.pressure"], weights=length),
                np.average(group["matrix.pressure"], weights=mesh.cell_measure),
            )
            for group in groups
        ]
    return np.array(rows).T


def difference(a, b):
    """Largest difference of means over time, over the range of the mean."""
    return np.abs(a - b).max(axis=1) / np.ptp(b, axis=1)


def main(sizes):
    six = ROOT / "models" / "six-fractures"
    RESULTS.mkdir(parents=True, exist_ok=True)
    PLOTS.mkdir(exist_ok=True)
    rows, curves = [], {}
    for size in sizes:
        bisectors = RESULTS / f"bisectors-{size}"
        if not bisectors.exists():
            subprocess.run([sys.executable, HERE / "two-point" / "bisectors.py", six, str(size), bisectors], check=True)
        cases = {
            "two-point, bisector mesh": (bisectors, [], "two-point"),
            "two-point, triangles": (six, triangles(size), "two-point"),
            "OpenGeoSys, K_n = 1e-9 m²": (six, triangles(size) + OPEN, "opengeosys"),
            "OpenGeoSys, K_n of C3": (six, triangles(size), "opengeosys"),
        }
        for label, (model, change, unit) in cases.items():
            name = f"{unit}-{'bisectors' if model != six else 'open' if OPEN[0] in change else 'triangles'}-{size}"
            ours = means(run(name.replace(unit, "hfv"), model, change))
            theirs = means(run(name, model, change, unit))
            curves[label] = ours, theirs
            rows.append([label, size, *difference(theirs, ours)])
            print(f"{label:28} h = {size}:", *(f"{d:.2e}" for d in rows[-1][2:]), flush=True)

    with open(PLOTS / "differences.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["unit", "size [m]", *MEANS])
        table.writerows([label, size, *(f"{d:.3e}" for d in row)] for label, size, *row in rows)
    figure, axes = plt.subplots(1, 3, figsize=(12, 4), sharey=True, layout="constrained")
    for i, (axis, mean) in enumerate(zip(axes, MEANS)):
        for label, style in zip(curves, STYLES):
            axis.loglog(sizes, [row[2 + i] for row in rows if row[0] == label], style, label=label)
        axis.set(title=mean, xlabel="fracture faces (m)", xticks=sizes, xticklabels=sizes)
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest difference from ours / range")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(curves), fontsize="small")
    figure.savefig(PLOTS / "differences.svg", metadata={"Date": None})

    figure, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
    for i, (axis, mean) in enumerate(zip(axes, MEANS)):
        scale = 1e6 if i == 0 else 1e-6
        for j, (label, (ours, theirs)) in enumerate(curves.items()):
            axis.plot(TIMES, scale * ours[i], "-", color=f"C{j}", lw=1)
            axis.plot(TIMES, scale * theirs[i], STYLES[j][0], ms=4, color=f"C{j}", fillstyle="none", label=label)
        axis.set(title=mean, xlabel="time (s)", ylabel="µm" if i == 0 else "MPa")
        axis.grid(alpha=0.3)
    legend = dict(loc="outside lower center", ncols=len(curves), fontsize="small")
    title = f"marks: the unit, lines: ours on the same mesh, of fracture faces of {sizes[-1]} m"
    figure.legend(*axes[0].get_legend_handles_labels(), title=title, **legend)
    figure.savefig(PLOTS / "means.svg", metadata={"Date": None})


if __name__ == "__main__":
    main([float(word) for word in sys.argv[1:]] or [0.04, 0.02, 0.01])
