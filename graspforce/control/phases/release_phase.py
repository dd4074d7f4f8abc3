"""The release: the forces ramp down to the touch force, then the fingers open along the normals of their contacts."""

from __future__ import annotations

import numpy as np

from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.phases.cycle_plan import BaseMotion
from graspforce.control.phases.finger_servo import ServoMemory
from graspforce.control.phases.object_phases import HeldObject, YieldingTarget
from graspforce.control.phases.phase_step import PhaseTorques
from graspforce.control.phases.tip_motion import TipMotion
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import Measurement
from graspforce.geometry.minimum_jerk import minimum_jerk

_OPEN_FORCE = 5.0  # N: bound of the feedback of fingers that open
_RISE_TIME = 0.1  # s, of the opening speed


class ReleasePhase:
    """The release of an object on the table.

    Args:
        held: the object.
        q: (n,) joint positions at the start, rad.
        base: where the hand's base stays.
        distance: (N,) distance by which each finger opens, m.
    """

    def __init__(self, held: HeldObject, q: Array, base: BaseMotion, distance: Array) -> None:
        self._held, self._base, self._q, self._distance = held, base, q, distance
        grasp = held.grasp
        self._outward = -(grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T)
        self._motion = TipMotion(grasp.hand, grasp.fingers)
        self._travel = np.zeros(len(grasp.fingers))  # m
        self._target = YieldingTarget(held)

    def step(self, t: float, measurement: Measurement, memory: ServoMemory) -> PhaseTorques:
        """Return the torques of a period; see `JointPhase.step`.

        Args:
            t: time since the start of the phase, s.
            measurement: the newest measurement.
            memory: memory of the servo.
        """
        held, settings = self._held, self._held.settings
        count = len(self._travel)
        if t < settings.squeeze_time:  # the forces ramp down
            share = 1.0 - minimum_jerk(t, settings.squeeze_time)[0]
            force = np.full(count, settings.touch_force)
            servo = held.servo.step(memory, measurement, JointMotion(self._q), force, predicted=False)
            command = held.step(measurement, 1.0, self._base, self._target.advance())
            tau = freeze(share * command.tau + (1.0 - share) * servo[0].tau)
            return PhaseTorques(tau, servo, self._base, command=command, share=share)
        speed = settings.open_speed * min(1.0, (t - settings.squeeze_time) / _RISE_TIME)
        is_moving = self._travel < self._distance
        dt = held.servo.period
        self._q, rates = self._motion.advance(self._q, (speed * is_moving)[:, None] * self._outward, dt)
        self._travel += speed * dt * is_moving
        servo = held.servo.step(memory, measurement, JointMotion(self._q, rates), np.full(count, _OPEN_FORCE))
        return PhaseTorques(servo[0].tau, servo, self._base, not is_moving.any())
