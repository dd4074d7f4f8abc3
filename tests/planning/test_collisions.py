"""Collisions in plans: links, object and obstacles keep apart between knots, or the refusal names them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from support.hands import load

from graspforce.core.arrays import Array
from graspforce.geometry import Box, Cylinder, Solid, Sphere
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
from graspforce.planning.separation import separation_equations
from graspforce.planning.settings import PlanSettings

SETTINGS = PlanSettings(intervals=20)


@lru_cache
def ball_grasp(seed: int = 0) -> Grasp:
    return find_grasp(load("four_finger"), Body.solid(Sphere(0.03), mass=0.05), friction=0.7, seed=seed)


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


def test_fingers_that_would_meet_go_round_one_another() -> None:
    """Random moves whose straight path collides by more than 2 mm, with both ends free: the search finds other paths."""
    hand = load("four_finger")
    rng = np.random.default_rng(0)
    scene = scene_of_task(FingerTask(hand))
    assert scene is not None
    blocked = []
    while len(blocked) < 2:
        q = rng.uniform(hand.q_lower, hand.q_upper, (2, hand.n))
        along = scene.least_gap_along(q[0] + np.linspace(0.0, 1.0, 101)[:, None] * (q[1] - q[0]))
        ends = [scene.least_gap(each) for each in q]
        if along is not None and along.gap.distance < -2e-3 and all(gap is not None and gap.distance > 1e-3 for gap in ends):
            blocked.append(q)
    for q in blocked:
        plan = plan_fingers(FingerTask(hand), q[0], q[1], settings=PlanSettings(intervals=20, budget=300.0))
        assert isinstance(plan, Plan)
        assert plan.check.verified
        collision = HandCollision(hand)
        times = np.linspace(0.0, plan.duration, 200)
        assert min(collision.link_gaps(each)[0].distance for each in plan.at(times).q) > -2e-5


def test_object_goes_round_an_obstacle_that_no_joint_moves() -> None:
    """A small ball below the path: the free plan without checks cuts through it, the one with checks does not."""
    grasp = ball_grasp(1)
    ball = Obstacle(Sphere(0.004), grasp.p_HO - np.array([0.0, 0.0, 0.0343]))
    p_HO, R_HO = grasp.p_HO + np.array([[-0.005, 0.0, 0.0], [0.005, 0.0, 0.0]]), np.array([grasp.R_HO, grasp.R_HO])
    task = task_of(grasp, CollisionSettings(obstacles=[ball]))
    least = []
    for each in (task, replace(task, collisions=None)):
        plan = plan_free(each, p_HO, R_HO, grasp.q, settings=PlanSettings(intervals=40, budget=300.0))
        assert isinstance(plan, Plan)
        at = plan.at(np.linspace(0.0, plan.duration, 500))
        least.append(float(np.linalg.norm(at.p_HO - ball.p_HO, axis=1).min()) - 0.034)
    assert least[0] > -1e-5
    assert least[1] < -1e-3


@pytest.mark.parametrize("kind", [Sphere, Cylinder, Box])
def test_separation_equations_agree_with_distances(kind: type[Solid]) -> None:
    """At the required distance beside a face the level is 1; below it, less."""
    hand = load("four_finger")
    name = hand.fingers[0].name
    link = hand.tree().tips[0].link
    e = separation_equations(hand, (name, link), ("fixed", -1), kind)
    tip = hand.tip_pose(hand.neutral, name)[0]
    sizes = {Sphere: [0.01], Cylinder: [0.01, 0.02], Box: [0.01, 0.02, 0.03]}[kind]
    q = hand.neutral[list(hand.finger(name).joints)]
    for extra, sign in ((1e-4, 1.0), (-1e-4, -1.0)):
        middle = tip + np.array([0.01 + 0.008 + extra, 0.0, 0.0])
        numbers = np.concatenate([np.ones(len(q)), hand.tree().tips[0].p_LF, middle, np.eye(3).ravel(), sizes, [0.008]])
        assert sign * (float(e.value(q, numbers)) - 1.0) > 0.0


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
