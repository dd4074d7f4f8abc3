"""The wrench and the mass matrix of a rigid body, for any frame O."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Superquadric
from graspforce.grasp.body import Body

GRAVITY = np.array([0.3, -9.0, -3.7])  # m/s², along no axis


def random_body(rng: np.random.Generator) -> Body:
    """Return a body of random point masses, so that its inertia is possible."""
    points, masses = rng.normal(0.0, 0.04, (6, 3)), rng.uniform(0.01, 0.1, 6)
    centre = masses @ points / masses.sum()
    arms = points - centre
    inertia = sum(m * ((r @ r) * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, arms, strict=True))
    return Body(masses.sum(), inertia, centre)


def tumbling(t: float, rng_numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position and axes of O on a smooth path in SE(3)."""
    a, b, c, d = rng_numbers
    p = a * np.sin(3.0 * t) + b * t**2
    return p, (Rotation.from_rotvec(c * np.sin(2.0 * t)) * Rotation.from_rotvec(d * (t + t**2))).as_matrix()


@pytest.mark.parametrize("seed", range(5))
def test_wrench_is_the_rate_of_momentum_minus_gravity(seed):
    """By numerical differentiation of the momentum, without the formulas of Body.wrench."""
    rng = np.random.default_rng(seed)
    body, numbers, h = random_body(rng), rng.normal(0.0, 0.5, (4, 3)), 1e-4

    def twist(t):
        (p0, R0), (p1, R1) = tumbling(t - h / 2, numbers), tumbling(t + h / 2, numbers)
        return np.array([*(p1 - p0) / h, *Rotation.from_matrix(R1 @ R0.T).as_rotvec() / h])

    def momentum(t):
        """Return linear momentum, and angular momentum about H's origin, in H."""
        p, R = tumbling(t, numbers)
        v, omega = np.split(twist(t), 2)
        arm = R @ body.p_OM
        linear = body.mass * (v + np.cross(omega, arm))
        return np.array([*linear, *R @ body.inertia @ R.T @ omega + np.cross(p + arm, linear)])

    t = 0.4
    p, R = tumbling(t, numbers)
    acceleration = (twist(t + h / 2) - twist(t - h / 2)) / h
    force, moment = np.split((momentum(t + h / 2) - momentum(t - h / 2)) / h, 2)
    force = force - body.mass * GRAVITY
    moment = moment - np.cross(p + R @ body.p_OM, body.mass * GRAVITY) - np.cross(p, force)  # from H's origin to O's
    got = body.wrench(BodyMotion(p, R, twist(t), acceleration), GRAVITY)
    # second-order differences with h = 1e-4: 1e-8 times derivatives of a hundred times the value
    np.testing.assert_allclose(R @ got[:3], force, atol=1e-6 * np.linalg.norm(force))
    np.testing.assert_allclose(R @ got[3:], moment, atol=1e-5 * np.linalg.norm(moment))


@given(seed=st.integers(0, 10_000))
def test_mass_matrix_maps_accelerations_from_rest_to_wrenches(seed):
    body = random_body(np.random.default_rng(seed))
    M = body.mass_matrix()
    rest = np.zeros(3)
    columns = [body.wrench(BodyMotion(rest, np.eye(3), np.zeros(6), e), rest) for e in np.eye(6)]
    np.testing.assert_allclose(M, np.transpose(columns), atol=1e-15)
    np.testing.assert_allclose(M, M.T, atol=1e-15)
    assert np.linalg.eigvalsh(M)[0] > 0.0
    L = body.mass_matrix_factor()
    np.testing.assert_allclose(L @ L.T, M, atol=1e-15)
    assert not np.triu(L, 1).any()


@pytest.mark.parametrize(("mass", "far"), [(0.05, 1e16), (1e16, 0.1), (1e-300, 1e9)])
def test_mass_matrix_factor_exists_for_a_body_far_from_its_origin(mass, far):
    """m ĉ ĉ exceeds the inertia by all digits: M_o in floating-point numbers is not positive definite."""
    body = Body(mass, 1e-5 * np.eye(3), [far, 2.0 * far, -far])
    L, M = body.mass_matrix_factor(), body.mass_matrix()
    assert L.diagonal().min() > 0.0
    np.testing.assert_allclose(L @ L.T, M, rtol=1e-12, atol=1e-15 * np.abs(M).max())


def test_inertia_that_is_positive_only_by_rounding_is_rejected():
    axes = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    flat = axes @ np.diag([1.0, 1.0, 1e-20]) @ axes.T
    with pytest.raises(InvalidInput, match="principal moments that are positive"):
        Body(1.0, (flat + flat.T) / 2.0)


def test_wrench_at_rest_is_the_weight_at_the_centre_of_mass():
    body = Body(0.2, 1e-4 * np.eye(3), [0.01, 0.0, 0.02])
    R = Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).as_matrix()  # O's x axis points down, its z axis along H's x
    w = body.wrench(BodyMotion(np.ones(3), R), [0.0, 0.0, -9.81])
    np.testing.assert_allclose(w, [-1.962, 0, 0, 0, -0.02 * 1.962, 0], atol=1e-15)


def test_solid_has_the_inertia_of_its_shape():
    shape = Superquadric([0.03, 0.02, 0.05], [0.8, 0.6])
    mass, inertia = shape.inertia(700.0)
    body = Body.solid(shape, mass)
    np.testing.assert_allclose(body.inertia, inertia, rtol=1e-14)
    assert (body.mass, body.shape) == (mass, shape)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"mass": 0.0}, "mass"),
        ({"mass": float("nan")}, "mass"),
        ({"inertia": np.diag([1.0, 1.0, 2.1])}, "inertia"),
        ({"inertia": np.diag([1.0, 1.0, -1.0])}, "inertia"),
        ({"inertia": np.eye(3) + np.array([[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]])}, "inertia"),
        ({"p_OM": [0, 0]}, "p_OM"),
    ],
)
def test_body_rejects_impossible_values(change, field):
    with pytest.raises(InvalidInput) as caught:
        Body(**{"mass": 1.0, "inertia": np.eye(3), **change})
    assert caught.value.field == field


def test_motion_rejects_a_reflection():
    with pytest.raises(InvalidInput, match="R_HO"):
        BodyMotion(np.zeros(3), np.diag([1.0, 1.0, -1.0]))
