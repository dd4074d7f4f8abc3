"""Vectors in three dimensions: cross products, norms, unit vectors and tangent bases, one by one or by rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graspforce.core.arrays import Array

_SKEW = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=np.float64)


def cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """Return a × b of two vectors. Scalar arithmetic: NumPy's overhead dominates for one pair.

    Args:
        a: (3,) numbers.
        b: (3,) numbers.
    """
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def skew(v: Array) -> Array:
    """Return the skew-symmetric matrices S with S y = v × y, and therefore y S = y × v for a row y.

    Args:
        v: (…, 3) vectors.

    Returns:
        (…, 3, 3).
    """
    return np.asarray((v @ _SKEW).reshape(*v.shape, 3))


def row_norms(v: Array) -> Array:
    """Return the (N,) Euclidean norms of the rows, without overflow or underflow.

    Args:
        v: (N, 3) vectors.
    """
    return np.hypot(np.hypot(v[:, 0], v[:, 1]), v[:, 2])


def unit_vectors(v: Array, fallback: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """Return the rows divided by their norms.

    Args:
        v: (N, 3) vectors.
        fallback: the result for a zero vector.

    Returns:
        (N, 3) unit vectors.
    """
    norm = row_norms(v)[:, None]
    if np.count_nonzero(norm) == len(norm):
        return np.asarray(v / norm)
    return np.asarray(np.divide(v, norm, out=np.broadcast_to(fallback, v.shape).copy(), where=norm > 0))


def tangent_bases(n: Array) -> Array:
    """Return orthonormal bases of the planes that are orthogonal to unit vectors.

    Args:
        n: (N, 3) unit vectors.

    Returns:
        (N, 3, 2): the columns t₁ and t₂ = n × t₁.
    """
    axis = np.eye(3)[np.abs(n).argmin(axis=1)]
    t = unit_vectors(np.cross(n, axis))
    return np.stack([t, np.cross(n, t)], axis=-1)


def table_axes(down: Array) -> Array:
    """Return two orthonormal directions along a table, whose normal is vertical, as rows.

    Args:
        down: (3,) unit vector along gravity.

    Returns:
        (2, 3).
    """
    return np.asarray(np.linalg.svd(down[None])[2][1:])
