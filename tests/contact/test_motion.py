"""Motions of bodies continue as rigid-body kinematics says."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion

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
