"""The wiring as an SSP 2.0 archive against the standard's schema, and what docs/interface.md says in Python."""

import re
import subprocess
import zipfile
from pathlib import Path

import fmpy
import pyssp_standard
import pytest
from conftest import COARSE, ROOT, SIX
from lxml import etree
from pack import orchestrator

SCHEMAS = Path(pyssp_standard.__file__).parent / "resources" / "ssp2"
SSD, SSC, SSV = (
    f"{{http://ssp-standard.org/SSP1/SystemStructure{name}}}" for name in ("Description", "Common", "ParameterValues")
)


def valid(name, archive, entry):
    """The root of an XML file of the archive, which the schema accepts."""
    schema = etree.XMLSchema(etree.parse(SCHEMAS / f"{name}.xsd"))
    root = etree.fromstring(archive.read(entry))
    schema.assertValid(root)
    return root


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packed")
    subprocess.run([orchestrator(), "pack", SIX, "--output", folder, "--ssp", *COARSE], check=True)
    return folder


def test_the_archive_satisfies_the_schema_and_its_units(packed):
    with zipfile.ZipFile(packed / "six-fractures.ssp") as archive:
        root = valid("SystemStructureDescription", archive, "SystemStructure.ssd")
        parameters = valid("SystemStructureParameterValues", archive, "resources/mechanics.ssv")
        archive.extractall(packed / "archive")
    values = {p.get("name"): float(p[0].get("value")) for p in parameters.iter(f"{SSV}Parameter")}
    assert values == {"porosity_compliance.factor": 1.0, "aperture_compliance.floor": 0.0}
    units = {u.get("name"): {k: int(v) for k, v in u[0].attrib.items()} for u in root.iter(f"{SSC}Unit")}
    assert units["Pa"] == {"kg": 1, "m": -1, "s": -2}
    connectors = {}
    for component in root.iter(f"{SSD}Component"):
        fmu = packed / "archive" / component.get("source")
        assert fmu.read_bytes() == (packed / f"six-fractures-{component.get('name')}.fmu").read_bytes()
        variables = {v.name: v for v in fmpy.read_model_description(str(fmu)).modelVariables}
        for connector in component.iter(f"{SSD}Connector"):
            variable = variables[connector.get("name")]
            assert connector.get("kind") == variable.causality
            assert connector[0].tag == SSC + variable.type and connector[0].get("unit") == variable.unit
            assert variable.unit in units
            sizes = [int(d.get("size")) for d in connector.iter(f"{SSC}Dimension")]
            assert sizes == [int(d.start) for d in variable.dimensions]
            connectors[component.get("name"), variable.name] = (connector.get("kind"), sizes)
    names = ("startElement", "startConnector", "endElement", "endConnector")
    connections = [tuple(c.get(name) for name in names) for c in root.iter(f"{SSD}Connection")]
    assert ("flow", "matrix.pressure", "mechanics", "matrix.pressure") in connections
    assert ("mechanics", "fracture.aperture_compliance", "flow", "fracture.aperture_compliance") in connections
    assert ("flow", "fracture.pressure", "flow", "fracture.pressure_reference") in connections
    # Four fields, and two compliances with their references.
    assert len(connections) == 8
    for start, output, end, input in connections:
        assert connectors[start, output][0] == "output" and connectors[end, input][0] == "input"
        assert connectors[start, output][1] == connectors[end, input][1]
    used = {c[:2] for c in connections} | {c[2:] for c in connections}
    assert used == set(connectors)


def test_a_third_unit_is_in_the_archive(packed, tmp_path):
    """A second flow that is given what mechanics finds, with a parameter and a list of start values."""
    fmu, name = packed / "six-fractures-flow.fmu", "matrix.porosity_change"
    cells = next(v for v in fmpy.read_model_description(str(fmu)).modelVariables if v.name == name).dimensions[0].start
    starts = [i * 1e-9 for i in range(int(cells))]
    unit = f'units.twin={{fmu="{fmu}", parameters={{"matrix_pressure_stiffness.cap"=1e12, "{name}"={starts}}}}}'
    wire = f'connections=[{{from="mechanics.{name}", to="twin.{name}"}}]'
    changes = [*COARSE, "--set", unit, "--set", wire]
    subprocess.run([orchestrator(), "pack", SIX, "--output", tmp_path, "--ssp", *changes], check=True)
    with zipfile.ZipFile(tmp_path / "six-fractures.ssp") as archive:
        root = valid("SystemStructureDescription", archive, "SystemStructure.ssd")
        parameters = valid("SystemStructureParameterValues", archive, "resources/twin.ssv")
        assert archive.read("resources/twin.fmu") == fmu.read_bytes()
    assert [c.get("name") for c in root.iter(f"{SSD}Component")] == ["flow", "mechanics", "twin"]
    *_, last = root.iter(f"{SSD}Connection")
    assert dict(last.attrib) == dict(
        startElement="mechanics", startConnector=name, endElement="twin", endConnector=name
    )
    cap, start = sorted(parameters.iter(f"{SSV}Parameter"), key=len)
    assert float(cap[0].get("value")) == 1e12
    assert [float(v) for v in start[0].get("value").split()] == starts and start[1].get("size") == str(cells)


def test_a_broken_archive_does_not_satisfy_the_schema(packed):
    with zipfile.ZipFile(packed / "six-fractures.ssp") as archive:
        root = etree.fromstring(archive.read("SystemStructure.ssd"))
    next(root.iter(f"{SSD}Connector")).set("kind", "entrance")
    schema = etree.XMLSchema(etree.parse(SCHEMAS / "SystemStructureDescription.xsd"))
    assert not schema.validate(root)


def test_the_same_model_gives_the_same_archive(packed, tmp_path):
    subprocess.run([orchestrator(), "pack", SIX, "--output", tmp_path, "--ssp", *COARSE], check=True)
    assert (tmp_path / "six-fractures.ssp").read_bytes() == (packed / "six-fractures.ssp").read_bytes()


def test_the_fingerprint_and_the_sides_are_what_the_document_says(packed):
    """Runs the code of docs/interface.md on the mesh that is written beside the units."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "interface.md").read_text(), re.S)
    names = {"path": packed / "six-fractures-mesh.h5"}
    exec(code, names)
    said = subprocess.run([orchestrator(), "check", SIX, *COARSE], check=True, capture_output=True, text=True).stdout
    assert f"mesh fingerprint: {names['fingerprint']}\n" in said
    assert len(names["fracture_faces"]) == int(re.search(r"(\d+) fracture faces", said)[1])
