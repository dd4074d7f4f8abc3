"""Twenty objects as triangle meshes, from ellipses along an axis.

Each object is a stack of elliptic rings across its z axis, interpolated between the knots of a table. The layers between
neighbouring rings are convex, so that an engine without concave shapes can represent the object by its layers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from graspforce.core.arrays import Array
from graspforce.geometry import TriangleMesh

_AROUND = 32  # vertices of a ring
_RINGS = 29

# height, half axes along x and y, and offset along x, of each knot, mm
_ROUND = {
    "bottle": [(-40, 15, 15), (-37, 17, 17), (8, 17, 17), (24, 8, 8), (40, 8, 8)],
    "mug body": [(-30, 24, 24), (-26, 26, 26), (30, 27, 27)],
    "screwdriver": [(-45, 12, 12), (-40, 16, 16), (5, 15, 15), (12, 5, 5), (45, 4, 4)],
    "pear": [(-34, 8, 8), (-27, 21, 21), (-12, 26, 26), (10, 17, 17), (28, 10, 10), (34, 4, 4)],
    "dumbbell": [(-40, 19, 19), (-20, 19, 19), (-14, 11, 11), (14, 11, 11), (20, 19, 19), (40, 19, 19)],
    "capsule": [(-40, 3, 3), (-37, 11, 11), (-30, 17, 17), (-20, 20, 20), (20, 20, 20), (30, 17, 17), (37, 11, 11), (40, 3, 3)],
    "hourglass": [(-35, 22, 22), (0, 14, 14), (35, 22, 22)],
    "frustum": [(-30, 26, 26), (30, 17, 17)],
    "mushroom": [(-30, 13, 13), (0, 12, 12), (6, 26, 26), (18, 24, 24), (27, 12, 12), (30, 4, 4)],
    "vase": [(-40, 14, 14), (-15, 24, 24), (15, 13, 13), (40, 18, 18)],
    "light bulb": [(-35, 12, 12), (-15, 13, 13), (8, 26, 26), (26, 21, 21), (35, 5, 5)],
    "pawn": [(-35, 22, 22), (-26, 20, 20), (-18, 11, 11), (10, 10, 10), (22, 15, 15), (31, 10, 10), (35, 3, 3)],
    "lemon": [(-33, 4, 4), (-26, 12, 12), (0, 22, 22), (26, 12, 12), (33, 4, 4)],
}
_BENT = {
    "hammer": [(-45, 10, 8, 0), (14, 10, 8, 0), (20, 24, 12, 0), (42, 24, 12, 0), (45, 22, 10, 0)],
    "duck": [(-24, 16, 12, 2), (-14, 27, 20, 0), (2, 24, 18, -2), (12, 14, 12, -9), (22, 14, 13, -12), (32, 4, 4, -12)],
    "bean": [(-35, 4, 4, 7), (-29, 14, 13, 4), (0, 18, 17, -5), (29, 14, 13, 4), (35, 4, 4, 7)],
    "soap": [(-20, 24, 15, 0), (-16, 28, 19, 0), (16, 28, 19, 0), (20, 24, 15, 0)],
    "banana": [(-42, 5, 5, 14), (-30, 14, 14, 6), (0, 17, 17, -5), (30, 14, 14, 6), (42, 5, 5, 14)],
    "handle": [(-40, 14, 10, 0), (-20, 17, 13, 2), (0, 15, 12, 0), (20, 18, 13, 3), (40, 13, 10, 0)],
    "boot": [(-25, 29, 16, 5), (-10, 27, 16, 3), (2, 17, 15, -6), (35, 16, 15, -7)],
}


@dataclass(frozen=True, eq=False)
class Lump:
    """An object between elliptic rings.

    Args:
        name: name of the object.
        rings: (K, M, 3) vertices of each ring in O, m, from the lowest to the highest.
    """

    name: str
    rings: Array

    @property
    def layers(self) -> list[Array]:
        """Vertices (2 M, 3) of the layers between neighbouring rings, in O, m; each layer is convex."""
        return [np.concatenate([low, high]) for low, high in zip(self.rings[:-1], self.rings[1:], strict=True)]

    @cached_property
    def mesh(self) -> TriangleMesh:
        """The surface."""
        count, around = self.rings.shape[:2]
        vertices = np.concatenate([self.rings.reshape(-1, 3), self.rings[[0, -1]].mean(axis=1)])
        faces, here = [], np.arange(around)
        after = np.roll(here, -1)
        for k in range(count - 1):
            low, high = k * around, (k + 1) * around
            faces.append(np.stack([low + here, low + after, high + after], axis=1))
            faces.append(np.stack([low + here, high + after, high + here], axis=1))
        bottom, top, last = np.full(around, count * around), np.full(around, count * around + 1), (count - 1) * around
        faces.append(np.stack([bottom, after, here], axis=1))
        faces.append(np.stack([top, last + here, last + after], axis=1))
        return TriangleMesh(vertices, np.concatenate(faces))


def lumps() -> list[Lump]:
    """Return the twenty objects; the centre of the box around each is its origin."""
    table = {**{name: [(*knot, 0) for knot in knots] for name, knots in _ROUND.items()}, **_BENT}
    return [_lump(name, 1e-3 * np.array(knots, dtype=float)) for name, knots in table.items()]


def _lump(name: str, knots: Array) -> Lump:
    """Return the object through knots, m."""
    z = np.unique(np.concatenate([knots[:, 0], np.linspace(knots[0, 0], knots[-1, 0], _RINGS)]).round(4))  # no flat layers
    a, b, x = PchipInterpolator(knots[:, 0], knots[:, 1:])(z).T
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    rings = np.stack(
        [x[:, None] + a[:, None] * np.cos(angle), b[:, None] * np.sin(angle), np.repeat(z[:, None], _AROUND, axis=1)], axis=2
    )
    points = rings.reshape(-1, 3)
    return Lump(name, rings - (points.min(axis=0) + points.max(axis=0)) / 2.0)
