"""Places on an object that a finger can touch, at one pose of the object.

Random postures of each finger, computed once for each hand, give tip positions. Those whose tip nearly touches the object's
surface are moved onto it. Places near an edge, near the limits of a joint or near another finger are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import Contact
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array, freeze
from graspforce.geometry import Shape
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.hand.hand import Hand
from graspforce.planning.regrasp.tip_paths import reach_places

_POSTURES = 20_000  # of each finger
_NEAR = 0.004  # m: a tip this near to touching is moved onto the surface
_EDGE_RATIO = 0.5  # distance from an edge, divided by the tip's radius
_HEIGHT_SHARE = 0.25  # of that distance: height above the surface from which the normals beside a place are found
_LEAST_DISTANCE = 1e-4  # m of a tip's centre from the surface, so that the direction between them is the normal
_FLAT_COSINE = 0.85  # of the angle between normals that far apart; at an edge they differ by more
_SINGULAR_RATIO = 0.08  # least ratio of a finger's singular values
_LIMIT_MARGIN = 0.05  # rad: least distance of a joint from its limits
_COUNTED = 8  # every so many of the postures, where places are counted
WIDE_CLEARANCE = 0.005  # m: a larger clearance is no better
_GENERATOR_SEED = 0  # the same postures in every search
_KEPT_HANDS = 4  # hands whose postures are kept for the next search


Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """A place that a finger can touch.

    Attributes:
        contact: the contact in O.
        q: (m,) joint positions of the finger, rad.
        clearance: distance of the finger's other links from the object, the palm and obstacles, beyond their margin, m; at most
            `WIDE_CLEARANCE`.
    """

    contact: Contact
    q: Array
    clearance: float


@dataclass(frozen=True, eq=False, slots=True)
class CandidateOptions:
    """Distances that places keep.

    Attributes:
        spacing: least distance between two tips, m.
        scene: collision geometry of hand, object and obstacles; None for no checks.
    """

    spacing: float
    scene: SceneCollision | None


class ContactCandidates:
    """Places that the fingers of a hand can touch on one object.

    Args:
        hand: the hand.
        shape: surface of the object.
        fingers: names of the fingers.
        friction: contact properties of each finger: a contact whose place is replaced.
        options: distances that the places keep.
    """

    def __init__(
        self, hand: Hand, shape: Shape, fingers: Sequence[str], friction: Sequence[Contact], options: CandidateOptions
    ) -> None:
        self._hand, self._shape, self._spacing, scene = hand, shape, options.spacing, options.scene
        self._scenes = {} if scene is None else {name: scene.of_finger(name) for name in fingers}
        self._model = dict(zip(fingers, friction, strict=True))
        self._q, tips = _random_postures(hand)
        self._tips = {name: tips[name] for name in fingers}

    def mean_tips(self, rng: np.random.Generator, count: int) -> Array:
        """Return the means of all fingertips in random postures, (count, 3) in H, m.

        Args:
            rng: generator of the postures.
            count: number of postures.
        """
        tips = [tips[rng.integers(len(tips), size=count)] for tips in self._tips.values()]
        return np.asarray(np.mean(tips, axis=0))

    def count(self, finger: str, motion: BodyMotion) -> int:
        """Return how many of the random postures of a finger nearly touch the object; a share of them is counted.

        Args:
            finger: name of the finger.
            motion: pose of the object.
        """
        centres = (self._tips[finger][::_COUNTED] - motion.p_HO) @ motion.R_HO  # m, in O
        radius = self._hand.finger(finger).tip_radius or 0.0  # m
        return int((np.abs(self._shape.phi(centres) - radius) < _NEAR).sum())

    def find(
        self, finger: str, motion: BodyMotion, q: Array, others: Sequence[str], count: int, rng: np.random.Generator
    ) -> list[Candidate]:
        """Return places that a finger can touch, in random order.

        Args:
            finger: name of the finger.
            motion: pose of the object.
            q: (n,) posture of the hand, rad.
            others: names of the fingers that touch the object.
            count: largest number of places.
            rng: generator of the random order.
        """
        hand, shape = self._hand, self._shape
        radius = hand.finger(finger).tip_radius or 0.0  # m
        centres = (self._tips[finger] - motion.p_HO) @ motion.R_HO  # m, in O
        distance = shape.phi(centres)
        near = np.flatnonzero((np.abs(distance - radius) < _NEAR) & (distance > _LEAST_DISTANCE))
        near = rng.permutation(near)[: 30 * count]
        if not len(near):
            return []
        p_OC, normals = closest_places(shape, centres[near])
        places = p_OC - radius * normals  # m: of the tip, in O
        tips_H = motion.p_HO + places @ motion.R_HO.T
        allowed = self._is_smooth(p_OC, normals, max(radius, _NEAR)) & self._is_clear(finger, tips_H, q, others)
        chosen = np.flatnonzero(allowed)[: 4 * count]
        joints = list(hand.finger(finger).joints)
        starts = np.tile(q, (len(chosen), 1))
        starts[:, joints] = self._q[near[chosen]][:, joints]
        postures, reached = reach_places(hand, finger, starts, tips_H[chosen])
        reached &= self._can_move(finger, postures)
        found: list[Candidate] = []
        for k, posture in zip(chosen[reached], postures[reached], strict=True):
            clearance = self._clearance(finger, motion, posture)
            if clearance < 0.0:
                continue
            model = self._model[finger]
            contact = Contact(
                position=p_OC[k],
                normal=normals[k],
                friction=model.friction,
                model=model.model,
                torsional_friction=model.torsional_friction,
                max_normal=model.max_normal,
            )
            found.append(Candidate(contact, freeze(posture[joints]), clearance))
            if len(found) == count:
                break
        return found

    def _is_smooth(self, p_OC: Array, normals: Array, radius: float) -> Mask:
        """Return whether the surface about each place has no edge, (K,)."""
        across = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        allowed = np.ones(len(p_OC), dtype=np.bool_)
        distance = _EDGE_RATIO * radius  # m
        for direction in (across, -across, np.cross(normals, across), -np.cross(normals, across)):
            _, beside = closest_places(self._shape, p_OC - _HEIGHT_SHARE * distance * normals + distance * direction)
            allowed &= (beside * normals).sum(axis=1) > _FLAT_COSINE
        return allowed

    def _can_move(self, finger: str, q: Array) -> Mask:
        """Return whether a finger is away from singular postures and from its joint limits, (K,)."""
        hand, joints = self._hand, list(self._hand.finger(finger).joints)
        sigma = np.linalg.svd(hand.tips_along(q, [finger])[1][:, 0][:, :, joints], compute_uv=False)
        lower, upper = hand.q_lower[joints] + _LIMIT_MARGIN, hand.q_upper[joints] - _LIMIT_MARGIN
        inside = ((q[:, joints] > lower) & (q[:, joints] < upper)).all(axis=1)
        return np.asarray(inside & (sigma[:, -1] > _SINGULAR_RATIO * sigma[:, 0]))

    def _clearance(self, finger: str, motion: BodyMotion, q: Array) -> float:
        """Return the clearance of a finger's links, m, at most `WIDE_CLEARANCE`; negative if one comes too near."""
        scene = self._scenes.get(finger)
        gap = None if scene is None else scene.least_gap(q, motion.p_HO, motion.R_HO)
        return WIDE_CLEARANCE if scene is None or gap is None else min(gap.distance - scene.margin, WIDE_CLEARANCE)

    def _is_clear(self, finger: str, tips_H: Array, q: Array, others: Sequence[str]) -> Mask:
        """Return whether a tip at each place keeps its distance from the other tips, (K,)."""
        hand, allowed = self._hand, np.ones(len(tips_H), dtype=np.bool_)
        radius = hand.finger(finger).tip_radius or 0.0  # m
        for name in others:
            least = radius + (hand.finger(name).tip_radius or 0.0) + self._spacing  # m
            allowed &= np.linalg.norm(tips_H - hand.tip_pose(q, name)[0], axis=1) > least
        return allowed


def closest_places(shape: Shape, points: Array) -> tuple[Array, Array]:
    """Return the closest places on the surface to points outside, (K, 3), and the directions towards them, (K, 3).

    The direction is the inward normal; at an edge, where there is none, it is one of those between the faces' normals.
    """
    places = shape.project_to_surface(points)
    towards = places - points
    return places, towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)


@lru_cache(_KEPT_HANDS)
def _random_postures(hand: Hand) -> tuple[Array, dict[str, Array]]:
    """Return random postures of a hand (M, n), rad, and the tip positions (M, 3) of each finger in H, m."""
    q = np.random.default_rng(_GENERATOR_SEED).uniform(hand.q_lower, hand.q_upper, (_POSTURES, hand.n))
    tree = hand.tree()
    p_HL, R_HL = tree.poses_along(q @ hand.T.T + hand.q0)
    return freeze(q), {tip.finger: freeze(p_HL[:, tip.link] + R_HL[:, tip.link] @ tip.p_LF) for tip in tree.tips}
