"""Accelerations that keep the contacts: the C code equals the reference in Python, and both equal the pseudo-inverse."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import GRASP_NAMES, named_grasp, soft_box_grasp

from graspforce.contact.kinematics import rolling_contacts_reference
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectControlLaw
from graspforce.control.contacts.contact_constraints import SPIN_DAMPING
from graspforce.control.contacts.mobility import (
    SPIN_DAMPING_START,
    MassFactor,
    compute_accelerations,
    compute_accelerations_reference,
    compute_damped_accelerations,
)
from graspforce.grasp.body import Body

native = pytest.importorskip("graspforce.core._native", reason="the C code was not built: no C compiler at installation")


@pytest.mark.parametrize("name", GRASP_NAMES)
def test_c_code_equals_reference_for_every_grasp(name: str) -> None:
    grasp, rng = named_grasp(name), np.random.default_rng(14)
    radii = np.array([grasp.hand.finger(finger).tip_radius or 0.0 for finger in grasp.fingers])
    for _ in range(5):
        q, v = grasp.q + 0.02 * rng.normal(size=grasp.hand.n), 0.3 * rng.normal(size=grasp.hand.n)
        motion = BodyMotion(grasp.p_HO + 1e-3 * rng.normal(size=3), grasp.R_HO, 0.1 * rng.normal(size=6))
        tips = grasp.hand.tip_motion(q, v, grasp.fingers)
        rolling = rolling_contacts_reference(tips, radii, motion, grasp.body.shape, grasp.contacts, grasp.contacts.R_OC)
        posture, acceleration = 10.0 * rng.normal(size=grasp.hand.n), rng.normal(size=6)
        M_factor, tolerance = MassFactor.from_body(grasp.body), ControlSettings().rank_tolerance
        arguments = rolling.A, rolling.B, rolling.beta, acceleration, posture, M_factor, tolerance
        found, expected = compute_accelerations(*arguments), compute_accelerations_reference(*arguments)
        # The condition of A is below 1/rank_tolerance, and the normal equations square it: 1e4 roundings of 100 rad/s².
        scale = np.abs(expected.joint_acceleration).max()
        np.testing.assert_allclose(found.joint_acceleration, expected.joint_acceleration, rtol=0.0, atol=1e-10 * scale)
        np.testing.assert_allclose(found.object_acceleration, expected.object_acceleration, atol=1e-12)
        assert (found.Q is None) == (expected.Q is None)


def matrix_with_singular_values(rng: np.random.Generator, r: int, n: int, sigma: np.ndarray) -> np.ndarray:
    """Return a random (r, n) matrix."""
    left, right = (np.linalg.qr(rng.normal(size=(size, size)))[0] for size in (r, n))
    return left @ np.diag(sigma) @ right[:, :r].T


def test_c_code_equals_pseudo_inverse_or_reports_missing_rank() -> None:
    rng, tolerance, count = np.random.default_rng(16), 0.01, {True: 0, False: 0}
    for _ in range(300):
        r = int(rng.integers(1, 17))
        n = r + int(rng.integers(0, 8))
        sigma = 0.05 * np.append(rng.uniform(0.1, 1.0, r - 1), rng.choice([1.0, 0.3, 0.05, 0.02, 0.005, 0.0]))  # m/rad
        A, B, beta = matrix_with_singular_values(rng, r, n, sigma), rng.normal(size=(r, 6)), rng.normal(size=r)
        a, posture, joints = rng.normal(size=6), 5.0 * rng.normal(size=n), np.empty(n)
        has_full_rank = native.joint_accelerations(
            A=A,
            B=B,
            beta=beta,
            object_acceleration=a,
            posture=posture,
            rank_tolerance=tolerance,
            joint_acceleration=joints,
        )
        count[has_full_rank] += 1
        if not has_full_rank:
            assert sigma.min() <= tolerance * sigma.max() * r  # ‖L⁻¹‖² tr K is at most r² σ_max²/σ_min²
            continue
        assert sigma.min() > tolerance * sigma.max()
        expected = posture + np.linalg.pinv(A) @ (B @ a + beta - A @ posture)
        np.testing.assert_allclose(joints, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())
        np.testing.assert_allclose(A @ joints, B @ a + beta, rtol=0.0, atol=1e-11 * np.abs(expected).max())
    assert min(count.values()) > 30


def test_nan_counts_as_missing_rank() -> None:
    arguments = {"A": np.full((1, 2), np.nan), "B": np.ones((1, 6)), "beta": np.ones(1), "object_acceleration": np.ones(6)}
    arguments |= {"posture": np.zeros(2), "rank_tolerance": 0.01, "joint_acceleration": np.empty(2)}
    assert native.joint_accelerations(**arguments) is False


def test_damped_rows_yield_near_a_loss_of_rank_and_the_others_stay_exact() -> None:
    """Three damped rows of which two become dependent. Far from it, the result is that of the pseudo-inverse."""
    rng, n = np.random.default_rng(17), 16
    damping = np.repeat([0.0, SPIN_DAMPING], [9, 3])  # m/rad
    exact = matrix_with_singular_values(rng, 11, n, rng.uniform(0.02, 0.1, 11))  # m/rad
    direction = np.linalg.svd(exact)[2][-1]  # not a combination of the rows
    a, B, beta, posture = rng.normal(size=6), rng.normal(size=(12, 6)), rng.normal(size=12), rng.normal(size=n)
    last = None
    for distance in np.geomspace(0.02, 1e-6, 800):  # m/rad
        A = np.vstack([exact, exact[-1] + distance * direction])
        found = compute_damped_accelerations(A, B, beta, a, posture, damping, 0.01)
        joints = found.joint_acceleration
        np.testing.assert_allclose(A[:9] @ joints, B[:9] @ a + beta[:9], rtol=0.0, atol=1e-9 * np.abs(joints).max())
        plain = posture + np.linalg.pinv(A) @ (B @ a + beta - A @ posture)
        if 1.0 / np.trace(np.linalg.inv(A @ A.T)) >= SPIN_DAMPING_START**2:
            np.testing.assert_allclose(joints, plain, rtol=0.0, atol=1e-9 * np.abs(plain).max())
        assert last is None or np.abs(joints - last).max() < 0.15 * np.abs(joints).max()  # continuous: 1.2 % a step
        last = joints
    assert np.abs(joints).max() < 1e-3 * np.abs(plain).max()
    dependent = np.vstack([exact[:8], exact[0], exact[9:], direction])  # a row that is not damped
    assert compute_damped_accelerations(dependent, B, beta, a, posture, damping, 0.01) is None


def test_c_code_damps_spins_as_the_reference() -> None:
    grasp, rng = soft_box_grasp(), np.random.default_rng(18)
    laws = [ObjectControlLaw(grasp, ControlSettings()) for _ in range(2)]
    laws[1]._compiled = None
    assert laws[0]._constraints.spin_damping == SPIN_DAMPING
    damped = 0
    for _ in range(120):
        q, v = grasp.q + 0.06 * rng.normal(size=grasp.hand.n), 0.3 * rng.normal(size=grasp.hand.n)
        state = GraspState(q, v, BodyMotion(grasp.p_HO + 1e-3 * rng.normal(size=3), grasp.R_HO, 0.1 * rng.normal(size=6)))
        desired = BodyMotion(grasp.p_HO, grasp.R_HO)
        found, expected = (law.compute_targets(law.initial_memory(), state, desired, None) for law in laws)
        joints = expected.joint_acceleration
        np.testing.assert_allclose(found.joint_acceleration, joints, rtol=0.0, atol=1e-9 * np.abs(joints).max())
        A = laws[0]._constraints.constraint_rows(expected.rolling)[0]
        damped += 1.0 / np.trace(np.linalg.inv(A @ A.T)) < SPIN_DAMPING_START**2
    assert damped > 3


@pytest.mark.parametrize("size", [0.5, 0.02, 0.005, 1e-5])
def test_errors_are_corrected_along_weak_constraints_and_not_along_others(size: float) -> None:
    """Two rows without joints constrain a body of unit mass and inertia: v_x, and v_y with a size."""
    body = Body(1.0, np.eye(3))
    A, B = np.zeros((3, 4)), np.zeros((3, 6))
    A[2, 0], B[2, 2], B[0, 0], B[1, 1] = 1.0, 1.0, 1.0, size
    found = compute_accelerations(A, B, np.zeros(3), np.zeros(6), np.zeros(4), MassFactor.from_body(body), 0.01)
    np.testing.assert_allclose(np.abs(found.uncontrollable), np.eye(6)[:2], atol=1e-12)
    is_corrected = size < 0.01  # of the largest
    np.testing.assert_allclose(found.feasible_projection, np.diag([0.0, float(is_corrected), 1.0, 1.0, 1.0, 1.0]), atol=1e-12)
