"""The check of a plan between its knots: as accurate as dense sampling, for plans of every planner."""

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

DENSE = 20 * 4  # instants in an interval: twenty times those that the check evaluates
ACCURACY = 1e-5  # of a limit: a hundredth of the tolerance
RANGES = {"four_finger": ((0.005, 0.008), 8.0)}  # m, °: distances and largest turn within its reach
KINDS = ("slip", "normal", "torque", "speed", "position")


def accelerated(plan: Plan, rate: float) -> Plan:
    """Return the plan run faster by a factor, which exceeds its limits."""
    knots = plan.knots
    fast = replace(knots, times=knots.times / rate, v=rate * knots.v, a=rate**2 * knots.a)
    fast = replace(fast, twist=rate * knots.twist, acceleration=rate**2 * knots.acceleration)
    return replace(plan, knots=fast)


def moves(name: str, count: int, seed: int, intervals: int) -> list[tuple[GraspTask, StraightPath, Array, Plan]]:
    """Return random moves along which the fingers can follow, with their plans."""
    task, middle, q = star_grasp(load(name))
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        path = random_move(rng, middle, *RANGES.get(name, ((0.005, 0.02), 20.0)))
        plan = plan_along(task, path, q, settings=PlanSettings(intervals=intervals))
        if isinstance(plan, Plan):
            found.append((task, path, q, plan))
    return found


def assert_check_equals_dense_sampling(plan: Plan) -> None:
    """Compare the check with a direct evaluation at eighty instants in every interval."""
    checked, dense = check(plan)[0], check_at_times(plan, times_between(plan.knots.times, DENSE - 1))
    for kind in KINDS:
        ours, exact = getattr(checked, kind), getattr(dense, kind)
        if max(ours, exact) > -0.01:  # values far from their limits do not matter
            assert ours == pytest.approx(exact, abs=ACCURACY, rel=0.02), kind
    assert checked.drift == pytest.approx(dense.drift, rel=0.2, abs=1e-9)  # m; a norm is not smooth where it is zero
    assert checked.imbalance == pytest.approx(dense.imbalance, rel=0.02, abs=1e-9)


@pytest.mark.parametrize("name", list(FINGERS))
def test_check_finds_the_largest_excess_anywhere(name: str) -> None:
    """Both planners, coarse grids, and plans that exceed limits by per cents."""
    for task, path, q, along in moves(name, 2, 11, 12):
        at = path.points(np.array([0.0, 1.0]))
        free = plan_free(task, at.p, at.R, q, settings=PlanSettings(intervals=20))
        assert isinstance(free, Plan)
        for plan in (along, free, accelerated(along, 1.05), accelerated(free, 1.05)):
            assert_check_equals_dense_sampling(plan)


def test_check_finds_an_excess_that_lasts_a_fortieth_of_an_interval() -> None:
    """A torque at its limit at the last knot exceeds it just before, relatively by about p²/4m.

    q̈ = L (1 + p x − m x² + c x³) with x the remaining part of the interval, without gravity. The interval is too short for
    rates to matter.
    """
    hand = load("four_finger")
    task = FingerTask(hand, gravity_H=np.zeros(3))
    p, m, c, h = 0.1, 4.0, 2.5, 1e-5  # 1, 1, 1, s
    inertia = np.abs(hand.mass_matrix(hand.neutral)[:, 0])  # kg·m², per acceleration of the first joint
    largest = float((hand.torque_upper[inertia > 0] / inertia[inertia > 0]).min())  # rad/s²
    profile_a = np.polynomial.Polynomial([1.0, p, -m, c])
    profile_v, profile_q = -profile_a.integ(), profile_a.integ(2)  # x decreases with time
    ends = np.array([1.0, 0.0])
    states = []
    for profile, scale in ((profile_q, h**2), (profile_v, h), (profile_a, 1.0)):
        states.append(np.zeros((2, hand.n)))
        states[-1][:, 0] = largest * scale * profile(ends)
    q, v, a = states
    template = plan_fingers_along(
        task, JointPath.through([hand.neutral, hand.neutral + 0.1]), settings=PlanSettings(intervals=4)
    )
    assert isinstance(template, Plan)
    knots = replace(template.knots, times=np.array([0.0, h]), q=hand.neutral + q, v=v, a=a, tau=0.0 * q, f=np.zeros((2, 0)))
    plan = replace(template, knots=knots)
    assert check_at_times(plan, times_between(knots.times, SAMPLES_PER_INTERVAL - 1)).torque == pytest.approx(0.0, abs=1e-6)
    excess = profile_a(profile_a.deriv().roots().min()) - 1.0
    assert excess == pytest.approx(p**2 / (4.0 * m), rel=0.02)
    assert check(plan)[0].torque == pytest.approx(excess, abs=5e-5)  # a twentieth of the tolerance


def test_interval_sampling_reproduces_polynomials_of_its_degree() -> None:
    knots = np.array([0.0, 0.3, 1.0])
    quartic = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.7, -0.4])
    for degree in (4, 8):
        nodes = interpolation_nodes(knots, degree)
        samples = sample_intervals(np.stack([quartic(nodes), nodes], axis=1), degree)
        t = times_between(knots, SAMPLES_PER_INTERVAL - 1)
        np.testing.assert_allclose(samples, np.stack([quartic(t), t], axis=1), atol=1e-14)
