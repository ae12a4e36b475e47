"""Flow in a fractured rock by two-point fluxes: a template for a flow unit of one's own.

One pressure for each cell K and each fracture face σ; in two dimensions. The balances of a time step are

    |K| (φⁿ − φⁿ⁻¹)/δt + Σ fluxes out of K = 0,         φ   = φ* + C (p_K − p*) + p_K/M
    |σ| (d_fⁿ − d_fⁿ⁻¹)/δt + Σ fluxes out of σ = 0,     d_f = d* + C_f (p_f − p_f*)

with the porosity change φ* and the aperture d* that mechanics found at the pressures p* and p_f*, and what it believes
of its own response to pressure: the compliances C and C_f (fixed stress; zero where the host does not set them). A flux
between two pressures is (p_1 − p_2)/(1/T_1 + 1/T_2 + …) with the transmissivities that lie between them:

    from a cell to a face       |σ| (n·K n)/(η d),   d the distance of the cell's point to the line of the face
    across half a fracture      |σ| 2 K_n/(η d_f)
    from a fracture face to its end   d_f³/(12 η) / (|σ|/2)

The last two with the aperture at the start of the time step. Where fracture faces meet, T_ij = T_i T_j/Σ T (star-delta):
the pressure at the meeting point is eliminated. At tips and at the boundary nothing flows, but where a pressure is given.

Such fluxes are consistent where the line between the points of neighbours is along K n of their face. The meshes of
`bisectors.py` are made so. On any other mesh they are not: refining does not help.
"""

from itertools import combinations
from pathlib import Path

import numpy as np
from pythonfmu3 import Fmi3Slave
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from flow import Flow


class TwoPoint(Flow, Fmi3Slave):
    """The unit: the geometry of its fluxes at the start, then a time step for each call of `do_step`."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description = "Darcy flow in a fractured rock by two-point fluxes"
        mesh = self.mesh

        # Half transmissivities of the pairs (cell, face).
        cell, face = mesh.pair_cell, mesh.pair_face
        points = Path(self.resources) / "points.npy"
        point = np.load(points) if points.exists() else mesh.cell_center
        normal = mesh.face_normal[face]
        distance = np.abs(np.sum(normal * (mesh.face_center[face] - point[cell]), axis=1))
        along = np.einsum("pi,pij,pj->p", normal, self.permeability[cell], normal)
        half = mesh.face_measure[face] * along / (self.viscosity * distance)

        # Pairs that share a face; pairs on a fracture; pairs on the boundary where a pressure is held.
        number = np.full(len(mesh.face_measure), -1)
        number[mesh.fracture_faces] = np.arange(len(mesh.fracture_faces))
        order = np.argsort(face, kind="stable")
        same = np.flatnonzero(face[order][1:] == face[order][:-1])
        a, b = order[same], order[same + 1]
        inside = number[face[a]] < 0
        a, b = a[inside], b[inside]
        self.in_rock = cell[a], cell[b], half[a] * half[b] / (half[a] + half[b])
        side = np.flatnonzero(number[face] >= 0)
        self.on_fracture = cell[side], number[face[side]], half[side]
        held_face = np.array([self.held.get(tag, np.nan) for tag in mesh.face_tag])
        held = np.flatnonzero(~np.isnan(held_face[face]))
        self.on_boundary = cell[held], half[held], held_face[face[held]]

        # Ends of fracture faces: which faces meet there, and the pressure that is held, if any.
        held_vertex = np.full(len(mesh.vertices), np.nan)
        for f in np.flatnonzero(~np.isnan(held_face)):
            held_vertex[mesh.face_vertices[f]] = held_face[f]
        ends = {}
        for i, f in enumerate(mesh.fracture_faces):
            for vertex in mesh.face_vertices[f]:
                ends.setdefault(vertex, []).append(i)
        self.ends = [(faces, held_vertex[vertex]) for vertex, faces in sorted(ends.items())]

    def do_step(self, current_time, step_size):
        mesh, values, memory = self.mesh, self.values, self.memory
        pressure = np.concatenate([values["matrix.pressure"], values["fracture.pressure"]])
        measure = np.concatenate([mesh.cell_measure, mesh.face_measure[mesh.fracture_faces]])

        # Storage: a change of volume is affine in the pressures.
        compliance = np.concatenate([values["matrix.porosity_compliance"], values["fracture.aperture_compliance"]])
        reference = np.concatenate([values["matrix.pressure_reference"], values["fracture.pressure_reference"]])
        deformed = np.concatenate([values["matrix.porosity_change"], values["fracture.aperture"]])
        before = np.concatenate([memory["porosity_change"], memory["aperture"]])
        elastic = np.concatenate([self.storage, np.zeros(len(mesh.fracture_faces))])
        slope = measure / step_size * (compliance + elastic)
        source = measure / step_size * (before - deformed + compliance * reference + elastic * pressure)

        # Fluxes: with what is held on the boundary on the right-hand side.
        first, second, transmissivity, held, to_held, held_pressure = self._connections(memory["aperture"])
        diagonal = slope
        np.add.at(diagonal, first, transmissivity)
        np.add.at(diagonal, second, transmissivity)
        np.add.at(diagonal, held, to_held)
        np.add.at(source, held, to_held * held_pressure)
        n = np.arange(len(diagonal))
        entries = np.concatenate([diagonal, -transmissivity, -transmissivity])
        places = np.concatenate([n, first, second]), np.concatenate([n, second, first])
        solution = splu(coo_array((entries, places)).tocsc()).solve(source)

        return self.accept(*np.split(solution, [mesh.cell_count]))

    def _connections(self, aperture):
        """Pairs of unknowns (cells, then fracture faces) with their transmissivities; unknowns beside a held pressure."""
        mesh = self.mesh
        length = mesh.face_measure[mesh.fracture_faces]
        a, b, rock = self.in_rock
        cell, number, half = self.on_fracture
        across = (length * 2 * self.normal_permeability / (self.viscosity * aperture))[number]
        along = aperture**3 / (12 * self.viscosity) / (length / 2)
        held, to_held, held_pressure = self.on_boundary
        pairs, ends = [], []
        for faces, pressure in self.ends:
            if np.isnan(pressure):
                total = along[faces].sum()
                pairs += [(i, j, along[i] * along[j] / total) for i, j in combinations(faces, 2)]
            else:
                ends += [(i, along[i], pressure) for i in faces]
        i, j, star = np.array(pairs).reshape(-1, 3).T
        k, end, end_pressure = np.array(ends).reshape(-1, 3).T
        n = mesh.cell_count
        return (
            np.concatenate([a, cell, n + i.astype(int)]),
            np.concatenate([b, n + number, n + j.astype(int)]),
            np.concatenate([rock, half * across / (half + across), star]),
            np.concatenate([held, n + k.astype(int)]),
            np.concatenate([to_held, end]),
            np.concatenate([held_pressure, end_pressure]),
        )
