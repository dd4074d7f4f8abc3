"""Tracking of plans: the controller's reference, rolling contacts, time scaling, and the executed move in MuJoCo."""

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
    """Return the plan of a hand's move with the controller's reserves."""
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


def test_object_reference_equals_the_plan_and_then_rests_at_the_goal(plan: Plan) -> None:
    follow = object_reference(plan)
    for t in np.linspace(0.01, 0.99, 9) * plan.duration:
        now, at = follow(t), plan.at([t])
        # Both are quintics through the same knots, of rotation vectors from the start and from the last knot.
        assert now.p_HO == pytest.approx(at.p_HO[0], abs=1e-12)
        assert np.abs(now.R_HO - at.R_HO[0]).max() < 1e-8
        assert now.twist == pytest.approx(at.twist[0], abs=1e-5)
        assert now.acceleration == pytest.approx(at.acceleration[0], rel=1e-3, abs=1e-2)
    for t in (plan.duration, 2.0 * plan.duration):
        assert np.array_equal(follow(t).p_HO, plan.knots.p_HO[-1])
        assert np.abs(np.append(follow(t).twist, follow(t).acceleration)).max() == 0.0


@pytest.mark.parametrize(("time_scale", "window"), [(1.0, 0.0), (1.3, 0.0), (1.0, 0.01), (1.2, 0.02)])
def test_rates_of_the_object_reference_match_differences(plan: Plan, time_scale: float, window: float) -> None:
    """Central differences: error h²/6 times the third derivative, at most about 1e4 m/s³ between the samples of the window."""
    follow, h = object_reference(plan, time_scale=time_scale, window=window), 1e-6
    end = time_scale * plan.duration + window
    for t in (0.123, 0.377, 0.641, 0.893):
        before, now, after = (follow(t * end + d) for d in (-h, 0.0, h))
        assert (after.p_HO - before.p_HO) / (2 * h) == pytest.approx(now.twist[:3], abs=1e-5)
        turned = Rotation.from_matrix(after.R_HO @ before.R_HO.T).as_rotvec() / (2 * h)
        assert turned == pytest.approx(now.twist[3:], abs=1e-5)
        assert (after.twist - before.twist) / (2 * h) == pytest.approx(now.acceleration, rel=1e-3, abs=0.1)


@pytest.mark.parametrize(("time_scale", "window"), [(1.0, 0.0), (1.2, 0.02)])
def test_joint_reference_equals_the_plan_and_matches_differences(plan: Plan, time_scale: float, window: float) -> None:
    follow, h = joint_reference(plan, time_scale=time_scale, window=window), 1e-6
    end = time_scale * plan.duration + window
    for t in (0.123, 0.377, 0.641, 0.893):
        before, now, after = (follow(t * end + d) for d in (-h, 0.0, h))
        for rate, x in ((1, 0), (2, 1)):
            slope = (after[x] - before[x]) / (2 * h)
            assert slope == pytest.approx(now[rate], rel=1e-3, abs=1e-3 * 100.0**x)
        if window == 0.0:
            at = plan.at([t * end / time_scale])
            assert now[0] == pytest.approx(at.q[0], abs=1e-12)
            assert now[1] == pytest.approx(at.v[0] / time_scale, abs=1e-9)
            assert now[2] == pytest.approx(at.a[0] / time_scale**2, abs=1e-6)
    q, v, a = follow(end)
    assert np.array_equal(q, plan.knots.q[-1])
    assert not np.append(v, a).any()


def test_window_reduces_steps_in_acceleration_and_time_scale_reduces_accelerations(plan: Plan) -> None:
    times = np.arange(0.0, 1.5 * plan.duration, 2.5e-4)

    def accelerations(**options: float) -> np.ndarray:
        return np.array([object_reference(plan, **options)(t).acceleration for t in times])

    hard, soft, slow = accelerations(), accelerations(window=0.01), accelerations(time_scale=1.25)
    largest = np.abs(hard).max()
    assert np.abs(np.diff(hard, axis=0)).max() > 0.5 * largest
    assert (
        np.abs(np.diff(soft, axis=0)).max() < 0.2 * largest
    )  # at most two samples of sixteen change from acceleration to braking
    assert np.abs(soft).max() <= largest * (1.0 + 1e-9)
    assert np.abs(slow).max() == pytest.approx(largest / 1.25**2, rel=1e-2)


def test_invalid_reference_names_its_field(plan: Plan) -> None:
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


# ── reserves for the controller ───────────────────────────────────────────────────────────────────────────────────────────────


def test_object_task_keeps_the_reserves_of_the_controller(plan: Plan) -> None:
    """A tenth of the hand's torque and of the contacts' friction, and the slip margin."""
    grasp = find_move_grasp("allegro_right")
    share = np.abs(plan.knots.tau) / grasp.hand.torque_upper
    assert share.max() <= 0.9 * (1.0 + 1e-6)
    f = plan.knots.f.reshape(len(plan.knots.f), -1, 3)
    margin = (0.9 * grasp.contacts.mu * f[..., 2] - np.linalg.norm(f[..., :2], axis=2)).min()  # N
    assert margin >= SETTINGS.slip_margin - 1e-5
    assert share.max() > 0.899 or margin < SETTINGS.slip_margin + 1e-3  # and no more
    with pytest.raises(InvalidInput, match="reserve"):
        tracking.object_task(grasp, SETTINGS, torque_reserve=1.0)
    with pytest.raises(InvalidInput, match="torque"):
        grasp.hand.derated(0.0)


def test_tracking_check_rolls_the_contacts(plan: Plan) -> None:
    """At the end each tip touches the surface, and its centre has left the place of a fixed contact."""
    grasp = find_move_grasp("allegro_right")
    check = tracking.check_tracking(plan, grasp, SETTINGS)
    assert check.fault == ""
    assert check.slip_margin.min() > SETTINGS.slip_margin * (1.0 - 1e-6)
    follow = object_reference(plan, window=tracking.SMOOTHING_WINDOW)
    goal = follow(check.t[-1])
    displacements = []
    for i, name in enumerate(grasp.fingers):
        centre = goal.R_HO.T @ (grasp.hand.tip_pose(check.q[-1], name)[0] - goal.p_HO)
        radius = grasp.hand.finger(name).tip_radius or 0.0
        assert np.linalg.norm(centre) == pytest.approx(0.03 + radius, abs=2e-6)  # second order in the period
        displacements.append(np.linalg.norm(centre - plan.task.tip_centres[i]))
    assert max(displacements) > 5e-4
    dt = SETTINGS.period
    # rad/s: accelerations of about 1e3 rad/s² change sign within the window of five periods
    assert np.diff(check.q, axis=0)[5:-5] / dt == pytest.approx((check.v[5:-6] + check.v[6:-5]) / 2.0, abs=0.1)


@pytest.mark.parametrize("damping", [40.0, 0.1, 0.0])
def test_null_space_joints_reach_the_reference_posture(damping: float) -> None:
    """An object at rest leaves one direction to each of three fingers with four joints, and all four to the free finger.

    The error decays at 10/s, to e⁻⁵ of it after half a second, also with less than critical damping or none.
    """
    grasp = find_move_grasp("allegro_right")
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    free = np.linalg.svd(J)[2][np.linalg.matrix_rank(J, tol=1e-6) :]
    assert len(free) == 3 + 4
    target = grasp.q + 0.05 * np.sign(free.sum(axis=0)) * np.abs(free).max(axis=0)  # rad
    none, settings = np.zeros(grasp.hand.n), replace(SETTINGS, posture_damping=damping)
    check = tracking.check_motion_tracking(lambda t: GraspMotion(rest, target, none, none), 0.5, grasp, settings)
    assert check.fault == ""
    before, after = np.abs(free @ (target - grasp.q)), np.abs(free @ (target - check.q[-1]))
    assert before.max() > 0.04
    # Contacts roll: the free directions at the end differ slightly from those at the start.
    assert (after < 0.01 * before.max()).all()
    idle = sorted(set(range(grasp.hand.n)) - {j for name in grasp.fingers for j in grasp.hand.finger(name).joints})
    error = (target - check.q[-1])[idle]
    assert error == pytest.approx(np.exp(-5.0) * (target - grasp.q)[idle], rel=0.05, abs=1e-9)


def test_plan_beyond_a_joint_speed_is_slowed_just_enough(plan: Plan) -> None:
    """With joint speed limits below the largest speed, σ is their ratio, to its tolerance."""
    grasp = find_move_grasp("allegro_right")
    check = tracking.check_tracking(plan, grasp, SETTINGS)
    fastest = np.abs(check.v).max()
    joints = tuple(replace(joint, velocity=fastest / 1.2) for joint in grasp.hand.joints)
    slow = tracking.time_scale_plan(plan, replace(grasp, hand=replace(grasp.hand, joints=joints)), SETTINGS)
    assert isinstance(slow, tracking.TimeScaledPlan)
    assert 1.2 * 0.97 <= slow.time_scale <= 1.2 * 1.03 + 0.05  # slowed, the window reduces the largest speed a little less
    assert slow.duration == pytest.approx(slow.time_scale * plan.duration + tracking.SMOOTHING_WINDOW)
    joints = tuple(replace(joint, velocity=fastest / 3.0) for joint in grasp.hand.joints)
    failure = tracking.time_scale_plan(plan, replace(grasp, hand=replace(grasp.hand, joints=joints)), SETTINGS)
    assert isinstance(failure, PlanFailure)
    assert failure.joint is not None
    assert f"{failure.joint} exceeds its speed limit, at" in failure.reason


def test_joint_that_reaches_the_end_of_its_range_is_named(plan: Plan) -> None:
    grasp = find_move_grasp("allegro_right")
    check = tracking.check_tracking(plan, grasp, SETTINGS)
    joint = int(np.argmax(check.q[-1] - check.q[0]))
    joints = list(grasp.hand.joints)
    joints[joint] = replace(joints[joint], upper=float(check.q[-1, joint] + check.q[0, joint]) / 2.0)
    failure = tracking.time_scale_plan(plan, replace(grasp, hand=replace(grasp.hand, joints=tuple(joints))), SETTINGS)
    assert isinstance(failure, PlanFailure)
    assert failure.joint == joints[joint].name
    assert f"{joints[joint].name} reaches the end of its range" in failure.reason
    assert failure.reason.startswith("With rolling contacts, after ")


# ── executed ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", HANDS)
def test_executed_move_arrives_without_slip(name: str) -> None:
    """In MuJoCo the object stays within 1 mm and 1° of its reference, and all fingertips stay in contact."""
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
    assert metrics.min_slip_margin > 0.5  # N; planner and controller keep 1 N


@pytest.mark.parametrize(
    ("hand", "displacement", "fault"),
    [
        ("allegro_right", (0.0, 0.01, 0.0), ""),
        (
            "allegro_right",
            (0.02, 0.0, 0.0),
            "joint_.* exceeds its speed limit",
        ),  # near a posture in which it would spin
        ("four_finger", (0.0, 0.0, 0.005), "finger_. cannot follow without spinning on the object"),
    ],
)
def test_spin_of_a_soft_fingertip_is_found_before_the_motion(
    hand: str, displacement: tuple[float, float, float], fault: str
) -> None:
    """The same motion with point contacts has no fault."""
    points = three_finger_grasp() if hand == "allegro_right" else find_move_grasp(hand)
    settings = replace(SETTINGS, slip_margin=0.5, gravity_H=PALM_UP if hand == "allegro_right" else SETTINGS.gravity_H)
    soft = [replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
    grasp = replace(points, contacts=ContactSet.stack(soft))
    follow = simulation.linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), displacement, 0.6)
    assert tracking.check_motion_tracking(follow, 0.6, points, settings).fault == ""
    check = tracking.check_motion_tracking(follow, 0.6, grasp, settings)
    assert bool(check.fault) == bool(fault)
    assert re.match(fault, check.fault)
    assert (check.fault_time < 0.6) == bool(fault)
