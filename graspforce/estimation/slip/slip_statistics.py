"""Statistics of the slip detector: means over windows, and the likelihood of slip of each finger.

The residuals y of N contacts have four rows for each contact: slip along t₁ and t₂, approach along n, and a fourth that
is not tested. The mean m_k over window k and the mean b over a long time have the variances c_k Σ and c_b Σ if the
noise Σ is independent between periods. Slip ŝ_i of one finger, with the covariance P_i, is the least-squares estimate
from m_k − b, whose covariance is (c_k + c_b) Σ + Σ_bias.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graspforce.core.arrays import Array

_POSE_SIZE = np.array([1.0, 1.0, 1.0, 30.0, 30.0, 30.0])  # m and rad: expected size of an unknown pose, unbounded in practice
_CERTAIN = 12.0  # difference of two statistics: the first finger is exp(6) times as likely
_FULL_TIMES = 8.0  # time constants after which a mean is full: its variance is off by a factor of exp(-14)
_SLIP_SIZE = 0.01  # m: expected size of a slip; it keeps estimates finite of slips that no measurement shows


class WindowGains(NamedTuple):
    """Gains of K windows and the baseline, in that order.

    Attributes:
        gains: (K + 1, 1) weights of a new residual in the means.
        kept: (K + 1, 1) weights of the last means.
        variance: (K + 1,) variances c of full means, as fractions of that of one residual.
        start: residuals from the start until the variances are those of full means.
    """

    gains: Array
    kept: Array
    variance: Array
    start: int

    @classmethod
    def for_step(cls, times: Array, elapsed: float) -> WindowGains:
        """Return the gains of exponential means.

        Args:
            times: (K + 1,) their time constants, s.
            elapsed: time between two residuals, s.
        """
        gains = -np.expm1(-elapsed / times)
        start = int(np.ceil(_FULL_TIMES / gains.min()))
        return cls(gains[:, None], 1.0 - gains[:, None], gains / (2.0 - gains), start)


class WindowMeans(NamedTuple):
    """Exponential means of the residuals over K windows and the baseline, in that order.

    Attributes:
        values: (K + 1, 4 N) means, m.
        variance: (K + 1,) variances c of the means as fractions of that of one residual.
        updates: residuals since the start or the last restart.
    """

    values: Array
    variance: Array
    updates: int

    @classmethod
    def start(cls, y: Array, count: int) -> WindowMeans:
        """Return the means after the first residual.

        Args:
            y: (4 N,) the residual, m.
            count: K + 1.
        """
        return cls(np.tile(y, (count, 1)), np.ones(count), 1)

    def updated(self, y: Array, gains: WindowGains) -> WindowMeans:
        """Return the means after another residual. Means that are not full weight all residuals equally.

        Args:
            y: (4 N,) the residual, m.
            gains: gains of the windows.
        """
        updates = self.updates + 1
        if updates > gains.start:
            return WindowMeans(gains.kept * self.values + gains.gains * y, gains.variance, updates)
        g = np.maximum(gains.gains, 1.0 / updates)
        kept = 1.0 - g
        variance = np.square(kept[:, 0]) * self.variance + np.square(g[:, 0])
        return WindowMeans(kept * self.values + g * y, variance, updates)

    def restarted(self, window: int) -> WindowMeans:
        """Return means that start anew from the mean over one window.

        Args:
            window: index of the window.
        """
        variance, count = self.variance[window], len(self.values)
        updates = max(round(1.0 / float(variance)), 1)
        return WindowMeans(np.tile(self.values[window], (count, 1)), np.full(count, variance), updates)


class SlipFound(NamedTuple):
    """Slip that explains a mean.

    Attributes:
        fingers: the fingers, the likeliest first.
        distances: (fingers, 2) their slip along t₁ and t₂, m.
        is_certain: whether no other finger is nearly as likely as the first.
        evidence: statistic of each of them that remains if any motion of the object is free, and any other finger slips, too:
            the least over the other fingers.
    """

    fingers: list[int]
    distances: Array
    is_certain: bool
    evidence: list[float]


class SlipTest(NamedTuple):
    """Test of the means of N contacts over K windows.

    Attributes:
        information: (K, 3 N, 3 N) inverse covariance of the means less the baseline, without motions of the object that are
            free, 1/m².
        whitener: (2 N K, 4 N (K + 1)) all means, with the baseline, to the slips of each finger alone with unit covariance,
            1/m.
        joint_whitener: (2 N K, 4 N (K + 1)) the same for the slips of all fingers together, 1/m.
        covariance: (K, 3 N, 3 N) covariance of the means less the baseline, m².
        B: (3 N, 6) twist of the object in O to the residuals.
        model_error: (3 N,) variances beyond the covariance that evidence of slip must exceed, m².
    """

    information: Array
    whitener: Array
    joint_whitener: Array
    covariance: Array
    B: Array
    model_error: Array

    def statistics(self, means: WindowMeans) -> Array:
        """Return ŝ_iᵀ P_i⁻¹ ŝ_i (K N,) of slips of each finger alone, by window; χ² with two degrees of freedom without slip.

        Args:
            means: means of the residuals.
        """
        z = self.whitener.dot(means.values.ravel())
        z *= z
        return np.asarray(z[0::2] + z[1::2])

    def joint_statistics(self, means: WindowMeans) -> Array:
        """Return the statistic (K,) of slips of all fingers together, by window; χ² with 2 N degrees of freedom without slip.

        Args:
            means: means of the residuals.
        """
        z = self.joint_whitener.dot(means.values.ravel())
        return np.asarray(np.square(z).reshape(len(self.information), -1).sum(axis=1))

    def slipping_fingers(self, means: WindowMeans, window: int, threshold: float) -> SlipFound:
        """Return the fingers whose slip explains a mean.

        The likeliest finger is taken first, then others whose statistic remains above the threshold beside it. They are
        uncertain if another finger is nearly as likely as the first.

        Args:
            means: means of the residuals.
            window: index of the window.
            threshold: of the statistic.

        """
        difference = (means.values[window] - means.values[-1]).reshape(-1, 4)
        d, W, count = difference[:, :3].ravel(), self.information[window], len(difference)
        found: list[int] = []
        is_certain = True
        explained = W  # information about further slips, beside those found
        while len(found) < count:
            statistics = [0.0 if i in found else _statistic(explained, d, i) for i in range(count)]
            best = int(np.argmax(statistics))
            if found and statistics[best] <= threshold:
                break
            if not found and count > 1:
                is_certain = statistics[best] - sorted(statistics)[-2] > _CERTAIN
            found.append(best)
            explained = _beside(W, found)
        columns = _tangents(found)
        distances = np.linalg.solve(_with_prior(W[np.ix_(columns, columns)]), W[columns] @ d)
        free = _without_motions(np.linalg.inv(self.covariance[window] + np.diag(self.model_error)), self.B)
        evidence = [min((_statistic(_beside(free, [j]), d, i) for j in range(count) if j != i), default=0.0) for i in found]
        return SlipFound(found, distances.reshape(-1, 2), is_certain, evidence)


def make_slip_test(noise: Array, bias: Array, variance: Array, B: Array, *, model_error: Array, has_pose: bool) -> SlipTest:
    """Return the test of the residuals at the present contacts.

    Args:
        noise: (3 N, 3 N) covariance Σ of the residuals' noise, without the fourth rows, m².
        bias: (3 N, 3 N) covariance of errors that differ between the window and the baseline, m².
        variance: (K + 1,) variances of the means as fractions of that of one residual, the baseline's last.
        B: (3 N, 6) twist of the object in O to the residuals.
        model_error: (3 N,) variances beyond these that evidence of slip must exceed, m².
        has_pose: whether the object's pose is measured. Otherwise any motion of the object is free.
    """
    factors = variance[:-1] + variance[-1]
    covariance = factors[:, None, None] * noise + bias
    W = np.linalg.inv(covariance)
    if not has_pose:
        W = _without_motions(W, B)
    K, count = len(factors), len(noise) // 3
    fingers = np.arange(count)
    rows = W.reshape(K, count, 3, 3 * count)[:, :, :2]  # of the tangents
    own = rows.reshape(K, count, 2, count, 3)[:, fingers, :, fingers, :2].transpose(1, 0, 2, 3)
    joint, columns = rows.reshape(K, 2 * count, 3 * count), _tangents(list(range(count)))
    return SlipTest(W, _whitener(own, rows), _whitener(joint[:, :, columns], joint), covariance, B, model_error)


def _whitener(information: Array, rows: Array) -> Array:
    """Return the matrix (2 N K, 4 N (K + 1)) that takes all means, with the baseline, to slips with unit covariance.

    Args:
        information: (K, …, d, d) information about slips of the same finger, or of all fingers.
        rows: (K, …, d, 3 N) rows of the information about the means.
    """
    K, count = len(rows), rows.shape[-1] // 3
    whitened = np.linalg.solve(np.linalg.cholesky(_with_prior(information)), rows).reshape(K, 2 * count, count, 3)
    whitener = np.zeros((K, 2 * count, K + 1, count, 4))
    windows = np.arange(K)
    whitener[windows, :, windows, :, :3] = whitened
    whitener[windows, :, K, :, :3] = -whitened
    return whitener.reshape(2 * count * K, -1)


def _tangents(fingers: list[int]) -> list[int]:
    """Return the tangential rows of fingers."""
    return [3 * i + axis for i in fingers for axis in range(2)]


def _without_motions(W: Array, B: Array) -> Array:
    """Return information (…, 3 N, 3 N) without that about motions of the object."""
    weighted = W @ B
    free = B.T @ weighted + np.diag(_POSE_SIZE**-2)
    return np.asarray(W - weighted @ np.linalg.solve(free, np.swapaxes(weighted, -1, -2)))


def _beside(W: Array, fingers: list[int]) -> Array:
    """Return the information about the other rows if some fingers slip by an unknown distance."""
    columns = _tangents(fingers)
    return np.asarray(W - W[:, columns] @ np.linalg.solve(_with_prior(W[np.ix_(columns, columns)]), W[columns]))


def _with_prior(information: Array) -> Array:
    """Return the information about slips with that of their expected size added, 1/m²."""
    return np.asarray(information + np.eye(information.shape[-1]) / _SLIP_SIZE**2)


def _statistic(W: Array, d: Array, i: int) -> float:
    """Return the statistic of slip of finger i with the information W, for the mean d."""
    rows = W[3 * i : 3 * i + 2]
    score = rows @ d
    return float(score @ np.linalg.solve(_with_prior(rows[:, 3 * i : 3 * i + 2]), score))
