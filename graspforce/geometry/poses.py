"""Poses as records: `position`, and `rotation` (rows of the matrix) or `quaternion` (w, x, y, z). Interpolation of poses."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.core.constants import LARGEST_DISTANCE
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.geometry.rotations import rotation_exp, rotation_from_quaternion, rotation_log


def pose_to_dict(p: Array, R: Array) -> JsonRecord:
    """Return the record of a pose.

    Args:
        p: (3,) position, m.
        R: (3, 3) rotation matrix.
    """
    return {"position": p.tolist(), "rotation": R.tolist()}


def pose_from_dict(record: object, field: str, optional: Collection[str] = ()) -> tuple[Array, Array, JsonRecord]:
    """Read a pose from its record.

    Args:
        record: mapping with `position` (m, at most 1e3 in each direction), and `rotation` or `quaternion`.
        field: path of the record, for error messages.
        optional: names of further fields that the record may have; the caller reads them.

    Returns:
        The position (3,) in m, the rotation matrix (3, 3), and all fields of the record.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    values = fields.check_record(record, field, required=["position"], optional=["rotation", "quaternion", *optional])
    if ("rotation" in values) == ("quaternion" in values):
        raise InvalidInput(field, record, "given with either rotation or quaternion")
    p = arrays.check_array(values["position"], f"{field}.position", (3,), limit=LARGEST_DISTANCE)
    if "rotation" in values:
        return p, arrays.check_rotation(values["rotation"], f"{field}.rotation"), values
    return p, rotation_from_quaternion(values["quaternion"], f"{field}.quaternion"), values


def interpolate_pose(p: Array, R: Array, p_target: Array, R_target: Array, share: float) -> tuple[Array, Array, float]:
    """Return the pose at a share of the way to another one, compiled if possible: on a straight line and about a fixed axis.

    Args:
        p: (3,) position, m.
        R: (3, 3) rotation matrix.
        p_target: (3,) the other position, m.
        R_target: (3, 3) the other rotation matrix.
        share: from 0 to 1.

    Returns:
        Position (3,) and rotation matrix (3, 3), read-only, and the largest component of the whole way, m and rad.
    """
    if native is None:
        return interpolate_pose_reference(p, R, p_target, R_target, share)
    p_next, R_next = np.empty(3), np.empty((3, 3))
    far: float = native.interpolate_pose(
        p=p, R=R, p_target=p_target, R_target=R_target, share=share, p_next=p_next, R_next=R_next
    )
    p_next.setflags(write=False)
    R_next.setflags(write=False)
    return p_next, R_next, far


def interpolate_pose_reference(
    p: Array, R: Array, p_target: Array, R_target: Array, share: float
) -> tuple[Array, Array, float]:
    """Return the same as `interpolate_pose`, in NumPy.

    Args:
        p: (3,) position, m.
        R: (3, 3) rotation matrix.
        p_target: (3,) the other position, m.
        R_target: (3, 3) the other rotation matrix.
        share: from 0 to 1.
    """
    way, turn = p_target - p, rotation_log(R_target @ R.T)  # m and rad
    far = max(map(abs, (*way.tolist(), *turn)))
    return arrays.freeze(p + share * way), arrays.freeze(rotation_exp([share * x for x in turn]) @ R), far
