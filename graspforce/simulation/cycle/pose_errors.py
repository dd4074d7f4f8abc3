"""The largest errors of an object's pose on the table, and the places where the closing fingers touch it then."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from graspforce.control.phases.touched_grasp import pose_on_table, surface_distances, touched_grasp
from graspforce.core.arrays import Array
from graspforce.simulation.cycle.table_scene import TableScene

_LARGEST_ERROR, _LARGEST_TURN = 0.01, math.radians(10.0)  # m and rad, of the object's pose
_DIRECTIONS = 8  # of the displacement
_LEAST_COVER = 0.05  # of a tip's radius, by which it covers the face
_STEP = 5e-4  # m, of the way on which a fingertip meets the object


def displaced_pose(scene: TableScene, offset: npt.ArrayLike, angle: float) -> tuple[Array, Array]:
    """Return the object's pose after a displacement along the table and a rotation about the vertical through O's origin.

    Args:
        scene: the scene.
        offset: (2,) displacement along the table, m.
        angle: rotation about the vertical, rad.
    """
    return pose_on_table(scene.grasp, scene.down, offset, angle)


def extreme_poses(scene: TableScene) -> list[tuple[Array, Array]]:
    """Return the expected pose of the object, and the poses displaced and turned by the largest errors.

    Args:
        scene: the scene.
    """
    poses = [displaced_pose(scene, np.zeros(2), 0.0)]
    for direction in np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False):
        offset = _LARGEST_ERROR * np.array([math.cos(direction), math.sin(direction)])
        poses += [displaced_pose(scene, offset, turn) for turn in (-_LARGEST_TURN, _LARGEST_TURN)]
    return poses


def count_missed_faces(scene: TableScene, standoff: Array, travel: float) -> int:
    """Return at how many of the extreme poses a fingertip misses the object, or all but misses its face.

    Each fingertip moves along the planned inward normal. A round tip that touches an edge covers the face by 1 − sin φ of its
    radius, where φ is the angle between the touched and the planned normal, in O. It slips off if this is less than 5 %.

    Args:
        scene: the scene.
        standoff: (N,) distances of the fingertips from the planned contacts at the start, m.
        travel: way of the fingertips beyond the planned contacts, m.
    """
    grasp = scene.grasp
    planned, least_cosine = grasp.contacts.R_OC[:, :, 2], math.sqrt(1.0 - (1.0 - _LEAST_COVER) ** 2)
    count = 0
    for pose in extreme_poses(scene):
        p_tip = _met_places(scene, pose, standoff, travel)
        if p_tip is None:
            count += 1
            continue
        touched = touched_grasp(grasp, grasp.q, p_tip, pose).contacts.R_OC[:, :, 2]
        count += bool((np.einsum("ij,ij->i", touched, planned) < least_cosine).any())
    return count


def _met_places(scene: TableScene, pose: tuple[Array, Array], standoff: Array, travel: float) -> Array | None:
    """Return the centres (N, 3) of the fingertips where they meet the object, in H, m; None if one misses it."""
    grasp = scene.grasp
    normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
    places = np.zeros((len(grasp.fingers), 3))
    for i, name in enumerate(grasp.fingers):
        way = np.arange(-standoff[i], travel, _STEP)
        centres = grasp.hand.tip_pose(grasp.q, name)[0] + way[:, None] * normals[i]
        inside = surface_distances(grasp, pose, centres) <= (grasp.hand.finger(name).tip_radius or 0.0)
        if not inside.any():
            return None
        places[i] = centres[int(inside.argmax())]
    return places
