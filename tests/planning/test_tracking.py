"""Plans that are followed: what the controller is told, what rolling changes, and where the object arrives in MuJoCo."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.planning_cases import block, straight_move
from support.tracked_moves import MOVES, SETTINGS, find_move_grasp, straight_path

from graspforce import ContactSet, InvalidInput, simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspMotion, ObjectController
from graspforce.planning import (
    FingerTask,
    JointPath,
    Plan,
    PlanFailure,
    joint_reference,
    object_reference,
    plan_along,
    plan_fingers_along,
    tracking,
)
from graspforce.planning.settings import PlanSettings
from graspforce.simulation import Plant

HANDS = list(MOVES)


def planned(name: str) -> Plan:
    grasp = find_move_grasp(name)
    plan = plan_along(
        tracking.object_task(grasp, SETTINGS),
        straight_path(grasp, *map(np.array, MOVES[name])),
        grasp.q,
        settings=PlanSettings(intervals=60),
    )
    assert isinstance(plan, Plan), plan.reason
    return plan


@pytest.fixture(scope="module")
def plan() -> Plan:
    return planned("allegro_right")


# ── reference ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_plan_s_reference_is_the_plan_and_then_rests_at_the_goal(plan: Plan) -> None:
    follow = object_reference(plan)
    for t in np.linspace(0.01, 0.99, 9) * plan.duration:
        now, wanted = follow(t), plan.at([t])
        # two quintics through the same knots, of rotation vectors from the start and from the knot before
        assert now.p_HO == pytest.approx(wanted.p_HO[0], abs=1e-12)
        assert np.abs(now.R_HO - wanted.R_HO[0]).max() < 1e-8
        assert now.twist == pytest.approx(wanted.twist[0], abs=1e-5)
        assert now.acceleration == pytest.approx(wanted.acceleration[0], rel=1e-3, abs=1e-2)
    for t in (plan.duration, 2.0 * plan.duration):
        assert np.array_equal(follow(t).p_HO, plan.knots.p_HO[-1])
        assert np.abs(np.append(follow(t).twist, follow(t).acceleration)).max() == 0.0


@pytest.mark.parametrize(("time_scale", "window"), [(1.0, 0.0), (1.3, 0.0), (1.0, 0.01), (1.2, 0.02)])
def test_its_rates_are_the_derivatives_of_its_pose(plan: Plan, time_scale: float, window: float) -> None:
    """Central differences over h err by h²/6 times the third derivative, some 1e4 m/s³ at most between the window's steps."""
    follow, h = object_reference(plan, time_scale=time_scale, window=window), 1e-6
    end = time_scale * plan.duration + window
    for t in (0.123, 0.377, 0.641, 0.893):
        before, now, after = (follow(t * end + d) for d in (-h, 0.0, h))
        assert (after.p_HO - before.p_HO) / (2 * h) == pytest.approx(now.twist[:3], abs=1e-5)
        turned = Rotation.from_matrix(after.R_HO @ before.R_HO.T).as_rotvec() / (2 * h)
        assert turned == pytest.approx(now.twist[3:], abs=1e-5)
        assert (after.twist - before.twist) / (2 * h) == pytest.approx(now.acceleration, rel=1e-3, abs=0.1)


@pytest.mark.parametrize(("time_scale", "window"), [(1.0, 0.0), (1.2, 0.02)])
def test_the_joints_reference_is_the_plan_s_with_its_derivatives(plan: Plan, time_scale: float, window: float) -> None:
    follow, h = joint_reference(plan, time_scale=time_scale, window=window), 1e-6
    end = time_scale * plan.duration + window
    for t in (0.123, 0.377, 0.641, 0.893):
        before, now, after = (follow(t * end + d) for d in (-h, 0.0, h))
        for rate, x in ((1, 0), (2, 1)):
            slope = (after[x] - before[x]) / (2 * h)
            assert slope == pytest.approx(now[rate], rel=1e-3, abs=1e-3 * 100.0**x)
        if window == 0.0:
            wanted = plan.at([t * end / time_scale])
            assert now[0] == pytest.approx(wanted.q[0], abs=1e-12)
            assert now[1] == pytest.approx(wanted.v[0] / time_scale, abs=1e-9)
            assert now[2] == pytest.approx(wanted.a[0] / time_scale**2, abs=1e-6)
    q, v, a = follow(end)
    assert np.array_equal(q, plan.knots.q[-1])
    assert not np.append(v, a).any()


def test_a_window_makes_steps_in_acceleration_small_and_a_slower_pace_makes_accelerations_smaller(plan: Plan) -> None:
    times = np.arange(0.0, 1.5 * plan.duration, 2.5e-4)

    def accelerations(**how: float) -> np.ndarray:
        return np.array([object_reference(plan, **how)(t).acceleration for t in times])

    hard, soft, slow = accelerations(), accelerations(window=0.01), accelerations(time_scale=1.25)
    largest = np.abs(hard).max()
    assert np.abs(np.diff(hard, axis=0)).max() > 0.5 * largest
    assert np.abs(np.diff(soft, axis=0)).max() < 0.2 * largest  # braking for speeding up, two steps of a sixteenth at most
    assert np.abs(soft).max() <= largest * (1.0 + 1e-9)
    assert np.abs(slow).max() == pytest.approx(largest / 1.25**2, rel=1e-2)


def test_what_cannot_be_followed_is_refused(plan: Plan) -> None:
    hand = find_move_grasp("allegro_right").hand
    alone = plan_fingers_along(
        FingerTask(hand), JointPath.through([hand.neutral, hand.neutral + 0.02]), settings=PlanSettings(intervals=20)
    )
    assert isinstance(alone, Plan)
    with pytest.raises(InvalidInput, match="plan"):
        object_reference(alone)
    with pytest.raises(InvalidInput, match="time_scale"):
        object_reference(plan, time_scale=0.0)
    with pytest.raises(InvalidInput, match="window"):
        object_reference(plan, window=-1e-3)
    with pytest.raises(InvalidInput, match=r"desired\.q.*of four_finger"):
        tracking.check_tracking(plan, find_move_grasp("four_finger"), SETTINGS)


def test_ideal_fingers_have_a_reference_too() -> None:
    lift = plan_along(block(), straight_move(0.0, 0.0, 1.0), settings=PlanSettings(intervals=30))
    assert isinstance(lift, Plan)
    middle = object_reference(lift, time_scale=2.0)(lift.duration)
    assert middle.p_HO == pytest.approx(lift.at([lift.duration / 2.0]).p_HO[0], abs=1e-9)


# ── room for the controller ───────────────────────────────────────────────────────────────────────────────────────────────────


def test_the_planner_keeps_back_what_the_controller_does(plan: Plan) -> None:
    """By the hand's and the contacts' own numbers: a tenth of torque, the slip margin and a tenth of friction."""
    grasp = find_move_grasp("allegro_right")
    share = np.abs(plan.knots.tau) / grasp.hand.torque_upper
    assert share.max() <= 0.9 * (1.0 + 1e-6)
    f = plan.knots.f.reshape(len(plan.knots.f), -1, 3)
    left = (0.9 * grasp.contacts.mu * f[..., 2] - np.linalg.norm(f[..., :2], axis=2)).min()  # N
    assert left >= SETTINGS.slip_margin - 1e-5
    assert share.max() > 0.899 or left < SETTINGS.slip_margin + 1e-3  # and no more than that is kept back
    with pytest.raises(InvalidInput, match="reserve"):
        tracking.object_task(grasp, SETTINGS, torque_reserve=1.0)
    with pytest.raises(InvalidInput, match="torque"):
        grasp.hand.derated(0.0)


def test_a_rehearsal_rolls_as_the_contacts_must(plan: Plan) -> None:
    """At the end each ball touches the surface, and has rolled: its middle is not where a fixed contact has it."""
    grasp = find_move_grasp("allegro_right")
    gone = tracking.check_tracking(plan, grasp, SETTINGS)
    assert gone.fault == ""
    assert gone.slip_margin.min() > SETTINGS.slip_margin * (1.0 - 1e-6)
    follow = object_reference(plan, window=tracking.SMOOTHING_WINDOW)
    goal = follow(gone.t[-1])
    moved = []
    for i, name in enumerate(grasp.fingers):
        middle = goal.R_HO.T @ (grasp.hand.tip_pose(gone.q[-1], name)[0] - goal.p_HO)
        radius = grasp.hand.finger(name).tip_radius or 0.0
        assert np.linalg.norm(middle) == pytest.approx(0.03 + radius, abs=2e-6)  # second order in a period: micrometres
        moved.append(np.linalg.norm(middle - plan.task.tip_centres[i]))
    assert max(moved) > 5e-4
    dt = SETTINGS.period
    # rad/s: accelerations of some 1e3 rad/s² turn round within the window, five periods
    assert np.diff(gone.q, axis=0)[5:-5] / dt == pytest.approx((gone.v[5:-6] + gone.v[6:-5]) / 2.0, abs=0.1)


@pytest.mark.parametrize("damping", [40.0, 0.1, 0.0])
def test_joints_that_the_object_leaves_free_go_where_they_are_wanted(damping: float) -> None:
    """The object rests, three fingers of four joints hold it: one way is left to each, and all four to the finger beside them.

    Their rates are 10/s of what is missing, so that after half a second e⁻⁵ of it is; not faster where damping is less than
    critical, and nothing is divided by it.
    """
    grasp = find_move_grasp("allegro_right")
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    free = np.linalg.svd(J)[2][np.linalg.matrix_rank(J, tol=1e-6) :]
    assert len(free) == 3 + 4
    wanted = grasp.q + 0.05 * np.sign(free.sum(axis=0)) * np.abs(free).max(axis=0)  # rad
    none, settings = np.zeros(grasp.hand.n), replace(SETTINGS, posture_damping=damping)
    gone = tracking.check_motion_tracking(lambda t: GraspMotion(rest, wanted, none, none), 0.5, grasp, settings)
    assert gone.fault == ""
    before, after = np.abs(free @ (wanted - grasp.q)), np.abs(free @ (wanted - gone.q[-1]))
    assert before.max() > 0.04
    # the ways curve: contacts roll under the fingers, and what is free at the end is not quite what was at the start
    assert (after < 0.01 * before.max()).all()
    beside = sorted(set(range(grasp.hand.n)) - {j for name in grasp.fingers for j in grasp.hand.finger(name).joints})
    missing = (wanted - gone.q[-1])[beside]
    assert missing == pytest.approx(np.exp(-5.0) * (wanted - grasp.q)[beside], rel=0.05, abs=1e-9)


def test_a_plan_that_rolling_makes_too_fast_is_slowed_just_enough(plan: Plan) -> None:
    """Joint speed limits a little below what the rehearsal needs: the pace falls by as much, and no more than its step."""
    grasp = find_move_grasp("allegro_right")
    gone = tracking.check_tracking(plan, grasp, SETTINGS)
    fastest = np.abs(gone.v).max()
    joints = tuple(replace(joint, velocity=fastest / 1.2) for joint in grasp.hand.joints)
    slow = tracking.time_scale_plan(plan, replace(grasp, hand=replace(grasp.hand, joints=joints)), SETTINGS)
    assert isinstance(slow, tracking.TimeScaledPlan)
    assert 1.2 * 0.97 <= slow.time_scale <= 1.2 * 1.03 + 0.05  # slowed, the window softens the quickest instant a little less
    assert slow.duration == pytest.approx(slow.time_scale * plan.duration + tracking.SMOOTHING_WINDOW)
    joints = tuple(replace(joint, velocity=fastest / 3.0) for joint in grasp.hand.joints)
    refused = tracking.time_scale_plan(plan, replace(grasp, hand=replace(grasp.hand, joints=joints)), SETTINGS)
    assert isinstance(refused, PlanFailure)
    assert refused.joint is not None
    assert f"{refused.joint} exceeds its speed limit, at" in refused.reason


def test_rolling_that_takes_a_joint_to_its_end_is_a_refusal_in_words(plan: Plan) -> None:
    grasp = find_move_grasp("allegro_right")
    gone = tracking.check_tracking(plan, grasp, SETTINGS)
    joint = int(np.argmax(gone.q[-1] - gone.q[0]))
    joints = list(grasp.hand.joints)
    joints[joint] = replace(joints[joint], upper=float(gone.q[-1, joint] + gone.q[0, joint]) / 2.0)
    refused = tracking.time_scale_plan(plan, replace(grasp, hand=replace(grasp.hand, joints=tuple(joints))), SETTINGS)
    assert isinstance(refused, PlanFailure)
    assert refused.joint == joints[joint].name
    assert f"{joints[joint].name} reaches the end of its range" in refused.reason
    assert refused.reason.startswith("With rolling contacts, after ")


# ── executed ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", HANDS)
def test_the_object_arrives_and_nothing_slips(name: str) -> None:
    """In a plant that is not ours: within 1 mm and 1° of the goal, and of every instant of the way; fingertips always touch."""
    grasp = find_move_grasp(name)
    pace = tracking.time_scale_plan(planned(name), grasp, SETTINGS)
    assert isinstance(pace, tracking.TimeScaledPlan), pace.reason
    plant = Plant(simulation.build_scene(grasp, gravity_H=SETTINGS.gravity_H))
    controller = ObjectController(grasp, SETTINGS)
    run = simulation.simulate(plant, controller, pace.reference(), pace.duration + 0.02)
    metrics = simulation.compute_metrics(run)
    assert np.linalg.norm(run.p_desired[-1] - grasp.p_HO - MOVES[name][0]) < 1e-12
    arrived = run.since(pace.duration)
    assert np.linalg.norm(arrived.position_error, axis=1).max() < 1e-3  # m
    assert np.degrees(np.linalg.norm(arrived.orientation_error, axis=1)).max() < 1.0
    assert metrics.position_error_peak < 1e-3
    assert metrics.lost_contact_steps == 0
    assert run.violation.max() < 1e-9  # N
    assert metrics.min_slip_margin > 0.5  # N, of the 1 N that both planner and controller keep


@pytest.mark.parametrize(
    ("hand", "along", "said"),
    [
        ("allegro_right", (0.0, 0.01, 0.0), ""),
        (
            "allegro_right",
            (0.02, 0.0, 0.0),
            "joint_.* exceeds its speed limit",
        ),  # near a posture in which it would have to spin
        ("four_finger", (0.0, 0.0, 0.005), "finger_. cannot follow without spinning on the object"),
    ],
)
def test_a_motion_that_would_spin_a_soft_fingertip_is_known_before_it_begins(
    hand: str, along: tuple[float, float, float], said: str
) -> None:
    """The same motion by points is at no fault."""
    points = three_finger_grasp() if hand == "allegro_right" else find_move_grasp(hand)
    settings = replace(SETTINGS, slip_margin=0.5, gravity_H=PALM_UP if hand == "allegro_right" else SETTINGS.gravity_H)
    soft = [replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
    grasp = replace(points, contacts=ContactSet.stack(soft))
    follow = simulation.linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), along, 0.6)
    assert tracking.check_motion_tracking(follow, 0.6, points, settings).fault == ""
    gone = tracking.check_motion_tracking(follow, 0.6, grasp, settings)
    assert bool(gone.fault) == bool(said)
    assert re.match(said, gone.fault)
    assert (gone.fault_time < 0.6) == bool(said)
