"""Fusion of the pose from the contacts with late, slow and biased camera poses.

The object's true pose is T_HO = T_contact D. The offset D is constant while the contacts keep what they kept at the start, and
drifts slowly where they slip or where their geometry is wrong. The camera sees T_HO with noise and with a constant error b
in H, such as of its calibration. The filter estimates

    x = (δ, b),    D = D̂ exp(δ),    δ̇ = w,    ḃ = 0,

with δ in O. A camera pose at time t is compared with the pose from the contacts at the same t, which a history keeps. So the
delay of the camera is exact whatever the object's motion: D moves by its drift only. The innovation z is the difference between
T_contact⁻¹ T_camera and D̂. With its covariance S, a pose whose zᵀ S⁻¹ z is above a quantile of the chi-square distribution is
rejected as an outlier.

Several poses in a row that are rejected, but agree with each other, are no outliers: the object has moved in the fingers. The
last of them gives a displacement X, with which the pose from the contacts starts anew at T_contact X.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import PoseMeasurement
from graspforce.estimation.pose.contact_pose import ARM
from graspforce.estimation.pose.pose_history import TimedPose
from graspforce.estimation.sensor_model import CameraModel
from graspforce.estimation.settings import EstimatorSettings
from graspforce.geometry.poses import interpolate_pose
from graspforce.geometry.rotations import rotation_exp, rotation_log

_CLOSE = 1e-9  # m and rad: offsets that are closer than this are equal
_LEAST_VARIANCE = 1e-18  # m² and rad²: no camera is more exact, whatever it reports
_RELATIVE_VARIANCE = 1e-14  # added to covariances relative to their trace, so that rounding does not make them singular
_MAX_ELAPSED = 1000.0  # s: the drift of a longer time is no larger, so that covariances stay far from overflow


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
        p, R, far = interpolate_pose(self.p, self.R, target.p, target.R, share)
        return target if far < _CLOSE else PoseOffset(p, R)

    def times(self, other: PoseOffset) -> PoseOffset:
        """Return the product with another offset, D D'.

        Args:
            other: the other offset D'.
        """
        return PoseOffset(freeze(self.p + self.R @ other.p), freeze(self.R @ other.R))

    def inverse(self) -> PoseOffset:
        """Return D⁻¹."""
        return PoseOffset(freeze(-(self.R.T @ self.p)), freeze(self.R.T))


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
        rejected: number of camera poses in a row that were rejected and agree with each other.
        rejected_innovation: (6,) innovation of the last rejected pose, m and rad; None if the last pose was accepted.
    """

    t: float
    offset: PoseOffset
    bias: Array
    covariance: Array
    rejected: int = 0
    rejected_innovation: Array | None = None


class FusionResult(NamedTuple):
    """Result of a camera pose.

    Attributes:
        memory: state of the filter after it.
        is_accepted: whether the pose was accepted.
        displacement: displacement X of the object in the fingers, if the pose revealed one. The offset then is relative to
            T_contact X.
    """

    memory: OffsetMemory
    is_accepted: bool
    displacement: PoseOffset | None = None


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
        position, angle, free = self.drift_variances(t - memory.t, drift.slip_time)
        P = np.array(memory.covariance)
        P[range(6), range(6)] += [position] * 3 + [angle] * 3
        P[:6, :6] += free * (drift.free_motions @ drift.free_motions.T)
        return P

    def drift_variances(self, elapsed: float, slip_time: float) -> tuple[float, float, float]:
        """Return the variance that drift adds to each coordinate, m², about each axis, rad², and along free motions, m².

        Args:
            elapsed: time, s; none before zero.
            slip_time: part of it in which a finger slipped, s.
        """
        settings, elapsed = self._settings, min(max(elapsed, 0.0), _MAX_ELAPSED)
        slip = settings.slip_drift**2 * min(slip_time, _MAX_ELAPSED)
        position, angle = settings.position_drift**2 * elapsed + slip, settings.angle_drift**2 * elapsed + slip / ARM**2
        return position, angle, settings.free_drift**2 * elapsed

    def measurement_noise(self, measured: PoseMeasurement) -> Array:
        """Return the (6, 6) covariance in H of a camera pose: as the camera reports it, or else as the model says.

        Args:
            measured: the camera pose.
        """
        return self._noise if measured.covariance is None else measured.covariance + _LEAST_VARIANCE * np.eye(6)

    def update(
        self, memory: OffsetMemory, measured: PoseMeasurement, contact_pose: TimedPose, contact_covariance: Array, drift: Drift
    ) -> FusionResult:
        """Return the result of a camera pose.

        Args:
            memory: memory after the last camera pose.
            measured: the camera pose.
            contact_pose: pose from the contacts at the time of the camera pose.
            contact_covariance: (6, 6) covariance of the pose from the contacts, in O.
            drift: additional drift since the last camera pose.
        """
        t, R = contact_pose.t, contact_pose.R_HO
        to_O = np.kron(np.eye(2), R.T)  # rotates twists from H to O
        H = np.hstack([np.eye(6), to_O])
        P = self.predicted_covariance(memory, t, drift)
        noise = to_O @ self.measurement_noise(measured) @ to_O.T + contact_covariance
        z = _innovation(memory, measured, contact_pose)
        S = H @ P @ H.T + noise
        has_moved = False
        if _squared_distance(z, S) > self._gate:
            count = 1
            if memory.rejected_innovation is not None:
                change = z - memory.rejected_innovation
                count += memory.rejected if _squared_distance(change, 2.0 * noise) <= self._gate else 0
            if count < self._settings.rejection_limit:
                return FusionResult(OffsetMemory(t, memory.offset, memory.bias, freeze(P), count, freeze(z)), False)
            has_moved = True
            P[range(6), range(6)] += z**2
            S[range(6), range(6)] += z**2
        K = np.linalg.solve(_regular(S), H @ P).T
        x, kept = K @ z, np.eye(12) - K @ H
        P = kept @ P @ kept.T + K @ noise @ K.T
        step = PoseOffset(x[:3], rotation_exp(x[3:6]))
        offset = PoseOffset(freeze(memory.offset.p + step.p), freeze(step.R @ memory.offset.R))
        updated = OffsetMemory(t, offset, freeze(memory.bias + x[6:]), freeze(0.5 * (P + P.T)))
        if not has_moved:
            return FusionResult(updated, True)
        displacement = offset.times(memory.offset.inverse())
        turn = np.eye(12)
        turn[:6, :6] = np.kron(np.eye(2), displacement.R.T)
        covariance = freeze(turn @ updated.covariance @ turn.T)
        return FusionResult(OffsetMemory(t, memory.offset, updated.bias, covariance), True, displacement)


def _regular(covariance: Array) -> Array:
    """Return a covariance (6, 6) that rounding does not make singular."""
    return np.asarray(covariance + _RELATIVE_VARIANCE * np.trace(covariance) * np.eye(6))


def _squared_distance(z: Array, covariance: Array) -> float:
    """Return zᵀ C⁻¹ z."""
    return float(z @ np.linalg.solve(_regular(covariance), z))


def _innovation(memory: OffsetMemory, measured: PoseMeasurement, contact_pose: TimedPose) -> Array:
    """Return the difference (6,) between T_contact⁻¹ T_camera, without the camera's bias, and the offset, in O, m and rad."""
    R = contact_pose.R_HO
    position = R.T @ (measured.p_HO - contact_pose.p_HO - memory.bias[:3]) - memory.offset.p
    unbiased = rotation_exp(-memory.bias[3:]) @ measured.R_HO
    return np.concatenate([position, rotation_log(R.T @ unbiased @ memory.offset.R.T)])
