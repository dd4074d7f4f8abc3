"""Minimum times along a path with closed forms, and the order of convergence of the grid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.planning_cases import (
    AXES,
    DISC,
    DISTANCE,
    GRAVITY,
    LIFT,
    MASS,
    MAX_NORMAL,
    NORMAL,
    OBLIQUE,
    TANGENTIAL,
    A,
    block,
    disc,
    motor_dynamics,
    straight_move,
)

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.planning.failure import IMMOVABLE, UNHOLDABLE, PlanFailure
from graspforce.planning.path import program
from graspforce.planning.path.dynamics import PathDynamics
from graspforce.planning.path.paths import StraightPath, knot_grid
from graspforce.planning.path.plan_along import knot_times, plan_along
from graspforce.planning.path.program import PathSolution
from graspforce.planning.path.program_rows import LimitMargins
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import IdealTask

CLOSE = 1e-4  # relative error of 100 intervals; a is linear in the interval in which the closed form has a step
MS = 1e-3
SLANT = np.deg2rad(30.0)


def planned(x: float, y: float, z: float, intervals: int = 100) -> Plan:
    """Return the plan of the block's move along a direction."""
    plan = plan_along(block(), straight_move(x, y, z), settings=PlanSettings(intervals=intervals))
    assert isinstance(plan, Plan)
    return plan


def solved(dynamics: PathDynamics) -> tuple[PathSolution, float]:
    """Return the solution of a program, and the duration of its motion, s."""
    answer = program.solve(dynamics, LimitMargins.slip_only(dynamics))
    assert answer is not None
    times = knot_times(dynamics.s, answer.b, answer.a)
    assert times is not None
    return answer, float(times[-1])


CASES = {
    "lift": ((0.0, 0.0, 1.0), LIFT),
    "lower": ((0.0, 0.0, -1.0), LIFT),
    "tangential": ((0.0, 1.0, 0.0), TANGENTIAL),
    "normal": ((1.0, 0.0, 0.0), NORMAL),
    "oblique": ((np.cos(SLANT), np.sin(SLANT), 0.0), OBLIQUE),
}


@pytest.mark.parametrize("name", CASES)
def test_block_between_two_fingers_takes_the_closed_form(name: str) -> None:
    direction, milliseconds = CASES[name]
    plan = planned(*direction)
    assert plan.check.verified
    assert plan.duration == pytest.approx(milliseconds * MS, rel=CLOSE)
    assert plan.optimality_gap < 1e-6  # the solver's tolerance is 1e-8 for a time of order 1


def test_tabulated_times_equal_their_closed_forms() -> None:
    root = np.sqrt(A**2 - GRAVITY**2)
    assert 2.0 * np.sqrt(DISTANCE * A) / root == pytest.approx(LIFT * MS, rel=1e-6)
    assert 2.0 * np.sqrt(DISTANCE / root) == pytest.approx(TANGENTIAL * MS, rel=1e-6)
    assert 2.0 * np.sqrt(DISTANCE / (MAX_NORMAL / MASS - GRAVITY)) == pytest.approx(NORMAL * MS, rel=1e-6)


@pytest.mark.parametrize("name", ["tangential", "normal", "oblique"])
def test_error_is_of_second_order_in_the_grid(name: str) -> None:
    """The step in acceleration is at a knot: twice the intervals give a quarter of the error."""
    direction, _ = CASES[name]
    exact = {
        "tangential": 2.0 * np.sqrt(DISTANCE / np.sqrt(A**2 - GRAVITY**2)),
        "normal": 2.0 * np.sqrt(DISTANCE / (MAX_NORMAL / MASS - GRAVITY)),
        "oblique": 2.0 * np.sqrt(DISTANCE / oblique_acceleration()),
    }[name]
    errors = np.array([planned(*direction, intervals).duration / exact - 1.0 for intervals in (50, 100, 200)])
    assert (errors > 0.0).all()
    assert errors[:-1] / errors[1:] == pytest.approx([4.0, 4.0], abs=0.4)


@pytest.mark.parametrize("intervals", [3, 5, 8, 20, 50, 100, 200])
@pytest.mark.parametrize("name", CASES)
def test_plan_is_never_faster_than_physics_by_more_than_its_own_excess_allows(name: str, intervals: int) -> None:
    """With every force limit larger by the plan's largest excess, the closed form is a lower bound on the duration."""
    plan = planned(*CASES[name][0], intervals)
    excess = max(plan.check.excess, 0.0)
    assert plan.check.verified  # and so excess <= plan.check.tolerance
    assert plan.duration >= minimum_time(name, 1.0 + excess)


def minimum_time(name: str, strength: float = 1.0) -> float:
    """Return the minimum time of a case, s, with normal forces up to ``strength`` times `MAX_NORMAL`."""
    a = strength * A  # m/s²
    if name in ("lift", "lower"):
        return float(2.0 * np.sqrt(DISTANCE * a / (a**2 - GRAVITY**2)))
    if name == "tangential":
        return float(2.0 * np.sqrt(DISTANCE / np.sqrt(a**2 - GRAVITY**2)))
    if name == "normal":
        return float(2.0 * np.sqrt(DISTANCE / (strength * MAX_NORMAL / MASS - GRAVITY)))
    return float(2.0 * np.sqrt(DISTANCE / oblique_acceleration(strength)))


def oblique_acceleration(strength: float = 1.0) -> float:
    """Return the smaller root of a² sin²θ + g² = 4μ² (N/m − a cos θ)², m/s²."""
    c, s = np.cos(SLANT), np.sin(SLANT)
    most = strength * MAX_NORMAL / MASS  # m/s²; 4μ² = 1
    roots = np.roots([s**2 - c**2, 2.0 * most * c, GRAVITY**2 - most**2])
    return float(min(root for root in roots if root > 0))


def test_disc_between_three_fingers_takes_the_closed_form() -> None:
    plan = plan_along(*disc())
    assert isinstance(plan, Plan)
    assert plan.check.verified
    assert plan.duration == pytest.approx(DISC * MS, rel=CLOSE)


def test_slip_margin_is_kept_at_every_instant_and_costs_its_time() -> None:
    """In the horizontal tangential move a margin ν leaves a = √(A'² − g²), A' = 2 (μN − ν)/m."""
    margin = 0.4  # N
    plan = plan_along(block(slip_margin=margin), straight_move(0.0, 1.0, 0.0))
    assert isinstance(plan, Plan)
    strength = 2.0 * (MAX_NORMAL * 0.5 - margin) / MASS  # m/s²
    assert plan.duration == pytest.approx(2.0 * np.sqrt(DISTANCE / np.sqrt(strength**2 - GRAVITY**2)), rel=CLOSE)
    f = plan.at(np.linspace(0.0, plan.duration, 777)).f.reshape(-1, 2, 3)
    slip_margin = 0.5 * f[:, :, 2] - np.hypot(f[:, :, 0], f[:, :, 1])
    assert slip_margin.min() == pytest.approx(margin, abs=1e-6)


def test_double_integrator_takes_the_closed_form() -> None:
    """Over d: 2√(d/a); with a speed limit d/v + v/a; with two accelerations √(2d (1/a₁ + 1/a₂))."""
    d, a, v = 0.3, 7.0, 0.9  # m, m/s², m/s
    s = knot_grid(200)

    def unit_inertia(s: Array) -> tuple[Array, Array, Array]:
        zero = np.zeros((len(s), 1))
        return zero, zero, np.full((len(s), 1), d)

    def duration(lower: float, upper: float, b_max: float = np.inf) -> float:
        answer, time = solved(motor_dynamics(s, unit_inertia, np.array([lower]), np.array([upper]), b_max))
        if np.isfinite(b_max):  # at the speed limit the acceleration does not oscillate from knot to knot
            middle = (s > 0.4) & (s < 0.6)
            assert np.abs(answer.a[middle]).max() * d < 1e-3 * a
            assert answer.b.max() <= b_max * (1 + 1e-7)
        return time

    assert duration(-a, a) == pytest.approx(2.0 * np.sqrt(d / a), rel=CLOSE)
    assert duration(-a, a, (v / d) ** 2) == pytest.approx(d / v + v / a, rel=CLOSE)
    assert duration(-3.0, a) == pytest.approx(np.sqrt(2.0 * d * (1.0 / a + 1.0 / 3.0)), rel=CLOSE)


@pytest.mark.parametrize(
    ("inertia", "weight", "limit", "start", "goal", "exact"),
    [
        (1.0, 1.0, 2.0, 0.0, 1.0, 1.3296929500),
        (1.0, 0.5, 1.0, -0.5, 1.5, 2.4893388243),
        (1e-3, 0.02, 0.05, 0.0, 1.2, 0.2928735884),
    ],
)
def test_one_joint_in_gravity_takes_the_exact_time(
    inertia: float, weight: float, limit: float, start: float, goal: float, exact: float
) -> None:
    """I θ̈ = u − mgl sin θ, |u| ≤ U: within 1e-4 on the finer of two grids, with a smaller error than on the coarser."""

    def pendulum(s: Array) -> tuple[Array, Array, Array]:
        theta = start + s * (goal - start)
        return weight * np.sin(theta)[:, None], np.zeros((len(s), 1)), np.full((len(s), 1), inertia * (goal - start))

    errors = []
    for intervals in (50, 200):
        _, time = solved(motor_dynamics(knot_grid(intervals), pendulum, np.array([-limit]), np.array([limit])))
        errors.append(abs(time / exact - 1.0))
    assert errors[1] < CLOSE
    assert errors[1] < errors[0]


# ── other contacts ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def pair(**changes: object) -> list[Contact]:
    """Return two contacts that press along x."""
    return [Contact([x, 0.0, 0.0], [-x, 0.0, 0.0], max_normal=MAX_NORMAL, **changes) for x in (-0.02, 0.02)]  # type: ignore[arg-type]


def test_soft_contacts_share_friction_between_force_and_moment() -> None:
    """With the centre of mass at a distance e from the line of the contacts, friction is 1/√(1/μ² + e²/γ²)."""
    mu, gamma, e = 0.5, 0.01, 0.006
    contacts = pair(friction=mu, model="soft", torsional_friction=gamma)
    task = IdealTask(Body(MASS, 1e-5 * AXES, np.array([0.0, e, 0.0])), ContactSet.stack(contacts))
    plan = plan_along(task, straight_move(0.0, 0.0, 1.0))
    assert isinstance(plan, Plan)
    most = 2.0 * MAX_NORMAL / np.hypot(1.0 / mu, e / gamma) / MASS  # m/s²
    assert plan.duration == pytest.approx(2.0 * np.sqrt(DISTANCE * most / (most**2 - GRAVITY**2)), rel=CLOSE)
    assert plan.check.verified


def test_point_contacts_cannot_supply_a_moment_about_their_line() -> None:
    """With gravity the object cannot be held; without, it cannot be accelerated."""
    body = Body(MASS, 1e-5 * AXES, np.array([0.0, 0.006, 0.0]))
    held = plan_along(IdealTask(body, ContactSet.stack(pair(friction=0.5))), straight_move(0.0, 0.0, 1.0))
    assert isinstance(held, PlanFailure)
    assert held.kind == UNHOLDABLE
    assert "moment about (1, 0, 0)" in held.reason
    floating = plan_along(
        IdealTask(body, ContactSet.stack(pair(friction=0.5)), gravity_H=np.zeros(3)), straight_move(0.0, 0.0, 1.0)
    )
    assert isinstance(floating, PlanFailure)
    assert floating.kind == IMMOVABLE
    assert "moment (1.00, 0.00, 0.00) N·m" in floating.reason.replace("-", "")


def test_frictionless_cage_takes_the_closed_form() -> None:
    """Six frictionless contacts along the axes: a = N/m along each; with a least force n at all contacts, (N − n)/m."""
    for least in (0.0, 2.0):
        contacts = [
            Contact(0.02 * side * axis, -side * axis, model="frictionless", min_normal=least, max_normal=MAX_NORMAL)  # type: ignore[arg-type]
            for axis in AXES
            for side in (-1.0, 1.0)
        ]
        plan = plan_along(IdealTask(Body(MASS, 1e-5 * AXES), ContactSet.stack(contacts)), straight_move(1.0, 0.0, 0.0))
        assert isinstance(plan, Plan)
        assert plan.duration == pytest.approx(2.0 * np.sqrt(DISTANCE * MASS / (MAX_NORMAL - least)), rel=CLOSE)
        assert plan.knots.f.min() > least - 1e-6


def test_torsional_friction_without_tangential_friction_takes_the_closed_form() -> None:
    """The cage is spun about x by the moments |m_n| ≤ γ f_n of two contacts."""
    gamma = 0.004
    contacts = (
        pair(friction=0.0, model="soft", torsional_friction=gamma)
        + [
            Contact(0.02 * side * axis, -side * axis, model="frictionless", max_normal=MAX_NORMAL)  # type: ignore[arg-type]
            for axis in AXES[1:]
            for side in (-1.0, 1.0)
        ]
    )
    spin = 2e-5  # kg·m²
    turned = Rotation.from_rotvec([1.0, 0.0, 0.0]).as_matrix()
    path = StraightPath(np.zeros(3), AXES, np.zeros(3), turned)
    plan = plan_along(IdealTask(Body(MASS, spin * AXES), ContactSet.stack(contacts)), path)
    assert isinstance(plan, Plan)
    assert plan.duration == pytest.approx(2.0 * np.sqrt(spin / (2.0 * gamma * MAX_NORMAL)), rel=CLOSE)
    assert plan.check.normal < 1e-3


@given(
    force=st.floats(-3, 4),
    distance=st.floats(-6, 1),
    weight=st.floats(0.0, 0.95),
    friction=st.floats(0.1, 1.5),
    up=st.booleans(),
)
@settings(max_examples=25, deadline=None)
def test_planning_is_invariant_to_units(force: float, distance: float, weight: float, friction: float, up: bool) -> None:
    """Forces from 1 mN to 10 kN, distances from 1 µm to 10 m, weights up to 95 % of the largest that friction holds."""
    largest, length, g = 10.0**force, 10.0**distance, 9.81
    mass = max(weight, 1e-3) * 2.0 * friction * largest / g  # kg
    most = 2.0 * friction * largest / mass  # m/s²
    contacts = [Contact([x, 0.0, 0.0], [-x, 0.0, 0.0], friction, max_normal=largest) for x in (-0.02, 0.02)]
    task = IdealTask(Body(mass, 1e-4 * mass * AXES), ContactSet.stack(contacts))
    goal = length * (AXES[2] if up else AXES[1])
    plan = plan_along(task, StraightPath(np.zeros(3), AXES, goal, AXES))
    assert isinstance(plan, Plan)
    root = np.sqrt(most**2 - g**2)
    exact = 2.0 * np.sqrt(length * most) / root if up else 2.0 * np.sqrt(length / root)
    assert plan.duration == pytest.approx(exact, rel=2e-4)  # for large weights braking takes a small part of an interval
    assert plan.check.verified
