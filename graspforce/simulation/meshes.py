"""Meshes in a scene: how the hand looks, and with what its fingertips touch. MuJoCo touches with a mesh's convex hull."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from graspforce.core.errors import ModelError
from graspforce.hand.kinematic_tree import Mesh

_MESH_SUFFIXES = (".stl", ".obj", ".msh")  # in these MuJoCo reads meshes


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
