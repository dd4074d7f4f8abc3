"""Cayley's parameters of a rotation, r = tan(θ/2) along its axis, and their derivatives in time.

    C = 1 + s ([r]× + [r]×²),    ω = s (ṙ + r × ṙ),    ω̇ = s (r̈ + r × r̈) − s (r·ṙ) ω,    s = 2/(1 + r·r)

Rational, and regular up to half a turn. Shuster, A Survey of Attitude Representations (1993), section on the Rodrigues vector.
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array


def parameters(C: Array) -> Array:
    """(M, 3) r of rotations (M, 3, 3) of less than half a turn."""
    odd = np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], axis=1)
    return np.asarray(odd / (1.0 + np.trace(C, axis1=1, axis2=2))[:, None])


def rates(r: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """ṙ and r̈ (M, 3) from r, ω and ω̇ (M, 3)."""
    s = _s(r)
    E = s[:, :, None] * (np.eye(3) + _cross(r))
    r_d = np.linalg.solve(E, omega[:, :, None])[:, :, 0]
    left = alpha + s * (r * r_d).sum(axis=1)[:, None] * omega
    return np.asarray(r_d), np.asarray(np.linalg.solve(E, left[:, :, None])[:, :, 0])


def rotation_and_rates(r: Array, r_d: Array, r_dd: Array) -> tuple[Array, Array, Array]:
    """C (M, 3, 3), ω and ω̇ (M, 3)."""
    s, S = _s(r), _cross(r)
    omega = s * (r_d + np.cross(r, r_d))
    alpha = s * (r_dd + np.cross(r, r_dd)) - s * (r * r_d).sum(axis=1)[:, None] * omega
    return np.eye(3) + s[:, :, None] * (S + S @ S), omega, alpha


def _s(r: Array) -> Array:
    return np.asarray(2.0 / (1.0 + (r * r).sum(axis=1))[:, None])


def _cross(r: Array) -> Array:
    """(M, 3, 3) [r]×."""
    return np.cross(np.eye(3), r[:, None])
