"""Contacts of spherical fingertips with the smooth surface of a mesh.

MuJoCo collides with the convex hull of a mesh, which fills hollows and has flat facets. The controller's surface is the zero
set of a smooth signed distance; see `graspforce.geometry.distance_field`. For a fingertip with centre c and radius r, with the
closest point x of that surface and its outward unit normal n, the contact has

    distance d = (c − x)·n − r,      point x + d n/2,      normal n.

It replaces the engine's contact of the fingertip with the hull before the engine solves. Smoothing moves the surface inwards
where it is convex, so the smooth surface lies inside the hull, and each fingertip that touches the surface touches the hull.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import TriangleMesh

HULL_MARGIN = 1e-4  # m: distance of a fingertip from the hull at which the engine creates a contact; more than it rounds


@dataclass(frozen=True, eq=False, slots=True)
class SurfaceContacts:
    """The smooth surface of an object, and the fingertips that collide with it.

    Attributes:
        shape: the surface.
        object_geom: index of the mesh's geom.
        tip_geoms: indices of the fingertips' geoms, spheres.
    """

    shape: TriangleMesh
    object_geom: int
    tip_geoms: tuple[int, ...]

    def distances(self, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
        """Return the distances of the fingertips from the surface, (N,), m; negative inside.

        Args:
            model: of MuJoCo.
            data: its data, with the poses of the geoms.
        """
        return self._touch(model, data, list(self.tip_geoms))[2]

    def replace_contacts(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Replace the contacts of fingertips with the hull by those with the surface, and return whether there are any.

        Args:
            model: of MuJoCo.
            data: its data, with contacts as the engine finds them; distance, point and frame of contacts are changed.
        """
        tips, places = [], []
        for c, (first, second) in enumerate(data.contact.geom.tolist()):
            tip = first if second == self.object_geom else second
            if self.object_geom in (first, second) and tip in self.tip_geoms:
                tips.append(tip)
                places.append((data.contact[c], 1.0 if first == self.object_geom else -1.0))
        if not tips:
            return False
        points, normals, distances = self._touch(model, data, tips)
        for (contact, sign), x, n, d in zip(places, points, normals, distances, strict=True):
            contact.dist, contact.includemargin = d, 0.0
            contact.pos[:] = x + 0.5 * d * n
            contact.frame[:] = _frame(sign * n)
            contact.exclude, contact.efc_address = int(d >= 0.0), -1
        return True

    def _touch(self, model: mujoco.MjModel, data: mujoco.MjData, tips: list[int]) -> tuple[Array, Array, Array]:
        """Return closest points and outward normals in H, (M, 3), m, and the distances of fingertips, (M,), m."""
        mesh = int(model.geom_dataid[self.object_geom])
        mujoco.mju_quat2Mat(R_SG := np.empty(9), model.mesh_quat[mesh])  # the engine moves vertices to their inertial frame
        R_HS = data.geom_xmat[self.object_geom].reshape(3, 3) @ R_SG.reshape(3, 3).T
        p_HS = data.geom_xpos[self.object_geom] - R_HS @ model.mesh_pos[mesh]
        centres = (data.geom_xpos[tips] - p_HS) @ R_HS
        points = self.shape.closest_points(centres)
        normals = -self.shape.inward_normal(points)
        distances = ((centres - points) * normals).sum(axis=1) - model.geom_size[tips, 0]
        return p_HS + points @ R_HS.T, normals @ R_HS.T, np.asarray(distances)


def update_positions(model: mujoco.MjModel, data: mujoco.MjData, surface: SurfaceContacts | None) -> None:
    """Compute everything that depends on positions, with contacts on the surface.

    Args:
        model: of MuJoCo.
        data: its data.
        surface: surface of a mesh; None for shapes that the engine knows.
    """
    mujoco.mj_fwdPosition(model, data)
    _remake_constraints(model, data, surface)


def begin_step(model: mujoco.MjModel, data: mujoco.MjData, surface: SurfaceContacts | None) -> None:
    """Do the first half of a step, `mj_step1`, with contacts on the surface.

    Args:
        model: of MuJoCo.
        data: its data.
        surface: as in `update_positions`.
    """
    mujoco.mj_step1(model, data)
    if _remake_constraints(model, data, surface):
        mujoco.mj_fwdVelocity(model, data)


def update_forces(model: mujoco.MjModel, data: mujoco.MjData, surface: SurfaceContacts | None) -> None:
    """Compute accelerations and contact forces, `mj_forward`, with contacts on the surface.

    Args:
        model: of MuJoCo.
        data: its data.
        surface: as in `update_positions`.
    """
    mujoco.mj_forward(model, data)
    if _remake_constraints(model, data, surface):
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fwdAcceleration(model, data)
        mujoco.mj_fwdConstraint(model, data)


def _remake_constraints(model: mujoco.MjModel, data: mujoco.MjData, surface: SurfaceContacts | None) -> bool:
    """Replace the contacts and make their constraints again, and return whether there are any."""
    if surface is None or not surface.replace_contacts(model, data):
        return False
    mujoco.mj_makeConstraint(model, data)
    mujoco.mj_island(model, data)
    mujoco.mj_projectConstraint(model, data)
    return True


def _frame(n: Array) -> Array:
    """Return normal and two tangents as nine numbers, row by row."""
    axis = np.zeros(3)
    axis[int(np.abs(n).argmin())] = 1.0
    t = np.cross(n, axis)
    t /= np.linalg.norm(t)
    return np.concatenate([n, t, np.cross(n, t)])
