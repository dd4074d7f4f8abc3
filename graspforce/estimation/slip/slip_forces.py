"""Evidence of slip in contact forces: unexpected forces, and forces at the friction limit.

A fingertip force that differs from the force of the joint torques shows that the finger does not move as commanded. A long mean
removes the constant part of the difference, such as from joint friction. The square of the rest, over its covariance, has a χ²
distribution with 3 N degrees of freedom.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.estimation.contact_forces import ContactForces

_WINDOWS = (0.003, 0.015)  # s: means of the forces that are tested
_BASELINE = 0.2  # s: mean of the constant part of a difference
_LEVEL_TIME = 0.5  # s: mean of the statistic, which is large where models of hand and contacts have errors
_FULL_TIMES = 4.0  # time constants after which a mean is full: its variance is off by a factor of exp(-8)
_LIMIT_DEVIATIONS = 5.0  # standard deviations between a force at its friction limit and the largest planned one

Flags = npt.NDArray[np.bool_]


class ForceMeans(NamedTuple):
    """Means of the forces of N contacts.

    Attributes:
        values: (4, 3 N) contact forces over the first window, and their mismatch over both windows and over the baseline, N.
        variance: variances of the means over the windows and the baseline, as fractions of that of one period.
        updates: periods since the start.
        level: mean of the statistic, relative to that of noise.
        whitener: (3 N, 3 N) inverse factor of the covariance of `mismatch_noise`, 1/N.
        noise: `mismatch_noise` of that whitener.
    """

    values: Array
    variance: tuple[float, float, float]
    updates: int
    level: float
    whitener: Array
    noise: Array


class ForceEvidence:
    """Tests of the contact forces.

    Args:
        period: time between two steps, s.
        limit_ratio: fraction of the friction coefficient at which a contact counts as at its limit.
        limit_reserve: fraction of the friction coefficient that planned forces leave unused.

    Attributes:
        gains: gains of the means over both windows and the baseline.
        level_gain: gain of the mean of the statistic.
        limit_ratio: fraction of the friction coefficient at which a contact counts as at its limit.
        planned_ratio: fraction of the friction coefficient that planned forces use.
    """

    def __init__(self, period: float, limit_ratio: float, limit_reserve: float) -> None:
        self.gains = tuple(-math.expm1(-period / time) for time in (*_WINDOWS, _BASELINE))
        column = np.array(self.gains)[[0, 0, 1, 2], None]
        self._full = column, tuple(gain / (2.0 - gain) for gain in self.gains)  # of full means: gains and variances
        self._full_from = math.ceil(_FULL_TIMES / self.gains[2])  # periods from the start
        self.level_gain = -math.expm1(-period / _LEVEL_TIME)
        self.limit_ratio, self.planned_ratio = limit_ratio, 1.0 - limit_reserve

    def step(self, means: ForceMeans | None, forces: ContactForces) -> tuple[float, ForceMeans]:
        """Return the largest statistic of unexpected forces, χ² with 3 N degrees of freedom each, and the means.

        Errors of hand and contacts make forces differ from those of the torques at any time. The statistic is divided by its
        mean over the past, as far as that exceeds the mean of noise.

        Args:
            means: means after the last period; None before the first.
            forces: contact forces of fingertip sensors.
        """
        mismatch, noise = forces.mismatch, forces.mismatch_noise
        assert mismatch is not None
        rows = np.empty((4, mismatch.size))
        rows[0], rows[1:] = forces.f.ravel(), mismatch.ravel()
        if means is None:
            return 0.0, ForceMeans(rows, (1.0, 1.0, 1.0), 1, 1.0, _whitener(noise), noise)
        updates = means.updates + 1
        start = 1.0 / updates
        gains, (c1, c2, c3) = self._full
        if updates < self._full_from:
            g1, g2, g3 = (max(gain, start) for gain in self.gains)
            gains = np.array([[g1], [g1], [g2], [g3]])
            c1, c2, c3 = (_updated(c, g) for c, g in zip(means.variance, (g1, g2, g3), strict=True))
        rows -= means.values
        rows *= gains
        rows += means.values
        whitener = means.whitener if means.noise is noise else _whitener(noise)
        z = (rows[1:3] - rows[3]).dot(whitener.T)
        z *= z
        first, second = z.sum(axis=1).tolist()
        statistic = max(first / (c1 + c3), second / (c2 + c3))
        level = means.level + max(self.level_gain, start) * (statistic / mismatch.size - means.level)
        return statistic / max(means.level, 1.0), ForceMeans(rows, (c1, c2, c3), updates, level, whitener, noise)

    def at_limit(self, means: ForceMeans, forces: ContactForces, mu: Array) -> list[bool]:
        """Return which contacts are at their friction limits, N of them.

        The force must reach the limit, and exceed the planned forces by several standard deviations.

        Args:
            means: means of the forces.
            forces: contact forces of fingertip sensors.
            mu: (N,) friction coefficients.
        """
        f, noise, c = means.values[0].tolist(), forces.noise, means.variance[0]
        flags = []
        for i, friction in enumerate(mu.tolist()):
            t1, t2, n = f[3 * i : 3 * i + 3]
            tangential, limit = math.hypot(t1, t2), friction * max(n, 0.0)  # N
            is_near = tangential > self.limit_ratio * limit
            if is_near:
                variance = max(noise[3 * i, 3 * i], noise[3 * i + 1, 3 * i + 1]) + friction**2 * noise[3 * i + 2, 3 * i + 2]
                is_near = tangential - self.planned_ratio * limit > _LIMIT_DEVIATIONS * math.sqrt(c * variance)
            flags.append(is_near)
        return flags


def _updated(variance: float, gain: float) -> float:
    """Return the variance of an exponential mean after another value, as a fraction of that of one value."""
    return (1.0 - gain) ** 2 * variance + gain * gain


def _whitener(noise: Array) -> Array:
    """Return the block-diagonal inverse of the lower Cholesky factors of covariances (N, 3, 3)."""
    count = len(noise)
    whitener = np.zeros((count, 3, count, 3))
    each = np.arange(count)
    whitener[each, :, each] = np.linalg.inv(np.linalg.cholesky(noise))
    return whitener.reshape(3 * count, -1)
