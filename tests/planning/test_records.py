"""Records of planning: exact round trips of moves, tasks and results, and their short texts."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.plan_requests import assert_same_plan, hand, moves, unreachable_move
from support.planning_cases import AXES, block, straight_move

from graspforce import InvalidInput
from graspforce.planning import (
    FingerTask,
    FreeMove,
    GraspTask,
    IdealTask,
    PathMove,
    Plan,
    PlanFailure,
    PlanSettings,
    Progress,
    StraightPath,
    WorkspaceBounds,
    move_from_dict,
    plan_along,
)
from graspforce.planning.task import task_from_dict

POSES = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]), np.array([AXES, AXES])


def as_json(record: object) -> object:
    """Return a record after it was written as JSON and read again."""
    return json.loads(json.dumps(record, allow_nan=False))


@pytest.mark.parametrize("kind", ["path", "spline", "free", "fingers", "postures"])
def test_move_is_planned_equally_after_a_round_trip(kind: str) -> None:
    move = moves()[kind]
    loaded = move_from_dict(as_json(move.to_dict()), hand())
    assert loaded.to_dict() == move.to_dict()
    assert_same_plan(loaded.plan(), move.plan())


@pytest.mark.parametrize("kind", [PathMove, FreeMove])
def test_move_of_ideal_fingers_is_planned_equally_after_a_round_trip(kind: type[PathMove | FreeMove]) -> None:
    move = kind(block(slip_margin=0.1), *POSES, intervals=10)
    loaded = kind.from_dict(as_json(move.to_dict()), None)
    assert isinstance(loaded.task, IdealTask)
    assert loaded.to_dict() == move.to_dict()
    assert_same_plan(loaded.plan(), move.plan())


def test_task_is_read_as_its_own_kind() -> None:
    grasp, fingers = moves()["path"].task, moves()["fingers"].task
    assert isinstance(task_from_dict(as_json(grasp.to_dict()), hand()), GraspTask)
    assert isinstance(task_from_dict(as_json(fingers.to_dict()), hand()), FingerTask)
    assert isinstance(task_from_dict(as_json(block().to_dict()), None), IdealTask)
    with pytest.raises(InvalidInput) as caught:
        task_from_dict({**grasp.to_dict(), "slip_margin": -1.0}, hand(), "task")
    assert caught.value.field == "task.slip_margin"


def test_failure_and_progress_survive_a_round_trip() -> None:
    for failure in (unreachable_move().plan(), plan_along(block(mass=0.6), straight_move(0.0, 0.0, 1.0))):
        assert isinstance(failure, PlanFailure)
        assert PlanFailure.from_dict(as_json(failure.to_dict())).to_dict() == failure.to_dict()
    progress = Progress("search", 0.4, 7, 0.031, 0.2)
    assert Progress.from_dict(as_json(progress.to_dict())).to_dict() == progress.to_dict()
    with pytest.raises(InvalidInput, match="stage"):
        Progress.from_dict({**progress.to_dict(), "stage": "thinking"})


def test_records_print_as_short_texts() -> None:
    plan = plan_along(block(), straight_move(0.0, 0.0, 1.0), settings=PlanSettings(intervals=20))
    assert isinstance(plan, Plan)
    assert repr(plan) == "<Plan: 91.30 ms, 21 knots, verified. IdealTask: 2 contacts, 0.1 kg>"
    assert str(plan).splitlines()[0] == repr(plan)[1:-1]
    assert "friction" in str(plan)
    assert plan._repr_html_().startswith("<table>")
    assert repr(plan.knots) == "<Trajectory: 21 states from 0 to 0.0913 s>"
    assert repr(moves()["fingers"].task) == "<FingerTask: four_finger>"
    failure = plan_along(block(mass=0.6), straight_move(0.0, 0.0, 1.0))
    assert isinstance(failure, PlanFailure)
    assert str(failure) == failure.reason
    assert repr(failure).startswith("<PlanFailure: unholdable. At the start")


@pytest.mark.parametrize(
    ("bounds", "field"),
    [
        ({"lower": [0.0, 0.0]}, "lower"),
        ({"upper": [0.0, np.nan, 0.0]}, "upper[1]"),
        ({"lower": [0.0, 0.0, 0.0], "upper": [1.0, 1.0, -1.0]}, "lower"),
        ({"turn": -0.1}, "turn"),
    ],
)
def test_invalid_workspace_names_its_field(bounds: dict[str, object], field: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        WorkspaceBounds(**bounds)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_workspace_without_bounds_contains_every_move() -> None:
    assert WorkspaceBounds().to_dict() == {"lower": [None] * 3, "upper": [None] * 3, "turn": None}
    far = StraightPath(np.zeros(3), AXES, [1e3, 0.0, 0.0], AXES)
    assert WorkspaceBounds().contains(far)
    assert not WorkspaceBounds(upper=[1.0, None, None]).contains(far)


@pytest.mark.parametrize(
    "settings",
    [{"intervals": 1}, {"intervals": 2.0}, {"intervals": 10_001}, {"tolerance": 0.0}, {"tolerance": np.nan}, {"budget": -1.0}],
)
def test_invalid_settings_name_their_field(settings: dict[str, float]) -> None:
    (field,) = settings
    with pytest.raises(InvalidInput) as caught:
        PlanSettings(**settings)  # type: ignore[arg-type]
    assert caught.value.field == field
    if field != "budget":
        with pytest.raises(InvalidInput) as caught:
            PathMove(block(), *POSES, **settings)  # type: ignore[arg-type]
        assert caught.value.field == field
