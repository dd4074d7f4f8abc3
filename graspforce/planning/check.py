"""The check of a plan against every limit, between its knots too, with the hand's own dynamics and the exact friction cones.

The check uses none of the equations that made the plan: poses and postures come from the plan's interpolation, loads from
`required_loads`. All quantities are smooth between two knots. A few instants in every interval therefore give interpolating
polynomials, and these give the extremes between. The worst instants are then evaluated directly; if the two values differ, the
polynomials get more instants.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import prod

import numpy as np

from graspforce.contact import friction
from graspforce.core.arrays import Array
from graspforce.planning.loads import RequiredLoads, required_loads, wrench_scale
from graspforce.planning.plan import Plan, PlanCheck
from graspforce.planning.task import HandTask, ObjectTask, Task

TOLERANCE = 1e-3  # default largest excess, relative to each limit
SAMPLES_PER_INTERVAL = 32  # instants in an interval at which polynomials are evaluated; parabolas join every three
_DEGREES = (4, 8, 16)  # degrees of the polynomials, tried in turn
_CONFIRM_SHARE = 0.05  # of the tolerance: largest difference between a polynomial and the direct evaluation
_NONE = -np.inf  # excess of a limit that does not exist


@dataclass(frozen=True, eq=False, slots=True)
class LimitExcess:
    """Amounts by which a trajectory exceeds its limits at M instants; negative inside.

    Args:
        slip: (M, N) load plus slip margin beyond μ f_n, N.
        normal: (M, N) normal force beyond its limits, N.
        torque: (M, n) motor torque beyond its limits, N·m.
        speed: (M, n) joint speed beyond its limit, rad/s.
        position: (M, n) joint position beyond its limits, rad.
        acceleration: (M, c) acceleration beyond its limit, m/s² or rad/s²: of the object's position and rotation and of the n
            joints, in this order, as far as the task has them.
    """

    slip: Array
    normal: Array
    torque: Array
    speed: Array
    position: Array
    acceleration: Array


def limit_excess(task: Task, required: RequiredLoads) -> LimitExcess:
    """Return the amounts by which loads exceed the limits of a task.

    Args:
        task: the task.
        required: loads at M instants.
    """
    none: Array = np.zeros((len(required.q), 0))
    slip, normal, torque, speed, position = none, none, none, none, none
    accelerations: list[Array] = []
    if isinstance(task, ObjectTask):
        contacts, padded = task.contacts, task.contacts.pad(required.f)
        f_n = padded[:, :, friction.F_N]
        margin = friction.slip_margin(padded, contacts.mu, contacts.gamma)
        slip = np.where(contacts.mu > 0.0, task.slip_margin - margin, _NONE)
        normal = np.maximum(f_n - contacts.max_normal, contacts.min_normal - f_n)
        accelerations += [np.linalg.norm(part, axis=1)[:, None] for part in np.split(required.acceleration, 2, axis=1)]
    if isinstance(task, HandTask):
        hand = task.hand
        torque = np.maximum(required.tau - hand.torque_upper, hand.torque_lower - required.tau)
        speed = np.abs(required.v) - hand.velocity_limit
        position = np.maximum(required.q - hand.q_upper, hand.q_lower - required.q)
        accelerations.append(np.abs(required.a))
    acceleration = np.hstack(accelerations) - acceleration_limits(task)
    return LimitExcess(slip, normal, torque, speed, position, acceleration)


def acceleration_limits(task: Task) -> Array:
    """Return the limits (c,) of the columns of `LimitExcess.acceleration`, m/s² and rad/s²; inf for no limit.

    Args:
        task: the task.
    """
    limits = task.acceleration_limits
    of_object = limits.object_limits if isinstance(task, ObjectTask) else ()
    return np.array([*of_object, *[limits.joints] * task.joint_count])


def times_between(knots: Array, count: int) -> Array:
    """Return the knots and evenly spaced times between them, in order.

    Args:
        knots: (K,) times, s.
        count: number of times inside every interval.
    """
    return _subdivide(knots, np.arange(count + 1) / (count + 1))


def interpolation_nodes(knots: Array, degree: int = _DEGREES[0]) -> Array:
    """Return the times at which `sample_intervals` needs values: the knots, and degree − 1 Chebyshev points between them.

    Args:
        knots: (K,) times, s.
        degree: of the interpolating polynomials.
    """
    return _subdivide(knots, _chebyshev_points(degree)[:-1])


def sample_intervals(values: Array, degree: int = _DEGREES[0]) -> Array:
    """Return values at `SAMPLES_PER_INTERVAL` even instants in every interval and at the last knot.

    The values are those of interpolating polynomials through Chebyshev points. Source: Berrut and Trefethen (2004).

    Args:
        values: (M, …) values at the `interpolation_nodes`.
        degree: of the polynomials.
    """
    M, shape = len(values) - 1, values.shape[1:]
    nodes = degree * np.arange(M // degree)[:, None] + np.arange(degree + 1)
    samples = _interpolation_matrix(degree) @ values.reshape(M + 1, prod(shape))[nodes]
    return np.concatenate([samples.reshape(M // degree * SAMPLES_PER_INTERVAL, *shape), values[-1:]])


def check(plan: Plan, tolerance: float = TOLERANCE) -> tuple[PlanCheck, LimitExcess]:
    """Check a plan against all limits.

    Args:
        plan: the plan; its own check is ignored.
        tolerance: largest allowed excess, relative to each limit.

    Returns:
        The check, and the amounts by which limits are exceeded at `SAMPLES_PER_INTERVAL` even instants in every interval and
        at the last knot.
    """
    task, knots = plan.task, plan.knots.times
    instants = times_between(knots, SAMPLES_PER_INTERVAL - 1)
    for degree in _DEGREES:
        at_nodes = required_loads(task, plan.at(interpolation_nodes(knots, degree)))
        required = RequiredLoads(*(sample_intervals(getattr(at_nodes, name), degree) for name in RequiredLoads.__slots__))
        over = limit_excess(task, required)
        over = LimitExcess(*(_interval_maxima(getattr(over, name)) for name in LimitExcess.__slots__))
        limits = _limits(task, required)
        interpolated, worst = _largest_shares(over, limits)
        direct, _ = _largest_shares(limit_excess(task, required_loads(task, plan.at(instants[worst]))), limits)
        error = np.maximum(interpolated, -tolerance) - np.maximum(direct, -tolerance)
        if np.abs(error).max() <= _CONFIRM_SHARE * tolerance:
            break
    if task.acceleration_limits.has_jerk:
        interpolated[-1] = max(interpolated[-1], _jerk_excess(task, knots, at_nodes, degree).max())
    return _plan_check(task, required, interpolated, tolerance), over


def jerk_excess(plan: Plan) -> Array:
    """Return the largest excess of jerk in each interval (K − 1,), relative to its limit; −inf without limits.

    Args:
        plan: the plan.
    """
    at_nodes = required_loads(plan.task, plan.at(interpolation_nodes(plan.knots.times)))
    return _jerk_excess(plan.task, plan.knots.times, at_nodes, _DEGREES[0])


def _jerk_excess(task: Task, knots: Array, at_nodes: RequiredLoads, degree: int) -> Array:
    """Return the excess from the derivatives of the accelerations' polynomials, at their nodes in every interval."""
    limits, parts = task.acceleration_limits, list[tuple[Array, float]]()
    if isinstance(task, ObjectTask):
        parts += zip(np.split(at_nodes.acceleration, 2, axis=1), limits.object_jerks, strict=True)
    if isinstance(task, HandTask):
        parts += [(column[:, None], limits.joint_jerk) for column in at_nodes.a.T]
    nodes = degree * np.arange(len(knots) - 1)[:, None] + np.arange(degree + 1)
    largest = np.full(len(knots) - 1, _NONE)
    for values, limit in parts:
        if limit < np.inf:
            jerk = _differentiation_matrix(degree) @ values[nodes] / np.diff(knots)[:, None, None]
            largest = np.maximum(largest, np.linalg.norm(jerk, axis=2).max(axis=1) / limit - 1.0)
    return largest


def check_at_times(plan: Plan, times: Array, tolerance: float = TOLERANCE) -> PlanCheck:
    """Check a plan at given times only, by direct evaluation, which validates the interpolation of `check`.

    Args:
        plan: the plan.
        times: (M,), s.
        tolerance: largest allowed excess, relative to each limit.
    """
    required = required_loads(plan.task, plan.at(times))
    shares, _ = _largest_shares(limit_excess(plan.task, required), _limits(plan.task, required))
    return _plan_check(plan.task, required, shares, tolerance)


def _subdivide(knots: Array, u: Array) -> Array:
    """Return the knots, and the fractions u of every interval; u begins with 0."""
    return np.append((knots[:-1, None] + np.diff(knots)[:, None] * u).ravel(), knots[-1])


def _chebyshev_points(degree: int) -> Array:
    """Return the Chebyshev points (degree + 1,) on [0, 1]."""
    return np.asarray((1.0 - np.cos(np.pi * np.arange(degree + 1) / degree)) / 2.0)


@cache
def _interpolation_matrix(degree: int) -> Array:
    """Return the matrix (SAMPLES_PER_INTERVAL, degree + 1) from values at Chebyshev points to those at even instants."""
    x, u = _chebyshev_points(degree), np.arange(SAMPLES_PER_INTERVAL) / SAMPLES_PER_INTERVAL
    weight = np.where(np.arange(degree + 1) % degree == 0, 0.5, 1.0) * (-1.0) ** np.arange(degree + 1)
    offset = u[:, None] - x
    equal = np.abs(offset) < 1e-12  # the instant is a Chebyshev point; distinct ones are at least 1/32 apart
    share = weight / np.where(equal, 1.0, offset)
    return np.asarray(np.where(equal.any(axis=1, keepdims=True), equal, share / share.sum(axis=1, keepdims=True)))


@cache
def _differentiation_matrix(degree: int) -> Array:
    """Return the matrix (degree + 1, degree + 1) from values at Chebyshev points on [0, 1] to derivatives there."""
    x = _chebyshev_points(degree)
    powers = np.arange(degree + 1)
    slopes = powers * np.where(powers > 0, x[:, None] ** np.maximum(powers - 1, 0), 0.0)
    return np.asarray(slopes @ np.linalg.inv(x[:, None] ** powers))


def _interval_maxima(x: Array) -> Array:
    """Return the maxima (M, c) within one sample of each, by parabolas through three samples that never span a knot."""
    left, middle, right = x[:-2], x[1:-1], x[2:]
    with np.errstate(invalid="ignore", divide="ignore"):  # straight lines, and limits that do not exist
        rise, bend = (right - left) / 2.0, right - 2.0 * middle + left
        at = np.clip(-rise / np.minimum(bend, 0.0), -1.0, 1.0)
        top = middle + at * (rise + at * bend / 2.0)
    top[SAMPLES_PER_INTERVAL - 1 :: SAMPLES_PER_INTERVAL] = _NONE
    return np.concatenate([x[:1], np.fmax(middle, top), x[-1:]])


def _largest_shares(over: LimitExcess, limits: dict[str, Array]) -> tuple[Array, list[int]]:
    """Return the largest excess of each kind (6,) relative to its limit, −inf if there is no limit, and their instants."""
    largest, instants = np.full(len(limits), _NONE), set()
    for i, (name, limit) in enumerate(limits.items()):
        with np.errstate(invalid="ignore"):
            share = np.where(np.isinf(limit), _NONE, getattr(over, name) / limit)
        if share.size:
            index = int(share.argmax())
            largest[i] = share.flat[index]
            instants.add(index // share.shape[1])
    return largest, sorted(instants)


def _limits(task: Task, required: RequiredLoads) -> dict[str, Array]:
    """Return the limit of each contact or joint to which its excess is relative, by the names of `LimitExcess`."""
    none: Array = np.zeros(0)
    limits = dict.fromkeys(LimitExcess.__slots__, none)
    if isinstance(task, ObjectTask):
        contacts = task.contacts
        f_n = contacts.pad(required.f)[:, :, friction.F_N].max(axis=0)
        limits["slip"] = np.maximum(f_n * contacts.mu, 1e-300)
        limits["normal"] = np.where(np.isfinite(contacts.max_normal) & (contacts.max_normal > 0), contacts.max_normal, 1.0)
    if isinstance(task, HandTask):
        hand = task.hand
        limits |= {"torque": hand.torque_upper, "speed": hand.velocity_limit, "position": hand.q_upper - hand.q_lower}
    limits["acceleration"] = acceleration_limits(task)
    return limits


def _plan_check(task: Task, required: RequiredLoads, shares: Array, tolerance: float) -> PlanCheck:
    """Return the record of a check whose largest excesses, relative to their limits, are ``shares`` (6,)."""
    drift = unmet = imbalance = 0.0
    if isinstance(task, ObjectTask):
        scale = wrench_scale(task.contacts)
        wrenches = (required.w, required.unmet, required.imbalance)
        largest, unmet, imbalance = (float(np.linalg.norm(wrench / scale, axis=1).max()) for wrench in wrenches)
        unmet, imbalance = unmet / (largest or 1.0), imbalance / (largest or 1.0)
        drift = float(required.drift.max(initial=0.0))
    slip, normal, torque, speed, position, acceleration = shares.tolist()
    return PlanCheck(slip, normal, torque, speed, position, acceleration, drift, unmet, imbalance, len(required.q), tolerance)
