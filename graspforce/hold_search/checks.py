"""Whether a guess that has come down is a hold, and what is wrong with it: geometry, closure, forces, and ways to go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.arrays import Array
from graspforce.body import Body, BodyMotion
from graspforce.contact import Contact, ContactSet
from graspforce.hand import Hand
from graspforce.hold import Hold
from graspforce.hold_search.goal import Goal, Guess, Measures
from graspforce.hold_search.travel import gone
from graspforce.problem import ForceProblem, Objective
from graspforce.solve import solve

_GAP = 1e-9  # m: rounding of what was asked for exactly
STUCK = 0.4  # the badness of a hold that bears everything and cannot be moved; less, the nearer it is


@dataclass(frozen=True, eq=False, slots=True)
class Asked:
    """What a hold must bear.

    Args:
        hand, body: which hand holds what.
        friction: μ of all contacts.
        max_normal: largest normal force of each, N.
        gravities: (K, 3) in H, one after the other, m/s².
        margin: that all contacts keep at once under each, N.
    """

    hand: Hand
    body: Body
    friction: float
    max_normal: float
    gravities: Array
    margin: float


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """One candidate, exact; ``fault`` says what keeps it from being a hold, "" where nothing does.

    Attributes:
        hold: None where it has not even contacts.
        fault: in words.
        badness: how far it is from a hold; faults that are met later in the checks are nearer.
        quality: greater is better.
    """

    hold: Hold | None
    fault: str
    badness: float
    quality: float


def checked(goal: Goal, guess: Guess, asked: Asked) -> Found:
    """The guess as a hold, or what keeps it from being one."""
    m = goal.measure(guess)
    fault, miss = _geometry(goal, m)
    if fault:
        return Found(None, fault, 1.0 + miss, 0.0)
    shape = asked.body.shape
    assert shape is not None  # find_hold refused it
    p_OC = shape.nearest(m.tips[0])
    contacts = ContactSet.stack(
        [Contact(p, n, asked.friction, max_normal=asked.max_normal) for p, n in zip(p_OC, m.normal[0], strict=True)]
    )
    names = tuple(asked.hand.fingers[f].name for f in goal.fingers)
    hold = Hold(asked.hand, asked.body, names, contacts, m.q[0], m.p_HO[0], _orthonormal(m.R_HO[0]))
    closure = _closure(contacts, asked)
    if closure <= 0.0:
        return Found(hold, "the contacts that its fingers reach do not close it", 0.9, 0.0)
    for g in asked.gravities:
        fault = _bears(hold, g, asked.margin)
        if fault:
            return Found(hold, fault, 0.5, 0.0)
    ways = gone(goal, guess)
    quality = closure * float(m.slowest.min() / m.press.max())
    if any(way.stop for way in ways):
        least = min(ways, key=lambda way: way.reached)
        lacking = 1.0 - sum(way.reached for way in ways) / (len(ways) * goal.demands.travel)
        return Found(hold, least.stop, STUCK * lacking, quality)
    return Found(hold, "", 0.0, quality)


def _geometry(goal: Goal, m: Measures) -> tuple[str, float]:
    """What is worst about a guess, in words, and by how much, m; nothing where all is as asked."""
    names, demands = [finger.name for finger in goal.hand.fingers], goal.demands
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    faults = [
        (abs(d) - _GAP, f"{names[f]} misses it by {1e3 * abs(d):.2f} mm") for f, d in zip(goal.fingers, m.touch[0], strict=True)
    ]
    for f, room, radius in zip(goal.fingers, m.room[0], goal.radii, strict=True):
        wanted = demands.edge * radius
        faults.append((wanted - room, f"{names[f]} touches {1e3 * room:.2f} mm from an edge, not {1e3 * wanted:.2f} mm"))
    gaps = [*zip((f"{name}'s links" for name in names), m.links[0].tolist(), strict=True), ("the palm", float(m.palm[0]))]
    said = [(gap, f"{what} would be {1e3 * gap:.2f} mm from it") for what, gap in gaps]
    said += [
        (gap, f"{names[i]} and {names[j]} would be {1e3 * gap:.2f} mm apart")
        for (i, j), gap in zip(pairs, m.fingers[0], strict=True)
    ]
    wanted = demands.clearance
    faults += [(wanted - gap, f"{words}, not {1e3 * wanted:.2f} mm") for gap, words in said]
    miss, words = max(faults)
    return (words, float(miss)) if miss > 0.0 else ("", 0.0)


def _closure(contacts: ContactSet, asked: Asked) -> float:
    """How well the contacts close the object, at most 1: the margin of all cones by forces that cancel, f_n ≤ 1, over μ."""
    unit = ContactSet.stack([Contact(c.position, c.normal, asked.friction, max_normal=1.0) for c in contacts.contacts])
    answer = solve(ForceProblem(unit, np.zeros(6), objective=Objective("margin")), explain=False)
    return float(answer.objective or 0.0) / asked.friction if answer.found else 0.0


def _bears(hold: Hold, gravity_H: Array, margin: float) -> str:
    """What is wrong with a hold under a gravity, in words."""
    where = "[" + ", ".join(f"{x:.3g}" for x in gravity_H) + "] m/s²"
    w = hold.body.wrench(BodyMotion(hold.p_HO, hold.R_HO), gravity_H)
    actuation = hold.hand.actuation(hold.q, hold.fingers, hold.contacts, hold.p_HO, hold.R_HO, gravity_H=gravity_H)
    answer = solve(ForceProblem(hold.contacts, w, actuation, objective=Objective("margin")), explain=False)
    if not answer.found:
        return f"under gravity {where} no forces within the motors' limits bear it"
    if float(answer.objective or 0.0) < margin:
        return f"under gravity {where} the slip margin is at most {answer.objective:.3g} N, not {margin:g} N"
    return ""


def _orthonormal(R: Array) -> Array:
    """The rotation nearest to a product of rotations, whose rounding it takes away."""
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)
