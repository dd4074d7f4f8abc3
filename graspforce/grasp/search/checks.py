"""Exact checks of a candidate after the descent: geometry, force closure, forces under gravity, and travel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp, pad_contact
from graspforce.grasp.search.candidates import CandidateMeasures, Candidates
from graspforce.grasp.search.common_joints import whole_posture
from graspforce.grasp.search.goal import SearchGoal
from graspforce.grasp.search.pair_distances import Pair
from graspforce.grasp.search.travel import simulate_travel
from graspforce.hand.descriptions.contact_description import HELD_OBJECT
from graspforce.hand.hand import Hand

_ROUNDING = 1e-9  # m, of distances and gaps that meet their requirement exactly
UNMOVABLE_PENALTY = 0.4  # largest penalty of a grasp that supports every load but cannot be moved as required


@dataclass(frozen=True, eq=False, slots=True)
class LoadRequirements:
    """Loads that a grasp must support.

    Args:
        hand: the hand, with the joints that move all fingers.
        body: the object.
        friction: μ of all contacts.
        max_normal: largest normal force of each contact, N.
        gravities: (K, 3) accelerations of gravity in H, m/s², each a load case.
        slip_margin: least slip margin of all contacts in each load case, N.
        pad_friction: γ of fingers whose description states none, m; None for point contacts.
    """

    hand: Hand
    body: Body
    friction: float
    max_normal: float
    gravities: Array
    slip_margin: float
    pad_friction: float | None = None


@dataclass(frozen=True, eq=False, slots=True)
class CandidateResult:
    """The result of the checks of one candidate.

    Attributes:
        grasp: the candidate as a grasp; None if its geometry is not possible.
        fault: the first requirement that it does not meet; empty if it meets all.
        penalty: 0 without a fault, larger the earlier the failed check.
        quality: of a grasp without a fault; larger is better.
        overlaps: pairs of bodies that overlap, some of the goal's forbidden pairs; empty if another requirement failed before.
    """

    grasp: Grasp | None
    fault: str
    penalty: float
    quality: float
    overlaps: tuple[Pair, ...] = ()


def check_candidate(goal: SearchGoal, candidates: Candidates, load: LoadRequirements) -> CandidateResult:
    """Check one candidate against all requirements.

    Args:
        goal: the geometric requirements.
        candidates: one candidate.
        load: the loads.
    """
    m = goal.measure(candidates)
    fault, excess = _geometry_fault(goal, m)
    if fault:
        return CandidateResult(None, fault, 1.0 + excess, 0.0)
    distances = goal.forbidden_distances(candidates)
    overlaps = tuple(goal.forbidden_pairs.pairs[k] for k in distances.argsort().tolist() if distances[k] < 0.0)
    if overlaps:
        first, second = (goal.forbidden_pairs.bodies[i].name for i in overlaps[0])
        fault = f"{first} and {'the object' if second == HELD_OBJECT else second} overlap"
        return CandidateResult(None, fault, 1.0 - float(distances.min()), 0.0, overlaps)
    p_OC = goal.shape.project_to_surface(m.tip_centres[0])
    names = tuple(goal.hand.fingers[f].name for f in goal.fingers)
    points = [Contact(p, n, load.friction, max_normal=load.max_normal) for p, n in zip(p_OC, m.normal[0], strict=True)]
    padded = [pad_contact(goal.hand, name, point) for name, point in zip(names, points, strict=True)]
    contacts = ContactSet.stack([with_pad_friction(contact, load.pad_friction) for contact in padded])
    q = whole_posture(load.hand, load.hand.neutral, m.q[0])
    grasp = Grasp(load.hand, load.body, names, contacts, q, m.p_HO[0], _nearest_rotation(m.R_HO[0]))
    closure = closure_quality(contacts, load.friction)
    if closure <= 0.0:
        return CandidateResult(grasp, "the contacts are not force-closed", 0.9, 0.0)
    for g in load.gravities:
        fault = _load_fault(grasp, g, load.slip_margin)
        if fault:
            return CandidateResult(grasp, fault, 0.5, 0.0)
    limits = simulate_travel(goal, candidates, np.flatnonzero(contacts.gamma))
    quality = closure * float(m.min_tip_speed.min() / m.normal_gain.max())
    if any(limit.reason for limit in limits):
        shortest = min(limits, key=lambda limit: limit.distance)
        lacking = 1.0 - sum(limit.distance for limit in limits) / (len(limits) * goal.requirements.travel)
        return CandidateResult(grasp, shortest.reason, UNMOVABLE_PENALTY * lacking, quality)
    return CandidateResult(grasp, "", 0.0, quality)


def _geometry_fault(goal: SearchGoal, m: CandidateMeasures) -> tuple[str, float]:
    """Return the worst geometric fault of a candidate and its size, m; ("", 0) if there is none."""
    names, required = [finger.name for finger in goal.hand.fingers], goal.requirements
    faults = []
    for f, distance in zip(goal.fingers, m.contact_distance[0].tolist(), strict=True):
        faults.append((abs(distance) - _ROUNDING, f"{names[f]} is {1e3 * abs(distance):.2f} mm from the surface"))
    for f, distance, radius in zip(goal.fingers, m.edge_distance[0].tolist(), goal.radii.tolist(), strict=True):
        least = required.edge_ratio * radius
        text = f"{names[f]} touches {1e3 * distance:.2f} mm from an edge, below {1e3 * least:.2f} mm"
        faults.append((least - distance, text))
    gaps = [(gap, f"the links of {name} and the object") for name, gap in zip(names, m.link_gap[0].tolist(), strict=True)]
    gaps.append((float(m.palm_gap[0]), "the palm and the object"))
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    gaps += [(gap, f"{names[i]} and {names[j]}") for (i, j), gap in zip(pairs, m.finger_gap[0].tolist(), strict=True)]
    for gap, between in gaps:
        text = f"{between} are {1e3 * gap:.2f} mm apart, below {1e3 * required.clearance:.2f} mm"
        faults.append((required.clearance - gap, text))
    touching = [names[f] for f in goal.fingers]
    for margin, text in zip(m.side_margin[0].tolist(), required.side.texts(touching), strict=True):
        faults.append((-margin, text))
    excess, text = max(faults)
    return (text, float(excess)) if excess > 0.0 else ("", 0.0)


def with_pad_friction(contact: Contact, gamma: float | None) -> Contact:
    """Return a point contact as a soft contact with a torsional friction; other contacts as they are.

    Args:
        contact: the contact.
        gamma: γ, m; None for no change.
    """
    if gamma is None or contact.model is not ContactModel.POINT:
        return contact
    return replace(contact, model=ContactModel.SOFT, torsional_friction=gamma)


def closure_quality(contacts: ContactSet, friction: float) -> float:
    """Return max over forces with G f = 0, f_n ≤ 1 of the least (μ f_n − ‖f_t‖)/μ: between 0 (not closed) and 1.

    Args:
        contacts: the contacts.
        friction: μ.
    """
    unit = replace(contacts, max_normal=freeze(np.ones(len(contacts))))
    solution = solve(ForceProblem(unit, np.zeros(6), objective=Objective("margin")), explain=False)
    return float(solution.objective or 0.0) / friction if solution.found else 0.0


def _load_fault(grasp: Grasp, gravity_H: Array, slip_margin: float) -> str:
    """Return why a grasp does not support its object under a gravity, m/s²; empty if it does."""
    where = "[" + ", ".join(f"{x:.3g}" for x in gravity_H) + "] m/s²"
    solution = solve(grasp.force_problem(gravity_H, objective=Objective("margin")), explain=False)
    if not solution.found:
        return f"under gravity {where} no forces within the motor limits support the object"
    if float(solution.objective or 0.0) < slip_margin:
        return f"under gravity {where} the slip margin is at most {solution.objective:.3g} N, below {slip_margin:g} N"
    return ""


def _nearest_rotation(R: Array) -> Array:
    """Return the rotation nearest to a product of rotations, without its rounding error."""
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)


def load_cases(gravity_H: npt.ArrayLike | None) -> Array:
    """Return the load cases (K, 3), m/s².

    Args:
        gravity_H: (3,) or (K, 3) accelerations of gravity in H, m/s²; None for the six directions of H's axes.
    """
    if gravity_H is None:
        return STANDARD_GRAVITY * np.vstack([np.eye(3), -np.eye(3)])
    if np.ndim(gravity_H) == 1:
        return arrays.check_array(gravity_H, "gravity_H", (3,))[None]
    return arrays.check_array(gravity_H, "gravity_H", (None, 3))
