"""The fusion is exact for late images, consistent on noise, equivariant, and robust to outliers and loss."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from graspforce.estimation import CameraModel, EstimatorSettings, PoseMeasurement
from graspforce.estimation.pose.pose_fusion import Drift, PoseFusion, PoseOffset
from graspforce.estimation.pose.pose_history import TimedPose

NO_DRIFT = Drift(0.0, np.zeros((6, 0)))
NO_NOISE = np.zeros((6, 6))
CAMERA = CameraModel(30.0, 0.05, 1e-3, 0.02)


def rotation(vector):
    return Rotation.from_rotvec(vector).as_matrix()


def contact_pose(t: float) -> TimedPose:
    """Return the pose from the contacts of an object in motion."""
    return TimedPose(t, np.array([0.1 * np.sin(3.0 * t), 0.2, 0.05 * t]), rotation([0.5 * t, 0.3, -np.cos(t)]))


ZERO, NONE, NO_TURN = np.zeros(6), np.zeros(3), np.eye(3)


def camera_pose(pose, p=NONE, R=NO_TURN, bias=ZERO, noise=ZERO):
    """Return a camera pose of an object with the offset (p, R), with a constant error and noise in H."""
    true_p, true_R = pose.p_HO + pose.R_HO @ p, pose.R_HO @ R
    return PoseMeasurement(pose.t, true_p + bias[:3] + noise[:3], rotation(bias[3:]) @ rotation(noise[3:]) @ true_R)


def offset_error(memory, p, R):
    """Return the error (6,) of the estimated offset."""
    return np.append(p - memory.offset.p, Rotation.from_matrix(R @ memory.offset.R.T).as_rotvec())


def run(fusion, poses, memory=None):
    """Return the memory after camera poses and the number of accepted ones."""
    memory, accepted = memory or fusion.initial_memory(0.0), 0
    for measured in poses:
        memory, ok, _ = fusion.update(memory, measured, contact_pose(measured.t), NO_NOISE, NO_DRIFT)
        accepted += ok
    return memory, accepted


def test_a_constant_offset_is_found_whatever_the_motion():
    """Without noise, the offset converges as the covariance of a constant does: to 1/(1 + k P/R) after k images."""
    settings = EstimatorSettings(position_drift=0.0, angle_drift=0.0, position_error=1e-2, angle_error=0.1)
    p, R = np.array([2e-3, -1e-3, 3e-3]), rotation([0.02, 0.05, -0.03])
    poses = [camera_pose(contact_pose(k / 30.0), p, R) for k in range(1, 101)]
    memory, accepted = run(PoseFusion(CAMERA, settings), poses)
    assert accepted == 100
    left = offset_error(memory, p, R)
    np.testing.assert_allclose(left[:3], p / (1.0 + 100 * 1e-4 / 1e-6), rtol=1e-3)
    assert np.abs(left[3:]).max() < 0.05 / (1.0 + 100 * 1e-2 / 4e-4) * 1.2


def test_noise_free_images_of_a_known_offset_change_nothing():
    """The innovation at the image's time is zero, however fast the object moves meanwhile: the delay is exact."""
    fusion = PoseFusion(CAMERA, EstimatorSettings())
    memory, accepted = run(fusion, [camera_pose(contact_pose(t)) for t in np.linspace(0.1, 5.0, 40)])
    assert accepted == 40
    np.testing.assert_allclose(offset_error(memory, np.zeros(3), np.eye(3)), 0.0, atol=1e-12)


@pytest.mark.parametrize("bias", [0.0, 1.0])
def test_errors_are_as_large_as_the_covariance_says(bias):
    """Over independent runs with drift, noise and bias, the normalised squared errors follow a chi-square distribution."""
    camera = CameraModel(30.0, 0.05, 1e-3, 0.02, 2e-3 * bias, 0.01 * bias)
    settings = EstimatorSettings(gate=0.999999)
    fusion, rng, runs, squares = PoseFusion(camera, settings), np.random.default_rng(0), 80, []
    for _ in range(runs):
        p, R = settings.position_error * rng.normal(size=3), rotation(settings.angle_error * rng.normal(size=3))
        b = bias * np.repeat([2e-3, 0.01], 3) * rng.normal(size=6)
        memory, step = fusion.initial_memory(0.0), 1.0 / 30.0
        for k in range(1, 31):
            p = p + settings.position_drift * np.sqrt(step) * rng.normal(size=3)
            R = rotation(settings.angle_drift * np.sqrt(step) * rng.normal(size=3)) @ R
            pose = contact_pose(k * step)
            noise = np.repeat([1e-3, 0.02], 3) * rng.normal(size=6)
            memory, *_ = fusion.update(memory, camera_pose(pose, p, R, b, noise), pose, NO_NOISE, NO_DRIFT)
        later = fusion.predicted_covariance(memory, memory.t, NO_DRIFT)[:6, :6]
        error = offset_error(memory, p, R)
        squares.append(error @ np.linalg.solve(later, error))
    low, high = stats.chi2.ppf([1e-3, 1.0 - 1e-3], 6 * runs)
    assert low < sum(squares) < high


def test_estimates_are_equivariant_under_a_change_of_the_base_frame():
    fusion, rng = PoseFusion(CAMERA, EstimatorSettings()), np.random.default_rng(1)
    p, R = np.array([0.5, -0.3, 0.2]), rotation([0.4, -1.0, 2.0])
    here = there = fusion.initial_memory(0.0)
    for t in np.linspace(0.1, 1.0, 20):
        pose, noise = contact_pose(t), np.repeat([1e-3, 0.02], 3) * rng.normal(size=6)
        measured = camera_pose(pose, noise=noise)
        moved = PoseMeasurement(t, p + R @ measured.p_HO, R @ measured.R_HO)
        here, *_ = fusion.update(here, measured, pose, NO_NOISE, NO_DRIFT)
        there, *_ = fusion.update(there, moved, TimedPose(t, p + R @ pose.p_HO, R @ pose.R_HO), NO_NOISE, NO_DRIFT)
    np.testing.assert_allclose(there.offset.p, here.offset.p, atol=1e-12)
    np.testing.assert_allclose(there.offset.R, here.offset.R, atol=1e-12)
    np.testing.assert_allclose(there.covariance[:6, :6], here.covariance[:6, :6], atol=1e-15)


def test_outliers_are_rejected_and_leave_the_offset_alone():
    fusion, rng = PoseFusion(CAMERA, EstimatorSettings()), np.random.default_rng(2)
    memory, rejected = fusion.initial_memory(0.0), 0
    for k, t in enumerate(np.linspace(0.1, 10.0, 300)):
        noise = np.repeat([1e-3, 0.02], 3) * rng.normal(size=6)
        if k % 10 == 5:
            noise[:3] += 0.05  # 50 σ
        before = memory
        memory, ok, _ = fusion.update(memory, camera_pose(contact_pose(t), noise=noise), contact_pose(t), NO_NOISE, NO_DRIFT)
        if k % 10 == 5:
            assert not ok
            np.testing.assert_array_equal(memory.offset.p, before.offset.p)
        rejected += not ok
    assert 30 <= rejected <= 30 + 5  # the gate rejects 0.1 % of 270 good poses: 0.27 expected
    assert np.linalg.norm(memory.offset.p) < 1e-3


def test_an_object_that_moved_in_the_fingers_is_found_again():
    """Poses that are rejected but agree are true: the last of them gives the displacement."""
    settings = EstimatorSettings(rejection_limit=5)
    fusion = PoseFusion(CAMERA, settings)
    memory, _ = run(fusion, [camera_pose(contact_pose(t)) for t in np.linspace(0.03, 3.0, 100)])
    p, R = np.array([0.02, 0.0, 0.0]), rotation([0.5, -1.0, 0.3])
    memory, accepted = run(fusion, [camera_pose(contact_pose(t), p, R) for t in np.linspace(3.03, 3.15, 4)], memory)
    assert accepted == 0
    pose = contact_pose(3.2)
    memory, is_accepted, displacement = fusion.update(memory, camera_pose(pose, p, R), pose, NO_NOISE, NO_DRIFT)
    assert is_accepted
    np.testing.assert_allclose(displacement.p, p, atol=2e-3)
    assert Rotation.from_matrix(displacement.R @ R.T).magnitude() < 0.02
    displaced = displacement.times(memory.offset)  # T_contact X D is the object
    np.testing.assert_allclose(displaced.p, p, atol=2e-3)


def test_outliers_that_disagree_are_never_accepted():
    fusion, rng = PoseFusion(CAMERA, EstimatorSettings(rejection_limit=3)), np.random.default_rng(8)
    memory, _ = run(fusion, [camera_pose(contact_pose(t)) for t in np.linspace(0.03, 3.0, 100)])
    wild = [camera_pose(contact_pose(t), 0.05 * rng.normal(size=3)) for t in np.linspace(3.03, 6.0, 100)]
    _, accepted = run(fusion, wild, memory)
    assert accepted == 0


def test_products_and_inverses_of_offsets():
    a, b = PoseOffset(np.array([1.0, 2.0, 3.0]), rotation([0.1, 0.2, 0.3])), PoseOffset(np.ones(3), rotation([1.0, 0.0, -1.0]))
    product = a.times(b).times(b.inverse())
    np.testing.assert_allclose(product.p, a.p, atol=1e-14)
    np.testing.assert_allclose(product.R, a.R, atol=1e-15)


def test_covariance_grows_while_the_camera_is_lost_and_shrinks_afterwards():
    settings = EstimatorSettings()
    fusion = PoseFusion(CAMERA, settings)
    memory, _ = run(fusion, [camera_pose(contact_pose(t)) for t in np.linspace(0.03, 3.0, 100)])
    now, later = (fusion.predicted_covariance(memory, t, NO_DRIFT) for t in (3.0, 8.0))
    growth = np.diag(later - now)
    np.testing.assert_allclose(growth[:3], 5.0 * settings.position_drift**2, rtol=1e-9)
    np.testing.assert_allclose(growth[3:6], 5.0 * settings.angle_drift**2, rtol=1e-9)
    again, ok, _ = fusion.update(memory, camera_pose(contact_pose(8.0)), contact_pose(8.0), NO_NOISE, NO_DRIFT)
    assert ok
    assert np.trace(again.covariance[:3, :3]) < np.trace(later[:3, :3])


def test_slip_and_free_motions_add_to_the_covariance():
    settings = EstimatorSettings()
    fusion = PoseFusion(CAMERA, settings)
    memory, free = fusion.initial_memory(0.0), np.zeros((6, 1))
    free[4] = 1.0
    still, moved = (fusion.predicted_covariance(memory, 1.0, drift) for drift in (NO_DRIFT, Drift(0.5, free)))
    added = moved - still
    np.testing.assert_allclose(np.diag(added)[:3], settings.slip_drift**2 * 0.5)
    assert added[4, 4] > added[3, 3] + 0.9 * settings.free_drift**2


def test_a_reported_covariance_replaces_the_model():
    """With two sensors' variances the update weights them as least squares do: P⁺ = (1/P + 1/R)⁻¹."""
    settings = EstimatorSettings(position_drift=0.0, angle_drift=0.0)
    fusion, pose = PoseFusion(CAMERA, settings), contact_pose(0.0)
    for sigma in (1e-4, 1e-2):
        measured = PoseMeasurement(0.0, pose.p_HO, pose.R_HO, np.diag([sigma**2] * 3 + [1e-4] * 3))
        memory, *_ = fusion.update(fusion.initial_memory(0.0), measured, pose, NO_NOISE, NO_DRIFT)
        expected = 1.0 / (1.0 / settings.position_error**2 + 1.0 / sigma**2)
        np.testing.assert_allclose(np.diag(memory.covariance)[:3], expected, rtol=1e-9)


def test_a_smooth_offset_approaches_its_target_exponentially():
    target = PoseOffset(np.array([1e-3, 2e-3, 0.0]), rotation([0.1, 0.0, -0.2]))
    offset = PoseOffset(np.zeros(3), np.eye(3))
    for _ in range(10):
        offset = offset.approach(target, 0.1)
    np.testing.assert_allclose(target.p - offset.p, 0.9**10 * target.p, rtol=1e-12)
    left = Rotation.from_matrix(target.R @ offset.R.T).as_rotvec()
    np.testing.assert_allclose(left, 0.9**10 * np.array([0.1, 0.0, -0.2]), atol=1e-12)
    for _ in range(400):
        offset = offset.approach(target, 0.1)
    assert offset is target
