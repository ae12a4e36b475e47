"""Flow in a fractured rock by OpenGeoSys: its LiquidFlow process on the triangles, with segments on the fractures.

The pressure is continuous, also across fractures: this is a model of fractures that do not hinder flow across them, a
large K_n/d_f. Pressures at vertices are OpenGeoSys' own; the unit gives their means over cells and fracture faces. With
porosity φ = φ* + C (p − p*) + p/M and aperture d_f = d* + C_f (p − p*), as docs/interface.md has them, a time step is

    (1/M + C) (pⁿ − pⁿ⁻¹)/δt − div(K/η ∇p) = −(φ* + C (pⁿ⁻¹ − p*) − φⁿ⁻¹)/δt         in the rock
    C_f (pⁿ − pⁿ⁻¹)/δt − div(d³/12η ∇p) = −(d* + C_f (pⁿ⁻¹ − p*) − dⁿ⁻¹)/δt           on fractures, besides

with d = dⁿ⁻¹. The right-hand sides are sources at the vertices; OpenGeoSys runs in a process of its own (`liquid_flow.py`).
"""

import subprocess
from pathlib import Path

import numpy as np
from pythonfmu3 import Fmi3Slave

from flow import Flow
from messages import receive, send


class OpenGeoSys(Flow, Fmi3Slave):
    """The unit, with the process that does its time steps."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description = "Darcy flow in a fractured rock by OpenGeoSys, pressure continuous"
        mesh = self.mesh
        self.process = None
        self.triangles = triangles(mesh)
        self.segments = mesh.face_vertices[mesh.fracture_faces]
        self.memory["pressure"] = np.full(len(mesh.vertices), float(self.initial_pressure))

    def exit_initialization_mode(self):
        super().exit_initialization_mode()
        mesh, resources = self.mesh, Path(self.resources)
        regions, region = np.unique(mesh.region, return_inverse=True)
        first = [np.flatnonzero(mesh.region == r)[0] for r in regions]
        held_faces = np.flatnonzero(np.isin(mesh.face_tag, list(self.held)))
        np.savez(
            resources / "setup.npz",
            points=np.column_stack([mesh.vertices, np.zeros(len(mesh.vertices))]),
            triangles=self.triangles,
            segments=self.segments,
            region=region,
            permeability=self.permeability[first],
            viscosity=self.viscosity,
            held_pressure=np.array(list(self.held.values()), dtype=float),
            held_faces=mesh.face_vertices[held_faces],
            held_number=np.searchsorted(list(self.held), mesh.face_tag[held_faces]),
        )
        python = (resources / "python.txt").read_text().strip()
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(
            [python, resources / "liquid_flow.py", resources / "setup.npz"], stdin=pipe, stdout=pipe
        )

    def do_step(self, current_time, step_size):
        mesh, values, memory = self.mesh, self.values, self.memory
        before = memory["pressure"]
        source = np.zeros(len(before))
        for field, at, corners, measure in [
            ("porosity", "matrix", self.triangles, mesh.cell_measure),
            ("aperture", "fracture", self.segments, mesh.face_measure[mesh.fracture_faces]),
        ]:
            name = "porosity_change" if at == "matrix" else field
            excess = before[corners].mean(axis=1) - values[f"{at}.pressure_reference"]
            change = values[f"{at}.{name}"] + values[f"{at}.{field}_compliance"] * excess - memory[name]
            part = -measure * change / (corners.shape[1] * step_size)
            np.add.at(source, corners, part[:, None])
        aperture, storage = memory["aperture"], self.storage + values["matrix.porosity_compliance"]
        send(
            self.process.stdin,
            step=step_size,
            pressure=before,
            source=source,
            storage=np.concatenate([storage, values["fracture.aperture_compliance"] / aperture]),
            aperture=np.concatenate([np.ones(mesh.cell_count), aperture]),
            permeability=np.concatenate([np.zeros(mesh.cell_count), aperture**2 / 12]),
        )
        answer = receive(self.process.stdout)
        if answer is None:
            raise RuntimeError("OpenGeoSys has ended; what it said is above")
        pressure = answer["pressure"]
        result = self.accept(pressure[self.triangles].mean(axis=1), pressure[self.segments].mean(axis=1))
        if result.status == 0:
            memory["pressure"] = pressure
        return result

    def terminate(self):
        if self.process:
            self.process.stdin.close()
            self.process.wait()


def triangles(mesh):
    """The vertices of each cell, counter-clockwise."""
    if not (np.bincount(mesh.pair_cell) == 3).all():
        raise ValueError("the cells must be triangles for this unit")
    corners = np.array([np.unique(c) for c in mesh.face_vertices[mesh.pair_face].reshape(-1, 6)])
    a, b, c = (mesh.vertices[corners[:, i]] for i in range(3))
    cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    corners[cross < 0] = corners[cross < 0][:, ::-1]
    return corners
