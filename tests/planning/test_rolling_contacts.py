"""Plans whose contacts roll: equal arcs on both surfaces, no slip, the controller's own law, small tips, edges, spin, files."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

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
    save,
    tracking,
)
from graspforce.planning.check import check
from graspforce.planning.failure import UNREACHABLE
from graspforce.planning.free.program import object_move_program
from graspforce.planning.loads import required_loads
from graspforce.planning.path.joint_path import contact_points, follow_object_path
from graspforce.planning.path.paths import JointPath, knot_grid
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import contacts_at
from graspforce.planning.tip_contacts import contact_frames, locate_contacts

HANDS = list(MOVES)
BALL = 0.03  # m, the radius of what `moves.find_move_grasp` holds


@cache
def rolled(name: str) -> Plan:
    """Return a tracked move with rolling contacts; "free" before the hand's name uses the free method."""
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
    return rolled(request.param)


def tips(plan: Plan, q: Array) -> tuple[Array, Array]:
    """(M, N, 3) and (M, N, 3, 3): the tip frames in H, one posture at a time."""
    hand = plan.task.hand
    poses = [[hand.tip_pose(each, name) for name in plan.task.fingers] for each in q]
    return np.array([[p for p, _ in row] for row in poses]), np.array([[R for _, R in row] for row in poses])


# ── rolling ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_arcs_are_equally_long_on_both_surfaces(plan: Plan) -> None:
    """What a ball that rolls leaves on the object is as long as what the object leaves on the ball."""
    at = plan.at(plan.duration * np.linspace(0.0, 1.0, 400))
    p_HF, R_HF = tips(plan, at.q)
    p_HC = at.p_HO[:, None] + at.p_OC @ at.R_HO.transpose(0, 2, 1)
    p_FC = ((p_HC - p_HF)[:, :, None] @ R_HF)[:, :, 0]
    assert np.linalg.norm(p_FC, axis=2) == pytest.approx(np.tile(plan.task.tip_radii, (len(p_FC), 1)), abs=1e-8)
    on_ball, on_object = (np.linalg.norm(np.diff(x, axis=0), axis=2).sum(axis=0) for x in (p_FC, at.p_OC))
    assert on_object.min() > 1e-4
    # chords, of 400 equal steps in time: short by a part of the square of 1/400 of the arc in radii, the same on neither
    assert on_ball == pytest.approx(on_object, rel=1e-5)


def test_two_balls_roll_by_montana_s_first_equation(plan: Plan) -> None:
    """u = n × ω_rel / (1/r + 1/R) on spheres of radii r and R, ω_rel of the tip as the object sees it, n into the object."""
    task, hand = plan.task, plan.task.hand
    for k in range(2, len(plan.knots.times) - 1, 5):
        at = plan.knots
        for i, name in enumerate(task.fingers):
            omega_F = hand.point_jacobian(at.q[k], name, np.zeros(3))[3:] @ at.v[k]
            spin = at.R_HO[k].T @ (omega_F - at.twist[k, 3:])
            expected = np.cross(at.R_OC[k, i, :, 2], spin) / (1.0 / task.tip_radii[i] + 1.0 / BALL)
            # The foot's rate is a difference over 10 µm of some 30 mm: wrong by the square of that part.
            assert at.p_OC_d[k, i] == pytest.approx(expected, abs=1e-6 * np.abs(at.p_OC_d[k]).max() + 1e-12)


def test_material_points_that_touch_move_alike_at_every_knot(plan: Plan) -> None:
    """By differences of poses over time: the finger's point at the contact and the object's have the same velocity."""
    dt = 1e-3 * plan.duration / 100
    times = plan.knots.times[1:-1:3]
    before, here, after = (plan.at(times + d) for d in (-dt, 0.0, dt))
    p_HC = here.p_HO[:, None] + here.p_OC @ here.R_HO.transpose(0, 2, 1)
    p_HF, R_HF = tips(plan, here.q)
    p_FC = ((p_HC - p_HF)[:, :, None] @ R_HF)[:, :, 0]
    moved = []
    for at in (before, after):
        p, R = tips(plan, at.q)
        finger = p + (R @ p_FC[..., None])[..., 0]
        moved.append(finger - at.p_HO[:, None] - here.p_OC @ at.R_HO.transpose(0, 2, 1))
    speed = np.linalg.norm(here.twist[:, :3], axis=1).max()
    assert np.abs(moved[1] - moved[0]).max() / (2 * dt) < 1e-5 * speed


@pytest.mark.parametrize("name", [*HANDS, "free dlr_hit2"])  # a fourth joint goes where a plan that goes any way wants it
def test_the_controller_s_own_law_leads_joints_and_contacts_the_same_way(name: str) -> None:
    """control.rolling at the plan's pace, one instant after the other, by the midpoint rule in steps that err by 1e-7 rad."""
    plan = rolled(name)
    task, hand = plan.task, plan.task.hand
    follow_plan, steps = object_reference(plan), 400
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


def test_a_small_tip_rolls_as_if_it_stayed() -> None:
    """The tip's middle leaves its place on the object by its radius times angles, and the duration follows to first order."""
    gained, moved = [], []
    for share in (0.02, 0.01):
        hand = load("dlr_hit2")
        small = replace(hand, fingers=tuple(replace(each, tip_radius=share * each.tip_radius) for each in hand.fingers))
        task, middle, q = star_grasp(small)
        turned = Rotation.from_rotvec([0.08, -0.06, 0.1]).as_matrix()
        path = StraightPath(middle, AXES, middle + np.array([-0.006, 0.004, 0.006]), turned)
        rolls, stays = (plan_along(replace(task, rolling=each), path, q) for each in (True, False))
        assert isinstance(rolls, Plan)
        assert isinstance(stays, Plan)
        gained.append(rolls.duration / stays.duration - 1.0)
        moved.append(np.abs(rolls.knots.q[-1] - stays.knots.q[-1]).max())
    assert 1e-4 < abs(gained[0]) < 0.01
    assert moved[0] / moved[1] == pytest.approx(2.0, rel=0.02)
    assert gained[0] / gained[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("name", [*HANDS, "free dlr_hit2"])
def test_a_rehearsal_finds_nothing_to_refuse(name: str) -> None:
    """Told at its own pace, with the window that softens its steps: no fault, and joints go where the plan has them."""
    plan = rolled(name)
    grasp = find_move_grasp(plan.task.hand.name)  # type: ignore[union-attr]
    pace = tracking.time_scale_plan(plan, grasp, SETTINGS)
    assert isinstance(pace, tracking.TimeScaledPlan), pace.reason
    assert pace.time_scale < 1.05
    assert pace.tracking_check.q[-1] == pytest.approx(
        plan.knots.q[-1], abs=5e-3
    )  # it keeps the posture too, the plan moves least


# ── the record ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_places_between_knots_are_where_tips_touch_and_rates_their_derivatives(plan: Plan) -> None:
    t, dt = np.linspace(0.013, 0.987, 77) * plan.duration, 1e-5 * plan.duration
    before, at, after = (plan.at(t + d) for d in (-dt, 0.0, dt))
    assert (after.p_OC - before.p_OC) / (2 * dt) == pytest.approx(at.p_OC_d, abs=1e-5 * np.abs(at.p_OC_d).max())
    now = locate_contacts(plan.task, at.q, at.p_HO, at.R_HO)
    assert now.p_OC == pytest.approx(at.p_OC, abs=1e-8)
    np.testing.assert_allclose(now.R_OC, at.R_OC, atol=1e-6)
    assert np.linalg.norm(at.p_OC, axis=2) == pytest.approx(np.full(at.p_OC.shape[:2], BALL), abs=1e-8)
    assert at.R_OC[..., 2] == pytest.approx(-at.p_OC / BALL, abs=1e-6)
    assert at.R_OC.swapaxes(-1, -2) @ at.R_OC == pytest.approx(np.tile(AXES, (*at.p_OC.shape[:2], 1, 1)), abs=1e-12)
    for end in (0, -1):
        assert np.abs(plan.knots.p_OC_d[end]).max() == 0.0


def test_the_check_sees_a_plan_whose_contacts_do_not_roll() -> None:
    """A plan with middles that stay, held against rolling: its tips slip by millimetres."""
    grasp = find_move_grasp("dlr_hit2")
    task = replace(tracking.object_task(grasp, SETTINGS), rolling=False)
    stays = plan_along(
        task, straight_path(grasp, *map(np.array, MOVES["dlr_hit2"])), grasp.q, settings=PlanSettings(intervals=40)
    )
    assert isinstance(stays, Plan)
    assert stays.check.verified
    found, _ = check(replace(stays, task=replace(task, rolling=True)))
    assert found.drift > 5e-4
    assert not found.verified
    honest = rolled("dlr_hit2")
    shifted = replace(honest.knots, p_OC=honest.knots.p_OC + np.array([1e-5, 0.0, 0.0]))
    assert required_loads(honest.task, shifted).drift.max() == pytest.approx(1e-5, rel=1e-2)


def test_matrices_are_those_of_one_contact_set_at_a_time() -> None:
    plan = rolled("dlr_hit2")
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
    """Return the move's path at its knots, and the joints' there."""
    grasp = find_move_grasp(plan.task.hand.name)  # type: ignore[union-attr]
    path = straight_path(grasp, *map(np.array, MOVES[grasp.hand.name]))
    joints = follow_object_path(plan.task, path, grasp.q)
    assert isinstance(joints, JointPath)
    return path.points(plan.s), joints.points(plan.s)


def test_files_hold_where_the_contacts_are(tmp_path: Path) -> None:
    plan = rolled("allegro_right")
    for ending in ("json", "npz", "csv"):
        save(plan, tmp_path / f"plan.{ending}")
    record = json.loads((tmp_path / "plan.json").read_text())
    assert np.array(record["knots"]["p_OC"]) == pytest.approx(plan.knots.p_OC, abs=0.0)
    with np.load(tmp_path / "plan.npz") as arrays:
        assert arrays["R_OC"] == pytest.approx(plan.knots.R_OC, abs=0.0)
    with (tmp_path / "plan.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    numbers = np.array(rows, dtype=float)
    for i, name in enumerate(plan.task.fingers):
        assert numbers[:, head.index(f"p_OC {name} y [m]")] == pytest.approx(plan.knots.p_OC[:, i, 1], abs=0.0)
        assert numbers[:, head.index(f"R_OC {name} xn")] == pytest.approx(plan.knots.R_OC[:, i, 0, 2], abs=0.0)


# ── shapes, edges and spin ────────────────────────────────────────────────────────────────────────────────────────────────────


def test_frames_turn_by_the_least_that_brings_their_normals_along() -> None:
    """About an axis across both normals: no turn about n is left where the way is a great circle."""
    task = rolled("allegro_right").task
    first = task.contacts.R_OC[0]  # type: ignore[union-attr]
    axis = Rotation.from_rotvec(0.7 * (0.6 * first[:, 0] + 0.8 * first[:, 1])).as_matrix()
    p_OC = np.array(task.contacts.p_OC)  # type: ignore[union-attr]
    p_OC[0] = axis @ p_OC[0]
    found = contact_frames(task, p_OC[None])[0]
    assert found[0] == pytest.approx(axis @ first, abs=1e-9)
    assert found[1:] == pytest.approx(task.contacts.R_OC[1:], abs=1e-9)  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["allegro_right cylinder", "four_finger box"])
def test_other_shapes_roll_by_their_own_feet(name: str) -> None:
    """Nothing slips or leaves by the check, contacts stay on the surface, and on a face normals stay."""
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
    bends = float(np.abs(plan.knots.R_OC - plan.knots.R_OC[0]).max())
    assert bends == pytest.approx(0.0, abs=1e-12) if "box" in name else bends > 1e-3


def test_an_implicit_ball_is_a_ball() -> None:
    grasp = named_grasp("allegro_right sphere")
    ball = ImplicitSurface(lambda x: float(x @ x / BALL**2 - 1.0), lambda x: 2.0 * x / BALL**2, BALL)
    durations = []
    for body in (grasp.body, replace(grasp.body, shape=ball)):
        task = GraspTask(grasp.hand, body, grasp.contacts, grasp.fingers)
        path = StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.array([0.0, 0.001, 0.001]), grasp.R_HO)
        plan = plan_along(task, path, grasp.q, settings=PlanSettings(intervals=40))
        assert isinstance(plan, Plan), plan.reason
        durations.append(plan.duration)
    assert durations[1] == pytest.approx(durations[0], rel=1e-6)


def test_a_contact_that_comes_to_an_edge_is_refused_with_the_place_and_the_finger() -> None:
    """A box lifted between four fingers rolls over their tips; made a slab that ends where they are half way, it ends there."""
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
    there = [name for name, far in zip(grasp.fingers, beyond, strict=True) if far > half]  # all four, but for rounding
    said = re.search(
        r"the contact of (\w+) rolls onto an edge, where the surface has no normal: on an edge or a corner", failure.reason
    )
    assert said is not None
    assert said[1] in there


def test_soft_tips_do_not_spin_where_they_can_and_are_refused_where_they_cannot() -> None:
    for name in ("allegro_right", "dlr_hit2"):
        grasp = find_move_grasp(name)
        task = tracking.object_task(grasp, SETTINGS)
        soft = [replace(each, model="soft", torsional_friction=0.01) for each in task.contacts.contacts]
        task = GraspTask(task.hand, task.body, ContactSet.stack(soft), task.fingers)  # type: ignore[arg-type]
        answer = plan_along(task, straight_path(grasp, 0.3 * np.array(MOVES[name][0]), 0.3 * np.array(MOVES[name][1])), grasp.q)
        if name == "dlr_hit2":  # three joints a finger
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


@pytest.mark.parametrize("name", ["allegro_right cylinder", "four_finger box"])
def test_over_other_shapes_any_way_is_no_slower_than_straight(name: str) -> None:
    grasp = named_grasp(name)
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    turned = grasp.R_HO @ Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    p = grasp.p_HO + np.array([5e-4, -5e-4, 1e-3])
    along = plan_along(task, StraightPath(grasp.p_HO, grasp.R_HO, p, turned), grasp.q, settings=PlanSettings(intervals=20))
    free = plan_free(task, [grasp.p_HO, p], [grasp.R_HO, turned], grasp.q, settings=PlanSettings(intervals=20))
    assert isinstance(along, Plan)
    assert isinstance(free, Plan)
    assert not free.s.size
    assert free.check.verified
    assert free.duration < along.duration
    assert free.knots.R_HO[-1] == pytest.approx(turned, abs=1e-7)


def test_any_way_knows_balls_tubes_and_planes_only() -> None:
    grasp = named_grasp("four_finger superquadric")
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    with pytest.raises(InvalidInput, match=r"body.shape = 'Superquadric'.*a Sphere, Cylinder or Box if tips roll"):
        plan_free(task, [grasp.p_HO, grasp.p_HO + 1e-3], [grasp.R_HO, grasp.R_HO], grasp.q)


@pytest.mark.parametrize("name", ["allegro_right sphere", "allegro_right cylinder", "four_finger box"])
def test_a_rolling_path_satisfies_the_free_program_s_equations(name: str) -> None:
    """What is along a path, put into the program at knots that are not its own: contact, torques, normal force and cone."""
    grasp = named_grasp(name)
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    turned = grasp.R_HO @ Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    plan = plan_along(task, StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + np.array([5e-4, -5e-4, 5e-4]), turned), grasp.q)
    assert isinstance(plan, Plan)
    knots = plan.at(plan.duration * np.linspace(0.0, 1.0, 9))
    move = object_move_program(task, knots)
    back = move.trajectory(move.guess)
    for each in ("q", "v", "a", "f", "p_HO", "R_HO", "twist", "acceleration", "p_OC", "R_OC"):
        assert getattr(back, each) == pytest.approx(getattr(knots, each), abs=1e-7), each
    for i, finger in enumerate(task.fingers):
        placed, numbers = move.program.structure.equations[i], move.program.parameter_values[i]
        joints = list(grasp.hand.finger(finger).joints)
        for k in (2, 5):
            g = np.array(placed.equations.value(move.guess[k, list(placed.variables)], numbers)).ravel()
            assert g[:3] == pytest.approx(0.0, abs=1e-5)  # between the path's knots its quintics slip a little
            assert g[3:6] == pytest.approx(0.0, abs=1e-2)  # and more in acceleration
            assert g[6:9] == pytest.approx(0.0, abs=1e-7)
            assert g[9 : 9 + len(joints)] == pytest.approx(back.tau[k, joints] / grasp.hand.torque_upper[joints], abs=1e-6)
            f = back.f[k].reshape(-1, 3)[i] / move.variables.scales.force
            assert g[-2] == pytest.approx(f[2], abs=1e-6)
            assert g[-1] == pytest.approx((0.7 * f[2]) ** 2 - f[0] ** 2 - f[1] ** 2, abs=1e-6)


def test_what_rolls_begins_on_the_surface() -> None:
    grasp = find_move_grasp("allegro_right")
    task = tracking.object_task(grasp, SETTINGS)
    with pytest.raises(InvalidInput, match=r"contacts\[0\].position.*on the object's surface"):
        replace(task, body=Body.solid(Box(0.06 * np.ones(3)), 0.05))
    assert not replace(task, body=Body.solid(Box(0.06 * np.ones(3)), 0.05), rolling=False).is_rolling.any()
    with pytest.raises(InvalidInput, match="rolling"):
        replace(task, rolling=1)
    assert task.is_rolling.all()
    assert not block().is_rolling.any()


def test_ideal_fingers_and_tips_without_a_radius_stay() -> None:
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


def test_rolling_is_integrated_to_rounding() -> None:
    """Against the classical Runge–Kutta method's 400 steps, by the law as it stands."""
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
