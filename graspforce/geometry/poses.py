"""Poses as records: `position`, and `rotation` (rows of the matrix) or `quaternion` (w, x, y, z)."""

from __future__ import annotations

from collections.abc import Collection

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.geometry.rotations import rotation_from_quaternion


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
        record: mapping with `position` (m), and `rotation` or `quaternion`.
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
    p = arrays.check_array(values["position"], f"{field}.position", (3,))
    if "rotation" in values:
        return p, arrays.check_rotation(values["rotation"], f"{field}.rotation"), values
    return p, rotation_from_quaternion(values["quaternion"], f"{field}.quaternion"), values
