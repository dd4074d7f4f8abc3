"""A plan's motion over time, as a controller is told it: at its pace, with its steps in acceleration softened.

The fastest moves go from full acceleration to full braking in no time, and no contact follows a step in its force without
ringing. So what is followed is the mean of the plan's motion over a window that ends now,

    p̄(t) = 1/m Σ p((t − cᵢ)/σ),   φ̄ likewise, R = R_start exp [φ]×,   cᵢ evenly in the window,

which takes the window longer, reaches the same goal, and its accelerations are means of the plan's. The joints' likewise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.planning.interpolation import angular_rates, hermite, intervals, rotation_vector_rates
from graspforce.planning.plan import Plan, Trajectory

_WINDOW_SAMPLES = 16  # m: of a window of some ten control periods, each period has its own


def object_reference(plan: Plan, *, time_scale: float = 1.0, window: float = 0.0) -> Callable[[float], BodyMotion]:
    """The object's motion over time: the plan's, then still at its goal.

    Args:
        plan: of a task with an object, which turns by less than half a turn from its start.
        time_scale: σ > 0: the plan takes σ times as long.
        window: s, ≥ 0: over which the motion is averaged; the move takes as much longer.
    """
    if plan.task.body is None:
        raise InvalidInput("plan", "fingers alone", "of a task with an object")
    knots = plan.knots
    R_start, goal = knots.R_HO[0], BodyMotion(knots.p_HO[-1], knots.R_HO[-1])
    mean = _windowed_mean(knots.times, _coordinates(knots, R_start), time_scale, window)

    def at(t: float) -> BodyMotion:
        now = mean(t)
        if now is None:
            return goal
        x, rate, bend = now
        phi = x[None, 3:]
        omega, alpha = angular_rates(phi, rate[None, 3:], bend[None, 3:])
        R = R_start @ Rotation.from_rotvec(phi[0]).as_matrix()
        return BodyMotion(x[:3], R, np.append(rate[:3], R @ omega[0]), np.append(bend[:3], R @ alpha[0]))

    return at


def joint_reference(
    plan: Plan, *, time_scale: float = 1.0, window: float = 0.0
) -> Callable[[float], tuple[Array, Array, Array]]:
    """The joints' motion over time as q, v, a (n,) each, rad, rad/s, rad/s²: the plan's, then still; arguments as
    `object_reference`.

    With the object's it agrees to second order in the window: the mean of motions on a curved way is a little beside the way.
    """
    knots = plan.knots
    mean = _windowed_mean(knots.times, (knots.q, knots.v, knots.a), time_scale, window)
    goal, rest = freeze(knots.q[-1]), freeze(np.zeros(knots.q.shape[1]))

    def at(t: float) -> tuple[Array, Array, Array]:
        return mean(t) or (goal, rest, rest)

    return at


def _windowed_mean(
    times: Array, states: tuple[Array, Array, Array], time_scale: float, window: float
) -> Callable[[float], tuple[Array, Array, Array] | None]:
    """Value, rate and acceleration, averaged over the window, at a time; None where all of it is over."""
    sigma = arrays.check_number(time_scale, "time_scale", above=0.0)
    window = arrays.check_number(window, "window", minimum=0.0)
    times = sigma * times
    end = float(times[-1]) + window  # s
    delays = window * (np.arange(_WINDOW_SAMPLES) + 0.5) / _WINDOW_SAMPLES if window > 0.0 else np.zeros(1)  # s
    states = (states[0], states[1] / sigma, states[2] / sigma**2)

    def at(t: float) -> tuple[Array, Array, Array] | None:
        if t >= end:
            return None
        then = t - delays
        i, u = intervals(times, np.clip(then, 0.0, times[-1]))
        (x, rate, bend), j = states, i + 1
        x, rate, bend = hermite(u, times[j] - times[i], (x[i], rate[i], bend[i], x[j], rate[j], bend[j]))
        moves = ((then > 0.0) & (then < times[-1]))[:, None]
        return x.mean(axis=0), np.where(moves, rate, 0.0).mean(axis=0), np.where(moves, bend, 0.0).mean(axis=0)

    return at


def _coordinates(knots: Trajectory, R_start: Array) -> tuple[Array, Array, Array]:
    """(K, 6) each: (p, φ) at the knots, R = R_start exp [φ]×, with rates and accelerations."""
    phi = Rotation.from_matrix(R_start.T @ knots.R_HO).as_rotvec()  # rad
    omega, alpha = (np.einsum("mji,mj->mi", knots.R_HO, x[:, 3:]) for x in (knots.twist, knots.acceleration))  # in O
    rate, bend = rotation_vector_rates(phi, omega, alpha)
    return (
        np.hstack([knots.p_HO, phi]),
        np.hstack([knots.twist[:, :3], rate]),
        np.hstack([knots.acceleration[:, :3], bend]),
    )
