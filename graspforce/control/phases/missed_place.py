"""Fingertips that slip past an edge, pass beside the object, or touch it late, and where the object then is."""

from __future__ import annotations

import numpy as np

from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.touched_grasp import pose_from_touch, touch_gaps, touched_grasp
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp

_SHIFT = 8e-3  # m: the object's position error is at most 12 mm, and a contact at least 4 mm from the edge
_LEAST_RATIO = 0.3  # of singular values: directions in which the normals hardly differ do not explain runs
_LEAST_LEVER = 3e-3  # m: distance of the contact from the object's middle, along the edge, that shows a direction


def run_alone(grasp: Grasp, p_tip: Array) -> tuple[int, float]:
    """Return the fingertip that has moved most along its normal beside a motion of the object, and how far, m.

    With displacements r_i along the inward normals n_i since the touch, the distance is max_i (r_i − n_i · d), where d is the
    translation of the object that fits the r_i best.

    Args:
        grasp: the grasp at the touch.
        p_tip: (N, 3) present centres of the fingertips, in H, m.
    """
    normals = _inward_normals(grasp)
    runs = np.einsum("ij,ij->i", normals, p_tip - _touch_places(grasp))  # m
    translation = np.linalg.lstsq(normals, runs, rcond=_LEAST_RATIO)[0]  # m
    excess = runs - normals @ translation  # m
    finger = int(np.argmax(excess))
    return finger, float(excess[finger])


def shift_of_slip(grasp: Grasp, p_tip: Array, down: Array, tolerance: float) -> Array | None:
    """Return the displacement of the object that explains a slipped fingertip, (3,) m along the table; None without a slip.

    Touches on plane faces do not show where the object is along them. A fingertip may therefore touch an edge, and slip off as
    the forces rise. It then runs along its inward normal while the others hardly move; see `run_alone`.

    Args:
        grasp: the grasp at the touch.
        p_tip: (N, 3) present centres of the fingertips, in H, m.
        down: (3,) unit vector along gravity, in H.
        tolerance: largest run of a fingertip that has not slipped, m.
    """
    finger, run = run_alone(grasp, p_tip)
    return shift_of_miss(grasp, finger, _touch_places(grasp)[finger], down) if run > tolerance else None


def shift_of_miss(grasp: Grasp, finger: int, p_tip: Array, down: Array) -> Array | None:
    """Return the displacement of the object that explains a fingertip beside it, (3,) m along the table.

    The displacement is along the face, from the fingertip towards the object's middle. The result is None if the fingertip is
    at the middle, or its normal is vertical.

    Args:
        grasp: the grasp with the expected pose of the object.
        finger: index of the fingertip in the grasp.
        p_tip: (3,) centre of the fingertip, in H, m.
        down: (3,) unit vector along gravity, in H.
    """
    across = np.cross(_inward_normals(grasp)[finger], down)  # along the table and the face
    length = float(np.linalg.norm(across))
    lever = float((grasp.p_HO - p_tip) @ across)
    if length == 0.0 or abs(lever) < _LEAST_LEVER * length:
        return None
    return np.asarray(np.copysign(_SHIFT, lever) * across / length)


def shift_of_late_touch(planned: Grasp, touched: Grasp, p_tip: Array, down: Array, settings: PhaseSettings) -> Array | None:
    """Return the displacement of the object that a late touch shows, (3,) m along the table; None if no finger was late.

    Static friction may stop a fingertip before the object, which then seems to be elsewhere. The rising forces move it on to
    the surface. It has touched late if it has run alone by more than the contact tolerance, and now all fingertips fit the
    object.

    Args:
        planned: the grasp as planned.
        touched: the grasp at the touch.
        p_tip: (N, 3) present centres of the fingertips, in H, m.
        down: (3,) unit vector along gravity, in H.
        settings: tolerances, and standard deviations of the errors.
    """
    if run_alone(touched, p_tip)[1] <= settings.contact_tolerance:
        return None
    pose = pose_from_touch(planned, p_tip, down, settings)
    if float(np.abs(touch_gaps(touched_grasp(planned, touched.q, p_tip, pose), p_tip)).max()) > settings.contact_tolerance:
        return None
    return along_table(pose[0] - planned.p_HO, down)


def along_table(shift: Array, down: Array) -> Array:
    """Return the part of a displacement along the table, (3,) m.

    Args:
        shift: (3,) the displacement, in H, m.
        down: (3,) unit vector along gravity, in H.
    """
    return np.asarray(shift - (shift @ down) * down)


def _inward_normals(grasp: Grasp) -> Array:
    """Return the inward normals (N, 3) of the contacts, in H."""
    return np.asarray(grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T)


def _touch_places(grasp: Grasp) -> Array:
    """Return the centres (N, 3) of the fingertips in the grasp's posture, in H, m."""
    return np.array([grasp.hand.tip_pose(grasp.q, name)[0] for name in grasp.fingers])
