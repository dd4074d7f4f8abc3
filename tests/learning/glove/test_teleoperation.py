"""Teleoperation: the desired motion reaches the operator's pose, and never exceeds its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import InvalidInput
from graspforce.learning import TeleoperationFilter, TeleoperationLimits, virtual_object

START = BodyMotion([0.1, 0.0, 0.05], np.eye(3))
LIMITS = TeleoperationLimits(travel=0.01, turn=0.3)


def test_the_motion_reaches_a_pose_and_rests():
    teleoperation = TeleoperationFilter(START, LIMITS)
    R = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_matrix()
    teleoperation.command([0.105, 0.002, 0.05], R)
    for _ in range(3000):
        motion = teleoperation.step(0.001)
    np.testing.assert_allclose(motion.p_HO, [0.105, 0.002, 0.05], atol=1e-8)
    np.testing.assert_allclose(motion.R_HO, R, atol=1e-8)
    np.testing.assert_allclose(motion.twist, 0.0, atol=1e-8)


def test_a_small_step_is_followed_without_overshoot():
    """Below the limits, the answer is that of a critically damped oscillator: 1 − (1 + ω t) exp(−ω t)."""
    teleoperation = TeleoperationFilter(START, LIMITS)
    teleoperation.command([0.1001, 0.0, 0.05])
    x = np.array([teleoperation.step(1e-4).p_HO[0] for _ in range(10_000)]) - 0.1
    t = 1e-4 * np.arange(1, 10_001)
    np.testing.assert_allclose(x, 1e-4 * (1.0 - (1.0 + 10.0 * t) * np.exp(-10.0 * t)), atol=1e-7)  # 0.1 % of the step
    assert x.max() <= 1e-4


@given(seed=st.integers(0, 1000), error=st.floats(0.0, 0.1))
@settings(deadline=None, max_examples=20)
def test_limits_hold_for_every_operator(seed, error):
    """The acceleration that stops at the speed limit is part of the bound; the discrete step may exceed travel by v dt."""
    rng, dt = np.random.default_rng(seed), 0.005
    teleoperation, before = TeleoperationFilter(START, LIMITS), START
    for k in range(200):
        if k % 4 == 0:
            teleoperation.command(START.p_HO + error * rng.normal(size=3), Rotation.random(random_state=seed + k).as_matrix())
        motion = teleoperation.step(dt)
        assert np.linalg.norm(motion.twist[:3]) <= LIMITS.speed + 1e-12
        assert np.linalg.norm(motion.twist[3:]) <= LIMITS.turn_rate + 1e-12
        assert np.linalg.norm(motion.acceleration[:3]) <= LIMITS.acceleration + 1e-9
        np.testing.assert_allclose(motion.p_HO, before.p_HO + dt * motion.twist[:3], atol=1e-12)
        before = motion


def test_poses_beyond_the_travel_are_cut():
    teleoperation = TeleoperationFilter(START, LIMITS)
    teleoperation.command([0.1, 0.5, 0.05])
    for _ in range(3000):
        motion = teleoperation.step(0.001)
    np.testing.assert_allclose(motion.p_HO, [0.1, 0.01, 0.05], atol=1e-8)


def test_a_virtual_object_moves_with_the_fingertips():
    rng = np.random.default_rng(0)
    tips, R, shift = rng.normal(size=(4, 3)), Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix(), [0.01, 0.02, -0.03]
    p, axes = virtual_object(START, tips, tips @ R.T + shift)
    np.testing.assert_allclose(axes, R, atol=1e-12)
    np.testing.assert_allclose(p, R @ START.p_HO + shift, atol=1e-12)


def test_invalid_arguments_are_refused():
    for call in (
        lambda: TeleoperationLimits(travel=0.0),
        lambda: TeleoperationLimits(turn=4.0),
        lambda: TeleoperationFilter(START).step(0.0),
        lambda: TeleoperationFilter(START).step(0.2),
        lambda: TeleoperationFilter(START).command([0.0, np.nan, 0.0]),
        lambda: virtual_object(START, np.zeros((3, 3)), np.zeros((3, 3))),
    ):
        with pytest.raises(InvalidInput):
            call()
