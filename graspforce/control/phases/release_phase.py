"""The release: the forces ramp down to the touch force, then the fingers open to the pre-grasp posture."""

from __future__ import annotations

import numpy as np

from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.cycle_plan import BaseMotion
from graspforce.control.phases.finger_servo import ServoMemory
from graspforce.control.phases.object_phases import HeldObject, YieldingTarget
from graspforce.control.phases.phase_step import PhaseTorques
from graspforce.control.phases.phase_times import release_time
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import Measurement
from graspforce.geometry.minimum_jerk import minimum_jerk

_OPEN_FORCE = 5.0  # N: bound of the feedback of fingers that open


class ReleasePhase:
    """The release of an object on the table.

    In the pre-grasp posture no link touches the object. Fingers that followed the normals of their contacts instead could bend
    in other ways than planned, and a link could push the object.

    Args:
        held: the object.
        q: (n,) joint positions at the start, rad.
        base: where the hand's base stays.
        q_open: (n,) the pre-grasp posture, rad.
    """

    def __init__(self, held: HeldObject, q: Array, base: BaseMotion, q_open: Array) -> None:
        self._held, self._base, self._wait = held, base, JointMotion(q)
        self._opening = JointTrajectory.between(q, q_open, release_time(held.grasp, q, q_open, held.settings))
        self._target = YieldingTarget(held)

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the start of the phase, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        held, settings = self._held, self._held.settings
        count = len(held.grasp.fingers)
        if t < settings.squeeze_time:  # the forces ramp down
            share = 1.0 - minimum_jerk(t, settings.squeeze_time)[0]
            servo = held.servo.step(memory, measurement, self._wait, np.full(count, settings.touch_force), predicted=False)
            command = held.step(measurement, 1.0, self._base, self._target.advance())
            tau = freeze(share * command.tau + (1.0 - share) * servo[0].tau)
            return PhaseTorques(tau, servo, self._base, command=command, share=share)
        elapsed = t - settings.squeeze_time  # s
        servo = held.servo.step(memory, measurement, self._opening(elapsed), np.full(count, _OPEN_FORCE))
        return PhaseTorques(servo[0].tau, servo, self._base, elapsed >= self._opening.duration)
