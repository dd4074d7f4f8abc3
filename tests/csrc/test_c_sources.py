"""The C sources: warnings, sanitizers, C++ users, the example of the header, and names of versions and statuses."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

import graspforce
from graspforce import Status

SOURCES = Path(graspforce.__file__).parent / "csrc"
HEADERS = sorted((SOURCES / "include/graspforce").glob("*.h"))
KERNEL = sorted((SOURCES / "kernel").glob("*.c"))
CONTROL = sorted((SOURCES / "control").glob("*.c")) + sorted((SOURCES / "controller").glob("*.c"))
MODULES = sorted((SOURCES / "python").glob("*.c"))
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
WARNINGS = ["-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-Wno-psabi", "-Werror"]
SANITIZERS = ["-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


def compile_program(folder: Path, sources: list[Path], *flags: str) -> Path:
    program = folder / "program"
    assert COMPILER is not None
    command = [COMPILER, *flags, "-Wno-psabi", f"-I{SOURCES / 'include'}", *map(str, sources), "-lm", "-o", str(program)]
    subprocess.run(command, check=True, timeout=300)
    return program


def has_sanitizers(folder: Path) -> bool:
    (folder / "probe.c").write_text("int main(void) { return 0; }\n")
    try:
        compile_program(folder, [folder / "probe.c"], "-std=c11", *SANITIZERS)
    except subprocess.CalledProcessError:
        return False
    return True


@needs_compiler
@pytest.mark.parametrize("lanes", [1, 2, 4])
@pytest.mark.parametrize("source", [*KERNEL, *CONTROL], ids=lambda path: path.stem)
def test_library_compiles_without_warnings(source: Path, lanes: int) -> None:
    """This holds at every vector width, as C11 without extensions."""
    assert COMPILER is not None
    flags = ["-std=c11", "-Wpedantic", *WARNINGS, "-O2", "-fsyntax-only", f"-DGF_LANES={lanes}", f"-I{SOURCES / 'include'}"]
    subprocess.run([COMPILER, *flags, str(source)], check=True, timeout=60)


@needs_compiler
@pytest.mark.parametrize("source", MODULES, ids=lambda path: path.stem)
def test_python_modules_compile_without_warnings(source: Path) -> None:
    assert COMPILER is not None
    include = [f"-I{sysconfig.get_paths()['include']}", f"-I{SOURCES / 'include'}"]
    warnings = [flag for flag in WARNINGS if flag != "-Wconversion"]  # Python's own macros convert
    subprocess.run([COMPILER, "-std=c11", *warnings, "-O2", "-fsyntax-only", *include, str(source)], check=True, timeout=60)


@needs_compiler
def test_headers_compile_as_cpp(tmp_path: Path) -> None:
    """All headers together, as C++17 with warnings as errors."""
    text = "".join(f'#include "graspforce/{path.name}"\n' for path in HEADERS)
    (tmp_path / "headers.cpp").write_text(text + "int main() { return gf_workspace_size(nullptr) != 0; }\n")
    assert COMPILER is not None
    flags = ["-x", "c++", "-std=c++17", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-fsyntax-only", f"-I{SOURCES / 'include'}"]
    subprocess.run([COMPILER, *flags, str(tmp_path / "headers.cpp")], check=True, timeout=60)


@needs_compiler
@pytest.mark.parametrize("lanes", [1, 2, 4])
def test_example_of_the_header_prints_its_result(tmp_path: Path, lanes: int) -> None:
    """The program in the comment of solve.h compiles without warnings and prints the line that the comment states."""
    comment = (SOURCES / "include/graspforce/solve.h").read_text().split("#ifndef")[0]
    example = comment[comment.index(" *     #include") : comment.index(" * prints")]
    (tmp_path / "example.c").write_text(re.sub(r"^ \*( {5})?", "", example, flags=re.M))
    expected = re.search(r'prints "(.*)"', comment)
    flags = ["-std=c11", *WARNINGS, "-O1", f"-DGF_LANES={lanes}"]
    program = compile_program(tmp_path, [tmp_path / "example.c", *KERNEL], *flags)
    assert expected is not None
    assert subprocess.run([program], check=True, capture_output=True, text=True, timeout=60).stdout.strip() == expected[1]


@needs_compiler
def test_status_strings_equal_the_statuses_of_python(tmp_path: Path) -> None:
    (tmp_path / "status.c").write_text(
        '#include <stdio.h>\n#include "graspforce/problem.h"\n'
        "int main(void) { for (int i = -1; i < 5; i++) puts(gf_status_string(i)); return 0; }\n"
    )
    program = compile_program(tmp_path, [tmp_path / "status.c", SOURCES / "kernel/strings.c"], "-std=c11", *WARNINGS)
    lines = subprocess.run([program], check=True, capture_output=True, text=True, timeout=60).stdout.split()
    assert lines == ["unknown", *(status.value for status in Status), "unknown"]


def test_version_of_the_library_equals_that_of_the_package() -> None:
    """The header states the version once as numbers and once as text; the compiled module has it from the library."""
    text = (SOURCES / "include/graspforce/version.h").read_text()
    numbers = [re.search(rf"#define GF_VERSION_{part} +(\d+)", text) for part in ("MAJOR", "MINOR", "PATCH")]
    string = re.search(r'#define GF_VERSION +"(.*)"', text)
    assert string is not None
    assert string[1] == graspforce.__version__
    assert ".".join(number[1] for number in numbers if number is not None) == graspforce.__version__
    module = pytest.importorskip("graspforce.force.backends._structured")
    assert module.__version__ == graspforce.__version__


@needs_compiler
def test_kernel_has_no_fault_under_sanitizers(tmp_path: Path) -> None:
    """AddressSanitizer and UndefinedBehaviorSanitizer with random and invalid numbers. kernel_fuzz.c checks the laws."""
    if not has_sanitizers(tmp_path):
        pytest.skip("this compiler has no sanitizers")
    fuzz = Path(__file__).with_name("kernel_fuzz.c")
    program = compile_program(tmp_path, [fuzz, *KERNEL], "-std=c11", *SANITIZERS)
    result = subprocess.run([program, "3000"], check=False, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    optimal, _, infeasible, failed = map(int, result.stdout.split())
    assert min(optimal, infeasible, failed) > 100  # every kind of result occurs


@needs_compiler
def test_binding_has_no_fault_under_sanitizers(tmp_path: Path) -> None:
    """The extension module under both sanitizers, in an interpreter that passes wrong sizes, types and numbers."""
    assert COMPILER is not None
    command = [COMPILER, "-print-file-name=libasan.so"]
    library = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    if not os.path.isabs(library):
        pytest.skip("this compiler has no shared sanitizer")
    module = tmp_path / ("_structured" + str(sysconfig.get_config_var("EXT_SUFFIX")))
    flags = ["-std=c11", "-fPIC", "-shared", "-Wno-psabi", *SANITIZERS]
    include = [f"-I{sysconfig.get_paths()['include']}", f"-I{SOURCES / 'include'}"]
    sources = [str(path) for path in (SOURCES / "python/structured_module.c", *KERNEL)]
    subprocess.run([COMPILER, *flags, *include, *sources, "-lm", "-o", str(module)], check=True)
    fuzz = Path(__file__).with_name("binding_fuzz.py")
    # The interpreter does not free all of its memory at its end, so leaks are not detected.
    environment = {**os.environ, "LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(fuzz), str(module), "400"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    accepted, rejected, raised = map(int, result.stdout.split())
    assert min(accepted, rejected, raised) > 100  # every kind of result occurs
