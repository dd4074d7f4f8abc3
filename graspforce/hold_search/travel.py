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

from graspforce import arrays
from graspforce.arrays import Array, frozen
from graspforce.errors import InvalidInput
from graspforce.hand import Hand
from graspforce.hold import Hold
from graspforce.hold_search.faces import Simple
from graspforce.hold_search.goal import Demands, Goal, Guess, Measures
from graspforce.hold_search.skeleton import Skeleton

Chosen = np.ndarray[tuple[int, ...], np.dtype[np.intp]]

_STEPS = 5  # of the midpoint rule: 1 mm each for the usual travel, which is then right to some µm
_LEAST_LEVER = 0.01  # singular values of A below this part of the largest count as zero, as the controller takes them
_FOLLOWED = 1e-3  # of d: what the contacts may miss of it
_OFF = 1e-4  # m: how far balls may leave the surface, by the steps' error
_STOP = 0.02  # rad: what joints keep to their limits on the way
_SLOWEST = 0.002  # m/rad: a finger that moves its tip slower in some direction is stretched out or folded
_SPIN_ARM = 0.03  # m: spin counts beside velocities as the speed that it makes this far from the normal, as for the controller
_SPIN_STEP = 2e-4  # m: a finger is near a posture in which it cannot keep from spinning for a fraction of a millimetre
_NONE: Chosen = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """How far the fingers can move the object one way.

    Attributes:
        direction: (3,) unit vector in H.
        reached: m, to a fifth of what was asked for.
        stop: what would be amiss one fifth further, in words; "" where the whole way can be gone.
    """

    direction: Array
    reached: float
    stop: str


def ways_of(hold: Hold, travel: float = 0.005, *, clearance: float = 0.002) -> tuple[Way, ...]:
    """To and fro along each axis of H, how far the fingers can move the object without turning it, and what stops them.

    Each axis is first turned to the nearest direction that all the fingers can move in, whatever their posture: planar fingers
    move the object in their planes alone, and what is common to no two planes cannot be gone.

    On the way joints keep 0.02 rad from their limits, no finger is stretched out, no soft fingertip comes to a posture in which
    it has to spin on the object, no ball rolls over an edge, and nothing else runs into the object or another finger.

    Args:
        hold: balls that touch a sphere, a cylinder or a box.
        travel: m.
        clearance: how far a touching finger's last link may come nearer than its ball, m, as in `find_hold`.
    """
    shape, hand = hold.body.shape, hold.hand
    if not isinstance(shape, Simple):
        raise InvalidInput("hold.body.shape", shape, "a sphere, a cylinder or a box, whose distances have a closed form")
    travel = arrays.number(travel, "travel", above=0.0)
    clearance = arrays.number(clearance, "clearance", minimum=0.0)
    skeleton, names = Skeleton(hand), [finger.name for finger in hand.fingers]
    fingers = tuple(names.index(name) for name in hold.fingers)
    goal = Goal(hand, skeleton, shape, fingers, Demands(clearance, 0.0, frozen(np.zeros(3)), travel))
    p_O = (goal.tips(hold.q[None])[0] - hold.p_HO) @ hold.R_HO
    x = np.concatenate([hold.q, hold.p_HO, np.zeros(3), np.ones(len(fingers))])
    guess = Guess(x[None], hold.R_HO[None], goal.see(p_O).level.argmax(axis=1)[None])
    return gone(goal, guess, np.flatnonzero(hold.contacts.gamma))


def gone(goal: Goal, guess: Guess, soft: Chosen = _NONE) -> tuple[Way, ...]:
    """How far a guess, if it is a hold, can be moved ± the travel along each of the fingers' ways.

    Args:
        goal, guess: what is held, and where.
        soft: which of the contacts tie the finger's spin.
    """
    travel, d = goal.demands.travel, np.vstack([goal.ways, -goal.ways])
    if travel == 0.0 or len(d) == 0:
        return ()
    start = goal.measure(guess)
    q, p = np.repeat(start.q, len(d), axis=0), np.repeat(start.p_HO, len(d), axis=0)
    h, stops, reached = travel / _STEPS, [""] * len(d), np.zeros(len(d))
    parts = int(np.ceil(h / _SPIN_STEP)) if len(soft) else 1
    for step in range(_STEPS):
        missed = np.zeros((len(d), len(goal.fingers) + len(soft)))
        for _ in range(parts):
            there, here = _rates(goal, guess, start, q, p, d, soft)
            middle, half_way = _rates(goal, guess, start, q + 0.5 * h / parts * there, p + 0.5 * h / parts * d, d, soft)
            q, p = q + h / parts * middle, p + h / parts * d
            missed = np.maximum(missed, np.maximum(here, half_way))
        m = _at(goal, guess, start, q, p)
        for b in range(len(d)):
            if not stops[b]:
                stops[b] = _stop(goal, q[b], missed[b], m, b, soft)
                reached[b] = travel * (step + 1) / _STEPS if not stops[b] else reached[b]
        if all(stops):
            break
    said = [
        f"moved {1e3 * (far + h):.3g} mm along {_named(way)} of H, {stop}"
        for far, way, stop in zip(reached, d, stops, strict=True)
    ]
    return tuple(
        Way(way, float(far), words if stop else "") for way, far, words, stop in zip(d, reached, said, stops, strict=True)
    )


def _at(goal: Goal, guess: Guess, start: Measures, q: Array, p: Array) -> Measures:
    """The hold, moved to postures (B, n) and places (B, 3)."""
    B, rest = len(q), goal.split(guess.x)[3]
    x = np.hstack([q, p, np.zeros((B, 3)), np.repeat(rest, B, axis=0)])
    return goal.measure(Guess(x, np.repeat(start.R_HO, B, axis=0), np.repeat(guess.face, B, axis=0)))


def _rates(goal: Goal, guess: Guess, start: Measures, q: Array, p: Array, d: Array, soft: Chosen) -> tuple[Array, Array]:
    """(B, n) q̇ per metre of the object's way along d (B, 3), and (B, N + S) what each contact misses of d, each spin of 0."""
    B, N = len(q), len(goal.fingers)
    points, spin = goal.rolling(q, p, start.R_HO, guess.face)
    A = np.concatenate([points.reshape(B, 3 * N, -1), _SPIN_ARM * spin[:, soft]], axis=1)
    inverse = np.linalg.pinv(A, rcond=_LEAST_LEVER)
    wanted = np.hstack([np.tile(d, N), np.zeros((B, len(soft)))])[..., None]
    back = (start.q - q)[..., None] / goal.demands.travel
    rate = inverse @ (wanted - A @ back) + back
    missed = (wanted - A @ rate)[..., 0]
    return rate[..., 0], np.hstack([np.linalg.norm(missed[:, : 3 * N].reshape(B, N, 3), axis=2), np.abs(missed[:, 3 * N :])])


def _stop(goal: Goal, q: Array, missed: Array, m: Measures, b: int, soft: Chosen) -> str:
    """What is amiss with the b-th of moved holds, in words."""
    N = len(goal.fingers)
    hand, names = goal.hand, [finger.name for finger in goal.hand.fingers]
    room = np.minimum(q - hand.q_lower, hand.q_upper - q)[goal.used]
    if room.min() < _STOP:
        j = int(goal.used[room.argmin()])
        return f"{hand.joints[j].name} would be {_end(hand, j, float(q[j]))}"
    amiss = [
        (_marked(N, soft[missed[N:] > _FOLLOWED]), "could not follow without spinning on it"),
        (missed[:N] > _FOLLOWED, "could not follow"),
        (m.slowest[b] < _SLOWEST, "would be stretched out"),
        (np.abs(m.touch[b]) > _OFF, "would leave it"),
        (m.room[b] < 0.0, "would roll over an edge"),
    ]
    for who, words in amiss:
        if who.any():
            return f"{names[goal.fingers[int(who.argmax())]]} {words}"
    if m.links[b].min() < 0.0:
        return f"{names[int(m.links[b].argmin())]}'s links would run into it"
    if m.fingers[b].min(initial=np.inf) < 0.0:
        return "two fingers would run into each other"
    return "the palm would be in the way" if m.palm[b] < 0.0 else ""


def _marked(N: int, which: Chosen) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(N,) true where named."""
    return np.isin(np.arange(N), which)


def _named(way: Array) -> str:
    axis = int(np.abs(way).argmax())
    if abs(way[axis]) > 1.0 - 1e-9:
        return f"{'-' if way[axis] < 0.0 else '+'}{'xyz'[axis]}"
    return "[" + ", ".join(f"{x:.2f}" for x in way) + "]"


def _end(hand: Hand, j: int, angle: float) -> str:
    low, high = float(hand.q_lower[j]), float(hand.q_upper[j])
    end, room = (low, angle - low) if angle - low < high - angle else (high, high - angle)
    return f"{abs(room):.3f} rad {'from' if room >= 0.0 else 'beyond'} its end at {end:.3f} rad"
