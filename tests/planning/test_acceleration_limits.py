"""Limits of accelerations: they hold everywhere, shorten nothing, and give known durations where nothing else limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.planning_cases import AXES, DISTANCE, block, disc, straight_move
from support.tracked_moves import MOVES, find_move_grasp

from graspforce import InvalidInput
from graspforce.control import ControlSettings
from graspforce.hand.hand import Hand
from graspforce.planning import (
    AccelerationLimits,
    FingersMove,
    FingerTask,
    IdealTask,
    JointPath,
    PathMove,
    Plan,
    PlanSettings,
    SplinePath,
    move_from_dict,
    plan_along,
    plan_fingers,
    plan_fingers_along,
    plan_free,
    tracking,
)

FORCE = 1e3  # N: so large that forces do not limit
_SETTINGS = PlanSettings(intervals=40)
_GRID = 0.02  # relative: a step in acceleration takes an interval of the path's grid


def strong_block(**limits: float) -> IdealTask:
    return replace(block(largest=FORCE), acceleration_limits=AccelerationLimits(**limits))


def largest(plan: Plan) -> tuple[float, float, float]:
    """Return the largest accelerations by difference quotients of the velocities, which the check does not use."""
    times = np.linspace(0.0, plan.duration, 4001)
    at = plan.at(times)
    step = times[1]
    linear, angular = (
        np.linalg.norm(np.diff(part, axis=0), axis=1).max(initial=0.0) / step for part in np.split(at.twist, 2, axis=1)
    )
    joints = np.abs(np.diff(at.v, axis=0)).max(initial=0.0) / step
    return float(linear), float(angular), float(joints)


@pytest.mark.parametrize("limit", [0.5, 50.0])
def test_straight_move_takes_twice_the_root_of_distance_over_acceleration(limit: float) -> None:
    """Rest to rest with ‖p̈‖ ≤ a alone: T = 2 √(d/a)."""
    task, path = strong_block(linear=limit), straight_move(1.0, 0.0, 0.0)
    expected = 2.0 * np.sqrt(DISTANCE / limit)
    ends = path.points(np.array([0.0, 1.0]))
    for plan in (plan_along(task, path), plan_free(task, ends.p, ends.R, settings=_SETTINGS)):
        assert isinstance(plan, Plan)
        assert plan.duration == pytest.approx(expected, rel=_GRID)
        assert plan.duration > expected * (1.0 - 2e-3)
        assert largest(plan)[0] <= limit * (1.0 + 2e-3)


def test_rotation_takes_twice_the_root_of_angle_over_acceleration() -> None:
    """A turn by 1 rad from rest to rest with ‖α‖ ≤ a alone: T = 2 √(1/a)."""
    task, path = disc()
    task, ends = replace(task, acceleration_limits=AccelerationLimits(angular=3.0)), path.points(np.array([0.0, 1.0]))
    for plan in (plan_along(task, path), plan_free(task, ends.p, ends.R, settings=_SETTINGS)):
        assert isinstance(plan, Plan)
        assert plan.duration == pytest.approx(2.0 / np.sqrt(3.0), rel=_GRID)
        assert largest(plan)[1] <= 3.0 * (1.0 + 2e-3)


def test_limits_hold_between_knots_of_a_curved_path() -> None:
    """Along a spline both terms, p' s̈ and p'' ṡ², count."""
    p = np.array([[0.0, 0.0, 0.0], [0.03, 0.02, 0.0], [0.06, -0.02, 0.01], [0.1, 0.0, 0.0]])
    turns = np.repeat(AXES[None], len(p), axis=0)
    plans = [plan_along(strong_block(linear=a), SplinePath.through(p, turns)) for a in (2.0, 4.0)]
    for plan, limit in zip(plans, (2.0, 4.0), strict=True):
        assert isinstance(plan, Plan)
        assert largest(plan)[0] <= limit * (1.0 + 2e-3)
    slow, fast = plans
    assert slow.duration / fast.duration == pytest.approx(np.sqrt(2.0), rel=2e-3)  # time scales with the root


def test_fingers_alone_keep_their_limit() -> None:
    """One joint that turns by d: T = 2 √(d/a)."""
    hand = Hand.load("allegro_right")
    goal = np.array(hand.neutral)
    goal[1] += 0.3
    task = FingerTask(hand, acceleration_limits=AccelerationLimits(joints=10.0))
    along = plan_fingers_along(task, JointPath.through([hand.neutral, goal]))
    for plan in (along, plan_fingers(task, hand.neutral, goal, settings=_SETTINGS)):
        assert isinstance(plan, Plan)
        assert plan.duration == pytest.approx(2.0 * np.sqrt(0.3 / 10.0), rel=_GRID)
        assert largest(plan)[2] <= 10.0 * (1.0 + 2e-3)


@pytest.mark.parametrize("method", ["path", "free"])
def test_larger_limits_never_lengthen_a_move_of_a_hand(method: str) -> None:
    grasp = find_move_grasp("allegro_right")
    to, _ = MOVES["allegro_right"]
    p, R = np.array([grasp.p_HO, grasp.p_HO + to]), np.array([grasp.R_HO, grasp.R_HO])
    free_task = tracking.object_task(grasp, ControlSettings(slip_margin=1.0))
    durations = []
    for factor in (1.0, 2.0, np.inf) if method == "path" else (1.0, np.inf):
        limits = AccelerationLimits(linear=1.0 * factor, angular=20.0 * factor, joints=40.0 * factor)
        task = replace(free_task, acceleration_limits=limits)
        if method == "path":
            plan = PathMove(task, p, R, q_start=grasp.q, intervals=60).plan()
        else:
            plan = plan_free(task, p, R, grasp.q, settings=PlanSettings(intervals=16))
        assert isinstance(plan, Plan)
        durations.append(plan.duration)
        assert plan.check.acceleration <= 1e-3
        found = largest(plan)
        assert all(
            x <= most * (1.0 + 5e-3) for x, most in zip(found, (limits.linear, limits.angular, limits.joints), strict=True)
        )
    assert durations == sorted(durations, reverse=True)
    assert durations[0] > 1.2 * durations[-1]  # the limits have an effect


def largest_jerks(plan: Plan) -> tuple[float, float, float]:
    """Return the largest jerks by difference quotients of the accelerations inside the intervals."""
    knots, u = plan.knots.times, np.linspace(0.02, 0.98, 9)
    times = (knots[:-1, None] + np.diff(knots)[:, None] * u).ravel()
    step = 1e-4 * np.diff(knots).min()
    before, after = plan.at(times), plan.at(times + step)
    linear, angular = (
        np.linalg.norm(part, axis=1).max(initial=0.0) / step
        for part in np.split(after.acceleration - before.acceleration, 2, axis=1)
    )
    return float(linear), float(angular), float(np.abs(after.a - before.a).max(initial=0.0)) / step


@pytest.mark.parametrize("limit", [2.0, 2000.0])
def test_straight_move_takes_the_cube_root_of_32_distances_over_jerk(limit: float) -> None:
    """Rest to rest with the jerk j alone, which is ±j: T = ∛(32 d/j). It starts and ends without acceleration."""
    plan = plan_along(strong_block(linear_jerk=limit), straight_move(1.0, 0.0, 0.0))
    assert isinstance(plan, Plan)
    exact = np.cbrt(32.0 * DISTANCE / limit)
    assert exact * (1.0 - 1e-3) <= plan.duration <= 1.03 * exact  # 100 intervals; the check takes a part of the limit
    assert plan.knots.acceleration[[0, -1]] == pytest.approx(0.0, abs=1e-12)
    assert largest_jerks(plan)[0] <= limit * (1.0 + 2e-3)
    assert plan.s[[0, -1]] == pytest.approx([0.0, 1.0])


def test_joint_move_keeps_its_limit_of_jerk() -> None:
    hand = Hand.load("allegro_right")
    goal = np.array(hand.neutral)
    goal[1] += 0.3
    task = FingerTask(hand, acceleration_limits=AccelerationLimits(joint_jerk=200.0))
    plan = plan_fingers(task, hand.neutral, goal)
    assert isinstance(plan, Plan)
    assert plan.duration == pytest.approx(np.cbrt(32.0 * 0.3 / 200.0), rel=0.03)
    assert largest_jerks(plan)[2] <= 200.0 * (1.0 + 2e-3)


def test_jerk_of_a_held_object_keeps_all_limits_at_once() -> None:
    grasp = find_move_grasp("allegro_right")
    to, turn = MOVES["allegro_right"]
    goal = Rotation.from_rotvec(turn).as_matrix() @ grasp.R_HO
    p, R = np.array([grasp.p_HO, grasp.p_HO + to]), np.array([grasp.R_HO, goal])
    free_task = tracking.object_task(grasp, ControlSettings(slip_margin=1.0))
    durations = []
    for factor in (1.0, 4.0, np.inf):
        limits = AccelerationLimits(linear=1.0, linear_jerk=100.0 * factor, angular_jerk=2e3 * factor, joint_jerk=1e4 * factor)
        plan = PathMove(replace(free_task, acceleration_limits=limits), p, R, q_start=grasp.q, intervals=60).plan()
        assert isinstance(plan, Plan)
        assert plan.check.verified
        durations.append(plan.duration)
        most = (limits.linear_jerk, limits.angular_jerk, limits.joint_jerk)
        assert all(found <= limit * (1.0 + 5e-3) for found, limit in zip(largest_jerks(plan), most, strict=True))
        assert largest(plan)[0] <= 1.0 + 5e-3
    assert durations == sorted(durations, reverse=True)
    with pytest.raises(InvalidInput, match="jerk"):
        plan_free(replace(free_task, acceleration_limits=AccelerationLimits(joint_jerk=1e4)), p, R, grasp.q)


def test_record_keeps_limits() -> None:
    hand = Hand.load("allegro_right")
    task = FingerTask(hand, acceleration_limits=AccelerationLimits(joints=10.0))
    move = FingersMove(task, [hand.neutral, hand.neutral + 0.1])
    record = move.to_dict()
    assert record["acceleration_limits"] == {"joints": 10.0}
    again = move_from_dict(record, hand)
    assert again.task.acceleration_limits == task.acceleration_limits
    assert "acceleration_limits" not in FingersMove(FingerTask(hand), move.postures).to_dict()
    with pytest.raises(InvalidInput, match=r"acceleration_limits\.linear"):
        move_from_dict({**record, "acceleration_limits": {"linear": -1.0}}, hand)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "fast"])
def test_limit_out_of_range_is_rejected(value: object) -> None:
    with pytest.raises(InvalidInput, match="linear"):
        AccelerationLimits(linear=value)  # type: ignore[arg-type]
