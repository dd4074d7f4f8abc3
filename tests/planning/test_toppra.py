"""Comparison with TOPP-RA on paths of fingers alone with torque limits: equal durations where its greedy rule is optimal.

Both use the same spline with its own derivatives, the same grid, and torque limits at the same knots (``Collocation``). With
``Interpolation`` TOPP-RA limits both ends of every interval and takes up to 3 % longer at 100 intervals. With the
discretisation "left" both programs are the same: b_{i+1} = b_i + 2 Δ_i a_i, with limits on (b_i, a_i). They are solved
differently. TOPP-RA moves as fast as the next knot allows. This is optimal unless tau_a, a motor's inertia along the path,
changes sign next to a knot: there a motor at its limit bounds b instead of a. Pham and Pham (2018) prove optimality without
such points.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import toppra
from scipy import sparse
from scipy.optimize import linprog
from support.hands import load
from toppra import algorithm, constraint

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.planning.interpolation import Indices
from graspforce.planning.path import program
from graspforce.planning.path.dynamics import PathDynamics, path_dynamics
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.path.paths import JointPath, knot_grid
from graspforce.planning.path.program_rows import LimitMargins
from graspforce.planning.task import FingerTask

toppra.setup_logging("ERROR")

# Postures as fractions of each joint's range.
STRAIGHT = ((0.4, 0.45, 0.5, 0.42), (0.6, 0.5, 0.7, 0.55))
VIA = ((0.3, 0.5, 0.6), (0.5, 0.4, 0.5), (0.7, 0.6, 0.45))
STRENGTH = 0.1  # of the motors' torque: gravity matters
FAST = 3.0  # times our largest rate: an inactive speed limit, without which TOPP-RA's linear programs fail at some knots


class OurPath(toppra.interpolator.AbstractGeometricPath):
    """Our path with its derivatives, through TOPP-RA's interface."""

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
    """Return the path through postures that are given as fractions of the joints' ranges."""
    rows = [np.resize(part, hand.n) for part in parts]
    return JointPath.through([hand.q_lower + row * (hand.q_upper - hand.q_lower) for row in rows])


def ours(hand: Hand, path: JointPath, s: Array) -> PathDynamics:
    """Return the equations of motion with torque limits only."""
    dynamics = path_dynamics(FingerTask(hand), PathKnots.of_fingers(path, s))
    free = np.full(len(s), np.inf)
    weak = {"lower": STRENGTH * dynamics.lower, "upper": STRENGTH * dynamics.upper}
    return replace(dynamics, b_max=free, b_max_between=free[1:], **weak)


def theirs(hand: Hand, path: JointPath, s: Array, rate: float) -> tuple[float, Array]:
    """Return TOPP-RA's duration, s, and rates ṡ, with constraints at the knots as ours."""
    limit = STRENGTH * hand.torque_upper

    def share(q: Array, v: Array, a: Array) -> Array:
        """Return torques relative to their limits: the tolerances of TOPP-RA's linear programs are absolute."""
        return hand.inverse_dynamics(q, v, a) / limit

    torque = constraint.JointTorqueConstraint(share, np.tile([-1.0, 1.0], (hand.n, 1)), np.zeros(hand.n))
    torque.set_discretization_type(constraint.DiscretizationType.Collocation)
    speed = FAST * rate * np.maximum(np.abs(path.points(s).q_s).max(axis=0), 1e-3)  # rad/s; some joints do not move
    inactive = constraint.JointVelocityConstraint(np.column_stack([-speed, speed]))
    found = algorithm.TOPPRA([torque, inactive], OurPath(path, hand.n), gridpoints=s).compute_parameterization(0.0, 0.0)
    return float((2.0 * np.diff(s) / (found[1][1:] + found[1][:-1])).sum()), found[1]


def durations(
    name: str, parts: tuple[tuple[float, ...], ...], intervals: int, discretisation: str = "left"
) -> tuple[float, float]:
    """Return our duration and TOPP-RA's on the same grid, s."""
    hand = load(name)
    path, s = route(hand, parts), knot_grid(intervals)
    dynamics = ours(hand, path, s)
    answer = program.solve(dynamics, LimitMargins.slip_only(dynamics), discretisation)
    assert answer is not None
    return answer.duration, theirs(hand, path, s, float(np.sqrt(answer.b.max())))[0]


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2", "allegro_right"])
def test_durations_equal_those_of_toppra_with_its_discretisation(name: str) -> None:
    mine, peer = durations(name, STRAIGHT, 100)
    assert mine == pytest.approx(peer, rel=1e-6)


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2", "allegro_right"])
def test_greedy_rule_is_slower_where_inertia_changes_sign_and_converges_with_the_grid(name: str) -> None:
    """TOPP-RA loses time next to a knot where a motor has no inertia along the path; the loss vanishes on finer grids."""
    losses = []
    for intervals in (100, 400):
        mine, peer = durations(name, VIA, intervals)
        losses.append(peer / mine - 1.0)
    assert min(losses) > -1e-6
    assert losses[1] < max(0.3 * losses[0], 1e-5)


def test_trapezoid_converges_to_the_same_duration_with_second_order() -> None:
    """TOPP-RA's rule is of first order; extrapolation from two grids makes it of second order."""
    mine, coarse = durations("dlr_hit2", STRAIGHT, 200, "trapezoid")
    _, fine = durations("dlr_hit2", STRAIGHT, 400)
    limit = 2.0 * fine - coarse
    assert mine == pytest.approx(limit, rel=1e-4)
    assert abs(mine / limit - 1.0) < 0.1 * abs(coarse / limit - 1.0)


# ── through via points ────────────────────────────────────────────────────────────────────────────────────────────────────────


def winding(hand: Hand, seed: int) -> JointPath:
    """Return a path of one finger through four random postures; from the fourth seed on every joint is monotonic."""
    own = list(hand.fingers[0].joints)
    postures = np.tile(hand.neutral, (4, 1))
    part = np.random.default_rng(seed).uniform(0.3, 0.7, size=(4, hand.n))
    postures[:, own] = (hand.q_lower + part * (hand.q_upper - hand.q_lower))[:, own]
    if seed >= 4:
        postures[:, own] = np.sort(postures[:, own], axis=0)
    return JointPath.through(postures)


def least_duration(dynamics: PathDynamics, b: Array) -> float:
    """Return a lower bound on the durations that the program with the discretisation "left" allows, by HiGHS, s.

    The duration Σ 2Δ/(√b + √b⁺) is convex in b and lies above its tangent at the given b. A linear program minimises the
    tangent; at the optimal b the bound equals the duration.
    """
    s, unit, half = dynamics.s, float(b.max()), (dynamics.upper - dynamics.lower) / 2.0
    K, step, r = len(s), np.diff(s), np.sqrt(b / b.max())
    times = 2.0 * step / (r[:-1] + r[1:])  # of the intervals, in units of 1/√unit
    slope = np.zeros(K)
    inner = r[1:-1]
    slope[1:-1] = -(times[:-1] / (r[:-2] + inner) + times[1:] / (inner + r[2:])) / (2.0 * inner)
    moved = np.flatnonzero(np.abs(dynamics.tau_a).max(axis=0) > 0.0)
    rows, bounds = [], []
    for sign, limit in ((1.0, dynamics.upper), (-1.0, -dynamics.lower)):
        for j in moved:
            per_b, per_a = (sign * unit / half[j] * tau[:-1, j] for tau in (dynamics.tau_b, dynamics.tau_a))
            rows.append(sparse.hstack([sparse.diags(per_b, shape=(K - 1, K)), sparse.diags(per_a)]))
            bounds.append((limit[j] - sign * dynamics.tau_0[:-1, j]) / half[j])
    forward = sparse.diags([-np.ones(K - 1), np.ones(K - 1)], [0, 1], shape=(K - 1, K))
    found = linprog(
        np.append(slope, np.zeros(K - 1)),
        sparse.vstack(rows),
        np.concatenate(bounds),
        sparse.hstack([forward, sparse.diags(-2.0 * step)]),
        np.zeros(K - 1),
        [(0.0, None if 0 < i < K - 1 else 0.0) for i in range(K)] + [(None, None)] * (K - 1),
        method="highs",
    )
    assert found.status == 0
    return float((times.sum() + found.fun - slope @ (b / unit)) / np.sqrt(unit))


def without_inertia(dynamics: PathDynamics) -> Indices:
    """Return the knots after which some motor's inertia along the path changes sign."""
    moved = np.abs(dynamics.tau_a).max(axis=0) > 0.0
    return np.unique(np.nonzero(np.diff(np.sign(dynamics.tau_a[:, moved]), axis=0))[0])


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2", "allegro_right"])
def test_duration_is_optimal_and_toppra_differs_only_where_inertia_changes_sign(name: str) -> None:
    """On 24 paths a linear program finds no shorter duration. TOPP-RA's durations are equal to 1e-7, unless a motor's inertia
    changes sign on the stretch where its rates differ."""
    hand, s = load(name), knot_grid(100)
    slower = 0
    for seed in range(8):
        path = winding(hand, seed)
        dynamics = ours(hand, path, s)
        answer = program.solve(dynamics, LimitMargins.slip_only(dynamics), "left")
        assert answer is not None
        assert least_duration(dynamics, answer.b) == pytest.approx(answer.duration, rel=1e-7)
        peer, rates = theirs(hand, path, s, float(np.sqrt(answer.b.max())))
        assert peer > answer.duration * (1.0 - 1e-7)
        places = without_inertia(dynamics)
        if peer < answer.duration * (1.0 + 1e-5):
            assert peer == pytest.approx(answer.duration, rel=1e-7)
            continue
        slower += 1
        differs = np.flatnonzero(np.abs(rates[1:-1] ** 2 / answer.b[1:-1] - 1.0) > 1e-3) + 1
        for stretch in np.split(differs, np.flatnonzero(np.diff(differs) > 1) + 1):
            assert ((places >= stretch[0] - 1) & (places <= stretch[-1])).any()
    assert 1 <= slower <= 6


def test_greedy_loss_vanishes_on_fine_grids_where_both_equal_the_second_order_rule() -> None:
    """TOPP-RA's loss falls from 1e-4 to less than 1e-6; extrapolation makes the first-order rule one of second order."""
    hand = load("dlr_hit2")
    path = winding(hand, 1)
    found: list[float] = []
    losses: list[float] = []
    for intervals in (100, 400, 1600):
        dynamics = ours(hand, path, knot_grid(intervals))
        answer = program.solve(dynamics, LimitMargins.slip_only(dynamics), "left")
        assert answer is not None
        found.append(answer.duration)
        losses.append(theirs(hand, path, dynamics.s, float(np.sqrt(answer.b.max())))[0] / answer.duration - 1.0)
    assert losses[0] > 5e-5
    assert losses[1] < 0.2 * losses[0]
    assert 0.0 < losses[2] < 1e-6
    dynamics = ours(hand, path, knot_grid(400))
    second = program.solve(dynamics, LimitMargins.slip_only(dynamics))
    assert second is not None
    assert second.duration == pytest.approx((4.0 * found[2] - found[1]) / 3.0, rel=1e-5)
    assert abs(found[2] / second.duration - 1.0) > 2e-5  # larger without extrapolation
