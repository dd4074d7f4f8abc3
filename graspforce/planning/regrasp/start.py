"""A start grasp for regrasps: an object where every finger reaches many places, held so that each finger can step.

Positions of the object are drawn at random: means of the fingertips in random postures. At those where the finger with the
fewest places has most, contacts are drawn at random. The result is a grasp with a wide slip margin without any one of its
fingers, and wide distances between bodies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Shape
from graspforce.grasp.body import Body
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.collision.settings import DEFAULT_COLLISIONS, CollisionSettings
from graspforce.grasp.grasp import Grasp, pad_contact
from graspforce.hand.hand import Hand
from graspforce.planning.regrasp.contact_candidates import WIDE_CLEARANCE, Candidate, CandidateOptions, ContactCandidates
from graspforce.planning.regrasp.holding import HoldingMargin
from graspforce.planning.regrasp.pose_path import PosePath
from graspforce.planning.regrasp.rolling_motion import HeldObject

_POSITIONS = 1500  # that are drawn
_KEPT = 40  # of them, with the most postures near
_PLACES = 40  # of each finger at each position
_USED = 8  # positions, with the most places
_DRAWS = 400  # grasps at each position
_LEAST_MARGIN = 0.05  # N
_COLLISION_CHECKS = 60  # of the best of these


@dataclass(frozen=True, eq=False, slots=True)
class StartOptions:
    """Options of the search for a start grasp.

    Args:
        fingers: names of the fingers. Default: all.
        friction: friction coefficient of the contacts, ≥ 0.
        max_normal: largest normal force of each contact, N.
        R_HO: (3, 3) axes of the object in H. Default: those of H.
        control: settings of the controller.
        collisions: obstacles and margin of the collision checks.
        spacing: least distance between two tips, and of links beyond the margin, m.
        seed: of the random positions and contacts.
    """

    fingers: Sequence[str] | None = None
    friction: float = 0.8
    max_normal: float = 20.0
    R_HO: npt.ArrayLike | None = None
    control: ControlSettings = field(default_factory=ControlSettings)
    collisions: CollisionSettings = DEFAULT_COLLISIONS
    spacing: float = 0.002
    seed: int = 0


def find_regrasp_start(hand: Hand, body: Body, options: StartOptions | None = None) -> Grasp:
    """Return a grasp from which each finger can step while the others hold.

    Args:
        hand: the hand.
        body: the object, with a shape.
        options: fingers, friction and settings.

    Raises:
        InvalidInput: the object has no shape, or no such grasp was found.
        UnknownName: the hand has no such finger.
    """
    options = StartOptions() if options is None else options
    if body.shape is None:
        raise InvalidInput("body.shape", None, "a shape")
    return _StartSearch(hand, body, body.shape, options).run()


class _StartSearch:
    """The search for one object."""

    def __init__(self, hand: Hand, body: Body, shape: Shape, options: StartOptions) -> None:
        names = [finger.name for finger in hand.fingers] if options.fingers is None else options.fingers
        self._hand, self._body, self._shape, self._options = hand, body, shape, options
        self._fingers = tuple(hand.finger(name).name for name in names)
        any_place = Contact([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], options.friction, max_normal=options.max_normal)
        models = [pad_contact(hand, name, any_place) for name in self._fingers]
        self._scene = SceneCollision(hand, shape, self._fingers, options.collisions)
        distances = CandidateOptions(options.spacing, self._scene)
        self._places = ContactCandidates(hand, shape, self._fingers, models, distances)
        self._R = np.eye(3) if options.R_HO is None else np.array(options.R_HO, dtype=float)
        self._rng = np.random.default_rng(options.seed)

    def run(self) -> Grasp:
        """Return the best grasp."""
        best: tuple[float, Grasp] | None = None
        places = [(p_HO, self._places_at(p_HO)) for p_HO in self._positions()]
        places.sort(key=lambda each: -min(len(found) for found in each[1]))
        for p_HO, found_places in places[:_USED]:
            found = self._best_grasp(p_HO, found_places)
            if found is not None and (best is None or found[0] > best[0]):
                best = found
        if best is None:
            wanted = f"an object that {', '.join(self._fingers)} of {self._hand.name} hold when any one of them lets go"
            raise InvalidInput("body", str(self._body), wanted)
        return best[1]

    def _positions(self) -> list[Array]:
        """Return positions of the object where every finger has many places, the best first, (3,), m."""
        drawn = self._places.mean_tips(self._rng, _POSITIONS)
        counts = np.array([min(self._places.count(name, BodyMotion(p, self._R)) for name in self._fingers) for p in drawn])
        order = np.argsort(-counts, kind="stable")
        kept: list[Array] = []
        still = self._scene.of_object_and_base()
        for k in order:
            if counts[k] == 0 or len(kept) == _KEPT:
                break
            gap = still.least_gap(self._hand.neutral, drawn[k], self._R)
            if gap is None or gap.distance > self._scene.margin:
                kept.append(drawn[k])
        return kept

    def _places_at(self, p_HO: Array) -> list[list[Candidate]]:
        """Return places for each finger at a position of the object."""
        motion = BodyMotion(p_HO, self._R)
        return [self._places.find(name, motion, self._hand.neutral, (), _PLACES, self._rng) for name in self._fingers]

    def _best_grasp(self, p_HO: Array, places: list[list[Candidate]]) -> tuple[float, Grasp] | None:
        """Return the score and the grasp at a position with wide margins without any finger, and wide clearance."""
        hand, enough = self._hand, 2.0 * max(self._options.control.slip_margin, _LEAST_MARGIN)  # N
        if not all(places):
            return None
        path = PosePath.turn(p_HO, self._R, [0.0, 0.0, 1.0], 0.1)  # only its start counts
        holding = HoldingMargin(hand, self._body, path, self._options.control, 10.0)
        graded: list[tuple[float, HeldObject]] = []
        for _ in range(_DRAWS):
            chosen = [each[int(self._rng.integers(len(each)))] for each in places]
            if self._is_spaced(chosen):
                state = self._state(chosen)
                margin = min(holding.find_without(state, name) for name in self._fingers)
                if margin > 0.0:
                    graded.append((margin, state))
        graded.sort(key=lambda each: -each[0])
        best: tuple[float, Grasp] | None = None
        for margin, state in graded[:_COLLISION_CHECKS]:
            gap = self._scene.least_gap(state.q, p_HO, self._R)
            clearance = WIDE_CLEARANCE if gap is None else min(gap.distance - self._scene.margin, WIDE_CLEARANCE)
            score = min(margin, enough) / enough + clearance / WIDE_CLEARANCE
            if clearance > 0.0 and (best is None or score > best[0]):
                best = score, Grasp(hand, self._body, self._fingers, state.contacts, state.q, p_HO, self._R)
        return best

    def _is_spaced(self, chosen: list[Candidate]) -> bool:
        """Return whether the tips keep their distance from one another."""
        radii = [self._hand.finger(name).tip_radius or 0.0 for name in self._fingers]  # m
        tips = [each.contact.position - r * each.contact.normal for each, r in zip(chosen, radii, strict=True)]
        pairs = combinations(range(len(tips)), 2)
        return all(np.linalg.norm(tips[i] - tips[j]) > radii[i] + radii[j] + self._options.spacing for i, j in pairs)

    def _state(self, chosen: list[Candidate]) -> HeldObject:
        """Return the state of a grasp with contacts."""
        q = np.array(self._hand.neutral)
        for name, each in zip(self._fingers, chosen, strict=True):
            q[list(self._hand.finger(name).joints)] = each.q
        return HeldObject(0.0, freeze(q), self._fingers, ContactSet.stack([each.contact for each in chosen]))
