"""Gears that hold the load at rest: the limits of the gear, and no cost for the motor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hands import load

import graspforce as gf
from graspforce.force.problem import ForceProblem
from graspforce.force.status import Status
from graspforce.hand.hand import Hand
from graspforce.hand.tendon_modes import stop_tendon_joints

FINGERS = ("finger_1", "finger_2", "finger_3", "finger_4")


def with_holding(hand: Hand, joints: set[int], torque: float) -> Hand:
    """Return the hand with gears that hold a torque at some joints."""
    each = [replace(joint, holding_torque=torque) if j in joints else joint for j, joint in enumerate(hand.joints)]
    return replace(hand, joints=tuple(each))


def box_problem(hand: Hand, weight: float) -> ForceProblem:
    """Return the force problem of the four-finger hand that carries a box of a weight, N."""
    normals = [[-1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]]
    p_HO, points = np.array([0.0, 0.0, 0.055]), [[0.03, 0.0225, 0], [0.03, -0.0225, 0], [-0.03, -0.0225, 0], [-0.03, 0.0225, 0]]
    contacts = gf.ContactSet.stack([gf.Contact(p, n, 0.6) for p, n in zip(points, normals, strict=True)])
    actuation = hand.actuation(hand.neutral, FINGERS, contacts, p_HO, np.eye(3))
    return ForceProblem(contacts, [0, 0, weight, 0, 0, 0], actuation)


def test_gears_that_hold_take_the_torque_from_the_other_motors() -> None:
    """The others' torques lie between those without and those that would be least if finger 1 cost nothing at all."""
    hand = load("four_finger")
    own = set(hand.finger("finger_1").joints)
    held, rest = with_holding(hand, own, 5.0), [j for j in range(hand.n) if j not in own]
    before, after = gf.solve(box_problem(hand, 2.0)), gf.solve(box_problem(held, 2.0))
    assert before.status is after.status is Status.OPTIMAL
    problem = box_problem(held, 2.0)
    free = gf.Actuation(
        problem.actuation.J,
        problem.actuation.tau_u,
        problem.actuation.lower,
        problem.actuation.upper,
        [0.0 if j in own else 1.0 for j in range(hand.n)],
    )
    least = gf.solve(ForceProblem(problem.contacts, problem.w, free))
    cost_before, cost_after, cost_least = (float(np.square(s.torques[rest]).sum()) for s in (before, after, least))
    assert cost_least * (1.0 - 1e-6) <= cost_after < cost_before
    assert cost_before - cost_after > 0.5 * (cost_before - cost_least)
    assert np.square(after.torques).sum() > np.square(before.torques).sum()


def test_limits_at_rest_are_those_of_the_gears_and_in_motion_of_the_motors() -> None:
    hand = with_holding(load("four_finger"), {0, 1, 2}, 9.0)
    problem = box_problem(hand, 1.0)
    np.testing.assert_array_equal(problem.actuation.upper[:4], [9.0, 9.0, 9.0, hand.torque_upper[3]])
    np.testing.assert_array_equal(problem.actuation.lower, -problem.actuation.upper)
    contacts, pose = problem.contacts, (np.array([0.0, 0.0, 0.055]), np.eye(3))
    moving = hand.actuation(hand.neutral, FINGERS, contacts, *pose, tau_u=np.zeros(hand.n))
    np.testing.assert_array_equal(moving.upper, hand.torque_upper)
    np.testing.assert_array_equal(moving.weight, hand.torque_weight)


def test_gears_hold_a_load_that_the_motors_cannot_lift() -> None:
    hand = load("four_finger")
    heavy = 200.0  # N
    assert gf.solve(box_problem(hand, heavy)).status is Status.INFEASIBLE
    solution = gf.solve(box_problem(with_holding(hand, set(range(hand.n)), 100.0), heavy))
    assert solution.status is Status.OPTIMAL
    assert solution.certificate.verified
    assert np.abs(solution.torques).max() > hand.torque_upper.max()


def test_weights_stay_if_all_gears_hold() -> None:
    hand = with_holding(load("four_finger"), set(range(12)), 2.0)
    np.testing.assert_array_equal(hand.rest_torque_weight, hand.torque_weight)


@pytest.mark.parametrize("name", ["barrett", "ability_right"])
def test_worm_gears_of_shipped_hands_hold_more_than_their_motors(name: str) -> None:
    hand = load(name)
    worms = [joint for joint in hand.joints if joint.holding_torque is not None]
    assert 0 < len(worms) < hand.n
    assert all(joint.holding_torque >= joint.torque for joint in worms)


def test_holding_torque_after_a_breakaway_is_that_of_the_same_gear() -> None:
    hand = load("barrett")
    after = stop_tendon_joints(hand, {"finger_3_inner": 1.0})
    assert after.joints[3].holding_torque * 4.0 / 3.0 == pytest.approx(hand.joints[3].holding_torque)
