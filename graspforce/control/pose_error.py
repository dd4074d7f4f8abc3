"""The error of a pose, and the acceleration that takes it away: PID on SE(3), the rotation's error by its logarithm."""

from __future__ import annotations

import math

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.geometry.rotations import rotation_log


def pose_error(desired: BodyMotion, now: BodyMotion) -> Array:
    """(6,) from where an object is to where it should be, in H: p_d − p, m, and log(R_d Rᵀ), rad."""
    return np.array([*(desired.p_HO - now.p_HO).tolist(), *rotation_log(desired.R_HO @ now.R_HO.T)])


def limit_integral(integral: Array, gain: Array, limits: tuple[float, float]) -> Array:
    """The integral, its linear and angular parts shortened so that gain·‖part‖ stays within the limits, m/s² and rad/s²."""
    result = integral
    for part, limit in ((slice(0, 3), limits[0]), (slice(3, 6), limits[1])):
        asked = float(gain[part][0]) * math.hypot(*integral[part].tolist())
        if asked > limit:
            result = result.copy() if result is integral else result
            result[part] *= limit / asked
    return result
