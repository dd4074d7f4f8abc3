"""Measured forces of the fingertips on the object: the last message of each finger, until it is too old. Frame: H hand base."""

from __future__ import annotations

from typing import Any

import numpy as np

from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp
from graspforce.service.ros2.messages import WrenchSample, read_wrench

_LONGEST_AGE = 0.05  # s, on the clock of the joint states


class FingertipWrenches:
    """The last measured wrench of each finger of a grasp. `receive` may be called by any thread, `at` by one.

    Attributes:
        received: number of messages.

    Args:
        grasp: the grasp.
    """

    def __init__(self, grasp: Grasp) -> None:
        self._hand, self._fingers, self.received = grasp.hand, grasp.fingers, 0
        self._tips = {name: grasp.hand.finger(name).tip for name in grasp.fingers}
        self._new: dict[str, WrenchSample] = {}
        self._last: dict[str, tuple[float, WrenchSample]] = {}

    def receive(self, finger: str, message: Any, base_frame: str) -> None:
        """Keep a message for the next joint state.

        Args:
            finger: name of the finger.
            message: a message `graspforce.service.ros2.messages.WRENCH`.
            base_frame: name of the hand's base; empty for the name of its first link.

        Raises:
            InvalidInput: the message has another frame, or a number is not finite.
        """
        self._new[finger] = read_wrench(message, {"", base_frame or self._hand.urdf.root}, self._tips[finger])
        self.received += 1

    def at(self, t: float, q: Array) -> Array | None:
        """Return the wrenches (N, 6) in H, N and N·m; None unless each finger has one that is at most 50 ms old.

        Args:
            t: time of the joint state, s.
            q: (n,) measured posture, rad.
        """
        for finger in self._fingers:
            if (sample := self._new.pop(finger, None)) is not None:
                self._last[finger] = t, sample
        rows = np.zeros((len(self._fingers), 6))
        for i, finger in enumerate(self._fingers):
            arrival, sample = self._last.get(finger, (-np.inf, None))
            if sample is None or t - arrival > _LONGEST_AGE:
                return None
            R = self._hand.tip_pose(q, finger)[1] if sample.is_in_tip else np.eye(3)
            rows[i] = np.concatenate([R @ sample.force, R @ sample.moment])
        return rows
