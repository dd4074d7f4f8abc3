"""Beside TOPP-RA, which knows fingers alone: the same durations on the same paths with torque limits only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import toppra
from hands_for_tests import load
from toppra import algorithm, constraint

from graspforce.arrays import Array
from graspforce.hand import Hand
from graspforce.planning import path_program
from graspforce.planning.path import JointPath, grid
from graspforce.planning.path_dynamics import PathDynamics, path_dynamics
from graspforce.planning.path_program import Reserve
from graspforce.planning.task import Task

toppra.setup_logging("ERROR")

# Postures as parts of each joint's range, for all joints alike.
STRAIGHT = ((0.4, 0.45, 0.5, 0.42), (0.6, 0.5, 0.7, 0.55))
BY_WAY_OF = ((0.3, 0.5, 0.6), (0.5, 0.4, 0.5), (0.7, 0.6, 0.45))
STRENGTH = 0.1  # of the motors: so weak that gravity counts
FAST = 3.0  # times our largest rate: a speed that no motion reaches, without which TOPP-RA's linear programs fail at some knots


class OurPath(toppra.interpolator.AbstractGeometricPath):
    """Our path, with its own derivatives, as TOPP-RA wants it."""

    def __init__(self, path: JointPath, n: int) -> None:
        self._path, self._n = path, n

    def __call__(self, path_positions: Array, order: int = 0) -> Array:
        points = self._path.points(np.atleast_1d(path_positions))
        values = (points.q, points.q_s, points.q_ss)[order]
        return values if np.ndim(path_positions) else values[0]

    @property
    def dof(self) -> int:
        return self._n

    @property
    def path_interval(self) -> Array:
        return np.array([0.0, 1.0])

    @property
    def waypoints(self) -> None:
        return None


def route(hand: Hand, parts: tuple[tuple[float, ...], ...]) -> JointPath:
    rows = [np.resize(part, hand.n) for part in parts]
    return JointPath.through([hand.q_lower + row * (hand.q_upper - hand.q_lower) for row in rows])


def ours(hand: Hand, path: JointPath, s: Array) -> PathDynamics:
    """The equations with torque limits only."""
    dynamics = path_dynamics(Task(hand), s, None, path.points(s), None)
    free = np.full(len(s), np.inf)
    weak = {"lower": STRENGTH * dynamics.lower, "upper": STRENGTH * dynamics.upper}
    return replace(dynamics, cap=free, cap_between=free[1:], **weak)


def theirs(hand: Hand, path: JointPath, s: Array, rate: float) -> float:
    """TOPP-RA's duration, its constraints at the knots alone as ours are."""
    limit = STRENGTH * hand.torque_upper

    def share(q: Array, v: Array, a: Array) -> Array:
        """Torques over their limits: the tolerances of TOPP-RA's linear programs are absolute."""
        return hand.inverse_dynamics(q, v, a) / limit

    torque = constraint.JointTorqueConstraint(share, np.tile([-1.0, 1.0], (hand.n, 1)), np.zeros(hand.n))
    torque.set_discretization_type(constraint.DiscretizationType.Collocation)
    speed = FAST * rate * np.abs(path.points(s).q_s).max(axis=0)  # rad/s
    never = constraint.JointVelocityConstraint(np.column_stack([-speed, speed]))
    found = algorithm.TOPPRA([torque, never], OurPath(path, hand.n), gridpoints=s).compute_parameterization(0.0, 0.0)
    return float((2.0 * np.diff(s) / (found[1][1:] + found[1][:-1])).sum())


def durations(name: str, parts: tuple[tuple[float, ...], ...], intervals: int, rule: str = "left") -> tuple[float, float]:
    """Ours and theirs on one grid."""
    hand = load(name)
    path, s = route(hand, parts), grid(intervals)
    dynamics = ours(hand, path, s)
    answer = path_program.solve(dynamics, Reserve.none(dynamics), rule)
    assert answer is not None
    return answer.duration, theirs(hand, path, s, float(np.sqrt(answer.b.max())))


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2", "allegro_right"])
def test_with_the_same_first_order_rule_durations_agree(name: str) -> None:
    """1e-6: our program is solved to 1e-8, TOPP-RA's small ones to about as much."""
    mine, peer = durations(name, STRAIGHT, 100)
    assert mine == pytest.approx(peer, rel=1e-6)


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2", "allegro_right"])
def test_where_inertia_along_the_path_changes_sign_ours_is_no_longer_than_the_greedy_one_and_they_meet(name: str) -> None:
    """TOPP-RA goes as fast as it can from knot to knot, which is not best next to a knot where a motor feels no inertia; the
    loss vanishes with the grid."""
    losses = []
    for intervals in (100, 400):
        mine, peer = durations(name, BY_WAY_OF, intervals)
        losses.append(peer / mine - 1.0)
    assert min(losses) > -1e-6
    assert losses[1] < max(0.3 * losses[0], 1e-5)


def test_both_converge_to_the_same_duration_ours_with_a_coarser_grid() -> None:
    """TOPP-RA's rule is of first order: extrapolated from two grids its error is of the second, and so is ours on one."""
    mine, coarse = durations("dlr_hit2", STRAIGHT, 200, "trapezoid")
    _, fine = durations("dlr_hit2", STRAIGHT, 400)
    limit = 2.0 * fine - coarse
    assert mine == pytest.approx(limit, rel=1e-4)
    assert abs(mine / limit - 1.0) < 0.1 * abs(coarse / limit - 1.0)
