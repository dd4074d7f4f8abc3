"""Spheres that follow the collision shapes of the links, for searches: smooth distances of many postures at once.

They guide a search. `HandCollision` computes the exact distances of its result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.collision import HandCollision, LinkShape
from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Tip

_LARGEST_SPACING = 1.5  # of the radius, for wide shapes such as a palm


@dataclass(frozen=True, eq=False, slots=True)
class LinkSphere:
    """A sphere that is fixed to a moving link.

    Attributes:
        link: index of the moving link, -1 for the base.
        p: (3,) centre in the link's frame, m.
        radius: m.
    """

    link: int
    p: Array
    radius: float


def finger_spheres(tree: KinematicTree, chain: list[int], tip: Tip, collision: HandCollision) -> list[LinkSphere]:
    """Return the spheres of a finger, from the base to the tip; the last one is the tip's own.

    A link without shapes gets spheres along its axis, as thick as the tip.

    Args:
        tree: the hand's links.
        chain: indices of the links that belong to the finger alone, base first.
        tip: the finger's tip.
        collision: the collision shapes.
    """
    found = []
    for k, link in enumerate(chain):
        shapes = [shape for shape in collision.shapes if shape.link == link]
        for shape in shapes:
            centres, radius = cover(shape)
            found += [LinkSphere(link, p, radius) for p in centres]
        end = tree.links[chain[k + 1]].p_PL if k + 1 < len(chain) else tip.p_LF
        length = float(np.linalg.norm(end))
        if not shapes and length > 0.0:
            count = int(np.ceil(length / tip.radius)) if tip.radius else 2
            found += [LinkSphere(link, j / count * end, tip.radius or 0.0) for j in range(count)]
    return [*found, LinkSphere(tip.link, tip.p_LF, tip.radius or 0.0)]


def cover(shape: LinkShape) -> tuple[Array, float]:
    """Return centres (K, 3) in the link's frame, m, and the radius, m, of equal spheres in place of a shape.

    The spheres touch the shape's sides from inside: on the axis of a cylinder or capsule, and on a lattice in the middle of a
    box. Edges and corners stick out of them. A mesh counts as its bounding box.

    Args:
        shape: the shape.
    """
    inner = float(shape.size.min()) / 2.0  # m, radius of the largest sphere inside
    spacing = _LARGEST_SPACING if shape.kind in ("box", "mesh") else 1.0
    half = np.maximum(shape.size / 2.0 - inner, 0.0)
    counts = [int(np.ceil(2.0 * h / (spacing * inner) - 1e-9)) + 1 if h > 1e-3 * inner else 1 for h in half.tolist()]
    lines = [np.linspace(-h, h, count) if count > 1 else np.zeros(1) for h, count in zip(half.tolist(), counts, strict=True)]
    lattice = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(shape.p_LS + lattice @ shape.R_LS.T), inner
