"""How far the fingers can move what they hold: the object goes, the balls roll on it, and everything is looked at on the way.

Contacts that roll have one velocity on both sides. While the object goes along d without turning, A q̇ = (d, …, d), with A the
contact points' Jacobians; what that leaves free brings the joints back to the hold's posture, as the controller does:

    q̇ = A⁺ (d, …, d) + (1 − A⁺ A) k (q_hold − q).

A soft contact ties the finger's spin about the normal too, one more row of A with 0 beside d. A finger of three joints cannot
keep to it, and one of four comes through postures in which it cannot: beyond them friction would have to give way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.faces import ClosedFormShape
from graspforce.grasp.search.goal import CandidateMeasures, Candidates, GeometryRequirements, SearchGoal
from graspforce.hand.hand import Hand

ContactIndices = np.ndarray[tuple[int, ...], np.dtype[np.intp]]

_STEPS = 5  # of the midpoint rule: 1 mm each for the usual travel, which is then right to some µm
_LEAST_LEVER = 0.01  # singular values of A below this part of the largest count as zero, as the controller takes them
_FOLLOWED = 1e-3  # of d: what the contacts may miss of it
_OFF = 1e-4  # m: how far balls may leave the surface, by the steps' error
_STOP = 0.02  # rad: what joints keep to their limits on the way
_SLOWEST = 0.002  # m/rad: a finger that moves its tip slower in some direction is stretched out or folded
_SPIN_ARM = 0.03  # m: spin counts beside velocities as the speed that it makes this far from the normal, as for the controller
_SPIN_STEP = 2e-4  # m: a finger is near a posture in which it cannot keep from spinning for a fraction of a millimetre
_NO_CONTACTS: ContactIndices = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, eq=False, slots=True)
class TravelLimit:
    """How far the fingers can move the object one way.

    Attributes:
        direction: (3,) unit vector in H.
        reached: m, to a fifth of what was asked for.
        stop: what would be amiss one fifth further, in words; "" where the whole way can be gone.
    """

    direction: Array
    distance: float
    reason: str


def travel_limits(grasp: Grasp, travel: float = 0.005, *, clearance: float = 0.002) -> tuple[TravelLimit, ...]:
    """To and fro along each axis of H, how far the fingers can move the object without turning it, and what stops them.

    Each axis is first turned to the nearest direction that all the fingers can move in, whatever their posture: planar fingers
    move the object in their planes alone, and what is common to no two planes cannot be gone.

    On the way joints keep 0.02 rad from their limits, no finger is stretched out, no soft fingertip comes to a posture in which
    it has to spin on the object, no ball rolls over an edge, and nothing else runs into the object or another finger.

    Args:
        hold: balls that touch a sphere, a cylinder or a box.
        travel: m.
        clearance: how far a touching finger's last link may come nearer than its ball, m, as in `find_grasp`.
    """
    shape, hand = grasp.body.shape, grasp.hand
    if not isinstance(shape, ClosedFormShape):
        raise InvalidInput("hold.body.shape", shape, "a sphere, a cylinder or a box, whose distances have a closed form")
    travel = arrays.check_number(travel, "travel", above=0.0)
    clearance = arrays.check_number(clearance, "clearance", minimum=0.0)
    kinematics, names = BatchKinematics(hand), [finger.name for finger in hand.fingers]
    fingers = tuple(names.index(name) for name in grasp.fingers)
    goal = SearchGoal(hand, kinematics, shape, fingers, GeometryRequirements(clearance, 0.0, freeze(np.zeros(3)), travel))
    p_O = (goal.tips(grasp.q[None])[0] - grasp.p_HO) @ grasp.R_HO
    x = np.concatenate([grasp.q, grasp.p_HO, np.zeros(3), np.ones(len(fingers))])
    candidates = Candidates(x[None], grasp.R_HO[None], goal.evaluate_faces(p_O).face_distance.argmax(axis=1)[None])
    return simulate_travel(goal, candidates, np.flatnonzero(grasp.contacts.gamma))


def simulate_travel(goal: SearchGoal, candidates: Candidates, soft: ContactIndices = _NO_CONTACTS) -> tuple[TravelLimit, ...]:
    """How far a guess, if it is a hold, can be moved ± the travel along each of the fingers' ways.

    Args:
        goal, guess: what is held, and where.
        soft: which of the contacts tie the finger's spin.
    """
    travel, d = goal.requirements.travel, np.vstack([goal.travel_directions, -goal.travel_directions])
    if travel == 0.0 or len(d) == 0:
        return ()
    start = goal.measure(candidates)
    q, p = np.repeat(start.q, len(d), axis=0), np.repeat(start.p_HO, len(d), axis=0)
    h, reasons, distance = travel / _STEPS, [""] * len(d), np.zeros(len(d))
    parts = int(np.ceil(h / _SPIN_STEP)) if len(soft) else 1
    for step in range(_STEPS):
        missed = np.zeros((len(d), len(goal.fingers) + len(soft)))
        for _ in range(parts):
            there, here = _joint_rates(goal, candidates, start, q, p, d, soft)
            middle, half_way = _joint_rates(
                goal, candidates, start, q + 0.5 * h / parts * there, p + 0.5 * h / parts * d, d, soft
            )
            q, p = q + h / parts * middle, p + h / parts * d
            missed = np.maximum(missed, np.maximum(here, half_way))
        m = _measure_moved(goal, candidates, start, q, p)
        for b in range(len(d)):
            if not reasons[b]:
                reasons[b] = _stop_reason(goal, q[b], missed[b], m, b, soft)
                distance[b] = travel * (step + 1) / _STEPS if not reasons[b] else distance[b]
        if all(reasons):
            break
    said = [
        f"moved {1e3 * (far + h):.3g} mm along {_direction_name(way)} of H, {reason}"
        for far, way, reason in zip(distance, d, reasons, strict=True)
    ]
    return tuple(
        TravelLimit(way, float(far), words if reason else "")
        for way, far, words, reason in zip(d, distance, said, reasons, strict=True)
    )


def _measure_moved(goal: SearchGoal, candidates: Candidates, start: CandidateMeasures, q: Array, p: Array) -> CandidateMeasures:
    """The hold, moved to postures (B, n) and places (B, 3)."""
    B, rest = len(q), goal.unpack(candidates.x)[3]
    x = np.hstack([q, p, np.zeros((B, 3)), np.repeat(rest, B, axis=0)])
    return goal.measure(Candidates(x, np.repeat(start.R_HO, B, axis=0), np.repeat(candidates.face, B, axis=0)))


def _joint_rates(
    goal: SearchGoal, candidates: Candidates, start: CandidateMeasures, q: Array, p: Array, d: Array, soft: ContactIndices
) -> tuple[Array, Array]:
    """(B, n) q̇ per metre of the object's way along d (B, 3), and (B, N + S) what each contact misses of d, each spin of 0."""
    B, N = len(q), len(goal.fingers)
    points, spin = goal.contact_jacobians(q, p, start.R_HO, candidates.face)
    A = np.concatenate([points.reshape(B, 3 * N, -1), _SPIN_ARM * spin[:, soft]], axis=1)
    inverse = np.linalg.pinv(A, rcond=_LEAST_LEVER)
    wanted = np.hstack([np.tile(d, N), np.zeros((B, len(soft)))])[..., None]
    back = (start.q - q)[..., None] / goal.requirements.travel
    rate = inverse @ (wanted - A @ back) + back
    missed = (wanted - A @ rate)[..., 0]
    return rate[..., 0], np.hstack([np.linalg.norm(missed[:, : 3 * N].reshape(B, N, 3), axis=2), np.abs(missed[:, 3 * N :])])


def _stop_reason(goal: SearchGoal, q: Array, missed: Array, m: CandidateMeasures, b: int, soft: ContactIndices) -> str:
    """What is amiss with the b-th of moved holds, in words."""
    N = len(goal.fingers)
    hand, names = goal.hand, [finger.name for finger in goal.hand.fingers]
    joint_margin = np.minimum(q - hand.q_lower, hand.q_upper - q)[goal.used_joints]
    if joint_margin.min() < _STOP:
        j = int(goal.used_joints[joint_margin.argmin()])
        return f"{hand.joints[j].name} would be {_limit_words(hand, j, float(q[j]))}"
    amiss = [
        (_marked(N, soft[missed[N:] > _FOLLOWED]), "could not follow without spinning on it"),
        (missed[:N] > _FOLLOWED, "could not follow"),
        (m.min_tip_speed[b] < _SLOWEST, "would be stretched out"),
        (np.abs(m.contact_distance[b]) > _OFF, "would leave it"),
        (m.edge_distance[b] < 0.0, "would roll over an edge"),
    ]
    for who, words in amiss:
        if who.any():
            return f"{names[goal.fingers[int(who.argmax())]]} {words}"
    if m.links[b].min() < 0.0:
        return f"{names[int(m.links[b].argmin())]}'s links would run into it"
    if m.fingers[b].min(initial=np.inf) < 0.0:
        return "two fingers would run into each other"
    return "the palm would be in the way" if m.palm[b] < 0.0 else ""


def _marked(N: int, which: ContactIndices) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(N,) true where named."""
    return np.isin(np.arange(N), which)


def _direction_name(way: Array) -> str:
    axis = int(np.abs(way).argmax())
    if abs(way[axis]) > 1.0 - 1e-9:
        return f"{'-' if way[axis] < 0.0 else '+'}{'xyz'[axis]}"
    return "[" + ", ".join(f"{x:.2f}" for x in way) + "]"


def _limit_words(hand: Hand, j: int, angle: float) -> str:
    low, high = float(hand.q_lower[j]), float(hand.q_upper[j])
    end, joint_margin = (low, angle - low) if angle - low < high - angle else (high, high - angle)
    return f"{abs(joint_margin):.3f} rad {'from' if joint_margin >= 0.0 else 'beyond'} its end at {end:.3f} rad"
