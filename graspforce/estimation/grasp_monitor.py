"""Monitor of a grasp: contact forces, slip, friction and payload in one step, from the estimated state and the last command."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.compiled_contact_forces import make_force_estimator
from graspforce.estimation.compiled_contact_friction import make_friction_estimator
from graspforce.estimation.compiled_payload import make_payload_estimator
from graspforce.estimation.contact_forces import ContactForces, ForceMemory, ForceModelErrors
from graspforce.estimation.contact_friction import (
    ContactFrictionEstimate,
    ContactFrictionMemory,
    ContactFrictionSettings,
    FrictionBlocks,
)
from graspforce.estimation.current_torques import CurrentTorques
from graspforce.estimation.estimate import EstimatorMemory, GraspEstimate
from graspforce.estimation.joints.joint_filter import JointFilter
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.payload import PayloadEstimate, PayloadMemory, PayloadSettings
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.estimation.settings import EstimatorSettings
from graspforce.estimation.slip.compiled_detector import make_detector
from graspforce.estimation.slip.compiled_precaution import make_precaution_test
from graspforce.estimation.slip.detector import SlipEstimate, SlipInputs, pose_difference, pose_error
from graspforce.estimation.slip.precaution import PrecautionMemory
from graspforce.estimation.slip.slip_memory import SlipBlocks, SlipMemory
from graspforce.estimation.slip.slip_settings import SlipSettings
from graspforce.grasp.grasp import Grasp

_AGREEMENT = 5.0  # standard deviations up to which two poses agree
_PAYLOAD_STEPS = 8  # periods between two updates of the payload, with the mean forces
_LEAST_ENCODER_NOISE = 1e-6  # rad; a noise of zero would make tests singular
_ALWAYS = 10**9  # updates after which the gains of the joint filter are constant


@dataclass(frozen=True, slots=True)
class GraspMonitorSettings:
    """Settings of `GraspMonitor`.

    Args:
        forces: constant errors of torques and fingertip sensors.
        slip: settings of the slip detector.
        friction: settings of the estimator of friction coefficients.
        payload: settings of the estimator of the payload.
        state: settings of `GraspEstimator`; they give the error of its joint accelerations.
    """

    forces: ForceModelErrors = field(default_factory=ForceModelErrors)
    slip: SlipSettings = field(default_factory=SlipSettings)
    friction: ContactFrictionSettings = field(default_factory=ContactFrictionSettings)
    payload: PayloadSettings = field(default_factory=PayloadSettings)
    state: EstimatorSettings = field(default_factory=EstimatorSettings)


class AppliedCommand(NamedTuple):
    """Command that acted during the last period.

    Attributes:
        tau: (n,) joint torques without those that overcome joint friction, N·m.
        joint_acceleration: (n,) commanded joint accelerations, rad/s².
        motion: desired motion of the object in H.
        free_torque: (n,) torques of the hand's own motion in it, N·m. Default: computed from the estimated state.
    """

    tau: Array
    joint_acceleration: Array
    motion: BodyMotion
    free_torque: Array | None = None


class GraspMonitorMemory(NamedTuple):
    """State of the monitor after a period: that of each of its estimators.

    Attributes:
        forces: of the estimator of contact forces.
        slip: of the slip detector; None before the first period.
        friction: of the estimator of friction coefficients.
        payload: of the estimator of the payload.
        recent: contact forces since the last update of the payload.
        rejected: (6,) error of the last pose if the estimator rejected it, m and rad; None if it did not.
        precaution: of the test for precautions; None before the first period with fingertip forces.
    """

    forces: ForceMemory
    slip: SlipMemory | SlipBlocks | None
    friction: ContactFrictionMemory | FrictionBlocks
    payload: PayloadMemory
    recent: tuple[ContactForces, ...] = ()
    rejected: Array | None = None
    precaution: PrecautionMemory | Block | None = None


@dataclass(frozen=True, eq=False, slots=True)
class GraspMonitorEstimate:
    """Estimates of the monitor in one period.

    Attributes:
        forces: contact forces.
        slip: slip by finger.
        friction: friction coefficients by finger, with bounds.
        payload: mass, centre of mass and external wrench of the object.
        is_precaution_due: whether forces or motion surely differ from the commanded ones, so that a short squeeze is due. False
            without fingertip forces.
    """

    forces: ContactForces
    slip: SlipEstimate
    friction: ContactFrictionEstimate
    payload: PayloadEstimate
    is_precaution_due: bool = False

    def to_dict(self) -> JsonRecord:
        """Return the record: `force` (N × 3, in the contact frames), `slipping`, `friction` and `payload`."""
        return {
            "force": self.forces.f.tolist(),
            "slipping": self.slip.slipping.tolist(),
            "friction": self.friction.to_dict(),
            "payload": self.payload.to_dict(),
        }


class GraspMonitor:
    """Estimators of contact forces, slip, friction and payload of a grasp, without memory of their own.

    Args:
        grasp: hand, object and contacts.
        sensors: noise of the sensors. Contact forces come from fingertip sensors and from joint torques: measured ones, those
            of measured currents (`current_torques`), or commanded ones.
        period: time between two steps, s.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        settings: settings of all parts.

    Raises:
        InvalidInput: currents are measured, and the torque constant of a drive is unknown.
    """

    def __init__(
        self,
        grasp: Grasp,
        sensors: SensorModel,
        period: float,
        gravity_H: npt.ArrayLike,
        settings: GraspMonitorSettings | None = None,
    ) -> None:
        settings = GraspMonitorSettings() if settings is None else settings
        self._gravity_H = arrays.check_array(gravity_H, "gravity_H", (3,))
        joints = JointFilter(grasp.hand.n, sensors, settings.state, period)
        in_the_end = replace(joints.initial_memory(0.0, grasp.q), updates=_ALWAYS)
        camera = sensors.camera or CameraModel()
        noise = np.repeat([camera.position_noise, camera.angle_noise], 3)
        self._agreement = _AGREEMENT * math.sqrt(2.0) * noise  # m and rad: largest difference of two poses
        disturbance_error = math.sqrt(joints.covariance(in_the_end)[2, 2])  # rad/s²
        self._currents: CurrentTorques | None = None
        errors, measured = settings.forces, sensors
        if sensors.current_noise is not None and sensors.torque_noise is None:
            self._currents = CurrentTorques(grasp.hand)
            of_currents = self._currents.noise(sensors.current_noise)
            errors, measured = of_currents.added_to(errors), replace(sensors, torque_noise=of_currents.noise)
        self._forces = make_force_estimator(grasp, measured, self._gravity_H, errors, disturbance_error)
        self._slip = make_detector(len(grasp.contacts), grasp.body.shape, sensors, period, settings.slip)
        encoder_variance = max(sensors.encoder_variance, _LEAST_ENCODER_NOISE**2)
        self._precaution = make_precaution_test(grasp, encoder_variance, period, settings.slip)
        self._friction = make_friction_estimator(grasp, period, settings.friction, self._forces.measured_variance)
        self._payload = make_payload_estimator(grasp.body, _PAYLOAD_STEPS * period, settings.payload)

    def initial_memory(self) -> GraspMonitorMemory:
        """Return the memory before the first step."""
        return GraspMonitorMemory(ForceMemory(), None, self._friction.initial_memory(), self._payload.initial_memory())

    def step(
        self,
        memory: GraspMonitorMemory,
        measurement: Measurement,
        estimate: GraspEstimate,
        estimator: EstimatorMemory,
        applied: AppliedCommand,
    ) -> tuple[GraspMonitorEstimate, GraspMonitorMemory]:
        """Return the estimate of a period, and the memory for the next one.

        Args:
            memory: memory after the last period; `initial_memory()` before the first.
            measurement: the measurement of the period.
            estimate: the state that `GraspEstimator` estimated from it.
            estimator: memory of that estimator.
            applied: command that acted during the last period.
        """
        contacts = estimator.pose
        tau = self._measured_torque(measurement, estimate.v, applied.tau)
        joints = estimate.q, estimate.v, estimate.disturbance
        forces, force_memory = self._forces.step(
            memory.forces,
            contacts,
            joints,
            tau,
            applied.joint_acceleration,
            measurement.tip_wrench,
            applied.free_torque,
        )
        error, rejected = self._credible(memory.rejected, _pose_error(measurement, estimator), estimate.camera_accepted)
        inputs = SlipInputs(
            measurement.t,
            contacts,
            measurement.q - estimate.q,  # the contacts belong to the estimated positions
            error,
            forces,
            memory.friction.estimate.expected,
        )
        slip, slip_memory = self._slip.step(memory.slip or self._slip.initial_memory(contacts), inputs)
        is_due, precaution = False, memory.precaution
        if measurement.tip_wrench is not None:
            is_due, precaution = self._precaution.step(precaution, slip_memory, contacts, applied.motion)
        friction, friction_memory = self._friction.step(memory.friction, forces, slip)
        payload, recent = memory.payload, (*memory.recent, forces)
        if len(recent) >= _PAYLOAD_STEPS:
            force_sum, motion = np.sum([each.f for each in recent], axis=0), (applied.motion, self._gravity_H)
            payload, recent = self._payload.update(payload, contacts, forces, (force_sum, len(recent)), motion), ()
        return (
            GraspMonitorEstimate(forces, slip, friction, payload.estimate, is_due),
            GraspMonitorMemory(force_memory, slip_memory, friction_memory, payload, recent, rejected, precaution),
        )

    def _measured_torque(self, measurement: Measurement, v: Array, commanded: Array) -> Array:
        """Return the best known joint torques without joint friction, (n,), N·m: measured, of the currents, or commanded."""
        if measurement.tau is not None:
            return measurement.tau
        if self._currents is not None and measurement.current is not None:
            return self._currents.torques(measurement.current, v)
        return commanded

    def _credible(self, last: Array | None, error: Array | None, accepted: bool | None) -> tuple[Array | None, Array | None]:
        """Return the error of a pose that the slip detector may use, and the error that waits for a pose to confirm it.

        A pose that the estimator rejected counts if the pose before was rejected, too, and agrees with it.

        Args:
            last: (6,) error that waits, m and rad; None for none.
            error: (6,) error of the pose of this period, m and rad; None without a pose.
            accepted: whether the estimator accepted the pose.
        """
        if error is None:
            return None, last
        if accepted:
            return error, None
        is_confirmed = last is not None and bool((abs(error - last) <= self._agreement).all())
        return error if is_confirmed else None, error


def _pose_error(measurement: Measurement, estimator: EstimatorMemory) -> Array | None:
    """Return the measured less the estimated pose, (6,) m and rad; None without an image.

    The estimated motion from the image to the measurement is added, so that the error fits to the measured joint positions.
    """
    if measurement.object is None:
        return None
    history, newest = estimator.history, estimator.history.newest
    at_image = newest if measurement.object.t >= newest.t else history.pose_at(measurement.object.t)
    if at_image is None:
        return None
    error = pose_error(measurement.object, at_image.p_HO, at_image.R_HO)
    if measurement.t < newest.t and (then := history.pose_at(measurement.t)) is not None:  # predicted over a latency
        error += pose_difference((then.p_HO, then.R_HO), (newest.p_HO, newest.R_HO))
    return error
