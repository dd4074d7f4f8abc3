"""Finding a hold: many guesses are screened together, the best go down by least squares, what comes out is checked exactly."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.checks import UNMOVABLE_PENALTY, CandidateResult, LoadRequirements, check_candidate
from graspforce.grasp.search.faces import ClosedFormShape
from graspforce.grasp.search.goal import Candidates, GeometryRequirements, SearchGoal
from graspforce.hand.hand import Hand

STANDARD_GRAVITY = 9.81  # m/s²

_SAMPLES = 300  # guesses for each set of fingers, of which the best go on
_DESCENTS = 16  # at most
_PREFERENCE_WEIGHTS = (1.0, 0.1)  # what should be is asked for less where it was in the way of what must be
_NEARLY = 0.003  # m: a miss that may come from that
_ENOUGH_LOADED = 4  # candidates that bear the load, to choose the best from; if none of them can be moved, others hardly will
_ENOUGH_TOUCHING = 8  # candidates that touch as they should: if none of them bears the load, others will hardly
_STEP = 1e-7  # rad, m: forward differences, eight digits right
_CONTACT_TOLERANCE = 1e-10  # m: where touching is exact
_TRAVEL = 0.005  # m
_LIMIT_SHARE = 0.05  # of its range that each joint stays away from its limits
_POSTURE_SPREAD = 0.6  # of half its range around rest, in which a guess places a joint


def find_grasp(
    hand: Hand,
    body: Body,
    fingers: Sequence[str] | None = None,
    *,
    friction: float = 0.6,
    max_normal: float = 20.0,
    gravity_H: Any = None,
    margin: float = 0.05,
    travel: float | None = None,
    clearance: float = 0.002,
    edge: float = 0.4,
    out_H: Any = None,
    seed: int = 0,
) -> Grasp:
    """A posture and a place of the object in which the fingertips hold it.

    In the hold that returns

    - each finger's ball touches the surface, to a nanometre, inside a face: not on an edge, which has no normal;
    - the contacts close the object: normal forces alone can nearly balance, and motors can make them;
    - joints keep a twentieth of their range from their limits, couplings included;
    - fingers keep their clearance from each other, and the object from links, idle fingers and palm. Links are as thick as the
      tip's ball, and filled by spheres along them; the palm is the plane across ``out_H`` through H's origin;
    - under each gravity the forces exist, certified, with every contact's slip margin at least ``margin`` and the motors within
      their limits;
    - the fingers can move the object by ``travel`` to and fro along each axis of H, turned to the nearest direction that they
      all can move in: see `travel_limits`. Nor does the palm come in the way.

    Guesses are drawn at random about the rest posture, with a seed; the same arguments give the same hold. Fingers that do not
    touch are stretched out of the way.

    Args:
        hand: the hand.
        body: the object; its shape a sphere, a cylinder or a box.
        fingers: which touch, by name, at least three: two points cannot close an object; by default the best three
            of some, or four where no three do, with the thumb where the hand has one (a finger so named) and it can.
        friction: μ of all contacts, > 0.
        max_normal: largest normal force of each contact, N.
        gravity_H: (3,) or (K, 3) accelerations of gravity in H under each of which the hold must stand, m/s²; by default
            9.81 in the six directions of H's axes: the palm turned any way.
        margin: the slip margin μ f_n − ‖f_t‖ that all contacts can have at once under each gravity, N.
        travel: m; 0 for a hold that need not move. By default 5 mm are wished for: where no hold allows it, that which can be
            moved furthest, on the mean of all ways, is returned; `travel_limits` says what stops it.
        clearance: m.
        edge: how far the contacts stay from the edges of their faces, over the radius of the ball.
        out_H: (3,) the direction out of the palm; by default the axis of H that is nearest to the way from the fingers' bases
            to their tips at rest.
        seed: of the guesses.

    Raises:
        InvalidInput: an argument that is not allowed, or no hold was found. The field is then ``body``, and the error says what
            the best guess misses; or ``travel``, where it misses nothing else, with the way and what stops it.
        UnknownName: a finger that the hand does not have.
    """
    if not isinstance(body.shape, ClosedFormShape):
        given = None if body.shape is None else type(body.shape).__name__
        raise InvalidInput("body.shape", given, "a sphere, a cylinder or a box, whose distances have a closed form")
    kinematics = BatchKinematics(hand)
    requirements = GeometryRequirements(
        arrays.check_number(clearance, "clearance", minimum=0.0),
        arrays.check_number(edge, "edge", minimum=0.0),
        _palm_direction(hand, kinematics) if out_H is None else _unit(out_H),
        _TRAVEL if travel is None else arrays.check_number(travel, "travel", minimum=0.0),
    )
    load = LoadRequirements(
        hand=hand,
        body=body,
        friction=arrays.check_number(friction, "friction", above=0.0),
        max_normal=arrays.check_number(max_normal, "max_normal", above=0.0),
        gravities=_gravities(gravity_H),
        margin=arrays.check_number(margin, "margin", minimum=0.0),
    )
    fields.check_integer(seed, "seed", minimum=0, maximum=2**32 - 1)
    attempts = [(requirements.travel, _DESCENTS)]
    if travel is None:  # a wish only, not sought as long: what must move as well may find no place at all
        attempts = [(requirements.travel, _DESCENTS // 2), (0.0, _DESCENTS)]
    for each, descents in attempts:
        best = _best_candidate(load, kinematics, dataclasses.replace(requirements, travel=each), fingers, seed, descents)
        is_unmovable = best.grasp is not None and 0.0 < best.penalty <= UNMOVABLE_PENALTY
        if best.grasp is not None and (not best.fault or (is_unmovable and travel is None)):
            return best.grasp
    who = "any three or four fingers" if fingers is None else ", ".join(fingers)
    if is_unmovable:
        raise InvalidInput("travel", travel, f"what {who} of {hand.name} can move what they hold by: {best.fault}")
    raise InvalidInput("body", type(body.shape).__name__, f"what {who} of {hand.name} can hold: {best.fault}")


def _best_candidate(
    load: LoadRequirements,
    kinematics: BatchKinematics,
    requirements: GeometryRequirements,
    fingers: Sequence[str] | None,
    seed: int,
    descents: int,
) -> CandidateResult:
    """The best of all candidates, of the first sets of fingers of which some holds and moves the object."""
    rng = np.random.default_rng(seed)
    shape, found = load.body.shape, list[CandidateResult]()
    assert isinstance(shape, ClosedFormShape)  # find_grasp refused others
    for sets in _finger_sets(load.hand, fingers):
        goals = [SearchGoal(load.hand, kinematics, shape, chosen, requirements) for chosen in sets]
        found += _candidates(goals, load, rng, descents)
        if any(not one.fault for one in found):
            break
    return min(found, key=lambda one: (one.penalty, -one.quality))


def _candidates(
    goals: Sequence[SearchGoal], load: LoadRequirements, rng: np.random.Generator, descents: int
) -> list[CandidateResult]:
    """The best guesses of all goals, brought down one by one until enough of them are holds."""
    guesses = [(goal, _guesses(goal, rng)) for goal in goals]
    costs = [np.square(goal.residuals(candidates)).sum(axis=1) for goal, candidates in guesses]
    order = sorted((cost, g, b) for g, each in enumerate(costs) for b, cost in enumerate(each.tolist()))
    found: list[CandidateResult] = []
    for _, g, b in order[:descents]:
        goal, candidates = guesses[g]
        candidates = _candidate(candidates, b)
        for preference_weight in _PREFERENCE_WEIGHTS:
            candidates = _descend(goal, candidates, preference_weight)
            one = check_candidate(goal, candidates, load)
            if not _NEARLY > one.penalty - 1.0 > 0.0:
                break
        found.append(one)
        touching = [one for one in found if one.grasp is not None]
        if sum(one.penalty <= UNMOVABLE_PENALTY for one in touching) >= _ENOUGH_LOADED or len(touching) >= _ENOUGH_TOUCHING:
            break
    return found


# ── guesses ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _guesses(goal: SearchGoal, rng: np.random.Generator) -> Candidates:
    """Postures about rest; the object between one finger and the others, an axis of it along the line between them."""
    B, N, hand = _SAMPLES, len(goal.fingers), goal.hand
    half = (hand.q_upper - hand.q_lower) / 2.0
    lower, upper = _search_limits(hand)
    q = np.clip(goal.rest + _POSTURE_SPREAD * half * rng.uniform(-1.0, 1.0, (B, hand.n)), lower, upper)
    tips = goal.tips(q)
    rows, alone = np.arange(B), rng.integers(N, size=B)
    one = tips[rows, alone]
    others = (tips.sum(axis=1) - one) / (N - 1)
    p_HO = (one + others) / 2.0
    R_HO = _random_axes(one - others, rng)
    lam = np.full((B, N), 0.5 / (N - 1))
    lam[rows, alone] = 0.5
    p_O = ((tips - p_HO[:, None]) @ R_HO).reshape(-1, 3)
    face = goal.evaluate_faces(p_O).face_distance.argmax(axis=1).reshape(B, N)
    return Candidates(np.hstack([q, p_HO, np.zeros((B, 3)), lam]), R_HO, face)


def _random_axes(along: Array, rng: np.random.Generator) -> Array:
    """(B, 3, 3) axes, one of which, any, lies along a vector, and which are turned about it at random."""
    B = len(along)
    x = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    y = np.cross(x, rng.normal(size=(B, 3)))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    axes = np.stack([x, y, np.cross(x, y)], axis=-1)
    first = rng.integers(3, size=B)
    return np.asarray(np.take_along_axis(axes, ((np.arange(3) - first[:, None]) % 3)[:, None, :], axis=2))


def _candidate(candidates: Candidates, b: int) -> Candidates:
    return Candidates(candidates.x[b : b + 1], candidates.R_start[b : b + 1], candidates.face[b : b + 1])


def _search_limits(hand: Hand) -> tuple[Array, Array]:
    aside = _LIMIT_SHARE * (hand.q_upper - hand.q_lower)
    return hand.q_lower + aside, hand.q_upper - aside


# ── descent ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _descend(goal: SearchGoal, start: Candidates, preference_weight: float) -> Candidates:
    """The guess, down to where least squares brings it, and then onto the surface exactly."""
    from scipy.optimize import least_squares  # here: it takes long to import, and solving does without

    hand, N = goal.hand, len(goal.fingers)
    lower, upper = _search_limits(hand)
    free = np.full(6, np.inf)
    bounds = (np.concatenate([lower, -free, np.full(N, 0.1)]), np.concatenate([upper, free, np.ones(N)]))
    scale = np.concatenate([np.ones(hand.n), np.full(3, 0.05), np.ones(3), np.ones(N)])

    def many(x: Array) -> Candidates:
        return Candidates(x, np.repeat(start.R_start, len(x), axis=0), np.repeat(start.face, len(x), axis=0))

    def residuals(x: Array) -> Array:
        return np.asarray(goal.residuals(many(x[None]), preference_weight)[0])

    def jacobian(x: Array) -> Array:
        r = goal.residuals(many(np.vstack([x, x + _STEP * np.eye(len(x))])), preference_weight)
        return np.asarray((r[1:] - r[0]).T / _STEP)

    result = least_squares(
        residuals,
        np.clip(start.x[0], *bounds),
        jacobian,
        np.asarray(bounds),
        "trf",
        x_scale=scale,
        ftol=1e-4,
        xtol=1e-6,
        gtol=1e-6,
        max_nfev=80,
    )
    x = _project_to_contact(goal, many, result.x, scale)
    return many(np.concatenate([np.clip(x[: hand.n], hand.q_lower, hand.q_upper), x[hand.n :]])[None])


def _project_to_contact(goal: SearchGoal, many: Any, x: Array, scale: Array) -> Array:
    """The nearest variables at which every ball touches: Newton's steps of least length on ``touch`` = 0."""
    for _ in range(8):
        step = 1e-6 * np.eye(len(x))
        contact_distance = goal.measure(many(np.vstack([x, x + step, x - step]))).contact_distance
        if np.abs(contact_distance[0]).max() < _CONTACT_TOLERANCE:
            break
        J = (contact_distance[1 : len(x) + 1] - contact_distance[len(x) + 1 :]).T / 2e-6 * scale
        x = x - scale * (np.linalg.pinv(J) @ contact_distance[0])
    return x


# ── arguments ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _finger_sets(hand: Hand, fingers: Sequence[str] | None) -> list[list[tuple[int, ...]]]:
    """The sets of fingers to try; those of one list together, a later list where the earlier ones hold nothing."""
    names = [finger.name for finger in hand.fingers]
    if fingers is None:
        thumbs = {i for i, name in enumerate(names) if "thumb" in name.lower()}
        lists: list[list[tuple[int, ...]]] = []
        for natural in (True, False):
            for size in (3, 4):
                every = itertools.combinations(range(len(names)), size)
                lists.append([chosen for chosen in every if thumbs.issubset(chosen) is natural])
        return [each for each in lists if each]
    chosen = () if isinstance(fingers, str) else tuple(names.index(hand.finger(name).name) for name in fingers)
    if len(set(chosen)) < len(chosen) or len(chosen) < 3:
        raise InvalidInput("fingers", fingers, "at least three different fingers: two points cannot close an object")
    return [[chosen]]


def _palm_direction(hand: Hand, kinematics: BatchKinematics) -> Array:
    """The axis of H nearest to the way from the fingers' bases to their tips at rest."""
    rest = kinematics.postures(hand.neutral[None])
    finger_axis = rest.tips[0].mean(axis=0) - rest.sphere_centres[0, kinematics.first].mean(axis=0)
    out = np.zeros(3)
    out[np.abs(finger_axis).argmax()] = np.sign(finger_axis[np.abs(finger_axis).argmax()])
    return freeze(out)


def _unit(out_H: Any) -> Array:
    out = arrays.check_array(out_H, "out_H", (3,))
    if not out.any():
        raise InvalidInput("out_H", out_H, "a direction: not zero")
    return freeze(out / np.linalg.norm(out))


def _gravities(gravity_H: Any) -> Array:
    if gravity_H is None:
        return STANDARD_GRAVITY * np.vstack([np.eye(3), -np.eye(3)])
    if np.ndim(gravity_H) == 1:
        return arrays.check_array(gravity_H, "gravity_H", (3,))[None]
    return arrays.check_array(gravity_H, "gravity_H", (None, 3))
