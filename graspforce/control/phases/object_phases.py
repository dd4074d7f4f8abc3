"""The phases in which the object controller acts: squeeze, lift, move, place, and the safe stop that holds the object."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.phases.cycle_plan import STOP_DECELERATION, BaseMotion, base_motion, braked_motion
from graspforce.control.phases.finger_servo import FingerServo, ServoMemory, ServoStep
from graspforce.control.phases.load_transfer import accelerated_torque, inertial_wrench, table_wrench
from graspforce.control.phases.motion_profile import MotionProfile
from graspforce.control.phases.phase_rules import LOST_CONTACT, MOVED, NO_FORCES
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_step import FeedbackController, ObjectCommand, PhaseTorques
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import Measurement
from graspforce.geometry.minimum_jerk import minimum_jerk
from graspforce.geometry.rotations import rotation_exp, rotation_log
from graspforce.grasp.grasp import Grasp

_FASTEST_TIP = 0.03  # m/s: speed along its inward normal of a fingertip that does not touch
_SPEED_TIME = 5e-3  # s: lag of the mean speed, which must exceed the limit, too; noise alone lifts single values above it
_RETREAT_RATE = 10.0  # times as fast as they rise, the forces go back while a fingertip runs
_RISE_AT_TOUCH = 5e-4  # m: rise of the object in the hand that shows the table; estimates scatter less
_TOUCH_DISTANCE = 0.015  # m: way of the base before its end on which the object may meet the table
_YIELD_TIME = 0.05  # s: lag with which the target of an object on the table follows its estimated pose


class HeldObject(NamedTuple):
    """Data that the object phases of a cycle share.

    Attributes:
        grasp: the grasp after the touch, with the pose that the object is to keep.
        controller: the object controller of that grasp.
        servo: the servo of the fingers.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        settings: times and tolerances.
        gaps: (N,) distances of the fingertips from the modelled surface at the touch, m; negative in penetration.
    """

    grasp: Grasp
    controller: FeedbackController
    servo: FingerServo
    gravity_H: Array
    settings: PhaseSettings
    gaps: Array

    @property
    def estimate(self) -> Any:
        """Estimate of the object controller; None if it has none."""
        return getattr(self.controller, "estimate", None)

    def step(
        self, measurement: Measurement, table_share: float, base: BaseMotion, desired: BodyMotion | None = None
    ) -> ObjectCommand:
        """Return the command that keeps the object at its pose in H while the table carries a part of its weight.

        The object is to stay where the fingers took it. Its pose from the touch and that of a camera differ by the errors of
        both, and a controller that followed the camera would push the object over the table. So camera poses do not count.

        Args:
            measurement: the newest measurement.
            table_share: part of the weight that the table carries, 0 to 1.
            base: motion of the base.
            desired: desired pose of the object. Default: that of the grasp.
        """
        grasp = self.grasp
        if measurement.object is not None:
            measurement = replace(measurement, object=None)
        external = table_wrench(grasp.body, grasp.R_HO, self.gravity_H, table_share)
        external = external + inertial_wrench(grasp.body, grasp.R_HO, base.a)
        target = BodyMotion(grasp.p_HO, grasp.R_HO) if desired is None else desired
        return self.controller.step(measurement, target, external if external.any() else None)

    def torque(self, command: ObjectCommand, q: Array, base: BaseMotion) -> Array:
        """Return the torques of a command, (n,) N·m, with those that accelerate the links with the base, within the limits.

        Args:
            command: the command of the object controller, which knows gravity only.
            q: (n,) joint positions, rad.
            base: motion of the base.
        """
        return accelerated_torque(self.grasp.hand, np.asarray(command.tau), q, base)


class YieldingTarget:
    """Target pose of an object that the table carries: it follows the estimated pose with a lag.

    The table stops the object wherever the target is. A fixed target would be some tenths of a millimetre inside the table or
    above it, and feedback and integral would press the object against the table.

    Args:
        held: the object; the target begins at the pose of its grasp.

    Attributes:
        pose: the target.
    """

    def __init__(self, held: HeldObject) -> None:
        self._held, self.pose = held, BodyMotion(held.grasp.p_HO, held.grasp.R_HO)
        self._share = 1.0 - math.exp(-held.servo.period / _YIELD_TIME)

    def advance(self) -> BodyMotion:
        """Move the target towards the estimated pose, and return it."""
        estimate = self._held.estimate
        if estimate is not None:
            p, R = self.pose.p_HO, self.pose.R_HO
            turn = np.array(rotation_log(R.T @ estimate.object.R_HO))
            p = p + self._share * (estimate.object.p_HO - p)
            self.pose = BodyMotion(p, R @ rotation_exp(self._share * turn))
        return self.pose

    def held(self) -> HeldObject:
        """Return the object with the target as the pose that it is to keep."""
        grasp = replace(self._held.grasp, p_HO=self.pose.p_HO, R_HO=self.pose.R_HO)
        return self._held._replace(grasp=grasp)


class GraspWatch:
    """Finds when the forces are infeasible, or a fingertip has left the object, for longer than the loss time.

    A fingertip may be off the modelled surface when it touches: the object tilts a little, or differs from its model. So the
    distance counts from that of the touch.

    Args:
        held: the object.
    """

    def __init__(self, held: HeldObject) -> None:
        self._held, self._without_forces, self._apart = held, 0.0, 0.0
        self._largest_gap = held.settings.contact_tolerance + np.maximum(held.gaps, 0.0)  # m

    def abort_reason(self, command: ObjectCommand) -> str:
        """Return the reason to stop the cycle after a step; empty for none.

        Args:
            command: the command of the step.
        """
        period, settings = self._held.servo.period, self._held.settings
        self._without_forces = self._without_forces + period if command.forces_reused else 0.0
        gap = getattr(self._held.estimate, "gap", None)
        is_apart = gap is not None and bool((np.asarray(gap) > self._largest_gap).any())
        self._apart = self._apart + period if is_apart else 0.0
        if self._without_forces > settings.loss_time:
            return NO_FORCES
        return LOST_CONTACT if self._apart > settings.loss_time else ""


class SqueezePhase:
    """The forces rise from the touch to the planned forces of an object on the table, then the weight goes to the fingers.

    The torques are (1 − r) tau_wait + r tau_object with the rise r, so no finger presses more than planned. A finger may not
    touch yet. While it runs towards the object, the rise goes back fast, so that it arrives slowly. Links that touch in place
    of the fingertips push the object away; the phase then ends before the forces are large.

    Args:
        held: the object.
        q_wait: (n,) target posture of the waiting fingers, rad.
        base: where the hand's base stays.

    Attributes:
        target: target pose of the object.
    """

    def __init__(self, held: HeldObject, q_wait: Array, base: BaseMotion) -> None:
        self._held, self._wait, self._base, self._watch = held, JointMotion(q_wait), base, GraspWatch(held)
        self.target = YieldingTarget(held)
        grasp = held.grasp
        self._force = np.full(len(grasp.fingers), held.settings.touch_force)
        self._tips = [grasp.hand.frame_id(name) for name in grasp.fingers]
        self._normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
        self._rise_time = 0.0  # s
        self._mean_speeds = np.zeros(len(grasp.fingers))  # m/s
        self._speed_share = 1.0 - math.exp(-held.servo.period / _SPEED_TIME)

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the start of the phase, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        held, settings = self._held, self._held.settings
        servo = held.servo.step(memory, measurement, self._wait, self._force, predicted=False)
        speeds = self._inward_speeds(servo[0])
        self._mean_speeds = self._mean_speeds + self._speed_share * (speeds - self._mean_speeds)  # m/s
        is_running = np.minimum(speeds, self._mean_speeds).max() > _FASTEST_TIP
        self._rise_time = max(self._rise_time + (-_RETREAT_RATE if is_running else 1.0) * held.servo.period, 0.0)
        share = minimum_jerk(self._rise_time, settings.squeeze_time)[0]
        weight = minimum_jerk(max(self._rise_time - settings.squeeze_time, 0.0), settings.transfer_time)[0]
        command = held.step(measurement, 1.0 - weight, self._base, self.target.advance())
        tau = freeze((1.0 - share) * servo[0].tau + share * command.tau)
        is_over = self._rise_time >= settings.squeeze_time + settings.transfer_time and not command.forces_reused
        abort = self._watch.abort_reason(command) or (MOVED if self._shift() > settings.largest_shift else "")
        return PhaseTorques(tau, servo, self._base, is_over, abort, command, share)

    def _shift(self) -> float:
        """Return how far the object has moved since the touch, as estimated, m."""
        estimate, grasp = self._held.estimate, self._held.grasp
        return 0.0 if estimate is None else float(np.linalg.norm(estimate.object.p_HO - grasp.p_HO))

    def _inward_speeds(self, servo: ServoStep) -> Array:
        """Return the speeds (N,) of the fingertips along their inward normals, m/s."""
        J = self._held.grasp.hand.model.frame_jacobians(servo.q[None], self._tips)[1][0, :, :3]
        return np.asarray(np.einsum("ij,ijk,k->i", self._normals, J, servo.v))


class CarryPhase:
    """The base moves with the held object; the object keeps its pose in H.

    An object that hangs lower than planned, or is turned, meets the table before the base is at its end. It rises in the hand
    then, and its target follows, so that the hand does not press it down.

    Args:
        held: the object.
        start: (3,) displacement of the base at the start, m.
        displacement: (3,) further displacement, m.
        profile: its time profile.
        lowers: whether the table carries the object at the end: after the motion, the weight goes back to it.

    Attributes:
        target: target pose of the object on the table, after the motion.
    """

    def __init__(
        self, held: HeldObject, start: Array, displacement: Array, profile: MotionProfile, lowers: bool = False
    ) -> None:
        self._held, self._start, self._displacement, self._lowers = held, start, displacement, lowers
        self._profile, self._is_on_table = profile, False
        self._down = held.gravity_H / float(np.linalg.norm(held.gravity_H))
        self._lowest = -math.inf  # m: lowest place of the object in the hand so far, along gravity
        self._watch, self.target = GraspWatch(held), YieldingTarget(held)

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the start of the phase, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        held, settings = self._held, self._held.settings
        duration = self._profile.duration
        base = base_motion(self._start, self._displacement, self._profile, t)
        table, end = 0.0, duration + settings.settling_time
        if self._lowers:
            table = minimum_jerk(max(t - end, 0.0), settings.transfer_time)[0]
            end += settings.transfer_time
        servo = held.servo.observe(memory, measurement)
        self._is_on_table = self._is_on_table or (self._lowers and (t >= duration or self._touches_table(t)))
        command = held.step(measurement, table, base, self.target.advance() if self._is_on_table else None)
        tau = held.torque(command, servo[0].q, base)
        return PhaseTorques(tau, servo, base, t >= end, self._watch.abort_reason(command), command, 1.0)

    def _touches_table(self, t: float) -> bool:
        """Return whether the table has pushed the object up in the hand."""
        estimate = self._held.estimate
        if estimate is None:
            return False
        place = float(estimate.object.p_HO @ self._down)  # m
        self._lowest = max(self._lowest, place)
        left = (1.0 - self._profile(t)[0]) * float(np.linalg.norm(self._displacement))  # m
        return left < _TOUCH_DISTANCE and place < self._lowest - _RISE_AT_TOUCH


class HoldObject:
    """The object stays where it is, and the base brakes: a safe stop.

    Args:
        held: the object.
        base: motion of the base when the stop begins.
    """

    def __init__(self, held: HeldObject, base: BaseMotion) -> None:
        self._held, self._base, self._desired = held, base, self._present_pose(held)

    @staticmethod
    def _present_pose(held: HeldObject) -> BodyMotion:
        """Return the pose of the object as estimated; that of the grasp without an estimate."""
        estimate = held.estimate
        if estimate is None:
            return BodyMotion(held.grasp.p_HO, held.grasp.R_HO)
        return BodyMotion(estimate.object.p_HO, estimate.object.R_HO)

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the stop, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        base = braked_motion(self._base, t, STOP_DECELERATION)
        servo = self._held.servo.observe(memory, measurement)
        command = self._held.step(measurement, 0.0, base, self._desired)
        tau = self._held.torque(command, servo[0].q, base)
        return PhaseTorques(tau, servo, base, command=command, share=1.0)
