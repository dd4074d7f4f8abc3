"""Between the knots of a motion: Hermite polynomials, quintic ones of vectors and of rotations, and cubic ones.

Each interval's polynomial has the values, rates and accelerations of both its knots, so all three are continuous. Rotations
go by the rotation vector φ from the interval's first knot, R = R₀ exp [φ]×, for which in the body's axes

    ω = J φ̇,    α = J φ̈ + J̇ φ̇,    J = 1 − A [φ]× + B [φ]×²,    A = (1 − cos θ)/θ²,  B = (θ − sin θ)/θ³,  θ = ‖φ‖

Chirikjian, Stochastic Models, Information Theory, and Lie Groups, volume 2 (2011), section 10.6.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array

Indices = np.ndarray[Any, np.dtype[np.intp]]

_SMALL = 0.1  # rad: below this the series of A and B, to θ⁶, are right to rounding


def intervals(knots: Array, times: Array) -> tuple[Indices, Array]:
    """(M,) the interval in which each time stands, and where in it, 0 to 1."""
    i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    return i, (times - knots[i]) / (knots[i + 1] - knots[i])


def hermite(u: Array, step: Array, ends: tuple[Array, Array, Array, Array, Array, Array]) -> tuple[Array, Array, Array]:
    """The polynomial's value, rate and acceleration.

    Args:
        u: (M,) where in the interval, 0 to 1.
        step: (M,) its length, s.
        ends: (M, …) value, rate and acceleration at its first knot, then at its second.
    """
    x, v, a, x_end, v_end, a_end = ends
    u, h = (each.reshape(-1, *(1,) * (x.ndim - 1)) for each in (u, step))
    # x + v h u + ½ a h² u² + u³ (c₃ + c₄ u + c₅ u²), the c from what is missed at the end
    missed = x_end - (x + v * h + 0.5 * a * h**2)
    missed_v = (v_end - (v + a * h)) * h
    missed_a = (a_end - a) * h**2
    c3 = 10.0 * missed - 4.0 * missed_v + 0.5 * missed_a
    c4 = -15.0 * missed + 7.0 * missed_v - missed_a
    c5 = 6.0 * missed - 3.0 * missed_v + 0.5 * missed_a
    value = x + v * h * u + 0.5 * a * (h * u) ** 2 + u**3 * (c3 + u * (c4 + u * c5))
    rate = v + a * h * u + u**2 * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)) / h
    acceleration = a + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)) / h**2
    return value, rate, acceleration


def hermite_cubic(u: Array, step: Array, ends: tuple[Array, Array, Array, Array]) -> tuple[Array, Array]:
    """The cubic polynomial's value and rate. Arguments as `hermite`: value and rate at the first knot, then at the second."""
    x, v, x_end, v_end = ends
    u, h = (each.reshape(-1, *(1,) * (x.ndim - 1)) for each in (u, step))
    missed, missed_v = x_end - (x + v * h), (v_end - v) * h  # x + v h u + u² (c₂ + c₃ u)
    c2, c3 = 3.0 * missed - missed_v, missed_v - 2.0 * missed
    return x + v * h * u + u**2 * (c2 + c3 * u), v + u * (2.0 * c2 + 3.0 * c3 * u) / h


def hermite_rotation(
    u: Array, step: Array, ends: tuple[Array, Array, Array, Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """R (M, 3, 3), and ω and α (M, 3) in the body's axes. Arguments as `hermite`: R, ω, α at the first knot and the second."""
    R, omega, alpha, R_end, omega_end, alpha_end = ends
    zero = np.zeros_like(omega)
    phi = Rotation.from_matrix(R.transpose(0, 2, 1) @ R_end).as_rotvec()  # rad
    phi, rate, acceleration = hermite(u, step, (zero, omega, alpha, phi, *rotation_vector_rates(phi, omega_end, alpha_end)))
    turned = R @ Rotation.from_rotvec(phi).as_matrix()
    return turned, *angular_rates(phi, rate, acceleration)


def angular_rates(phi: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
    """ω and α (M, 3), in the body's axes, of rotation vectors φ (M, 3) with their rates and accelerations."""
    J = _right_jacobian(phi)
    return _times(J, rate), _times(J, acceleration) + _jacobian_rate_term(phi, rate)


def rotation_vector_rates(phi: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """φ̇ and φ̈ (M, 3) of rotation vectors φ (M, 3) of bodies that turn with ω and α, in their axes: `angular_rates` undone."""
    J = _right_jacobian(phi)
    rate = _solved(J, omega)
    return rate, _solved(J, alpha - _jacobian_rate_term(phi, rate))


def _right_jacobian(phi: Array) -> Array:
    A, B, _, _ = _coefficients(phi)
    S = _cross_matrix(phi)
    return np.asarray(np.eye(3) - A[:, None, None] * S + B[:, None, None] * (S @ S))


def _jacobian_rate_term(phi: Array, rate: Array) -> Array:
    """J̇ φ̇ = −Ȧ φ × φ̇ + B φ̇ × (φ × φ̇) + Ḃ φ × (φ × φ̇), with Ȧ = A'/θ φ·φ̇; −A φ̇ × φ̇ is zero."""
    _, B, A_rate, B_rate = _coefficients(phi)
    along = (phi * rate).sum(axis=1)
    across = np.cross(phi, rate)
    return np.asarray(
        -(A_rate * along)[:, None] * across
        + B[:, None] * np.cross(rate, across)
        + (B_rate * along)[:, None] * np.cross(phi, across)
    )


def _coefficients(phi: Array) -> tuple[Array, Array, Array, Array]:
    """A, B, A'/θ, B'/θ."""
    square = (phi * phi).sum(axis=1)
    x = np.where(square < _SMALL**2, square, 0.0)
    series = (
        1 / 2 - x / 24 * (1 - x / 30 * (1 - x / 56)),
        1 / 6 - x / 120 * (1 - x / 42 * (1 - x / 72)),
        -1 / 12 + x / 180 * (1 - x * 3 / 112),
        -1 / 60 + x / 1260 * (1 - x / 48),
    )
    theta = np.sqrt(np.where(square < _SMALL**2, 1.0, square))
    sin, cos = np.sin(theta), np.cos(theta)
    A, B = (1 - cos) / theta**2, (theta - sin) / theta**3
    closed = (A, B, (sin / theta - 2 * A) / theta**2, (A - 3 * B) / theta**2)
    A, B, A_rate, B_rate = (np.where(square < _SMALL**2, *pair) for pair in zip(series, closed, strict=True))
    return A, B, A_rate, B_rate


def _cross_matrix(x: Array) -> Array:
    """(M, 3, 3) [x]×."""
    return np.cross(np.eye(3), x[:, None])


def _solved(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, vector[:, :, None])[:, :, 0])


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray((matrix @ vector[:, :, None])[:, :, 0])
