"""Estimator of the state of a grasp: joints, object, slip and gaps, from what the hand measures."""

from __future__ import annotations

import copy
import math

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import make_unchecked
from graspforce.estimation.estimate import EstimatorMemory, EstimatorParts, GraspEstimate
from graspforce.estimation.joints.joint_filter import JointFilter
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.estimation.pose.compiled_contact_pose import make_tracker
from graspforce.estimation.pose.compiled_pose_fusion import make_fusion
from graspforce.estimation.pose.pose_fusion import Drift, PoseOffset
from graspforce.estimation.pose.pose_history import PoseHistory, TimedPose
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.estimation.settings import EstimatorSettings
from graspforce.grasp.grasp import Grasp


class GraspEstimator:
    """Estimator of a grasp's state. Call `step` once every period.

    Joint positions are required; they give the joint rates, and the object's pose and twist from the fingertips with rolling
    contacts. Camera poses, which may be late and rare, correct the pose by an offset:

        estimator = GraspEstimator(grasp, SensorModel(encoder_noise=1e-3))
        memory = estimator.initial_memory(Measurement(t, q))
        estimate, memory = estimator.step(memory, Measurement(t, q), command.joint_acceleration)

    Args:
        grasp: hand, object and contacts.
        sensors: rate, latency and noise of the sensors. Default: nearly perfect encoders.
        period: time between two measurements, s. Default: that of the sensors' rate.
        settings: process noise, initial uncertainty and gates.

    Raises:
        InvalidInput: the period is not greater than 0.
    """

    def __init__(
        self,
        grasp: Grasp,
        sensors: SensorModel | None = None,
        period: float | None = None,
        settings: EstimatorSettings | None = None,
    ) -> None:
        self.grasp = grasp
        self.sensors = SensorModel() if sensors is None else sensors
        self.settings = EstimatorSettings() if settings is None else settings
        self.period = arrays.check_number(1.0 / self.sensors.rate if period is None else period, "period", above=0.0)
        self._parts = EstimatorParts(
            JointFilter(grasp.hand.n, self.sensors, self.settings, self.period, _acceleration_limits(grasp)),
            make_tracker(grasp, self.period),
            make_fusion(self.sensors.camera or CameraModel(), self.settings),
            self.settings.contact_noise,
        )
        self._smoothing = -math.expm1(-self.period / self.settings.offset_time)
        self._history_length = round(self.settings.history / self.period)

    def with_grasp(self, grasp: Grasp) -> GraspEstimator:
        """Return the estimator of the same hand with other contacts. It shares the filters and is faster than a new one.

        Args:
            grasp: the grasp, with the pose of the object from which its contacts are tracked.
        """
        estimator = copy.copy(self)
        estimator.grasp, estimator._parts = grasp, self._parts._replace(tracker=make_tracker(grasp, self.period))
        return estimator

    def continued_memory(self, memory: EstimatorMemory, q: Array) -> EstimatorMemory:
        """Return a memory in which the contacts of this estimator start anew, at the pose of its grasp.

        Joint filter, camera offset and history stay. Distances of the fingertips from their contacts count as in
        `initial_memory`.

        Args:
            memory: memory after a step with other contacts, when the object was at that pose.
            q: (n,) joint positions then, rad.
        """
        parts = self._parts
        variance = float(parts.joints.covariance(memory.joints)[0, 0])  # rad²
        pose, reference = parts.tracker.start(q, variance, self.settings.contact_error)
        return memory._replace(pose=pose, reference=reference._replace(start=None))

    def initial_memory(self, measurement: Measurement, samples: int = 1, offset: PoseOffset | None = None) -> EstimatorMemory:
        """Return the memory at the start of the grasp, when the object is at the pose of the grasp.

        A difference between the measured posture and that of the grasp counts as an error of the contacts, as far as it exceeds
        the noise of the encoders. The next measurements improve the start, see `joint_start`: its standard deviation falls from
        that of one measurement to about 0.4 of it. An average of several measurements at rest gives a better one.

        Args:
            measurement: the first measurement, which `step` may get again, or the average of several.
            samples: number of measurements of which it is the average.
            offset: offset of the object from its pose in the grasp, from an earlier estimate; none by default.

        Raises:
            InvalidInput: the measurement belongs to another hand, or there are no samples.
        """
        self._check_joint_count(measurement)
        count = fields.check_integer(samples, "samples", minimum=1, maximum=10**9)
        parts, t, variance = self._parts, measurement.t, self.sensors.encoder_variance / count  # rad²
        pose, reference = parts.tracker.start(measurement.q, variance, self.settings.contact_error)
        if count > 1:
            reference = reference._replace(start=None)  # the smoother counts on the noise of one measurement
        joints, start = parts.joints.initial_memory(t, measurement.q, measurement.v), parts.fusion.initial_memory(t, offset)
        return EstimatorMemory(joints, pose, reference, start, start.offset, PoseHistory(), 0.0)

    def step(
        self,
        memory: EstimatorMemory,
        measurement: Measurement,
        joint_acceleration: Array | None = None,
        *,
        slipping: npt.ArrayLike | None = None,
        touching: npt.ArrayLike | None = None,
    ) -> tuple[GraspEstimate, EstimatorMemory]:
        """Return the estimate after a measurement, and the memory for the next step.

        Args:
            memory: memory after the last step; `initial_memory` before the first.
            measurement: measured joint positions, and what else was measured.
            joint_acceleration: (n,) joint accelerations that the last command asked for, rad/s². Default: none.
            slipping: (N,) whether each fingertip slips: it then does not determine the object's motion along its surface.
            touching: (N,) whether each fingertip touches: if not, it does not determine the object's motion.

        Raises:
            InvalidInput: the measurement belongs to another hand, or is earlier than the last one.
        """
        self._check_joint_count(measurement)
        parts, t = self._parts, measurement.t
        state, joints = parts.joints.step(memory.joints, t, measurement.q, measurement.v, joint_acceleration)
        weights, slip_time, last, reference = parts.tracker.weights, memory.slip_time, memory.pose, memory.reference
        if slipping is not None or touching is not None:
            is_slipping, is_apart = self._contact_flags(slipping, touching)
            weights = parts.tracker.reduced_weights(is_slipping, is_apart)
            if is_slipping.any() or is_apart.any():
                slip_time, reference = slip_time + self.period, reference._replace(start=None)
        if reference.start is not None and joints.start is not None and joints.start is not memory.joints.start:
            variance = parts.joints.start_variance(joints)
            last, reference = parts.tracker.improve_start(last, reference, joints.start, variance, self.settings.contact_error)
        pose = parts.tracker.step(last, reference, state[0], state[1], weights)
        t += parts.joints.delay * self.period
        history = memory.history.append(TimedPose(t, pose.p_HO.copy(), pose.R_HO.copy()), self._history_length)
        smooth = memory.smooth_offset.approach(memory.offset.offset, self._smoothing)
        accepted, present = None, EstimatorMemory(joints, pose, reference, memory.offset, smooth, history, slip_time)
        if measurement.object is not None:
            present, accepted = self._with_camera_pose(present, state[0], measurement.object)
            pose = present.pose
        estimate = make_unchecked(
            GraspEstimate, t=t, q=state[0], v=state[1], disturbance=state[2], object=pose.motion, slip=pose.slip, gap=pose.gap,
            offset=present.offset.offset, smooth_offset=present.smooth_offset, camera_accepted=accepted, _memory=present,
            _parts=parts,
        )  # fmt: skip
        return estimate, present

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _check_joint_count(self, measurement: Measurement) -> None:
        """Raise InvalidInput if the measured joints are not those of the hand."""
        hand = self.grasp.hand
        if len(measurement.q) != hand.n:
            raise InvalidInput("measurement.q", measurement.q, f"a list of {hand.n} numbers, one for each motor of {hand.name}")

    def _contact_flags(
        self, slipping: npt.ArrayLike | None, touching: npt.ArrayLike | None
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Return which fingertips slip, and which do not touch, both (N,)."""
        count = len(self.grasp.contacts)
        flags = []
        for name, values in (("slipping", slipping), ("touching", touching)):
            array = np.zeros(count, bool) if values is None else np.asarray(values)
            if array.shape != (count,) or array.dtype != np.bool_:
                raise InvalidInput(name, values, f"a list of {count} booleans, one for each contact")
            flags.append(array)
        return flags[0], np.zeros(count, bool) if touching is None else ~flags[1]

    def _with_camera_pose(self, memory: EstimatorMemory, q: Array, measured: PoseMeasurement) -> tuple[EstimatorMemory, bool]:
        """Return the memory after a camera pose, and whether the pose was accepted."""
        newest = memory.history.newest
        contact_pose = memory.history.pose_at(min(measured.t, newest.t))
        if contact_pose is None or contact_pose.t < memory.offset.t:
            return memory, False  # older than the history, or than a pose that was used
        parts, pose = self._parts, memory.pose
        variance = float(parts.joints.covariance(memory.joints)[0, 0])  # rad²
        covariance, free_motions = parts.tracker.uncertainty(pose, memory.reference, variance, parts.contact_noise)
        drift = Drift(memory.slip_time, free_motions)
        offset, is_accepted, moved = parts.fusion.update(memory.offset, measured, contact_pose, covariance, drift)
        if moved is None:
            return memory._replace(offset=offset, slip_time=0.0), is_accepted
        p_HO, R_HO = pose.p_HO + pose.R_HO @ moved.p, pose.R_HO @ moved.R
        pose, reference = parts.tracker.restart(pose, p_HO, R_HO, q, variance)
        history = memory.history.displaced(moved.p, moved.R, contact_pose.t)
        smooth = moved.inverse().times(memory.smooth_offset)  # the fused pose, as controlled, does not jump
        return EstimatorMemory(memory.joints, pose, reference, offset, smooth, history, 0.0), is_accepted


def _acceleration_limits(grasp: Grasp) -> Array:
    """Return the (n,) accelerations that the motors can cause, the torque range divided by M_jj of the mass matrix, rad/s²."""
    hand = grasp.hand
    return np.asarray((hand.torque_upper - hand.torque_lower) / np.diag(hand.mass_matrix(grasp.q)))
