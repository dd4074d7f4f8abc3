"""Precaution: forces or motion that surely differ from the commanded ones, before slip itself is found.

A drop of friction or a push changes contact forces and fingertip motion before a slip is long enough for an alarm. A short
squeeze costs little then, even if no slip follows. Two quantities are tested:

- the statistic of unexpected forces (`slip_forces`), χ² with 3 N degrees of freedom;
- the displacement of each fingertip along the surface of the object in its *desired* pose, y = s − B ξ. Here s is the slip for
  the estimated pose and the measured joint positions, and ξ the small motion from the estimated to the desired pose. Means over
  three windows, less the mean over 0.2 s, have the covariance c A Σ_q Aᵀ of the encoders' noise: χ² with two degrees of freedom
  for each finger. The noise of cameras does not affect it, in contrast to the test of slip.

The first grows with the force, the second with the distance: slow slip changes forces by less than their noise. Motion of the
object and slip of a finger look alike in the second. A precaution does not need the difference.

Thresholds follow from the wanted time T between two false precautions. Each of both kinds of evidence gets half of the
probability: with p = Δt/(2 T), P(χ²_{3N} > x) = p, and exp(−x/2) = p/(K N) for K windows and N fingers. Windows and periods are
correlated, so that false precautions are rarer than that. With the default of 100 h, 30 min are free of them with a probability
of 99.5 % at least.

Tracking errors and errors of models make statistics large at any time. So each is divided by its mean ℓ over the past 0.5 s,
relative to that of noise, where ℓ > 1. Such errors act mostly along one direction, whose square has a heavier tail than the sum
of d squares: a fraction 1 − 1/ℓ of the mean has one degree of freedom. The threshold grows to x + d (1 − 1.25/ℓ) x₁ with
P(χ²₁ > x₁) = p. Noise alone hardly exceeds ℓ = 1.25.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block
from graspforce.estimation.pose.contact_pose import ContactPose
from graspforce.estimation.slip.detector import pose_difference
from graspforce.estimation.slip.slip_memory import SlipBlocks, SlipMemory

_WINDOWS = (0.004, 0.012, 0.03)  # s: means of the displacement that are tested
_BASELINE = 0.2  # s: mean of the constant part of a displacement
_LEVEL_TIME = 0.5  # s: mean of the statistics
REFRESH_STEPS = 64  # periods between two computations of the covariance, which changes with the posture only
_START_TIME = 0.2  # s without a test at the start, until the baseline is full
NOISE_LEVEL = 1.25  # largest mean of a statistic of noise, relative to its expectation
LEAST_VARIANCE = 1e-12  # m², of a displacement: it keeps covariances regular where a finger cannot move


class PrecautionMemory(NamedTuple):
    """State of the test of N fingers between two periods.

    Attributes:
        means: (K + 1, 2 N) means of the displacements over K windows and the baseline, m.
        variance: (K + 1,) their variances as fractions of that of one period.
        updates: periods since the start.
        level: (N,) mean statistic of each finger, relative to that of noise.
        whitener: (2 N, 2 N) inverse factor of the covariance of a displacement, transposed, 1/m.
    """

    means: Array
    variance: Array
    updates: int
    level: Array
    whitener: Array


class PrecautionTest:
    """Test of forces and motion against the commanded ones, without memory of its own.

    Args:
        count: number N of contacts.
        encoder_variance: variance of the noise of a joint position, rad².
        period: time between two steps, s.
        interval: time between two false precautions, s, at least.
    """

    def __init__(self, count: int, encoder_variance: float, period: float, interval: float) -> None:
        self._variance, share = encoder_variance, period / (2.0 * interval)
        self._gains = np.array([-math.expm1(-period / time) for time in (*_WINDOWS, _BASELINE)])
        self._level_gain = -math.expm1(-period / _LEVEL_TIME)
        self._start = round(_START_TIME / period)  # periods
        self._count, self._tail = count, float(chdtri(1, share))
        self.force_threshold = float(chdtri(3 * count, share))
        self.motion_threshold = -2.0 * math.log(share / (len(_WINDOWS) * count))

    def step(
        self,
        memory: PrecautionMemory | Block | None,
        slip: SlipMemory | SlipBlocks,
        contacts: ContactPose,
        desired: BodyMotion,
    ) -> tuple[bool, PrecautionMemory | Block]:
        """Return whether a precautionary squeeze is due in this period, and the memory for the next one.

        Args:
            memory: memory after the last period; None before the first.
            slip: memory of the slip detector after this period, with the slips and the statistic of unexpected forces.
            contacts: the contacts at the estimated pose.
            desired: desired motion of the object in this period.
        """
        assert memory is None or isinstance(memory, PrecautionMemory)  # this method makes no other
        assert not isinstance(slip, SlipBlocks)  # they are for the compiled form
        y = slip.residual.reshape(-1, 3)[:, :2].ravel() - self._displacement(contacts, desired)
        if memory is None:
            count, means = len(y) // 2, np.tile(y, (len(self._gains), 1))
            variance, whitener = np.ones(len(self._gains)), self._whitener(contacts)
            return False, PrecautionMemory(means, variance, 1, np.ones(count), whitener)
        updates = memory.updates + 1
        gains = np.maximum(self._gains, 1.0 / updates)
        means = memory.means + gains[:, None] * (y - memory.means)
        variance = (1.0 - gains) ** 2 * memory.variance + gains * gains
        whitener = memory.whitener if updates % REFRESH_STEPS else self._whitener(contacts)
        z = (means[:-1] - means[-1]).dot(whitener)
        statistics = (z * z).reshape(len(z), -1, 2).sum(axis=2) / (variance[:-1] + variance[-1])[:, None]
        levels = np.maximum(memory.level, 1.0)
        is_moved = statistics.max(axis=0) / levels > self.motion_threshold + self._growth(2, levels)
        gain = max(self._level_gain, 1.0 / updates)
        level = memory.level + gain * (0.5 * statistics.mean(axis=0) - memory.level)
        pushed = self.force_threshold + self._growth(3 * self._count, np.array(max(slip.force_level, 1.0)))
        is_due = updates > self._start and (bool(is_moved.any()) or slip.force_statistic > float(pushed))
        return is_due, PrecautionMemory(means, variance, updates, level, whitener)

    def _growth(self, freedom: int, levels: Array) -> Array:
        """Return by how much thresholds grow with the levels of statistics with so many degrees of freedom."""
        return np.asarray(freedom * self._tail * np.maximum(1.0 - NOISE_LEVEL / levels, 0.0))

    def _displacement(self, contacts: ContactPose, desired: BodyMotion) -> Array:
        """Return the displacements of the surface at the contacts from the estimated to the desired pose, (2 N,), m."""
        motion = pose_difference((desired.p_HO, desired.R_HO), (contacts.p_HO, contacts.R_HO))
        return np.asarray(contacts.B.dot(motion).reshape(-1, 4)[:, :2].ravel())

    def _whitener(self, contacts: ContactPose) -> Array:
        """Return the block-diagonal transposed inverse Cholesky factors of the covariances of the displacements."""
        count = len(contacts.R_OC)
        A = contacts.A.reshape(count, 4, -1)[:, :2]
        covariance = self._variance * A @ A.transpose(0, 2, 1) + LEAST_VARIANCE * np.eye(2)  # m²
        whitener, each = np.zeros((count, 2, count, 2)), np.arange(count)
        whitener[each, :, each] = np.linalg.inv(np.linalg.cholesky(covariance)).transpose(0, 2, 1)
        return whitener.reshape(2 * count, -1)
