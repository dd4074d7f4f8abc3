"""Motions to follow: functions of time that say where the object should be, how fast, and with what acceleration.

Each begins at rest at the pose that it is given, and its twist and acceleration are the derivatives of its pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.state import DesiredMotion, object_motion
from graspforce.core import arrays
from graspforce.core.arrays import Array

Reference = Callable[[float], DesiredMotion]

_ZERO = np.zeros(3)  # no velocity, or no acceleration


def constant_reference(start: BodyMotion) -> Reference:
    """Stay where it is."""
    rest = BodyMotion(start.p_HO, start.R_HO)
    return lambda t: rest


def linear_reference(start: BodyMotion, travel: Any, period: float) -> Reference:
    """Out and back along a straight line, for ever: p = p₀ + d (1 − cos ωt)/2. Source: Al-Gallaf.

    Args:
        start: where it begins.
        travel: (3,) d, from one end to the other, in H, m.
        period: from the start to the start again, s.
    """
    d, omega = arrays.check_array(travel, "travel", (3,)), 2.0 * math.pi / arrays.check_number(period, "period", above=0.0)

    def at(t: float) -> BodyMotion:
        x, v, a = _raised_cosine(omega, t)
        return BodyMotion(start.p_HO + x * d, start.R_HO, np.append(v * d, _ZERO), np.append(a * d, _ZERO))

    return at


def rotation_reference(start: BodyMotion, axis: Any, angle: float, period: float) -> Reference:
    """Turn and turn back about O's origin, for ever: by the angle θ (1 − cos ωt)/2.

    Args:
        start: where it begins.
        axis: (3,) the unit vector to turn about, in H; normalised.
        angle: θ, rad.
        period: from the start to the start again, s.
    """
    u = arrays.check_array(axis, "axis", (3,))
    u = u / np.linalg.norm(u)
    theta, omega = arrays.check_number(angle, "angle"), 2.0 * math.pi / arrays.check_number(period, "period", above=0.0)

    def at(t: float) -> BodyMotion:
        x, v, a = (theta * value for value in _raised_cosine(omega, t))  # rad, rad/s, rad/s²
        return BodyMotion(start.p_HO, _rotation(u, x) @ start.R_HO, np.append(_ZERO, v * u), np.append(_ZERO, a * u))

    return at


def sine_reference(start: BodyMotion, amplitude: Any, period: float) -> Reference:
    """To and fro about where it is: p = p₀ + s(t) A sin ωt, with s rising smoothly from 0 to 1 in the first period.

    Args:
        start: the middle.
        amplitude: (3,) A, in H, m.
        period: s.
    """
    A, period = arrays.check_array(amplitude, "amplitude", (3,)), arrays.check_number(period, "period", above=0.0)
    omega = 2.0 * math.pi / period

    def at(t: float) -> BodyMotion:
        r = min(t / period, 1.0)
        s = r**3 * (10.0 - 15.0 * r + 6.0 * r**2)  # rest, and no acceleration, at both ends
        ds = 30.0 * r**2 * (1.0 - r) ** 2 / period  # 1/s
        dds = 60.0 * r * (1.0 - r) * (1.0 - 2.0 * r) / period**2  # 1/s²
        sin, cos = math.sin(omega * t), math.cos(omega * t)
        x, v = s * sin, ds * sin + s * omega * cos
        a = dds * sin + 2.0 * ds * omega * cos - s * omega**2 * sin
        return BodyMotion(start.p_HO + x * A, start.R_HO, np.append(v * A, _ZERO), np.append(a * A, _ZERO))

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
        return BodyMotion(moved.p_HO, turned.R_HO, twist, np.append(moved.acceleration[:3], turned.acceleration[3:]))

    return at


def _raised_cosine(omega: float, t: float) -> tuple[float, float, float]:
    """(1 − cos ωt)/2 and its two derivatives."""
    return (1.0 - math.cos(omega * t)) / 2.0, omega * math.sin(omega * t) / 2.0, omega**2 * math.cos(omega * t) / 2.0


def _rotation(u: Array, angle: float) -> Array:
    """Rodrigues: the rotation by an angle about a unit vector."""
    x, y, z = u
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * hat + (1.0 - math.cos(angle)) * hat @ hat)
