"""The module of whole control steps: clean under sanitizers with odd numbers and wrong arguments."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from support.c_controllers import COMPILER, SOURCES

SUPPORT = Path(__file__).parents[1] / "support"
PARTS = (
    *("python/whole_step_module.c", "control/contact_kinematics.c", "control/control_step.c"),
    *("control/joint_accelerations.c", "kernel/certify.c", "kernel/grasp_matrix.c", "kernel/solve.c"),
)


def shared_library(name: str) -> str | None:
    """Return the path of a library of the compiler; None if it has none."""
    found = subprocess.run([str(COMPILER), f"-print-file-name={name}"], capture_output=True, text=True, check=False)
    return found.stdout.strip() if os.path.isabs(found.stdout.strip()) else None


@pytest.mark.skipif(COMPILER is None or sys.platform != "linux", reason="needs a C compiler on Linux")
def test_whole_steps_are_clean_under_sanitizers(tmp_path: Path) -> None:
    libraries = shared_library("libasan.so"), shared_library("libstdc++.so.6")
    if libraries[0] is None or libraries[1] is None:
        pytest.skip("this compiler has no shared sanitizer")
    module = tmp_path / ("_whole_step" + str(sysconfig.get_config_var("EXT_SUFFIX")))
    flags = ["-std=c11", "-O0", "-g", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror", "-Wno-psabi", "-DGF_LANES=1"]
    flags += [f"-I{SOURCES / 'include'}", f"-I{sysconfig.get_paths()['include']}"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    sources = [str(SOURCES / part) for part in PARTS]
    subprocess.run([str(COMPILER), *flags, *sources, "-lm", "-o", str(module)], check=True)
    # Leaks are not reported: the interpreter keeps memory until it ends. Exceptions of C++ libraries need libstdc++ first.
    preload = {"LD_PRELOAD": " ".join(map(str, libraries)), "ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"}
    command = [sys.executable, str(SUPPORT / "odd_whole_steps.py"), str(module)]
    environment = {**os.environ, **preload, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    attempts, found = map(int, done.stdout.split())
    assert attempts > 200
    assert 0 < found < attempts  # usual states, and odd ones that are left to the reference
