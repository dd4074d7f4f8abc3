"""Exact distances of a few pairs of bodies, two links or a link and the object, as residuals of the grasp search.

The search's spheres leave out distances within a finger and between a finger and the palm. Where the exact check finds such an
overlap, the search continues with the distances of these pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.shapes.collision_body import CollisionBody, place, signed_distance

_LEAST_DISTANCE = 1e-9  # m: nearest points closer than this have no direction

Pair = tuple[int, int]  # indices of bodies


@dataclass(frozen=True, eq=False, slots=True)
class PairDistances:
    """Pairs of bodies whose distances are computed.

    Args:
        bodies: bodies of the hand's links, then the object.
        pairs: indices of the bodies of each pair.
    """

    bodies: Sequence[CollisionBody]
    pairs: tuple[Pair, ...] = ()

    def near_first(self, p: Sequence[Array], R: Sequence[Array]) -> Array:
        """Return the distances in B postures near the first one, exact there and of first order in the others, (B, P) m.

        With the nearest points a, b and their direction n in the first posture, d = nᵀ (b − a) as both move with their bodies.

        Args:
            p: (B, 3) position of each frame in H, m: of the moving links, the object, and the base.
            R: (B, 3, 3) their axes.
        """
        columns = []
        for pair in self.pairs:
            one, other = (self.bodies[i] for i in pair)
            distance, points = signed_distance(
                one, place(one, p[one.frame][0], R[one.frame][0]), other, place(other, p[other.frame][0], R[other.frame][0])
            )
            apart = points[1] - points[0]
            direction = apart / distance if abs(distance) > _LEAST_DISTANCE else np.zeros(3)
            a, b = (
                p[f] + R[f] @ (R[f][0].T @ (point - p[f][0])) for f, point in zip((one.frame, other.frame), points, strict=True)
            )
            columns.append(distance + ((b - a) - apart) @ direction)
        return np.stack(columns, axis=1)

    def exact(self, p: Sequence[Array], R: Sequence[Array]) -> Array:
        """Return the distances in B postures, (B, P) m.

        Args:
            p: as in `near_first`.
            R: as in `near_first`.
        """
        rows = [[each[b : b + 1] for each in frames] for b in range(len(p[0])) for frames in (p, R)]
        return np.concatenate([self.near_first(*rows[2 * b : 2 * b + 2]) for b in range(len(p[0]))])
