"""Fusion of the pose from the contacts with late, slow and biased camera poses.

The object's true pose is T_HO = T_contact D. The offset D is constant while the contacts keep what they kept at the start, and
drifts slowly where they slip or where their geometry is wrong. The camera sees T_HO with noise and with a constant error b
in H, such as of its calibration. The filter estimates

    x = (δ, b),    D = D̂ exp(δ),    δ̇ = w,    ḃ = 0,

with δ in O. A camera pose at time t is compared with the pose from the contacts at the same t, which a history keeps. So the
delay of the camera is exact whatever the object's motion: D moves by its drift only. The innovation z is the difference between
T_contact⁻¹ T_camera and D̂. With its covariance S, a pose whose zᵀ S⁻¹ z is above a quantile of the chi-square distribution is
rejected as an outlier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from graspforce.core.arrays import Array, freeze
from graspforce.estimation.contact_pose import ARM
from graspforce.estimation.measurement import PoseMeasurement
from graspforce.estimation.pose_history import TimedPose
from graspforce.estimation.sensor_model import CameraModel
from graspforce.estimation.settings import EstimatorSettings
from graspforce.geometry.rotations import rotation_exp, rotation_log

_CLOSE = 1e-9  # m and rad: offsets that are closer than this are equal


class PoseOffset(NamedTuple):
    """Offset D between the pose from the contacts and the object's pose: T_HO = T_contact D.

    Attributes:
        p: (3,) position, m.
        R: (3, 3) rotation.
    """

    p: Array
    R: Array

    def approach(self, target: PoseOffset, share: float) -> PoseOffset:
        """Return an offset on the way to another one.

        Args:
            target: the other offset.
            share: part of the way, from 0 to 1.
        """
        if target is self:
            return self
        way, turn = target.p - self.p, rotation_log(target.R @ self.R.T)
        if max(map(abs, (*way.tolist(), *turn))) < _CLOSE:
            return target
        return PoseOffset(freeze(self.p + share * way), freeze(rotation_exp([share * x for x in turn]) @ self.R))


NO_OFFSET = PoseOffset(freeze(np.zeros(3)), freeze(np.eye(3)))
"""The offset at the start. It is the same object until the first camera pose, so that `is` finds it."""


@dataclass(frozen=True, eq=False, slots=True)
class OffsetMemory:
    """State of the filter after a camera pose.

    Attributes:
        t: time of the last camera pose, or of the start, s.
        offset: estimated offset D.
        bias: (6,) estimated constant error of the camera in H, m and rad.
        covariance: (12, 12) covariance of (δ, b).
        rejected: number of camera poses rejected in a row.
    """

    t: float
    offset: PoseOffset
    bias: Array
    covariance: Array
    rejected: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class Drift:
    """Drift of the offset since the last camera pose, besides the drift at all times.

    Attributes:
        slip_time: time in which a finger slipped, s.
        free_motions: (6, f) unit displacements in O that the contacts leave free.
    """

    slip_time: float
    free_motions: Array


class PoseFusion:
    """Filter of the offset between the pose from the contacts and camera poses.

    Args:
        camera: noise and bias of the camera.
        settings: drift, initial uncertainty and gate.
    """

    def __init__(self, camera: CameraModel, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._noise = np.diag([camera.position_noise**2] * 3 + [camera.angle_noise**2] * 3)
        self._bias = np.array([camera.position_bias**2] * 3 + [camera.angle_bias**2] * 3)
        self._gate = float(chdtri(6, 1.0 - settings.gate))  # quantile of the chi-square distribution

    def initial_memory(self, t: float, offset: PoseOffset | None = None) -> OffsetMemory:
        """Return the memory at the start.

        Args:
            t: time, s.
            offset: offset at the start; none by default.
        """
        start = np.array([self._settings.position_error**2] * 3 + [self._settings.angle_error**2] * 3)
        covariance = np.diag(np.concatenate([start, self._bias]))
        return OffsetMemory(t, NO_OFFSET if offset is None else offset, freeze(np.zeros(6)), freeze(covariance))

    def predicted_covariance(self, memory: OffsetMemory, t: float, drift: Drift) -> Array:
        """Return the (12, 12) covariance of offset and bias at a later time.

        Args:
            memory: the memory after the last camera pose.
            t: time, s.
            drift: additional drift until then.
        """
        settings, elapsed = self._settings, max(t - memory.t, 0.0)
        slip = settings.slip_drift**2 * drift.slip_time
        position = settings.position_drift**2 * elapsed + slip  # m²
        angle = settings.angle_drift**2 * elapsed + slip / ARM**2  # rad²
        P = np.array(memory.covariance)
        P[range(6), range(6)] += [position] * 3 + [angle] * 3
        P[:6, :6] += settings.free_drift**2 * elapsed * (drift.free_motions @ drift.free_motions.T)
        return P

    def update(
        self, memory: OffsetMemory, measured: PoseMeasurement, contact_pose: TimedPose, contact_covariance: Array, drift: Drift
    ) -> tuple[OffsetMemory, bool]:
        """Return the memory after a camera pose, and whether the pose was accepted.

        Args:
            memory: memory after the last camera pose.
            measured: the camera pose.
            contact_pose: pose from the contacts at the time of the camera pose.
            contact_covariance: (6, 6) covariance of the pose from the contacts, in O.
            drift: additional drift since the last camera pose.
        """
        p, R = contact_pose.p_HO, contact_pose.R_HO
        to_H = np.kron(np.eye(2), R)  # rotates twists from O to H
        H = np.hstack([np.eye(6), to_H.T])
        P = self.predicted_covariance(memory, contact_pose.t, drift)
        noise = self._noise if measured.covariance is None else measured.covariance
        position = R.T @ (measured.p_HO - p - memory.bias[:3]) - memory.offset.p  # m, in O
        unbiased = rotation_exp(-memory.bias[3:]) @ measured.R_HO
        turn = rotation_log(R.T @ unbiased @ memory.offset.R.T)  # rad, in O
        z = np.concatenate([position, turn])
        S = H @ P @ H.T + to_H.T @ noise @ to_H + contact_covariance
        if z @ np.linalg.solve(S, z) > self._gate:
            if memory.rejected < self._settings.rejection_limit:
                rejected = memory.rejected + 1
                return OffsetMemory(contact_pose.t, memory.offset, memory.bias, freeze(P), rejected), False
            P[range(6), range(6)] += z**2  # the object has moved in the fingers
            S[range(6), range(6)] += z**2
        K = np.linalg.solve(S, H @ P).T
        x = K @ z
        kept = np.eye(12) - K @ H
        measured_noise = to_H.T @ noise @ to_H + contact_covariance
        P = kept @ P @ kept.T + K @ measured_noise @ K.T
        updated = OffsetMemory(
            contact_pose.t,
            PoseOffset(freeze(memory.offset.p + x[:3]), freeze(rotation_exp(x[3:6]) @ memory.offset.R)),
            freeze(memory.bias + x[6:]),
            freeze(0.5 * (P + P.T)),
        )
        return updated, True
