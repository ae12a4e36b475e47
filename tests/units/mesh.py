"""The mesh that travels with a model as `mesh.h5` (layout: docs/interface.md), in two dimensions."""

import hashlib

import numpy as np


def read(path):
    """All datasets of an HDF5 file by their paths, and attributes as `path@name`.

    For the packing of units only: within the orchestrator h5py would meet another version of the HDF5 library.
    """
    import h5py

    entries = {}

    def add(name, item):
        entries.update({f"{name}@{key}": value for key, value in item.attrs.items()})
        if isinstance(item, h5py.Dataset):
            entries[name] = item[()]

    with h5py.File(path) as file:
        add("", file)
        file.visititems(add)
    return entries


class Mesh:
    """Geometry and fracture network of a mesh of polygons. Lengths in m, areas in m²; arrays are in the order of the file."""

    def __init__(self, entries):
        if entries["@dimension"] != 2:
            raise ValueError("the mesh must have two dimensions for this unit")
        names = (entries[entry].tobytes().decode().splitlines() for entry in ("regions", "tags", "fractures"))
        self.regions, self.tags, self.fractures = names
        points = entries["vertices"]
        self.vertices = points[:, :2]
        face_offsets, face_vertices = entries["faces/offsets"], entries["faces/vertices"]
        cell_offsets, cell_faces = entries["cells/offsets"], entries["cells/faces"]
        self.region, self.face_tag = entries["cells/region"], entries["faces/tag"]
        self.face_fracture = entries["faces/fracture"]

        # Faces are segments.
        self.face_vertices = face_vertices.reshape(-1, 2)
        ends = self.vertices[self.face_vertices]
        self.face_center = ends.mean(axis=1)
        along = ends[:, 1] - ends[:, 0]
        self.face_measure = np.linalg.norm(along, axis=1)
        self.face_normal = np.column_stack([along[:, 1], -along[:, 0]]) / self.face_measure[:, None]

        # Pairs (cell, face), by cell.
        self.pair_face = cell_faces
        self.pair_cell = np.repeat(np.arange(len(cell_offsets) - 1), np.diff(cell_offsets))
        self.cell_count = len(cell_offsets) - 1
        self.fracture_faces = np.flatnonzero(self.face_fracture >= 0)
        sides = np.bincount(cell_faces, minlength=len(self.face_vertices))
        self.boundary_faces = np.flatnonzero(sides == 1)

        # Triangles between each face and a point inside the cell.
        mean = self.sum_by_cell(self.face_center[cell_faces]) / np.diff(cell_offsets)[:, None]
        a, b = (ends[cell_faces, i] - mean[self.pair_cell] for i in (0, 1))
        area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        self.cell_measure = self.sum_by_cell(area)
        self.cell_center = mean + self.sum_by_cell(area[:, None] * (a + b) / 3) / self.cell_measure[:, None]

        self.fingerprint = fingerprint(
            points, (face_offsets, face_vertices), (cell_offsets, cell_faces), self.face_fracture
        )

    def sum_by_cell(self, values):
        """Sums values of the pairs (cell, face)."""
        total = np.zeros((self.cell_count, *values.shape[1:]))
        np.add.at(total, self.pair_cell, values)
        return total


def fingerprint(points, faces, cells, face_fracture):
    """The text that is equal for equal meshes: SHA-256 over the lists, each behind its length in bytes."""
    digest = hashlib.sha256()
    # Adding zero turns −0 into +0.
    lists = [np.array([2]), points + 0.0, *faces, *cells, face_fracture + 1]
    for values in lists:
        data = values.astype("<f8" if values.dtype.kind == "f" else "<u8").tobytes()
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()
