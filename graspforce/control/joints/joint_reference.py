"""Reference motions of joints: functions of time that return positions, rates and accelerations."""

from __future__ import annotations

from collections.abc import Callable

import numpy.typing as npt

from graspforce.control.joints.joint_command import JointMotion
from graspforce.core import arrays
from graspforce.geometry.minimum_jerk import minimum_jerk

JointReference = Callable[[float], JointMotion]  # time since the start, s → desired motion


def minimum_jerk_reference(start: npt.ArrayLike, goal: npt.ArrayLike, rise: float) -> JointReference:
    """Return a reference from one posture to another with least jerk, or a step for a rise time of 0; see `minimum_jerk`.

    Args:
        start: (n,) posture at t = 0, rad.
        goal: (n,) posture from t = T on, rad.
        rise: T, s, ≥ 0.

    Raises:
        InvalidInput: a value is not finite, or lengths differ.
    """
    q0 = arrays.check_array(start, "start", (None,))
    travel = arrays.check_array(goal, "goal", q0.shape) - q0
    T = arrays.check_number(rise, "rise", minimum=0.0)

    def reference(t: float) -> JointMotion:
        if t >= T:
            return JointMotion(q0 + travel)
        s, ds, dds = minimum_jerk(t, T)
        return JointMotion(q0 + s * travel, ds * travel, dds * travel)

    return reference
