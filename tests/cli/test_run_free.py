"""``graspforce simulate --free``: step responses of a hand without an object."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import load

from graspforce.cli import main
from graspforce.cli.run_free import parse_posture

FREE = ["simulate", "--free", "--hand", "four_finger", "--duration", "0.6"]


def test_free_prints_a_row_for_each_moved_joint_and_writes_files(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    joint = load("four_finger").joint_names[1]
    files = ["--save", str(tmp_path / "run.npz"), "--plots", str(tmp_path / "plots")]
    assert main([*FREE, "--posture", f"{joint}=0.5", "--frequency", "5", *files]) == 0
    out = capsys.readouterr().out
    assert "four_finger, computed_torque: 0.6 s without an object" in out
    assert sum(name in out for name in load("four_finger").joint_names) == 1
    assert np.load(tmp_path / "run.npz")["q"].shape == (600, 12)
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {"positions.png", "torques.png"}


def test_free_fails_if_a_joint_does_not_settle(capsys):
    assert main([*FREE[:-1], "0.05"]) == 1
    assert "–" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--law", "lqr"], "--law"),
        (["--rise", "-1"], "--rise"),
        (["--frequency", "0"], "--frequency"),
        (["--posture", "joint"], "JOINT=RAD"),
        (["--posture", "finger_1_joint=0.1"], "--posture"),
        (["--view", "browser"], "--free"),
        (["--joint-friction", "-0.1"], "--joint-friction"),
        (["--joint-friction", "much"], "--joint-friction"),
    ],
)
def test_free_names_the_wrong_option(arguments, text, capsys):
    assert main([*FREE, *arguments]) == 1
    assert text in capsys.readouterr().err


def test_posture_has_the_named_joints_and_is_neutral_otherwise():
    hand = load("four_finger")
    name = hand.joint_names[4]
    q = parse_posture(f"{name}=0.25", hand)
    assert q[4] == 0.25
    np.testing.assert_array_equal(np.delete(q, 4), np.delete(hand.neutral, 4))
    with pytest.raises(Exception, match=f"--posture {name} = 9"):
        parse_posture(f"{name}=9", hand)
