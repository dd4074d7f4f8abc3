"""The frame at which one motion of a finger ends and the next one begins, by least squares.

Before the boundary b, the speed of each angle falls from a constant to zero; after b it rises from zero to another constant:

    v(t) = v₁ min((b − t)/r₁, 1)^p₁ for t < b,   v(t) = v₂ min((t − b)/r₂, 1)^p₂ for t > b.

The angles are the integral. r = 0 is a sudden change, and p = 1 a limited acceleration. Motions with least jerk of duration T
are a further shape, v ∝ (s/T)² (1 − s/T)² at the time s from the boundary. For each b and each shape of a grid of r, p and T,
v₁ and v₂ of all angles follow from linear least squares.
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array

_LEAST_JERK = 0  # stands for the exponent of motions with least jerk
_SHAPES = (  # rise times or durations in frames, and exponents
    (0.0, 1),
    *((r, p) for r in (2.0, 4.0, 8.0, 16.0, 32.0) for p in (1, 2)),
    *((T, _LEAST_JERK) for T in (16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0)),
)
_RIDGE = 1e-9  # part of the Gram matrix's diagonal: a window may be too short to tell the shapes apart


def best_boundary(angles: Array, first: int, last: int) -> int:
    """Return the frame that divides a window into two motions with the least sum of squared errors.

    Args:
        angles: (T, k) angles in the window.
        first: first frame that may be the boundary.
        last: last frame that may be the boundary.
    """
    t = np.arange(len(angles), dtype=np.float64)
    y = angles - angles.mean(axis=0)
    best, result = -np.inf, first
    for b in range(first, last + 1):
        before = np.array([-_way(b - t, r, p) for r, p in _SHAPES])
        after = np.array([_way(t - b, r, p) for r, p in _SHAPES])
        explained = _explained(before, after, y)
        if explained > best:
            best, result = explained, b
    return result


def _way(t: Array, rise: float, power: int) -> Array:
    """Return the way after times t (T,) of a speed that rises from zero; zero before zero."""
    t = np.maximum(t, 0.0)
    if power == _LEAST_JERK:
        r = np.minimum(t / rise, 1.0)
        return np.asarray(rise * r**3 * (10.0 - 15.0 * r + 6.0 * r**2))
    if rise == 0.0:
        return t
    early = np.minimum(t, rise)
    return np.asarray(rise * (early / rise) ** (power + 1) / (power + 1) + np.maximum(t - rise, 0.0))


def _explained(before: Array, after: Array, y: Array) -> float:
    """Return the largest sum of squares of y (T, k) that a constant, one row of `before` and one of `after` explain."""
    before = before - before.mean(axis=1, keepdims=True)
    after = after - after.mean(axis=1, keepdims=True)
    aa = np.square(before).sum(axis=1)[:, None]
    cc = np.square(after).sum(axis=1)[None, :]
    aa, cc = aa * (1.0 + _RIDGE) + _RIDGE, cc * (1.0 + _RIDGE) + _RIDGE
    ac = before @ after.T
    u, w = before @ y, after @ y  # (S, k)
    uu, ww, uw = np.square(u).sum(axis=1)[:, None], np.square(w).sum(axis=1)[None, :], u @ w.T
    return float(((cc * uu - 2.0 * ac * uw + aa * ww) / (aa * cc - ac * ac)).max())
