"""Progress callbacks and budgets: progress is monotonic, a stop is obeyed, and the best checked plan so far is returned."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import pytest
from support.hands import load
from support.planning_cases import DISTANCE, block, straight_move

from graspforce import InvalidInput
from graspforce.geometry import Sphere
from graspforce.planning import (
    FingerTask,
    Obstacle,
    Plan,
    PlanFailure,
    PlanSettings,
    Progress,
    plan_along,
    plan_fingers,
    plan_free,
)
from graspforce.planning.failure import STOPPED
from graspforce.planning.progress import CHECK, EQUATIONS, JOINT_PATH, PATH, SEARCH

ENDS = (np.array([[0.0, 0.0, 0.0], DISTANCE * np.array([0.8, 0.0, 0.6])]), np.tile(np.eye(3), (2, 1, 1)))
HAND = load("allegro_right")
BENT_JOINTS = HAND.neutral + np.where(np.arange(HAND.n) < 4, 0.2, 0.0)  # rad: one finger moves

ALONG = partial(plan_along, block(), straight_move(0.8, 0.0, 0.6), settings=PlanSettings(intervals=20))
FREE = partial(plan_free, block(), *ENDS, settings=PlanSettings(intervals=12))
FINGERS = partial(plan_fingers, FingerTask(HAND), HAND.neutral, BENT_JOINTS, settings=PlanSettings(intervals=12))
EACH = pytest.mark.parametrize("plan", [ALONG, FREE, FINGERS], ids=["along", "free", "fingers"])


class Recorder:
    """A callback that records all progress, and returns False at the call of a given number."""

    def __init__(self, stop: int | None = None) -> None:
        self.seen: list[Progress] = []
        self._stop = stop

    def __call__(self, now: Progress) -> bool:
        self.seen.append(now)
        return len(self.seen) - 1 != self._stop


@EACH
def test_progress_is_monotonic_and_ends_with_the_plan(plan) -> None:  # type: ignore[no-untyped-def]
    recorder = Recorder()
    found = plan(callback=recorder)
    assert isinstance(found, Plan)
    assert not found.stopped
    for before, after in itertools.pairwise(recorder.seen):
        assert 0.0 <= before.fraction <= after.fraction <= 1.0
        assert before.seconds <= after.seconds
        assert before.best is None or (after.best is not None and after.best <= before.best)
    assert (recorder.seen[0].stage, recorder.seen[0].best) == (JOINT_PATH, None)
    assert recorder.seen[-1].stage == CHECK
    best = recorder.seen[-1].best
    assert best is not None
    assert found.duration <= best


@pytest.mark.parametrize("plan", [FREE, FINGERS], ids=["free", "fingers"])
def test_search_reports_its_stages_and_iterations(plan) -> None:  # type: ignore[no-untyped-def]
    recorder = Recorder()
    found = plan(callback=recorder)
    stages = [stage for stage, _ in itertools.groupby(now.stage for now in recorder.seen)]
    assert stages == [JOINT_PATH, PATH, EQUATIONS, SEARCH, CHECK]
    counted = [now.iteration for now in recorder.seen if now.stage == SEARCH]
    assert counted == [0, *range(len(counted) - 1)]  # the first call is that of the stage
    assert len(counted) - 1 in (
        found.statistics.iterations,
        found.statistics.iterations + 1,
    )  # the solver may end without a callback


@EACH
def test_zero_budget_gives_a_failure_that_names_it(plan) -> None:  # type: ignore[no-untyped-def]
    failure = plan(settings=PlanSettings(budget=0.0))
    assert isinstance(failure, PlanFailure)
    assert failure.kind == STOPPED
    assert failure.reason == "The budget of 0 s ended before there was a first plan."
    for budget in (-1.0, np.nan):
        with pytest.raises(InvalidInput, match="budget"):
            plan(settings=PlanSettings(budget=budget))


@EACH
def test_stop_at_any_call_returns_the_best_checked_plan(plan) -> None:  # type: ignore[no-untyped-def]
    complete = Recorder()
    fastest = plan(callback=complete).duration
    for stop in sorted({*range(0, len(complete.seen) - 1, 3), 1, len(complete.seen) - 2}):
        recorder = Recorder(stop)
        found = plan(callback=recorder)
        assert len(recorder.seen) == stop + 1  # no call after the stop
        if recorder.seen[-1].best is None:
            assert isinstance(found, PlanFailure)
            assert found.kind == STOPPED
            assert found.reason == "Planning was stopped before there was a first plan."
        else:
            assert isinstance(found, Plan)
            assert found.check.verified
            assert found.stopped
            assert fastest * (1.0 - 1e-3) <= found.duration <= recorder.seen[-1].best  # limits hold to 1e-3


@EACH
def test_callback_that_returns_nothing_does_not_stop(plan) -> None:  # type: ignore[no-untyped-def]
    seen: list[Progress] = []
    found = plan(callback=seen.append)
    assert not found.stopped
    assert seen
    stopped = plan(callback=lambda now: np.bool_(False))
    assert stopped.kind == STOPPED


def test_stop_after_the_straight_path_returns_its_plan() -> None:
    found = FREE(callback=lambda now: now.best is None)
    along = plan_along(block(), straight_move(0.8, 0.0, 0.6), settings=PlanSettings(intervals=12))
    assert isinstance(found, Plan)
    assert isinstance(along, Plan)
    np.testing.assert_array_equal(found.knots.times, along.knots.times)
    np.testing.assert_array_equal(found.knots.f, along.knots.f)


@EACH
def test_exception_in_a_callback_is_raised_and_the_next_call_succeeds(plan) -> None:  # type: ignore[no-untyped-def]
    for stage in (JOINT_PATH, PATH, EQUATIONS, SEARCH, CHECK):
        if plan is ALONG and stage in (EQUATIONS, SEARCH):
            continue

        def callback(now: Progress, stage: str = stage) -> bool:
            if now.stage == stage and (now.iteration >= 2 or stage != SEARCH):
                raise ZeroDivisionError(stage)
            return True

        with pytest.raises(ZeroDivisionError, match=stage):
            plan(callback=callback)
    assert plan().found


def test_stopped_search_never_returns_a_straight_path_through_an_obstacle() -> None:
    straight = FINGERS()
    tips, _ = HAND.tips_along(straight.at([straight.duration / 2.0]).q, [HAND.fingers[0].name])
    obstacle = Obstacle(Sphere(0.002), tips[0, 0])
    stopped = FINGERS(obstacles=[obstacle], callback=lambda now: now.stage != SEARCH)
    assert isinstance(stopped, PlanFailure)
    assert stopped.kind == STOPPED
