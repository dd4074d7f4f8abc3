"""Meshes in a scene: how the hand looks, and with what its fingertips touch. MuJoCo touches with a mesh's convex hull."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from graspforce.arrays import Array
from graspforce.errors import ModelError
from graspforce.hands.tree import Mesh
from graspforce.hold import Hold
from graspforce.simulation import looks

_READ = (".stl", ".obj", ".msh")  # in these MuJoCo reads meshes
_SKIN = "skin"
_SIGNS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


def skin(spec: Any, bodies: Sequence[Any], meshes: Sequence[Mesh], hold: Hold) -> None:
    """Let the links look like meshes, which touch nothing."""
    tips = {hold.hand.finger(name).tip for name in hold.fingers}
    for number, mesh in enumerate(meshes):
        looks.silent(add(spec, bodies, mesh), f"{_SKIN} {number}", looks.TIP if mesh.part in tips else looks.LINK)


def corners(spec: Any, hold: Hold) -> Array:
    """(N, 3) the corners of the boxes around the skin of a hand in a hold, in H, m: what a camera should see."""
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, x in zip(hold.hand.full_joints, hold.hand.T @ hold.q + hold.hand.q0, strict=True):
        if spec.joint(name) is not None:  # a locked joint is none
            data.joint(name).qpos = x
    mujoco.mj_kinematics(model, data)
    found = []
    for i in range(model.ngeom):
        if model.geom(i).name.startswith(_SKIN):
            middle, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
            found.append(data.geom_xpos[i] + (middle + half * _SIGNS) @ data.geom_xmat[i].reshape(3, 3).T)
    return np.concatenate(found)


def add(spec: Any, bodies: Sequence[Any], mesh: Mesh) -> Any:
    """A geom of a mesh on its link; a file that several links share is read once.

    Args:
        spec: the scene.
        bodies: of the links, in the tree's order.
        mesh: what to add.

    Raises:
        ModelError: a file of a kind that MuJoCo does not read.
    """
    if mesh.file.suffix.lower() not in _READ:
        raise ModelError(f"{mesh.file}: MuJoCo reads meshes from {', '.join(_READ)}, not from {mesh.file.suffix or 'this'}")
    name = f"{mesh.file} {mesh.scale.tolist()}"
    if spec.mesh(name) is None:
        asset = spec.add_mesh(name=name, file=str(mesh.file.absolute()), scale=mesh.scale)
        asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # asks for no closed surface, and nobody uses it
    body = spec.worldbody if mesh.link < 0 else bodies[mesh.link]
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(mesh.R_LS).ravel())
    return body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=mesh.p_LS, quat=quaternion)
