"""Regrasp tasks, plans and their refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.regrasp_plans import plan_with_one_step, turn_task

from graspforce.core.errors import InvalidInput
from graspforce.planning import PlanFailure
from graspforce.planning.regrasp import ObjectStage, PosePath, RegraspPlan, RegraspSettings, RegraspTask, plan_regrasp


def test_short_turn_needs_no_finger_step() -> None:
    plan = plan_regrasp(turn_task(0.05))
    assert isinstance(plan, RegraspPlan)
    assert plan.step_count == 0
    assert plan.stages[-1].end.u == pytest.approx(0.05)
    assert plan.margin >= 1.2 * plan.task.control.slip_margin * (1.0 - 1e-6)


def test_search_without_time_is_refused_with_the_share_of_the_path() -> None:
    failure = plan_regrasp(turn_task(6.0), RegraspSettings(budget=1e-6))
    assert isinstance(failure, PlanFailure)
    assert "does not prove that there is none" in failure.reason
    assert failure.s is not None
    assert 0.0 <= failure.s < 1.0


def test_callback_ends_the_search() -> None:
    seen = []
    failure = plan_regrasp(turn_task(6.0), callback=lambda progress: seen.append(progress) or False)
    assert isinstance(failure, PlanFailure)
    assert len(seen) == 1
    assert seen[0].length == pytest.approx(6.0)


def test_stages_of_a_found_plan_join() -> None:
    """Each stage begins where the one before ends; objects move forward, and finger steps end at their contact."""
    plan = plan_with_one_step()
    q, u = plan.task.grasp.q, 0.0
    for stage in plan.stages:
        first = stage.states[0].q if isinstance(stage, ObjectStage) else stage.postures[0]
        np.testing.assert_allclose(first, q, atol=1e-9)
        q, u = stage.end.q, stage.end.u
    assert u == plan.task.path.length
    assert "1 finger steps" in str(plan)


def test_invalid_tasks_and_settings_are_refused_by_field() -> None:
    task = turn_task()
    grasp = task.grasp
    elsewhere = PosePath.turn(grasp.p_HO + 0.01, grasp.R_HO, [0.0, 0.0, 1.0], 1.0)
    with pytest.raises(InvalidInput, match=r"path\.p_HO"):
        RegraspTask(grasp, elsewhere)
    with pytest.raises(InvalidInput, match="shape"):
        RegraspTask(replace(grasp, body=replace(grasp.body, shape=None)), task.path)
    for wrong in (
        {"margin": -1.0},
        {"advance": 0.0},
        {"candidates": 0},
        {"budget": np.nan},
        {"seed": -1},
        {"object_rate": "x"},
    ):
        with pytest.raises(InvalidInput, match=next(iter(wrong))):
            RegraspSettings(**wrong)
