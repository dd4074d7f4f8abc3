"""Free moves: closed forms, limits by the shared check, never slower than the straight path, and failures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import load
from support.planning_cases import (
    DISC,
    DISTANCE,
    FINGERS,
    FRICTION,
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
    random_move,
    star_grasp,
)

from graspforce import InvalidInput
from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.planning.check import SAMPLES_PER_INTERVAL, check, check_at_times, times_between
from graspforce.planning.failure import UNHOLDABLE, UNREACHABLE, PlanFailure
from graspforce.planning.fingers.plan_fingers import plan_fingers
from graspforce.planning.free.guess import guess_from_end_poses
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.free.program import object_move_program
from graspforce.planning.free.workspace import WorkspaceBounds
from graspforce.planning.loads import required_loads
from graspforce.planning.nlp.optimisers import FATROP, IPOPT, TOLERANCE, optimise
from graspforce.planning.path.paths import StraightPath
from graspforce.planning.path.plan_along import plan_along
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask, GraspTask, IdealTask
from graspforce.planning.time_scaling import slow_down_to_limits, static_forces
from graspforce.planning.trajectory import Trajectory

HANDS = list(FINGERS)
RANGES = {"four_finger": ((0.005, 0.008), 8.0)}  # m, °: distances and largest turn within its reach
NARROW = 1e-6  # m: half width of a workspace that leaves a straight line only


def poses(path: StraightPath) -> tuple[Array, Array]:
    """Return the positions (2, 3) and orientations (2, 3, 3) at both ends."""
    at = path.points(np.array([0.0, 1.0]))
    return at.p, at.R


def shortest(task: IdealTask, path: StraightPath, intervals: int, tolerance: float = TOLERANCE) -> float:
    """Return the duration that the solver finds for a straight line, without a check, ms.

    The weights of forces and of steps in acceleration are proportional to the solver's tolerance.
    """
    along = plan_along(task, path, settings=PlanSettings(intervals=intervals))
    assert isinstance(along, Plan)
    p = path.points(np.array([0.0, 1.0])).p
    workspace = WorkspaceBounds(p.min(axis=0) - NARROW, p.max(axis=0) + NARROW, 0.0)
    move = object_move_program(task, along.at_even_times(intervals), workspace)
    program = replace(move.program, weights=tolerance / TOLERANCE * move.program.weights)
    answer = optimise(program, move.guess, tolerance=tolerance)
    assert answer.converged
    return 1e3 * float(move.trajectory(answer.x).times[-1])


def along_x(angle: float) -> StraightPath:
    """Return a horizontal path of 0.1 m at an angle from the contacts' normals."""
    return StraightPath(np.zeros(3), np.eye(3), DISTANCE * np.array([np.cos(angle), np.sin(angle), 0.0]), np.eye(3))


CLOSED = {
    "lift": (StraightPath(np.zeros(3), np.eye(3), [0, 0, DISTANCE], np.eye(3)), LIFT),
    "lower": (StraightPath(np.zeros(3), np.eye(3), [0, 0, -DISTANCE], np.eye(3)), LIFT),
    "tangential": (along_x(np.pi / 2), TANGENTIAL),
    "normal": (along_x(0.0), NORMAL),
}


@pytest.mark.parametrize("name", CLOSED)
def test_block_between_two_fingers_takes_the_closed_form(name: str) -> None:
    """Within a thousandth at 40 intervals, with a smaller error than at 20."""
    path, exact = CLOSED[name]
    coarse, fine = (shortest(block(), path, intervals) / exact - 1.0 for intervals in (20, 40))
    assert abs(fine) < 1e-3
    assert abs(fine) < 0.6 * abs(coarse)


def uneven(stronger: float, weaker: float) -> IdealTask:
    """Return the block without gravity between fingers of different strength: one accelerates it along x, one brakes it."""
    contacts = [
        Contact([x, 0.0, 0.0], [-np.sign(x), 0.0, 0.0], FRICTION, max_normal=largest)
        for x, largest in ((-0.02, stronger), (0.02, weaker))
    ]
    return IdealTask(Body(MASS, 1e-5 * np.eye(3)), ContactSet.stack(contacts), gravity_H=np.zeros(3))


@pytest.mark.parametrize(("stronger", "weaker"), [(6.0, 2.0), (5.0, 2.0), (8.0, 1.0)])
def test_uneven_accelerations_take_the_closed_form(stronger: float, weaker: float) -> None:
    """√(2d (1/a₁ + 1/a₂)), to a thousandth at 40 intervals."""
    exact = 1e3 * np.sqrt(2.0 * DISTANCE * (MASS / stronger + MASS / weaker))
    assert shortest(uneven(stronger, weaker), along_x(0.0), 40) == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize(
    ("task", "angle", "exact", "ratio"),
    [
        (uneven(6.0, 2.0), 0.0, 1e3 * np.sqrt(2.0 * DISTANCE * MASS * (1.0 / 6.0 + 1.0 / 2.0)), 3.0),
        (block(), 0.0, 2e3 * np.sqrt(DISTANCE / (MAX_NORMAL / MASS - GRAVITY)), 1.0),
        (block(), np.pi / 2, 2e3 * np.sqrt(DISTANCE / np.sqrt(A**2 - GRAVITY**2)), 1.0),
    ],
    ids=["uneven", "normal", "tangential"],
)
def test_error_is_of_second_order_with_the_stated_factor(task: IdealTask, angle: float, exact: float, ratio: float) -> None:
    """(a₁ + a₂)²/(6 a₁ a₂ K²) for a step at a knot, except for higher orders and the weights."""
    factor = (1.0 + ratio) ** 2 / (6.0 * ratio)
    for intervals in (8, 16, 32):
        error = shortest(task, along_x(angle), intervals, tolerance=1e-7) / exact - 1.0
        assert intervals**2 * error == pytest.approx(factor, rel=0.05)


def test_oblique_move_takes_the_closed_form() -> None:
    """The workspace is aligned with H, so that the fingers are rotated instead of the path."""
    turn = Rotation.from_rotvec([0.0, 0.0, -np.pi / 6]).as_matrix()
    straight = block()
    contacts = [
        Contact(turn @ p, turn @ R[:, 2], mu, max_normal=most)
        for p, R, mu, most in zip(
            straight.contacts.p_OC, straight.contacts.R_OC, straight.contacts.mu, straight.contacts.max_normal, strict=True
        )
    ]
    task = IdealTask(straight.body, ContactSet.stack(contacts))
    assert shortest(task, along_x(0.0), 40) == pytest.approx(OBLIQUE, rel=1e-3)


def test_disc_between_three_fingers_takes_the_closed_form() -> None:
    task, path = disc()
    p = np.full(3, NARROW)
    along = plan_along(task, path, settings=PlanSettings(intervals=40))
    assert isinstance(along, Plan)
    move = object_move_program(task, along.at_even_times(40), WorkspaceBounds(-p, p, 0.01))
    answer = optimise(move.program, move.guess)
    assert 1e3 * float(move.trajectory(answer.x).times[-1]) == pytest.approx(DISC, rel=1e-3)
    free = plan_free(
        task, *poses(path), settings=PlanSettings(intervals=40)
    )  # a small fall leaves more friction for the rotation
    assert isinstance(free, Plan)
    assert 0.99 * DISC < 1e3 * free.duration < DISC


def by_both(along: Plan) -> list[float]:
    """Return the durations that both solvers find from a plan along a path, s."""
    move = object_move_program(along.task, along.at_even_times(20))
    answers = [optimise(move.program, move.guess, solver) for solver in (IPOPT, FATROP)]
    assert all(answer.converged for answer in answers)
    return [float(move.trajectory(answer.x).times[-1]) for answer in answers]


def test_fatrop_equals_ipopt() -> None:
    along = plan_along(*disc(), settings=PlanSettings(intervals=20))
    assert isinstance(along, Plan)
    times = by_both(along)
    assert times[0] == pytest.approx(times[1], rel=1e-4)


# ── hands ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def moves(name: str, count: int, seed: int, rolling: bool = False) -> list[tuple[GraspTask, StraightPath, Array]]:
    """Return random moves along which the fingers can follow; by default without rolling, whose programs are smaller."""
    task, middle, q = star_grasp(load(name))
    task = replace(task, rolling=rolling)
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        path = random_move(rng, middle, *RANGES.get(name, ((0.005, 0.02), 20.0)))
        if plan_along(task, path, q, settings=PlanSettings(intervals=20)).found:
            found.append((task, path, q))
    return found


def test_fatrop_equals_ipopt_with_rolling_contacts() -> None:
    """To the solvers' tolerances, at most 1e-3 each, and fatrop's additional weights."""
    ((task, path, q),) = moves("dlr_hit2", 1, 7, rolling=True)
    along = plan_along(task, path, q, settings=PlanSettings(intervals=20))
    assert isinstance(along, Plan)
    times = by_both(along)
    assert times[0] == pytest.approx(times[1], rel=2e-3)
    assert max(times) < 0.99 * along.duration


@pytest.mark.parametrize(("name", "rolling"), [*((name, False) for name in HANDS), ("dlr_hit2", True)])
def test_free_move_keeps_every_limit_and_is_never_slower_than_straight(name: str, rolling: bool) -> None:
    gains = []
    for task, path, q in moves(name, 1 if rolling else 2, 2, rolling):
        free, along = plan_free(task, *poses(path), q), plan_along(task, path, q, settings=PlanSettings(intervals=40))
        assert isinstance(free, Plan)
        assert isinstance(along, Plan)
        assert free.duration <= along.duration * (1.0 + 1e-12)
        assert free.check.verified
        finer = check_at_times(free, times_between(free.knots.times, 4 * SAMPLES_PER_INTERVAL - 1))
        assert finer.excess < 1.01e-3  # the check is accurate to a hundredth of the tolerance
        assert finer.drift < 1e-6
        p_HO, R_HO = poses(path)
        assert free.knots.p_HO[[0, -1]] == pytest.approx(p_HO, abs=1e-8)
        assert free.knots.R_HO[-1] == pytest.approx(R_HO[1], abs=1e-7)
        for end in (0, -1):
            assert np.abs(free.knots.twist[end]).max() < 1e-6
            assert np.abs(free.knots.v[end]).max() < 1e-5
        gains.append(1.0 - free.duration / along.duration)
    assert max(gains) > 0.0


@pytest.fixture(scope="module")
def free_plan() -> Plan:
    """Return a plan that is faster than the straight path."""
    task, path, q = moves("allegro_right", 1, 1)[0]
    plan = plan_free(task, *poses(path), q)
    assert isinstance(plan, Plan)
    assert plan.s.size == 0
    return plan


def test_states_are_consistent_derivatives(free_plan: Plan) -> None:
    dt = 1e-4 * free_plan.duration
    t = np.linspace(0.02, 0.98, 40) * free_plan.duration
    before, here, after = (free_plan.at(t + d) for d in (-dt, 0.0, dt))
    assert (after.q - before.q) / (2 * dt) == pytest.approx(here.v, abs=1e-4 * np.abs(here.v).max())
    assert (after.p_HO - before.p_HO) / (2 * dt) == pytest.approx(here.twist[:, :3], abs=1e-5)
    assert np.isnan(free_plan.optimality_gap)
    assert free_plan.to_dict()["gap"] is None


def test_plan_satisfies_the_equations_of_the_program(free_plan: Plan) -> None:
    """Contacts, G f = w, cones, and torques by the hand's own dynamics."""
    task = free_plan.task
    knots = free_plan.at(free_plan.duration * np.linspace(0.0, 1.0, 9))
    move = object_move_program(task, knots)
    back = move.trajectory(move.guess)
    for name in Trajectory.__slots__:
        if name != "tau":  # interpolated in the plan, by the hand's dynamics here
            assert getattr(back, name) == pytest.approx(getattr(knots, name), abs=1e-9), name
    structure, hand = move.program.structure, task.hand
    for name, placed, numbers in zip(task.fingers, structure.equations, move.program.parameter_values, strict=False):
        joints = list(hand.finger(name).joints)
        for k in (2, 5):
            g = np.array(placed.equations.value(move.guess[k, list(placed.variables)], numbers)).ravel()
            assert g[:3] == pytest.approx(0.0, abs=1e-6)
            assert g[9 : 9 + len(joints)] == pytest.approx(back.tau[k, joints] / hand.torque_upper[joints], abs=1e-9)
            f = back.f[k].reshape(-1, 3)[task.fingers.index(name)] / move.variables.scales.force
            assert g[-2] == pytest.approx(f[2], abs=1e-9)
            assert g[-1] == pytest.approx((0.6 * f[2]) ** 2 - f[0] ** 2 - f[1] ** 2, abs=1e-9)


def test_workspace_is_kept() -> None:
    """It excludes the fastest path."""
    task, path, q = moves("allegro_right", 1, 1)[0]
    p_HO, _ = poses(path)
    workspace = WorkspaceBounds(p_HO.min(axis=0) - 1e-4, p_HO.max(axis=0) + 1e-4, 0.01)
    plan = plan_free(task, *poses(path), q, workspace=workspace)
    assert isinstance(plan, Plan)
    assert (plan.knots.p_HO >= workspace.lower - 1e-6).all()
    assert (plan.knots.p_HO <= workspace.upper + 1e-6).all()


def test_plan_beyond_its_limits_is_slowed_just_enough(free_plan: Plan) -> None:
    """Run 2 % too fast, a plan exceeds its limits; slowed down it keeps them and is little slower than before."""
    knots, rate = free_plan.knots, 1.02
    rest_forces = static_forces(free_plan.task, knots)
    assert rest_forces is not None
    f = rest_forces + rate**2 * (knots.f - rest_forces)
    fast = replace(
        knots,
        times=knots.times / rate,
        v=rate * knots.v,
        a=rate**2 * knots.a,
        f=f,
        twist=rate * knots.twist,
        acceleration=rate**2 * knots.acceleration,
    )
    too_fast = replace(free_plan, knots=fast)
    too_fast = replace(too_fast, check=check(too_fast)[0])
    assert not too_fast.check.verified
    assert too_fast.check.unmet < 1e-9  # the forces still give the motion
    slowed = slow_down_to_limits(too_fast, 1e-3)
    assert slowed is not None
    assert slowed.check.verified
    assert too_fast.duration < slowed.duration < 1.05 * free_plan.duration
    assert 0.7e-3 < slowed.check.excess < 1e-3  # not slower than necessary
    assert check_at_times(slowed, times_between(slowed.knots.times, 4 * SAMPLES_PER_INTERVAL - 1)).excess < 1e-3
    w = required_loads(slowed.task, slowed.knots).imbalance  # interpolated forces give the motion too
    assert np.abs(w).max() < 1e-9
    assert slow_down_to_limits(free_plan, 1e-3) is free_plan


# ── failures ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_goal_out_of_reach_names_the_finger() -> None:
    task, path, q = moves("dlr_hit2", 1, 1)[0]
    (start, _), (R, _) = poses(path)
    far = plan_free(task, [start, start + np.array([0.0, 0.0, 0.3])], [R, R], q)
    assert isinstance(far, PlanFailure)
    assert far.kind == UNREACHABLE
    assert far.reason.startswith("At the goal, the contact of thumb must be within reach of thumb")
    assert far.s == 1.0


def test_search_finds_a_path_where_the_straight_one_cannot_be_followed() -> None:
    """On the straight path a joint leaves its range; the fourth joint of each finger prevents it."""
    task, middle, q = star_grasp(load("allegro_right"))
    task = replace(task, rolling=False)
    rng = np.random.default_rng(5)
    path = [random_move(rng, middle, (0.01, 0.03), 35.0) for _ in range(106)][-1]
    along = plan_along(task, path, q, settings=PlanSettings(intervals=40))
    assert isinstance(along, PlanFailure)
    assert along.joint is not None
    plan = plan_free(task, *poses(path), q)
    assert isinstance(plan, Plan)
    assert plan.check.verified
    assert plan.check.position <= plan.check.tolerance
    guess = guess_from_end_poses(task, path, q, 40)
    assert isinstance(guess, Trajectory)
    assert guess.p_HO[-1] == pytest.approx(path.points(np.ones(1)).p[0], abs=1e-12)
    assert plan.duration < guess.times[-1]  # the guess is slow


def test_object_too_heavy_to_hold_names_the_limit() -> None:
    task, path, q = moves("dlr_hit2", 1, 1)[0]
    heavy = replace(task, body=replace(task.body, mass=50.0, inertia=1e3 * task.body.inertia))
    failure = plan_free(heavy, *poses(path), q)
    assert isinstance(failure, PlanFailure)
    assert failure.kind == UNHOLDABLE
    assert failure.s == 0.0
    assert failure.reason.startswith("At the start the object cannot be held still.")
    assert "the torque limits of joints" in failure.reason


def test_slip_margin_is_kept_and_never_saves_time() -> None:
    task, path, q = moves("allegro_right", 1, 1)[0]
    plain = plan_free(task, *poses(path), q)
    careful = plan_free(replace(task, slip_margin=0.2), *poses(path), q)
    assert isinstance(plain, Plan)
    assert isinstance(careful, Plan)
    f = careful.knots.f.reshape(len(careful.knots.times), -1, 3)
    assert (0.6 * f[:, :, 2] - np.hypot(f[:, :, 0], f[:, :, 1])).min() > 0.2 - 0.005  # N; a thousandth of the largest friction
    assert careful.duration > plain.duration * (1.0 - 1e-3)  # to the solver's tolerance


def test_duration_converges_with_the_grid() -> None:
    """The error is of second order: about a per cent at 20 intervals, a part of that at 40."""
    task, path, q = moves("dlr_hit2", 1, 1)[0]
    along = plan_along(task, path, q, settings=PlanSettings(intervals=40))
    assert isinstance(along, Plan)
    times = []
    for intervals in (10, 20, 40):
        move = object_move_program(task, along.at_even_times(intervals))
        times.append(float(move.trajectory(optimise(move.program, move.guess).x).times[-1]))
    assert 0.0 < times[1] - times[2] < 0.5 * (times[0] - times[1])
    assert times[1] == pytest.approx(times[2], rel=0.02)


def test_invalid_task_names_its_field() -> None:
    pose = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]), np.tile(np.eye(3), (2, 1, 1))
    straight = block()
    slippery = [Contact([x, 0, 0], [-np.sign(x), 0, 0], model="frictionless") for x in (-0.02, 0.02)]
    with pytest.raises(InvalidInput, match=r"contacts\[0\].model = 'frictionless'.*a point or soft contact with friction"):
        plan_free(IdealTask(straight.body, ContactSet.stack(slippery)), *pose)
    with pytest.raises(InvalidInput, match="plan_fingers plans fingers alone"):
        plan_free(FingerTask(load("dlr_hit2")), *pose)
    with pytest.raises(InvalidInput, match="plan_free plans a move of an object"):
        plan_fingers(straight, [], [])
