"""Wrenches of many motions against a sum over point masses and against the wrench of each motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.grasp.body import Body

G = np.array([1.0, -2.0, -9.0])  # m/s²
SPIN, PATH, STEP = np.array([5.0, -7.0, 11.0]), np.array([0.3, 0.2, -0.4]), 1e-4  # rad/s, m, s


def place(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return position and axes of O: an arc with two combined rotations."""
    first, second = Rotation.from_rotvec(SPIN * np.sin(t)), Rotation.from_rotvec(SPIN[::-1] * t**2)
    return PATH * np.sin(3.0 * t), (first * second).as_matrix()


def test_wrenches_are_sums_over_point_masses() -> None:
    """Σ mᵢ (r̈ᵢ − g) and Σ (rᵢ − p) × mᵢ (r̈ᵢ − g), r̈ by differences with error STEP² r⁗/12, of order 1e-4 of 1e3."""
    rng = np.random.default_rng(4)
    masses, points = rng.uniform(0.01, 0.05, 12), rng.normal(size=(12, 3)) * [0.02, 0.03, 0.05] + [0.01, 0.02, -0.03]
    mass, com = masses.sum(), masses @ points / masses.sum()
    about = points - com
    inertia = np.einsum("i,ij,ik->jk", masses, about, about)
    body = Body(mass, np.trace(inertia) * np.eye(3) - inertia, com)
    for t in (0.1, 0.5, 0.9):
        (p_0, R_0), (p, R), (p_1, R_1) = (place(t + d) for d in (-STEP, 0.0, STEP))
        accelerations = (p_0 + points @ R_0.T - 2.0 * (p + points @ R.T) + p_1 + points @ R_1.T) / STEP**2 - G
        force = masses @ accelerations
        moment = np.cross(points @ R.T, masses[:, None] * accelerations).sum(axis=0)
        omegas = [Rotation.from_matrix(A.T @ B).as_rotvec() / STEP for A, B in ((R_0, R), (R, R_1))]
        omega, alpha = (omegas[0] + omegas[1]) / 2.0, (omegas[1] - omegas[0]) / STEP
        p_dd = (p_0 - 2.0 * p + p_1) / STEP**2
        (w,) = body.wrenches((R.T @ (p_dd - G))[None], omega[None], alpha[None])
        assert w == pytest.approx(np.concatenate([R.T @ force, R.T @ moment]), rel=1e-4, abs=1e-4 * np.abs(w).max())
        assert np.linalg.norm(np.cross(omega, omega @ body.inertia)) > 0.01 * np.linalg.norm(
            w[3:]
        )  # the gyroscopic term is not negligible
        motion = BodyMotion(p, R, [0.0, 0.0, 0.0, *(R @ omega)], [*p_dd, *(R @ alpha)])
        assert w == pytest.approx(body.wrench(motion, G), rel=1e-9, abs=1e-9)  # R is a rotation to within rounding
