"""The nine meta motions of a finger: eight by the signs of its joint rates, and rest.

A finger has four angles: 1 distal–intermediate, 2 proximal–intermediate, 3 abduction (of a thumb: rotation), 4
metacarpal–proximal. Flexion is positive. The sign of angle 2 states whether the finger opens or closes; angle 1 decides if
angle 2 rests. The signs of angles 3 and 4 state the direction. Source: HANDLE project, Parameterizing and creating new
actions (undated), table 2.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array

META_MOTIONS = tuple(range(1, 10))  # 1 to 4 open the finger, 5 to 8 close it, 9 is rest
IDLE = 9
_DIRECTIONS = ((1, 1), (-1, 1), (-1, -1), (1, -1))  # signs of angles 3 and 4 of motions 1 to 4, and of 5 to 8

Flags = npt.NDArray[np.bool_]


def meta_motion_conditions(v: npt.ArrayLike, deadband: float = 0.0) -> Flags:
    """Return which meta motions the changes of a finger's angles allow.

    An angle that rests allows both signs, so that several of the motions 1 to 8 may be allowed at once. None is allowed if
    angles 1 and 2 rest and another angle moves.

    Args:
        v: (T, 4) changes of the four angles between frames, in any unit.
        deadband: largest magnitude of a change that counts as rest, in the same unit, ≥ 0.

    Returns:
        (T, 9) flags of the motions 1 to 9.

    Raises:
        InvalidInput: an argument is not allowed.
    """
    v = arrays.check_array(v, "v", (None, 4))
    deadband = arrays.check_number(deadband, "deadband", minimum=0.0)
    sign = np.where(np.abs(v) <= deadband, 0, np.sign(v)).astype(int)
    flexion = np.where(sign[:, 1] != 0, sign[:, 1], sign[:, 0])
    allowed = np.zeros((len(v), 9), dtype=bool)
    for j in range(8):
        side, lift = _DIRECTIONS[j % 4]
        allowed[:, j] = (flexion == (-1 if j < 4 else 1)) & (sign[:, 2] * side >= 0) & (sign[:, 3] * lift >= 0)
    allowed[:, IDLE - 1] = ~sign.any(axis=1)
    return allowed


def intensities(v: Array, allowed: Flags, epsilon: float) -> Array:
    """Return the intensity of each meta motion in each frame, equation (1): Σ_k |v_k| + ε where allowed, else 0; 1 for rest.

    Args:
        v: (T, 4) changes of the angles.
        allowed: (T, 9) flags of `meta_motion_conditions`.
        epsilon: ε > 0, in the unit of v.

    Returns:
        (T, 9).
    """
    strength = np.abs(v).sum(axis=1) + epsilon
    result = np.where(allowed, strength[:, None], 0.0)
    result[:, IDLE - 1] = allowed[:, IDLE - 1]
    return result
