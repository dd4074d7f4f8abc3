"""The least distance of many pairs of bodies at many instants, with few exact distances.

A distance d at one instant bounds that at another from below by d − δ, where δ is the largest displacement of one body relative
to the other between the instants. The search refines the pair and the instant with the lowest bound until no bound is below
the least distance found. First bounds come from spheres and boxes around the bodies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.hand.shapes.collision_body import CollisionBody, place, signed_distance

_TOLERANCE = 1e-5  # m: the result exceeds the least distance by at most this,
_RELATIVE_TOLERANCE = 0.02  # or by this share of it


@dataclass(frozen=True, eq=False, slots=True)
class FramePoses:
    """Poses of the frames of a scene at M instants.

    Attributes:
        p: (M, F, 3) positions in H, m.
        R: (M, F, 3, 3) axes in H.
    """

    p: Array
    R: Array


@dataclass(frozen=True, eq=False, slots=True)
class LeastGap:
    """The pair of bodies that come nearest to their required distance.

    Attributes:
        pair: index of the pair.
        instant: index of the instant.
        distance: their distance then, m; negative for an overlap.
        points: (2, 3) their nearest points in H, m.
    """

    pair: int
    instant: int
    distance: float
    points: Array


def find_least_gap(
    bodies: Sequence[CollisionBody], pairs: npt.NDArray[np.intp], poses: FramePoses, required: Array
) -> LeastGap:
    """Return the pair and the instant with the least distance beyond the required one.

    Args:
        bodies: the bodies.
        pairs: (P, 2) indices of the bodies of each pair, at least one pair.
        poses: poses of the frames at M instants.
        required: (P,) distance that each pair must keep, m.
    """
    bounds = sphere_bounds(bodies, pairs, poses) - required
    lowest = bounds.min(axis=0)
    motions: dict[int, _RelativeMotion] = {}
    best, least = np.inf, LeastGap(0, 0, np.inf, np.zeros((2, 3)))
    while True:
        pair = int(lowest.argmin())
        if lowest[pair] >= best - max(_TOLERANCE, _RELATIVE_TOLERANCE * best):
            return least
        one, other = (bodies[i] for i in pairs[pair])
        if pair not in motions:
            motions[pair] = _RelativeMotion.of(one, other, poses)
            bounds[:, pair] = np.maximum(bounds[:, pair], motions[pair].box_bounds() - required[pair])
        else:
            instant = int(bounds[:, pair].argmin())
            distance, points = signed_distance(one, _place_at(one, poses, instant), other, _place_at(other, poses, instant))
            excess = distance - required[pair]
            if excess < best:
                best, least = excess, LeastGap(pair, instant, distance, points)
            bounds[:, pair] = np.maximum(bounds[:, pair], excess - motions[pair].displacements(instant))
        lowest[pair] = bounds[:, pair].min()


def find_near_pairs(
    bodies: Sequence[CollisionBody], pairs: npt.NDArray[np.intp], poses: FramePoses, required: Array, within: float
) -> list[tuple[int, float]]:
    """Return the pairs that come within a distance of their required one, with their least distance beyond it, m.

    Args:
        bodies: the bodies.
        pairs: (P, 2) indices of the bodies of each pair.
        poses: poses of the frames at M instants.
        required: (P,) distance that each pair must keep, m.
        within: largest distance beyond it, m.
    """
    lowest = (sphere_bounds(bodies, pairs, poses) - required).min(axis=0) if len(pairs) else np.zeros(0)
    found = []
    for pair in np.flatnonzero(lowest < within).tolist():
        least = find_least_gap(bodies, pairs[[pair]], poses, required[[pair]])
        if least.distance - required[pair] < within:
            found.append((pair, least.distance - float(required[pair])))
    return found


def sphere_bounds(bodies: Sequence[CollisionBody], pairs: npt.NDArray[np.intp], poses: FramePoses) -> Array:
    """Return the distances (M, P) of the spheres around the bodies, m, at most the bodies' own.

    Args:
        bodies: the bodies.
        pairs: (P, 2) indices of the bodies of each pair.
        poses: poses of the frames at M instants.
    """
    frames, p_FB = [body.frame for body in bodies], np.array([body.p_FB for body in bodies])
    centres = poses.p[:, frames] + (poses.R[:, frames] @ p_FB[:, :, None])[..., 0]
    radii = np.array([body.radius for body in bodies])
    one, other = pairs.T
    x = centres[:, one] - centres[:, other]
    return np.asarray(np.sqrt((x * x).sum(axis=2)) - radii[one] - radii[other])


@dataclass(frozen=True, eq=False, slots=True)
class _RelativeMotion:
    """The motion of the smaller body of a pair relative to the larger one, at M instants.

    Attributes:
        centres: (M, 3) centre of the smaller body in the axes of the larger one's box, from the box's centre, m.
        R: (M, 9) its axes there.
        half_extents: (3,) of the larger one's box, m.
        radius: of the sphere around the smaller body, m.
        arm: radius that rotation moves, zero for a sphere, m.
    """

    centres: Array
    R: Array
    half_extents: Array
    radius: float
    arm: float

    @classmethod
    def of(cls, one: CollisionBody, other: CollisionBody, poses: FramePoses) -> _RelativeMotion:
        large, small = (one, other) if one.radius >= other.radius else (other, one)
        R_HL = poses.R[:, large.frame]
        p_HL = poses.p[:, large.frame] + R_HL @ large.p_FB
        p_HS = poses.p[:, small.frame] + poses.R[:, small.frame] @ small.p_FB
        R_HB = R_HL @ large.R_FG
        centres = ((p_HS - p_HL)[:, None] @ R_HB)[:, 0]
        R = (R_HB.swapaxes(1, 2) @ poses.R[:, small.frame]).reshape(-1, 9)
        return cls(centres, R, large.half_extents, small.radius, 0.0 if small.kind == "sphere" else small.radius)

    def box_bounds(self) -> Array:
        """Return the distances (M,) of the smaller body's sphere from the larger body's box, m."""
        x = np.abs(self.centres) - self.half_extents
        outside = np.maximum(x, 0.0)
        return np.asarray(np.sqrt((outside * outside).sum(axis=1)) + np.minimum(x.max(axis=1), 0.0) - self.radius)

    def displacements(self, instant: int) -> Array:
        """Return the largest displacements (M,) of points of the smaller body from an instant to all instants, m."""
        x = self.centres - self.centres[instant]
        moved = np.sqrt((x * x).sum(axis=1))
        if self.arm > 0.0:
            turn = self.R - self.R[instant]
            moved += self.arm * np.sqrt((turn * turn).sum(axis=1) / 2.0)  # ‖ΔR‖₂ = ‖ΔR‖_F/√2 of two rotations
        return np.asarray(moved)


def _place_at(body: CollisionBody, poses: FramePoses, instant: int) -> object:
    return place(body, poses.p[instant, body.frame], poses.R[instant, body.frame])
