"""Rotation matrices: logarithm, exponential, and conversion from a quaternion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput


def rotation_log(R: Array) -> list[float]:
    """Return the rotation vector θ a of a rotation matrix R = exp(θ â), with axis a and angle 0 ≤ θ ≤ π.

    The unit quaternion is computed from its largest component (Shepperd, 1978), and θ = 2 atan2(‖vector‖, |scalar|). So the
    result is accurate to rounding near 0 and near π. At θ = π both a and −a are valid; one of them is returned.

    Args:
        R: (3, 3) rotation matrix.

    Returns:
        Three numbers, rad.
    """
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = R.tolist()
    squares = (r00 + r11 + r22, r00, r11, r22)  # 4 q² = 1 + trace for the scalar, 1 + 2 rᵢᵢ − trace for the others
    largest = max(range(4), key=squares.__getitem__)
    if largest == 0:
        w, x, y, z = 1.0 + squares[0], r21 - r12, r02 - r20, r10 - r01
    elif largest == 1:
        w, x, y, z = r21 - r12, 1.0 + r00 - r11 - r22, r01 + r10, r02 + r20
    elif largest == 2:
        w, x, y, z = r02 - r20, r01 + r10, 1.0 - r00 + r11 - r22, r12 + r21
    else:
        w, x, y, z = r10 - r01, r02 + r20, r12 + r21, 1.0 - r00 - r11 + r22
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return [0.0, 0.0, 0.0]
    scale = math.copysign(2.0 * math.atan2(sine, abs(w)) / sine, w)
    return [scale * x, scale * y, scale * z]


def rotation_from_quaternion(quaternion: object, field: str) -> Array:
    """Return the rotation matrix of a quaternion.

    Args:
        quaternion: (4,) (w, x, y, z), of any length except zero.
        field: path of the quaternion, for error messages.

    Returns:
        (3, 3), read-only.

    Raises:
        InvalidInput: not four finite numbers, or zero.
    """
    numbers = arrays.check_array(quaternion, field, (4,))
    largest = float(np.abs(numbers).max())
    if largest == 0.0:
        raise InvalidInput(field, quaternion, "a quaternion (w, x, y, z) that is not zero")
    scaled = numbers / largest  # prevents overflow and underflow of the squares
    w, x, y, z = (scaled / np.linalg.norm(scaled)).tolist()
    return arrays.freeze(
        [
            [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def rotation_exp(rotation_vector: Sequence[float] | Array) -> Array:
    """Return the rotation matrix R = exp(θ â) of a rotation vector θ a by the unit quaternion.

    Args:
        rotation_vector: (3,) θ a, rad.

    Returns:
        (3, 3).
    """
    x, y, z = rotation_vector.tolist() if isinstance(rotation_vector, np.ndarray) else rotation_vector
    half = 0.5 * math.sqrt(x * x + y * y + z * z)  # rad: θ/2
    s = 0.5 * math.sin(half) / half if half > 0.0 else 0.5  # sin(θ/2)/θ
    w, i, j, k = math.cos(half), s * x, s * y, s * z
    return np.array(
        [
            [1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j - w * k), 2.0 * (i * k + w * j)],
            [2.0 * (i * j + w * k), 1.0 - 2.0 * (i * i + k * k), 2.0 * (j * k - w * i)],
            [2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)],
        ]
    )
