"""Kinematics and dynamics of every shipped hand in C equal those of Pinocchio, couplings included."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.c_controllers import COMPILER, SOURCES, WARNINGS, compile_objects

from graspforce import Hand
from graspforce.cli import main
from graspforce.core.errors import InvalidInput
from graspforce.hand import shipped_hands
from graspforce.hand.model_source import write_hand_source

CHECK = Path(__file__).with_name("hand_model_check.c")
STATES = 30
TOLERANCE = 1e-12  # some hundred roundings of numbers up to 10

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


@pytest.fixture(scope="session")
def library(tmp_path_factory) -> list[Path]:
    return compile_objects(tmp_path_factory.mktemp("hand_model"), [SOURCES / "controller/hand_model.c"], "-O2")


def compute_in_c(hand: Hand, folder: Path, library: list[Path], numbers: np.ndarray) -> np.ndarray:
    """Return the output of hand_model_check.c, a row for each row of numbers."""
    _, table = write_hand_source(hand, folder, "tested")
    flags = ['-DHEADER="tested_hand.h"', "-DHAND=tested_hand", f"-I{folder}", f"-I{SOURCES / 'include'}"]
    sources = [*map(str, [CHECK, table, *library])]
    command = [str(COMPILER), "-std=c11", *WARNINGS, *flags, *sources, "-lm", "-o", str(folder / "check")]
    subprocess.run(command, check=True, timeout=60)
    result = subprocess.run([folder / "check"], input=numbers.tobytes(), capture_output=True, check=True, timeout=60)
    return np.frombuffer(result.stdout).reshape(len(numbers), -1)


@needs_compiler
@pytest.mark.parametrize("name", shipped_hands())
def test_kinematics_and_dynamics_in_c_equal_pinocchio(name: str, tmp_path: Path, library: list[Path]) -> None:
    """Poses of all links, joint twists, their rates, and inverse dynamics, in random states within the joint limits."""
    hand, rng = Hand.load(name), np.random.default_rng(5)
    q = rng.uniform(hand.q_lower, hand.q_upper, size=(STATES, hand.n))
    v, a, gravity = rng.normal(size=(STATES, hand.n)), rng.normal(size=(STATES, hand.n)), 9.81 * rng.normal(size=(STATES, 3))
    outputs = compute_in_c(hand, tmp_path, library, np.hstack([q, v, a, gravity]))
    for i in range(STATES):
        motion = hand.model.link_motion(q[i], v[i])
        poses = np.concatenate([part.ravel() for part in motion.link_poses])
        expected = [poses, motion.J.ravel(), motion.J_rate.ravel(), hand.inverse_dynamics(q[i], v[i], a[i], gravity[i])]
        np.testing.assert_allclose(outputs[i], np.concatenate(expected), rtol=TOLERANCE, atol=TOLERANCE)


def test_command_writes_the_same_files_each_time(tmp_path: Path, capsys) -> None:
    texts = []
    for folder in ("first", "second"):
        assert main(["hands", "codegen", "ability_right", "--out", str(tmp_path / folder)]) in (None, 0)
        texts.append([path.read_text() for path in sorted((tmp_path / folder).iterdir())])
    assert texts[0] == texts[1]
    assert len(texts[0]) == 2
    assert "ability_right_hand.c" in capsys.readouterr().out


def test_name_must_be_a_c_identifier(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="letters, digits and underscores"):
        write_hand_source(Hand.load("dclaw"), tmp_path, "my hand")
