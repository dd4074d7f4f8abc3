"""Interpolation between the knots of a trajectory: quintic Hermite polynomials of rotations, and cubic ones of vectors.

`graspforce.geometry.hermite` has the quintic polynomials of vectors.
A rotation goes by the rotation vector φ from the interval's first knot, R = R₀ exp [φ]×. In the body's axes

    ω = J φ̇,    α = J φ̈ + J̇ φ̇,    J = 1 − A [φ]× + B [φ]×²,    A = (1 − cos θ)/θ²,  B = (θ − sin θ)/θ³,  θ = ‖φ‖

Source: Chirikjian (2011), section 10.6.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array
from graspforce.geometry.hermite import Ends, hermite
from graspforce.geometry.vectors import skew

Indices = npt.NDArray[np.intp]

_SMALL = 0.1  # rad: below it the series of A and B up to θ⁶ are exact to rounding


def hermite_cubic(u: Array, step: Array, ends: tuple[Array, Array, Array, Array]) -> tuple[Array, Array]:
    """Return value and rate of cubic polynomials.

    Args:
        u: (M,) fractions of the intervals, 0 to 1.
        step: (M,) durations of the intervals, s.
        ends: (M, …) each: value and rate at the first knot, then at the second.
    """
    x, v, x_end, v_end = ends
    u, h = (each.reshape(-1, *(1,) * (x.ndim - 1)) for each in (u, step))
    error, error_v = x_end - (x + v * h), (v_end - v) * h  # x + v h u + u² (c₂ + c₃ u)
    c2, c3 = 3.0 * error - error_v, error_v - 2.0 * error
    return x + v * h * u + u**2 * (c2 + c3 * u), v + u * (2.0 * c2 + 3.0 * c3 * u) / h


def hermite_rotation(u: Array, step: Array, ends: Ends) -> tuple[Array, Array, Array]:
    """Return rotation matrices R (M, 3, 3), and ω and α (M, 3) in the body's axes.

    Args:
        u: (M,) fractions of the intervals, 0 to 1.
        step: (M,) durations of the intervals, s.
        ends: R, ω and α at the first knot, then at the second.
    """
    R, omega, alpha, R_end, omega_end, alpha_end = ends
    zero = np.zeros_like(omega)
    phi = Rotation.from_matrix(R.transpose(0, 2, 1) @ R_end).as_rotvec()  # rad
    phi, rate, acceleration = hermite(u, step, (zero, omega, alpha, phi, *rotation_vector_rates(phi, omega_end, alpha_end)))
    return R @ Rotation.from_rotvec(phi).as_matrix(), *angular_rates(phi, rate, acceleration)


def angular_rates(phi: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
    """Return ω and α (M, 3) in the body's axes, rad/s and rad/s².

    Args:
        phi: (M, 3) rotation vectors φ, rad.
        rate: (M, 3) φ̇, rad/s.
        acceleration: (M, 3) φ̈, rad/s².
    """
    J = _right_jacobian(phi)
    return _times(J, rate), _times(J, acceleration) + _jacobian_rate_term(phi, rate)


def rotation_vector_rates(phi: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """Return φ̇ and φ̈ (M, 3), the inverse of `angular_rates`.

    Args:
        phi: (M, 3) rotation vectors φ, rad.
        omega: (M, 3) angular velocities in the body's axes, rad/s.
        alpha: (M, 3) angular accelerations in the body's axes, rad/s².
    """
    J = _right_jacobian(phi)
    rate = _solve(J, omega)
    return rate, _solve(J, alpha - _jacobian_rate_term(phi, rate))


def _right_jacobian(phi: Array) -> Array:
    """Return J (M, 3, 3)."""
    A, B, _, _ = _coefficients(phi)
    S = skew(phi)
    return np.asarray(np.eye(3) - A[:, None, None] * S + B[:, None, None] * (S @ S))


def _jacobian_rate_term(phi: Array, rate: Array) -> Array:
    """Return J̇ φ̇ = −Ȧ φ × φ̇ + B φ̇ × (φ × φ̇) + Ḃ φ × (φ × φ̇), with Ȧ = A'/θ φ·φ̇; −A φ̇ × φ̇ is zero."""
    _, B, A_rate, B_rate = _coefficients(phi)
    along = (phi * rate).sum(axis=1)
    across = np.cross(phi, rate)
    return np.asarray(
        -(A_rate * along)[:, None] * across
        + B[:, None] * np.cross(rate, across)
        + (B_rate * along)[:, None] * np.cross(phi, across)
    )


def _coefficients(phi: Array) -> tuple[Array, Array, Array, Array]:
    """Return A, B, A'/θ and B'/θ."""
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


def _solve(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, vector[:, :, None])[:, :, 0])


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray((matrix @ vector[:, :, None])[:, :, 0])
