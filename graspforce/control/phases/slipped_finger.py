"""A fingertip that has run past the edge of its face in a squeeze, and where the object then is."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp

_SHIFT = 8e-3  # m: the object's position error is at most 12 mm, and a contact at least 4 mm from the edge
_LEAST_RATIO = 0.3  # of singular values: directions in which the normals hardly differ do not explain runs
_LEAST_LEVER = 3e-3  # m: distance of the contact from the object's middle, along the edge, that shows a direction


def shift_of_slip(grasp: Grasp, p_tip: Array, down: Array, tolerance: float) -> Array | None:
    """Return the displacement of the object that explains a slipped fingertip, (3,) m along the table; None without a slip.

    Touches on plane faces do not show where the object is along them. A fingertip may therefore touch an edge, and slip off as
    the forces rise. It then moves along its inward normal while the others hardly move. With displacements r_i along the inward
    normals n_i since the touch, a fingertip has slipped if max_i (r_i − n_i · d) exceeds the tolerance, where d is the
    translation of the object that fits the r_i best. The displacement is along the face, from that fingertip towards the
    object's middle.

    Args:
        grasp: the grasp at the touch.
        p_tip: (N, 3) present centres of the fingertips, in H, m.
        down: (3,) unit vector along gravity, in H.
        tolerance: largest displacement of a fingertip that has not slipped, m.
    """
    normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
    p_touch = np.array([grasp.hand.tip_pose(grasp.q, name)[0] for name in grasp.fingers])
    runs = np.einsum("ij,ij->i", normals, p_tip - p_touch)  # m
    translation = np.linalg.lstsq(normals, runs, rcond=_LEAST_RATIO)[0]  # m
    excess = runs - normals @ translation  # m
    slipped = int(np.argmax(excess))
    if excess[slipped] <= tolerance:
        return None
    across = np.cross(normals[slipped], down)  # along the table and the face
    length = float(np.linalg.norm(across))
    lever = float((grasp.p_HO - p_touch[slipped]) @ across)
    if length == 0.0 or abs(lever) < _LEAST_LEVER * length:
        return None
    return np.asarray(np.copysign(_SHIFT, lever) * across / length)
