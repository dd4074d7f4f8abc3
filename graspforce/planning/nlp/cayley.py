"""Cayley parameters of a rotation, r = tan(θ/2) along its axis, and their time derivatives.

    C = 1 + s ([r]× + [r]×²),    ω = s (ṙ + r × ṙ),    ω̇ = s (r̈ + r × r̈) − s (r·ṙ) ω,    s = 2/(1 + r·r)

They are rational, and regular up to half a turn. Source: Shuster (1993), there called the Rodrigues vector.
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry.vectors import skew


def parameters(C: Array) -> Array:
    """Return the Cayley parameters (M, 3) of rotations of less than half a turn.

    Args:
        C: (M, 3, 3) rotation matrices.
    """
    odd = np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], axis=1)
    return np.asarray(odd / (1.0 + np.trace(C, axis1=1, axis2=2))[:, None])


def parameter_rates(r: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """Return ṙ (M, 3), 1/s, and r̈ (M, 3), 1/s².

    Args:
        r: (M, 3) Cayley parameters.
        omega: (M, 3) angular velocities, rad/s.
        alpha: (M, 3) angular accelerations, rad/s².
    """
    s = _scale(r)
    E = s[:, :, None] * (np.eye(3) + skew(r))
    r_d = np.linalg.solve(E, omega[:, :, None])[:, :, 0]
    rest = alpha + s * (r * r_d).sum(axis=1)[:, None] * omega
    return np.asarray(r_d), np.asarray(np.linalg.solve(E, rest[:, :, None])[:, :, 0])


def rotation_and_rates(r: Array, r_d: Array, r_dd: Array) -> tuple[Array, Array, Array]:
    """Return rotation matrices C (M, 3, 3), ω (M, 3) in rad/s and ω̇ (M, 3) in rad/s².

    Args:
        r: (M, 3) Cayley parameters.
        r_d: (M, 3) their rates, 1/s.
        r_dd: (M, 3) their accelerations, 1/s².
    """
    s, S = _scale(r), skew(r)
    omega = s * (r_d + np.cross(r, r_d))
    alpha = s * (r_dd + np.cross(r, r_dd)) - s * (r * r_d).sum(axis=1)[:, None] * omega
    return np.eye(3) + s[:, :, None] * (S + S @ S), omega, alpha


def _scale(r: Array) -> Array:
    """Return s (M, 1)."""
    return np.asarray(2.0 / (1.0 + (r * r).sum(axis=1))[:, None])
