"""Collision geoms of the hand's links and palm, and their pairs with the object and one another.

The shapes and the pairs are those of `SceneCollision`. The fingertips of the grasp have geoms of their own, and their links do
not collide with the object. Pairs that overlap in the grasp do not collide, so that a run begins at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.grasp import Grasp
from graspforce.hand.shapes.collision_body import CollisionBody
from graspforce.simulation.plants.plant_interface import LinkCollision

LINK_PREFIX = "shape "  # of the names of these geoms

LINK_FRICTION = 0.5
HIDDEN_GROUP = 4  # geoms of this group are not drawn

_TYPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}


def add_link_geoms(
    spec: mujoco.MjSpec, body_of: Callable[[int], mujoco.MjsBody], grasp: Grasp, others: tuple[str, ...]
) -> list[tuple[str, str]]:
    """Add the collision geoms of all links, and return the pairs of geoms that must collide, by their names.

    Args:
        spec: specification of the model.
        body_of: the body of each moving link by its index; -1 is the base.
        grasp: hand, object and fingers.
        others: names of the object's geom and, if there is one, of the floor's.
    """
    scene = SceneCollision(grasp.hand, grasp.body.shape, grasp.fingers)
    poses = scene.poses(grasp.q[None], grasp.p_HO[None], grasp.R_HO[None])
    names = [*(f"{LINK_PREFIX}{i} {body.name}" for i, body in enumerate(scene.links)), others[0]]
    for body, name in zip(scene.links, names, strict=False):
        _add_geom(spec, body_of(body.frame), body, name)
    apart = [scene.distance(pair, poses, 0) > 0.0 for pair in range(len(scene.pairs))]
    pairs = [(names[i], names[j]) for i, j in scene.pairs[apart]]
    moving = [names[i] for i, body in enumerate(scene.links) if body.frame >= 0]
    return pairs + [(name, floor) for floor in others[1:] for name in moving]


def collision_names(model: mujoco.MjModel, **others: int) -> dict[int, str]:
    """Return the names of the geoms that collide with links, by their indices.

    Args:
        model: of MuJoCo.
        **others: index of each other geom by the name to return for it.
    """
    names = {i: model.geom(i).name for i in range(model.ngeom)}
    links = {i: name.split(" ", 2)[2] for i, name in names.items() if name.startswith(LINK_PREFIX)}
    return links | {i: name for name, i in others.items()}


def read_collision(data: mujoco.MjData, contact: int, names: Mapping[int, str]) -> LinkCollision | None:
    """Return a contact of MuJoCo as a collision; None for a contact without force, and for other contacts.

    Args:
        data: of MuJoCo.
        contact: index of the contact.
        names: as `collision_names` returns them.
    """
    found = data.contact[contact]
    first, second = (names.get(int(geom)) for geom in found.geom)
    force = float(data.efc_force[found.efc_address]) if found.efc_address >= 0 else 0.0
    if first is None or second is None or force <= 0.0:
        return None
    return LinkCollision(first, second, force)


def _add_geom(spec: mujoco.MjSpec, part: mujoco.MjsBody, body: CollisionBody, name: str) -> None:
    """Add a geom that is not drawn and has no mass."""
    x, y, z = body.half_extents.tolist()
    size = {"sphere": [x, 0.0, 0.0], "box": [x, y, z], "cylinder": [x, z, 0.0], "capsule": [x, z - x, 0.0]}.get(body.kind)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(body.R_FG).ravel())
    geom = part.add_geom(type=_TYPES[body.kind], pos=body.p_FG, quat=quaternion)
    if size is None:
        mesh = spec.add_mesh(name=name, uservert=body.hull_points.ravel().tolist())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom.meshname = name
    else:
        geom.size = size
    geom.name, geom.contype, geom.conaffinity, geom.mass = name, 0, 0, 0.0  # it collides in explicit pairs only
    geom.group = HIDDEN_GROUP
