"""The command ``graspforce regrasp``."""

from __future__ import annotations

import json

import pytest
from support.regrasp_plans import plan_with_one_step

from graspforce.cli import main, run_regrasp
from graspforce.planning.failure import UNSOLVED, PlanFailure

SHORT = ["regrasp", "--hand", "four_finger", "--object", "sphere:0.03", "--angle", "0.1"]


@pytest.fixture
def _no_search(monkeypatch):
    monkeypatch.setattr(run_regrasp, "find_regrasp_start", lambda *_: plan_with_one_step().task.grasp)


@pytest.mark.usefixtures("_no_search")
def test_regrasp_prints_stages_and_outcome(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(run_regrasp, "plan_regrasp", lambda *_: plan_with_one_step())
    assert main([*SHORT, "--plots", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("steps", "complete", "least planned slip margin"))
    assert (tmp_path / "regrasp.png").stat().st_size > 0
    assert (tmp_path / "torques.png").stat().st_size > 0


@pytest.mark.usefixtures("_no_search")
def test_failed_search_gives_its_reason_and_exit_code_1(monkeypatch, capsys):
    monkeypatch.setattr(run_regrasp, "plan_regrasp", lambda *_: PlanFailure(UNSOLVED, "The object came to 5 %.", 0.05))
    assert main(SHORT) == 1
    assert "The object came to 5 %." in capsys.readouterr().out


@pytest.mark.usefixtures("_no_search")
def test_goal_pose_is_searched_on_any_path(monkeypatch, capsys):
    goals = []
    monkeypatch.setattr(run_regrasp, "plan_regrasp_to", lambda goal, *_: goals.append(goal) or plan_with_one_step())
    assert main([*SHORT, "--to=0,0,0.001", "--turn=0,0,0.1", "--friction-uncertainty", "0.1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)
    (goal,) = goals
    assert goal.p_HO - goal.grasp.p_HO == pytest.approx([0.0, 0.0, 0.001])
    assert goal.turn == pytest.approx([0.0, 0.0, 0.1])
    assert goal.control.friction_error == 0.1


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--axis", "0,0,0"),
        ("--object-axis", "0,0,0"),
        ("--axis", "z"),
        ("--angle", "0"),
        ("--angle", "nan"),
        ("--slip-margin", "-1"),
        ("--budget", "0"),
        ("--to", "0,0,0"),
        ("--friction-uncertainty", "1"),
    ],
)
def test_wrong_option_is_named(option, value, capsys):
    assert main(["regrasp", option, value]) == 1
    assert option in capsys.readouterr().err


@pytest.mark.parametrize("axis", [(0.0, 0.0, 2.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.3, -0.5, 0.7)])
def test_object_axis_is_the_z_axis_of_the_object(axis):
    given = run_regrasp.RegraspOptions(
        grasp=run_regrasp.GraspOptions("four_finger", "sphere:0.03", None, None, None, "0,0,-9.81", 0),
        axis_H=(0.0, 0.0, 1.0), angle=1.0, object_axis_H=axis, slip_margin=0.1, budget=1.0,
    )  # fmt: skip
    R = given.orientation
    assert pytest.approx(run_regrasp.np.eye(3)) == R.T @ R
    assert R[:, 2] * sum(each**2 for each in axis) ** 0.5 == pytest.approx(axis)
