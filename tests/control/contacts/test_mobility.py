"""Accelerations that keep the contacts: the C code equals the reference in Python, and both equal the pseudo-inverse."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import GRASP_NAMES, named_grasp, soft_box_grasp

from graspforce.contact.kinematics import rolling_contacts_reference
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectControlLaw
from graspforce.control.contacts.mobility import (
    SPIN_COMPLIANCE,
    SPIN_COMPLIANCE_START,
    MassFactor,
    ObjectCompliance,
    compute_accelerations,
    compute_accelerations_reference,
    compute_compliant_accelerations,
)

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


COMPLIANCE = ObjectCompliance(MassFactor.from_body(soft_box_grasp().body).mobility, SPIN_COMPLIANCE)


def test_object_yields_near_a_loss_of_rank_and_all_contacts_are_kept() -> None:
    """Two rows become dependent. Far from it, the result is that of the pseudo-inverse; near it, joints stay slow."""
    rng, n, rows = np.random.default_rng(17), 16, 12
    exact = matrix_with_singular_values(rng, rows - 1, n, rng.uniform(0.02, 0.1, rows - 1))  # m/rad
    direction = np.linalg.svd(exact)[2][-1]  # not a combination of the rows
    B = rng.normal(size=(rows, 6)) * [1.0, 1.0, 1.0, 0.03, 0.03, 0.03]  # contacts at some 30 mm from O
    a, beta, posture = rng.normal(size=6), rng.normal(size=rows), rng.normal(size=n)
    last = None
    for distance in np.geomspace(0.02, 1e-6, 800):  # m/rad
        A = np.vstack([exact, exact[-1] + distance * direction])
        found = compute_compliant_accelerations(A, B, beta, a, posture, COMPLIANCE, 0.01)
        joints, yielded = found.joint_acceleration, found.object_acceleration
        np.testing.assert_allclose(A @ joints, B @ yielded + beta, rtol=0.0, atol=1e-9 * np.abs(joints).max())
        plain = posture + np.linalg.pinv(A) @ (B @ a + beta - A @ posture)
        if 1.0 / np.trace(np.linalg.inv(A @ A.T)) >= SPIN_COMPLIANCE_START**2:
            np.testing.assert_allclose(joints, plain, rtol=0.0, atol=1e-9 * np.abs(plain).max())
            np.testing.assert_array_equal(yielded, a)
        assert last is None or np.abs(joints - last).max() < 0.15 * np.abs(joints).max()  # continuous: 1.2 % a step
        last = joints
    assert np.abs(joints).max() < 1e-3 * np.abs(plain).max()


def test_yielding_accelerations_minimise_the_stated_cost_among_those_that_keep_the_contacts() -> None:
    """The optimality system of the program, solved as one linear system with multipliers."""
    rng, n, rows = np.random.default_rng(21), 16, 12
    factor = MassFactor.from_body(soft_box_grasp().body)
    sigma = np.append(rng.uniform(0.02, 0.1, rows - 1), 1e-3)  # m/rad
    A, B, beta = matrix_with_singular_values(rng, rows, n, sigma), rng.normal(size=(rows, 6)), rng.normal(size=rows)
    a, posture = rng.normal(size=6), rng.normal(size=n)
    found = compute_compliant_accelerations(A, B, beta, a, posture, COMPLIANCE, 0.01)
    least = 1.0 / np.trace(np.linalg.inv(A @ A.T))
    compliance = SPIN_COMPLIANCE * (1.0 - least / SPIN_COMPLIANCE_START**2)
    M = factor.factor @ factor.factor.T / soft_box_grasp().body.mass
    H = np.block([[M, np.zeros((6, n))], [np.zeros((n, 6)), compliance**2 * np.eye(n)]])
    rows_of_both = np.hstack([-B, A])
    system = np.block([[H, rows_of_both.T], [rows_of_both, np.zeros((rows, rows))]])
    expected = np.linalg.solve(system, np.concatenate([M @ a, compliance**2 * posture, beta]))
    np.testing.assert_allclose(found.object_acceleration, expected[:6], rtol=0.0, atol=1e-7 * np.abs(expected[:6]).max())
    np.testing.assert_allclose(found.joint_acceleration, expected[6 : 6 + n], rtol=0.0, atol=1e-7 * np.abs(expected).max())


def test_c_code_yields_as_the_reference() -> None:
    grasp, rng = soft_box_grasp(), np.random.default_rng(18)
    laws = [ObjectControlLaw(grasp, ControlSettings()) for _ in range(2)]
    laws[1]._compiled = None
    assert laws[0]._constraints.compliance == SPIN_COMPLIANCE
    yielding = 0
    for _ in range(120):
        q, v = grasp.q + 0.06 * rng.normal(size=grasp.hand.n), 0.3 * rng.normal(size=grasp.hand.n)
        state = GraspState(q, v, BodyMotion(grasp.p_HO + 1e-3 * rng.normal(size=3), grasp.R_HO, 0.1 * rng.normal(size=6)))
        desired = BodyMotion(grasp.p_HO, grasp.R_HO)
        found, expected = (law.compute_targets(law.initial_memory(), state, desired, None) for law in laws)
        joints = expected.joint_acceleration
        np.testing.assert_allclose(found.joint_acceleration, joints, rtol=0.0, atol=1e-9 * np.abs(joints).max())
        scale = np.abs(expected.object_acceleration).max()
        np.testing.assert_allclose(found.object_acceleration, expected.object_acceleration, rtol=0.0, atol=1e-9 * scale)
        np.testing.assert_allclose(found.w, expected.w, rtol=0.0, atol=1e-9 * np.abs(expected.w).max())
        A = laws[0]._constraints.constraint_rows(expected.rolling)[0]
        yielding += 1.0 / np.trace(np.linalg.inv(A @ A.T)) < SPIN_COMPLIANCE_START**2
    assert yielding > 3
