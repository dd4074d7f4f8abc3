"""The visible parts of a display model as triangle meshes with shared vertices, one for each body and colour."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.simulation.plants.link_geoms import HIDDEN_GROUP
from graspforce.simulation.plants.scene_parts import OBJECT
from graspforce.simulation.rendering.display_model import DisplayModel
from graspforce.simulation.rendering.tessellation import geom_triangles, triangle_colours

_MERGED = 1e-6  # m: vertices that are nearer count as one
_ROUND = {  # kinds of geoms whose surface is smooth
    int(kind) for kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_CAPSULE)
}


@dataclass(frozen=True, eq=False, slots=True)
class PartMesh:
    """A mesh that moves with a body.

    Attributes:
        name: unique name.
        body: index of the body in the display model.
        vertices: (V, 3) in the body's frame, m.
        faces: (F, 3) indices of vertices, counter-clockwise from outside.
        colour: (3,) red, green, blue, 0 to 1.
        is_round: whether the surface is shaded smoothly.
        is_object: whether it belongs to the object.
    """

    name: str
    body: int
    vertices: Array
    faces: npt.NDArray[np.intp]
    colour: Array
    is_round: bool
    is_object: bool


def part_meshes(display: DisplayModel) -> tuple[PartMesh, ...]:
    """Return the visible parts of a display model.

    Args:
        display: the model.
    """
    model, parts = display.model, []
    for geom in range(model.ngeom):
        triangles = geom_triangles(model, geom)
        if model.geom_group[geom] == HIDDEN_GROUP or not len(triangles):
            continue
        colours = triangle_colours(model, geom, triangles)
        mujoco.mju_quat2Mat(R := np.empty(9), model.geom_quat[geom])
        in_body = triangles @ R.reshape(3, 3).T + model.geom_pos[geom]
        for number, colour in enumerate(np.unique(colours, axis=0)):
            corners = in_body[(colours == colour).all(axis=1)].reshape(-1, 3)
            _, first, index = np.unique(np.rint(corners / _MERGED), axis=0, return_index=True, return_inverse=True)
            faces = index.reshape(-1, 3)
            faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # not those that shrink to an edge at a pole
            parts.append(
                PartMesh(
                    name=f"{geom}_{number}",
                    body=int(model.geom_bodyid[geom]),
                    vertices=corners[first],
                    faces=faces,
                    colour=colour,
                    is_round=int(model.geom_type[geom]) in _ROUND,
                    is_object=model.geom(geom).name == OBJECT,
                )
            )
    return tuple(parts)
