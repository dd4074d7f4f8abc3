"""Spin angles of soft pads on the object, and their return."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspforce.contact.kinematics import TipContactState
from graspforce.control.contacts.pad_spin import next_spin, spin_acceleration

PERIOD = 1e-3  # s


def tips(R_OF: np.ndarray) -> TipContactState:
    return TipContactState(np.zeros((len(R_OF), 3)), R_OF, np.zeros((len(R_OF), 3)))


@given(st.integers(0, 10**6), st.floats(-0.5, 0.5))
def test_the_angle_is_the_sum_of_the_rotations_about_the_normal(seed: int, total: float) -> None:
    """Rotations of the tip about tangents, as in rolling, are no spin."""
    rng, steps = np.random.default_rng(seed), 200
    R_OC, start = Rotation.random(2, random_state=rng).as_matrix(), Rotation.random(2, random_state=rng)
    n, t = R_OC[:, :, 2], R_OC[:, :, 0]
    spin, before = None, None
    for k in range(steps + 1):
        about_n = Rotation.from_rotvec(k / steps * total * n)
        about_t = Rotation.from_rotvec(1e-3 * np.sin(0.3 * k) * t)
        now = tips((about_t * about_n * start).as_matrix())
        spin, before = next_spin(spin, before, now, R_OC, PERIOD), now
    np.testing.assert_allclose(spin[:, 0], total, atol=1e-3 * abs(total) + 1e-6)  # second order in the rolling
    np.testing.assert_allclose(spin[:, 1], total / steps / PERIOD, atol=1e-3 * abs(total) / steps / PERIOD + 1e-3)


def test_a_spin_returns_without_overshoot() -> None:
    """A critically damped motion from rest keeps its sign: e⁻ᵏᵗ (1 + k t)."""
    angle, rate, least = 0.3, 0.0, 0.3
    for _ in range(1500):
        rate += PERIOD * spin_acceleration(np.array([[angle, rate]]))[0]
        angle += PERIOD * rate
        least = min(least, angle)
    assert least > -1e-4
    assert abs(angle) < 1e-3 * 0.3
