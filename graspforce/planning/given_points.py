"""Checks of the poses and postures that a move is given: finite, different from one to the next, and within joint limits."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand
from graspforce.planning.task import HandTask, Task

METRES_PER_RADIAN = 0.05  # m: weighs rotations in the distance of two poses, about the size of a held object
LIMIT_TOLERANCE = 1e-3  # largest excess of a given posture beyond a joint's limits, relative to the joint's range

MIN_DISTANCE = 1e-7  # m or rad: nearer poses or postures count as equal
_MAX_COORDINATE = 1e3  # m


def check_poses(p_HO: npt.ArrayLike, R_HO: npt.ArrayLike, count: int | None = None) -> tuple[Array, Array]:
    """Return positions (m, 3) and orientations (m, 3, 3) of a move, at least two, each different from the one before.

    Args:
        p_HO: (m, 3) positions of O in H, each coordinate at most 1000 m.
        R_HO: (m, 3, 3) orientations.
        count: the number of poses; None for any.

    Raises:
        InvalidInput: a wrong shape, a number out of range, not a rotation matrix, or equal poses in a row; names the pose.
    """
    p = arrays.check_array(p_HO, "p_HO", (None, 3))
    R = arrays.check_rotations(R_HO, "R_HO", len(p))
    if len(p) < 2:
        raise InvalidInput("p_HO", p, "at least two poses")
    if count is not None and len(p) != count:
        raise InvalidInput("p_HO", f"{len(p)} poses", "two poses, start and goal")
    for i in np.flatnonzero((np.abs(p) > _MAX_COORDINATE).any(axis=1)):
        raise InvalidInput(f"p_HO[{i}]", p[i], f"coordinates of at most {_MAX_COORDINATE:g} m")
    check_different(pose_distances(p, R), p, "p_HO")
    return p, R


def pose_distances(p: Array, R: Array) -> Array:
    """Return the distances (m − 1,) from each pose to the next, m; a radian counts as 5 cm.

    Args:
        p: (m, 3) positions, m.
        R: (m, 3, 3) orientations.
    """
    rotations = Rotation.from_matrix(R)
    angles = (rotations[:-1].inv() * rotations[1:]).magnitude()  # rad
    return np.asarray(np.hypot(np.linalg.norm(np.diff(p, axis=0), axis=1), METRES_PER_RADIAN * angles))


def check_different(distances: Array, points: Array, field: str) -> None:
    """Raise an error if a pose or posture is equal to the one before.

    Args:
        distances: (m − 1,) distances from each to the next, m or rad.
        points: (m, …) the poses' positions, or the postures.
        field: their name for errors.

    Raises:
        InvalidInput: a distance is almost zero; names the second one.
    """
    for i in np.flatnonzero(distances < MIN_DISTANCE):
        raise InvalidInput(f"{field}[{i + 1}]", points[i + 1], "different from the one before: nothing moves between them")


def check_postures(hand: Hand, postures: npt.ArrayLike, field: str) -> Array:
    """Return postures (m, n) of a move, each within the joint limits and different from the one before.

    Args:
        hand: the hand; a posture may exceed its limits by `LIMIT_TOLERANCE`.
        postures: (m, n) rad, at least two.
        field: name of the postures for errors.

    Raises:
        InvalidInput: a wrong shape, a position beyond its limits, or equal postures in a row; names the posture.
    """
    q = arrays.check_array(postures, field, (None, hand.n))
    if len(q) < 2:
        raise InvalidInput(field, q, "at least two postures")
    for i, each in enumerate(q):
        check_posture(hand, each, f"{field}[{i}]")
    check_different(np.linalg.norm(np.diff(q, axis=0), axis=1), q, field)
    return q


def check_start_posture(task: Task, q_start: npt.ArrayLike | None) -> Array | None:
    """Return the posture (n,) near the start of a move, within the joint limits; None for the neutral posture.

    Args:
        task: the task; ideal fingers have no joints.
        q_start: (n,) posture, rad, or None.

    Raises:
        InvalidInput: a wrong shape, or a position beyond its limits; names the joint.
    """
    if q_start is None:
        return None
    return (
        check_posture(task.hand, q_start, "q_start")
        if isinstance(task, HandTask)
        else arrays.check_array(q_start, "q_start", (0,))
    )


def check_posture(hand: Hand, posture: npt.ArrayLike, field: str) -> Array:
    """Return a posture (n,) within the joint limits, rad.

    Args:
        hand: the hand; the posture may exceed its limits by `LIMIT_TOLERANCE`.
        posture: (n,) rad.
        field: its name for errors.

    Raises:
        InvalidInput: a wrong shape, or a position beyond its limits; names the joint.
    """
    q = arrays.check_array(posture, field, (hand.n,))
    allowed = LIMIT_TOLERANCE * (hand.q_upper - hand.q_lower)
    for i in np.flatnonzero((q < hand.q_lower - allowed) | (q > hand.q_upper + allowed)):
        joint = hand.joints[i]
        limits = f"within [{joint.lower:.4g}, {joint.upper:.4g}] rad, the limits of {joint.name}"
        raise InvalidInput(f"{field}[{i}]", float(q[i]), limits)
    return q
