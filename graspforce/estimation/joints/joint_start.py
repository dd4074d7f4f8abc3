"""Positions of the joints at the first measurement, from that and the measurements after it (fixed-point smoothing).

The first sample alone has the noise of the encoders. The innovations ν of a Kalman filter after it also depend on the
positions q₀ at that time. With the cross covariance Π of q₀ and the filter's state,

    q̂₀ ← q̂₀ + Π Hᵀ S⁻¹ ν,    Π ← Π (1 − K H)ᵀ Fᵀ,    var q̂₀ ← var q̂₀ − Π Hᵀ S⁻¹ H Πᵀ

(Anderson and Moore, 1979). The motion since the start need not be known: the filter accounts for it. Most of the improvement
comes within the first twenty samples.
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array

UPDATES = 32
"""Number of measurements after the first that improve the positions at the start."""


class StartSmoother:
    """Gains of the positions at the start.

    Args:
        F: (3, 3) transition of position, rate and disturbance in a period.
        Q: (3, 3) covariance of the process noise in a period.
        R: (m, m) covariance of the measured position, or of position and rate.
        P: (3, 3) covariance of the state at the first measurement.

    Attributes:
        gains: (UPDATES, m) response of the positions at the start to the innovations.
        variances: (UPDATES + 1,) variance of the positions at the start after each update, rad².
    """

    def __init__(self, F: Array, Q: Array, R: Array, P: Array) -> None:
        H = np.eye(3)[: len(R)]
        cross, variances, gains = P[0], [float(P[0, 0])], []
        for _ in range(UPDATES):
            P, cross = F @ P @ F.T + Q, cross @ F.T
            S = H @ P @ H.T + R
            gain = np.linalg.solve(S, H @ cross)
            gains.append(gain)
            variances.append(variances[-1] - float(gain @ S @ gain))
            kept = np.eye(3) - np.linalg.solve(S, H @ P).T @ H
            P, cross = kept @ P, kept @ cross
        self.gains, self.variances = np.array(gains), np.array(variances)
