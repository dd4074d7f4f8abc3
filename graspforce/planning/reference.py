"""The motion of a plan over time, as a reference for a controller: time-scaled, and smoothed by a moving average.

The fastest moves have steps in acceleration, and contacts cannot follow a step in force without ringing. The reference is
therefore the mean of the plan's motion over a window that ends now,

    p̄(t) = 1/m Σ p((t − cᵢ)/σ),   φ̄ likewise, R = R_start exp [φ]×,   cᵢ evenly spaced in the window

It takes longer by the window and reaches the same goal, and its accelerations are means of the plan's. The same holds for the
joints.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.geometry.hermite import hermite, locate_intervals
from graspforce.planning.interpolation import angular_rates, rotation_vector_rates
from graspforce.planning.plan import Plan
from graspforce.planning.task import FingerTask
from graspforce.planning.trajectory import Trajectory

_WINDOW_SAMPLES = 16  # m: more than the control periods in a window


def object_reference(plan: Plan, *, time_scale: float = 1.0, window: float = 0.0) -> Callable[[float], BodyMotion]:
    """Return the object's motion as a function of time in s: the plan's, then at rest at the goal.

    Args:
        plan: plan of a task with an object, whose orientation stays less than half a turn from the start.
        time_scale: σ > 0; the plan takes σ times as long.
        window: time over which the motion is averaged, s, ≥ 0; the move takes that much longer.

    Raises:
        InvalidInput: a plan of fingers alone, or a value out of range.
    """
    if isinstance(plan.task, FingerTask):
        raise InvalidInput("plan", "a plan of fingers alone", "a plan of a task with an object")
    knots = plan.knots
    R_start, goal = knots.R_HO[0], BodyMotion(knots.p_HO[-1], knots.R_HO[-1])
    mean = _windowed_mean(knots.times, _coordinates(knots, R_start), time_scale, window)

    def reference(t: float) -> BodyMotion:
        now = mean(t)
        if now is None:
            return goal
        x, rate, acceleration = now
        phi = x[None, 3:]
        omega, alpha = angular_rates(phi, rate[None, 3:], acceleration[None, 3:])
        R = R_start @ Rotation.from_rotvec(phi[0]).as_matrix()
        twist, twist_d = np.append(rate[:3], R @ omega[0]), np.append(acceleration[:3], R @ alpha[0])
        return BodyMotion(x[:3], R, twist, twist_d)

    return reference


def joint_reference(
    plan: Plan, *, time_scale: float = 1.0, window: float = 0.0
) -> Callable[[float], tuple[Array, Array, Array]]:
    """Return the joints' motion as a function of time in s: the plan's, then at rest at the goal.

    It agrees with `object_reference` up to second order in the window: the mean of points on a curve lies beside the curve.

    Args:
        plan: the plan.
        time_scale: σ > 0; the plan takes σ times as long.
        window: time over which the motion is averaged, s, ≥ 0; the move takes that much longer.

    Returns:
        A function that returns q, v and a (n,), rad, rad/s and rad/s².

    Raises:
        InvalidInput: a value out of range.
    """
    knots = plan.knots
    mean = _windowed_mean(knots.times, (knots.q, knots.v, knots.a), time_scale, window)
    goal, rest = freeze(knots.q[-1]), freeze(np.zeros(knots.q.shape[1]))

    def reference(t: float) -> tuple[Array, Array, Array]:
        return mean(t) or (goal, rest, rest)

    return reference


def _windowed_mean(
    times: Array, states: tuple[Array, Array, Array], time_scale: float, window: float
) -> Callable[[float], tuple[Array, Array, Array] | None]:
    """Return value, rate and acceleration, averaged over the window, as a function of time; None after the end."""
    sigma = arrays.check_number(time_scale, "time_scale", above=0.0)
    window = arrays.check_number(window, "window", minimum=0.0)
    times = sigma * times
    end = float(times[-1]) + window  # s
    delays = window * (np.arange(_WINDOW_SAMPLES) + 0.5) / _WINDOW_SAMPLES if window > 0.0 else np.zeros(1)  # s
    x, v, a = states[0], states[1] / sigma, states[2] / sigma**2

    def mean(t: float) -> tuple[Array, Array, Array] | None:
        if t >= end:
            return None
        instants = t - delays
        i, u = locate_intervals(times, np.clip(instants, 0.0, times[-1]))
        j = i + 1
        value, rate, acceleration = hermite(u, times[j] - times[i], (x[i], v[i], a[i], x[j], v[j], a[j]))
        moves = ((instants > 0.0) & (instants < times[-1]))[:, None]
        rate, acceleration = np.where(moves, rate, 0.0), np.where(moves, acceleration, 0.0)
        return value.mean(axis=0), rate.mean(axis=0), acceleration.mean(axis=0)

    return mean


def _coordinates(knots: Trajectory, R_start: Array) -> tuple[Array, Array, Array]:
    """Return (p, φ) at the knots with R = R_start exp [φ]×, their rates and accelerations, (K, 6) each."""
    phi = Rotation.from_matrix(R_start.T @ knots.R_HO).as_rotvec()  # rad
    omega, alpha = (np.einsum("mji,mj->mi", knots.R_HO, x[:, 3:]) for x in (knots.twist, knots.acceleration))  # in O
    rate, acceleration = rotation_vector_rates(phi, omega, alpha)
    return (
        np.hstack([knots.p_HO, phi]),
        np.hstack([knots.twist[:, :3], rate]),
        np.hstack([knots.acceleration[:, :3], acceleration]),
    )
