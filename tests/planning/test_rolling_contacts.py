"""Plans with rolling contacts: equal arcs, no slip, agreement with control, small tips, edges, and spin."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from support.control_grasps import named_grasp
from support.hands import load
from support.planning_cases import AXES, block, star_grasp, straight_move
from support.tracked_moves import MOVES, SETTINGS, find_move_grasp, straight_path

from graspforce import InvalidInput
from graspforce.contact.compiled_kinematics import rolling_contacts
from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.matrices import grasp_matrices, grasp_matrix
from graspforce.core.arrays import Array
from graspforce.geometry import Box, ImplicitSurface
from graspforce.grasp.body import Body
from graspforce.planning import (
    GraspTask,
    Plan,
    PlanFailure,
    StraightPath,
    object_reference,
    plan_along,
    plan_free,
    tracking,
)
from graspforce.planning.check import check
from graspforce.planning.failure import UNREACHABLE
from graspforce.planning.loads import required_loads
from graspforce.planning.path.joint_path import contact_points, follow_object_path
from graspforce.planning.path.paths import JointPath, knot_grid
from graspforce.planning.settings import PlanSettings
from graspforce.planning.tip_contacts import contact_frames, contacts_at, locate_contacts

HANDS = list(MOVES)
RADIUS = 0.03  # m, of the sphere of `find_move_grasp`


@cache
def rolling_plan(name: str) -> Plan:
    """Return the plan of a hand's move along a straight path; with "free " before its name, of a free move."""
    *free, name = name.split()
    grasp = find_move_grasp(name)
    task, path = tracking.object_task(grasp, SETTINGS), straight_path(grasp, *map(np.array, MOVES[name]))
    plan = plan_along(task, path, grasp.q)
    assert isinstance(plan, Plan), plan.reason
    if not free:
        return plan
    at = path.points(np.array([0.0, 1.0]))
    found = plan_free(task, at.p, at.R, grasp.q)
    assert isinstance(found, Plan), found.reason
    assert not found.s.size
    assert found.check.verified
    assert found.duration < plan.duration
    return found


@pytest.fixture(params=[*HANDS, "free dlr_hit2", "free allegro_right"])
def plan(request: pytest.FixtureRequest) -> Plan:
    return rolling_plan(request.param)


def tips(plan: Plan, q: Array) -> tuple[Array, Array]:
    """Return the tip frames in H, (M, N, 3) and (M, N, 3, 3), one posture at a time."""
    hand = plan.task.hand
    poses = [[hand.tip_pose(each, name) for name in plan.task.fingers] for each in q]
    return np.array([[p for p, _ in row] for row in poses]), np.array([[R for _, R in row] for row in poses])


# ── rolling ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_arcs_on_both_surfaces_have_equal_lengths(plan: Plan) -> None:
    at = plan.at(plan.duration * np.linspace(0.0, 1.0, 400))
    p_HF, R_HF = tips(plan, at.q)
    p_HC = at.p_HO[:, None] + at.p_OC @ at.R_HO.transpose(0, 2, 1)
    p_FC = ((p_HC - p_HF)[:, :, None] @ R_HF)[:, :, 0]
    assert np.linalg.norm(p_FC, axis=2) == pytest.approx(np.tile(plan.task.tip_radii, (len(p_FC), 1)), abs=1e-8)
    on_tip, on_object = (np.linalg.norm(np.diff(x, axis=0), axis=2).sum(axis=0) for x in (p_FC, at.p_OC))
    assert on_object.min() > 1e-4
    # Sums of 400 chords differ from the arcs by the square of 1/400 of the arc in radii.
    assert on_tip == pytest.approx(on_object, rel=1e-5)


def test_contact_velocity_satisfies_montanas_first_equation(plan: Plan) -> None:
    """u = n × ω_rel / (1/r + 1/R) on spheres of radii r and R, with ω_rel of the tip relative to the object."""
    task, hand = plan.task, plan.task.hand
    for k in range(2, len(plan.knots.times) - 1, 5):
        at = plan.knots
        for i, name in enumerate(task.fingers):
            omega_F = hand.point_jacobian(at.q[k], name, np.zeros(3))[3:] @ at.v[k]
            spin = at.R_HO[k].T @ (omega_F - at.twist[k, 3:])
            expected = np.cross(at.R_OC[k, i, :, 2], spin) / (1.0 / task.tip_radii[i] + 1.0 / RADIUS)
            # The velocity is a central difference over 10 µm on a radius of 30 mm.
            assert at.p_OC_d[k, i] == pytest.approx(expected, abs=1e-6 * np.abs(at.p_OC_d[k]).max() + 1e-12)


def test_material_points_at_contacts_have_equal_velocities(plan: Plan) -> None:
    """Compare the finger's point at the contact with the object's by differences of poses over time."""
    dt = 1e-3 * plan.duration / 100
    times = plan.knots.times[1:-1:3]
    before, here, after = (plan.at(times + d) for d in (-dt, 0.0, dt))
    p_HC = here.p_HO[:, None] + here.p_OC @ here.R_HO.transpose(0, 2, 1)
    p_HF, R_HF = tips(plan, here.q)
    p_FC = ((p_HC - p_HF)[:, :, None] @ R_HF)[:, :, 0]
    offsets = []
    for at in (before, after):
        p, R = tips(plan, at.q)
        finger = p + (R @ p_FC[..., None])[..., 0]
        offsets.append(finger - at.p_HO[:, None] - here.p_OC @ at.R_HO.transpose(0, 2, 1))
    speed = np.linalg.norm(here.twist[:, :3], axis=1).max()
    assert np.abs(offsets[1] - offsets[0]).max() / (2 * dt) < 1e-5 * speed


@pytest.mark.parametrize("name", [*HANDS, "free dlr_hit2"])  # a free move chooses the fourth joint itself
def test_integrated_reference_law_reaches_the_same_joints_and_contacts(name: str) -> None:
    """Integrate the law of `contact.kinematics` by the midpoint rule, with an error of 1e-7 rad."""
    plan = rolling_plan(name)
    task, hand = plan.task, plan.task.hand
    follow_plan, steps = object_reference(plan), 600
    dt = plan.duration / steps

    def at(q: Array, t: float, R_OC: Array):  # type: ignore[no-untyped-def]
        desired = follow_plan(t)
        found = rolling_contacts(
            hand.tip_motion(q, np.zeros(hand.n), task.fingers), task.tip_radii, desired, task.body.shape, task.contacts, R_OC
        )
        twist = (desired.twist.reshape(2, 3) @ desired.R_HO).ravel()
        return found, np.linalg.pinv(found.A) @ found.B @ twist

    q, R_OC = np.array(plan.knots.q[0]), task.contacts.R_OC
    for k in range(steps):
        found, v = at(q, k * dt, R_OC)
        q = q + dt * at(q + dt / 2.0 * v, (k + 0.5) * dt, found.R_OC)[1]
        R_OC = found.R_OC
    found, _ = at(q, plan.duration, R_OC)
    assert q == pytest.approx(plan.knots.q[-1], abs=1e-5)
    assert found.p_OC == pytest.approx(plan.knots.p_OC[-1], abs=1e-7)
    assert found.R_OC[:, :, 2] == pytest.approx(plan.knots.R_OC[-1, :, :, 2], abs=1e-5)
    assert np.abs(found.gap).max() < 1e-7


def test_small_tip_converges_to_a_fixed_contact() -> None:
    """The tip's centre leaves its place by the radius times angles; the duration changes by first order in the radius."""
    gains, motions = [], []
    for share in (0.02, 0.01):
        hand = load("dlr_hit2")
        small = replace(hand, fingers=tuple(replace(each, tip_radius=share * each.tip_radius) for each in hand.fingers))
        task, middle, q = star_grasp(small)
        turned = Rotation.from_rotvec([0.08, -0.06, 0.1]).as_matrix()
        path = StraightPath(middle, AXES, middle + np.array([-0.006, 0.004, 0.006]), turned)
        rolling, fixed = (plan_along(replace(task, rolling=each), path, q) for each in (True, False))
        assert isinstance(rolling, Plan)
        assert isinstance(fixed, Plan)
        gains.append(rolling.duration / fixed.duration - 1.0)
        motions.append(np.abs(rolling.knots.q[-1] - fixed.knots.q[-1]).max())
    assert 1e-4 < abs(gains[0]) < 0.01
    assert motions[0] / motions[1] == pytest.approx(2.0, rel=0.02)
    assert gains[0] / gains[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("name", [*HANDS, "free dlr_hit2"])
def test_plan_with_rolling_contacts_is_trackable(name: str) -> None:
    """With the smoothing window, at nearly its own pace, to nearly the same posture."""
    plan = rolling_plan(name)
    grasp = find_move_grasp(plan.task.hand.name)  # type: ignore[union-attr]
    pace = tracking.time_scale_plan(plan, grasp, SETTINGS)
    assert isinstance(pace, tracking.TimeScaledPlan), pace.reason
    assert pace.time_scale < 1.05
    assert pace.tracking_check.q[-1] == pytest.approx(
        plan.knots.q[-1], abs=5e-3
    )  # the controller keeps the posture; the plan has the smallest joint rates


# ── states and check ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_contacts_between_knots_are_where_tips_touch_with_their_velocities(plan: Plan) -> None:
    t, dt = np.linspace(0.013, 0.987, 77) * plan.duration, 1e-5 * plan.duration
    before, at, after = (plan.at(t + d) for d in (-dt, 0.0, dt))
    assert (after.p_OC - before.p_OC) / (2 * dt) == pytest.approx(at.p_OC_d, abs=1e-5 * np.abs(at.p_OC_d).max())
    now = locate_contacts(plan.task, at.q, at.p_HO, at.R_HO)
    assert now.p_OC == pytest.approx(at.p_OC, abs=1e-8)
    np.testing.assert_allclose(now.R_OC, at.R_OC, atol=1e-6)
    assert np.linalg.norm(at.p_OC, axis=2) == pytest.approx(np.full(at.p_OC.shape[:2], RADIUS), abs=1e-8)
    assert at.R_OC[..., 2] == pytest.approx(-at.p_OC / RADIUS, abs=1e-6)
    assert at.R_OC.swapaxes(-1, -2) @ at.R_OC == pytest.approx(np.tile(AXES, (*at.p_OC.shape[:2], 1, 1)), abs=1e-12)
    for end in (0, -1):
        assert np.abs(plan.knots.p_OC_d[end]).max() < 1e-12  # m/s: a row that the solver meets to rounding


def test_check_finds_contacts_that_slip() -> None:
    """A plan with fixed tip centres slips by millimetres if its contacts should roll."""
    grasp = find_move_grasp("dlr_hit2")
    task = replace(tracking.object_task(grasp, SETTINGS), rolling=False)
    fixed = plan_along(
        task, straight_path(grasp, *map(np.array, MOVES["dlr_hit2"])), grasp.q, settings=PlanSettings(intervals=40)
    )
    assert isinstance(fixed, Plan)
    assert fixed.check.verified
    found, _ = check(replace(fixed, task=replace(task, rolling=True)))
    assert found.drift > 5e-4
    assert not found.verified
    valid = rolling_plan("dlr_hit2")
    shifted = replace(valid.knots, p_OC=valid.knots.p_OC + np.array([1e-5, 0.0, 0.0]))
    assert required_loads(valid.task, shifted).drift.max() == pytest.approx(1e-5, rel=1e-2)


def test_matrices_equal_those_of_single_contact_sets() -> None:
    plan = rolling_plan("dlr_hit2")
    task, knots = plan.task, plan.knots
    soft = [Contact(c.position, c.normal, 0.5, "soft", torsional_friction=0.01) for c in task.contacts.contacts]  # type: ignore[union-attr]
    for each in (task, GraspTask(task.hand, task.body, ContactSet.stack(soft), task.fingers)):  # type: ignore[arg-type]
        G = grasp_matrices(each.contacts, knots.p_OC, knots.R_OC)
        J = contact_points(each, *sampled(each, plan)).J
        for k in (0, 50, 100):
            now = contacts_at(each.contacts, knots.p_OC[k], knots.R_OC[k])
            assert G[k] == pytest.approx(grasp_matrix(now), abs=1e-15)
            alone = task.hand.contact_jacobian(knots.q[k], task.fingers, now, knots.p_HO[k], knots.R_HO[k])
            assert J[k] == pytest.approx(alone, abs=1e-8)


def sampled(task: GraspTask, plan: Plan):  # type: ignore[no-untyped-def]
    """Return the paths of object and joints at the knots."""
    grasp = find_move_grasp(plan.task.hand.name)  # type: ignore[union-attr]
    path = straight_path(grasp, *map(np.array, MOVES[grasp.hand.name]))
    joints = follow_object_path(plan.task, path, grasp.q)
    assert isinstance(joints, JointPath)
    return path.points(plan.s), joints.points(plan.s)


# ── shapes, edges and spin ────────────────────────────────────────────────────────────────────────────────────────────────────


def test_contact_frames_rotate_by_the_smallest_rotation() -> None:
    """Along a great circle no rotation about n remains."""
    task = rolling_plan("allegro_right").task
    first = task.contacts.R_OC[0]  # type: ignore[union-attr]
    axis = Rotation.from_rotvec(0.7 * (0.6 * first[:, 0] + 0.8 * first[:, 1])).as_matrix()
    p_OC = np.array(task.contacts.p_OC)  # type: ignore[union-attr]
    p_OC[0] = axis @ p_OC[0]
    found = contact_frames(task, p_OC[None])[0]
    assert found[0] == pytest.approx(axis @ first, abs=1e-9)
    assert found[1:] == pytest.approx(task.contacts.R_OC[1:], abs=1e-9)  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["allegro_right cylinder", "four_finger box"])
def test_contacts_roll_on_other_shapes(name: str) -> None:
    """No slip by the check, contacts stay on the surface, and normals stay constant on a face."""
    grasp = named_grasp(name)
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    turned = grasp.R_HO @ Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    path = StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.array([5e-4, -5e-4, 1e-3]), turned)
    plan = plan_along(task, path, grasp.q, settings=PlanSettings(intervals=40))
    assert isinstance(plan, Plan), plan.reason
    assert plan.check.drift < 1e-8
    shape = grasp.body.shape
    assert shape is not None
    assert np.abs(shape.project_to_surface(plan.knots.p_OC.reshape(-1, 3)) - plan.knots.p_OC.reshape(-1, 3)).max() < 1e-9
    assert np.linalg.norm(plan.knots.p_OC[-1] - plan.knots.p_OC[0], axis=1).max() > 2e-4
    change = float(np.abs(plan.knots.R_OC - plan.knots.R_OC[0]).max())
    assert change == pytest.approx(0.0, abs=1e-12) if "box" in name else change > 1e-3


def test_implicit_sphere_equals_a_sphere() -> None:
    grasp = named_grasp("allegro_right sphere")
    sphere = ImplicitSurface(lambda x: float(x @ x / RADIUS**2 - 1.0), lambda x: 2.0 * x / RADIUS**2, RADIUS)
    durations = []
    for body in (grasp.body, replace(grasp.body, shape=sphere)):
        task = GraspTask(grasp.hand, body, grasp.contacts, grasp.fingers)
        path = StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.array([0.0, 0.001, 0.001]), grasp.R_HO)
        plan = plan_along(task, path, grasp.q, settings=PlanSettings(intervals=40))
        assert isinstance(plan, Plan), plan.reason
        durations.append(plan.duration)
    assert durations[1] == pytest.approx(durations[0], rel=1e-6)


def test_contact_that_rolls_onto_an_edge_is_located() -> None:
    """A lifted box rolls over the tips; cut to a slab of half that height, it ends where they reach its edge."""
    grasp = named_grasp("four_finger box")
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    path = StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.array([0.0, 0.0, 0.003]), grasp.R_HO)
    whole = plan_along(task, path, grasp.q)
    assert isinstance(whole, Plan)
    half = float(np.abs(whole.knots.p_OC[:, :, 2]).max()) / 2.0  # m, of the slab's height
    assert half > 2.0 * np.abs(grasp.contacts.p_OC[:, 2]).max()
    body = replace(grasp.body, shape=Box([0.06, 0.06, 2.0 * half]))
    failure = plan_along(replace(task, body=body), path, grasp.q)
    assert isinstance(failure, PlanFailure)
    assert failure.kind == UNREACHABLE
    assert failure.s is not None
    joints = follow_object_path(task, path, grasp.q)
    assert isinstance(joints, JointPath)
    s = np.array([failure.s - 2e-3, failure.s + 1e-3])
    before, beyond = np.abs(contact_points(task, path.points(s), joints.points(s)).p_OC[:, :, 2])
    assert before.max() < half < beyond.max()
    at_edge = [name for name, far in zip(grasp.fingers, beyond, strict=True) if far > half]  # all four, to rounding
    match = re.search(
        r"the contact of (\w+) rolls onto an edge, where the surface has no normal: on an edge or a corner", failure.reason
    )
    assert match is not None
    assert match[1] in at_edge


def test_soft_tips_roll_without_spin_or_fail() -> None:
    for name in ("allegro_right", "dlr_hit2"):
        grasp = find_move_grasp(name, seed=3)  # the thumb of the Allegro hand can turn about the normal
        task = tracking.object_task(grasp, SETTINGS)
        soft = [replace(each, model="soft", torsional_friction=0.01) for each in task.contacts.contacts]
        task = replace(task, contacts=ContactSet.stack(soft), collisions=None)  # type: ignore[arg-type]  # the law only
        answer = plan_along(task, straight_path(grasp, 0.3 * np.array(MOVES[name][0]), 0.3 * np.array(MOVES[name][1])), grasp.q)
        if name == "dlr_hit2":  # three joints for each finger
            assert isinstance(answer, PlanFailure)
            assert "would spin on the object: with 3 joints it cannot turn" in answer.reason
            continue
        assert isinstance(answer, Plan), answer.reason
        for k in (20, 50, 80):
            at = answer.knots
            for i, finger in enumerate(task.fingers):
                omega_F = grasp.hand.point_jacobian(at.q[k], finger, np.zeros(3))[3:] @ at.v[k]
                n_H = at.R_HO[k] @ at.R_OC[k, i, :, 2]
                assert n_H @ (omega_F - at.twist[k, 3:]) == pytest.approx(0.0, abs=1e-5 * np.abs(at.v[k]).max())


def test_rolling_contact_must_start_on_the_surface() -> None:
    grasp = find_move_grasp("allegro_right")
    task = tracking.object_task(grasp, SETTINGS)
    with pytest.raises(InvalidInput, match=r"contacts\[0\].position.*on the object's surface"):
        replace(task, body=Body.solid(Box(0.06 * np.ones(3)), 0.05))
    assert not replace(task, body=Body.solid(Box(0.06 * np.ones(3)), 0.05), rolling=False).is_rolling.any()
    with pytest.raises(InvalidInput, match="rolling"):
        replace(task, rolling=1)
    assert task.is_rolling.all()
    assert not block().is_rolling.any()


def test_ideal_fingers_and_tips_without_radius_do_not_roll() -> None:
    lift = plan_along(block(), straight_move(0.0, 0.0, 1.0), settings=PlanSettings(intervals=20))
    assert isinstance(lift, Plan)
    assert (lift.at([0.3 * lift.duration]).p_OC == block().contacts.p_OC).all()  # type: ignore[union-attr]
    hand = load("dlr_hit2")
    pointed = replace(hand, fingers=tuple(replace(each, tip_radius=None) for each in hand.fingers))
    task, middle, q = star_grasp(pointed)
    plan = plan_along(
        task,
        StraightPath(middle, AXES, middle + np.array([-0.003, 0.002, 0.003]), AXES),
        q,
        settings=PlanSettings(intervals=20),
    )
    assert isinstance(plan, Plan)
    assert (plan.knots.p_OC == task.contacts.p_OC).all()  # type: ignore[union-attr]


def test_joint_path_keeps_tips_on_the_surface_with_exact_derivatives() -> None:
    grasp = find_move_grasp("allegro_right")
    task, path = tracking.object_task(grasp, SETTINGS), straight_path(grasp, *map(np.array, MOVES["allegro_right"]))
    joints = follow_object_path(task, path, grasp.q)
    assert isinstance(joints, JointPath)
    s = knot_grid(200)
    at = joints.points(s)
    poses = path.points(s)
    now = locate_contacts(task, at.q, poses.p, poses.R)
    heights = np.linalg.norm(now.p_OC - now.p_OF, axis=2)
    assert heights == pytest.approx(np.tile(task.tip_radii, (len(s), 1)), abs=1e-8)
    assert CubicSpline(s, at.q)(s, 1)[3:-3] == pytest.approx(at.q_s[3:-3], abs=1e-5)
