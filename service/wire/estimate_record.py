"""The estimated state of a stream with sensors, on the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:  # the estimator needs SciPy
    from graspforce.estimation.estimate import GraspEstimate
    from graspforce.estimation.grasp_monitor import GraspMonitorEstimate


class EstimateRecord(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The estimated state from which a command was computed, of a stream with sensors.

    Args:
        posture: joint positions, rad.
        velocity: joint rates, rad/s.
        position: position of the object from the contacts, in H, m.
        rotation: rotation matrix of the object from the contacts, in H.
        twist: twist of the object from the contacts, in H, m/s and rad/s.
        fused_position: position of the best known pose, in H, m.
        fused_rotation: rotation matrix of the best known pose, in H.
        slip: slip of each fingertip since the start that no motion of the object explains, m.
        monitor: estimated forces, slip, friction and payload, with sensors of torques or fingertip forces.
    """

    posture: list[float]
    velocity: list[float]
    position: list[float]
    rotation: list[list[float]]
    twist: list[float]
    fused_position: list[float]
    fused_rotation: list[list[float]]
    slip: list[list[float]]
    monitor: dict[str, Any] | None = None

    @classmethod
    def pack(cls, estimate: GraspEstimate, monitor: GraspMonitorEstimate | None) -> EstimateRecord:
        """Return the wire form of an estimate.

        Args:
            estimate: the estimated state.
            monitor: estimated forces, slip, friction and payload, or None.
        """
        motion, fused = estimate.object, estimate.fused_pose
        return cls(
            posture=estimate.q.tolist(),
            velocity=estimate.v.tolist(),
            position=motion.p_HO.tolist(),
            rotation=motion.R_HO.tolist(),
            twist=motion.twist.tolist(),
            fused_position=fused.p_HO.tolist(),
            fused_rotation=fused.R_HO.tolist(),
            slip=estimate.slip.tolist(),
            monitor=None if monitor is None else monitor.to_dict(),
        )
