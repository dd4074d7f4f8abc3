"""The grasp after the touch: the object's pose from where the fingertips met it, and the contacts there.

The object stands on the table, so its pose error is a displacement (x, y) along the table and a rotation ψ about the vertical.
The estimate minimises

    Σ ((φ(p_i) − r_i)/σ_c)² + (x² + y²)/σ_p² + (ψ/σ_ψ)²,

with the signed distance φ of each tip's centre p_i from the surface and the tip's radius r_i. It is the most probable pose for
independent Gaussian errors of the touched places, σ_c, and of the expected pose, σ_p and σ_ψ, within two standard deviations of
the latter. So a fingertip that stopped where the object cannot be stays off its surface.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from graspforce.contact.contact import Contact, ContactSet
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Shape
from graspforce.geometry.rotations import rotation_exp
from graspforce.geometry.vectors import table_axes, unit_vectors
from graspforce.grasp.grasp import Grasp

POSE_DEVIATIONS = 2.0  # standard deviations of the object's pose within which it is
_CONVERGED = 1e-6  # relative change of the weighted errors


def pose_from_touch(
    grasp: Grasp, p_tip: Array, down: Array, settings: PhaseSettings, touching: npt.ArrayLike = True
) -> tuple[Array, Array]:
    """Return the most probable pose of an object on a table, p_HO (3,) in m and R_HO (3, 3).

    Args:
        grasp: the grasp with the expected pose.
        p_tip: (N, 3) centres of the fingertips, in H, m.
        down: (3,) unit vector along gravity, in H.
        settings: standard deviations of the errors.
        touching: (N,) whether each fingertip touches; the others do not count. Default: all do.

    Raises:
        InvalidInput: the object has no shape.
    """
    shape, counts = _surface(grasp), np.broadcast_to(touching, len(grasp.fingers))
    radii = np.array([grasp.hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])  # m
    deviations = np.array([settings.position_error, settings.position_error, settings.angle_error])

    def displaced(x: Array) -> tuple[Array, Array]:
        scaled = deviations * x
        return pose_on_table(grasp, down, scaled[:2], float(scaled[2]))

    def errors(x: Array) -> Array:
        p_HO, R_HO = displaced(x)
        distances = shape.signed_distance((p_tip - p_HO) @ R_HO) - radii
        return np.concatenate([distances[counts] / settings.contact_error, x])

    found = least_squares(errors, np.zeros(3), bounds=(-POSE_DEVIATIONS, POSE_DEVIATIONS), ftol=_CONVERGED)
    return displaced(found.x)


def pose_on_table(grasp: Grasp, down: Array, offset: npt.ArrayLike, angle: float) -> tuple[Array, Array]:
    """Return the object's pose after a displacement along the table and a rotation about the vertical through O's origin.

    Args:
        grasp: the grasp with the expected pose.
        down: (3,) unit vector along gravity, in H.
        offset: (2,) displacement along `table_axes(down)`, m.
        angle: rotation about the vertical, rad.

    Returns:
        p_HO (3,), m, and R_HO (3, 3).
    """
    p_HO = grasp.p_HO + np.asarray(offset) @ table_axes(down)
    return np.asarray(p_HO), np.asarray(rotation_exp(angle * down) @ grasp.R_HO)


def touched_grasp(grasp: Grasp, q: Array, p_tip: Array, pose: tuple[Array, Array]) -> Grasp:
    """Return the grasp with its contacts where the fingertips touch the object.

    Args:
        grasp: the grasp as planned; it gives friction and contact models.
        q: (n,) measured joint positions, rad.
        p_tip: (N, 3) centres of the fingertips, in H, m.
        pose: p_HO (3,) and R_HO (3, 3) of the object.

    Raises:
        InvalidInput: the object has no shape.
    """
    shape, (p_HO, R_HO) = _surface(grasp), pose
    centres = (p_tip - p_HO) @ R_HO
    points = shape.project_to_surface(centres)
    outside = shape.phi(centres) > 0.0
    contacts = []
    for i, contact in enumerate(grasp.contacts.contacts):
        n = unit_vectors((points[i] - centres[i])[None])[0] if outside[i] else shape.inward_normal(points[i])
        tangent = Contact(points[i], n, 0.0).tangent
        contacts.append(replace(contact, position=points[i], normal=n, tangent=tangent))
    return replace(grasp, contacts=ContactSet.stack(contacts), q=q, p_HO=p_HO, R_HO=R_HO)


def surface_distances(grasp: Grasp, pose: tuple[Array, Array], points: Array) -> Array:
    """Return signed distances (N,) of points from the object's surface, m; negative inside.

    Args:
        grasp: the grasp with the object.
        pose: p_HO (3,) and R_HO (3, 3) of the object.
        points: (N, 3) points, in H, m.

    Raises:
        InvalidInput: the object has no shape.
    """
    p_HO, R_HO = pose
    return _surface(grasp).signed_distance((points - p_HO) @ R_HO)


def touch_gaps(grasp: Grasp, p_tip: Array) -> Array:
    """Return the distances (N,) between the fingertips' surfaces and the object's, m; negative in penetration.

    Args:
        grasp: the grasp, with the object's pose.
        p_tip: (N, 3) centres of the fingertips, in H, m.

    Raises:
        InvalidInput: the object has no shape.
    """
    radii = np.array([grasp.hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])  # m
    return np.asarray(surface_distances(grasp, (grasp.p_HO, grasp.R_HO), p_tip) - radii)


def contact_shifts(planned: Grasp, touched: Grasp) -> tuple[Array, Array]:
    """Return how far each contact is from its place in the plan, both in O: distances (N,), m, and angles of normals, rad.

    Args:
        planned: the grasp as planned.
        touched: the grasp after the touch.
    """
    distances = np.linalg.norm(touched.contacts.p_OC - planned.contacts.p_OC, axis=1)
    cosines = np.einsum("ij,ij->i", touched.contacts.R_OC[:, :, 2], planned.contacts.R_OC[:, :, 2])
    return distances, np.array([math.acos(min(1.0, max(-1.0, each))) for each in cosines.tolist()])


def _surface(grasp: Grasp) -> Shape:
    """Return the surface of the object; raise InvalidInput if it has none."""
    if grasp.body.shape is None:
        raise InvalidInput("grasp.body.shape", None, "given: the object's pose follows from its surface")
    return grasp.body.shape
