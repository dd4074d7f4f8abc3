"""The force solver and the controller with single precision: the torques of double, hostile numbers, no double arithmetic."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.c_controllers import (
    COMPILER,
    CPP_COMPILER,
    LIBRARY_SOURCES,
    SOURCES,
    build_loop,
    compile_objects,
    python_torques,
    random_records,
    run_loop,
)
from support.control_grasps import named_grasp

pytestmark = pytest.mark.skipif(COMPILER is None or CPP_COMPILER is None, reason="needs a C and a C++ compiler")
SINGLE = ["-DGF_FLOAT32"]
HOSTILE = (np.nan, np.inf, -np.inf, 1e38, -1e38, 1e19, 1e9, 1e-45)
# Of the largest torque. Certificates hold to 5e-4; a step that takes more has lost forces, not digits.
TOLERANCE = 1e-3


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> list[Path]:
    return compile_objects(tmp_path_factory.mktemp("float32"), LIBRARY_SOURCES, "-O1", *SINGLE)


@pytest.mark.parametrize("source", LIBRARY_SOURCES, ids=lambda path: path.stem)
def test_sources_compile_without_double_arithmetic(source: Path) -> None:
    """The compiler warns about each number that it would widen to double."""
    flags = ["-std=c11", "-Wpedantic", "-Wall", "-Wextra", "-Wshadow", "-Wdouble-promotion", "-Wfloat-conversion", "-Werror"]
    command = [str(COMPILER), *flags, *SINGLE, "-fsingle-precision-constant", "-O2", "-fsyntax-only", "-Wno-psabi"]
    if "clang" in subprocess.run([str(COMPILER), "--version"], capture_output=True, text=True, check=True).stdout:
        pytest.skip("clang has no option for constants with single precision")
    subprocess.run([*command, f"-I{SOURCES / 'include'}", str(source)], check=True, timeout=60)


@pytest.mark.parametrize(
    ("example", "name"),
    [
        ("control_loop.c", "allegro_right sphere"),
        ("control_loop.cpp", "dlr_hit2 sphere"),
        ("control_loop.c", "four_finger box"),
    ],
)
def test_torques_with_single_precision_equal_those_of_double(
    example: str, name: str, tmp_path: Path, library: list[Path]
) -> None:
    grasp = named_grasp(name)
    records = random_records(grasp, 300, seed=3)
    program = build_loop(tmp_path, example, grasp, library, *SINGLE)
    torques, _ = run_loop(program, records, grasp.hand.n, np.float32)
    expected, _ = python_torques(grasp, records)
    np.testing.assert_allclose(torques, expected, rtol=0.0, atol=TOLERANCE * np.abs(expected).max())


def test_hostile_numbers_give_finite_torques_within_limits(tmp_path: Path, library: list[Path]) -> None:
    grasp, rng = named_grasp("allegro_right sphere"), np.random.default_rng(6)
    records = random_records(grasp, 300, seed=7)
    for row in records:
        row[rng.integers(len(row), size=3)] = rng.choice(HOSTILE, size=3)
    torques, _ = run_loop(build_loop(tmp_path, "control_loop.c", grasp, library, *SINGLE), records, grasp.hand.n, np.float32)
    assert np.isfinite(torques).all()
    assert (np.abs(torques) <= np.maximum(grasp.hand.torque_upper, -grasp.hand.torque_lower) * (1.0 + 1e-6)).all()
