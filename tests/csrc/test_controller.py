"""The controller in C: torques of the C and C++ loops equal those of Python; hostile numbers; no heap."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.c_controllers import (
    COMPILER,
    CPP_COMPILER,
    LIBRARY_SOURCES,
    build_loop,
    compile_objects,
    library_objects,
    python_torques,
    random_records,
    run_loop,
)
from support.control_grasps import named_grasp, soft_box_grasp

from graspforce import Contact, ContactSet
from graspforce.control import ControlSettings, FrictionSettings, write_controller
from graspforce.core.errors import InvalidInput
from graspforce.geometry import ImplicitSurface
from graspforce.grasp.body import Body

pytestmark = pytest.mark.skipif(COMPILER is None or CPP_COMPILER is None, reason="needs a C and a C++ compiler")
SANITIZERS = ["-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
TOLERANCE = 1e-9  # N·m: both solvers stop at a relative error of 1e-9 of torques below 1 N·m
HOSTILE = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e155, 1e30, 1e9, 5e-324)
ALLOCATORS = {"malloc", "calloc", "realloc", "aligned_alloc", "free", "printf", "fprintf"}


@pytest.fixture(scope="session")
def library(tmp_path_factory) -> list[Path]:
    return library_objects(tmp_path_factory.mktemp("library"))


@pytest.mark.parametrize(
    ("example", "name"),
    [
        ("control_loop.c", "allegro_right sphere"),
        ("control_loop.c", "dlr_hit2 sphere"),
        ("control_loop.c", "four_finger box"),
        ("control_loop.c", "four_finger superquadric"),
        ("control_loop.cpp", "allegro_right cylinder"),
    ],
)
def test_torques_of_a_loop_without_python_equal_those_of_python(
    example: str, name: str, tmp_path: Path, library: list[Path]
) -> None:
    """Random states and motions in sequence, so that integral, contact frames, sliding and warm starts count as well."""
    grasp = named_grasp(name)
    records = random_records(grasp, 300, seed=3)
    program = build_loop(tmp_path, example, grasp, library)
    torques, _ = run_loop(program, records, grasp.hand.n)
    expected, commands = python_torques(grasp, records)
    assert all(command.solution.found for command in commands)
    np.testing.assert_allclose(torques, expected, rtol=0.0, atol=TOLERANCE)


def test_soft_pads_that_spin_equal_python(tmp_path: Path, library: list[Path]) -> None:
    """The constraints of soft contacts hold spins, and the memory holds their angles."""
    plain = named_grasp("allegro_right box")
    pairs = zip(plain.contacts.p_OC, plain.contacts.R_OC[:, :, 2], strict=True)
    contacts = [Contact(p, n, friction=0.7, max_normal=20.0, model="soft", torsional_friction=0.005) for p, n in pairs]
    grasp = replace(plain, hand=plain.hand.with_pads(0.005), contacts=ContactSet.stack(contacts))
    records = random_records(grasp, 100, seed=4, scale=0.2)
    torques, report = run_loop(build_loop(tmp_path, "control_loop.c", grasp, library), records, grasp.hand.n)
    expected, commands = python_torques(grasp, records)
    assert ".spin_damping = 0.014" in (tmp_path / "grasp_controller.c").read_text()
    assert report.split() == ["full", "100"]
    assert all(command.solution.found for command in commands)
    np.testing.assert_allclose(torques, expected, rtol=0.0, atol=TOLERANCE)


def test_objects_that_yield_to_soft_pads_equal_python(tmp_path: Path, library: list[Path]) -> None:
    """Close to a loss of rank, the object yields; further away it does not."""
    grasp, settings = soft_box_grasp(), ControlSettings(spin_compliance=0.01)
    records = random_records(grasp, 100, seed=4, scale=0.2)
    program = build_loop(tmp_path, "control_loop.c", grasp, library, settings=settings)
    torques, report = run_loop(program, records, grasp.hand.n)
    expected, commands = python_torques(grasp, records, settings)
    assert ".spin_compliance = 0.01" in (tmp_path / "grasp_controller.c").read_text()
    assert report.split() == ["full", "100"]
    assert all(command.solution.found for command in commands)
    np.testing.assert_allclose(torques, expected, rtol=0.0, atol=TOLERANCE)


def test_heavy_object_gets_a_smaller_margin_and_torques_within_limits(tmp_path: Path, library: list[Path]) -> None:
    """If the slip margin is infeasible, the forces keep a part of it."""
    grasp, settings = named_grasp("allegro_right sphere"), ControlSettings(slip_margin=20.0)
    records = random_records(grasp, 20, seed=5)
    program = build_loop(tmp_path, "control_loop.c", grasp, library, settings=settings)
    torques, report = run_loop(program, records, grasp.hand.n)
    assert report.split() == ["reduced", "20"]
    assert (torques >= grasp.hand.torque_lower).all()
    assert (torques <= grasp.hand.torque_upper).all()


def test_infeasible_steps_reuse_the_last_forces_as_in_python(tmp_path: Path, library: list[Path]) -> None:
    """No forces supply the wrench of the acceleration 2,000 m/s². The integral and the forces wait; the next step continues."""
    grasp = named_grasp("allegro_right sphere")
    records = random_records(grasp, 60, seed=8)
    infeasible = np.arange(60) % 3 == 1
    records[infeasible, -6] = 2000.0  # m/s²
    torques, report = run_loop(build_loop(tmp_path, "control_loop.c", grasp, library), records, grasp.hand.n)
    expected, commands = python_torques(grasp, records)
    assert report.split() == ["full", "40", "reused", "20"]
    assert [not command.solution.found for command in commands] == infeasible.tolist()
    # after a problem without solution the two solvers start from other forces, and agree to their accuracy only
    np.testing.assert_allclose(torques, expected, rtol=0.0, atol=1e-6)


def test_controller_refuses_too_little_memory(tmp_path: Path, library: list[Path]) -> None:
    """One byte less than gf_controller_size(), and memory that is not aligned."""
    program = tmp_path / "memory.c"
    program.write_text(
        """#include <stdio.h>
#include "grasp_controller.h"
static _Alignas(32) unsigned char memory[1 << 18];
int main(void)
{
    const size_t size = gf_controller_size(&grasp_controller);
    gf_controller_setup wrong = grasp_controller;
    wrong.grasp.force_size++;
    printf("%d %d %d %d\\n", gf_controller_init(&grasp_controller, memory, size) != NULL,
           gf_controller_init(&grasp_controller, memory, size - 1) != NULL,
           gf_controller_init(&grasp_controller, memory + 1, sizeof memory - 1) != NULL, gf_controller_size(&wrong) != 0);
    return 0;
}
"""
    )
    _, source, _, hand_source = write_controller(named_grasp("dlr_hit2 sphere"), tmp_path)
    objects = compile_objects(tmp_path / "tables", [source, hand_source, program], f"-I{tmp_path}")
    subprocess.run([str(COMPILER), *map(str, [*objects, *library]), "-lm", "-o", str(tmp_path / "memory")], check=True)
    result = subprocess.run([tmp_path / "memory"], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["1", "0", "0", "0"]


def test_hostile_numbers_cause_no_fault_and_leave_the_controller_intact(tmp_path: Path) -> None:
    """Under both sanitizers. An invalid state repeats the last torques, and the next state continues as if it had not been."""
    grasp = named_grasp("allegro_right sphere")
    n, rng = grasp.hand.n, np.random.default_rng(6)
    try:
        checked = compile_objects(tmp_path / "library", LIBRARY_SOURCES, *SANITIZERS)
        program = build_loop(tmp_path, "control_loop.c", grasp, checked, *SANITIZERS)
    except subprocess.CalledProcessError:
        pytest.skip("this compiler has no sanitizers")
    good = random_records(grasp, 150, seed=7)
    clean, _ = run_loop(program, good, n)
    not_finite = good.copy()
    not_finite[np.arange(150), rng.integers(good.shape[1], size=150)] = rng.choice(HOSTILE[:3], size=150)
    torques, report = run_loop(program, np.stack([good, not_finite], axis=1).reshape(300, -1), n)
    np.testing.assert_array_equal(torques[::2], clean)
    np.testing.assert_array_equal(torques[1::2], clean)
    assert "invalid 150" in report
    large = good.copy()
    for row in large:
        row[rng.integers(len(row), size=3)] = rng.choice(HOSTILE, size=3)
    torques, _ = run_loop(program, large, n)
    assert np.isfinite(torques).all()
    assert (np.abs(torques) <= np.maximum(grasp.hand.torque_upper, -grasp.hand.torque_lower)).all()


@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_library_calls_no_allocator_and_prints_nothing(library: list[Path]) -> None:
    result = subprocess.run(["nm", "-u", *map(str, library)], capture_output=True, text=True, check=True)
    assert not ALLOCATORS & set(result.stdout.split())


def test_settings_that_c_does_not_follow_are_refused(tmp_path: Path) -> None:
    grasp = named_grasp("allegro_right sphere")
    with pytest.raises(InvalidInput, match="joint friction"):
        write_controller(grasp, tmp_path, ControlSettings(friction=FrictionSettings()))
    ball = ImplicitSurface(lambda p: p @ p - 9e-4, lambda p: 2.0 * p, 0.03)
    body = Body(grasp.body.mass, grasp.body.inertia, grasp.body.p_OM, ball)
    with pytest.raises(InvalidInput, match=r"grasp\.body\.shape"):
        write_controller(replace(grasp, body=body), tmp_path)
    with pytest.raises(InvalidInput, match="letters"):
        write_controller(grasp, tmp_path, name="2nd")
