"""Meshes on which two-point fluxes are consistent: bisectors.py MODEL SIZE FOLDER

The cells are those of the points that are nearest to one of given sites (a Voronoi or perpendicular-bisector mesh), in
coordinates in which the permeability is isotropic: then the line between neighbours is along K n of their face. Faces lie
on a fracture where sites lie in pairs on both sides of it, on circles around the ends of its faces (R. L. Berge,
Ø. S. Klemetsdal, K.-A. Lie, Computational Geosciences 23, 2019).

From MODEL, the folder of a model of a rectangle of triangles with fractures that do not cross and one permeability, makes
FOLDER: the same model on such a mesh, with faces of about SIZE (m), and the sites in `points.npy`.
"""

import re
import sys
import tomllib
from pathlib import Path

import h5py
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Voronoi, cKDTree

# Radius of the circles over the length of a fracture face: pairs of sites then make squares.
RADIUS = np.sqrt(0.5)
# Sweeps that move the other sites to the centres of their cells.
SWEEPS = 10
# Over the radius of a circle: sites that are nearer to its centre would take the vertex there away.
CLEARANCE = 1.05
# Over the size: points that are nearer are one.
SAME = 1e-6


def fracture_sites(points, size, low, high):
    """The vertices of a fracture along a polyline, the pairs of sites at its faces, and those beyond its tips."""
    points = np.array(points)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    counts = np.maximum(1, np.round(lengths / size)).astype(int)
    parts = [a + np.arange(n)[:, None] / n * (b - a) for a, b, n in zip(points, points[1:], counts)]
    vertices = np.concatenate([*parts, points[-1:]])
    steps = np.diff(vertices, axis=0)
    length = np.linalg.norm(steps, axis=1)
    radius = RADIUS * np.maximum(np.append(length, 0), np.insert(length, 0, 0))
    # Where the circles around both ends of a face meet.
    along = (length**2 + radius[:-1] ** 2 - radius[1:] ** 2) / (2 * length)
    height = np.sqrt(radius[:-1] ** 2 - along**2)
    direction = steps / length[:, None]
    normal = np.column_stack([-direction[:, 1], direction[:, 0]])
    foot = vertices[:-1] + along[:, None] * direction
    pairs = np.stack([foot + height[:, None] * normal, foot - height[:, None] * normal], axis=1)
    inside = lambda x: ((x > low) & (x < high)).all()
    tips = [(vertices[0], -direction[0], radius[0]), (vertices[-1], direction[-1], radius[-1])]
    beyond = [x + r * t for x, t, r in tips if inside(x)]
    return vertices, radius, pairs, np.array(beyond).reshape(-1, 2)


def with_images(sites, low, high, size):
    """Sites, and behind them the images of those near the boundary, with the side that each is behind."""
    images, sides = [sites], [np.full(len(sites), -1)]
    for side, (axis, place) in enumerate([(0, low[0]), (0, high[0]), (1, low[1]), (1, high[1])]):
        near = sites[np.abs(sites[:, axis] - place) < 4 * size].copy()
        near[:, axis] = 2 * place - near[:, axis]
        images.append(near)
        sides.append(np.full(len(near), side))
    return np.concatenate(images), np.concatenate(sides)


def centres(diagram, count):
    """Centres of mass of the first cells."""
    center = np.empty((count, 2))
    for i in range(count):
        x = diagram.vertices[diagram.regions[diagram.point_region[i]]]
        x = x - (origin := x.mean(axis=0))
        next = np.roll(x, -1, axis=0)
        cross = x[:, 0] * next[:, 1] - x[:, 1] * next[:, 0]
        center[i] = origin + (cross[:, None] * (x + next)).sum(axis=0) / (3 * cross.sum())
    return center


def other_sites(low, high, size, fixed, circles, radius):
    """Sites away from fractures: a triangular lattice, relaxed, outside of all circles."""
    rows = int(np.ceil((high[1] - low[1]) / (size * np.sqrt(0.75))))
    columns = int(np.ceil((high[0] - low[0]) / size))
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    unit = np.column_stack([(i + 0.25 + 0.5 * (j % 2)).ravel() / columns, (j.ravel() + 0.5) / rows])
    sites = low + unit * (high - low)
    tree = cKDTree(circles)

    def is_outside(x):
        distance, near = tree.query(x)
        return distance > CLEARANCE * radius[near]

    sites = sites[is_outside(sites)]
    sites = sites[cKDTree(fixed).query(sites)[0] > 0.7 * size]
    for _ in range(SWEEPS):
        every, _ = with_images(np.concatenate([fixed, sites]), low, high, size)
        moved = centres(Voronoi(every), len(fixed) + len(sites))[len(fixed) :]
        sites = np.where(is_outside(moved)[:, None], moved, sites)
    return sites


def mesh(model, size):
    """Entries of the mesh file, and the sites of the cells (m)."""
    source = model["mesh"]["triangles"]
    (region,) = model["regions"].items()
    permeability = np.broadcast_to(region[1]["permeability"], 2)
    stretch = np.sqrt(permeability[0] / permeability)
    low, high = (np.array(source[end]) * stretch for end in ("low", "high"))
    names = list(source["fractures"])
    fractures = [
        fracture_sites(np.array(source["fractures"][name]["points"]) * stretch, size, low, high) for name in names
    ]
    pairs = np.concatenate([pairs for _, _, pairs, _ in fractures])
    fracture_of_pair = np.repeat(np.arange(len(names)), [len(pairs) for _, _, pairs, _ in fractures])
    fixed = np.concatenate([pairs.reshape(-1, 2), *(beyond for *_, beyond in fractures)])
    circles = np.concatenate([vertices for vertices, *_ in fractures])
    radius = np.concatenate([radius for _, radius, *_ in fractures])
    sites = np.concatenate([fixed, other_sites(low, high, size, fixed, circles, radius)])
    every, side = with_images(sites, low, high, size)
    diagram = Voronoi(every)

    # One vertex for those that round-off has made several; what is on fractures and boundary is exactly there.
    kept = (diagram.ridge_points < len(sites)).any(axis=1)
    couples, ends = diagram.ridge_points[kept], np.array(diagram.ridge_vertices)[kept]
    same = cKDTree(diagram.vertices).query_pairs(SAME * size, output_type="ndarray")
    shape = (len(diagram.vertices),) * 2
    _, group = connected_components(coo_array((np.ones(len(same)), same.T), shape=shape))
    vertices = np.empty((group.max() + 1, 2))
    vertices[group] = diagram.vertices
    distance, near = cKDTree(circles).query(vertices)
    vertices[distance < SAME * size] = circles[near[distance < SAME * size]]
    for place in (low, high):
        vertices = np.where(np.abs(vertices - place) < SAME * size, place, vertices)
    ends = group[ends]
    true = ends[:, 0] != ends[:, 1]
    couples, ends = couples[true], ends[true]
    used, ends = np.unique(ends, return_inverse=True)
    vertices, ends = vertices[used] / stretch, ends.reshape(-1, 2)

    low_site, high_site = couples.min(axis=1), couples.max(axis=1)
    on_fracture = (high_site < 2 * len(pairs)) & (low_site % 2 == 0) & (high_site == low_site + 1)
    if on_fracture.sum() != len(pairs):
        sys.exit("the size is too large: fractures are too near to each other or to the boundary")
    fracture = np.where(on_fracture, fracture_of_pair[np.minimum(low_site // 2, len(pairs) - 1)], -1)
    cell, face = couples.ravel(), np.repeat(np.arange(len(ends)), 2)
    cell, face = cell[cell < len(sites)], face[cell < len(sites)]
    order = np.argsort(cell, kind="stable")
    entries = {
        "vertices": np.column_stack([vertices, np.zeros(len(vertices))]),
        "faces/offsets": 2 * np.arange(len(ends) + 1),
        "faces/vertices": ends.ravel(),
        "faces/tag": side[high_site],
        "faces/fracture": fracture,
        "cells/offsets": np.insert(np.cumsum(np.bincount(cell)), 0, 0),
        "cells/faces": face[order],
        "cells/region": np.zeros(len(sites), dtype=np.int64),
    }
    texts = {"regions": [region[0]], "tags": ["left", "right", "bottom", "top"], "fractures": names}
    for name, lines in texts.items():
        entries[name] = np.frombuffer("".join(line + "\n" for line in lines).encode(), dtype=np.uint8)
    return entries, sites / stretch


def write(folder, text, entries, sites):
    """The model with its mesh from a file, the mesh, and the sites."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = re.split(r"(?m)^(?=\[)", text)
    tables = [table for table in tables if not re.match(r"\[(mesh|variants)\b", table)]
    (folder / "model.toml").write_text("".join([*tables, '\n[mesh]\nfile = "mesh.h5"\n']))
    with h5py.File(folder / "mesh.h5", "w", libver=("v110", "v110")) as file:
        file.attrs.update({"version": np.uint32(1), "dimension": np.uint32(2)})
        for name, values in entries.items():
            file[name] = values
    np.save(folder / "points.npy", sites)


if __name__ == "__main__":
    text = (Path(sys.argv[1]) / "model.toml").read_text()
    write(Path(sys.argv[3]), text, *mesh(tomllib.loads(text), float(sys.argv[2])))
