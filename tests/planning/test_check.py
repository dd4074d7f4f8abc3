"""The check between knots: as sharp as looking everywhere, and the same for whoever made the plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hands import load
from support.planning_cases import FINGERS, random_move, star_grasp

from graspforce.core.arrays import Array
from graspforce.planning.check import (
    SAMPLES_PER_INTERVAL,
    check,
    check_at_times,
    interpolation_nodes,
    sample_intervals,
    times_between,
)
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.path.paths import JointPath, StraightPath
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask, GraspTask

DENSE = 20 * 4  # instants in an interval: twenty times what the check evaluates
RIGHT = 1e-5  # of a limit: a hundredth of the tolerance
ROOM = {"four_finger": ((0.005, 0.008), 8.0)}  # m, °
KINDS = ("slip", "normal", "torque", "speed", "position")


def hasty(plan: Plan, rate: float) -> Plan:
    """Return the same states at earlier times: rates and accelerations no longer match, and limits are broken."""
    knots = plan.knots
    fast = replace(knots, times=knots.times / rate, v=rate * knots.v, a=rate**2 * knots.a)
    fast = replace(fast, twist=rate * knots.twist, acceleration=rate**2 * knots.acceleration)
    return replace(plan, knots=fast)


def moves(name: str, count: int, seed: int, intervals: int) -> list[tuple[GraspTask, StraightPath, Array, Plan]]:
    """Random moves along which the fingers can follow, with their plans."""
    task, middle, q = star_grasp(load(name))
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        path = random_move(rng, middle, *ROOM.get(name, ((0.005, 0.02), 20.0)))
        plan = plan_along(task, path, q, settings=PlanSettings(intervals=intervals))
        if isinstance(plan, Plan):
            found.append((task, path, q, plan))
    return found


def same(plan: Plan) -> None:
    """Compare the check with a check of eighty instants in every interval."""
    seen, there = check(plan)[0], check_at_times(plan, times_between(plan.knots.times, DENSE - 1))
    for kind in KINDS:
        ours, true = getattr(seen, kind), getattr(there, kind)
        if max(ours, true) > -0.01:  # elsewhere nothing is near its limit
            assert ours == pytest.approx(true, abs=RIGHT, rel=0.02), kind
    assert seen.drift == pytest.approx(there.drift, rel=0.2, abs=1e-9)  # m; a length, which is not smooth where it is zero
    assert seen.imbalance == pytest.approx(there.imbalance, rel=0.02, abs=1e-9)


@pytest.mark.parametrize("name", list(FINGERS))
def test_what_is_reported_is_the_largest_anywhere_of_either_method_s_plans(name: str) -> None:
    """Also on coarse grids, and of plans that break limits by per cents."""
    for task, path, q, along in moves(name, 2, 11, 12):
        at = path.points(np.array([0.0, 1.0]))
        free = plan_free(task, at.p, at.R, q, settings=PlanSettings(intervals=20))
        assert isinstance(free, Plan)
        for plan in (along, free, hasty(along, 1.05), hasty(free, 1.05)):
            same(plan)


def test_a_limit_that_is_broken_for_a_fortieth_of_an_interval_is_seen() -> None:
    """A joint's torque that is at its limit at the last knot and rises above it just before: by p²/4m of it, about.

    q̈ = L (1 + p x − m x² + c x³), x the part of the interval that is left; no gravity, too short a time for rates to count.
    """
    hand = load("four_finger")
    task = FingerTask(hand, gravity_H=np.zeros(3))
    p, m, c, h = 0.1, 4.0, 2.5, 1e-5  # 1, 1, 1, s
    turns = np.abs(hand.mass_matrix(hand.neutral)[:, 0])  # kg·m², of the first joint's acceleration
    largest = float((hand.torque_upper[turns > 0] / turns[turns > 0]).min())  # rad/s²
    left = np.polynomial.Polynomial([1.0, p, -m, c])
    rate, angle = -left.integ(), left.integ(2)  # over what is left they fall
    ends = np.array([1.0, 0.0])
    states = []
    for profile, scale in ((angle, h**2), (rate, h), (left, 1.0)):
        states.append(np.zeros((2, hand.n)))
        states[-1][:, 0] = largest * scale * profile(ends)
    q, v, a = states
    some = plan_fingers_along(task, JointPath.through([hand.neutral, hand.neutral + 0.1]), settings=PlanSettings(intervals=4))
    assert isinstance(some, Plan)
    knots = replace(some.knots, times=np.array([0.0, h]), q=hand.neutral + q, v=v, a=a, tau=0.0 * q, f=np.zeros((2, 0)))
    plan = replace(some, knots=knots)
    assert check_at_times(plan, times_between(knots.times, SAMPLES_PER_INTERVAL - 1)).torque == pytest.approx(0.0, abs=1e-6)
    most = left(left.deriv().roots().min()) - 1.0
    assert most == pytest.approx(p**2 / (4.0 * m), rel=0.02)
    assert check(plan)[0].torque == pytest.approx(most, abs=5e-5)  # a twentieth of the tolerance


def test_polynomials_of_their_degree_are_met() -> None:
    knots = np.array([0.0, 0.3, 1.0])
    cubic = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.7, -0.4])
    for degree in (4, 8):
        met = sample_intervals(
            np.stack([cubic(interpolation_nodes(knots, degree)), interpolation_nodes(knots, degree)], axis=1), degree
        )
        t = times_between(knots, SAMPLES_PER_INTERVAL - 1)
        np.testing.assert_allclose(met, np.stack([cubic(t), t], axis=1), atol=1e-14)
