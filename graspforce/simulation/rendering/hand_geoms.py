"""The look of a hand: the meshes of its URDF, or links modelled from its kinematic tree. No geom here collides or has mass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from graspforce.core.arrays import Array
from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Mesh
from graspforce.simulation.plants.meshes import add_mesh_geom
from graspforce.simulation.plants.scene_parts import make_passive_geom

LINK, PALM, JOINT, PAD = "link", "palm", "joint", "pad"  # names of the materials
HAND_PREFIX = "hand"  # of the names of these geoms

_MIN_THICKNESS, _MAX_THICKNESS = 0.006, 0.0095  # m, radius of modelled links
_DEFAULT_THICKNESS = 0.007  # m, of fingers whose tips have no radius
_SHORT = 1e-3  # m: shorter links are not drawn
_PALM_DEPTH = 0.008  # m, half the thickness of a modelled palm
_PALM_MARGIN = 0.014  # m, from a finger's base to the palm's edge
_CORNERS = 16  # points of the rounded corner about each finger's base


def add_mesh_geoms(spec: Any, bodies: Sequence[Any], meshes: Sequence[Mesh], tip_links: set[str]) -> None:
    """Add the meshes of the URDF's visual shapes.

    Args:
        spec: the display model's specification.
        bodies: bodies of the links, in the tree's order.
        meshes: meshes to add.
        tip_links: names of the URDF links at the fingertips; these get the material of pads.
    """
    for number, mesh in enumerate(meshes):
        geom = add_mesh_geom(spec, bodies, mesh)
        make_passive_geom(geom, f"{HAND_PREFIX} mesh {number}")
        geom.material = PAD if mesh.urdf_link in tip_links else PALM if mesh.link < 0 else LINK


def add_modelled_geoms(spec: Any, bodies: Sequence[Any], tree: KinematicTree) -> None:
    """Add a palm, a capsule for each link, a cylinder for each joint and a ball for each fingertip.

    Args:
        spec: the display model's specification.
        bodies: bodies of the links, in the tree's order.
        tree: the hand's links and fingertips.
    """
    radii = [tip.radius for tip in tree.tips if tip.radius is not None]
    tip_radius = min(radii, default=_DEFAULT_THICKNESS)  # m
    thickness = float(np.clip(0.9 * tip_radius, min(_MIN_THICKNESS, 0.95 * tip_radius), _MAX_THICKNESS))
    ends = [(link.parent, link.p_PL) for link in tree.links] + [(tip.link, tip.p_LF) for tip in tree.tips]
    bases = [np.asarray(end) for parent, end in ends if parent < 0]
    if len(bases) > 1:
        _add_palm(spec, np.array([np.zeros(3), *bases]))
    for number, (parent, end) in enumerate(ends):
        if parent >= 0 and np.linalg.norm(end) > _SHORT:
            capsule = bodies[parent].add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[thickness, 0.0, 0.0])
            capsule.fromto = [0.0, 0.0, 0.0, *end]
            make_passive_geom(capsule, f"{HAND_PREFIX} link {number}")
            capsule.material = LINK
    for body, link in zip(bodies, tree.links, strict=True):
        if not link.is_prismatic:
            knuckle = body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[1.12 * thickness, 0.0, 0.0])
            knuckle.fromto = [*(-1.15 * thickness * link.axis), *(1.15 * thickness * link.axis)]
            make_passive_geom(knuckle, f"{HAND_PREFIX} joint {link.joint}")
            knuckle.material = JOINT
    for tip in tree.tips:
        size = [tip.radius or thickness, 0.0, 0.0]
        ball = bodies[tip.link].add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size, pos=tip.p_LF)
        make_passive_geom(ball, f"{HAND_PREFIX} pad {tip.finger}")
        ball.material = PAD


def _add_palm(spec: Any, bases: Array) -> None:
    """Add a plate with rounded corners through H's origin and the finger bases."""
    centre = bases.mean(axis=0)
    _, _, axes = np.linalg.svd(bases - centre)
    angles = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    rim = np.outer(np.cos(angles), axes[0]) + np.outer(np.sin(angles), axes[1])
    points = np.concatenate(
        [
            base + scale * _PALM_MARGIN * rim + side * _PALM_DEPTH * axes[2]
            for base in bases
            for scale, side in ((1.0, 0.6), (1.0, -0.6), (0.75, 1.0), (0.75, -1.0))
        ]
    )
    hull = ConvexHull(points)
    triangles = hull.simplices.copy()
    corners = points[triangles]
    outward = np.einsum(
        "ni,ni->n", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), hull.equations[:, :3]
    )
    triangles[outward < 0.0] = triangles[outward < 0.0, ::-1]
    spec.add_mesh(name="palm", uservert=points.ravel().tolist(), userface=triangles.ravel().tolist())
    palm = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="palm")
    make_passive_geom(palm, f"{HAND_PREFIX} palm")
    palm.material = PALM
