"""Mesh geoms of a MuJoCo model."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from graspforce.core.errors import ModelError
from graspforce.hand.kinematics.kinematic_tree import Mesh

_MESH_SUFFIXES = (".stl", ".obj", ".msh")  # of the files that MuJoCo reads


def add_mesh_geom(spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], mesh: Mesh) -> mujoco.MjsGeom:
    """Add a mesh to the body of its link. MuJoCo collides with the mesh's convex hull.

    Args:
        spec: specification of the model. Links that share a file share a mesh asset.
        bodies: bodies of the links, in the tree's order.
        mesh: the mesh to add.

    Returns:
        The geom.

    Raises:
        ModelError: MuJoCo does not read this kind of file.
    """
    if mesh.file.suffix.lower() not in _MESH_SUFFIXES:
        raise ModelError(
            f"{mesh.file}: MuJoCo reads meshes from {', '.join(_MESH_SUFFIXES)}, not from {mesh.file.suffix or 'this file'}"
        )
    name = f"{mesh.file} {mesh.scale.tolist()}"
    if spec.mesh(name) is None:
        asset = spec.add_mesh(name=name, file=str(mesh.file.absolute()), scale=mesh.scale)
        asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # unused, and accepts open surfaces
    body = spec.worldbody if mesh.link < 0 else bodies[mesh.link]
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(mesh.R_LS).ravel())
    return body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=mesh.p_LS, quat=quaternion)
