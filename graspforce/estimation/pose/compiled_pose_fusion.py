"""Fusion of poses in C (`csrc/include/graspforce/pose_fusion.h`). `pose_fusion` is the reference implementation."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.compiled import native, new_block
from graspforce.estimation.measurement import PoseMeasurement
from graspforce.estimation.pose.pose_fusion import Drift, FusionResult, OffsetMemory, PoseFusion, PoseOffset
from graspforce.estimation.pose.pose_history import TimedPose
from graspforce.estimation.sensor_model import CameraModel
from graspforce.estimation.settings import EstimatorSettings

_ACCEPTED = 2  # result of fuse_pose()


def make_fusion(camera: CameraModel, settings: EstimatorSettings) -> PoseFusion:
    """Return a filter of camera poses: compiled if possible, the reference implementation otherwise.

    Args:
        camera: noise and bias of the camera.
        settings: drift, initial uncertainty and gate.
    """
    return PoseFusion(camera, settings) if native is None else CompiledFusion(camera, settings)


class CompiledFusion(PoseFusion):
    """Filter of the offset between the pose from the contacts and camera poses, by compiled code.

    Args:
        camera: noise and bias of the camera.
        settings: drift, initial uncertainty and gate.
    """

    def __init__(self, camera: CameraModel, settings: EstimatorSettings) -> None:
        super().__init__(camera, settings)
        self._dtype: np.dtype[np.void] = np.dtype(native.offset_layout())

    def update(
        self, memory: OffsetMemory, measured: PoseMeasurement, contact_pose: TimedPose, contact_covariance: Array, drift: Drift
    ) -> FusionResult:
        """Return the result of a camera pose; see `PoseFusion.update`. The reference implementation treats outliers.

        Args:
            memory: memory after the last camera pose.
            measured: the camera pose.
            contact_pose: pose from the contacts at the time of the camera pose.
            contact_covariance: (6, 6) covariance of the pose from the contacts, in O.
            drift: additional drift since the last camera pose.
        """
        position_drift, angle_drift, free_drift = self.drift_variances(contact_pose.t - memory.t, drift.slip_time)
        block = new_block(self._dtype)
        result = native.fuse_pose(
            p_measured=measured.p_HO,
            R_measured=measured.R_HO,
            noise=self.measurement_noise(measured),
            p_HO=contact_pose.p_HO,
            R_HO=contact_pose.R_HO,
            contact_covariance=contact_covariance,
            free_motions=_six_columns(drift.free_motions),
            p=memory.offset.p,
            R=memory.offset.R,
            bias=memory.bias,
            covariance=memory.covariance,
            position_drift=position_drift,
            angle_drift=angle_drift,
            free_drift=free_drift,
            gate=self._gate,
            next=block,
        )
        if result != _ACCEPTED:
            return super().update(memory, measured, contact_pose, contact_covariance, drift)
        block.setflags(write=False)
        offset = PoseOffset(block["p"], block["R"])
        return FusionResult(OffsetMemory(contact_pose.t, offset, block["bias"], block["covariance"]), True)


def _six_columns(motions: Array) -> Array:
    """Return at most six displacements with zeros beside them, (6, 6)."""
    if motions.shape[1] == 6:
        return motions
    padded = np.zeros((6, 6))
    padded[:, : motions.shape[1]] = motions
    return padded
