"""The phases in which the fingers move alone: approach, retract, reopen, and the safe stop that keeps the posture."""

from __future__ import annotations

import numpy as np

from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.cycle_plan import STOP_DECELERATION, BaseMotion, base_motion, braked_motion, move_time
from graspforce.control.phases.finger_servo import FingerServo, ServoMemory
from graspforce.control.phases.load_transfer import accelerated_torque
from graspforce.control.phases.motion_profile import MotionProfile
from graspforce.control.phases.phase_rules import NOT_REACHED
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_step import PhaseTorques
from graspforce.core.arrays import Array
from graspforce.estimation.measurement import Measurement
from graspforce.hand.hand import Hand

_PATIENCE = 2.0  # s after the end of the motion in which the joints may still arrive
_LATE_TOLERANCE = 3.0  # times the tolerances: largest error after this time; static friction may have stopped the joints


class JointPhase:
    """The fingers follow a joint motion until they rest at its end.

    Static friction may stop joints before it. Two seconds after the end of the motion, three times the tolerances are
    enough: the next phases need room between fingertips and object, and no exact posture.

    Args:
        servo: the servo.
        motion: the motion.
        settings: tolerance and settling time.
        base: where the hand's base stays.
        largest_force: (N,) bound of the feedback of each finger at its tip, N.
        learns: whether the levels of joint friction are learned: no finger touches at the start.
    """

    def __init__(
        self,
        servo: FingerServo,
        motion: JointTrajectory,
        settings: PhaseSettings,
        base: BaseMotion,
        largest_force: Array,
        learns: bool,
    ) -> None:
        self._servo, self._motion, self._settings = servo, motion, settings
        self._base, self._force, self._learns = base, largest_force, learns
        self._tolerances = settings.posture_tolerances(servo.hand)  # rad or m
        self._settled = 0.0  # s

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period.

        Args:
            t: time since the start of the phase, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        desired, end = self._motion(t), self._motion.duration
        servo = self._servo.step(memory, measurement, desired, self._force, is_free=True, learns=self._learns)
        error = float((np.abs(desired.q - servo[0].q) / self._tolerances).max())
        is_near = t >= end and error <= 1.0
        self._settled = self._settled + self._servo.period if is_near else 0.0
        is_late = t > end + _PATIENCE and not is_near
        is_over = self._settled >= self._settings.settling_time or (is_late and error <= _LATE_TOLERANCE)
        return PhaseTorques(servo[0].tau, servo, self._base, is_over, NOT_REACHED if is_late and not is_over else "")


class ReopenPhase:
    """The fingers open, then the hand's base moves over the object.

    Args:
        hand: the hand.
        opening: the phase in which the fingers open.
        displacement: (3,) of the base, m.
    """

    def __init__(self, hand: Hand, opening: JointPhase, displacement: Array) -> None:
        self._hand, self._opening, self._displacement = hand, opening, displacement
        self._profile = MotionProfile.least_jerk(move_time(displacement))
        self._opened: float | None = None  # s

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the start of the phase, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        result = self._opening.step(t, measurement, memory)
        if self._opened is None:
            self._opened = t if result.is_over else None
            return result._replace(is_over=False)
        base = base_motion(result.base.p, self._displacement, self._profile, t - self._opened)
        tau = accelerated_torque(self._hand, result.tau, result.servo[0].q, base)
        return result._replace(tau=tau, base=base, is_over=t - self._opened >= self._profile.duration)


class HoldJoints:
    """The joints keep a posture with bounded tip forces, and the base brakes: a safe stop.

    Args:
        servo: the servo.
        q: (n,) the posture, rad.
        base: motion of the base when the stop begins.
        largest_force: (N,) bound of the feedback of each finger at its tip, N.
    """

    def __init__(self, servo: FingerServo, q: Array, base: BaseMotion, largest_force: Array) -> None:
        self._servo, self._desired, self._base, self._force = servo, JointMotion(q), base, largest_force

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the stop, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        base = braked_motion(self._base, t, STOP_DECELERATION)
        servo = self._servo.step(memory, measurement, self._desired, self._force)
        return PhaseTorques(accelerated_torque(self._servo.hand, servo[0].tau, servo[0].q, base), servo, base)
