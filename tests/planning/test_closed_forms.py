"""Minimum times with closed forms, and the order in which the grid converges to them."""

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

CLOSE = 1e-4  # relative: what 100 intervals reach, a being linear, not broken, where the closed form breaks it
MS = 1e-3
SLANT = np.deg2rad(30.0)


def planned(x: float, y: float, z: float, intervals: int = 100) -> Plan:
    plan = plan_along(block(), straight_move(x, y, z), settings=PlanSettings(intervals=intervals))
    assert isinstance(plan, Plan)
    return plan


def solved(dynamics: PathDynamics) -> tuple[PathSolution, float]:
    """Return a program's answer and the duration of the motion that it describes."""
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
def test_a_block_between_two_fingers(name: str) -> None:
    """The facts' closed forms, to what 100 intervals reach."""
    direction, milliseconds = CASES[name]
    plan = planned(*direction)
    assert plan.check.verified
    assert plan.duration == pytest.approx(milliseconds * MS, rel=CLOSE)
    assert plan.optimality_gap < 1e-6  # the solver's tolerance, 1e-8, on a scale on which the time is of order 1


def test_the_closed_forms_are_those_of_the_facts() -> None:
    root = np.sqrt(A**2 - GRAVITY**2)
    assert 2.0 * np.sqrt(DISTANCE * A) / root == pytest.approx(LIFT * MS, rel=1e-6)
    assert 2.0 * np.sqrt(DISTANCE / root) == pytest.approx(TANGENTIAL * MS, rel=1e-6)
    assert 2.0 * np.sqrt(DISTANCE / (MAX_NORMAL / MASS - GRAVITY)) == pytest.approx(NORMAL * MS, rel=1e-6)


@pytest.mark.parametrize("name", ["tangential", "normal", "oblique"])
def test_the_error_falls_with_the_square_of_the_grid(name: str) -> None:
    """The one break of the acceleration falls on a knot, so halving the intervals quarters the error."""
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
    """Return the smaller root of a² sin²θ + g² = 4μ² (N/m − a cos θ)²."""
    c, s = np.cos(SLANT), np.sin(SLANT)
    most = strength * MAX_NORMAL / MASS  # m/s²; 4μ² = 1
    roots = np.roots([s**2 - c**2, 2.0 * most * c, GRAVITY**2 - most**2])
    return float(min(root for root in roots if root > 0))


def test_a_disc_spun_between_three_fingers() -> None:
    plan = plan_along(*disc())
    assert isinstance(plan, Plan)
    assert plan.check.verified
    assert plan.duration == pytest.approx(DISC * MS, rel=CLOSE)


def test_friction_that_is_kept_back_is_there_at_every_instant_and_costs_its_time() -> None:
    """Keeping back ν of μN in the horizontal tangential move leaves a = √(A'² − g²), A' = 2 (μN − ν)/m."""
    margin = 0.4  # N
    plan = plan_along(block(slip_margin=margin), straight_move(0.0, 1.0, 0.0))
    assert isinstance(plan, Plan)
    left = 2.0 * (MAX_NORMAL * 0.5 - margin) / MASS
    assert plan.duration == pytest.approx(2.0 * np.sqrt(DISTANCE / np.sqrt(left**2 - GRAVITY**2)), rel=CLOSE)
    f = plan.at(np.linspace(0.0, plan.duration, 777)).f.reshape(-1, 2, 3)
    spare = 0.5 * f[:, :, 2] - np.hypot(f[:, :, 0], f[:, :, 1])
    assert spare.min() == pytest.approx(margin, abs=1e-6)


def test_speed_caps_and_uneven_motors() -> None:
    """A double integrator over d: 2√(d/a); with a cap on speed d/v + v/a; with a₁ and a₂ √(2d (1/a₁ + 1/a₂))."""
    d, a, v = 0.3, 7.0, 0.9  # m, m/s², m/s
    s = knot_grid(200)

    def mass_one(s: Array) -> tuple[Array, Array, Array]:
        zero = np.zeros((len(s), 1))
        return zero, zero, np.full((len(s), 1), d)

    def duration(lower: float, upper: float, b_max: float = np.inf) -> float:
        answer, time = solved(motor_dynamics(s, mass_one, np.array([lower]), np.array([upper]), b_max))
        if np.isfinite(b_max):  # on the cap the acceleration is zero: it does not ring from knot to knot
            flat = (s > 0.4) & (s < 0.6)
            assert np.abs(answer.a[flat]).max() * d < 1e-3 * a
            assert answer.b.max() <= b_max * (1 + 1e-7)
        return time

    assert duration(-a, a) == pytest.approx(2.0 * np.sqrt(d / a), rel=CLOSE)
    assert duration(-a, a, (v / d) ** 2) == pytest.approx(d / v + v / a, rel=CLOSE)
    assert duration(-3.0, a) == pytest.approx(np.sqrt(2.0 * d * (1.0 / a + 1.0 / 3.0)), rel=CLOSE)


@pytest.mark.parametrize(
    ("inertia", "weight", "most", "start", "goal", "exact"),
    [
        (1.0, 1.0, 2.0, 0.0, 1.0, 1.3296929500),
        (1.0, 0.5, 1.0, -0.5, 1.5, 2.4893388243),
        (1e-3, 0.02, 0.05, 0.0, 1.2, 0.2928735884),
    ],
)
def test_one_joint_with_gravity(inertia: float, weight: float, most: float, start: float, goal: float, exact: float) -> None:
    """I θ̈ = u − mgl sin θ, |u| ≤ U. Two grids: within 1e-4 on the finer one, and nearer than on the coarser."""

    def pendulum(s: Array) -> tuple[Array, Array, Array]:
        theta = start + s * (goal - start)
        return weight * np.sin(theta)[:, None], np.zeros((len(s), 1)), np.full((len(s), 1), inertia * (goal - start))

    errors = []
    for intervals in (50, 200):
        _, time = solved(motor_dynamics(knot_grid(intervals), pendulum, np.array([-most]), np.array([most])))
        errors.append(abs(time / exact - 1.0))
    assert errors[1] < CLOSE
    assert errors[1] < errors[0]


# ── other contacts ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def pair(**changes: object) -> list[Contact]:
    """Two fingers that press along x."""
    return [Contact([x, 0.0, 0.0], [-x, 0.0, 0.0], max_normal=MAX_NORMAL, **changes) for x in (-0.02, 0.02)]  # type: ignore[arg-type]


def test_soft_fingers_bear_a_moment_about_their_normals_with_the_same_friction() -> None:
    """A centre of mass e off the fingers' line: each bears F/2 and F e/2, so that friction is as 1/√(1/μ² + e²/γ²)."""
    mu, gamma, off = 0.5, 0.01, 0.006
    contacts = pair(friction=mu, model="soft", torsional_friction=gamma)
    task = IdealTask(Body(MASS, 1e-5 * AXES, np.array([0.0, off, 0.0])), ContactSet.stack(contacts))
    plan = plan_along(task, straight_move(0.0, 0.0, 1.0))
    assert isinstance(plan, Plan)
    most = 2.0 * MAX_NORMAL / np.hypot(1.0 / mu, off / gamma) / MASS  # m/s²
    assert plan.duration == pytest.approx(2.0 * np.sqrt(DISTANCE * most / (most**2 - GRAVITY**2)), rel=CLOSE)
    assert plan.check.verified


def test_point_fingers_cannot_bear_that_moment_and_say_so() -> None:
    """At rest under gravity already; and without gravity as soon as it moves."""
    body = Body(MASS, 1e-5 * AXES, np.array([0.0, 0.006, 0.0]))
    held = plan_along(IdealTask(body, ContactSet.stack(pair(friction=0.5))), straight_move(0.0, 0.0, 1.0))
    assert isinstance(held, PlanFailure)
    assert held.kind == UNHOLDABLE
    assert "moment about (1, 0, 0)" in held.reason
    afloat = plan_along(
        IdealTask(body, ContactSet.stack(pair(friction=0.5)), gravity_H=np.zeros(3)), straight_move(0.0, 0.0, 1.0)
    )
    assert isinstance(afloat, PlanFailure)
    assert afloat.kind == IMMOVABLE
    assert "moment (1.00, 0.00, 0.00) N·m" in afloat.reason.replace("-", "")


def test_a_cage_without_friction_and_fingers_that_must_keep_pressing() -> None:
    """Six frictionless fingers along the axes: a = N/m along any of them; with a least force n on all, (N − n)/m."""
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


def test_a_contact_that_may_only_twist() -> None:
    """No tangential friction but a moment about the normal: the cage, spun about x by |m_n| ≤ γ f_n of two fingers."""
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
def test_millinewtons_and_micrometres_are_planned_as_newtons_and_metres_are(
    force: float, distance: float, weight: float, friction: float, up: bool
) -> None:
    """Lift and sideways, forces from 1 mN to 10 kN, ways from 1 µm to 10 m, weights up to 95 % of what friction can hold."""
    largest, way_length, g = 10.0**force, 10.0**distance, 9.81
    mass = max(weight, 1e-3) * 2.0 * friction * largest / g  # kg
    most = 2.0 * friction * largest / mass  # m/s²
    contacts = [Contact([x, 0.0, 0.0], [-x, 0.0, 0.0], friction, max_normal=largest) for x in (-0.02, 0.02)]
    task = IdealTask(Body(mass, 1e-4 * mass * AXES), ContactSet.stack(contacts))
    goal = way_length * (AXES[2] if up else AXES[1])
    plan = plan_along(task, StraightPath(np.zeros(3), AXES, goal, AXES))
    assert isinstance(plan, Plan)
    root = np.sqrt(most**2 - g**2)
    exact = 2.0 * np.sqrt(way_length * most) / root if up else 2.0 * np.sqrt(way_length / root)
    assert plan.duration == pytest.approx(exact, rel=2e-4)  # near what friction holds the brake is short beside its intervals
    assert plan.check.verified
