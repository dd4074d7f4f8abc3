"""Monitor of a grasp: contact forces, slip, friction and payload in one step, from the estimated state and the last command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.contact_forces import ContactForceEstimator, ContactForces, ForceMemory, contact_wrench
from graspforce.estimation.contact_friction import FrictionEstimate, FrictionEstimator, FrictionMemory
from graspforce.estimation.contact_pose import ContactPose
from graspforce.estimation.estimate import EstimatorMemory, GraspEstimate
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.payload import PayloadEstimate, PayloadEstimator, PayloadInputs, PayloadMemory
from graspforce.estimation.sensor_model import SensorModel
from graspforce.estimation.slip import SlipDetector, SlipEstimate, SlipInputs, SlipMemory, pose_error
from graspforce.grasp.grasp import Grasp


class AppliedCommand(NamedTuple):
    """Command that acted during the last period.

    Attributes:
        tau: (n,) joint torques without those that overcome joint friction, N·m.
        joint_acceleration: (n,) commanded joint accelerations, rad/s².
        motion: desired motion of the object in H.
    """

    tau: Array
    joint_acceleration: Array
    motion: BodyMotion


class GraspMonitorMemory(NamedTuple):
    """State of the monitor after a period: that of each of its estimators; slip begins with the first period."""

    forces: ForceMemory
    slip: SlipMemory | None
    friction: FrictionMemory
    payload: PayloadMemory


@dataclass(frozen=True, eq=False, slots=True)
class GraspMonitorEstimate:
    """What the monitor estimates in one period.

    Attributes:
        forces: contact forces.
        slip: slip by finger.
        friction: friction coefficients by finger, with bounds.
        payload: mass, centre of mass and external wrench of the object.
    """

    forces: ContactForces
    slip: SlipEstimate
    friction: FrictionEstimate
    payload: PayloadEstimate

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
        sensors: noise of the sensors. Contact forces come from joint torques, measured or commanded, and fingertip sensors.
        period: time between two steps, s.
        gravity_H: (3,) acceleration of gravity in H, m/s².
    """

    def __init__(self, grasp: Grasp, sensors: SensorModel, period: float, gravity_H: npt.ArrayLike) -> None:
        self._gravity_H = arrays.check_array(gravity_H, "gravity_H", (3,))
        self._forces = ContactForceEstimator(grasp, sensors, self._gravity_H)
        self._slip = SlipDetector(len(grasp.contacts), sensors, period)
        self._friction = FrictionEstimator(grasp.contacts.mu, period)
        self._payload = PayloadEstimator(grasp.body, period)

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
        tau = applied.tau if measurement.tau is None else measurement.tau
        joints = np.array([estimate.q, estimate.v, estimate.disturbance])
        forces, force_memory = self._forces.step(
            memory.forces, contacts, joints, tau, applied.joint_acceleration, measurement.tip_wrench
        )
        inputs = SlipInputs(
            measurement.t, contacts, measurement.q - estimate.q, _pose_error(measurement, estimator), forces,
            memory.friction.estimate.expected,
        )  # fmt: skip
        slip, slip_memory = self._slip.step(memory.slip or self._slip.initial_memory(contacts), inputs)
        friction, friction_memory = self._friction.step(memory.friction, forces, slip)
        payload_inputs = self._payload_inputs(contacts, forces, applied.motion)
        payload, payload_memory = self._payload.step(memory.payload, payload_inputs)
        return (
            GraspMonitorEstimate(forces, slip, friction, payload),
            GraspMonitorMemory(force_memory, slip_memory, friction_memory, payload_memory),
        )

    def _payload_inputs(self, contacts: ContactPose, forces: ContactForces, motion: BodyMotion) -> PayloadInputs:
        """Return the wrench of the contacts with its covariances, and the desired rates of the object in O."""
        w, noise, bias = contact_wrench(contacts, forces)
        rates = np.array([motion.acceleration[:3] - self._gravity_H, motion.acceleration[3:], motion.twist[3:]])
        return PayloadInputs(w, noise, bias, rates @ contacts.R_HO)


def _pose_error(measurement: Measurement, estimator: EstimatorMemory) -> Array | None:
    """Return the measured less the estimated pose at the time of the image, (6,) m and rad; None without an image."""
    if measurement.object is None:
        return None
    at_image = estimator.history.pose_at(min(measurement.object.t, estimator.history.newest.t))
    return None if at_image is None else pose_error(measurement.object, at_image.p_HO, at_image.R_HO)
