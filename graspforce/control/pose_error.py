"""Pose error on SE(3) and the limit on its integral.

The rotation error is the rotation vector log(R_d Rᵀ), so the error is the constant twist that leads to the desired pose in one
second.
"""

from __future__ import annotations

import math

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.geometry.rotations import rotation_log


def pose_error(desired: BodyMotion, measured: BodyMotion) -> Array:
    """Return the pose error of an object in H, (6,): p_d − p, m, and log(R_d Rᵀ), rad.

    Args:
        desired: desired pose; its rates are not used.
        measured: measured pose; its rates are not used.
    """
    return np.array([*(desired.p_HO - measured.p_HO).tolist(), *rotation_log(desired.R_HO @ measured.R_HO.T)])


def limit_integral(integral: Array, gain: Array, limits: tuple[float, float]) -> Array:
    """Return the integral, shortened so that its accelerations stay within their limits: gain·‖part‖ ≤ limit.

    The linear and the angular part keep their directions.

    Args:
        integral: (6,) integral of the pose error, m·s and rad·s.
        gain: (6,) integral gains, 1/s³, equal within each part.
        limits: largest linear and angular acceleration, m/s² and rad/s².
    """
    result = integral
    for part, limit in ((slice(0, 3), limits[0]), (slice(3, 6), limits[1])):
        acceleration = float(gain[part][0]) * math.hypot(*integral[part].tolist())
        if acceleration > limit:
            result = result.copy() if result is integral else result
            result[part] *= limit / acceleration
    return result
