"""Runs the injection with and without the traffic light, and plots both: plot.py [FILE.svg]"""

import csv
import subprocess
import sys
import tomllib
from pathlib import Path

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from pack import ROOT, orchestrator  # noqa: E402

MODEL = ROOT / "models" / "traffic-light"
RUNS = {"rate held": [], "traffic light": ["--variant", "controlled"]}


def series(options, folder):
    """The columns of series.csv by name, without their units."""
    subprocess.run([orchestrator(), "run", MODEL, "--output", folder, "--overwrite", "--quiet", *options], check=True)
    with open(folder / "series.csv", newline="") as file:
        head, *rows = csv.reader(file)
    return dict(zip((name.split(" [")[0] for name in head), np.array(rows, dtype=float).T))


def main(path):
    subprocess.run([HERE / "build"], check=True)
    model = tomllib.loads((MODEL / "model.toml").read_text())
    held = model["flow"]["wells"]["injector"]["rate"]
    light = model["variants"]["controlled"]["units"]["traffic_light"]["parameters"]
    figure, axes = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
    for label, options in RUNS.items():
        columns = series(options, ROOT / "results" / f"traffic-light-{label.replace(' ', '-')}")
        days = columns["time"] / 86400
        rate = columns.get("rate", np.full(len(days), held))
        axes[0].step(days, 1e4 * rate, where="post", label=label)
        axes[1].plot(days, columns["slip_tendency.max"], label=label)
        axes[2].plot(days, 1e3 * columns["slip.max"], label=label)
        largest = {name: columns[name].max() for name in ("slip_tendency.max", "slip.max", "seismic_moment")}
        print(f"{label}:", ", ".join(f"{name} {value:.4g}" for name, value in largest.items()))
    for threshold, color in [("yellow", "goldenrod"), ("red", "crimson")]:
        axes[1].axhline(light[threshold], color=color, lw=0.8, ls="--")
    for axis, name in zip(axes, ["rate of the well (1e-4 m²/s)", "largest slip tendency", "largest slip (mm)"]):
        axis.set_ylabel(name)
        axis.grid(alpha=0.3)
    axes[0].legend()
    axes[2].set_xlabel("time (days)")
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else MODEL / "plots" / "traffic-light.svg")
