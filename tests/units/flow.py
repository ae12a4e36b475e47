"""What flow units have in common: the variables of docs/interface.md, and what the model says, in two dimensions."""

import tomllib
from pathlib import Path

import numpy as np

from arrays import DISCARDED, DONE, Arrays
from mesh import Mesh


class Flow(Arrays):
    """A flow unit of a model without wells, gravity, sources or compressibility of the fluid.

    `mesh`; in cells `permeability` (m², 2 × 2), `storage` 1/M (1/Pa) and `initial_pressure` (Pa); on fracture faces
    `normal_permeability` K_n (m²); `viscosity` (Pa s); `held`, pressures (Pa) of boundaries by number of the tag.

    In its memory are the porosity change and the aperture at the start of the time step.
    """

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        resources = Path(self.resources)
        self.mesh = mesh = Mesh(np.load(resources / "mesh.npz"))
        self._read(tomllib.loads((resources / "model.toml").read_text()))
        cells, faces = np.ones(mesh.cell_count), np.ones(len(mesh.fracture_faces))
        start = self.initial_pressure
        self.output("matrix.pressure", "Pa", start * cells, "Pressure in the rock")
        self.output("fracture.pressure", "Pa", start * faces, "Pressure in the fractures")
        self.input("matrix.porosity_change", "1", 0 * cells, "Porosity caused by deformation")
        self.input("fracture.aperture", "m", 0 * faces, "Hydraulic aperture; to be set before the start")
        # Needed for splits other than fixed strain and drained.
        self.input("matrix.porosity_compliance", "1/Pa", 0 * cells, "d(porosity change)/d(pressure) of mechanics")
        self.input("fracture.aperture_compliance", "m/Pa", 0 * faces, "d(aperture)/d(pressure) of mechanics")
        self.input("matrix.pressure_reference", "Pa", start * cells, "Pressure at which mechanics was evaluated")
        self.input("fracture.pressure_reference", "Pa", start * faces, "Pressure at which mechanics was evaluated")
        self.text("mesh.fingerprint", mesh.fingerprint, "Hash of the mesh's topology and coordinates")

    def exit_initialization_mode(self):
        if not (self.values["fracture.aperture"] > 0).all():
            raise ValueError("fracture.aperture must be set, and positive, before the start")
        self.memory["porosity_change"] = self.values["matrix.porosity_change"]
        self.memory["aperture"] = self.values["fracture.aperture"]

    def accept(self, matrix_pressure, fracture_pressure):
        """Ends a time step, if the apertures are positive. If not, nothing has changed: the host may try other inputs."""
        values = self.values
        excess = matrix_pressure - values["matrix.pressure_reference"]
        porosity_change = values["matrix.porosity_change"] + values["matrix.porosity_compliance"] * excess
        excess = fracture_pressure - values["fracture.pressure_reference"]
        aperture = values["fracture.aperture"] + values["fracture.aperture_compliance"] * excess
        if not (np.isfinite(matrix_pressure).all() and np.isfinite(fracture_pressure).all() and (aperture > 0).all()):
            self.log("an aperture is not positive, or a pressure not finite", DISCARDED.status)
            return DISCARDED
        values["matrix.pressure"], values["fracture.pressure"] = matrix_pressure, fracture_pressure
        self.memory.update(porosity_change=porosity_change, aperture=aperture)
        return DONE

    def _read(self, model):
        mesh, flow = self.mesh, model["flow"]
        unknown = [name for name in ("wells", "gravity", "matrix_source", "fracture_source") if flow.get(name)]
        if unknown or "bulk_modulus" in flow["fluid"]:
            raise ValueError(f"this unit knows no {', '.join(unknown) or 'compressible fluid'}")
        self.viscosity = flow["fluid"]["viscosity"]
        self.initial_pressure = number("initial.pressure", model["initial"]["pressure"])
        regions = [model["regions"][name] for name in mesh.regions]
        self.permeability = np.array([tensor(region["permeability"]) for region in regions])[mesh.region]
        self.storage = np.array([1 / region.get("biot_modulus", np.inf) for region in regions])[mesh.region]
        normal = np.array([model["fractures"][name]["normal_permeability"] for name in mesh.fractures])
        self.normal_permeability = normal[mesh.face_fracture[mesh.fracture_faces]]
        self.held = {}
        for name, boundary in flow.get("boundary", {}).items():
            if boundary.keys() != {"pressure"}:
                raise ValueError(f"flow.boundary.{name}: this unit knows pressures only")
            self.held[mesh.tags.index(name)] = number(f"flow.boundary.{name}.pressure", boundary["pressure"])


def number(entry, value):
    """A value of the model that must be a number, not an expression."""
    if not isinstance(value, (int, float)):
        raise ValueError(f"{entry} is {value!r}: this unit knows numbers only")
    return value


def tensor(permeability):
    """A permeability of the model as a 2 × 2 array: a number, a diagonal or all of it."""
    values = np.array(permeability, dtype=float)
    return values if values.ndim == 2 else np.diag(np.broadcast_to(values, 2))
