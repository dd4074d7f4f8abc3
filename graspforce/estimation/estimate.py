"""Estimate of a grasp's state, with covariances that are computed at their first access."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import make_unchecked
from graspforce.estimation.joints.joint_filter import JointFilter, JointFilterMemory
from graspforce.estimation.pose.contact_pose import ContactPose, ContactPoseTracker, ContactReference
from graspforce.estimation.pose.pose_fusion import NO_OFFSET, Drift, OffsetMemory, PoseFusion, PoseOffset
from graspforce.estimation.pose.pose_history import PoseHistory
from graspforce.geometry.poses import pose_to_dict


class EstimatorMemory(NamedTuple):
    """State of the estimator after a measurement.

    Attributes:
        joints: state of the joint filter.
        pose: pose from the contacts.
        reference: reference of the contacts at the start.
        offset: offset of the object from that pose, from camera poses.
        smooth_offset: the offset, without steps.
        history: poses from the contacts.
        slip_time: time since the last camera pose in which a finger slipped, s.
    """

    joints: JointFilterMemory
    pose: ContactPose
    reference: ContactReference
    offset: OffsetMemory
    smooth_offset: PoseOffset
    history: PoseHistory
    slip_time: float


class EstimatorParts(NamedTuple):
    """Parts of an estimator, which do not change.

    Attributes:
        joints: filter of the joints.
        tracker: tracker of the pose from the contacts.
        fusion: filter of camera poses.
        contact_noise: standard deviation of the momentary error of each contact coordinate, m.
    """

    joints: JointFilter
    tracker: ContactPoseTracker
    fusion: PoseFusion
    contact_noise: float


@dataclass(frozen=True, eq=False)
class GraspEstimate:
    """Estimated state of a grasp.

    `object` is consistent with the contacts: control it. The object's best known pose, with camera poses, is `fused_pose`. It
    differs by the slowly varying offset D: T_fused = T_object D. To bring the fused pose to a desired one, control `object` to
    `to_contact_frame(desired)`, which follows D without steps.

    Attributes:
        t: time of the estimate, s: that of the measurement plus the latency that is predicted.
        q: (n,) joint positions, rad.
        v: (n,) joint rates, rad/s.
        disturbance: (n,) joint accelerations beside the commanded ones, such as from friction, rad/s².
        object: pose and twist of the object in H from the contacts.
        slip: (N, 2) slip of each fingertip along t₁ and t₂ since the start that no motion of the object explains, m.
        gap: (N,) distances of the fingertips from the surface, m; negative in penetration.
        offset: D as a position in m and a rotation.
        smooth_offset: D without the steps that camera poses cause.
        camera_accepted: whether the camera pose of this period was accepted; None if there was none.
    """

    t: float
    q: Array
    v: Array
    disturbance: Array
    object: BodyMotion
    slip: Array
    gap: Array
    offset: PoseOffset
    smooth_offset: PoseOffset
    camera_accepted: bool | None
    _memory: EstimatorMemory
    _parts: EstimatorParts

    @cached_property
    def joint_covariance(self) -> Array:
        """(3, 3) covariance of position, rate and disturbance of each joint, in rad, rad/s and rad/s²."""
        return freeze(self._parts.joints.covariance(self._memory.joints))

    @cached_property
    def pose_covariance(self) -> Array:
        """(6, 6) covariance in H of the pose from the contacts, from noise: p, m², and rotation vector, rad²."""
        memory, parts = self._memory, self._parts
        variance = float(self.joint_covariance[0, 0])  # rad²
        return self._in_H(parts.tracker.covariance(memory.pose, memory.reference, variance, parts.contact_noise))

    @cached_property
    def slip_covariance(self) -> Array:
        """(N, 2, 2) covariance of `slip` of each finger from noise, m²."""
        memory, parts = self._memory, self._parts
        variance = float(self.joint_covariance[0, 0])  # rad²
        return freeze(parts.tracker.slip_covariance(memory.pose, memory.reference, variance, parts.contact_noise))

    @cached_property
    def twist_covariance(self) -> Array:
        """(6, 6) covariance in H of the twist, m²/s² and rad²/s²."""
        return self._in_H(self._parts.tracker.twist_covariance(self._memory.pose, float(self.joint_covariance[1, 1])))

    @cached_property
    def fused_covariance(self) -> Array:
        """(6, 6) covariance in H of the fused pose: of the pose from the contacts and of the offset, m² and rad²."""
        memory = self._memory
        drift = Drift(memory.slip_time, self._parts.tracker.free_motions(memory.pose))
        offset = self._parts.fusion.predicted_covariance(memory.offset, self.t, drift)[:6, :6]
        return freeze(self.pose_covariance + self._in_H(offset))

    @cached_property
    def fused_pose(self) -> BodyMotion:
        """Best known pose and twist of the object in H; the acceleration is zero."""
        body, offset = self.object, self.offset
        if offset is NO_OFFSET:
            return body
        fused = body.of_fixed_frame(offset.p, offset.R)
        return make_unchecked(BodyMotion, p_HO=fused.p_HO, R_HO=fused.R_HO, twist=fused.twist, acceleration=body.acceleration)

    def to_contact_frame(self, desired: BodyMotion, duration: float = 0.0) -> BodyMotion:
        """Return the motion of `object` that gives the fused pose a desired motion: T_desired D⁻¹.

        Args:
            desired: desired motion of the object in H.
            duration: time over which it is continued with constant acceleration before, s.
        """
        offset = self.smooth_offset
        if offset is NO_OFFSET:
            return desired.after(duration) if duration > 0.0 else desired
        return desired.of_parent_frame(offset.p, offset.R, duration)

    def to_dict(self) -> JsonRecord:
        """Return the record: joints, the pose from the contacts, the fused pose with its covariance, slip and gaps."""
        fused = self.fused_pose
        return {
            "t": self.t,
            "posture": self.q.tolist(),
            "velocity": self.v.tolist(),
            "object": {**pose_to_dict(self.object.p_HO, self.object.R_HO), "twist": self.object.twist.tolist()},
            "fused": {**pose_to_dict(fused.p_HO, fused.R_HO), "covariance": self.fused_covariance.tolist()},
            "slip": self.slip.tolist(),
            "gap": self.gap.tolist(),
        }

    def _in_H(self, covariance: Array) -> Array:
        """Return a covariance of twists in O, rotated to H."""
        to_H = np.kron(np.eye(2), self.object.R_HO)
        return freeze(to_H @ covariance @ to_H.T)
