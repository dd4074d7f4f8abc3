"""Motions of bodies continue, and move frames fixed in them, as rigid-body kinematics says."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion, fixed_frame_motion_reference, motion_after_reference

RNG = np.random.default_rng(0)
P, R = RNG.normal(size=3), Rotation.random(random_state=1).as_matrix()


def test_a_body_with_constant_twist_continues_exactly():
    twist = RNG.normal(size=6)
    later = BodyMotion(P, R, twist).after(0.3)
    np.testing.assert_allclose(later.p_HO, P + 0.3 * twist[:3], atol=1e-15)
    np.testing.assert_allclose(later.R_HO, Rotation.from_rotvec(0.3 * twist[3:]).as_matrix() @ R, atol=1e-15)
    np.testing.assert_array_equal(later.twist, twist)


def test_an_accelerated_body_continues_to_third_order():
    """One step of t and two of t/2 differ by the terms of third order: eight times less for half the time."""
    motion, differences = BodyMotion(P, R, RNG.normal(size=6), RNG.normal(size=6)), []
    for t in (0.1, 0.05):
        once, twice = motion.after(t), motion.after(t / 2).after(t / 2)
        np.testing.assert_allclose(once.p_HO, twice.p_HO, atol=1e-15)
        np.testing.assert_allclose(once.twist, twice.twist, atol=1e-15)
        differences.append(Rotation.from_matrix(once.R_HO @ twice.R_HO.T).magnitude())
    assert 6.0 < differences[0] / differences[1] < 10.0


def test_a_fixed_frame_moves_with_the_body():
    """Velocity and acceleration of its origin against differences in time, of second order: 1e-8 times some 100 m/s³."""
    motion, h = BodyMotion(P, R, RNG.normal(size=6), RNG.normal(size=6)), 1e-4  # s
    p, turn = RNG.normal(size=3), Rotation.random(random_state=2).as_matrix()
    frame = motion.of_fixed_frame(p, turn)
    np.testing.assert_allclose(frame.p_HO, P + R @ p, atol=1e-15)
    np.testing.assert_allclose(frame.R_HO, R @ turn, atol=1e-15)
    later, earlier = (motion.after(t).of_fixed_frame(p, turn) for t in (h, -h))
    np.testing.assert_allclose(frame.twist[:3], (later.p_HO - earlier.p_HO) / (2.0 * h), atol=1e-6)
    np.testing.assert_allclose(frame.acceleration[:3], (later.twist - earlier.twist)[:3] / (2.0 * h), atol=1e-6)
    np.testing.assert_array_equal(frame.twist[3:], motion.twist[3:])
    back = frame.of_fixed_frame(-turn.T @ p, turn.T)
    for name in ("p_HO", "R_HO", "twist", "acceleration"):
        np.testing.assert_allclose(getattr(back, name), getattr(motion, name), atol=1e-14)


def test_compiled_motions_equal_the_reference():
    for _ in range(20):
        motion = BodyMotion(P, R, RNG.normal(size=6), RNG.normal(size=6))
        p, turn, t = RNG.normal(size=3), Rotation.random(random_state=RNG).as_matrix(), RNG.normal()
        pairs = [(motion.of_fixed_frame(p, turn.T), fixed_frame_motion_reference(motion, p, turn.T))]
        pairs += [(motion.after(t), motion_after_reference(motion, t))]
        for found, expected in pairs:
            for name in ("p_HO", "R_HO", "twist", "acceleration"):
                np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0.0, atol=1e-13)
                assert not getattr(found, name).flags.writeable
