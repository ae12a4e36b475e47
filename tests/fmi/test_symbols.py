"""Every exported symbol against the standard's C header, by a C compiler.

The declarations that fmi-unit makes of its own signatures are compiled after those of the standard: a
difference in any parameter is a compile error. The program then assigns each symbol of the library to a
pointer of the standard's function type, and calls one.
"""

import re
import subprocess
from pathlib import Path

import fmpy
import pytest
from conftest import FOLDER

HEADERS = Path(fmpy.__file__).parent / "c-code"

PROGRAM = """
#include <dlfcn.h>
#include <stdio.h>
#include <string.h>
#include "fmi3Functions.h"
#include "fmi_unit.h"

_Static_assert(sizeof(fmi3Status) == 4 && fmi3OK == 0 && fmi3Warning == 1 && fmi3Discard == 2
               && fmi3Error == 3 && fmi3Fatal == 4, "status");
_Static_assert(sizeof(fmi3DependencyKind) == 4 && sizeof(fmi3IntervalQualifier) == 4, "enumerations");
_Static_assert(sizeof(fmi3Boolean) == 1 && sizeof(fmi3Clock) == 1 && sizeof(fmi3Byte) == 1, "bytes");

int main(int count, char **arguments) {
    void *library = dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL);
    int found = 0;
    if (!library) { puts(dlerror()); return 1; }
%s
    fmi3GetVersionTYPE *version = (fmi3GetVersionTYPE *)dlsym(library, "fmi3GetVersion");
    printf("%%d %%s\\n", found, version());
    return strcmp(version(), fmi3Version) != 0;
}
"""

ASSIGN = """    {{ {0}TYPE *p = {0}; p = ({0}TYPE *)dlsym(library, "{0}"); if (p) found++; else puts("{0} is missing"); }}"""


@pytest.fixture
def functions():
    text = (HEADERS / "fmi3Functions.h").read_text()
    found = re.findall(r"^FMI3_Export (\w+)TYPE\s+(\w+);", text, re.MULTILINE)
    assert len(found) == 75 and all(a == b for a, b in found)
    return [name for name, _ in found]


def build(folder, functions, header):
    """Compiles the program against our declarations in `header` and links it to the library."""
    (folder / "fmi_unit.h").write_text(header)
    source, program = folder / "symbols.c", folder / "symbols"
    source.write_text(PROGRAM % "\n".join(ASSIGN.format(name) for name in functions))
    library = next((FOLDER.parent / "debug/examples").glob("libheated_bars.so"))
    command = ["cc", "-std=c11", "-Wall", "-Werror", f"-I{HEADERS}", f"-I{folder}", source, library, "-ldl", "-o", program]
    return subprocess.run(command, capture_output=True, text=True), program, library


def test_every_symbol_has_the_type_of_the_standard(functions, tmp_path):
    header = (FOLDER / "fmi_unit.h").read_text()
    assert header.count(";\n") == 75
    compiled, program, library = build(tmp_path, functions, header)
    assert compiled.returncode == 0, compiled.stderr
    run = subprocess.run([program, library], capture_output=True, text=True)
    assert (run.stdout, run.returncode) == ("75 3.0\n", 0)


@pytest.mark.parametrize("good, bad", [("double*, size_t", "float*, size_t"), ("bool, size_t", "int, size_t")])
def test_a_wrong_signature_does_not_compile(functions, tmp_path, good, bad):
    header = (FOLDER / "fmi_unit.h").read_text()
    compiled, _, _ = build(tmp_path, functions, header.replace(good, bad, 1))
    assert "conflicting types" in compiled.stderr


def test_nothing_else_is_exported(functions):
    library = FOLDER.parent / "debug/examples/libheated_bars.so"
    listed = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True)
    assert sorted(line.split()[-1] for line in listed.stdout.splitlines()) == sorted(functions)
