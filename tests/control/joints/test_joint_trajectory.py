"""Motions of joints through knots: interpolation, order in time, and their records."""

from __future__ import annotations

import json

import numpy as np
import pytest

from graspforce.control.joints.joint_reference import minimum_jerk_reference
from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.core.errors import InvalidInput

START, GOAL = np.array([0.1, -0.4, 0.9]), np.array([0.7, 0.2, -0.3])  # rad
TIMES = np.linspace(-0.1, 2.1, 23)  # s


def wave() -> JointTrajectory:
    """Return a motion of three joints through five knots, from rest to rest."""
    t = np.array([0.0, 0.3, 0.9, 1.4, 2.0])
    share = (t / t[-1])[:, None]
    q = START + (GOAL - START) * share + 0.1 * np.sin(np.pi * share) * [1.0, -1.0, 0.5]
    v = np.gradient(q, t, axis=0)
    v[[0, -1]] = 0.0
    return JointTrajectory(t, q, v, np.zeros_like(q))


def test_motion_between_two_postures_has_least_jerk():
    motion, reference = JointTrajectory.between(START, GOAL, 1.7), minimum_jerk_reference(START, GOAL, 1.7)
    for t in np.linspace(0.0, 2.0, 21):
        for name in ("q", "v", "a"):
            np.testing.assert_allclose(getattr(motion(t), name), getattr(reference(t), name), atol=1e-12)


def test_rates_and_accelerations_are_derivatives():
    motion, h = wave(), 1e-5  # s
    for t in np.linspace(0.05, 1.95, 17):
        before, now, after = motion(t - h), motion(t), motion(t + h)
        np.testing.assert_allclose((after.q - before.q) / (2 * h), now.v, atol=1e-8)
        np.testing.assert_allclose((after.v - before.v) / (2 * h), now.a, atol=1e-7)


def test_reversed_motion_passes_the_same_postures_backwards():
    motion, back = wave(), wave().reversed()
    for t in TIMES:
        there, here = motion(motion.duration - t), back(t)
        np.testing.assert_allclose(here.q, there.q, atol=1e-12)
        np.testing.assert_allclose(here.v, -there.v, atol=1e-12)
        np.testing.assert_allclose(here.a, there.a, atol=1e-11)


def test_motions_in_sequence_keep_their_course():
    first, second = JointTrajectory.between(GOAL, START, 0.8), wave()
    both = first.followed_by(second)
    assert both.duration == pytest.approx(2.8)
    for t in np.linspace(0.0, 2.8, 15):
        expected = first(t) if t <= 0.8 else second(t - 0.8)
        np.testing.assert_allclose(both(t).q, expected.q, atol=1e-12)


def test_record_survives_json():
    motion = wave()
    again = JointTrajectory.from_dict(json.loads(json.dumps(motion.to_dict())), 3)
    for name in ("t", "q", "v", "a"):
        np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"times": [0.0, 1.0, 0.5, 1.5, 2.0]}, "trajectory.t"),
        ({"times": [0.0]}, "trajectory.posture"),
        ({"velocity": [[0.0] * 2] * 5}, "trajectory.velocity"),
        ({"acceleration": None}, "trajectory.acceleration"),
        ({"speed": 1.0}, "trajectory.speed"),
    ],
)
def test_invalid_records_are_named(change, field):
    with pytest.raises(InvalidInput) as caught:
        JointTrajectory.from_dict({**wave().to_dict(), **change}, 3)
    assert caught.value.field == field
