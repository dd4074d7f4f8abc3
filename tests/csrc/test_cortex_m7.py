"""The controller in C for a Cortex-M7, run by an emulator: the torques of Python, no heap, a bounded stack."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.c_controllers import python_torques, random_records
from support.control_grasps import named_grasp
from support.cortex_m7 import ALLOCATORS, COMPILER, EMULATOR, FLOAT32, MISSING, count_steps, undefined_symbols

pytestmark = pytest.mark.skipif(COMPILER is None or EMULATOR is None, reason=MISSING)


def test_steps_on_a_microcontroller_equal_python_without_heap(tmp_path: Path) -> None:
    """The counter of instructions is right to its resolution; the stack stays below 8 KiB."""
    grasp = named_grasp("allegro_right sphere")
    records = random_records(grasp, 5, seed=1, scale=0.1)
    counted, objects = count_steps(tmp_path, grasp, records)
    expected, _ = python_torques(grasp, records)
    assert counted.statuses == ["full"] * 5
    np.testing.assert_allclose(counted.torques, expected, rtol=0.0, atol=1e-8)  # a solver without lanes takes other roundings
    assert not ALLOCATORS & undefined_symbols(objects)
    assert (counted.stack < 8192).all()
    assert counted.loop[0] == pytest.approx(counted.loop[1], abs=80)
    assert (counted.instructions > 0).all()


def test_single_precision_needs_no_double_arithmetic_and_takes_fewer_instructions(tmp_path: Path) -> None:
    """On a Cortex-M7 without a double-precision unit, arithmetic of double would call functions such as __aeabi_dmul."""
    grasp = named_grasp("allegro_right sphere")
    records = random_records(grasp, 3, seed=1, scale=0.1)
    for name in ("single", "double"):
        (tmp_path / name).mkdir()
    single, objects = count_steps(tmp_path / "single", grasp, records, FLOAT32)
    double, _ = count_steps(tmp_path / "double", grasp, records)
    symbols = undefined_symbols(objects)
    assert not ALLOCATORS & symbols
    assert not {name for name in symbols if name.startswith(("__aeabi_d", "__aeabi_f2d", "__aeabi_i2d"))}
    assert single.statuses == ["full"] * 3
    np.testing.assert_allclose(single.torques, double.torques, rtol=0.0, atol=5e-4 * np.abs(double.torques).max())
    assert (single.stack < 8192).all()
    assert single.memory < 0.6 * double.memory
