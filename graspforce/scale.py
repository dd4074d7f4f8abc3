"""The units in which the numbers of a force problem are small, whatever its own units and wherever O stands.

    force F    what sets the forces of the answer: the wrench about the contacts' centroid, the least normal forces, what a
               joint outside its limits demands, the bias torques that the torque cost would cancel, and for "margin" the
               limit that ends it
    length L   rms distance of the contacts from their centroid
    torque T   a joint's own: what F loads it with, or its bias torque
    cost       what F costs

Solvers are given numbers over these units and certificates judge by them. A unit that is too large would let wrong answers
pass, one that is too small would let none pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce import friction
from graspforce.actuation import Actuation
from graspforce.arrays import Array
from graspforce.contact import ContactSet
from graspforce.grasp import characteristic_length
from graspforce.problem import ForceProblem

_NEGLIGIBLE = 1e-14  # a joint that forces load less than this beside the most loaded one is loaded by rounding alone


@dataclass(frozen=True, eq=False, slots=True)
class Scale:
    """The problem's own units: force, N; length, m; torque of each joint (n,), N·m; cost in the objective's unit."""

    force: float
    length: float
    torque: Array
    cost: float


def scale(problem: ForceProblem) -> Scale:
    """The units of a problem; all follow when its units change, and none when O moves."""
    contacts, hand, kind = problem.contacts, problem.hand, problem.objective.type
    length = characteristic_length(contacts)  # m
    reach = reaches(problem, length)  # N·m per N
    _, w = problem.balance
    force = float(max(np.linalg.norm(w[:3]), np.linalg.norm(w[3:]) / length, contacts.min_normal.max()))
    if hand is not None:
        force = max(force, _demanded(hand, reach))
        if kind == "torque":
            force = max(force, _cancelling(hand, reach))
    if kind == "margin":
        force = max(force, _widest_margin(contacts, hand, reach))
    if force == 0.0 and hand is not None and reach.any():
        force = float(np.abs(hand.tau_u).max()) / float(reach.max())
    force = force or 1.0

    torque = reach * force  # N·m
    if hand is not None:
        torque = np.maximum(torque, np.abs(hand.tau_u))
    torque[torque == 0.0] = 1.0
    cost = force
    if kind == "force":
        cost = force * force  # not **, which raises where this overflows
    elif kind == "margin":
        cost = force * float(contacts.mu[contacts.mu > 0].min())
    elif kind == "torque":
        assert hand is not None  # checked when the problem was made
        cost = float((hand.weight * (reach * force) ** 2).max(initial=0.0)) + problem.objective.force_weight * force * force
    return Scale(force, length, torque, cost or 1.0)


def component_units(contacts: ContactSet, length: float) -> Array:
    """(k,) the unit of each stacked component over the force unit: 1 for forces, ``length`` for moments."""
    return np.where(contacts.columns % 4 == friction.M, length, 1.0)


def bearing(contacts: ContactSet) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(k,) whether a stacked component can be other than zero. A normal force that may not press is held at zero."""
    contact, column = contacts.columns // 4, contacts.columns % 4
    tangential, twist = column == friction.T1, column == friction.M
    tangential |= column == friction.T2
    dead = (tangential & (contacts.mu[contact] == 0)) | (twist & (contacts.gamma[contact] == 0))
    return np.asarray(~(dead | ((tangential | twist) & (contacts.max_normal[contact] == 0))))


def reaches(problem: ForceProblem, length: float) -> Array:
    """(n,) the most that a newton (or a newton times ``length``) at any contact loads each joint with, N·m per N."""
    contacts, hand = problem.contacts, problem.hand
    if hand is None:
        return np.zeros(0)
    rows = bearing(contacts)
    reach = np.abs(hand.J[rows] * component_units(contacts, length)[rows, None]).max(axis=0, initial=0.0)
    return np.where(reach > _NEGLIGIBLE * reach.max(initial=0.0), reach, 0.0)


def _demanded(hand: Actuation, reach: Array) -> float:
    """The force that some contact must make because a joint is outside its limits without it, N."""
    beyond = np.maximum(np.maximum(hand.lower - hand.tau_u, hand.tau_u - hand.upper), 0.0)  # N·m
    return float(np.divide(beyond, reach, out=np.zeros_like(reach), where=reach > 0).max(initial=0.0))


def _cancelling(hand: Actuation, reach: Array) -> float:
    """The force that cancels the bias torques, each weighed as in the cost, N."""
    size = np.sqrt(hand.weight)
    bias = float((size * np.abs(hand.tau_u))[reach > 0].max(initial=0.0))
    lever = float((size * reach).max(initial=0.0))
    return bias / lever if lever > 0 else 0.0


def _widest_margin(contacts: ContactSet, hand: Actuation | None, reach: Array) -> float:
    """The force at which the first limit ends the margin's growth, N."""
    pressing = contacts.max_normal[(contacts.mu > 0) & (contacts.max_normal > 0)]
    if hand is not None:
        room = np.maximum(hand.upper - hand.tau_u, hand.tau_u - hand.lower)  # N·m
        loaded = (reach > 0) & (room > 0)
        pressing = np.append(pressing, room[loaded] / reach[loaded])
    ends = pressing[np.isfinite(pressing)]
    return float(ends.min()) if ends.size else 0.0
