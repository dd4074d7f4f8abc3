"""Moves of the shipped hands: the laws at the knots and between them, what must not matter, and reasons in words."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import load
from support.planning_cases import AXES, DISTANCE, FINGERS, block, random_move, star_grasp, straight_move

from graspforce import InvalidInput
from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.hand.description import MODELS_FOLDER
from graspforce.hand.hand import Hand
from graspforce.planning.check import SAMPLES_PER_INTERVAL, check_at_times, times_between
from graspforce.planning.failure import OVERLOADED, SINGULAR, UNHOLDABLE, UNREACHABLE, PlanFailure
from graspforce.planning.path.paths import JointPath, PosePoints, ScrewPath, SplinePath, StraightPath
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.plan_files import csv_columns, save
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask, GraspTask, contacts_at

LIFT = {"four_finger": (0.001, 0.002, 0.006), "dlr_hit2": (-0.006, 0.004, 0.006), "allegro_right": (-0.004, 0.004, 0.006)}  # m
TURN = {"four_finger": (0.02, -0.02, 0.03), "dlr_hit2": (0.08, -0.06, 0.1), "allegro_right": (0.1, 0.1, 0.02)}  # rad
ROOM = {"four_finger": ((0.005, 0.008), 8.0)}  # m, °: its tips have a few millimetres before a finger is stretched
HANDS = list(FINGERS)


def lifted(name: str, **changes: float) -> tuple[GraspTask, ScrewPath, Array]:
    """Return a small move of a shipped hand along a screw: its path is curved, and so is every term of the dynamics at work."""
    task, middle, q = star_grasp(load(name), **changes)
    return task, ScrewPath(middle, AXES, middle + LIFT[name], Rotation.from_rotvec(TURN[name]).as_matrix()), q


def planned(*question: object, **options: object) -> Plan:
    plan = plan_along(*question, **options)  # type: ignore[arg-type]
    assert isinstance(plan, Plan), plan.reason
    return plan


def refused(*question: object, **options: object) -> PlanFailure:
    planner = plan_fingers_along if isinstance(question[0], FingerTask) else plan_along
    failure = planner(*question, **options)  # type: ignore[arg-type]
    assert isinstance(failure, PlanFailure)
    assert not failure.found
    return failure


@pytest.fixture(scope="module", params=HANDS)
def plan(request: pytest.FixtureRequest) -> Plan:
    return planned(*lifted(request.param))


# ── laws ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_motors_make_the_motion_and_the_forces(plan: Plan) -> None:
    """tau = M a + h + Jᵀ f, and Newton's and Euler's laws about O, at every knot, by the hand's functions of one posture."""
    task, knots = plan.task, plan.knots
    hand, contacts, body = task.hand, task.contacts, task.body
    for k in range(0, len(knots.times), 9):
        q, p, R = knots.q[k], knots.p_HO[k], knots.R_HO[k]
        contacts = contacts_at(task.contacts, knots.p_OC[k], knots.R_OC[k])
        J = hand.contact_jacobian(q, task.fingers, contacts, p, R)
        tau = hand.inverse_dynamics(q, knots.v[k], knots.a[k], task.gravity_H) + J.T @ knots.f[k]
        assert tau == pytest.approx(knots.tau[k], abs=1e-9)  # N·m: derivatives of the spline are its own, to rounding
        forces = knots.f[k].reshape(-1, 3)
        pushed = [R @ contacts.R_OC[i] @ f for i, f in enumerate(forces)]  # N, in H
        arms = [R @ p_OC for p_OC in contacts.p_OC]
        com, omega, alpha = R @ body.p_OM, knots.twist[k, 3:], knots.acceleration[k, 3:]
        of_com = knots.acceleration[k, :3] + np.cross(alpha, com) + np.cross(omega, np.cross(omega, com))
        wanted = body.mass * (of_com - task.gravity_H)
        assert sum(pushed) == pytest.approx(wanted, abs=1e-9)
        inertia = R @ body.inertia @ R.T
        spin = inertia @ alpha + np.cross(omega, inertia @ omega) + np.cross(com, wanted)
        assert sum(np.cross(arm, f) for arm, f in zip(arms, pushed, strict=True)) == pytest.approx(spin, abs=1e-9)


def test_every_limit_is_kept_to_a_thousandth_between_knots_too(plan: Plan) -> None:
    """At four times as many instants as the planner's own check, as they are. Friction or a motor is what ends haste."""
    assert plan.check.verified
    finer = check_at_times(plan, times_between(plan.knots.times, 4 * SAMPLES_PER_INTERVAL - 1))
    assert finer.excess < 1.01e-3  # the check is right to a hundredth of this tolerance
    assert finer.drift < 1e-6
    assert max(finer.slip, finer.torque, finer.normal, finer.speed) > -1e-3
    assert 0.0 <= plan.optimality_gap < 1e-6


def test_forces_between_knots_stay_in_their_cones_and_torques_inside_their_limits(plan: Plan) -> None:
    hand, contacts = plan.task.hand, plan.task.contacts
    at = plan.at(np.linspace(0.0, plan.duration, 997))
    f = at.f.reshape(-1, len(contacts), 3)
    assert (contacts.mu * f[:, :, 2] - np.hypot(f[:, :, 0], f[:, :, 1])).min() > -1e-6  # N: the solver's tolerance
    assert f[:, :, 2].max() < contacts.max_normal[0] + 1e-6
    assert (np.abs(at.tau) / hand.torque_upper).max() < 1.0 + 1e-6


def test_states_are_each_other_s_derivatives_and_rest_at_both_ends(plan: Plan) -> None:
    """Differences over dt err by dt² times third and fourth derivatives, of order (2π/T)³ here."""
    dt = 1e-4 * plan.duration
    t = np.linspace(0.02, 0.98, 60) * plan.duration
    before, here, after = (plan.at(t + d) for d in (-dt, 0.0, dt))
    v, a = np.abs(here.v).max(), np.abs(here.a).max()
    assert (after.q - before.q) / (2 * dt) == pytest.approx(here.v, abs=1e-4 * v)
    assert (after.v - before.v) / (2 * dt) == pytest.approx(here.a, abs=2e-2 * a)  # a is not smooth at knots
    assert (after.p_HO - before.p_HO) / (2 * dt) == pytest.approx(here.twist[:, :3], abs=1e-5)
    for end in (0, -1):
        assert np.abs(plan.knots.v[end]).max() == 0.0
        assert np.abs(plan.knots.twist[end]).max() == 0.0
    assert plan.knots.times[0] == 0.0
    assert (np.diff(plan.knots.times) > 0).all()


@pytest.mark.parametrize("name", HANDS)
def test_tips_that_do_not_roll_stay_with_their_contacts(name: str) -> None:
    """Their middles move as the object does there: J_c v = ṗ + ω × (R c)."""
    task, path, q = lifted(name)
    plan = planned(replace(task, rolling=False), path, q)
    task, hand = plan.task, plan.task.hand
    assert (plan.knots.p_OC == task.contacts.p_OC).all()
    assert (plan.knots.R_OC == task.contacts.R_OC).all()
    at = plan.at(np.linspace(0.0, plan.duration, 101))
    p, J = hand.tips_along(at.q, task.fingers)
    arms = task.tip_centres @ at.R_HO.transpose(0, 2, 1)
    assert p == pytest.approx(at.p_HO[:, None] + arms, abs=1e-6)
    carried = at.twist[:, None, :3] + np.cross(at.twist[:, None, 3:], arms)
    assert np.einsum("kfcn,kn->kfc", J, at.v) == pytest.approx(carried, abs=1e-5 * np.abs(carried).max())


# ── what must and what must not matter ────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2"])
def test_the_way_back_takes_as_long(name: str) -> None:
    """Time reversed, rates change sign and torques do not; contacts roll back to where they began."""
    task, path, q = lifted(name)
    there = planned(task, path, q)
    at = path.points(np.array([0.0, 1.0]))
    task = replace(task, contacts=contacts_at(task.contacts, there.knots.p_OC[-1], there.knots.R_OC[-1]))
    back = planned(task, ScrewPath(at.p[1], at.R[1], at.p[0], at.R[0]), there.knots.q[-1])
    assert back.duration == pytest.approx(there.duration, rel=1e-6)
    assert back.knots.q[::-1] == pytest.approx(there.knots.q, abs=1e-7)
    assert back.knots.p_OC[::-1] == pytest.approx(there.knots.p_OC, abs=1e-8)
    assert np.linalg.norm(there.knots.p_OC[-1] - there.knots.p_OC[0], axis=1).max() > 5e-4


def test_more_friction_never_takes_longer_and_a_slip_margin_never_less() -> None:
    plain = planned(*lifted("allegro_right")).duration
    rougher = planned(*lifted("allegro_right", friction=0.8)).duration
    task, path, q = lifted("allegro_right")
    careful = planned(replace(task, slip_margin=0.2), path, q)
    assert rougher <= plain * (1 + 1e-7)
    assert careful.duration > plain
    assert abs(careful.check.slip) <= careful.check.tolerance  # the margin, and no more, is kept back somewhere


def test_where_the_object_s_frame_stands_does_not_matter() -> None:
    """O moved to a corner of the object, its axes turned: the same move, the same time."""
    task, path, q = lifted("four_finger")
    shift, turn = np.array([0.02, -0.01, 0.03]), Rotation.from_rotvec([0.4, 0.9, -0.3]).as_matrix()  # O' in O
    c = task.contacts
    contacts = ContactSet((c.p_OC - shift) @ turn, turn.T @ c.R_OC, c.models, c.mu, c.gamma, c.min_normal, c.max_normal)
    body = Body(task.body.mass, turn.T @ task.body.inertia @ turn, (task.body.p_OM - shift) @ turn)

    class Seen:
        """The same path, of O'."""

        def points(self, s: Array):  # type: ignore[no-untyped-def]
            x = path.points(s)
            arm = np.cross(x.omega, shift)
            p_s = x.p_s + (x.R @ arm[:, :, None])[:, :, 0]
            p_ss = x.p_ss + (x.R @ (np.cross(x.omega_s, shift) + np.cross(x.omega, arm))[:, :, None])[:, :, 0]
            return type(x)(x.p + x.R @ shift, p_s, p_ss, x.R @ turn, x.omega @ turn, x.omega_s @ turn)

    moved = planned(replace(task, contacts=contacts, body=body), Seen(), q)
    assert moved.duration == pytest.approx(planned(task, path, q).duration, rel=1e-6)


def test_a_finer_grid_changes_the_duration_by_its_square() -> None:
    """To a thousandth at 50 intervals, and four times nearer at 200; where accelerations jump, knots fall as they may."""
    times = [planned(*lifted("dlr_hit2"), settings=PlanSettings(intervals=n)).duration for n in (50, 200, 400)]
    assert times[0] == pytest.approx(times[2], rel=1e-3)
    assert abs(times[1] - times[2]) < abs(times[0] - times[2]) / 4.0


def test_through_a_via_pose_and_straight() -> None:
    task, path, q = lifted("dlr_hit2")
    ends = path.points(np.array([0.0, 0.5, 1.0]))
    via = ends.p + np.array([[0, 0, 0], [0.001, 0.001, 0.0], [0, 0, 0]])
    bent = planned(task, SplinePath.through(via, ends.R), q)
    middle = np.abs(bent.at(np.linspace(0, bent.duration, 4001)).p_HO - via[1]).max(axis=1)
    assert middle.min() < 1e-5  # m: a four-thousandth of the way
    assert np.linalg.norm(bent.knots.twist[1:-1], axis=1).min() > 1e-3  # it does not stop
    straight = planned(task, StraightPath(ends.p[0], ends.R[0], ends.p[2], ends.R[2]), q)
    assert straight.check.verified
    assert straight.duration == pytest.approx(planned(task, path, q).duration, rel=0.1)


@pytest.mark.parametrize("name", HANDS)
def test_random_moves_that_fingers_can_follow_are_planned(name: str) -> None:
    """5 to 20 mm and up to 20°, or what the hand has room for: of those that inverse kinematics reaches, every one."""
    hand = load(name)
    task, middle, q_start = star_grasp(hand)
    rng, tried, found = np.random.default_rng(3), 0, 0
    for _ in range(40):
        path = random_move(rng, middle, *ROOM.get(name, ((0.005, 0.02), 20.0)))
        at, q = path.points(np.linspace(0.0, 1.0, 5)), q_start
        try:
            for p, R in zip(at.p, at.R, strict=True):
                q = hand.grasp_posture(task.fingers, task.contacts, p, R, q)
        except InvalidInput:
            continue
        tried += 1
        answer = plan_along(task, path, q_start, settings=PlanSettings(intervals=50))
        found += answer.found and answer.check.verified
        if tried == 6:
            break
    assert tried >= 3
    assert found == tried


@pytest.mark.parametrize(("name", "seed", "limit"), [("allegro_right", 0, "torque"), ("four_finger", 3, "speed")])
def test_fingers_alone_by_way_of_a_posture_are_mended_until_they_keep_their_limits(name: str, seed: int, limit: str) -> None:
    hand = load(name)
    rng = np.random.default_rng(seed)
    low, high = 0.6 * hand.q_lower + 0.4 * hand.q_upper, 0.4 * hand.q_lower + 0.6 * hand.q_upper
    plan = plan_fingers_along(
        FingerTask(hand), JointPath.through(rng.uniform(low, high, size=(3, hand.n))), settings=PlanSettings(intervals=40)
    )
    assert isinstance(plan, Plan)
    assert plan.statistics.solves > 1
    assert len(plan.s) == 41  # on the same grid
    assert plan.check.verified
    assert getattr(plan.check, limit) > -5e-3  # mended by no more than it took
    assert check_at_times(plan, times_between(plan.knots.times, 4 * SAMPLES_PER_INTERVAL - 1)).excess < 1.01e-3
    assert plan.knots.f.shape[1] == 0
    assert plan.knots.p_HO.shape == (0, 3)


# ── reasons ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_out_of_reach_at_the_start_and_on_the_way() -> None:
    task, path, q = lifted("dlr_hit2")
    at = path.points(np.array([0.0]))
    far = refused(task, StraightPath(at.p[0] + [0, 0, 0.3], AXES, at.p[0], AXES), q)
    assert (far.kind, far.s) == (UNREACHABLE, 0.0)
    assert far.reason.startswith("At the start, the contact of thumb must be within reach of thumb")
    across = StraightPath(at.p[0], AXES, at.p[0] + [0, 0.04, 0], AXES)
    rolled, task = refused(task, across, q), replace(task, rolling=False)
    assert rolled.kind == UNREACHABLE
    assert f"joint {rolled.joint} needs the position" in rolled.reason
    sideways = refused(task, across, q)
    assert sideways.kind == UNREACHABLE
    assert sideways.joint is not None
    assert f"joint {sideways.joint} needs the position" in sideways.reason
    assert 0.0 < sideways.s < 1.0
    assert f"At s = {sideways.s:.3f}" in sideways.reason
    for s, reached in ((sideways.s - 2e-3, True), (sideways.s + 2e-3, False)):  # the place, to a thousandth
        p_HO = at.p[0] + [0, 0.04 * s, 0]
        if reached:
            task.hand.grasp_posture(task.fingers, task.contacts, p_HO, AXES, q)
        else:
            with pytest.raises(InvalidInput, match="within reach"):
                task.hand.grasp_posture(task.fingers, task.contacts, p_HO, AXES, q)


def test_a_finger_that_is_stretched_on_the_way_is_named_with_its_joint() -> None:
    task, middle, q = star_grasp(load("four_finger"))
    singular = refused(task, StraightPath(middle, AXES, middle + 0.08 * AXES[2], AXES), q)
    assert singular.kind == SINGULAR
    assert singular.joint is not None
    assert singular.joint.endswith("_joint_3")
    assert "is singular: its tip cannot move along" in singular.reason


def test_heavier_than_friction_can_hold() -> None:
    """2 μ N = 5 N bear 0.51 kg, not 0.6: 1.177 times the friction would."""
    heavy = refused(block(mass=0.6), straight_move(0, 0, 1))
    assert (heavy.kind, heavy.s) == (UNHOLDABLE, 0.0)
    assert heavy.infeasibility is not None
    assert heavy.infeasibility.verified
    assert heavy.infeasibility.friction_factor == pytest.approx(0.6 * 9.81 / 5.0, rel=1e-6)
    assert "At the start the object cannot be held still." in heavy.reason
    assert "5.886 is required and at most 5 can be supplied" in heavy.reason
    assert "1.177 times the friction" in heavy.reason


def test_motors_that_cannot_hold_the_object_are_named_by_their_joint() -> None:
    """Fingers that could press hard enough, with motors that cannot."""
    task, path, q = lifted("allegro_right", mass=3.0, friction=1.5, largest=60.0)
    failure = refused(task, path, q)
    assert failure.kind == UNHOLDABLE
    assert failure.joint is not None
    assert "torque limits of joint" in failure.reason


def test_too_wide_a_slip_margin_is_refused_with_what_there_is() -> None:
    """μN − mg/2 = 2.0095 N is all that two fingers can keep back."""
    wide = refused(block(slip_margin=2.1), straight_move(0, 0, 1))
    assert wide.kind == UNHOLDABLE
    assert "the slip margin is at most 2.009 N, less than the required 2.1 N" in wide.reason


def test_a_place_in_the_middle_that_cannot_be_held_is_found() -> None:
    """Turned by half a turn about its fingers' line nothing changes; about a horizontal axis friction must bear all weight
    halfway, where both fingers press vertically."""
    half = Rotation.from_rotvec([0.0, np.pi * 0.999, 0.0]).as_matrix()
    failure = refused(block(mass=0.52, friction=0.98, largest=4.0), StraightPath([0, 0, 0], AXES, [0, 0, 0.01], half))
    assert failure.kind == UNHOLDABLE
    assert failure.s is not None
    assert 0.0 < failure.s < 1.0
    assert f"At s = {failure.s:.3f} the object cannot be held still" in failure.reason


def test_a_motor_too_weak_for_its_own_finger() -> None:
    hand = load("dlr_hit2")
    heavy = FingerTask(hand, gravity_H=(0.0, 0.0, -2000.0))
    failure = refused(heavy, JointPath.through([hand.neutral, hand.neutral + 0.1]))
    assert (failure.kind, failure.s) == (OVERLOADED, 0.0)
    assert f"joint {failure.joint} needs" in failure.reason


def test_fingers_alone_beyond_a_limit() -> None:
    hand = load("dlr_hit2")
    goal = np.array(hand.neutral)
    goal[4] = 1.7
    failure = refused(FingerTask(hand), JointPath.through([hand.neutral, goal]))
    assert (failure.kind, failure.joint) == (UNREACHABLE, "index_joint_2")
    assert "outside its limits [0, 1.571] rad" in failure.reason


def flat_hand(folder: Path) -> Hand:
    """Return the four-finger hand, by its own name, with its first joints locked: each finger moves its tip in a plane only."""
    described = json.loads((MODELS_FOLDER / "four_finger.json").read_text())
    described["urdf"] = "four_finger.urdf"
    described["locked"] = [{"joint": f"finger_{i}_joint_1", "source": "test"} for i in range(1, 5)]
    for motor in described["motors"]:
        motor["joints"] = [name for name in motor["joints"] if "joint_1" not in name]
    (folder / "flat.json").write_text(json.dumps(described))
    (folder / "four_finger.urdf").write_text((MODELS_FOLDER / "four_finger.urdf").read_text())
    return Hand.load(folder / "flat.json")


def test_fingers_of_two_joints_move_in_their_plane_and_say_so_out_of_it(tmp_path: Path) -> None:
    hand = flat_hand(tmp_path)
    task, middle, q = star_grasp(hand)
    plan = planned(task, StraightPath(middle, AXES, middle + 0.006 * AXES[2], AXES), q)
    assert plan.check.verified
    sideways = refused(task, StraightPath(middle, AXES, middle + 0.004 * AXES[1], AXES), q)
    assert (sideways.kind, sideways.s) == (SINGULAR, 0.0)
    assert "has 2 joints and cannot move its tip along (0.00, 1.00, 0.00)" in sideways.reason


class Wrong:
    """A path of a user's own, with a mistake."""

    def __init__(self, **wrong: Array) -> None:
        self._wrong = wrong

    def points(self, s: Array) -> PosePoints:
        return replace(straight_move(0, 0, 1).points(s), **self._wrong)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(lifted("dlr_hit2")[0], fingers=("thumb",)), "fingers.*3 different finger names"),
        (lambda: replace(lifted("dlr_hit2")[0], fingers="thumb"), "fingers.*a list of finger names"),
        (lambda: replace(lifted("dlr_hit2")[0], fingers=("thumb", "index", "toe")), "toe"),
        (lambda: replace(lifted("dlr_hit2")[0], slip_margin=-1.0), "slip_margin"),
        (lambda: replace(block(), slip_margin=-1.0), "slip_margin"),
        (lambda: plan_along(block(), JointPath.through([[0.0], [1.0]])), "plan_fingers_along takes a path of the joints"),
        (lambda: plan_along(block(), StraightPath([0, 0, 0], AXES, [0, 0, 0], AXES)), "a path along which something moves"),
        (lambda: plan_along(block(largest=None), straight_move(0, 0, 1)), "nothing else limits the forces"),
        (lambda: plan_along(block(), straight_move(0, 0, 1), settings=PlanSettings(intervals=1)), "intervals = 1"),
        (lambda: plan_along(block(), Wrong(p=np.zeros((5, 2)))), "path.points.p "),
        (lambda: plan_along(block(), Wrong(omega=np.full((5, 3), np.nan))), r"path.points.omega\[0\]\[0\] = nan"),
        (lambda: plan_along(block(), Wrong(R=2.0 * np.tile(AXES, (5, 1, 1)))), "path.points.R.*rotation matrices"),
    ],
)
def test_what_is_not_allowed_is_named(make, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        make()


# ── files ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_files_hold_what_the_plan_holds(plan: Plan, tmp_path: Path) -> None:
    step = 1e-3  # s
    save(plan, tmp_path / "plan.json", step)
    record = json.loads((tmp_path / "plan.json").read_text())
    assert record["schema"] == "graspforce/plan/1"
    assert record["duration"] == plan.duration
    assert record["check"]["verified"] is True
    assert np.array(record["knots"]["f"]) == pytest.approx(plan.knots.f, abs=0.0)
    save(plan, tmp_path / "plan.npz", step)
    with np.load(tmp_path / "plan.npz") as arrays:
        times = arrays["times"]
        assert np.diff(times[:-1]) == pytest.approx(step, rel=1e-9)
        assert times[-1] == plan.duration
        assert arrays["p_HO"] == pytest.approx(plan.at(times).p_HO, abs=0.0)
        assert np.array(record["samples"]["q"]) == pytest.approx(arrays["q"], abs=0.0)
        hand = plan.task.hand
        assert arrays["joints"].tolist() == [joint.name for joint in hand.joints]
    save(plan, tmp_path / "plan.csv")
    with (tmp_path / "plan.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == csv_columns(plan)
    numbers = np.array(rows, dtype=float)
    assert numbers[:, 0] == pytest.approx(plan.knots.times, abs=0.0)
    column = head.index(f"tau {plan.task.hand.joints[1].name} [N·m]")
    assert numbers[:, column] == pytest.approx(plan.knots.tau[:, 1], abs=0.0)
    assert numbers[:, head.index("p_HO z [m]")] == pytest.approx(plan.knots.p_HO[:, 2], abs=0.0)
    with pytest.raises(InvalidInput, match=r"suffix of path.*one of .json, .csv, .npz"):
        save(plan, tmp_path / "plan.txt")


def test_times_outside_the_move_are_refused() -> None:
    plan = planned(block(), straight_move(0, 0, 1), settings=PlanSettings(intervals=20))
    with pytest.raises(InvalidInput, match="between 0 and the duration"):
        plan.at([2.0 * plan.duration])
    assert plan.at([plan.duration]).p_HO[0] == pytest.approx([0.0, 0.0, DISTANCE], abs=1e-15)
