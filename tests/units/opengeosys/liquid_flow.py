"""Time steps of OpenGeoSys' LiquidFlow process, one a request: liquid_flow.py SETUP.npz

A process of its own: OpenGeoSys writes to the standard output and brings libraries along that need not fit those of the
host. Requests come by the standard input, answers go to the standard output.

The time step of a simulation is fixed, what it writes to its pressure is not read, and apertures are read once. So each
time step is a simulation of its own, with the pressure before it as initial condition. It takes any time step, and equal
requests have equal answers to the last bit. (Importing ogs.OGSMesh makes known what OGSSimulation.mesh returns.)
"""

import os
import sys
import tempfile
from pathlib import Path

import meshio
import numpy as np
import ogs.OGSMesh  # noqa: F401
from ogs.OGSSimulator import OGSSimulation

from messages import receive, send

MEDIUM = """
<medium id="{number}">
    <phases><phase><type>AqueousLiquid</type><properties>
        <property><name>viscosity</name><type>Constant</type><value>{viscosity}</value></property>
        <property><name>density</name><type>Constant</type><value>1000</value></property>
    </properties></phase></phases>
    <properties>
        {permeability}
        <property><name>storage</name><type>Parameter</type><parameter_name>storage</parameter_name></property>
        <property><name>porosity</name><type>Constant</type><value>1</value></property>
        <property><name>reference_temperature</name><type>Constant</type><value>293.15</value></property>
    </properties>
</medium>"""
ROCK = "<property><name>permeability</name><type>Constant</type><value>{values}</value></property>"
FRACTURE = """
<property><name>permeability</name><type>Parameter</type><parameter_name>fracture_permeability</parameter_name></property>
"""
CONSTANT = "<parameter><name>{name}</name><type>Constant</type><value>{value}</value></parameter>"
DIRICHLET = """
<boundary_condition><mesh>{name}</mesh><type>Dirichlet</type><parameter>{name}</parameter></boundary_condition>"""


class LiquidFlow:
    """Triangles and, on fractures, segments between the same vertices; the pressure is continuous."""

    def __init__(self, setup, folder):
        self.setup, self.folder = setup, folder
        self.template = (Path(__file__).parent / "project.prj").read_text()
        triangles, segments = setup["triangles"], setup["segments"]
        # Without fractures there are no segments.
        self.cells = [("triangle", triangles), ("line", segments)][: 1 + (len(segments) > 0)]
        rocks = setup["permeability"].reshape(-1, 4).tolist()
        self.material = np.append(setup["region"], np.full(len(segments), len(rocks))).astype(np.int32)
        permeabilities = [ROCK.format(values=" ".join(map(repr, rock))) for rock in rocks] + [FRACTURE]
        self.media = "".join(
            MEDIUM.format(number=i, viscosity=setup["viscosity"], permeability=permeability)
            for i, permeability in enumerate(permeabilities)
        )
        self.held = {f"held{i}": value for i, value in enumerate(setup["held_pressure"])}
        for i, name in enumerate(self.held):
            faces = setup["held_faces"][setup["held_number"] == i]
            used, lines = np.unique(faces, return_inverse=True)
            data = {"bulk_node_ids": used.astype(np.uint64)}
            mesh = meshio.Mesh(setup["points"][used], [("line", lines.reshape(-1, 2))], point_data=data)
            mesh.write(folder / f"{name}.vtu")

    def step(self, request):
        """The pressure (Pa) at the vertices after a time step.

        Of the request: `step` (s); at the vertices `pressure` (Pa) and `source` (m²/s); in triangles and then segments
        `storage` (1/Pa), `aperture` (m, 1 in triangles) and `permeability` (m², that of segments is used).
        """
        by_kind = lambda values: np.split(values, [len(self.setup["triangles"])])[: len(self.cells)]
        meshio.Mesh(
            self.setup["points"],
            self.cells,
            point_data={
                "initial_pressure": request["pressure"],
                "source": request["source"],
                "bulk_node_ids": np.arange(len(self.setup["points"]), dtype=np.uint64),
            },
            cell_data={
                "MaterialIDs": by_kind(self.material),
                "storage": by_kind(request["storage"]),
                "aperture": by_kind(request["aperture"]),
                "fracture_permeability": by_kind(request["permeability"]),
            },
        ).write(self.folder / "domain.vtu")
        project = self.template.format(
            step=float(request["step"]),
            media=self.media,
            boundary_meshes="".join(f"<mesh>{name}.vtu</mesh>" for name in self.held),
            boundary_conditions="".join(DIRICHLET.format(name=name) for name in self.held),
            parameters="".join(CONSTANT.format(name=name, value=value) for name, value in self.held.items()),
        )
        (self.folder / "project.prj").write_text(project)
        simulation = OGSSimulation(["", str(self.folder / "project.prj"), "-o", str(self.folder), "-l", "error"])
        try:
            if simulation.execute_time_step() != 0:
                raise RuntimeError("OpenGeoSys could not do the time step")
            return simulation.mesh("domain").data_array("pressure", "double").copy()
        finally:
            simulation.close()


def main():
    answers = os.fdopen(os.dup(1), "wb")
    # OpenGeoSys writes there.
    os.dup2(2, 1)
    with tempfile.TemporaryDirectory() as folder:
        flow = LiquidFlow(dict(np.load(sys.argv[1])), Path(folder))
        while (request := receive(sys.stdin.buffer)) is not None:
            send(answers, pressure=flow.step(request))


if __name__ == "__main__":
    main()
