"""Distances between the links of a hand, and between its links and an object, from the collision shapes of its URDF.

A link without collision shapes takes its visual shapes. Meshes count as convex. Two links are neighbours if a joint, or several
joints with links without shapes between them, connects them. Neighbours may touch, and so may a link and one of its ancestors
that overlap in the neutral posture. All other pairs must not.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.hand.descriptions.urdf import UrdfShape
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.meshes import Directories
from graspforce.hand.shapes.shape_geometry import coal_geometry, extent

CollisionObject = Sphere | Cylinder | Box


@dataclass(frozen=True, eq=False, slots=True)
class LinkShape:
    """A shape on a moving link L with its bounding box.

    Attributes:
        urdf_link: name of the URDF link that has the shape.
        link: index of the moving link that carries it, -1 for the hand's base.
        kind: box, sphere, cylinder, capsule or mesh.
        p_LS: (3,) centre of the bounding box in L, m.
        R_LS: (3, 3) axes of the bounding box in L.
        size: (3,) full extents along these axes, m.
    """

    urdf_link: str
    link: int
    kind: str
    p_LS: Array
    R_LS: Array
    size: Array


@dataclass(frozen=True, slots=True)
class LinkGap:
    """The distance between two links, or between a link and the object.

    Attributes:
        first: name of the first URDF link.
        second: name of the second URDF link; "object" for the object.
        distance: m; negative for an overlap.
    """

    first: str
    second: str
    distance: float


class HandCollision:
    """The collision shapes of a hand.

    Attributes:
        shapes: the shapes, in the order of the URDF.
        missing: messages of the shapes that cannot be read, such as meshes that are not found; these are left out.
    """

    def __init__(self, hand: Hand, directories: Directories = ()) -> None:
        self._hand = hand
        shapes: list[LinkShape] = []
        geometries: list[Any] = []
        places: list[tuple[Array, Array]] = []  # of the geometry and of its box's centre, on the URDF link
        missing: list[str] = []
        for urdf_link in hand.urdf.links.values():
            for shape in urdf_link.shapes:
                try:
                    geometry = coal_geometry(shape, hand.urdf_path, directories)
                except ModelError as error:
                    missing.append(str(error))
                    continue
                shapes.append(_link_shape(hand, urdf_link.name, shape, geometry))
                geometries.append(geometry)
                places.append((shape.p, shape.R))
        self.shapes, self.missing = tuple(shapes), tuple(missing)
        self._geometries, self._places = geometries, places
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._pairs = self._allowed_pairs()

    def link_gaps(self, q: Array) -> list[LinkGap]:
        """Return the distances of all pairs of links that must not touch, the nearest first.

        Args:
            q: (n,) joint positions, rad.
        """
        placed = self._placed(q)
        gaps = [
            LinkGap(self.shapes[i].urdf_link, self.shapes[j].urdf_link, self._distance(i, placed[i], j, placed[j]))
            for i, j in self._pairs
        ]
        return sorted(gaps, key=lambda gap: gap.distance)

    def object_gaps(
        self, q: Array, shape: CollisionObject, p_HO: Array, R_HO: Array, skipped_links: Sequence[int] = ()
    ) -> list[LinkGap]:
        """Return the distances between the links and an object, the nearest first.

        Args:
            q: (n,) joint positions, rad.
            shape: surface of the object.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            skipped_links: indices of moving links to leave out, such as those that touch.
        """
        placed = self._placed(q)
        body, place = _object_geometry(shape), coal.Transform3s(np.array(R_HO), np.array(p_HO))
        gaps = [
            LinkGap(each.urdf_link, "object", self._least_distance(self._geometries[i], placed[i], body, place))
            for i, each in enumerate(self.shapes)
            if each.link not in skipped_links
        ]
        return sorted(gaps, key=lambda gap: gap.distance)

    def _allowed_pairs(self) -> list[tuple[int, int]]:
        """Return the pairs of shapes that must not touch."""
        parents = _parents_with_shapes(self._hand, {shape.link for shape in self.shapes})
        placed, pairs = self._placed(self._hand.neutral), []
        for i, first in enumerate(self.shapes):
            for j in range(i):
                a, b = first.link, self.shapes[j].link
                if a == b or parents.get(a) == b or parents.get(b) == a:
                    continue
                is_chain = b in _ancestors(parents, a) or a in _ancestors(parents, b)
                if not is_chain or self._distance(i, placed[i], j, placed[j]) >= 0.0:
                    pairs.append((i, j))
        return pairs

    def _placed(self, q: Array) -> list[Any]:
        """Return the poses of the geometries in H."""
        poses = self._hand.link_poses(q)
        placed = []
        for shape, (p_FS, R_FS) in zip(self.shapes, self._places, strict=True):
            p, R = poses[shape.urdf_link]
            placed.append(coal.Transform3s(R @ R_FS, p + R @ p_FS))
        return placed

    def _distance(self, i: int, first: Any, j: int, second: Any) -> float:
        return self._least_distance(self._geometries[i], first, self._geometries[j], second)

    def _least_distance(self, one: Any, one_place: Any, other: Any, other_place: Any) -> float:
        self._result.clear()
        return float(coal.distance(one, one_place, other, other_place, self._request, self._result))


def _link_shape(hand: Hand, urdf_link: str, shape: UrdfShape, geometry: Any) -> LinkShape:
    """Return a shape of a URDF link on the moving link that carries it."""
    link, p_LF, R_LF = hand.model.carrier_of(urdf_link)
    low, high = extent(geometry)
    p_FS = shape.p + shape.R @ ((low + high) / 2.0)
    return LinkShape(urdf_link, link, shape.kind, freeze(p_LF + R_LF @ p_FS), freeze(R_LF @ shape.R), freeze(high - low))


def _parents_with_shapes(hand: Hand, links: Collection[int]) -> dict[int, int]:
    """Return the nearest ancestor with shapes, or the base, of each moving link with shapes."""
    tree, parents = hand.tree().links, {}
    for link in links:
        if link >= 0:
            above = tree[link].parent
            while above >= 0 and above not in links:
                above = tree[above].parent
            parents[link] = above
    return parents


def _ancestors(parents: Mapping[int, int], link: int) -> set[int]:
    """Return the ancestors of a link with shapes."""
    found = set()
    while link in parents:
        link = parents[link]
        found.add(link)
    return found


def _object_geometry(shape: CollisionObject) -> Any:
    """Return the geometry of an object in its own axes."""
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.height)
    return coal.Box(*shape.edges.tolist())
