"""Meshes in a scene: how the hand looks, and with what its fingertips touch. MuJoCo touches with a mesh's convex hull."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import ModelError
from graspforce.grasp.grasp import Grasp
from graspforce.hand.kinematic_tree import Mesh
from graspforce.simulation import appearance

_MESH_SUFFIXES = (".stl", ".obj", ".msh")  # in these MuJoCo reads meshes
_SKIN = "skin"
_SIGNS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


def skin(spec: Any, bodies: Sequence[Any], meshes: Sequence[Mesh], grasp: Grasp) -> None:
    """Let the links look like meshes, which touch nothing."""
    tips = {grasp.hand.finger(name).tip for name in grasp.fingers}
    for number, mesh in enumerate(meshes):
        appearance.make_passive_geom(
            add_mesh_geom(spec, bodies, mesh),
            f"{_SKIN} {number}",
            appearance.TIP_COLOUR if mesh.urdf_link in tips else appearance.LINK_COLOUR,
        )


def mesh_corners(spec: Any, grasp: Grasp) -> Array:
    """(N, 3) the corners of the boxes around the skin of a hand in a hold, in H, m: what a camera should see."""
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, x in zip(grasp.hand.full_joints, grasp.hand.T @ grasp.q + grasp.hand.q0, strict=True):
        if spec.joint(name) is not None:  # a locked joint is none
            data.joint(name).qpos = x
    mujoco.mj_kinematics(model, data)
    found = []
    for i in range(model.ngeom):
        if model.geom(i).name.startswith(_SKIN):
            middle, half = model.geom_aabb[i, :3], model.geom_aabb[i, 3:]
            found.append(data.geom_xpos[i] + (middle + half * _SIGNS) @ data.geom_xmat[i].reshape(3, 3).T)
    return np.concatenate(found)


def add_mesh_geom(spec: Any, bodies: Sequence[Any], mesh: Mesh) -> Any:
    """A geom of a mesh on its link; a file that several links share is read once.

    Args:
        spec: the scene.
        bodies: of the links, in the tree's order.
        mesh: what to add.

    Raises:
        ModelError: a file of a kind that MuJoCo does not read.
    """
    if mesh.file.suffix.lower() not in _MESH_SUFFIXES:
        raise ModelError(
            f"{mesh.file}: MuJoCo reads meshes from {', '.join(_MESH_SUFFIXES)}, not from {mesh.file.suffix or 'this'}"
        )
    name = f"{mesh.file} {mesh.scale.tolist()}"
    if spec.mesh(name) is None:
        asset = spec.add_mesh(name=name, file=str(mesh.file.absolute()), scale=mesh.scale)
        asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # asks for no closed surface, and nobody uses it
    body = spec.worldbody if mesh.link < 0 else bodies[mesh.link]
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(mesh.R_LS).ravel())
    return body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=mesh.p_LS, quat=quaternion)
