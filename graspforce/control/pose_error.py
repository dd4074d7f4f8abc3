"""The error of a pose, and the acceleration that takes it away: PID on SE(3), the rotation's error by its logarithm."""

from __future__ import annotations

import math

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array


def rotation_log(R: Array) -> list[float]:
    """The rotation vector θ a of a rotation, rad, 0 ≤ θ ≤ π: axis a and angle θ with R = exp(θ â).

    By way of the unit quaternion, its largest component first (Shepperd 1978), and θ = 2 atan2(‖vector‖, |scalar|): no digits
    are lost near 0 or near π. At π both ± a are right, and one of them is given.

    Args:
        R: (3, 3).
    """
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = R.tolist()
    squares = (r00 + r11 + r22, r00, r11, r22)  # 4 q² = 1 + the trace, and 1 + 2 rᵢᵢ − the trace
    largest = max(range(4), key=squares.__getitem__)
    if largest == 0:
        w, x, y, z = 1.0 + squares[0], r21 - r12, r02 - r20, r10 - r01
    elif largest == 1:
        w, x, y, z = r21 - r12, 1.0 + r00 - r11 - r22, r01 + r10, r02 + r20
    elif largest == 2:
        w, x, y, z = r02 - r20, r01 + r10, 1.0 - r00 + r11 - r22, r12 + r21
    else:
        w, x, y, z = r10 - r01, r02 + r20, r12 + r21, 1.0 - r00 - r11 + r22
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return [0.0, 0.0, 0.0]
    scale = math.copysign(2.0 * math.atan2(sine, abs(w)) / sine, w)
    return [scale * x, scale * y, scale * z]


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
