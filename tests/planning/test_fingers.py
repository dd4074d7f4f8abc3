"""Free moves of fingers alone: clearances, obstacles, and fingers at rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import load

from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.planning.failure import UNREACHABLE, UNSOLVED, PlanFailure
from graspforce.planning.fingers.plan_fingers import plan_fingers
from graspforce.planning.moves.fingers_move import FingersMove
from graspforce.planning.path.paths import JointPath
from graspforce.planning.path.plan_along import plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask


def test_fingers_are_never_slower_than_straight_and_others_do_not_move() -> None:
    hand = load("allegro_right")
    rng = np.random.default_rng(1)
    part = rng.uniform(0.3, 0.7, size=(2, hand.n))
    q_start, q_goal = hand.q_lower + part * (hand.q_upper - hand.q_lower)
    still = list(hand.finger("middle").joints)
    q_goal[still] = q_start[still]
    along = plan_fingers_along(
        FingerTask(hand, collisions=None), JointPath.through([q_start, q_goal]), settings=PlanSettings(intervals=30)
    )
    free = plan_fingers(FingerTask(hand, collisions=None), q_start, q_goal, settings=PlanSettings(intervals=30))
    assert isinstance(free, Plan)
    assert isinstance(along, Plan)
    assert free.check.verified
    assert free.duration <= along.duration
    assert np.ptp(free.knots.q[:, still], axis=0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("kind", ["sphere", "box", "cylinder"])
def test_fingertip_avoids_an_obstacle(kind: str) -> None:
    hand = load("four_finger")
    q_start = hand.neutral.copy()
    joints = list(hand.finger("finger_1").joints)
    q_goal = q_start.copy()
    q_start[joints[0]], q_goal[joints[0]] = -0.4, 0.4
    q_start[joints[1:]] = q_goal[joints[1:]] = 0.3
    straight = plan_fingers(FingerTask(hand, collisions=None), q_start, q_goal, settings=PlanSettings(intervals=30))
    assert isinstance(straight, Plan)
    middle, _ = hand.tips_along(straight.at([straight.duration / 2]).q, ["finger_1"])
    shape = {"sphere": Sphere(0.002), "box": Box([0.004, 0.003, 0.005]), "cylinder": Cylinder(0.002, 0.004)}[kind]
    turned = Rotation.from_rotvec([0.2, 0.1, 0.3]).as_matrix()
    obstacle = Obstacle(shape, middle[0, 0] + np.array([0.0, 0.0, 0.004]), turned)
    detour = plan_fingers(
        FingerTask(hand, collisions=None), q_start, q_goal, settings=PlanSettings(intervals=30), obstacles=[obstacle]
    )
    assert isinstance(detour, Plan)
    assert detour.check.verified
    tips, _ = hand.tips_along(detour.at(np.linspace(0, detour.duration, 301)).q, ["finger_1"])
    radius = hand.finger("finger_1").tip_radius
    assert radius is not None
    distance = obstacle.distance(tips[:, 0])
    assert distance.min() > radius - 2e-5
    p_straight, _ = hand.tips_along(straight.at(np.linspace(0, straight.duration, 301)).q, ["finger_1"])
    assert obstacle.distance(p_straight[:, 0]).min() < radius - 1e-3  # m: the straight line meets the obstacle
    assert (
        straight.duration * (1.0 - 1e-3) < detour.duration < 1.2 * straight.duration
    )  # the other joints avoid it in nearly the same time
    blocked = plan_fingers(FingerTask(hand, collisions=None), q_start, q_goal, obstacles=[Obstacle(shape, tips[-1, 0])])
    assert isinstance(blocked, PlanFailure)
    assert blocked.kind == UNREACHABLE
    assert blocked.reason.startswith("At the goal, the clearance between the tip of finger_1 and obstacles[0]")


def test_spline_through_postures_keeps_its_clearances_or_is_refused() -> None:
    """An obstacle on the spline between two via postures is found; a given posture too near to it is named."""
    hand, radius = load("four_finger"), 0.002
    postures = np.tile(hand.neutral, (3, 1))
    swing = hand.finger("finger_1").joints[0]
    postures[:, swing] += -0.1, 0.0, 0.1
    postures[1, hand.finger("finger_1").joints[1]] += 0.1
    task = FingerTask(hand, collisions=None)
    clear = FingersMove(task, postures, intervals=20).plan()
    assert isinstance(clear, Plan)
    on_the_way = hand.tip_pose(clear.at([0.25 * clear.duration]).q[0], "finger_1")[0]
    blocked = FingersMove(task, postures, obstacles=[Obstacle(Sphere(radius), on_the_way)], intervals=20).plan()
    assert isinstance(blocked, PlanFailure)
    assert blocked.kind == UNSOLVED
    assert "between the tip of finger_1 and obstacles[0]" in blocked.reason
    far = Obstacle(Sphere(radius), on_the_way - [0.0, 0.0, 0.1])
    kept = FingersMove(task, postures, 0.001, [far], intervals=20).plan()
    assert isinstance(kept, Plan)
    assert kept.duration == pytest.approx(clear.duration, rel=1e-9)
    at_via = FingersMove(task, postures, obstacles=[Obstacle(Sphere(radius), hand.tip_pose(postures[1], "finger_1")[0])]).plan()
    assert isinstance(at_via, PlanFailure)
    assert at_via.kind == UNREACHABLE
    assert at_via.reason.startswith("At posture 1, the clearance between the tip of finger_1 and obstacles[0]")


def test_finger_regrasps_around_an_edge() -> None:
    """From one face of a held box to the next; the straight line passes through the edge."""
    hand = load("four_finger")
    radius = hand.finger("finger_1").tip_radius
    assert radius is not None
    q = [hand.neutral, hand.neutral.copy()]
    q[1][list(hand.finger("finger_1").joints[:2])] += (0.065, 0.05)
    above, beside = (hand.tip_pose(each, "finger_1")[0] for each in q)
    edge = 0.02  # m
    middle = np.array([above[0], beside[1], above[2]]) - np.array([0.0, edge / 2 + radius, edge / 2 + radius])
    obstacle = Obstacle(Box([3 * edge, edge, edge]), middle)
    plan = plan_fingers(FingerTask(hand, collisions=None), q[0], q[1], obstacles=[obstacle])
    assert isinstance(plan, Plan)
    tips, _ = hand.tips_along(plan.at(np.linspace(0, plan.duration, 301)).q, ["finger_1"])
    distance = obstacle.distance(tips[:, 0])
    assert distance[[0, -1]] == pytest.approx(radius, abs=1e-9)  # contact at both ends
    assert plan.knots.q[[0, -1]] == pytest.approx(np.array(q), abs=1e-9)
    assert distance.min() > radius - 2e-5
    assert plan.check.verified
    straight = plan_fingers(FingerTask(hand, collisions=None), q[0], q[1])
    assert isinstance(straight, Plan)
    p_straight, _ = hand.tips_along(straight.at(np.linspace(0, straight.duration, 301)).q, ["finger_1"])
    assert obstacle.distance(p_straight[:, 0]).min() < radius - 1e-4  # m: the straight line passes through the box
