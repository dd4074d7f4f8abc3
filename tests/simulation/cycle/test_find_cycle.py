"""Which of several grasps `find_cycle` chooses: the first that misses no face, or the one that misses faces at fewest poses."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from graspforce.core.errors import InvalidInput
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand
from graspforce.simulation.cycle import plan_cycle
from tests.support.table_scenes import ball_scene

FAULT = "a grasp with room around it"
MORE = 8  # seeds after the first that allows a cycle


def chosen(monkeypatch: pytest.MonkeyPatch, missed: list[int | None]) -> tuple[int, list[str]]:
    """Return which grasp is chosen, and what `on_seed` was told.

    Args:
        monkeypatch: of pytest.
        missed: for each seed the number of poses at which a face is missed; None for a grasp that allows no cycle. The last
            value repeats.
    """
    number = itertools.count()
    plan = plan_cycle.plan_cycle(ball_scene())
    plans: list[object] = []

    def next_plan(*arguments: object) -> object:
        count = missed[min(next(number), len(missed) - 1)]
        if count is None:
            plans.append(None)
            raise InvalidInput("scene", "a grasp", FAULT)
        plans.append(replace(plan))
        return plans[-1]

    def count_of(*arguments: object) -> int:
        count = missed[min(len(plans) - 1, len(missed) - 1)]
        assert count is not None
        return count

    monkeypatch.setattr(plan_cycle, "find_table_grasp", lambda *arguments, **options: ball_scene())
    monkeypatch.setattr(plan_cycle, "plan_cycle", next_plan)
    monkeypatch.setattr(plan_cycle, "count_missed_faces", count_of)
    told: list[str] = []
    hand = Hand.load("allegro_right")
    _, found = plan_cycle.find_cycle(hand, Body.solid(Sphere(0.03), 0.1), on_seed=lambda seed, text: told.append(text))
    return next(i for i, each in enumerate(plans) if each is found), told


def test_first_grasp_that_misses_no_face_is_chosen(monkeypatch):
    index, told = chosen(monkeypatch, [None, 3, 0, 0])
    assert index == 2
    assert [bool(text) for text in told] == [True, True, False]


def test_without_such_a_grasp_the_one_that_misses_least_is_chosen(monkeypatch):
    index, told = chosen(monkeypatch, [None, 5, 4, None, 1, 2, 1, 6])
    assert index == 4
    assert len(told) == 2 + MORE


def test_object_without_a_grasp_that_allows_a_cycle_is_refused(monkeypatch):
    with pytest.raises(InvalidInput, match=FAULT):
        chosen(monkeypatch, [None])
