"""Reference motions: functions of time that return the desired pose of the object, with its twist and acceleration.

Each motion starts at rest at a given pose. Twist and acceleration are the time derivatives of the pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.control.state import DesiredMotion, object_motion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import unchecked_constructor
from graspforce.geometry.minimum_jerk import minimum_jerk

Reference = Callable[[float], DesiredMotion]  # of the time, s

_make_motion = unchecked_constructor(BodyMotion)  # the start and the amplitudes are checked
_ZERO = np.zeros(3)  # a velocity or an acceleration


def constant_reference(start: BodyMotion) -> Reference:
    """Return a motion that stays at a pose.

    Args:
        start: the pose.
    """
    rest = BodyMotion(start.p_HO, start.R_HO)
    return lambda t: rest


def linear_reference(start: BodyMotion, travel: npt.ArrayLike, period: float) -> Reference:
    """Return a periodic motion out and back along a line: p = p₀ + d (1 − cos ωt)/2 with ω = 2π/T (Al-Gallaf, section V).

    Args:
        start: pose at t = 0.
        travel: (3,) displacement d between the ends, in H, m.
        period: T, s.
    """
    d, omega = arrays.check_array(travel, "travel", (3,)), 2.0 * math.pi / arrays.check_number(period, "period", above=0.0)

    def at(t: float) -> BodyMotion:
        x, v, a = _raised_cosine(omega, t)
        return _make_motion(start.p_HO + x * d, start.R_HO, np.append(v * d, _ZERO), np.append(a * d, _ZERO))

    return at


def rotation_reference(start: BodyMotion, axis: npt.ArrayLike, angle: float, period: float) -> Reference:
    """Return a periodic rotation out and back about O's origin, by the angle θ (1 − cos ωt)/2 with ω = 2π/T.

    Args:
        start: pose at t = 0.
        axis: (3,) axis of rotation in H, of any length but zero.
        angle: θ, rad.
        period: T, s.

    Raises:
        InvalidInput: the axis is zero.
    """
    u = arrays.check_array(axis, "axis", (3,))
    if not u.any():
        raise InvalidInput("axis", axis, "a vector that is not zero")
    u = u / np.linalg.norm(u)
    theta, omega = arrays.check_number(angle, "angle"), 2.0 * math.pi / arrays.check_number(period, "period", above=0.0)

    def at(t: float) -> BodyMotion:
        x, v, a = (theta * value for value in _raised_cosine(omega, t))  # rad, rad/s, rad/s²
        return _make_motion(start.p_HO, _rotation(u, x) @ start.R_HO, np.append(_ZERO, v * u), np.append(_ZERO, a * u))

    return at


def sine_reference(start: BodyMotion, amplitude: npt.ArrayLike, period: float) -> Reference:
    """Return an oscillation about a pose: p = p₀ + s(t) A sin ωt with ω = 2π/T.

    The factor s rises smoothly from 0 to 1 in the first period.

    Args:
        start: the middle, and the pose at t = 0.
        amplitude: (3,) A, in H, m.
        period: T, s.
    """
    A, period = arrays.check_array(amplitude, "amplitude", (3,)), arrays.check_number(period, "period", above=0.0)
    omega = 2.0 * math.pi / period

    def at(t: float) -> BodyMotion:
        s, ds, dds = minimum_jerk(t, period)
        sin, cos = math.sin(omega * t), math.cos(omega * t)
        x, v = s * sin, ds * sin + s * omega * cos
        a = dds * sin + 2.0 * ds * omega * cos - s * omega**2 * sin
        return _make_motion(start.p_HO + x * A, start.R_HO, np.append(v * A, _ZERO), np.append(a * A, _ZERO))

    return at


def combined_reference(translation: Reference, rotation: Reference) -> Reference:
    """Return the motion whose position follows one reference and whose orientation follows another.

    Args:
        translation: gives position, velocity and linear acceleration.
        rotation: gives orientation, angular velocity and angular acceleration.
    """

    def at(t: float) -> BodyMotion:
        moved, turned = object_motion(translation(t)), object_motion(rotation(t))
        twist = np.append(moved.twist[:3], turned.twist[3:])
        return _make_motion(moved.p_HO, turned.R_HO, twist, np.append(moved.acceleration[:3], turned.acceleration[3:]))

    return at


def _raised_cosine(omega: float, t: float) -> tuple[float, float, float]:
    """Return (1 − cos ωt)/2 and its first and second derivative."""
    return (1.0 - math.cos(omega * t)) / 2.0, omega * math.sin(omega * t) / 2.0, omega**2 * math.cos(omega * t) / 2.0


def _rotation(u: Array, angle: float) -> Array:
    """Return the matrix of a rotation about a unit vector (Rodrigues' formula)."""
    x, y, z = u
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * hat + (1.0 - math.cos(angle)) * hat @ hat)
