"""Moves whichever way they go: closed forms, laws through the shared check, never slower than the straight path, words."""

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
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.grasp.body import Body
from graspforce.planning.check import SAMPLES_PER_INTERVAL, check, check_at_times, times_between
from graspforce.planning.failure import UNHOLDABLE, UNREACHABLE, PlanFailure
from graspforce.planning.fingers.obstacles import Obstacle
from graspforce.planning.fingers.plan_fingers import plan_fingers
from graspforce.planning.free.guess import guess_from_end_poses
from graspforce.planning.free.object_equations import finger_equations, object_equations
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.free.program import object_move_program
from graspforce.planning.free.workspace import WorkspaceBounds
from graspforce.planning.loads import required_loads
from graspforce.planning.nlp.machine_code import cache_folder, compile_equations
from graspforce.planning.nlp.optimisers import FATROP, IPOPT, TOLERANCE, optimise
from graspforce.planning.path.paths import JointPath, StraightPath
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask, GraspTask, IdealTask
from graspforce.planning.time_scaling import slow_down_to_limits, static_forces
from graspforce.planning.trajectory import Trajectory

HANDS = list(FINGERS)
ROOM = {"four_finger": ((0.005, 0.008), 8.0)}  # m, °: its tips have a few millimetres before a finger is stretched
NARROW = 1e-6  # m: a room no wider than this leaves a straight line


def poses(path: StraightPath) -> tuple[Array, Array]:
    """Return the positions (2, 3) and orientations (2, 3, 3) at both ends."""
    at = path.points(np.array([0.0, 1.0]))
    return at.p, at.R


def shortest(task: IdealTask, path: StraightPath, intervals: int, tolerance: float = TOLERANCE) -> float:
    """Return the program's own answer along a straight line, before any check and comparison, ms.

    What its weights on forces and on steps of the acceleration cost goes with the solver's tolerance.
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
    """0.1 m, horizontally, at an angle from the contacts' normals."""
    return StraightPath(np.zeros(3), np.eye(3), DISTANCE * np.array([np.cos(angle), np.sin(angle), 0.0]), np.eye(3))


CLOSED = {
    "lift": (StraightPath(np.zeros(3), np.eye(3), [0, 0, DISTANCE], np.eye(3)), LIFT),
    "lower": (StraightPath(np.zeros(3), np.eye(3), [0, 0, -DISTANCE], np.eye(3)), LIFT),
    "tangential": (along_x(np.pi / 2), TANGENTIAL),
    "normal": (along_x(0.0), NORMAL),
}


@pytest.mark.parametrize("name", CLOSED)
def test_a_block_between_two_fingers_takes_as_long_as_its_closed_form_says(name: str) -> None:
    """Within a thousandth at 40 intervals, and nearer with more."""
    path, exact = CLOSED[name]
    coarse, fine = (shortest(block(), path, intervals) / exact - 1.0 for intervals in (20, 40))
    assert abs(fine) < 1e-3
    assert abs(fine) < 0.6 * abs(coarse)


def uneven(most: float, least: float) -> IdealTask:
    """Return a block between two fingers of different strength: one pushes it along x, the other brakes it."""
    contacts = [
        Contact([x, 0.0, 0.0], [-np.sign(x), 0.0, 0.0], FRICTION, max_normal=largest)
        for x, largest in ((-0.02, most), (0.02, least))
    ]
    return IdealTask(Body(MASS, 1e-5 * np.eye(3)), ContactSet.stack(contacts), gravity_H=np.zeros(3))


@pytest.mark.parametrize(("most", "least"), [(6.0, 2.0), (5.0, 2.0), (8.0, 1.0)])
def test_a_block_pushed_harder_than_it_is_braked(most: float, least: float) -> None:
    """√(2d (1/a₁ + 1/a₂)): to a thousandth, 40 intervals."""
    exact = 1e3 * np.sqrt(2.0 * DISTANCE * (MASS / most + MASS / least))
    assert shortest(uneven(most, least), along_x(0.0), 40) == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize(
    ("task", "angle", "exact", "ratio"),
    [
        (uneven(6.0, 2.0), 0.0, 1e3 * np.sqrt(2.0 * DISTANCE * MASS * (1.0 / 6.0 + 1.0 / 2.0)), 3.0),
        (block(), 0.0, 2e3 * np.sqrt(DISTANCE / (MAX_NORMAL / MASS - GRAVITY)), 1.0),
        (block(), np.pi / 2, 2e3 * np.sqrt(DISTANCE / np.sqrt(A**2 - GRAVITY**2)), 1.0),
    ],
    ids=["uneven", "normal", "tangential"],
)
def test_the_error_is_of_second_order_and_as_large_as_stated(task: IdealTask, angle: float, exact: float, ratio: float) -> None:
    """(a₁ + a₂)²/(6 a₁ a₂ K²) where the jump falls on a knot, but for the next order and the cost of the weights."""
    stated = (1.0 + ratio) ** 2 / (6.0 * ratio)
    for intervals in (8, 16, 32):
        error = shortest(task, along_x(angle), intervals, tolerance=1e-7) / exact - 1.0
        assert intervals**2 * error == pytest.approx(stated, rel=0.05)


def test_a_block_moved_obliquely() -> None:
    """A room with its edges along H cannot hold it to an oblique line, so gravity and the fingers are turned instead."""
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


def test_a_disc_spun_between_three_fingers() -> None:
    task, path = disc()
    p = np.full(3, NARROW)
    along = plan_along(task, path, settings=PlanSettings(intervals=40))
    assert isinstance(along, Plan)
    move = object_move_program(task, along.at_even_times(40), WorkspaceBounds(-p, p, 0.01))
    answer = optimise(move.program, move.guess)
    assert 1e3 * float(move.trajectory(answer.x).times[-1]) == pytest.approx(DISC, rel=1e-3)
    free = plan_free(
        task, *poses(path), settings=PlanSettings(intervals=40)
    )  # falling a little while it spins leaves more friction for the spin
    assert isinstance(free, Plan)
    assert 0.99 * DISC < 1e3 * free.duration < DISC


def by_both(along: Plan) -> list[float]:
    """Return the durations that both solvers find from a plan along a path, s."""
    move = object_move_program(along.task, along.at_even_times(20))
    answers = [optimise(move.program, move.guess, solver) for solver in (IPOPT, FATROP)]
    assert all(answer.converged for answer in answers)
    return [float(move.trajectory(answer.x).times[-1]) for answer in answers]


def test_fatrop_finds_the_same() -> None:
    along = plan_along(*disc(), settings=PlanSettings(intervals=20))
    assert isinstance(along, Plan)
    times = by_both(along)
    assert times[0] == pytest.approx(times[1], rel=1e-4)


# ── hands ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def moves(name: str, count: int, seed: int, rolling: bool = False) -> list[tuple[GraspTask, StraightPath, Array]]:
    """Random moves along which the fingers can follow; by default of contacts that stay, whose programs are smaller."""
    task, middle, q = star_grasp(load(name))
    task = replace(task, rolling=rolling)
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        path = random_move(rng, middle, *ROOM.get(name, ((0.005, 0.02), 20.0)))
        if plan_along(task, path, q, settings=PlanSettings(intervals=20)).found:
            found.append((task, path, q))
    return found


def test_fatrop_finds_the_same_where_contacts_roll() -> None:
    """To what both solvers' tolerances leave, 1e-3 each at most, and fatrop's own weights."""
    ((task, path, q),) = moves("dlr_hit2", 1, 7, rolling=True)
    along = plan_along(task, path, q, settings=PlanSettings(intervals=20))
    assert isinstance(along, Plan)
    times = by_both(along)
    assert times[0] == pytest.approx(times[1], rel=2e-3)
    assert max(times) < 0.99 * along.duration


@pytest.mark.parametrize(("name", "rolling"), [*((name, False) for name in HANDS), ("dlr_hit2", True)])
def test_free_moves_keep_every_limit_and_are_never_slower(name: str, rolling: bool) -> None:
    gained = []
    for task, path, q in moves(name, 1 if rolling else 2, 1, rolling):
        free, along = plan_free(task, *poses(path), q), plan_along(task, path, q, settings=PlanSettings(intervals=40))
        assert isinstance(free, Plan)
        assert isinstance(along, Plan)
        assert free.duration <= along.duration * (1.0 + 1e-12)
        assert free.check.verified
        finer = check_at_times(free, times_between(free.knots.times, 4 * SAMPLES_PER_INTERVAL - 1))
        assert finer.excess < 1.01e-3  # the check is right to a hundredth of this tolerance
        assert finer.drift < 1e-6
        p_HO, R_HO = poses(path)
        assert free.knots.p_HO[[0, -1]] == pytest.approx(p_HO, abs=1e-8)
        assert free.knots.R_HO[-1] == pytest.approx(R_HO[1], abs=1e-7)
        for end in (0, -1):
            assert np.abs(free.knots.twist[end]).max() < 1e-6
            assert np.abs(free.knots.v[end]).max() < 1e-5
        gained.append(1.0 - free.duration / along.duration)
    assert max(gained) > 0.0  # a freedom that is worth something


@pytest.fixture(scope="module")
def freely() -> Plan:
    """Return a move that is not the straight path's."""
    task, path, q = moves("allegro_right", 1, 1)[0]
    plan = plan_free(task, *poses(path), q)
    assert isinstance(plan, Plan)
    assert plan.s.size == 0
    return plan


def test_states_are_each_other_s_derivatives(freely: Plan) -> None:
    dt = 1e-4 * freely.duration
    t = np.linspace(0.02, 0.98, 40) * freely.duration
    before, here, after = (freely.at(t + d) for d in (-dt, 0.0, dt))
    assert (after.q - before.q) / (2 * dt) == pytest.approx(here.v, abs=1e-4 * np.abs(here.v).max())
    assert (after.p_HO - before.p_HO) / (2 * dt) == pytest.approx(here.twist[:, :3], abs=1e-5)
    assert np.isnan(freely.optimality_gap)
    assert freely.to_dict()["gap"] is None


def test_the_program_s_equations_are_the_hand_s(freely: Plan) -> None:
    """Put a checked plan into the program: closure, G f = w and torques as the hand's own dynamics have them."""
    task = freely.task
    knots = freely.at(freely.duration * np.linspace(0.0, 1.0, 9))
    move = object_move_program(task, knots)
    back = move.trajectory(move.guess)
    for name in Trajectory.__slots__:
        if name != "tau":  # between the plan's knots torques are its interpolation's, here the hand's
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


def test_a_room_is_kept_to() -> None:
    """It shuts out the way that is fastest."""
    task, path, q = moves("allegro_right", 1, 1)[0]
    p_HO, _ = poses(path)
    workspace = WorkspaceBounds(p_HO.min(axis=0) - 1e-4, p_HO.max(axis=0) + 1e-4, 0.01)
    plan = plan_free(task, *poses(path), q, workspace=workspace)
    assert isinstance(plan, Plan)
    assert (plan.knots.p_HO >= workspace.lower - 1e-6).all()
    assert (plan.knots.p_HO <= workspace.upper + 1e-6).all()


def test_a_plan_in_too_much_haste_is_slowed_just_enough(freely: Plan) -> None:
    """Run 2 % too fast it breaks its limits; slowed, it keeps them, and is not much slower than it was."""
    knots, rate = freely.knots, 1.02
    resting = static_forces(freely.task, knots)
    assert resting is not None
    f = resting + rate**2 * (knots.f - resting)
    fast = replace(
        knots,
        times=knots.times / rate,
        v=rate * knots.v,
        a=rate**2 * knots.a,
        f=f,
        twist=rate * knots.twist,
        acceleration=rate**2 * knots.acceleration,
    )
    hasty = replace(freely, knots=fast)
    hasty = replace(hasty, check=check(hasty)[0])
    assert not hasty.check.verified
    assert hasty.check.unmet < 1e-9  # the forces still make the motion
    mended = slow_down_to_limits(hasty, 1e-3)
    assert mended is not None
    assert mended.check.verified
    assert hasty.duration < mended.duration < 1.05 * freely.duration
    assert 0.7e-3 < mended.check.excess < 1e-3  # by no more than it had to be
    assert check_at_times(mended, times_between(mended.knots.times, 4 * SAMPLES_PER_INTERVAL - 1)).excess < 1e-3
    w = required_loads(mended.task, mended.knots).imbalance  # forces between those sought make the motion as those sought do
    assert np.abs(w).max() < 1e-9
    assert slow_down_to_limits(freely, 1e-3) is freely


def test_compiled_equations_answer_the_same(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compile_equations.cache_clear()
    e = object_equations((False, True))
    machine = compile_equations(e)
    rng = np.random.default_rng(0)
    x, p, lam = rng.normal(size=e.variable_count), rng.normal(size=e.parameter_count), rng.normal(size=e.row_count)
    for ours, theirs in ((machine.value, e.value), (machine.jacobian_values, e.jacobian_values)):
        assert np.array(ours(x, p)) == pytest.approx(np.array(theirs(x, p)), rel=1e-12, abs=1e-12)
    for ours, theirs in zip(machine.lagrangian_derivatives(x, p, lam), e.lagrangian_derivatives(x, p, lam), strict=True):
        assert np.array(ours) == pytest.approx(np.array(theirs), rel=1e-12, abs=1e-12)
    if machine is not e:
        assert len(list(cache_folder().glob("*.so"))) == 1
    monkeypatch.setenv("CC", "no-such-compiler")
    compile_equations.cache_clear()
    assert compile_equations(e) is e
    compile_equations.cache_clear()


def test_equations_are_kept_for_the_next_move() -> None:
    hand = load("dlr_hit2")
    assert finger_equations(hand, "index", ()) is finger_equations(hand, "index", ())


# ── fingers alone ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_fingers_alone_are_never_slower_than_straight_and_others_stand_still() -> None:
    hand = load("allegro_right")
    rng = np.random.default_rng(1)
    part = rng.uniform(0.3, 0.7, size=(2, hand.n))
    q_start, q_goal = hand.q_lower + part * (hand.q_upper - hand.q_lower)
    still = list(hand.finger("middle").joints)
    q_goal[still] = q_start[still]
    along = plan_fingers_along(FingerTask(hand), JointPath.through([q_start, q_goal]), settings=PlanSettings(intervals=30))
    free = plan_fingers(FingerTask(hand), q_start, q_goal, settings=PlanSettings(intervals=30))
    assert isinstance(free, Plan)
    assert isinstance(along, Plan)
    assert free.check.verified
    assert free.duration <= along.duration
    assert np.ptp(free.knots.q[:, still], axis=0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("kind", ["sphere", "box", "cylinder"])
def test_fingertips_go_round_what_is_in_their_way(kind: str) -> None:
    hand = load("four_finger")
    q_start = hand.neutral.copy()
    joints = list(hand.finger("finger_1").joints)
    q_goal = q_start.copy()
    q_start[joints[0]], q_goal[joints[0]] = -0.4, 0.4
    q_start[joints[1:]] = q_goal[joints[1:]] = 0.3
    straight = plan_fingers(FingerTask(hand), q_start, q_goal, settings=PlanSettings(intervals=30))
    assert isinstance(straight, Plan)
    middle, _ = hand.tips_along(straight.at([straight.duration / 2]).q, ["finger_1"])
    shape = {"sphere": Sphere(0.002), "box": Box([0.004, 0.003, 0.005]), "cylinder": Cylinder(0.002, 0.004)}[kind]
    turned = Rotation.from_rotvec([0.2, 0.1, 0.3]).as_matrix()
    obstacle = Obstacle(shape, middle[0, 0] + np.array([0.0, 0.0, 0.004]), turned)
    round_it = plan_fingers(FingerTask(hand), q_start, q_goal, settings=PlanSettings(intervals=30), obstacles=[obstacle])
    assert isinstance(round_it, Plan)
    assert round_it.check.verified
    tips, _ = hand.tips_along(round_it.at(np.linspace(0, round_it.duration, 301)).q, ["finger_1"])
    radius = hand.finger("finger_1").tip_radius
    assert radius is not None
    distance = obstacle.distance(tips[:, 0])
    assert distance.min() > radius - 2e-5
    cut, _ = hand.tips_along(straight.at(np.linspace(0, straight.duration, 301)).q, ["finger_1"])
    assert obstacle.distance(cut[:, 0]).min() < radius - 1e-3  # m: it was in the way
    assert straight.duration * (1.0 - 1e-3) < round_it.duration < 1.2 * straight.duration  # other joints make the detour
    blocked = plan_fingers(FingerTask(hand), q_start, q_goal, obstacles=[Obstacle(shape, tips[-1, 0])])
    assert isinstance(blocked, PlanFailure)
    assert blocked.kind == UNREACHABLE
    assert blocked.reason.startswith("At the goal, the clearance between the tip of finger_1 and obstacles[0]")


def test_a_finger_leaves_the_object_and_touches_it_again_round_an_edge() -> None:
    """Regrasping: from one face of a held box to the next; the straight way cuts the edge."""
    hand = load("four_finger")
    radius = hand.finger("finger_1").tip_radius
    assert radius is not None
    q = [hand.neutral, hand.neutral.copy()]
    q[1][list(hand.finger("finger_1").joints[:2])] += (0.065, 0.05)
    above, beside = (hand.tip_pose(each, "finger_1")[0] for each in q)
    edge = 0.02  # m
    middle = np.array([above[0], beside[1], above[2]]) - np.array([0.0, edge / 2 + radius, edge / 2 + radius])
    obstacle = Obstacle(Box([3 * edge, edge, edge]), middle)
    plan = plan_fingers(FingerTask(hand), q[0], q[1], obstacles=[obstacle])
    assert isinstance(plan, Plan)
    tips, _ = hand.tips_along(plan.at(np.linspace(0, plan.duration, 301)).q, ["finger_1"])
    distance = obstacle.distance(tips[:, 0])
    assert distance[[0, -1]] == pytest.approx(radius, abs=1e-9)  # it touches at both ends, exactly where it was told to
    assert plan.knots.q[[0, -1]] == pytest.approx(np.array(q), abs=1e-9)
    assert distance.min() > radius - 2e-5
    assert plan.check.verified
    straight = plan_fingers(FingerTask(hand), q[0], q[1])
    assert isinstance(straight, Plan)
    cut, _ = hand.tips_along(straight.at(np.linspace(0, straight.duration, 301)).q, ["finger_1"])
    assert obstacle.distance(cut[:, 0]).min() < radius - 1e-4  # m: it would have


# ── reasons ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_goal_out_of_reach_is_said() -> None:
    task, path, q = moves("dlr_hit2", 1, 1)[0]
    (start, _), (R, _) = poses(path)
    far = plan_free(task, [start, start + np.array([0.0, 0.0, 0.3])], [R, R], q)
    assert isinstance(far, PlanFailure)
    assert far.kind == UNREACHABLE
    assert far.reason.startswith("At the goal, the contact of thumb must be within reach of thumb")
    assert far.s == 1.0


def test_where_fingers_cannot_follow_the_straight_line_another_way_is_found() -> None:
    """The straight line, its joints moved least, takes a joint beyond its end; the fourth joint of each finger knows a way."""
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
    cold = guess_from_end_poses(task, path, q, 40)
    assert isinstance(cold, Trajectory)
    assert cold.p_HO[-1] == pytest.approx(path.points(np.ones(1)).p[0], abs=1e-12)
    assert plan.duration < cold.times[-1]  # s: the guess was a slow one


def test_an_object_too_heavy_to_hold_is_said_with_what_gives_out() -> None:
    task, path, q = moves("dlr_hit2", 1, 1)[0]
    heavy = replace(task, body=replace(task.body, mass=50.0, inertia=1e3 * task.body.inertia))
    failure = plan_free(heavy, *poses(path), q)
    assert isinstance(failure, PlanFailure)
    assert failure.kind == UNHOLDABLE
    assert failure.s == 0.0
    assert failure.reason.startswith("At the start the object cannot be held still.")
    assert "the torque limits of joints" in failure.reason


def test_a_slip_margin_is_kept_back_and_never_saves_time() -> None:
    task, path, q = moves("allegro_right", 1, 1)[0]
    plain = plan_free(task, *poses(path), q)
    careful = plan_free(replace(task, slip_margin=0.2), *poses(path), q)
    assert isinstance(plain, Plan)
    assert isinstance(careful, Plan)
    f = careful.knots.f.reshape(len(careful.knots.times), -1, 3)
    assert (0.6 * f[:, :, 2] - np.hypot(f[:, :, 0], f[:, :, 1])).min() > 0.2 - 0.005  # N: a thousandth of the largest friction
    assert careful.duration > plain.duration * (1.0 - 1e-3)  # both to the solver's tolerance


def test_a_finer_grid_changes_the_duration_little() -> None:
    """Accelerations linear between knots lose by the square of the step: per cent at 20 intervals, parts of that at 40."""
    task, path, q = moves("dlr_hit2", 1, 1)[0]
    along = plan_along(task, path, q, settings=PlanSettings(intervals=40))
    assert isinstance(along, Plan)
    times = []
    for intervals in (10, 20, 40):
        move = object_move_program(task, along.at_even_times(intervals))
        times.append(float(move.trajectory(optimise(move.program, move.guess).x).times[-1]))
    assert 0.0 < times[1] - times[2] < 0.5 * (times[0] - times[1])
    assert times[1] == pytest.approx(times[2], rel=0.02)


def test_tasks_that_are_not_for_it_are_refused_at_the_door() -> None:
    pose = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]), np.tile(np.eye(3), (2, 1, 1))
    straight = block()
    contacts = [Contact([x, 0, 0], [-np.sign(x), 0, 0], 0.5, model="soft", torsional_friction=0.01) for x in (-0.02, 0.02)]
    soft = IdealTask(straight.body, ContactSet.stack(contacts))
    with pytest.raises(InvalidInput, match=r"contacts\[0\].model = 'soft'.*a point contact with friction"):
        plan_free(soft, *pose)
    with pytest.raises(InvalidInput, match="plan_fingers plans fingers alone"):
        plan_free(FingerTask(load("dlr_hit2")), *pose)
    with pytest.raises(InvalidInput, match="plan_free plans a move of an object"):
        plan_fingers(straight, [], [])
