"""Collisions in plans: links, object and obstacles keep apart between knots, or the refusal names them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from support.hands import load

from graspforce.core.arrays import Array
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.collision import HandCollision
from graspforce.planning import (
    FingerTask,
    GraspTask,
    Plan,
    PlanFailure,
    StraightPath,
    plan_along,
    plan_fingers,
    plan_free,
)
from graspforce.planning.collisions import least_gap_of_plan, plan_collision, scene_of_task
from graspforce.planning.failure import COLLISION
from graspforce.planning.settings import PlanSettings

SETTINGS = PlanSettings(intervals=20)


@lru_cache
def ball_grasp() -> Grasp:
    return find_grasp(load("four_finger"), Body.solid(Sphere(0.03), mass=0.05), friction=0.7)


def task_of(grasp: Grasp, settings: CollisionSettings | None = None) -> GraspTask:
    """Return the task of a grasp with collision checks."""
    return GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers, collisions=settings or CollisionSettings())


def straight(grasp: Grasp, offset: tuple[float, float, float]) -> StraightPath:
    return StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.array(offset), grasp.R_HO)


def palm_distance(grasp: Grasp, p_HO: Array) -> float:
    """Return the distance of the ball from the palm's collision shape, m."""
    gaps = HandCollision(grasp.hand).object_gaps(grasp.q, grasp.body.shape, p_HO, grasp.R_HO)  # type: ignore[arg-type]
    return next(gap.distance for gap in gaps if gap.first == "palm")


def test_ball_pushed_into_the_palm_is_refused_with_both_names_place_and_instant() -> None:
    grasp = ball_grasp()
    path = straight(grasp, (0.0, 0.0, -0.03))
    failure = plan_along(task_of(grasp), path, grasp.q, settings=SETTINGS)
    assert isinstance(failure, PlanFailure)
    assert (failure.kind, failure.links, failure.s) == (COLLISION, ("palm", "object"), 1.0)
    assert failure.reason.startswith("At the goal, palm and the object overlap by ")
    depth = -palm_distance(grasp, grasp.p_HO - np.array([0.0, 0.0, 0.03]))
    assert f"overlap by {1e3 * depth:.2g} mm" in failure.reason
    assert failure.point is not None
    assert np.linalg.norm(np.array(failure.point) - (grasp.p_HO - [0.0, 0.0, 0.03])) < 0.03  # inside the ball
    assert isinstance(plan_along(replace(task_of(grasp), collisions=None), path, grasp.q, settings=SETTINGS), Plan)


def test_free_planner_refuses_a_goal_inside_the_palm() -> None:
    grasp = ball_grasp()
    p_HO = np.array([grasp.p_HO, grasp.p_HO - np.array([0.0, 0.0, 0.03])])
    failure = plan_free(task_of(grasp), p_HO, np.array([grasp.R_HO, grasp.R_HO]), grasp.q, settings=SETTINGS)
    assert isinstance(failure, PlanFailure)
    assert (failure.kind, failure.links) == (COLLISION, ("palm", "object"))


def test_plan_beside_an_obstacle_keeps_its_margin_or_is_refused() -> None:
    """A table 1 mm below the ball: lifting keeps half a millimetre, lowering by 4 mm does not."""
    grasp = ball_grasp()
    path = straight(grasp, (0.0, 0.0, 0.004))
    table = Obstacle(Box([0.02, 0.02, 0.01]), grasp.p_HO - np.array([0.0, 0.0, 0.03 + 0.001 + 0.005]))
    plan = plan_along(task_of(grasp, CollisionSettings(0.0005, [table])), path, grasp.q, settings=SETTINGS)
    assert isinstance(plan, Plan)
    scene = scene_of_task(plan.task)
    assert scene is not None
    assert plan_collision(scene, plan) is None
    least = least_gap_of_plan(scene, plan)
    assert least is not None
    assert 0.0 < least.gap.distance <= 0.001 + 1e-6
    lower = straight(grasp, (0.0, 0.0, -0.004))
    failure = plan_along(task_of(grasp, CollisionSettings(0.0, [table])), lower, grasp.q, settings=SETTINGS)
    assert isinstance(failure, PlanFailure)
    assert (failure.links, failure.s) == (("object", "obstacles[0]"), 1.0)


def test_fingers_that_meet_in_the_middle_of_their_path_are_refused_or_go_round() -> None:
    """Two fingers exchange their sides; at both ends they are apart."""
    hand = load("four_finger")
    rng = np.random.default_rng(0)
    scene = scene_of_task(FingerTask(hand))
    assert scene is not None
    found = 0
    for _ in range(200):
        q = rng.uniform(hand.q_lower, hand.q_upper, (2, hand.n))
        apart = [scene.least_gap(each) for each in q]
        if any(gap is None or gap.distance < 1e-3 for gap in apart):
            continue
        middle = scene.least_gap_along(q[0] + np.linspace(0.0, 1.0, 101)[:, None] * (q[1] - q[0]))
        if middle is None or middle.gap.distance > -2e-3:
            continue
        answer = plan_fingers(FingerTask(hand), q[0], q[1], settings=PlanSettings(intervals=20, budget=10.0))
        if isinstance(answer, PlanFailure):
            assert answer.links is not None
            assert answer.reason.startswith("No motion without collision was found")
        else:
            assert plan_collision(scene, answer) is None
        found += 1
        if found == 2:
            break
    assert found == 2


def test_failure_with_links_is_saved_and_loaded() -> None:
    failure = PlanFailure(COLLISION, "Two links meet.", 0.5, links=("palm", "object"), point=(0.0, 0.1, 0.2))
    again = PlanFailure.from_dict(failure.to_dict())
    assert (again.links, again.point, again.s) == (failure.links, failure.point, failure.s)


def test_tasks_with_collision_settings_are_saved_and_loaded() -> None:
    hand = load("four_finger")
    settings = CollisionSettings(0.002, [Obstacle(Sphere(0.01), [0.1, 0.0, 0.0])])
    again = FingerTask.from_dict(FingerTask(hand, collisions=settings).to_dict(), hand)
    assert again.collisions is not None
    assert again.collisions.to_dict() == settings.to_dict()
    assert FingerTask.from_dict(FingerTask(hand, collisions=None).to_dict(), hand).collisions is None


@pytest.mark.parametrize("margin", [-1e-3, np.nan])
def test_settings_reject_a_negative_margin(margin: float) -> None:
    with pytest.raises(ValueError, match="margin"):
        CollisionSettings(margin)
