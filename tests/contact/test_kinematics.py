"""Rolling contact: accelerations against an integrated rolling motion, parallel transport of the tangents, special shapes."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import three_finger_grasp
from support.control_grasps import ROUND_TIP_GRASPS, named_grasp

from graspforce.contact.compiled_kinematics import rolling_contacts
from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.kinematics import slip_velocity
from graspforce.contact.motion import BodyMotion, TipMotion
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp

AXIS = np.array([2.0, -3.0, 6.0]) / 7.0


def object_motion(grasp: Grasp, t: float) -> BodyMotion:
    """Return a motion of the object with constant acceleration along a line and about a fixed axis."""
    v, a = np.array([0.03, -0.04, 0.05]), np.array([0.3, 0.2, -0.4])
    turn, rate, angular = 0.9 * t + 2.0 * t**2, 0.9 + 4.0 * t, 4.0  # rad, rad/s, rad/s²
    R = Rotation.from_rotvec(turn * AXIS).as_matrix() @ grasp.R_HO
    p = grasp.p_HO + v * t + a * t**2 / 2
    return BodyMotion(p, R, [*(v + a * t), *(rate * AXIS)], [*a, *(angular * AXIS)])


def closest_points(grasp: Grasp, q: np.ndarray, motion: BodyMotion) -> np.ndarray:
    """Return the (N, 3) points of the surface closest to the centres of the tips, in O."""
    tips = np.array([grasp.hand.tip_pose(q, finger)[0] for finger in grasp.fingers])
    assert grasp.body.shape is not None
    return grasp.body.shape.project_to_surface((tips - motion.p_HO) @ motion.R_HO)


def normals(grasp: Grasp, q: np.ndarray, motion: BodyMotion) -> np.ndarray:
    """Return the (N, 3) inward normals at the closest points, in H, from the shape."""
    assert grasp.body.shape is not None
    return grasp.body.shape.inward_normal(closest_points(grasp, q, motion)) @ motion.R_HO.T


def rolling_rates(grasp: Grasp, q: np.ndarray, t: float) -> np.ndarray:
    """Return the smallest joint rates for which finger and object have the same velocity at the contacts.

    Soft fingers also have the object's angular velocity about the normal.
    """
    motion = object_motion(grasp, t)
    rows, velocities = [], []
    n_H = normals(grasp, q, motion)
    for i, (finger, point) in enumerate(zip(grasp.fingers, closest_points(grasp, q, motion), strict=True)):
        arm = motion.R_HO @ point
        J = grasp.hand.point_jacobian(q, finger, motion.p_HO + arm)
        rows.append(J[:3])
        velocities.append(motion.twist[:3] + np.cross(motion.twist[3:], arm))
        if grasp.contacts.gamma[i] > 0.0:
            rows.append(n_H[i : i + 1] @ J[3:])
            velocities.append(n_H[i : i + 1] @ motion.twist[3:])
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(velocities), rcond=None)[0]


def rolled_posture(grasp: Grasp, t: float, steps: int) -> np.ndarray:
    """Return the posture after rolling from time 0 to t: the fourth-order Runge–Kutta method on velocities."""
    q, h = np.array(grasp.q), t / steps
    for i in range(steps):
        s = i * h
        k1 = rolling_rates(grasp, q, s)
        k2 = rolling_rates(grasp, q + h / 2 * k1, s + h / 2)
        k3 = rolling_rates(grasp, q + h / 2 * k2, s + h / 2)
        k4 = rolling_rates(grasp, q + h * k3, s + h)
        q = q + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return q


def contacts_now(grasp: Grasp, q, v, motion: BodyMotion, R_before=None):
    radii = np.array([grasp.hand.finger(finger).tip_radius or 0.0 for finger in grasp.fingers])
    before = grasp.contacts.R_OC if R_before is None else R_before
    return rolling_contacts(grasp.hand.tip_motion(q, v, grasp.fingers), radii, motion, grasp.body.shape, grasp.contacts, before)


@pytest.mark.parametrize("name", ROUND_TIP_GRASPS)
def test_accelerations_of_a_rolling_motion_satisfy_the_law(name: str) -> None:
    """A q̈ = B a + β holds for joints whose rates give finger and object the same velocity at the contacts at all times."""
    grasp, h = named_grasp(name), 1e-3  # s
    motion = object_motion(grasp, 0.0)
    v = rolling_rates(grasp, grasp.q, 0.0)
    v_dot = derivative(lambda t: rolling_rates(grasp, rolled_posture(grasp, t, 1), t), h)
    found = contacts_now(grasp, grasp.q, v, motion)
    a_O = np.concatenate([motion.acceleration[:3] @ motion.R_HO, motion.acceleration[3:] @ motion.R_HO])
    # Truncation is h⁴ times a fifth derivative of about 10⁵ rad/s⁵. The closest point of a superquadric is found by iteration,
    # and its error (1e-9 m) is divided by h.
    atol = 1e-4 if name.endswith("superquadric") else 2e-6  # m/s²
    np.testing.assert_allclose(found.A @ v_dot, found.B @ a_O + found.beta, atol=atol)
    assert np.abs(found.beta).max() > 1e-2  # m/s²: the convective terms matter
    np.testing.assert_allclose(slip_velocity(found, motion), 0.0, atol=1e-12)
    np.testing.assert_allclose(found.gap, 0.0, atol=5e-9)  # m; the tolerance of inverse kinematics is a nanometre


def spins(grasp: Grasp, t: float) -> np.ndarray:
    """Return the (N,) spins n·(ω_F − ω_O) after rolling from time 0 to t, rad/s."""
    q, motion = rolled_posture(grasp, t, 1), object_motion(grasp, t)
    v, n_H = rolling_rates(grasp, q, t), normals(grasp, q, motion)
    omega = np.array([grasp.hand.point_jacobian(q, finger, motion.p_HO)[3:] @ v for finger in grasp.fingers])
    return np.sum(n_H * (omega - motion.twist[3:]), axis=1)


def derivative(of, h: float) -> np.ndarray:
    """Return the derivative at time 0 by central differences over h and h/2 with Richardson extrapolation; fourth order."""
    coarse, fine = (of(h) - of(-h)) / (2 * h), (of(h / 2) - of(-h / 2)) / h
    return (4 * fine - coarse) / 3


def as_soft(grasp: Grasp) -> Grasp:
    """Return the grasp with soft contacts."""
    soft = [replace(each, model="soft", torsional_friction=0.005) for each in grasp.contacts.contacts]
    return replace(grasp, contacts=ContactSet.stack(soft))


@pytest.mark.parametrize("name", [*ROUND_TIP_GRASPS, "dlr_hit2 sphere"])
def test_the_rate_of_the_spin_satisfies_the_law(name: str) -> None:
    """d/dt n·(ω_F − ω_O) = A q̈ − B a − β while point contacts roll with free spin; also for a tip without a radius."""
    grasp, h = named_grasp(name), 1e-3  # s
    motion, v = object_motion(grasp, 0.0), rolling_rates(grasp, grasp.q, 0.0)
    v_dot = derivative(lambda t: rolling_rates(grasp, rolled_posture(grasp, t, 1), t), h)
    found = contacts_now(as_soft(grasp), grasp.q, v, motion).spin
    a_O = np.concatenate([motion.acceleration[:3] @ motion.R_HO, motion.acceleration[3:] @ motion.R_HO])
    twist_O = np.concatenate([motion.twist[:3] @ motion.R_HO, motion.twist[3:] @ motion.R_HO])
    assert found is not None
    assert contacts_now(grasp, grasp.q, v, motion).spin is None
    spinning = spins(grasp, 0.0)
    assert np.abs(spinning).max() > 0.1  # rad/s
    np.testing.assert_allclose(found.A @ v - found.B @ twist_O, spinning, atol=1e-9)
    got = found.A @ v_dot - found.B @ a_O - found.beta
    # The errors of the velocity rows, divided by a tip radius of about 1 cm.
    atol = 1e-2 if name.endswith("superquadric") else 2e-4  # rad/s²
    np.testing.assert_allclose(got, derivative(lambda t: spins(grasp, t), h), atol=atol)
    assert np.abs(found.beta).max() > 1e-1  # rad/s²: the convective terms matter


def test_soft_contacts_of_four_joint_fingers_roll_without_spin() -> None:
    """All four rows of each contact, against an integrated motion."""
    grasp, h = three_finger_grasp(model="soft"), 1e-3  # s
    motion, v = object_motion(grasp, 0.0), rolling_rates(grasp, grasp.q, 0.0)
    v_dot = derivative(lambda t: rolling_rates(grasp, rolled_posture(grasp, t, 1), t), h)
    A, B, beta = ContactConstraints.from_contacts(grasp.contacts).constraint_rows(contacts_now(grasp, grasp.q, v, motion))
    a_O = np.concatenate([motion.acceleration[:3] @ motion.R_HO, motion.acceleration[3:] @ motion.R_HO])
    assert A.shape == (12, grasp.hand.n)
    np.testing.assert_allclose(A @ v_dot, B @ a_O + beta, atol=2e-6)  # m/s²
    np.testing.assert_allclose(spins(grasp, 0.02), 0.0, atol=1e-9)
    point = replace(grasp, contacts=three_finger_grasp().contacts)
    assert np.abs(spins(point, 0.02)).max() > 0.1  # rad/s: point contacts do spin


@pytest.mark.parametrize("name", ["four_finger sphere", "allegro_right cylinder", "four_finger box"])
def test_after_rolling_the_tips_still_touch_and_do_not_slip(name: str) -> None:
    grasp, t = named_grasp(name), 0.04
    q, motion = rolled_posture(grasp, t, 10), object_motion(grasp, t)
    found = contacts_now(grasp, q, rolling_rates(grasp, q, t), motion)
    start = contacts_now(grasp, grasp.q, rolling_rates(grasp, grasp.q, 0.0), object_motion(grasp, 0.0))
    assert np.linalg.norm(found.p_OC - start.p_OC, axis=1).max() > 1e-4  # m: the contacts moved over the object
    np.testing.assert_allclose(found.gap, 0.0, atol=2e-8)  # m; fourth-order steps of 4 ms
    np.testing.assert_allclose(slip_velocity(found, motion), 0.0, atol=1e-12)
    assert grasp.body.shape is not None
    np.testing.assert_allclose(found.p_OC, closest_points(grasp, q, motion), atol=1e-12)
    np.testing.assert_allclose(found.R_OC[:, :, 2], grasp.body.shape.inward_normal(found.p_OC), atol=1e-9)


@pytest.mark.parametrize("name", ROUND_TIP_GRASPS)
def test_jacobians_are_those_of_hand_and_grasp(name: str) -> None:
    grasp = named_grasp(name)
    found = contacts_now(grasp, grasp.q, np.zeros(grasp.hand.n), object_motion(grasp, 0.0))
    contacts = replace(grasp.contacts, p_OC=found.p_OC, R_OC=found.R_OC)
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, contacts, grasp.p_HO, grasp.R_HO)
    np.testing.assert_allclose(found.J, J, atol=1e-14)
    G = contacts.wrench_bases()[:, :, :3]  # all are point contacts
    np.testing.assert_allclose(found.B, np.vstack(G.transpose(0, 2, 1)), atol=1e-15)


def test_slip_velocity_is_the_tangential_velocity_of_the_finger_over_an_object_at_rest() -> None:
    grasp = named_grasp("four_finger box")
    v = np.linspace(-0.3, 0.5, grasp.hand.n)
    motion = BodyMotion(grasp.p_HO, grasp.R_HO)
    found = contacts_now(grasp, grasp.q, v, motion)
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, replace(grasp.contacts, R_OC=found.R_OC), grasp.p_HO, grasp.R_HO)
    np.testing.assert_allclose(slip_velocity(found, motion), (J @ v).reshape(-1, 3)[:, :2], atol=1e-9)


def tip_at(c: np.ndarray, c_rate: np.ndarray) -> TipMotion:
    twist = np.array([[*c_rate, 0.0, 0.0, 0.0]])
    return TipMotion(c[None], np.eye(3)[None], np.stack([np.zeros((1, 6)), twist, np.zeros((1, 6))], axis=2))


def test_a_spinning_tip_that_moves_along_its_normal_keeps_its_spin() -> None:
    """Along n, the normal is constant, so β = 0. A tangential velocity turns the normal."""
    contacts = ContactSet.stack([Contact([0.0, 0.0, 0.03], [0.0, 0.0, -1.0], 0.5, "soft", torsional_friction=0.005)])
    motion, spin = BodyMotion(np.zeros(3), np.eye(3)), np.array([2.0, 0.0, 3.0])  # rad/s
    for rate, beta in (([0.0, 0.0, 0.4], 0.0), ([0.08, 0.0, 0.4], 4.0)):
        tips = tip_at(np.array([0.0, 0.0, 0.04]), np.array(rate))
        tips.rates[0, 3:, 1] = spin
        found = rolling_contacts(tips, np.array([0.01]), motion, Sphere(0.03), contacts, contacts.R_OC).spin
        assert found is not None
        # n = −c/|c| turns by −0.08 m/s over 0.04 m in x, so n·ω_F changes by −2 · 2 rad/s².
        # The rate of the closest point is a difference over ±0.4 m/s · 1e-4 s, a thousandth of 0.04 m: relative error 1e-6.
        np.testing.assert_allclose(found.beta, beta, atol=2e-5)


def test_tangents_turn_by_the_solid_angle_around_a_closed_path_on_a_sphere() -> None:
    """Parallel transport: a circle at colatitude θ turns the tangents by 2π (1 − cos θ)."""
    theta, radius, r = 0.7, 0.03, 0.01
    contacts = ContactSet.stack([Contact([0.0, 0.0, radius], [0.0, 0.0, -1.0], 0.5)])
    motion, turned = BodyMotion(np.zeros(3), np.eye(3)), []
    for steps in (200, 400):
        R = R_first = None
        for phi in np.linspace(0.0, 2 * np.pi, steps + 1):
            out = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
            tips = tip_at((radius + r) * out, np.zeros(3))
            found = rolling_contacts(tips, np.array([r]), motion, Sphere(radius), contacts, contacts.R_OC if R is None else R)
            R = found.R_OC
            R_first = R if R_first is None else R_first
        cosine, sine = R_first[0, :, 0] @ R[0, :, 0], R_first[0, :, 1] @ R[0, :, 0]
        turned.append(np.arctan2(sine, cosine))
        np.testing.assert_allclose(R[0].T @ R[0], np.eye(3), atol=1e-14)
        assert np.linalg.det(R[0]) == pytest.approx(1.0)
    # With an inward n the sign is reversed. The error of a step is of second order, their sum of first order.
    expected = -2 * np.pi * (1 - np.cos(theta))
    errors = [abs(angle - expected) for angle in turned]
    assert errors[1] < 3e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


def test_a_tip_in_deep_penetration_keeps_its_normal() -> None:
    """Also with its centre inside the object, and on its surface."""
    contacts = ContactSet.stack([Contact([0.0, 0.0, 0.03], [0.0, 0.0, -1.0], 0.5)])
    for height, gap in ((0.0405, 5e-4), (0.038, -2e-3), (0.03, -0.01), (0.029, -0.011)):
        tips = tip_at(np.array([0.0, 0.0, height]), np.array([0.01, 0.0, 0.0]))
        found = rolling_contacts(
            tips, np.array([0.01]), BodyMotion(np.zeros(3), np.eye(3)), Sphere(0.03), contacts, contacts.R_OC
        )
        np.testing.assert_allclose(found.R_OC, contacts.R_OC, atol=1e-12)
        assert found.gap[0] == pytest.approx(gap, abs=1e-12)


def test_a_body_without_a_shape_is_a_plane_at_each_contact() -> None:
    """The faces of a box are planes, so the contacts are the same with and without its shape."""
    grasp = named_grasp("four_finger box")
    shapeless = dataclasses.replace(grasp, body=Body(grasp.body.mass, grasp.body.inertia))
    motion, v = object_motion(grasp, 0.0), np.linspace(-0.4, 0.4, grasp.hand.n)
    with_shape, without_shape = contacts_now(grasp, grasp.q, v, motion), contacts_now(shapeless, grasp.q, v, motion)
    for name in ("p_OC", "R_OC", "J", "A", "B", "beta", "velocity", "gap"):
        np.testing.assert_allclose(getattr(without_shape, name), getattr(with_shape, name), atol=1e-8)


def test_a_tip_without_a_radius_keeps_its_contact_point() -> None:
    grasp = named_grasp("anthropomorphic15")
    q = grasp.q + 1e-3
    found = contacts_now(grasp, q, np.ones(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO, 0.1 * np.ones(6)))
    np.testing.assert_array_equal(found.p_OC, grasp.contacts.p_OC)
    np.testing.assert_array_equal(found.R_OC, grasp.contacts.R_OC)
    # The gap is the distance of its origin from there, against the normal.
    tips = np.array([grasp.hand.tip_pose(q, finger)[0] for finger in grasp.fingers]) - grasp.p_HO
    np.testing.assert_allclose(
        found.gap, -np.sum((tips - grasp.contacts.p_OC) * grasp.contacts.R_OC[:, :, 2], axis=1), atol=1e-15
    )


def test_a_tip_that_moves_over_an_edge_keeps_a_valid_frame() -> None:
    """From the upper face of a box to the side to which t₁ pointed: n has turned into the previous t₁."""
    grasp = ContactSet.stack([Contact([0.0, 0.0, 0.03], [0.0, 0.0, -1.0], 0.5, tangent=[1.0, 0.0, 0.0])])
    for side in (1.0, -1.0):
        tips = tip_at(np.array([side * 0.04, 0.0, 0.0]), np.zeros(3))
        motion = BodyMotion(np.zeros(3), np.eye(3))
        found = rolling_contacts(tips, np.array([0.01]), motion, Box([0.06, 0.06, 0.06]), grasp, grasp.R_OC)
        np.testing.assert_allclose(found.p_OC[0], [side * 0.03, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(found.R_OC[0, :, 2], [-side, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(found.R_OC[0, :, 1], grasp.R_OC[0, :, 1], atol=1e-15)
        np.testing.assert_allclose(found.R_OC[0].T @ found.R_OC[0], np.eye(3), atol=1e-15)
        assert np.linalg.det(found.R_OC[0]) == pytest.approx(1.0)


def test_contacts_of_all_models_have_their_rows() -> None:
    """Two soft, one frictionless and one point contact have as many components as four point contacts, but other ones."""
    grasp = named_grasp("four_finger sphere")
    soft = [replace(each, model="soft", torsional_friction=0.005) for each in grasp.contacts.contacts[:2]]
    slick = [replace(each, model="frictionless", friction=None) for each in grasp.contacts.contacts[2:]]
    for contacts in (ContactSet.stack([*soft, slick[0], grasp.contacts.contacts[3]]), ContactSet.stack([*soft, *slick])):
        again = replace(grasp, contacts=contacts)
        found = contacts_now(again, grasp.q, np.zeros(grasp.hand.n), object_motion(grasp, 0.0))
        now = replace(contacts, p_OC=found.p_OC, R_OC=found.R_OC)
        J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, now, grasp.p_HO, grasp.R_HO)
        np.testing.assert_allclose(found.J, J, atol=1e-14)
