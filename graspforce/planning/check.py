"""A plan held against every limit between its knots, through the hand's own dynamics and the contacts' own cones.

Nothing here knows how the plan was made: poses and postures come from its interpolation, the wrench from Newton's and Euler's
laws, motor torques from the hand's inverse dynamics, contacts from where the fingertips are over the object's surface. All of
them are smooth between two knots, so a few instants in every interval give polynomials, and those the extremes in between: an
excess that lasts for a hundredth of an interval is seen too. What is seen is looked up at the worst instants, and more instants
taken where the two differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import prod

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import RANK_TOLERANCE, characteristic_length, contact_jacobians, grasp_matrices
from graspforce.core.arrays import Array
from graspforce.planning.plan import Plan, PlanCheck, Trajectory
from graspforce.planning.task import Task
from graspforce.planning.tip_contacts import (
    TipContacts,
    constraints,
    drift,
    locate_contacts,
)

TOLERANCE = 1e-3  # of each limit
SAMPLES_PER_INTERVAL = (
    32  # instants in every interval at which polynomials are evaluated, and a parabola through every three of them
)
_DEGREES = (4, 8, 16)  # of the polynomials, tried in turn; on 120 moves the first is right to 1e-5 of each limit
_CONFIRM_SHARE = 0.05  # of the tolerance: by how much what is seen may differ from what is there
_NONE = -np.inf


@dataclass(frozen=True, eq=False, slots=True)
class RequiredLoads:
    """What a motion asks for at M times, its forces corrected by the least that gives the object the wrench it needs.

    Args:
        q, v, tau: (M, n) rad, rad/s, N·m.
        f: (M, k) N and N·m.
        drift: (M, N) how far tips are off the surface, or have slipped, or contacts are from where the motion has them, m.
        unmet: (M, 6) the wrench that no forces at the contacts make, N and N·m.
        imbalance: (M, 6) the wrench that the motion's own forces miss, N and N·m.
        w: (M, 6) the wrench that the object needs.
    """

    q: Array
    v: Array
    tau: Array
    f: Array
    drift: Array
    unmet: Array
    imbalance: Array
    w: Array


@dataclass(frozen=True, eq=False, slots=True)
class LimitExcess:
    """By how much a motion exceeds its limits at M times; negative inside.

    Args:
        slip: (M, N) N.
        normal: (M, N) N.
        torque: (M, n) N·m.
        speed: (M, n) rad/s.
        position: (M, n) rad.
    """

    slip: Array
    normal: Array
    torque: Array
    speed: Array
    position: Array


def loads(task: Task, trajectory: Trajectory) -> RequiredLoads:
    """What a motion asks for."""
    M, hand, contacts, body = len(trajectory.times), task.hand, task.contacts, task.body
    w, missed, unmet, f = np.zeros((M, 6)), np.zeros((M, 6)), np.zeros((M, 6)), trajectory.f
    drifted = np.zeros((M, 0))
    if body is not None and contacts is not None:
        spin, turn = trajectory.twist[:, 3:], trajectory.acceleration[:, 3:]
        in_O = [
            np.einsum("mji,mj->mi", trajectory.R_HO, x) for x in (trajectory.acceleration[:, :3] - task.gravity_H, spin, turn)
        ]
        w = body.wrenches(*in_O)
        p_OC, R_OC = trajectory.p_OC, trajectory.R_OC
        if hand is not None:
            now = locate_contacts(task, trajectory.q, trajectory.p_HO, trajectory.R_HO)
            J, drifted = contact_jacobians(contacts, now.twists, trajectory.R_HO, now.R_OC), _drift(task, trajectory, now)
            p_OC, R_OC = now.p_OC, now.R_OC
        G, unit = grasp_matrices(contacts, p_OC, R_OC), _units(contacts)
        missed = w - (G @ f[:, :, None])[:, :, 0]
        f = f + (np.linalg.pinv(G / unit[:, None], rcond=RANK_TOLERANCE) @ (missed / unit)[:, :, None])[:, :, 0]
        unmet = w - (G @ f[:, :, None])[:, :, 0]
    tau = np.zeros((M, 0))
    if hand is not None:
        tau = hand.inverse_dynamics_along(trajectory.q, trajectory.v, trajectory.a, task.gravity_H)
        if contacts is not None:
            tau = tau + (J.swapaxes(1, 2) @ f[:, :, None])[:, :, 0]
    return RequiredLoads(trajectory.q, trajectory.v, tau, f, drifted, unmet, missed, w)


def _drift(task: Task, trajectory: Trajectory, now: TipContacts) -> Array:
    """(M, N) what `RequiredLoads` says; slips by the trapezoidal rule, whatever their direction."""
    spin = np.einsum("mji,mj->mi", trajectory.R_HO, trajectory.twist[:, 3:])  # rad/s, in O
    A, b = constraints(task, now, trajectory.R_HO, trajectory.twist[:, :3], spin)
    constrained, _ = task.constrained
    speed = np.zeros((len(A), len(constrained)))
    speed[:, constrained] = ((A @ trajectory.v[:, :, None])[:, :, 0] - b)[:, : int(constrained.sum())]
    slip = np.linalg.norm(speed.reshape(len(A), -1, 3), axis=2)  # m/s
    slipped = np.zeros(slip.shape)
    slipped[1:] = np.cumsum((slip[1:] + slip[:-1]) / 2.0 * np.diff(trajectory.times)[:, None], axis=0)
    places = np.linalg.norm(now.p_OC - trajectory.p_OC, axis=2)
    return np.asarray(np.maximum.reduce([drift(task, now), places, np.where(task.is_rolling, slipped, 0.0)]))


def excess(task: Task, required: RequiredLoads) -> LimitExcess:
    """What exceeds the limits."""
    M, hand, contacts = len(required.q), task.hand, task.contacts
    none: Array = np.zeros((M, 0))
    slip, normal, torque, speed, position = none, none, none, none, none
    if contacts is not None:
        padded = contacts.pad(required.f)
        pressing = padded[:, :, friction.F_N]
        rough = contacts.mu > 0.0
        slip = np.where(rough, task.slip_margin - friction.slip_margin(padded, contacts.mu, contacts.gamma), _NONE)
        normal = np.maximum(pressing - contacts.max_normal, contacts.min_normal - pressing)
    if hand is not None:
        torque = np.maximum(required.tau - hand.torque_upper, hand.torque_lower - required.tau)
        speed = np.abs(required.v) - hand.velocity_limit
        position = np.maximum(required.q - hand.q_upper, hand.q_lower - required.q)
    return LimitExcess(slip, normal, torque, speed, position)


def times_between(knots: Array, each: int) -> Array:
    """(M,) the knots, and ``each`` times evenly inside every interval between them, in order."""
    return _times(knots, np.arange(each + 1) / (each + 1))


def interpolation_nodes(knots: Array, degree: int = _DEGREES[0]) -> Array:
    """(M,) the times from which `sample_intervals` makes its polynomials: the knots, and ``degree`` − 1 in every interval."""
    return _times(knots, _chebyshev(degree)[:-1])


def sample_intervals(values: Array, degree: int = _DEGREES[0]) -> Array:
    """Values (M, …) at the `interpolation_nodes` of some knots to values at `SAMPLES_PER_INTERVAL` instants from every knot
    on, and at the last.

    Interpolating polynomials through Chebyshev's points: Berrut and Trefethen, Barycentric Lagrange interpolation (2004).
    """
    M, shape = len(values) - 1, values.shape[1:]
    of_interval = degree * np.arange(M // degree)[:, None] + np.arange(degree + 1)
    inside = _polynomials(degree) @ values.reshape(M + 1, prod(shape))[of_interval]
    return np.concatenate([inside.reshape(M // degree * SAMPLES_PER_INTERVAL, *shape), values[-1:]])


def check(plan: Plan, tolerance: float = TOLERANCE) -> tuple[PlanCheck, LimitExcess]:
    """A plan's check, and by how much it exceeds its limits at `SAMPLES_PER_INTERVAL` instants from every knot on, and at
    the last.

    Args:
        plan: the plan; its own check is not looked at.
        tolerance: the excess that is let pass, as part of each limit.
    """
    task, knots = plan.task, plan.knots.times
    instants = times_between(knots, SAMPLES_PER_INTERVAL - 1)
    for degree in _DEGREES:
        at_nodes = loads(task, plan.at(interpolation_nodes(knots, degree)))
        required = RequiredLoads(*(sample_intervals(getattr(at_nodes, name), degree) for name in RequiredLoads.__slots__))
        over = excess(task, required)
        over = LimitExcess(*(_interval_maxima(getattr(over, name)) for name in LimitExcess.__slots__))
        limits = _limits(task, required)
        seen, worst = _worst(over, limits)
        there, _ = _worst(excess(task, loads(task, plan.at(instants[worst]))), limits)
        differ = np.maximum(seen, -tolerance) - np.maximum(there, -tolerance)
        if np.abs(differ).max() <= _CONFIRM_SHARE * tolerance:
            break
    return _check(task, required, seen, tolerance), over


def check_at_times(plan: Plan, times: Array, tolerance: float = TOLERANCE) -> PlanCheck:
    """The check of some times alone, (M,), s, as they are: for those who doubt the polynomials."""
    required = loads(plan.task, plan.at(times))
    return _check(plan.task, required, _worst(excess(plan.task, required), _limits(plan.task, required))[0], tolerance)


def _times(knots: Array, u: Array) -> Array:
    """(M,) the knots, and in every interval the parts u of it, of which the first is 0."""
    return np.append((knots[:-1, None] + np.diff(knots)[:, None] * u).ravel(), knots[-1])


def _chebyshev(degree: int) -> Array:
    """(degree + 1,) from 0 to 1."""
    return np.asarray((1.0 - np.cos(np.pi * np.arange(degree + 1) / degree)) / 2.0)


@cache
def _polynomials(degree: int) -> Array:
    """(EACH, degree + 1) from values at Chebyshev's points to those at evenly spaced instants, the last point's left out."""
    x, u = _chebyshev(degree), np.arange(SAMPLES_PER_INTERVAL) / SAMPLES_PER_INTERVAL
    weight = np.where(np.arange(degree + 1) % degree == 0, 0.5, 1.0) * (-1.0) ** np.arange(degree + 1)
    off = u[:, None] - x
    met = np.abs(off) < 1e-12  # an instant that is a point: 1/32 of an interval is the least that others are apart
    share = weight / np.where(met, 1.0, off)
    return np.asarray(np.where(met.any(axis=1, keepdims=True), met, share / share.sum(axis=1, keepdims=True)))


def _interval_maxima(x: Array) -> Array:
    """(M, c) at evenly spaced instants to the most within one of them, by parabolas through three; none across a knot."""
    left, middle, right = x[:-2], x[1:-1], x[2:]
    with np.errstate(invalid="ignore", divide="ignore"):  # straight lines, and limits that are not there
        rise, bend = (right - left) / 2.0, right - 2.0 * middle + left
        at = np.clip(-rise / np.minimum(bend, 0.0), -1.0, 1.0)
        top = middle + at * (rise + at * bend / 2.0)
    top[SAMPLES_PER_INTERVAL - 1 :: SAMPLES_PER_INTERVAL] = _NONE
    return np.concatenate([x[:1], np.fmax(middle, top), x[-1:]])


def _worst(over: LimitExcess, limits: dict[str, Array]) -> tuple[Array, list[int]]:
    """(5,) the largest excess of each kind as part of its limit, −inf where there are none, and at which times these are."""
    most, at = np.full(len(limits), _NONE), set()
    for i, (name, limit) in enumerate(limits.items()):
        part = getattr(over, name) / limit
        if part.size:
            where = int(part.argmax())
            most[i] = part.flat[where]
            at.add(where // part.shape[1])
    return most, sorted(at)


def _limits(task: Task, required: RequiredLoads) -> dict[str, Array]:
    """What excesses are parts of, by `LimitExcess`'s names: of each contact or joint."""
    hand, contacts = task.hand, task.contacts
    none: Array = np.zeros(0)
    slip = normal = torque = speed = position = none
    if contacts is not None:
        slip = np.maximum(contacts.pad(required.f)[:, :, friction.F_N].max(axis=0) * contacts.mu, 1e-300)
        normal = np.where(np.isfinite(contacts.max_normal) & (contacts.max_normal > 0), contacts.max_normal, 1.0)
    if hand is not None:
        torque, speed, position = hand.torque_upper, hand.velocity_limit, hand.q_upper - hand.q_lower
    return {"slip": slip, "normal": normal, "torque": torque, "speed": speed, "position": position}


def _check(task: Task, required: RequiredLoads, parts: Array, tolerance: float) -> PlanCheck:
    drift = unmet = imbalance = 0.0
    if task.contacts is not None:
        unit = _units(task.contacts)
        largest, unmet, imbalance = (
            float(np.linalg.norm(wrench / unit, axis=1).max()) for wrench in (required.w, required.unmet, required.imbalance)
        )
        unmet, imbalance = unmet / (largest or 1.0), imbalance / (largest or 1.0)
        drift = float(required.drift.max(initial=0.0))
    slip, normal, torque, speed, position = parts.tolist()
    samples = len(required.q)
    return PlanCheck(slip, normal, torque, speed, position, drift, unmet, imbalance, samples, tolerance)


def _units(contacts: ContactSet) -> Array:
    """(6,) of a wrench: N, and for moments N·m over the contacts' distance, m."""
    length = characteristic_length(contacts)
    return np.array([1.0, 1.0, 1.0, length, length, length])
