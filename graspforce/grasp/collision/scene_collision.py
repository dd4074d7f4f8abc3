"""Collision geometry of a scene: the links of a hand, the object that it holds, and obstacles.

Links take the collision shapes of the URDF; see `HandCollision`, which also states the pairs of links that may touch. The
object may touch the links that carry the fingertips of its contacts, and the links that the hand's description allows.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Shape
from graspforce.grasp.collision.least_gap import FramePoses, LeastGap, find_least_gap, sphere_bounds
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.hand.collision import LinkGap, hand_collision
from graspforce.hand.descriptions.contact_description import HELD_OBJECT
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.collision_body import CollisionBody, object_geometry, place, signed_distance

_BASE = -1  # index of the frame H; the moving links are 0 to L − 1 and the object is L


@dataclass(frozen=True, eq=False, slots=True)
class GapAlong:
    """The least distance along a motion.

    Attributes:
        instant: index of the instant.
        gap: the two bodies, their distance and their nearest points then.
        required: distance that they must keep, m.
    """

    instant: int
    gap: LinkGap
    required: float

    @property
    def lack(self) -> float:
        """Distance by which they are too near, m; negative if they keep the required distance."""
        return self.required - self.gap.distance


class SceneCollision:
    """The bodies of a scene and the pairs that must not touch.

    Args:
        hand: the hand.
        shape: surface of the object; None for no object. An implicit surface has no geometry and is left out.
        fingers: fingers whose tips touch the object, by name.
        settings: obstacles and margin; none by default.

    Attributes:
        links: shapes of the links.
        bodies: these shapes, then the object and the obstacles, which are named ``obstacles[0]`` and so on.
        object_frame: index of the object's frame; the moving links come before it.
        pairs: (P, 2) indices of bodies that must not touch.
        margin: distance that they must keep, m.
    """

    def __init__(
        self, hand: Hand, shape: Shape | None = None, fingers: Sequence[str] = (), settings: CollisionSettings | None = None
    ) -> None:
        settings = CollisionSettings() if settings is None else settings
        links = hand_collision(hand)
        self._hand, self._tree, self.margin = hand, hand.tree(), settings.margin
        bodies, pairs = list(links.bodies), list(links.pairs)
        self.links = links.bodies
        geometry, held = object_geometry(shape), len(self._tree.links)
        self.object_frame = held
        touching = {tip.link for tip in self._tree.tips if tip.finger in fingers}
        allowed = hand.description.allowed_contacts
        if geometry is not None:
            pairs += [
                (i, len(bodies))
                for i, link in enumerate(links.bodies)
                if link.frame not in touching and not any(each.covers(link.name, HELD_OBJECT) for each in allowed)
            ]
            bodies.append(CollisionBody.of_geometry(HELD_OBJECT, held, geometry, np.zeros(3), np.eye(3)))
        moving = [i for i, body in enumerate(bodies) if body.frame != _BASE]
        for k, obstacle in enumerate(settings.obstacles):
            pairs += [(i, len(bodies)) for i in moving]
            fixed = object_geometry(obstacle.shape)
            bodies.append(CollisionBody.of_geometry(f"obstacles[{k}]", _BASE, fixed, obstacle.p_HO, obstacle.R_HO))
        self.bodies, self.pairs = tuple(bodies), np.array(pairs, dtype=np.intp).reshape(-1, 2)

    def of_object_and_base(self) -> SceneCollision:
        """Return the scene with only those pairs whose distance does not depend on the hand's posture."""
        reduced = copy.copy(self)
        fixed = [all(self.bodies[i].frame in (_BASE, self.object_frame) for i in pair) for pair in self.pairs]
        reduced.pairs = self.pairs[fixed]
        return reduced

    def of_finger(self, finger: str) -> SceneCollision:
        """Return the scene with only those pairs of one finger's own links with the object, the base and obstacles.

        Args:
            finger: name of the finger.
        """
        reduced, own = copy.copy(self), self._own_frames(finger)
        others = (_BASE, self.object_frame)
        frames = [[self.bodies[i].frame for i in pair] for pair in self.pairs]
        reduced.pairs = self.pairs[[(a in own and b in others) or (b in own and a in others) for a, b in frames]]
        return reduced

    def finger_of(self, name: str, fingers: Sequence[str]) -> str | None:
        """Return the finger that a link belongs to; None for the palm, the object, obstacles and links that fingers share.

        Args:
            name: name of a body.
            fingers: names of the fingers to choose from.
        """
        frames = {body.frame for body in self.bodies if body.name == name}
        return next((finger for finger in fingers if frames & self._own_frames(finger)), None)

    def _own_frames(self, finger: str) -> set[int]:
        """Return the indices of the links that move only one finger."""
        links, chains = self._tree.links, dict[str, list[int]]()
        for tip in self._tree.tips:
            chains[tip.finger], i = [], tip.link
            while i >= 0:
                chains[tip.finger].append(i)
                i = links[i].parent
        others = {i for name, chain in chains.items() if name != finger for i in chain}
        return set(chains[finger]) - others

    def names(self, pair: int) -> tuple[str, str]:
        """Return the names of a pair's bodies.

        Args:
            pair: index of the pair.
        """
        one, other = self.pairs[pair]
        return self.bodies[one].name, self.bodies[other].name

    def least_gap(self, q: Array, p_HO: Array | None = None, R_HO: Array | None = None) -> LinkGap | None:
        """Return the nearest two bodies that must not touch; None if there is no such pair.

        Args:
            q: (n,) joint positions, rad.
            p_HO: (3,) position of the object in H, m; None without an object.
            R_HO: (3, 3) axes of the object in H.
        """
        along = self.least_gap_along(q[None], None if p_HO is None else p_HO[None], None if R_HO is None else R_HO[None])
        return None if along is None else along.gap

    def least_gap_along(self, q: Array, p_HO: Array | None = None, R_HO: Array | None = None) -> GapAlong | None:
        """Return the pair that comes nearest to its required distance in M postures; None if there is no pair.

        Args:
            q: (M, n) joint positions, rad.
            p_HO: (M, 3) positions of the object in H, m; None without an object.
            R_HO: (M, 3, 3) axes of the object in H.
        """
        if not len(self.pairs):
            return None
        poses = self.poses(q, p_HO, R_HO)
        required = self.required(poses)
        least = find_least_gap(self.bodies, self.pairs, poses, required)
        return GapAlong(least.instant, self._gap(least), float(required[least.pair]))

    def poses(self, q: Array, p_HO: Array | None = None, R_HO: Array | None = None) -> FramePoses:
        """Return the poses of the moving links, the object and the base in M postures.

        Args:
            q: (M, n) joint positions, rad.
            p_HO: (M, 3) positions of the object in H, m; None without an object.
            R_HO: (M, 3, 3) axes of the object in H.
        """
        p, R = self._tree.poses_along(q @ self._hand.T.T + self._hand.q0)
        rest, axes = np.zeros((len(q), 1, 3)), np.broadcast_to(np.eye(3), (len(q), 1, 3, 3))
        p_O, R_O = (rest, axes) if p_HO is None or R_HO is None else (p_HO[:, None], R_HO[:, None])
        return FramePoses(np.concatenate([p, p_O, rest], axis=1), np.concatenate([R, R_O, axes], axis=1))

    def required(self, poses: FramePoses) -> Array:
        """Return the distance (P,) that each pair must keep along a motion, m.

        Args:
            poses: poses of the frames at the instants of the motion, the start first and the goal last.
        """
        required = np.full(len(self.pairs), self.margin)
        if self.margin > 0.0:
            ends = FramePoses(poses.p[[0, -1]], poses.R[[0, -1]])
            near = sphere_bounds(self.bodies, self.pairs, ends).min(axis=0) < self.margin
            for pair in np.flatnonzero(near):
                distances = [self.distance(int(pair), ends, instant) for instant in (0, 1)]
                required[pair] = np.clip(min(distances), 0.0, self.margin)
        return required

    def distance(self, pair: int, poses: FramePoses, instant: int) -> float:
        """Return the distance of a pair, m; negative for an overlap.

        Args:
            pair: index of the pair.
            poses: poses of the frames, as `poses` returns them.
            instant: index of the instant.
        """
        one, other = (self.bodies[i] for i in self.pairs[pair])
        places = [place(body, poses.p[instant, body.frame], poses.R[instant, body.frame]) for body in (one, other)]
        return signed_distance(one, places[0], other, places[1])[0]

    def _gap(self, least: LeastGap) -> LinkGap:
        return LinkGap(*self.names(least.pair), least.distance, least.points)
