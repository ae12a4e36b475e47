"""The FMU as a file: valid to FMPy and to the schemas of the standard."""

import zipfile
from pathlib import Path

import fmpy
from fmpy.validation import validate_fmu
from lxml import etree

SCHEMAS = Path(fmpy.__file__).parent / "schema" / "fmi3"


def xml(fmu, name):
    with zipfile.ZipFile(fmu) as archive:
        return etree.fromstring(archive.read(name))


def schema(name):
    return etree.XMLSchema(file=str(SCHEMAS / name))


def test_fmpy_has_nothing_to_say(fmu):
    assert validate_fmu(fmu) == []


def test_the_description_follows_the_schema(fmu):
    checker = schema("fmi3ModelDescription.xsd")
    root = xml(fmu, "modelDescription.xml")
    assert checker.validate(root), checker.error_log
    # The check can fail.
    root.find("ModelVariables/Float64").set("valueReference", "-1")
    assert not checker.validate(root)


def test_the_terminals_follow_the_schema(fmu):
    checker = schema("fmi3TerminalsAndIcons.xsd")
    root = xml(fmu, "terminalsAndIcons/terminalsAndIcons.xml")
    assert checker.validate(root), checker.error_log
    names = {v.name for v in fmpy.read_model_description(fmu).modelVariables}
    members = {m.get("variableName") for m in root.iter("TerminalMemberVariable")}
    assert members == {"bars.heat", "bars.temperature"} <= names


def test_what_is_declared_is_read(fmu):
    description = fmpy.read_model_description(fmu)
    variables = {v.name: v for v in description.modelVariables}
    assert [d.start for d in variables["bars.temperature"].dimensions] == [3, 4]
    assert variables["bars.phase"].declaredType.items[1].name == "liquid"
    watt = next(u for u in description.unitDefinitions if u.name == "W")
    assert (watt.baseUnit.kg, watt.baseUnit.m, watt.baseUnit.s) == (1, 2, -3)
    # FMPy renames the flags, so they are read from the file.
    flags = xml(fmu, "modelDescription.xml").find("CoSimulation").attrib
    assert {name for name, value in flags.items() if value == "true"} == {
        "canGetAndSetFMUState",
        "canSerializeFMUState",
        "providesDirectionalDerivatives",
        "providesAdjointDerivatives",
        "canHandleVariableCommunicationStepSize",
    }


def test_old_unpackers_can_read_the_archive(fmu):
    with zipfile.ZipFile(fmu) as archive:
        assert archive.testzip() is None
        for entry in archive.infolist():
            assert entry.extract_version <= 20 and entry.compress_type in (0, 8)
            assert entry.date_time == (1980, 1, 1, 0, 0, 0)
