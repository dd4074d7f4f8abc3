"""Poses as records: `position`, and `rotation` (rows of the matrix) or `quaternion` (w, x, y, z)."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput


def pose_to_dict(p: Array, R: Array) -> dict[str, Any]:
    """Return the record of a pose.

    Args:
        p: (3,) position, m.
        R: (3, 3) rotation matrix.
    """
    return {"position": p.tolist(), "rotation": R.tolist()}


def pose_from_dict(record: object, field: str, optional: Collection[str] = ()) -> tuple[Array, Array, dict[str, Any]]:
    """Read a pose from its record.

    Args:
        record: mapping with `position` (m), and `rotation` or `quaternion`.
        field: path of the record, for errors.
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


def rotation_from_quaternion(quaternion: object, field: str) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion.

    Args:
        quaternion: (4,) (w, x, y, z), of any length except zero.
        field: path of the quaternion, for errors.

    Raises:
        InvalidInput: not four finite numbers, or zero.
    """
    numbers = arrays.check_array(quaternion, field, (4,))
    largest = float(np.abs(numbers).max())
    if largest == 0.0:
        raise InvalidInput(field, quaternion, "a quaternion (w, x, y, z) that is not zero")
    scaled = numbers / largest  # the squares of a tiny or huge quaternion would under- or overflow
    w, x, y, z = (scaled / np.linalg.norm(scaled)).tolist()
    return arrays.freeze(
        [
            [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )
