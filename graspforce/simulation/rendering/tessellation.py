"""Triangles of MuJoCo's geoms and their colours, for rendering without OpenGL."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.plants.scene_parts import OBJECT
from graspforce.simulation.rendering import stage

_AROUND, _ALONG = 36, 18  # divisions of round surfaces; multiples of 12 and 6, for a texture of squares
_FACE = 6  # divisions of a box's edges


def geom_triangles(model: mujoco.MjModel, geom: int) -> Array:
    """Return the surface of a geom as triangles (N, 3, 3) in its own frame, m; counter-clockwise from outside.

    Planes and unknown kinds have no triangles.
    """
    kind, size = model.geom_type[geom], np.array(model.geom_size[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh_triangles(model, int(model.geom_dataid[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.asarray(size[0] * _round_triangles(_half_circle()))
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.asarray(size * _round_triangles(_half_circle()))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        half_circle, middle = size[0] * _half_circle(), _ALONG // 2
        shift = np.array([0.0, size[1]])
        below, above = half_circle[: middle + 1] - shift, half_circle[middle:] + shift
        return _round_triangles(np.concatenate([below, above]))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius, half = size[:2]
        side = np.column_stack([np.full(_ALONG // 2 + 1, radius), np.linspace(-half, half, _ALONG // 2 + 1)])
        return _round_triangles(
            np.concatenate([[[0.0, -half], [radius / 2.0, -half]], side, [[radius / 2.0, half], [0.0, half]]])
        )
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.asarray(size * _cube_triangles())
    return np.zeros((0, 3, 3))


def triangle_colours(model: Any, geom: int, triangles: Array) -> Array:
    """Return the colours of a geom's triangles, (N, 3), red, green, blue, 0 to 1: the material's, and squares for the object.

    Args:
        model: of MuJoCo.
        geom: index of the geom.
        triangles: (N, 3, 3) of `geom_triangles`.
    """
    if model.geom(geom).name != OBJECT:
        material = int(model.geom_matid[geom])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        return np.tile(np.asarray(rgba[:3], dtype=np.float64), (len(triangles), 1))
    middles = triangles.mean(axis=1)
    longitude = np.arctan2(middles[:, 1], middles[:, 0]) / (2.0 * np.pi)
    latitude = np.arctan2(middles[:, 2], np.hypot(middles[:, 0], middles[:, 1])) / (2.0 * np.pi)
    dark = (np.floor(stage.SQUARES * longitude) + np.floor(stage.SQUARES * latitude)) % 2 == 0
    return np.where(dark[:, None], *(np.array(colour) / 255.0 for colour in stage.OBJECT_COLOURS))


def _mesh_triangles(model: Any, mesh: int) -> Array:
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    return np.asarray(vertices[faces], dtype=np.float64)


def _half_circle() -> Array:
    """Return the profile (r, z) of a sphere of radius 1 from pole to pole."""
    angles = np.linspace(-np.pi / 2.0, np.pi / 2.0, _ALONG + 1)
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _round_triangles(profile: Array) -> Array:
    """Return the surface that a profile (r, z) sweeps about the third axis."""
    turn = np.linspace(0.0, 2.0 * np.pi, _AROUND + 1)
    points = np.stack(
        [np.outer(profile[:, 0], np.cos(turn)), np.outer(profile[:, 0], np.sin(turn)), np.tile(profile[:, 1:], len(turn))],
        axis=-1,
    )
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)


def _cube_triangles() -> Array:
    """Return the surface of a cube with edges of length 2."""
    steps = np.linspace(-1.0, 1.0, _FACE + 1)
    u, v = np.meshgrid(steps, steps, indexing="ij")
    top = np.stack([u, v, np.ones_like(u)], axis=-1)
    a, b, c, d = top[:-1, :-1], top[1:, :-1], top[1:, 1:], top[:-1, 1:]
    face = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    x, y, z = np.eye(3)
    turns = [np.array(rows).T for rows in ((x, y, z), (-x, y, -z), (y, z, x), (z, y, -x), (z, x, y), (x, z, -y))]
    return np.concatenate([face @ R.T for R in turns])
