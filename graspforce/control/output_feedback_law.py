"""Law of the control of a grasped object from measurements: a state estimator and the object control law.

Each period, the estimator gives joint positions, joint rates and the object's pose from what the hand measures
(`graspforce.estimation`). The control law of `ObjectController` acts on this estimate as if it were the state. Torques, forces
and accelerations of the command are those of the law; its accelerations are inputs of the estimator in the next period.

A monitor may run beside the estimator. It estimates contact forces, slip, friction and payload. Fingers that it finds slipping
press harder from the same period on (`slip_reflex`). With fingertip forces, all fingers press a little harder for a short time
as soon as forces or motion surely differ from the commanded ones (precaution). Those whose slip is evident from the motion do
not determine the motion of the object along their surface.
A finger that has slipped is planned with the friction that this shows, if it is less than that of the contact.

When contacts let go or join, estimator and monitor continue with the contacts that are left, from the estimated pose. A finger
that joins determines the object's motion once its force is no longer limited.
"""

from __future__ import annotations

import copy
import math
import operator
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.control.command import Command, free_torque
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.memory import ControlMemory
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState, object_motion
from graspforce.core.arrays import Array
from graspforce.core.records import make_unchecked, unchecked_constructor
from graspforce.estimation.estimate import EstimatorMemory, GraspEstimate
from graspforce.estimation.grasp_estimator import GraspEstimator
from graspforce.estimation.grasp_monitor import AppliedCommand, GraspMonitor, GraspMonitorEstimate, GraspMonitorMemory
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.pose.pose_fusion import PoseOffset
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp

_AS_MODELLED = ContactConditions()
_make_state = unchecked_constructor(GraspState)
_CERTAIN = 3.0  # standard deviations from which a normal force is not zero
_CREEP_DEVIATIONS = 4.0  # of a fingertip's position, from which motion along the surface is not noise
# rad. A filter for better encoders follows a joint that breaks loose from friction within a period; the loop that compensates
# its disturbance is then unstable.
_LEAST_ENCODER_NOISE = 3e-5


class OutputFeedbackMemory(NamedTuple):
    """Memory of the controller between two steps.

    Attributes:
        control: memory of the control law.
        estimator: memory of the estimator; None before the first measurement.
        joint_acceleration: (n,) joint accelerations of the last command, rad/s²; None before the first.
        offset: offset with which the estimator starts; none by default.
        monitor: memory of the monitor; None before the first step, or without a monitor.
        applied: last command, as the monitor needs it; None before the first.
        slipping: (N,) fingers that slip evidently; None before the first step, or without a monitor.
    """

    control: ControlMemory
    estimator: EstimatorMemory | None
    joint_acceleration: Array | None
    offset: PoseOffset | None = None
    monitor: GraspMonitorMemory | None = None
    applied: AppliedCommand | None = None
    slipping: npt.NDArray[np.bool_] | None = None


class OutputFeedbackStep(NamedTuple):
    """Result of a step.

    Attributes:
        command: command for the next period.
        estimate: estimated state.
        monitor: estimated forces, slip, friction and payload; None in the first step, and without a monitor.
        memory: memory for the next step.
    """

    command: Command
    estimate: GraspEstimate
    monitor: GraspMonitorEstimate | None
    memory: OutputFeedbackMemory


class OutputFeedbackLaw:
    """Estimator and control law of one grasp, without memory of their own.

    Args:
        grasp: hand, object and contacts.
        settings: settings of the controller. Default: `ControlSettings.for_sensors` of the sensors and the hand's drives.
        sensors: noise, rate and latency of the sensors. Encoders count with at least 0.03 mrad of noise, because the filter's
            disturbances are compensated. Default: nearly perfect encoders, no camera. The delay of the drives is added to
            the latency.
        monitored: whether a monitor estimates contact forces, slip, friction and payload. Default: if the sensors measure
            joint torques or fingertip forces.
        law_type: type of the control law.
    """

    def __init__(
        self,
        grasp: Grasp,
        settings: ControlSettings | None = None,
        sensors: SensorModel | None = None,
        monitored: bool | None = None,
        law_type: type[ObjectControlLaw] = ObjectControlLaw,
    ) -> None:
        measured = _with_least_noise(SensorModel() if sensors is None else sensors)
        self.sensors = measured.with_delay(grasp.hand.drives.delay)
        if settings is None:
            base = ControlSettings(period=1.0 / measured.rate)
            settings = ControlSettings.for_sensors(measured, base, drives=grasp.hand.drives).settings
        self.settings = _with_creep_above_noise(settings, grasp, self.sensors)
        self.law = law_type(grasp, self.settings)
        self.estimator = GraspEstimator(grasp, self.sensors, self.settings.period)
        self.monitor: GraspMonitor | None = None
        self._set_grasp(grasp, self.sensors.has_force_sensors if monitored is None else monitored)

    def _set_grasp(self, grasp: Grasp, monitored: bool) -> None:
        """Set what depends on the contacts."""
        self._grasp, self._mu = grasp, grasp.contacts.mu * (1.0 - self.settings.friction_error)
        count = len(grasp.contacts)
        self._calm = ContactConditions(np.zeros(count, bool), None, (), np.ones(count, bool))  # nothing slips, all touch
        if monitored:
            self.monitor = GraspMonitor(grasp, self.sensors, self.settings.period, self.settings.gravity_H)

    def with_contacts(self, law: ObjectControlLaw) -> OutputFeedbackLaw:
        """Return the estimator and another control law of the same hand and object, with its contacts.

        Args:
            law: the control law; its grasp has the present pose of the object.
        """
        changed = copy.copy(self)
        changed.law, changed.estimator = law, self.estimator.with_grasp(law.grasp)
        changed._set_grasp(law.grasp, self.monitor is not None)
        return changed

    def continued_memory(
        self, memory: OutputFeedbackMemory, control: ControlMemory, fingers: Sequence[str], q: Array
    ) -> OutputFeedbackMemory:
        """Return the memory of this law after the last step of a law with other contacts.

        The monitor starts anew: it has one state for all contacts.

        Args:
            memory: memory after that step.
            control: memory of this control law.
            fingers: fingers of the other contacts.
            q: (n,) estimated joint positions in that step, rad.
        """
        estimator = None if memory.estimator is None else self.estimator.continued_memory(memory.estimator, q)
        slipping = memory.slipping
        if slipping is not None:
            before = dict(zip(fingers, slipping.tolist(), strict=True))
            slipping = np.array([before.get(name, False) for name in self._grasp.fingers])
        return memory._replace(control=control, estimator=estimator, monitor=None, slipping=slipping)

    def initial_memory(self, control: ControlMemory | None = None, offset: PoseOffset | None = None) -> OutputFeedbackMemory:
        """Return the memory before the first step.

        Args:
            control: memory of the control law to continue from. Default: that before the first step.
            offset: offset of the object from its pose in the grasp, from an earlier estimate; none by default.
        """
        return OutputFeedbackMemory(control or self.law.initial_memory(), None, None, offset)

    def step(
        self,
        memory: OutputFeedbackMemory,
        measurement: Measurement,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        conditions: ContactConditions | None = None,
    ) -> OutputFeedbackStep:
        """Compute the estimate, the command for the next period, and the memory for the next step.

        Args:
            memory: memory after the last step; `initial_memory()` before the first.
            measurement: as in `OutputFeedbackController.step`.
            desired: as in `OutputFeedbackController.step`.
            external: as in `OutputFeedbackController.step`.
            conditions: slip, friction and lost drives of the contacts, if they are known. Default: slip and friction as the
                monitor finds them. The fingertips of lost fingers do not determine the object's pose.

        Raises:
            InvalidInput: as in `OutputFeedbackController.step`.
            UnknownName: as in `OutputFeedbackController.step`.
        """
        touching = None
        if conditions is not None:
            conditions.check(self._grasp)
            if conditions.lost:
                touching = np.array([finger not in conditions.lost for finger in self._grasp.fingers])
        ramp = memory.control.ramp
        if ramp is not None and (is_joining := np.isfinite(ramp.limit) & ~ramp.releasing).any():
            touching = ~is_joining if touching is None else touching & ~is_joining
        before = memory.estimator or self.estimator.initial_memory(measurement, offset=memory.offset)
        slipping = memory.slipping if memory.slipping is not None and True in memory.slipping.tolist() else None
        inputs = before, measurement, memory.joint_acceleration
        estimate, after = self.estimator.step(*inputs, slipping=slipping, touching=touching)
        monitored, monitor = None, memory.monitor
        if self.monitor is not None and memory.applied is not None:
            past = memory.monitor or self.monitor.initial_memory()
            monitored, monitor = self.monitor.step(past, measurement, estimate, after, memory.applied)
            slipping = monitored.slip.evident
            conditions = self._monitored_conditions(_AS_MODELLED if conditions is None else conditions, monitored, estimate.gap)
        state = _make_state(estimate.q, estimate.v, estimate.object)
        target = _in_contact_frame(estimate, desired, estimate.t - measurement.t)
        command, control = self.law.step(memory.control, state, target, external, conditions)
        applied = AppliedCommand(command.tau, command.joint_acceleration, object_motion(target), free_torque(command))
        next_memory = OutputFeedbackMemory(
            control, after, command.joint_acceleration, memory.offset, monitor, applied, slipping
        )
        return OutputFeedbackStep(command, estimate, monitored, next_memory)

    def _monitored_conditions(self, known: ContactConditions, monitored: GraspMonitorEstimate, gap: Array) -> ContactConditions:
        """Return the conditions of the contacts with what the monitor finds.

        A contact touches if its gap is within the tolerance, or if its normal force is certain. Warnings of slip and of lost
        contacts then do not follow from the noise of the encoders.
        """
        is_touching = max(gap.tolist()) <= self.settings.contact_tolerance
        is_bounded = any(map(operator.lt, monitored.friction.upper.tolist(), self._mu.tolist()))
        due, is_slipping = monitored.is_precaution_due, True in monitored.slip.slipping.tolist()
        if known is _AS_MODELLED and is_touching and not (is_bounded or is_slipping or due):
            return self._calm
        friction = np.minimum(self._mu, monitored.friction.upper)
        touching = gap <= self.settings.contact_tolerance
        if not touching.all():
            deviation = np.sqrt(np.diag(monitored.forces.covariance)[2::3])  # N
            touching = touching | (monitored.forces.f[:, 2] > _CERTAIN * deviation)
        return known.completed(monitored.slip.slipping, friction if (friction < self._mu).any() else None, touching, due)


def _with_least_noise(sensors: SensorModel) -> SensorModel:
    """Return the sensors with the least noise of encoders for which the filter's disturbances can be compensated."""
    noise = math.sqrt(max(_LEAST_ENCODER_NOISE**2 - sensors.encoder_resolution**2 / 12.0, 0.0))  # rad
    return replace(sensors, encoder_noise=max(sensors.encoder_noise, noise))


def _with_creep_above_noise(settings: ControlSettings, grasp: Grasp, sensors: SensorModel) -> ControlSettings:
    """Return settings whose limit of sliding exceeds the error of the fingertips' first positions.

    The estimates begin with the first measurement, and its error counts as sliding until it is forgotten.
    """
    tips = [grasp.hand.frame_id(name) for name in grasp.fingers]
    J = grasp.hand.model.frame_jacobians(grasp.q[None], tips)[1][0, :, :3]
    deviation = math.sqrt(sensors.encoder_variance * float(np.square(J).sum(axis=(1, 2)).max()))  # m
    limit = max(settings.creep_limit, _CREEP_DEVIATIONS * deviation)
    return settings if limit == settings.creep_limit else replace(settings, creep_limit=limit)


def _in_contact_frame(estimate: GraspEstimate, desired: DesiredMotion, latency: float) -> DesiredMotion:
    """Return the desired motion when the torque acts, for the pose from the contacts, which the law controls.

    Args:
        estimate: the estimate, for the time when the torque acts.
        desired: desired motion at the time of the measurement.
        latency: time from the measurement until the torque acts, s.
    """
    latency = max(latency, 0.0)
    if not isinstance(desired, GraspMotion):
        return estimate.to_contact_frame(desired, latency)
    q = desired.q + latency * desired.v + 0.5 * latency**2 * desired.a
    v = desired.v + latency * desired.a
    return make_unchecked(GraspMotion, object=estimate.to_contact_frame(desired.object, latency), q=q, v=v, a=desired.a)
