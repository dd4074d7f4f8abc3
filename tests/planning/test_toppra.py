"""Beside TOPP-RA, which knows fingers alone: the same durations on the same paths with torque limits only.

Both are given the same spline with its own derivatives, the same grid and torque limits at the same knots (`Collocation`; by
`Interpolation` TOPP-RA asks for more, at both ends of every interval, and takes up to 3 % longer at 100 intervals), and with
the rule "left" ours has its very program: b_{i+1} = b_i + 2 Δ_i a_i, limits on (b_i, a_i). What differs is how it is solved.
TOPP-RA goes forward as fast as the next knot allows. That is best as long as going faster here never means going slower there,
which fails next to a knot where a motor's inertia along the path, tau_a, changes sign: there a motor at its limit bounds b and
not a, and haste before it must be paid for. Pham and Pham, A new approach to time-optimal path parameterization based on
reachability analysis (2018), prove optimality where there are no such points.
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
    """Return the equations with torque limits only."""
    dynamics = path_dynamics(FingerTask(hand), PathKnots.of_fingers(path, s))
    free = np.full(len(s), np.inf)
    weak = {"lower": STRENGTH * dynamics.lower, "upper": STRENGTH * dynamics.upper}
    return replace(dynamics, b_max=free, b_max_between=free[1:], **weak)


def theirs(hand: Hand, path: JointPath, s: Array, rate: float) -> tuple[float, Array]:
    """TOPP-RA's duration and rates ṡ, its constraints at the knots alone as ours are."""
    limit = STRENGTH * hand.torque_upper

    def share(q: Array, v: Array, a: Array) -> Array:
        """Torques over their limits: the tolerances of TOPP-RA's linear programs are absolute."""
        return hand.inverse_dynamics(q, v, a) / limit

    torque = constraint.JointTorqueConstraint(share, np.tile([-1.0, 1.0], (hand.n, 1)), np.zeros(hand.n))
    torque.set_discretization_type(constraint.DiscretizationType.Collocation)
    speed = FAST * rate * np.maximum(np.abs(path.points(s).q_s).max(axis=0), 1e-3)  # rad/s; some joints stand still
    never = constraint.JointVelocityConstraint(np.column_stack([-speed, speed]))
    found = algorithm.TOPPRA([torque, never], OurPath(path, hand.n), gridpoints=s).compute_parameterization(0.0, 0.0)
    return float((2.0 * np.diff(s) / (found[1][1:] + found[1][:-1])).sum()), found[1]


def durations(
    name: str, parts: tuple[tuple[float, ...], ...], intervals: int, discretisation: str = "left"
) -> tuple[float, float]:
    """Ours and theirs on one grid."""
    hand = load(name)
    path, s = route(hand, parts), knot_grid(intervals)
    dynamics = ours(hand, path, s)
    answer = program.solve(dynamics, LimitMargins.slip_only(dynamics), discretisation)
    assert answer is not None
    return answer.duration, theirs(hand, path, s, float(np.sqrt(answer.b.max())))[0]


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


# ── through via points ────────────────────────────────────────────────────────────────────────────────────────────────────────


def winding(hand: Hand, seed: int) -> JointPath:
    """One finger through four random postures; from the fourth seed on without turning any joint back."""
    own = list(hand.fingers[0].joints)
    postures = np.tile(hand.neutral, (4, 1))
    part = np.random.default_rng(seed).uniform(0.3, 0.7, size=(4, hand.n))
    postures[:, own] = (hand.q_lower + part * (hand.q_upper - hand.q_lower))[:, own]
    if seed >= 4:
        postures[:, own] = np.sort(postures[:, own], axis=0)
    return JointPath.through(postures)


def no_shorter_than(dynamics: PathDynamics, b: Array) -> float:
    """Return a lower bound on the duration of every b' that the rule "left" allows, by HiGHS.

    The duration Σ 2Δ/(√b + √b⁺) is convex in b, so it lies above its tangent at the b given, and a linear program finds the
    least of that: where b is best, its own duration.
    """
    s, unit, half = dynamics.s, float(b.max()), (dynamics.upper - dynamics.lower) / 2.0
    K, step, r = len(s), np.diff(s), np.sqrt(b / b.max())
    times = 2.0 * step / (r[:-1] + r[1:])  # of the intervals, in 1/√unit
    falls = np.zeros(K)
    inner = r[1:-1]
    falls[1:-1] = -(times[:-1] / (r[:-2] + inner) + times[1:] / (inner + r[2:])) / (2.0 * inner)
    moved = np.flatnonzero(np.abs(dynamics.tau_a).max(axis=0) > 0.0)
    rows, room = [], []
    for sign, limit in ((1.0, dynamics.upper), (-1.0, -dynamics.lower)):
        for j in moved:
            of_b, of_a = (sign * unit / half[j] * tau[:-1, j] for tau in (dynamics.tau_b, dynamics.tau_a))
            rows.append(sparse.hstack([sparse.diags(of_b, shape=(K - 1, K)), sparse.diags(of_a)]))
            room.append((limit[j] - sign * dynamics.tau_0[:-1, j]) / half[j])
    forward = sparse.diags([-np.ones(K - 1), np.ones(K - 1)], [0, 1], shape=(K - 1, K))
    found = linprog(
        np.append(falls, np.zeros(K - 1)),
        sparse.vstack(rows),
        np.concatenate(room),
        sparse.hstack([forward, sparse.diags(-2.0 * step)]),
        np.zeros(K - 1),
        [(0.0, None if 0 < i < K - 1 else 0.0) for i in range(K)] + [(None, None)] * (K - 1),
        method="highs",
    )
    assert found.status == 0
    return float((times.sum() + found.fun - falls @ (b / unit)) / np.sqrt(unit))


def without_inertia(dynamics: PathDynamics) -> Indices:
    """Return the knots after which some motor's inertia along the path changes sign."""
    moved = np.abs(dynamics.tau_a).max(axis=0) > 0.0
    return np.unique(np.nonzero(np.diff(np.sign(dynamics.tau_a[:, moved]), axis=0))[0])


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2", "allegro_right"])
def test_through_via_points_ours_is_best_and_the_greedy_one_as_good_but_where_a_motor_feels_no_inertia(name: str) -> None:
    """24 paths: a third opinion finds nothing shorter, to the tolerance of our solver; TOPP-RA's is as short to a tenth of a
    millionth but where inertia changes sign within the stretch on which it goes at other rates."""
    hand, s = load(name), knot_grid(100)
    lost = 0
    for seed in range(8):
        path = winding(hand, seed)
        dynamics = ours(hand, path, s)
        answer = program.solve(dynamics, LimitMargins.slip_only(dynamics), "left")
        assert answer is not None
        assert no_shorter_than(dynamics, answer.b) == pytest.approx(answer.duration, rel=1e-7)
        peer, rates = theirs(hand, path, s, float(np.sqrt(answer.b.max())))
        assert peer > answer.duration * (1.0 - 1e-7)
        places = without_inertia(dynamics)
        if peer < answer.duration * (1.0 + 1e-5):
            assert peer == pytest.approx(answer.duration, rel=1e-7)
            continue
        lost += 1
        differs = np.flatnonzero(np.abs(rates[1:-1] ** 2 / answer.b[1:-1] - 1.0) > 1e-3) + 1
        for stretch in np.split(differs, np.flatnonzero(np.diff(differs) > 1) + 1):
            assert ((places >= stretch[0] - 1) & (places <= stretch[-1])).any()
    assert 1 <= lost <= 6


def test_on_finer_grids_both_meet_and_are_where_our_second_order_rule_is() -> None:
    """What greed loses falls from 1e-4 to less than 1e-6; the rule that both have is of first order, extrapolated of second."""
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
    assert abs(found[2] / second.duration - 1.0) > 2e-5  # without extrapolation it is further off
