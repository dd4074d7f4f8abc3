"""Whether a guess that has come down is a hold, and what is wrong with it: geometry, closure, forces, and ways to go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem, Objective
from graspforce.force.solver import solve
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.goal import CandidateMeasures, Candidates, SearchGoal
from graspforce.grasp.search.travel import simulate_travel
from graspforce.hand.hand import Hand

_GAP = 1e-9  # m: rounding of what was asked for exactly
UNMOVABLE_PENALTY = 0.4  # the badness of a hold that bears everything and cannot be moved; less, the nearer it is


@dataclass(frozen=True, eq=False, slots=True)
class LoadRequirements:
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
class CandidateResult:
    """One candidate, exact; ``fault`` says what keeps it from being a hold, "" where nothing does.

    Attributes:
        hold: None where it has not even contacts.
        fault: in words.
        badness: how far it is from a hold; faults that are met later in the checks are nearer.
        quality: greater is better.
    """

    grasp: Grasp | None
    fault: str
    penalty: float
    quality: float


def check_candidate(goal: SearchGoal, candidates: Candidates, load: LoadRequirements) -> CandidateResult:
    """The guess as a hold, or what keeps it from being one."""
    m = goal.measure(candidates)
    fault, miss = _geometry_fault(goal, m)
    if fault:
        return CandidateResult(None, fault, 1.0 + miss, 0.0)
    shape = load.body.shape
    assert shape is not None  # find_grasp refused it
    p_OC = shape.project_to_surface(m.tips[0])
    contacts = ContactSet.stack(
        [Contact(p, n, load.friction, max_normal=load.max_normal) for p, n in zip(p_OC, m.normal[0], strict=True)]
    )
    names = tuple(load.hand.fingers[f].name for f in goal.fingers)
    grasp = Grasp(load.hand, load.body, names, contacts, m.q[0], m.p_HO[0], _orthonormal(m.R_HO[0]))
    closure = _closure(contacts, load)
    if closure <= 0.0:
        return CandidateResult(grasp, "the contacts that its fingers reach do not close it", 0.9, 0.0)
    for g in load.gravities:
        fault = _load_fault(grasp, g, load.margin)
        if fault:
            return CandidateResult(grasp, fault, 0.5, 0.0)
    limits = simulate_travel(goal, candidates)
    quality = closure * float(m.min_tip_speed.min() / m.normal_gain.max())
    if any(limit.reason for limit in limits):
        least = min(limits, key=lambda limit: limit.distance)
        lacking = 1.0 - sum(limit.distance for limit in limits) / (len(limits) * goal.requirements.travel)
        return CandidateResult(grasp, least.reason, UNMOVABLE_PENALTY * lacking, quality)
    return CandidateResult(grasp, "", 0.0, quality)


def _geometry_fault(goal: SearchGoal, m: CandidateMeasures) -> tuple[str, float]:
    """What is worst about a guess, in words, and by how much, m; nothing where all is as asked."""
    names, requirements = [finger.name for finger in goal.hand.fingers], goal.requirements
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    faults = [
        (abs(d) - _GAP, f"{names[f]} misses it by {1e3 * abs(d):.2f} mm")
        for f, d in zip(goal.fingers, m.contact_distance[0], strict=True)
    ]
    for f, edge_distance, radius in zip(goal.fingers, m.edge_distance[0], goal.radii, strict=True):
        wanted = requirements.edge * radius
        faults.append(
            (wanted - edge_distance, f"{names[f]} touches {1e3 * edge_distance:.2f} mm from an edge, not {1e3 * wanted:.2f} mm")
        )
    gaps = [*zip((f"{name}'s links" for name in names), m.links[0].tolist(), strict=True), ("the palm", float(m.palm[0]))]
    said = [(gap, f"{what} would be {1e3 * gap:.2f} mm from it") for what, gap in gaps]
    said += [
        (gap, f"{names[i]} and {names[j]} would be {1e3 * gap:.2f} mm apart")
        for (i, j), gap in zip(pairs, m.fingers[0], strict=True)
    ]
    wanted = requirements.clearance
    faults += [(wanted - gap, f"{words}, not {1e3 * wanted:.2f} mm") for gap, words in said]
    miss, words = max(faults)
    return (words, float(miss)) if miss > 0.0 else ("", 0.0)


def _closure(contacts: ContactSet, load: LoadRequirements) -> float:
    """How well the contacts close the object, at most 1: the margin of all cones by forces that cancel, f_n ≤ 1, over μ."""
    unit = ContactSet.stack([Contact(c.position, c.normal, load.friction, max_normal=1.0) for c in contacts.contacts])
    answer = solve(ForceProblem(unit, np.zeros(6), objective=Objective("margin")), explain=False)
    return float(answer.objective or 0.0) / load.friction if answer.found else 0.0


def _load_fault(grasp: Grasp, gravity_H: Array, margin: float) -> str:
    """What is wrong with a hold under a gravity, in words."""
    where = "[" + ", ".join(f"{x:.3g}" for x in gravity_H) + "] m/s²"
    w = grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), gravity_H)
    actuation = grasp.hand.actuation(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO, gravity_H=gravity_H)
    answer = solve(ForceProblem(grasp.contacts, w, actuation, objective=Objective("margin")), explain=False)
    if not answer.found:
        return f"under gravity {where} no forces within the motors' limits bear it"
    if float(answer.objective or 0.0) < margin:
        return f"under gravity {where} the slip margin is at most {answer.objective:.3g} N, not {margin:g} N"
    return ""


def _orthonormal(R: Array) -> Array:
    """The rotation nearest to a product of rotations, whose rounding it takes away."""
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)
