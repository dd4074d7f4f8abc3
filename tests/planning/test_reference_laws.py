"""The laws in planning equal their references: rolling contact (`contact.kinematics`) and Newton–Euler (`grasp.body`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import named_grasp

from graspforce.contact.contact import ContactSet
from graspforce.contact.kinematics import RollingContacts, rolling_contacts_reference
from graspforce.contact.matrices import contact_jacobians, grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.planning import tip_contacts
from graspforce.planning.free.program import ObjectMoveProgram, object_move_program
from graspforce.planning.task import GraspTask
from graspforce.planning.trajectory import Trajectory

# Each face, side and sphere has its own equations in CasADi.
GRASPS = ["four_finger sphere", "four_finger cylinder", "four_finger box", "allegro_right sphere", "allegro_right cylinder"]


def random_motion(grasp: Grasp, rng: np.random.Generator) -> BodyMotion:
    """Return the grasp's pose with a random twist and acceleration."""
    size = np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])
    return BodyMotion(grasp.p_HO, grasp.R_HO, size * rng.normal(size=6), size * rng.normal(size=6))


def reference(grasp: Grasp, q: Array, v: Array, motion: BodyMotion) -> RollingContacts:
    """Return the contacts by the reference law."""
    radii = np.array([grasp.hand.finger(finger).tip_radius or 0.0 for finger in grasp.fingers])
    tips = grasp.hand.tip_motion(q, v, grasp.fingers)
    return rolling_contacts_reference(tips, radii, motion, grasp.body.shape, grasp.contacts, grasp.contacts.R_OC)


def rates_in_O(motion: BodyMotion) -> tuple[Array, Array]:
    """Return the twist and the acceleration in O."""
    return tuple((rate.reshape(2, 3) @ motion.R_HO).ravel() for rate in (motion.twist, motion.acceleration))


def as_soft(grasp: Grasp) -> Grasp:
    """Return the grasp with soft contacts."""
    contacts = [replace(each, model="soft", torsional_friction=0.005) for each in grasp.contacts.contacts]
    return replace(grasp, contacts=ContactSet.stack(contacts))


def as_task(grasp: Grasp) -> GraspTask:
    """Return a task that starts from the grasp."""
    return GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)


# ── rolling contact, NumPy for many postures ─────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("is_soft", [False, True])
@pytest.mark.parametrize("name", [*GRASPS, "four_finger superquadric", "dlr_hit2 sphere"])
def test_constraints_of_many_postures_are_those_of_the_reference(name: str, is_soft: bool) -> None:
    """Positions, normals, Jacobians and velocity constraints; compared in O, as the tangents may differ by a turn about n.

    A tip without a radius is compared where it touches: planning takes its origin for the contact, the reference its place on
    the object.
    """
    grasp, rng = named_grasp(name), np.random.default_rng(31)
    grasp = as_soft(grasp) if is_soft else grasp
    task, M, count = as_task(grasp), 4, len(grasp.fingers)
    # Inverse kinematics of the grasp ends at a nanometre.
    is_round = bool(task.is_rolling.all())
    q = grasp.q + (5e-3 if is_round else 0.0) * rng.normal(size=(M, grasp.hand.n))
    tolerance = 1e-10 if is_round else 1e-8
    motions = [random_motion(grasp, rng) for _ in range(M)]
    p_HO, R_HO = np.tile(grasp.p_HO, (M, 1)), np.tile(grasp.R_HO, (M, 1, 1))
    many = tip_contacts.locate_contacts(task, q, p_HO, R_HO)
    twists = np.array([rates_in_O(motion)[0] for motion in motions])
    p_d = np.array([motion.twist[:3] for motion in motions])
    A, b = tip_contacts.constraints(task, many, R_HO, p_d, twists[:, 3:])
    J = contact_jacobians(task.contacts, many.contact_twists, R_HO, many.R_OC)
    for k in range(M):
        one = reference(grasp, q[k], np.zeros(grasp.hand.n), motions[k])
        np.testing.assert_allclose(many.p_OC[k], one.p_OC, atol=1e-12)
        np.testing.assert_allclose(many.R_OC[k, :, :, 2], one.R_OC[:, :, 2], atol=1e-9)
        points = 3 * count

        def in_O(rows: Array, R_OC: Array) -> Array:
            return np.asarray(R_OC @ rows[:points].reshape(count, 3, -1))  # noqa: B023

        np.testing.assert_allclose(in_O(A[k], many.R_OC[k]), in_O(one.A, one.R_OC), atol=tolerance)
        np.testing.assert_allclose(
            in_O(b[k, :, None], many.R_OC[k]), in_O((one.B @ twists[k])[:, None], one.R_OC), atol=tolerance
        )
        same_frames = replace(grasp.contacts, p_OC=many.p_OC[k], R_OC=many.R_OC[k])
        expected = grasp.hand.contact_jacobian(q[k], grasp.fingers, same_frames, grasp.p_HO, grasp.R_HO)
        np.testing.assert_allclose(J[k], expected, atol=1e-12)
        if is_soft and is_round:
            assert one.spin is not None
            length = tip_contacts._SPIN_LENGTH
            np.testing.assert_allclose(A[k, points:], length * one.spin.A, atol=1e-10)
            np.testing.assert_allclose(b[k, points:], length * one.spin.B @ twists[k], atol=1e-10)


@pytest.mark.parametrize("name", GRASPS)
def test_contact_point_rates_are_those_of_the_reference(name: str) -> None:
    """d/dt p_OC of the reference, by central differences, while the joints move and the object is at rest."""
    grasp, rng, h = named_grasp(name), np.random.default_rng(32), 1e-5  # s
    task, v = as_task(grasp), 0.3 * rng.normal(size=grasp.hand.n)
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    before, now, after = (reference(grasp, grasp.q + dt * v, v, rest) for dt in (-h, 0.0, h))
    rates = grasp.hand.tip_motion(grasp.q, v, grasp.fingers).twist[:, :3] @ grasp.R_HO
    found = tip_contacts.closest_point_rates(task, now.tip_contacts.p_OF[None], rates[None])[0]
    np.testing.assert_allclose(found, (after.p_OC - before.p_OC) / (2.0 * h), atol=1e-6)
    assert np.abs(found).max() > 1e-3  # m/s


# ── rolling contact and Newton–Euler, CasADi ─────────────────────────────────────────────────────────────────────────────────


def program_at(grasp: Grasp, motion: BodyMotion, v: Array, a: Array, f: Array) -> ObjectMoveProgram:
    """Return the program of a move whose first knot is the given state. The reference pose of its variables is another one."""
    p_HO = grasp.p_HO + np.array([[0.0, 0.0, 0.0], [1e-3, 2e-3, -1e-3], [2e-3, -1e-3, 3e-3]])
    R_HO = np.array(
        [grasp.R_HO @ Rotation.from_rotvec(turn * np.array([2.0, -1.0, 3.0])).as_matrix() for turn in (0.0, 0.1, 0.2)]
    )

    def knots(first: Array) -> Array:
        return np.tile(first, (3, *(1,) * np.ndim(first)))

    now = reference(grasp, grasp.q, v, motion)
    trajectory = Trajectory(
        np.array([0.0, 0.05, 0.1]),
        *(knots(each) for each in (grasp.q, v, a, np.zeros(grasp.hand.n), f)),
        p_HO,
        R_HO,
        *(knots(each) for each in (motion.twist, motion.acceleration, now.p_OC, now.R_OC, np.zeros(now.p_OC.shape))),
    )
    return object_move_program(as_task(grasp), trajectory)


def values(move: ObjectMoveProgram, index: int) -> Array:
    """Return the values of a set of equations at the first knot."""
    placed, numbers = move.program.structure.equations[index], move.program.parameter_values[index]
    return np.array(placed.equations.value(move.guess[0, list(placed.variables)], numbers)).ravel()


@pytest.mark.parametrize("name", GRASPS)
def test_contact_equations_in_casadi_are_the_reference(name: str) -> None:
    """Slip A v − B V of any velocities; and A q̈ − B a − β of any accelerations, at velocities that roll."""
    grasp, rng = named_grasp(name), np.random.default_rng(33)
    for is_rolling in (False, True):
        motion, v, a = random_motion(grasp, rng), 0.3 * rng.normal(size=grasp.hand.n), 3.0 * rng.normal(size=grasp.hand.n)
        twist, acceleration = rates_in_O(motion)
        if is_rolling:
            found = reference(grasp, grasp.q, v, motion)
            v = np.linalg.lstsq(found.A, found.B @ twist, rcond=None)[0]
        found = reference(grasp, grasp.q, v, motion)
        np.testing.assert_allclose(found.gap, 0.0, atol=1e-8)
        move = program_at(grasp, motion, v, a, np.zeros(grasp.contacts.size))
        slip = (found.A @ v - found.B @ twist).reshape(-1, 3, 1)  # m/s
        left = (found.A @ a - found.B @ acceleration - found.beta).reshape(-1, 3, 1)  # m/s²
        scales = move.variables.scales
        speed, gain = scales.length / scales.time, scales.length / scales.time**2
        for i in range(len(grasp.fingers)):
            R_HC = grasp.R_HO @ found.R_OC[i]
            g = values(move, i)
            np.testing.assert_allclose(g[:3] * speed, (R_HC @ slip[i]).ravel(), atol=1e-7)
            if is_rolling:
                np.testing.assert_allclose(g[3:6] * gain, (R_HC @ left[i]).ravel(), atol=1e-5)
            np.testing.assert_allclose(g[6:9] * scales.length, 0.0, atol=1e-7)
        assert (np.abs(slip).max() < 1e-9) == is_rolling
        assert np.abs(left).max() > 0.1  # m/s²


@pytest.mark.parametrize("name", ["four_finger sphere", "allegro_right box", "dlr_hit2 sphere"])
def test_object_equations_in_casadi_are_newton_and_euler_of_body(name: str) -> None:
    """The residual G f − w of any forces and motions, with rolling and with fixed contacts."""
    grasp, rng = named_grasp(name), np.random.default_rng(34)
    body = Body(0.07, grasp.body.inertia + np.diag([1e-5, 2e-5, 1.5e-5]), 0.01 * rng.normal(size=3), grasp.body.shape)
    grasp = replace(grasp, body=body)
    motion, f = random_motion(grasp, rng), rng.normal(size=grasp.contacts.size)
    found = reference(grasp, grasp.q, np.zeros(grasp.hand.n), motion)
    move = program_at(grasp, motion, np.zeros(grasp.hand.n), np.zeros(grasp.hand.n), f)
    contacts = replace(grasp.contacts, p_OC=found.p_OC, R_OC=found.R_OC)
    residual = grasp_matrix(contacts) @ f - body.wrench(motion, move.task.gravity_H)
    in_H = (residual.reshape(2, 3) @ grasp.R_HO.T) / move.variables.scales.force
    lever = np.linalg.norm(grasp.contacts.p_OC, axis=1).max()  # m
    np.testing.assert_allclose(values(move, -1), [*in_H[0], *in_H[1] / lever], atol=1e-9)
