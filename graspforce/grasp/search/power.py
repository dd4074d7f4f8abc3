"""Candidates of power grasps: the object lies on the palm, and all fingers close around it.

Many proposals are drawn at once: a posture with open fingers, axes of the object, and a place on the palm between two fingers.
Spheres stand for the links while the fingers close. Proposals are ranked by an estimate of force closure at the first
touches. The best ones become candidates: the collision shapes then approach, close and touch exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.geometry import Solid
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.checks import LoadRequirements
from graspforce.grasp.search.closing import GAP, ClosingFinger, TouchScene
from graspforce.grasp.search.faces import rough_face_distances
from graspforce.grasp.search.sampling import random_axes, search_limits

_BATCH = 400  # proposals that are drawn at once
_KEPT = 80  # proposals of a batch whose closing motion is computed; their open fingers do not overlap the object
_DRAWS = 16  # candidates that are drawn from a batch
_STEPS = 14  # postures of each closing motion, from open to closed
_OPEN_SHARE = (0.3, 1.0)  # of the way from neutral to its open end, at which a closing joint starts
_PLACED_AFTER = (0.3, 1.0)  # share of the closing motion after which the object is placed between two fingers
_CLOSES = 0.7  # probability that a joint which can close its finger turns in the closing motion
_STAY_SHARE = (-0.6, 1.0)  # of the way from neutral to its open end, or to its closed end if negative, at which a joint stays
_OPENINGS = 6  # postures, each nearer to neutral, of which the first without overlaps is taken
_SIDE_SHARE = 0.3  # of half its range around neutral, in which the other joints are sampled
_AT_BASES = 0.3  # share of the places that are drawn around the mean of the fingers' bases
_PLACE_SPREAD = 0.03  # m, of these places
_APPROACH, _BEYOND = 0.02, 0.04  # m: the object's approach begins before its estimated place, and ends beyond it
_APPROACH_STEP = 0.004  # m
_SURFACE_POINTS = 150  # of the object, for its height over the palm
_DEPTH = 0.002  # m: largest overlap of a sphere of an open finger
_DIRECTIONS = 120  # of wrenches, for the estimate of closure
_LEVER = 0.03  # m: moments count as forces at this lever
_PREFERENCE = 2.0  # a candidate is proposal uᵖ N of N, the best first, with p this number and u uniform in (0, 1)


@dataclass(frozen=True, eq=False, slots=True)
class _Proposals:
    """Proposals, the best first.

    Attributes:
        sideways: (B, n) postures of neutral fingers, spread sideways, rad.
        share: (B, n) shares of the way from neutral to the open end of each closing joint, or to its closed end if negative.
        closes: (B, n) whether each joint closes a finger; the other joints stay.
        p_HO: (B, 3) estimated positions of the object in H, m.
        R_HO: (B, 3, 3) its axes.
    """

    sideways: Array
    share: Array
    closes: npt.NDArray[np.bool_]
    p_HO: Array
    R_HO: Array


class PowerSampler:
    """Random candidates of power grasps.

    Args:
        load: the hand, and the friction of the contacts.
        shape: surface of the object.
        kinematics: of the hand.
        scene: the hand and the object.
        fingers: the joints that close the fingers.
        normal: (3,) normal of the palm in H, towards the object.
    """

    def __init__(
        self,
        load: LoadRequirements,
        shape: Solid,
        kinematics: BatchKinematics,
        scene: TouchScene,
        fingers: tuple[ClosingFinger, ...],
        normal: Array,
    ) -> None:
        self._hand, self._shape, self._kinematics, self._scene, self._fingers = load.hand, shape, kinematics, scene, fingers
        hand, self._normal = load.hand, normal
        self._limits, self._friction, self._torsion = search_limits(hand), load.friction, load.pad_friction or 0.0
        self._bases = hand.model.joint_origins(hand.neutral)[kinematics.first_links]
        own = {frame for finger in fingers for frame in finger.frames}
        self._of_palm = np.array([body.frame not in own for body in scene.bodies[:-1]])
        self._signs = np.zeros(hand.n)
        for finger in fingers:
            self._signs[list(finger.joints)] = finger.signs
        rng = np.random.default_rng(0)
        far = rng.normal(size=(_SURFACE_POINTS, 3))
        far *= 2.0 * shape._largest_half_extent / np.linalg.norm(far, axis=1, keepdims=True)
        self._surface = np.asarray(shape.closest_points(shape.centre + far))
        directions = rng.normal(size=(_DIRECTIONS, 6))
        self._directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        self._proposals: _Proposals | None = None
        self._unused: list[int] = []
        self._drawn = 0

    def sample(self, rng: np.random.Generator) -> tuple[Array, Array, Array] | None:
        """Return posture, position and axes of the object of a random candidate; None if it does not get in place.

        Args:
            rng: random generator.
        """
        if self._proposals is None or not self._unused or self._drawn >= _DRAWS:
            self._proposals, self._drawn = self._propose(rng), 0
            self._unused = list(range(len(self._proposals.p_HO)))
        self._drawn += 1
        if not self._unused:
            return None
        b = self._unused.pop(int(rng.random() ** _PREFERENCE * len(self._unused)))
        each = self._proposals
        q = self._open_posture(each.sideways[b], each.share[b])
        if q is None:
            return None
        placed = self._approach(q, each.p_HO[b], each.R_HO[b])
        if placed is None:
            return None
        for f in rng.permutation(len(self._fingers)).tolist():
            q = self._scene.close(self._chosen(self._fingers[f], each.closes[b]), q, placed, each.R_HO[b])
        return q, placed, each.R_HO[b]

    # ── proposals ──────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _propose(self, rng: np.random.Generator) -> _Proposals:
        """Return proposals with two touching fingers, the one with the best estimate of closure first."""
        hand, (lower, upper), B = self._hand, self._limits, _BATCH
        side = rng.uniform(-1.0, 1.0, (B, hand.n))
        side[:, list(hand.common_joints)] = 0.0
        sideways = hand.neutral + _SIDE_SHARE * (upper - lower) / 2.0 * side
        closes = (rng.random((B, hand.n)) < _CLOSES) & (self._signs != 0.0)
        share = np.where(closes, rng.uniform(*_OPEN_SHARE, (B, hand.n)), rng.uniform(*_STAY_SHARE, (B, hand.n)))
        opened = self._opened(sideways, share)
        turn = np.where(closes, np.where(self._signs > 0.0, upper - opened, opened - lower), 0.0)  # rad, as far as it can
        longest = turn.max(axis=1, keepdims=True)
        on_way = opened + self._signs * np.minimum(rng.uniform(*_PLACED_AFTER, (B, 1)) * longest, turn)
        R_HO = random_axes(np.tile(self._normal, (B, 1)), rng)
        p_HO = self._places(self._kinematics.evaluate(on_way).sphere_centres, R_HO, rng)
        gaps = self._distances(self._kinematics.evaluate(opened).sphere_centres[:, None], p_HO, R_HO)[0]
        kept = np.flatnonzero(gaps.min(axis=(1, 2)) >= -_DEPTH)[:_KEPT]
        passed = np.minimum(np.linspace(0.0, 1.0, _STEPS)[:, None] * longest[kept][:, None], turn[kept][:, None])
        path = opened[kept][:, None] + self._signs * passed  # the joints turn at equal rates
        motion = self._kinematics.evaluate(path.reshape(-1, hand.n))
        centres = motion.sphere_centres.reshape(len(kept), _STEPS, len(self._kinematics.sphere_radii), 3)
        score = self._scores(centres, p_HO[kept], R_HO[kept])
        order = np.argsort(-score, kind="stable")
        best = kept[order[score[order] > -np.inf]]
        return _Proposals(sideways[best], share[best], closes[best], p_HO[best], R_HO[best])

    def _opened(self, sideways: Array, share: Array) -> Array:
        """Return the postures (…, n) with closing joints on the way from neutral to their open ends, rad."""
        hand, (lower, upper) = self._hand, self._limits
        end = np.where((self._signs > 0.0) == (share >= 0.0), lower, upper)
        return np.asarray(
            np.clip(np.where(self._signs != 0.0, hand.neutral + np.abs(share) * (end - hand.neutral), sideways), lower, upper)
        )

    def _places(self, centres: Array, R_HO: Array, rng: np.random.Generator) -> Array:
        """Return positions (B, 3) of the object on the palm, m: between spheres of two fingers, or near the fingers' bases.

        Args:
            centres: (B, S, 3) centres of the fingers' spheres on the way, m.
            R_HO: (B, 3, 3) axes of the object.
            rng: random generator.
        """
        B, n = len(centres), self._normal
        owner, rows = self._kinematics.sphere_finger, np.arange(B)
        ends = []
        pairs = np.array([rng.permutation(len(self._fingers))[[0, -1]] for _ in range(B)])  # equal for a single finger
        for f in pairs.T:
            first = self._kinematics.first_sphere[f]
            count = np.bincount(owner)[f]
            s = first + (count * rng.uniform(0.3, 1.0, B)).astype(int).clip(max=count - 1)
            ends.append(centres[rows, s])
        point = (ends[0] + ends[1]) / 2.0
        near = rng.random(B) < _AT_BASES
        point[near] = self._bases.mean(axis=0) + _PLACE_SPREAD * rng.uniform(-1.0, 1.0, (int(near.sum()), 3))
        point -= (R_HO @ self._shape.centre) + (point @ n)[:, None] * n
        surface = point[:, None] + self._surface @ R_HO.swapaxes(1, 2)
        height = (self._palm_height(surface) - surface @ n).max(axis=1)  # -inf beside the palm
        return np.asarray(point + np.where(np.isfinite(height), height, 0.0)[:, None] * n)

    def _palm_height(self, points: Array) -> Array:
        """Return the height (…) of the palm along its normal above or below points (…, 3) of H, m; -inf beside the palm."""
        poses, found = self._scene.link_places(self._hand.neutral), np.full(points.shape[:-1], -np.inf)
        for body in (each for each, chosen in zip(self._scene.bodies[:-1], self._of_palm, strict=True) if chosen):
            T = poses[body.frame]
            R = T[:3, :3] @ body.R_FG
            local, along = (points - T[:3, 3] - T[:3, :3] @ body.p_FB) @ R, self._normal @ R
            along = np.where(np.abs(along) < 1e-9, 1e-9, along)
            ends = np.stack([(-body.half_extents - local) / along, (body.half_extents - local) / along])
            enter, leave = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
            found = np.where(enter < leave, np.maximum(found, leave + points @ self._normal), found)
        return found

    def _scores(self, centres: Array, p_HO: Array, R_HO: Array) -> Array:
        """Return estimates of closure (B,), the larger the better; -inf if less than two fingers touch.

        A touch beyond an edge does not count. The estimate is the least support of the wrenches of unit normal forces in fixed
        directions.
        """
        kinematics, B = self._kinematics, len(centres)
        local = (centres - p_HO[:, None, None]) @ R_HO[:, None]
        distance, inward, inside = self._distances(centres, p_HO, R_HO)
        contacts = [(self._surface_support(R_HO), R_HO.swapaxes(1, 2) @ self._normal, np.ones(B, dtype=bool))]
        rows = np.arange(B)
        for f in range(len(self._fingers)):
            own = np.flatnonzero(kinematics.sphere_finger == f)
            least, nearest = distance[:, :, own].min(axis=2), own[distance[:, :, own].argmin(axis=2)]
            k = (least < 0.0).argmax(axis=1)
            s = nearest[rows, k]
            normal = inward[rows, k, s]
            p = local[rows, k, s] + kinematics.sphere_radii[s][:, None] * normal
            contacts.append((p, normal, (least < 0.0).any(axis=1) & (inside[rows, k, s] > 0.0)))
        count = sum(touches.astype(int) for _, _, touches in contacts)
        support = np.stack([np.where(t[:, None], self._support(p, n), -np.inf) for p, n, t in contacts]).max(axis=0).min(axis=1)
        return np.asarray(np.where(count < 3, -np.inf, support))

    def _distances(self, centres: Array, p_HO: Array, R_HO: Array) -> tuple[Array, Array, Array]:
        """Return distances (B, K, S) of spheres from the object, m, inward normals in O there, and distances from edges, m.

        Args:
            centres: (B, K, S, 3) centres of the fingers' spheres, m.
            p_HO: (B, 3) positions of the object, m.
            R_HO: (B, 3, 3) its axes.
        """
        shape, radii = centres.shape[:3], self._kinematics.sphere_radii
        local = (centres - p_HO[:, None, None]) @ R_HO[:, None]
        near = np.linalg.norm(local - self._shape.centre, axis=3) < np.sqrt(3.0) * self._shape._largest_half_extent + radii
        distance, inward, inside = np.full(shape, np.inf), np.zeros((*shape, 3)), np.zeros(shape)
        if near.any():
            faces = rough_face_distances(self._shape, local[near])
            face, rows = faces.face_distance.argmax(axis=1), np.arange(np.count_nonzero(near))
            distance[near] = faces.face_distance[rows, face]
            inward[near] = faces.normal[rows, face]
            inside[near] = faces.edge_distance[rows, face]
        return distance - radii, inward, inside

    def _surface_support(self, R_HO: Array) -> Array:
        """Return the points (B, 3) of the object, in O, that touch the palm first, m."""
        down = R_HO.swapaxes(1, 2) @ -self._normal
        height = down @ self._surface.T
        lowest = np.isclose(height, height.max(axis=1, keepdims=True), atol=1e-3)
        return np.asarray((lowest @ self._surface) / lowest.sum(axis=1, keepdims=True))

    def _support(self, p: Array, normal: Array) -> Array:
        """Return the support (B, D) of the wrenches of contacts at points (B, 3) with inward normals (B, 3), in O."""
        a, b = self._directions[:, :3], self._directions[:, 3:]
        g = a + np.cross(b[None], (p - self._shape.centre)[:, None]) / _LEVER  # f·(a + b × p) = f·a + (p × f)·b
        along = (g * normal[:, None]).sum(axis=2)
        across = np.linalg.norm(g - along[:, :, None] * normal[:, None], axis=2)
        return np.asarray(along + self._friction * across + self._torsion / _LEVER * np.abs(normal @ b.T))

    @staticmethod
    def _chosen(finger: ClosingFinger, closes: npt.NDArray[np.bool_]) -> ClosingFinger:
        """Return a finger with those of its joints that close it in a proposal."""
        kept = [(j, sign) for j, sign in zip(finger.joints, finger.signs, strict=True) if closes[j]]
        return replace(finger, joints=tuple(j for j, _ in kept), signs=tuple(sign for _, sign in kept))

    # ── candidates ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _open_posture(self, sideways: Array, share: Array) -> Array | None:
        """Return a posture between neutral and the open ends of the closing joints; None if links overlap there."""
        sideways, share = np.array(sideways), np.array(share)
        for _ in range(_OPENINGS):
            q = self._opened(sideways, share)
            overlapping = self._scene.overlapping_links(q)
            if not overlapping:
                return q
            for finger, each in zip(self._fingers, self._hand.fingers, strict=True):
                if overlapping & set(finger.frames):  # nearer to neutral
                    own = list(each.joints)
                    share[own], sideways[own] = 0.5 * share[own], 0.5 * (sideways[own] + self._hand.neutral[own])
        return None

    def _approach(self, q: Array, p_HO: Array, R_HO: Array) -> Array | None:
        """Return where the object first touches the palm, along its normal; None if it overlaps other links there."""
        start, of_palm = p_HO + _APPROACH * self._normal, np.flatnonzero(self._of_palm)

        def gap(s: float) -> float:
            return self._scene.part_gap(q, start - s * self._normal, R_HO, of_palm)

        s = self._scene.first_touch(gap, _APPROACH + _BEYOND, _APPROACH_STEP)
        placed = start - s * self._normal
        if s == 0.0 or s >= _APPROACH + _BEYOND:
            return None
        return None if self._scene.object_gaps(q, placed, R_HO, GAP)[0].min() < 0.0 else np.asarray(placed)
