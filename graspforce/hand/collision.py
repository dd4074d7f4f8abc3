"""Distances between the links of a hand, and between its links and an object, from the collision shapes of its URDF.

A link without collision shapes takes its visual shapes. Meshes count as convex. Two links are neighbours if a joint, or several
joints with links without shapes between them, connects them. Neighbours may touch, and so may a link and one of its ancestors
that overlap in the neutral posture, and the pairs of the description's `allowed_contacts`. All other pairs must not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.geometry import Shape
from graspforce.hand.descriptions.contact_description import HELD_OBJECT
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.collision_body import CollisionBody, object_geometry, place, signed_distance
from graspforce.hand.shapes.meshes import Directories
from graspforce.hand.shapes.shape_geometry import coal_geometry


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


@dataclass(frozen=True, eq=False, slots=True)
class LinkGap:
    """The distance between two links, or between a link and the object.

    Attributes:
        first: name of the first URDF link.
        second: name of the second URDF link; "object" for the object.
        distance: m; negative for an overlap.
        points: (2, 3) the nearest points of both in H, m; of an overlap, the points at its greatest depth.
    """

    first: str
    second: str
    distance: float
    points: Array


class HandCollision:
    """The collision shapes of a hand.

    Attributes:
        shapes: the shapes, in the order of the URDF.
        bodies: the same shapes as geometry in the frames of their moving links.
        missing: messages of the shapes that cannot be read, such as meshes that are not found; these are left out.
        pairs: pairs of indices of shapes that must not touch.
    """

    def __init__(self, hand: Hand, directories: Directories = ()) -> None:
        self._hand = hand
        shapes: list[LinkShape] = []
        bodies: list[CollisionBody] = []
        missing: list[str] = []
        for urdf_link in hand.urdf.links.values():
            link, p_LF, R_LF = hand.model.carrier_of(urdf_link.name)
            for shape in urdf_link.shapes:
                try:
                    geometry = coal_geometry(shape, hand.urdf_path, directories)
                except ModelError as error:
                    missing.append(str(error))
                    continue
                p_LG, R_LG = p_LF + R_LF @ shape.p, R_LF @ shape.R
                bodies.append(CollisionBody.of_geometry(urdf_link.name, link, geometry, p_LG, R_LG))
                shapes.append(_link_shape(shape.kind, bodies[-1]))
        self.shapes, self.bodies, self.missing = tuple(shapes), tuple(bodies), tuple(missing)
        self.pairs = tuple(self._forbidden_pairs())

    def link_gaps(self, q: Array) -> list[LinkGap]:
        """Return the distances of all pairs of links that must not touch, the nearest first.

        Args:
            q: (n,) joint positions, rad.
        """
        places = self._places(q)
        return sorted((self._gap(places, i, j) for i, j in self.pairs), key=lambda gap: gap.distance)

    def object_gaps(self, q: Array, shape: Shape, p_HO: Array, R_HO: Array, skipped_links: Sequence[int] = ()) -> list[LinkGap]:
        """Return the distances between the links and an object, the nearest first.

        Args:
            q: (n,) joint positions, rad.
            shape: surface of the object.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            skipped_links: indices of moving links to leave out, such as those that touch.

        Raises:
            InvalidInput: the shape is an implicit surface, which has no geometry.
        """
        geometry = object_geometry(shape)
        if geometry is None:
            raise InvalidInput("shape", type(shape).__name__, "a sphere, a cylinder, a box or a superquadric")
        held = CollisionBody.of_geometry(HELD_OBJECT, 0, geometry, np.zeros(3), np.eye(3))
        held_place, gaps = place(held, p_HO, R_HO), []
        for body, body_place in zip(self.bodies, self._places(q), strict=True):
            if body.frame not in skipped_links:
                distance, points = signed_distance(body, body_place, held, held_place)
                gaps.append(LinkGap(body.name, HELD_OBJECT, distance, points))
        return sorted(gaps, key=lambda gap: gap.distance)

    def _forbidden_pairs(self) -> Iterator[tuple[int, int]]:
        """Yield the pairs of shapes that must not touch."""
        parents = _parents_with_shapes(self._hand, {body.frame for body in self.bodies})
        places, allowed = self._places(self._hand.neutral), self._hand.description.allowed_contacts
        for i, first in enumerate(self.bodies):
            for j, second in enumerate(self.bodies[:i]):
                a, b = first.frame, second.frame
                if a == b or parents.get(a) == b or parents.get(b) == a:
                    continue
                if any(each.covers(first.name, second.name) for each in allowed):
                    continue
                is_chain = b in _ancestors(parents, a) or a in _ancestors(parents, b)
                if not is_chain or self._gap(places, i, j).distance >= 0.0:
                    yield i, j

    def _places(self, q: Array) -> list[Any]:
        """Return the places of the bodies in H."""
        moved = self._hand.model.link_motion(np.asarray(q), np.zeros(self._hand.n)).link_poses  # the base first
        return [place(body, *moved[2 * body.frame + 2 : 2 * body.frame + 4]) for body in self.bodies]

    def _gap(self, places: Sequence[Any], i: int, j: int) -> LinkGap:
        first, second = self.bodies[i], self.bodies[j]
        return LinkGap(first.name, second.name, *signed_distance(first, places[i], second, places[j]))


@lru_cache(maxsize=16)
def hand_collision(hand: Hand) -> HandCollision:
    """Return the collision shapes of a hand, which are made once.

    Args:
        hand: the hand.
    """
    return HandCollision(hand)


def _link_shape(kind: str, body: CollisionBody) -> LinkShape:
    """Return a shape with its bounding box on the moving link that carries it."""
    return LinkShape(body.name, body.frame, kind, body.p_FB, body.R_FG, freeze(2.0 * body.half_extents))


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
