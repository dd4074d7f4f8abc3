"""The history interpolates exactly where the twist is constant, and old histories stay as they were."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce.estimation.pose.pose_history import PoseHistory, TimedPose

VELOCITY, RATE = np.array([0.1, -0.2, 0.05]), np.array([1.0, 2.0, -3.0])  # m/s, rad/s


def pose_at(t: float) -> TimedPose:
    """Return the pose of a motion with constant velocity and constant angular velocity."""
    return TimedPose(t, VELOCITY * t, Rotation.from_rotvec(RATE * t).as_matrix())


def history(times, max_length=1000):
    result = PoseHistory()
    for t in times:
        result = result.append(pose_at(t), max_length)
    return result


@pytest.mark.parametrize("count", [2, 31, 32, 33, 64, 100])
def test_constant_rates_are_interpolated_exactly(count):
    times = 0.01 * np.arange(count)
    poses = history(times)
    for t in np.concatenate([times, np.random.default_rng(0).uniform(0.0, times[-1], 20)]):
        found, true = poses.pose_at(t), pose_at(t)
        np.testing.assert_allclose(found.p_HO, true.p_HO, atol=1e-15)
        np.testing.assert_allclose(found.R_HO, true.R_HO, atol=1e-14)


def test_there_is_no_pose_outside():
    poses = history(np.linspace(1.0, 2.0, 50))
    assert poses.pose_at(0.999) is None
    assert poses.pose_at(2.001) is None
    assert PoseHistory().pose_at(0.0) is None


def test_old_entries_are_dropped_and_new_ones_kept():
    poses = history(0.001 * np.arange(5000), max_length=256)
    entries = sum(len(chunk) for chunk in poses.chunks) + len(poses.recent)
    assert 224 <= entries <= 256 + 32
    assert poses.newest.t == pytest.approx(4.999)
    assert poses.pose_at(4.999 - 0.2) is not None
    assert poses.pose_at(4.0) is None


def test_appending_leaves_the_old_history_alone():
    before = history([0.0, 1.0])
    after = before.append(pose_at(2.0), 100)
    assert before.newest.t == 1.0
    assert before.pose_at(1.5) is None
    assert after.pose_at(1.5) is not None
