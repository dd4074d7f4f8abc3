"""Plausibility of the desired motions of a stream: where the fingertips reach, at rates that a hand can have.

A state with another desired motion is refused with the code ``implausible``, as an implausible state: one such motion would
bring the joints to their limits, and estimates that follow the error would keep its effect.

| quantity                                   | range                                                            |
|--------------------------------------------|------------------------------------------------------------------|
| desired position of the object             | reach of the fingertips + size of the object + 5 cm              |
| desired twist of the object                | 5 m/s and 50 rad/s in each direction                             |
| desired joint positions                    | the joint limits ± a tenth of their range                        |
"""

from __future__ import annotations

import math

import numpy as np

from graspforce.control import DesiredMotion
from graspforce.control.state import GraspMotion, object_motion
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.grasp.grasp import Grasp
from graspforce.service.server.plausibility import OBJECT_RATE, OBJECT_SPEED, Implausible, middle_and_half, object_reach

_JOINT_MARGIN = 0.1  # of the range of a joint


class DesiredGuard:
    """Checks of the desired motions of one stream.

    Attributes:
        position: range of the desired position of the object.
        twist: range of its desired twist.
        posture: range of the desired joint positions.

    Args:
        grasp: hand, object and contacts.
    """

    def __init__(self, grasp: Grasp) -> None:
        hand, reach = grasp.hand, np.full(3, object_reach(grasp))  # m
        speed = np.repeat([OBJECT_SPEED, OBJECT_RATE], 3)
        margin = np.where(np.isfinite(hand.q_upper - hand.q_lower), _JOINT_MARGIN * (hand.q_upper - hand.q_lower), 0.0)
        self.position = _Range("desired.position", -reach, reach, "m")
        self.twist = _Range("desired.twist", -speed, speed, "m/s or rad/s")
        self.posture = _Range("desired.joints.posture", hand.q_lower - margin, hand.q_upper + margin, "rad or m")

    def check(self, desired: DesiredMotion) -> None:
        """Check a desired motion.

        Args:
            desired: the motion.

        Raises:
            Implausible: it is out of range; names the field.
        """
        body, position, twist = object_motion(desired), self.position, self.twist
        if not position.contains(body.p_HO):
            position.refuse(body.p_HO)
        if not twist.contains(body.twist):
            twist.refuse(body.twist)
        if isinstance(desired, GraspMotion) and not self.posture.contains(desired.q):
            self.posture.refuse(desired.q)


class _Range:
    """The range of an array of numbers.

    Attributes:
        rules: (4, m) rules as those of `StateGuard`, without bounds of changes.
    """

    def __init__(self, field: str, lower: Array, upper: Array, unit: str) -> None:
        self._field, self._lower, self._upper, self._unit = field, lower, upper, unit
        free = np.full(len(lower), math.inf)  # changes
        self.rules = np.array([*middle_and_half(lower, upper), free, free])

    def contains(self, x: Array) -> bool:
        """Return whether all numbers are in the range, or their count is wrong: then the control law names the array."""
        if len(x) != len(self._lower):
            return True
        if native is not None:
            return bool(native.is_plausible_state(x, None, 0.0, self.rules))
        return not (np.abs(x - self.rules[0]) > self.rules[1]).any()

    def refuse(self, x: Array) -> None:
        """Raise Implausible for the first number out of range."""
        for i, value in enumerate(x.tolist()):
            if abs(value - self.rules[0, i]) > self.rules[1, i]:
                allowed = f"plausible: from {self._lower[i]:.6g} to {self._upper[i]:.6g} {self._unit}"
                raise Implausible(f"{self._field}[{i}]", value, allowed)
