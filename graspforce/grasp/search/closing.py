"""Closing of fingers around an object: every joint turns until a link beyond it touches.

Distances are those of the collision shapes. A motion ends where the least distance falls to `GAP`, found by Brent's method, so
that links touch the object without overlap.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.geometry import Solid
from graspforce.hand.collision import HandCollision
from graspforce.hand.descriptions.contact_description import HELD_OBJECT
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.collision_body import CollisionBody, object_geometry, place, signed_distance

GAP = 1e-6  # m, of bodies that touch
_STEP = 0.05  # rad, or 2.5 mm of a prismatic joint, between evaluations of a motion
_SLIDE = 0.05  # m, that counts as 1 rad
_NEAR = 1.0  # m: larger distances are not computed exactly

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class ClosingFinger:
    """The joints that close a finger.

    Attributes:
        name: name of the finger.
        joints: indices of the joints that close it, base first.
        signs: direction of each, 1.0 or −1.0.
        frames: indices of the moving links that belong to the finger alone, base first.
    """

    name: str
    joints: tuple[int, ...]
    signs: tuple[float, ...]
    frames: tuple[int, ...]


class TouchScene:
    """A hand and an object whose links may touch the object, but not overlap it or one another.

    Args:
        hand: the hand.
        collision: its collision shapes.
        shape: surface of the object.

    Attributes:
        bodies: bodies of the links, then the object.
    """

    def __init__(self, hand: Hand, collision: HandCollision, shape: Solid) -> None:
        self._hand, held = hand, hand.T.shape[0]
        thing = CollisionBody.of_geometry(HELD_OBJECT, held, object_geometry(shape), np.zeros(3), np.eye(3))
        self.bodies = (*collision.bodies, thing)
        self._object = len(collision.bodies)
        self._links = np.array(collision.pairs, dtype=np.intp).reshape(-1, 2)
        self._frames = np.array([body.frame for body in self.bodies])
        self._centres = np.array([[*body.p_FB, 1.0] for body in self.bodies])[..., None]
        self._radii = np.array([body.radius for body in self.bodies])
        self._known_pairs: dict[tuple[int, ...], Indices] = {}
        turned = hand.T != 0.0
        self._moves = np.array([self._ancestors(frame) for frame in range(held)]) @ turned > 0.0  # (frames, joints)

    def moved_by(self, joint: int) -> Indices:
        """Return the indices of the moving links that a joint moves.

        Args:
            joint: index of the actuated joint.
        """
        return np.flatnonzero(self._moves[:, joint])

    def object_gaps(self, q: Array, p_HO: Array, R_HO: Array, near: float = _NEAR) -> tuple[Array, Array]:
        """Return the distances (L,) of all links' bodies from the object, m, and the nearest points (L, 2, 3) in H.

        Args:
            q: (n,) posture, rad.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object.
            near: distance above which a lower bound is returned, m.
        """
        pairs = np.stack([np.arange(self._object), np.full(self._object, self._object)], axis=1)
        return self._distances(self._poses(q, p_HO, R_HO), pairs, near)

    def part_gap(self, q: Array, p_HO: Array, R_HO: Array, chosen: Indices, near: float = 0.02) -> float:
        """Return the least distance of some links' bodies from the object, m; `near` if it is larger.

        Args:
            q: (n,) posture, rad.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            chosen: indices of the bodies.
            near: distance above which bodies count as far, m.
        """
        pairs = np.stack([chosen, np.full(len(chosen), self._object)], axis=1)
        return float(self._distances(self._poses(q, p_HO, R_HO), pairs, near)[0].min(initial=near))

    def link_gap(self, q: Array) -> float:
        """Return the least distance of links that must not touch, m.

        Args:
            q: (n,) posture, rad.
        """
        poses = self._poses(q, np.zeros(3), np.eye(3))
        return float(self._distances(poses, self._links, GAP)[0].min(initial=np.inf))

    def overlapping_links(self, q: Array) -> set[int]:
        """Return the indices of the moving links that overlap another link, with -1 for the base.

        Args:
            q: (n,) posture, rad.
        """
        distances, _ = self._distances(self._poses(q, np.zeros(3), np.eye(3)), self._links, GAP)
        return {int(frame) for frame in self._frames[self._links[distances < 0.0]].ravel()}

    def first_touch(self, gap: Callable[[float], float], longest: float, step: float) -> float:
        """Return the largest s ≤ `longest` with gap ≥ `GAP` on the way from 0, in the resolution of the steps.

        Args:
            gap: least distance at s, m, that decreases to an overlap.
            longest: largest s, rad or m.
            step: distance of evaluations.
        """
        from scipy.optimize import brentq  # imported here, because it is slow to import

        s, after = 0.0, min(step, longest)
        while s < longest:
            if gap(after) < GAP:
                low = float(brentq(lambda x: gap(x) - 1.5 * GAP, s, after, xtol=1e-12)) if gap(s) > 1.5 * GAP else s
                return low if gap(low) >= 0.0 else s
            s, after = after, min(after + step, longest)
        return longest

    def close(self, finger: ClosingFinger, q: Array, p_HO: Array, R_HO: Array) -> Array:
        """Return the posture after a finger has closed: its joints turn together, until a link beyond each of them touches.

        Args:
            finger: the finger.
            q: (n,) posture, rad.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object.
        """
        hand, free = self._hand, list(range(len(finger.joints)))
        scale = np.array([_SLIDE if joint.is_prismatic else 1.0 for joint in hand.joints])
        while free:
            d = np.zeros(hand.n)
            for k in free:
                d[finger.joints[k]] = finger.signs[k] * scale[finger.joints[k]]
            room = np.where(d > 0.0, hand.q_upper - q, q - hand.q_lower)[d != 0.0] / np.abs(d[d != 0.0])
            moving = np.flatnonzero(self._moves @ (d != 0.0))
            start = q

            def gap(s: float, start: Array = start, d: Array = d, moving: Indices = moving) -> float:
                return self.least_gap(start + s * d, p_HO, R_HO, moving)

            s = self.first_touch(gap, float(room.min()), _STEP)
            q = start + s * d
            touching = self._touching(q, p_HO, R_HO, moving) if s < room.min() else ()
            stopped = [k for k in free if set(self.moved_by(finger.joints[k])) & set(touching)]
            limited = [k for k in free if room[free.index(k)] <= s + 1e-9]
            if not stopped and not limited:
                stopped = free[:1]  # the finger touches another one: without its first joint it may get past it
            free = [k for k in free if k not in stopped and k not in limited]
        return q

    def least_gap(self, q: Array, p_HO: Array, R_HO: Array, moving: Indices) -> float:
        """Return the least distance of some links from the object and from links that they must not touch, m."""
        poses, near = self._poses(q, p_HO, R_HO), 0.02
        return float(self._distances(poses, self._pairs_of(moving), near)[0].min(initial=near))

    def link_places(self, q: Array) -> Array:
        """Return the poses (L + 2, 4, 4) of the moving links in H, followed by two identities for the object and the base.

        Args:
            q: (n,) posture, rad.
        """
        return self._poses(q, np.zeros(3), np.eye(3))

    def _pairs_of(self, moving: Indices) -> Indices:
        """Return the pairs of some moving links with the object, and with links that they must not touch."""
        key = tuple(moving.tolist())
        if key not in self._known_pairs:
            own = np.flatnonzero(np.isin(self._frames[:-1], moving))
            pairs = np.stack([own, np.full(len(own), self._object)], axis=1)
            others = self._links[np.isin(self._frames[self._links], moving).any(axis=1)]
            self._known_pairs[key] = np.concatenate([pairs, others])
        return self._known_pairs[key]

    def _touching(self, q: Array, p_HO: Array, R_HO: Array, moving: Indices) -> Collection[int]:
        """Return the moving links, of some, that touch the object."""
        gaps, _ = self.object_gaps(q, p_HO, R_HO, 1e-3)
        frames = self._frames[:-1][gaps <= 4.0 * GAP]
        return set(frames.tolist()) & set(moving.tolist())

    def _poses(self, q: Array, p_HO: Array, R_HO: Array) -> Array:
        """Return the poses (L + 2, 4, 4) of the moving links, the object and the base."""
        links = self._hand.model.joint_poses(q)
        poses = np.concatenate([links, np.tile(np.eye(4), (2, 1, 1))])
        poses[-2, :3, 3], poses[-2, :3, :3] = p_HO, R_HO
        return poses

    def _distances(self, poses: Array, pairs: Indices, near: float) -> tuple[Array, Array]:
        """Return the distances of pairs, and their nearest points; bounds by spheres where these are above `near`."""
        centres = (poses[self._frames] @ self._centres)[:, :3, 0]
        one, other = pairs.T
        distances = np.linalg.norm(centres[one] - centres[other], axis=1) - self._radii[one] - self._radii[other]
        points = np.zeros((len(pairs), 2, 3))
        for k in np.flatnonzero(distances < near).tolist():
            first, second = (self.bodies[i] for i in pairs[k])
            places = [place(body, poses[body.frame, :3, 3], poses[body.frame, :3, :3]) for body in (first, second)]
            distances[k], points[k] = signed_distance(first, places[0], second, places[1])
        return distances, points

    def _ancestors(self, frame: int) -> Array:
        """Return an array (n_full,) with 1 for a moving link and the links before it."""
        tree, chain = self._hand.tree().links, np.zeros(self._hand.T.shape[0])
        while frame >= 0:
            chain[frame] = 1.0
            frame = tree[frame].parent
        return chain
