"""The fusion of poses in C equals the reference in NumPy to rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import three_finger_grasp
from support.control_grasps import named_grasp, with_all_contact_models
from support.tip_motions import random_rotations

from graspforce import ContactSet
from graspforce.estimation import CameraModel, EstimatorSettings, PoseMeasurement
from graspforce.estimation.pose.compiled_contact_pose import CompiledTracker
from graspforce.estimation.pose.compiled_pose_fusion import CompiledFusion
from graspforce.estimation.pose.contact_pose import ContactPoseTracker
from graspforce.estimation.pose.pose_fusion import Drift, OffsetMemory, PoseFusion, PoseOffset
from graspforce.estimation.pose.pose_history import TimedPose
from graspforce.geometry.poses import interpolate_pose, interpolate_pose_reference
from graspforce.grasp.grasp import Grasp

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

CAMERA = CameraModel(30.0, 0.05, 1e-3, 0.02, 3e-3, 0.01)
ROUNDING = 1e-12


def random_covariance(rng, size, scale):
    """Return a covariance (size, size) of full rank with standard deviations of about `scale`."""
    root = scale * rng.normal(size=(size, size + 2)) / np.sqrt(size)
    return root @ root.T


def random_update(rng):
    """Return the arguments of an update: millimetres and degrees, as a grasp has them."""
    turns = [Rotation.from_rotvec(0.05 * rng.normal(size=3)).as_matrix() for _ in range(2)]
    offset = PoseOffset(2e-3 * rng.normal(size=3), turns[0])
    covariance, rejected = random_covariance(rng, 12, 2e-3), int(rng.integers(3))
    innovation = 0.03 * rng.normal(size=6) if rejected else None
    memory = OffsetMemory(1.0, offset, 2e-3 * rng.normal(size=6), covariance, rejected, innovation)
    pose = TimedPose(1.0 + 0.1 * rng.random(), 0.1 * rng.normal(size=3), random_rotations(rng, 1)[0])
    far = 3e-3 * rng.choice([0.3, 1.0, 10.0])
    R = pose.R_HO @ offset.R @ Rotation.from_rotvec(far * rng.normal(size=3)).as_matrix()
    p = pose.p_HO + pose.R_HO @ offset.p + far * rng.normal(size=3)
    measured = PoseMeasurement(pose.t, p, R, random_covariance(rng, 6, 1e-3) if rng.random() < 0.5 else None)
    drift = Drift(rng.choice([0.0, 0.02]), rng.normal(size=(6, rng.integers(7))))
    return memory, measured, pose, random_covariance(rng, 6, 1e-4), drift


def assert_same(found, expected):
    """Assert that two results agree, covariances relative to the standard deviations."""
    assert found.is_accepted == expected.is_accepted
    assert (found.displacement is None) == (expected.displacement is None)
    ours, theirs = found.memory, expected.memory
    assert (ours.t, ours.rejected) == (theirs.t, theirs.rejected)
    scale = np.sqrt(np.abs(np.diag(theirs.covariance)))
    scale = np.outer(scale, scale)
    np.testing.assert_allclose(ours.covariance / scale, theirs.covariance / scale, rtol=0.0, atol=ROUNDING)
    np.testing.assert_array_equal(ours.covariance, ours.covariance.T)
    for part, law_part in zip((*ours.offset, ours.bias), (*theirs.offset, theirs.bias), strict=True):
        np.testing.assert_allclose(part, law_part, rtol=0.0, atol=ROUNDING)


def test_updates_equal_those_of_the_reference():
    """Accepted and rejected poses; slip, free motions, reported covariances, and a biased camera."""
    rng, settings = np.random.default_rng(0), EstimatorSettings(rejection_limit=3)
    compiled, law = CompiledFusion(CAMERA, settings), PoseFusion(CAMERA, settings)
    accepted, count = 0, 300
    for _ in range(count):
        arguments = random_update(rng)
        found = compiled.update(*arguments)
        assert_same(found, law.update(*arguments))
        accepted += found.is_accepted
        assert not (found.is_accepted and found.memory.covariance.flags.writeable)
    assert 0.2 * count < accepted < 0.8 * count


def test_a_covariance_that_is_not_definite_goes_to_the_reference():
    memory, measured, pose, contact, drift = random_update(np.random.default_rng(1))
    settings, covariance = EstimatorSettings(), np.array(memory.covariance)
    covariance[0, 0] = -1.0
    arguments = replace(memory, covariance=covariance), measured, pose, contact, drift
    found, expected = CompiledFusion(CAMERA, settings).update(*arguments), PoseFusion(CAMERA, settings).update(*arguments)
    np.testing.assert_array_equal(found.memory.covariance, expected.memory.covariance)


def test_interpolated_poses_equal_those_of_the_reference():
    rng = np.random.default_rng(2)
    for share in (0.0, 0.005, 0.5, 1.0):
        p, R = rng.normal(size=(2, 3)), random_rotations(rng, 2)
        found, expected = (each(p[0], R[0], p[1], R[1], share) for each in (interpolate_pose, interpolate_pose_reference))
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-14)
        assert not found[0].flags.writeable
        assert not found[1].flags.writeable
    end = interpolate_pose(p[0], R[0], p[1], R[1], 1.0)
    np.testing.assert_allclose(end[0], p[1], atol=1e-15)
    np.testing.assert_allclose(end[1], R[1], atol=1e-14)


def first_contacts(grasp, count):
    """Return the grasp with its first contacts only."""
    contacts = ContactSet.stack(grasp.contacts.contacts[:count])
    return Grasp(grasp.hand, grasp.body, grasp.fingers[:count], contacts, grasp.q, grasp.p_HO, grasp.R_HO)


@pytest.mark.parametrize("count", [1, 2, None])
@pytest.mark.parametrize("name", ["allegro", "four_finger box", "dlr_hit2 sphere", "anthropomorphic15"])
def test_uncertainty_equals_that_of_the_reference(name, count):
    """One contact leaves three motions free, two leave one; all contact models."""
    grasp = three_finger_grasp() if name == "allegro" else named_grasp(name)
    grasp = with_all_contact_models(grasp, 0) if count is None else first_contacts(grasp, count)
    compiled, law, rng = CompiledTracker(grasp, 1e-3), ContactPoseTracker(grasp, 1e-3), np.random.default_rng(3)
    pose, reference = compiled.start(grasp.q + 1e-3 * rng.normal(size=grasp.hand.n), 1e-6, 5e-4)
    pose = compiled.step(pose, reference, grasp.q, 0.1 * rng.normal(size=grasp.hand.n), compiled.weights)
    found, expected = (each.uncertainty(pose, reference, 1e-7, 1e-5) for each in (compiled, law))
    scale = np.abs(expected.covariance).max()
    np.testing.assert_allclose(found.covariance / scale, expected.covariance / scale, rtol=0.0, atol=ROUNDING)
    projections = [free.free_motions @ free.free_motions.T for free in (found, expected)]
    np.testing.assert_allclose(*projections, rtol=0.0, atol=1e-9)  # 1/(30 mm)² = 1e3 times the rounding
    assert np.linalg.matrix_rank(projections[0], 1e-6) == {1: 3, 2: 1, None: 0}[count]
