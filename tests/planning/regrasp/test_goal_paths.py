"""Paths to a goal pose, and plans for errors of the friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.regrasp_plans import CONTROL, start_state, turn_task

from graspforce import InvalidInput
from graspforce.contact.contact import ContactSet
from graspforce.geometry.rotations import rotation_exp
from graspforce.planning.failure import STOPPED, PlanFailure
from graspforce.planning.regrasp import RegraspGoal, RegraspPlan, RegraspSettings, goal_from_steps, plan_regrasp_to
from graspforce.planning.regrasp.holding import HoldingMargin

GRASP = named_grasp("four_finger sphere")


@pytest.mark.parametrize(
    ("to", "turn", "count"),
    [
        ([0.01, 0.0, 0.0], [0.0, 0.0, 0.0], 1),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 2.5], 2),
        ([0.01, 0.0, 0.02], [0.3, 0.0, 2.5], 6),
        ([0.0, 0.001, 0.0], [0.0, np.pi - 1e-9, 0.0], 6),
    ],
)
def test_all_paths_lead_from_the_grasp_to_the_goal(to: list[float], turn: list[float], count: int) -> None:
    goal = goal_from_steps(GRASP, to, turn, CONTROL)
    paths = list(goal.paths())
    assert len(paths) == count
    for path in paths:
        start, end = path.motion(0.0), path.motion(path.length)
        np.testing.assert_allclose(start.p_HO, GRASP.p_HO, atol=1e-12)
        np.testing.assert_allclose(start.R_HO, GRASP.R_HO, atol=1e-12)
        np.testing.assert_allclose(end.p_HO, GRASP.p_HO + to, atol=1e-12)
        np.testing.assert_allclose(end.R_HO, rotation_exp(np.array(turn)) @ GRASP.R_HO, atol=1e-12)
        assert np.linalg.norm(path.turns, axis=1).max() <= np.pi / 2.0 + 1e-9
    total = [np.linalg.norm(path.turns, axis=1).sum() for path in paths]
    size = np.linalg.norm(turn)
    assert set(np.round(total, 6)) == ({0.0} if size == 0.0 else set(np.round([size, 2.0 * np.pi - size], 6)))


def test_goal_within_reach_is_planned_without_finger_steps() -> None:
    goal = goal_from_steps(GRASP, [0.0, 0.0, 0.0], [0.0, 0.0, 0.05], CONTROL)
    plan = plan_regrasp_to(goal, RegraspSettings(budget=20.0))
    assert isinstance(plan, RegraspPlan)
    assert plan.step_count == 0
    np.testing.assert_allclose(plan.task.path.motion(plan.stages[-1].end.u).R_HO, goal.R_HO, atol=1e-9)


def test_search_tries_every_path_and_the_callback_ends_it() -> None:
    goal = goal_from_steps(GRASP, [0.0, 0.0, 0.0], [0.0, 0.0, 3.0], CONTROL)
    failure = plan_regrasp_to(goal, RegraspSettings(budget=1e-6))
    assert isinstance(failure, PlanFailure)
    assert "does not prove that there is none" in failure.reason
    lengths: list[float] = []
    stopped = plan_regrasp_to(goal, callback=lambda progress: bool(lengths.append(progress.length)))
    assert isinstance(stopped, PlanFailure)
    assert stopped.kind == STOPPED
    assert len(lengths) == 1


def test_goal_at_the_grasp_is_rejected() -> None:
    with pytest.raises(InvalidInput, match="p_HO"):
        RegraspGoal(GRASP, GRASP.p_HO, GRASP.R_HO)


@pytest.mark.parametrize("distance", [10.1, 1e18, 1e300])
def test_goal_beyond_the_largest_distance_is_rejected(distance: float) -> None:
    with pytest.raises(InvalidInput, match=r"p_HO.*at most 10 m"):
        RegraspGoal(GRASP, GRASP.p_HO + np.array([0.0, distance, 0.0]), GRASP.R_HO)


@pytest.mark.parametrize("error", [0.1, 0.3])
def test_margin_for_an_interval_of_friction_is_that_of_its_lower_end(error: float) -> None:
    task = turn_task()
    state = start_state(task)
    body, hand, path = task.grasp.body, task.grasp.hand, task.path
    lower = ContactSet.stack([replace(each, friction=(1.0 - error) * each.friction) for each in state.contacts.contacts])
    of_interval = HoldingMargin(hand, body, path, replace(CONTROL, friction_error=error), 5.0)
    of_lower_end = HoldingMargin(hand, body, path, CONTROL, 5.0)
    for name in state.fingers:
        margin = of_interval.find_without(state, name)
        assert margin == pytest.approx(of_lower_end.find_without(replace(state, contacts=lower), name), abs=1e-6)
        assert margin < of_lower_end.find_without(state, name)
