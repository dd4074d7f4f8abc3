"""Candidates of the grasp search: their variables, the requirements on their geometry, and what is measured of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.grasp.search.side_conditions import SideConditions

Indices = npt.NDArray[np.intp]

_NO_CONDITIONS = SideConditions()


@dataclass(frozen=True, eq=False, slots=True)
class GeometryRequirements:
    """Requirements on the geometry of a grasp.

    Args:
        clearance: least distance between fingers, and of the object from palm and links, m.
        edge_ratio: least distance of a contact from the edge of its face, divided by the tip radius.
        palm_normal_H: (3,) unit normal of the palm in H, outward.
        palm_point_H: (3,) point of the palm's surface in H, m.
        travel: distance by which the fingers can move the object both ways along each of their directions, m.
        side: approach direction, table and opposed fingers.
        keeps_overlaps: whether candidates keep the distances of bodies that overlapped in earlier ones. It helps classes,
            whose fingers are often close to one another.
    """

    clearance: float
    edge_ratio: float
    palm_normal_H: Array
    palm_point_H: Array
    travel: float
    side: SideConditions = _NO_CONDITIONS
    keeps_overlaps: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Candidates:
    """B candidates of a search: their variables and constants.

    Attributes:
        x: (B, n + 6 + N) the variables: posture, rad; position of the object in H, m; rotation of the object from `R_start` as
            a rotation vector, rad; and the weights λ.
        R_start: (B, 3, 3) the object's axes in H at the start.
        face: (B, N) index of the face that each finger touches.
    """

    x: Array
    R_start: Array
    face: Indices


@dataclass(frozen=True, eq=False, slots=True)
class CandidateMeasures:
    """Measures of B candidates. Lengths in m; a negative gap is an overlap.

    Attributes:
        q: (B, n) postures, rad.
        p_HO: (B, 3) positions of the object in H.
        R_HO: (B, 3, 3) the object's axes in H.
        tip_centres: (B, N, 3) centres of the touching tips in O.
        contact_distance: (B, N) distance of each touching tip from its face.
        edge_distance: (B, N) distance of each contact from the edge of its face.
        normal: (B, N, 3) inward normals in O.
        normal_gain: (B, N) ‖J⁺ n‖, joint rate per tip speed along the normal, rad/m.
        limit_margin: (B, n_used) least joint limit margins during the travel, to first order, rad; of a prismatic joint in
            units of 50 mm.
        min_tip_speed: (B, N) tip speed per joint rate in the slowest of the directions that the finger has, m/rad.
        undriven_speed: (B, N, U) speed of each contact along its normal per rate of each joint without motor, m/rad.
        link_gap: (B, F) least gap between the spheres of each finger and the object; without the touching tips.
        finger_gap: (B, F(F−1)/2) least gap between the spheres of each pair of fingers.
        palm_gap: (B,) gap between the object and the palm: its plane, or its spheres.
        side_margin: (B, K) by how much the side conditions are met, m.
        pair_distance: (B, P) distances of the goal's pairs of bodies, m.
    """

    q: Array
    p_HO: Array
    R_HO: Array
    tip_centres: Array
    contact_distance: Array
    edge_distance: Array
    normal: Array
    normal_gain: Array
    limit_margin: Array
    min_tip_speed: Array
    undriven_speed: Array
    link_gap: Array
    finger_gap: Array
    palm_gap: Array
    side_margin: Array
    pair_distance: Array
