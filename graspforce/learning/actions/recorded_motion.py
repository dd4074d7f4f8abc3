"""The motion of an object in a recording, as a reference for another object of another size.

From its start, the object moves by d(t) in H and turns by R(t). Another object, s times as large, starts at (p, R₀). It takes
the poses p + s d(t), R(t) R₀: fingertips on its surface then move s times as far, in the same directions. Poses between which
the object hardly moves are left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.geometry.rotations import rotation_log

_LEAST_DISTANCE = 1e-4  # m, between two poses of the reference
_LEAST_TURN = 2e-3  # rad


class RecordedMotion(NamedTuple):
    """Poses of an object, the first of which is its start.

    Attributes:
        p_HO: (M, 3) positions of O in H, m.
        R_HO: (M, 3, 3) axes of the object in H.
    """

    p_HO: Array
    R_HO: Array


def recorded_motion(p_HO: npt.ArrayLike, R_HO: npt.ArrayLike, start: BodyMotion, size_ratio: float = 1.0) -> RecordedMotion:
    """Return the poses of a recorded motion for an object with another start and another size.

    Plan a path through the poses for the grasp of the new object: the plan has the forces, times and limits of that object.

    Args:
        p_HO: (T, 3) recorded positions of O in H, m.
        R_HO: (T, 3, 3) recorded axes of the object in H.
        start: pose of the other object at its start.
        size_ratio: size of the other object divided by that of the recorded one, > 0.

    Raises:
        InvalidInput: another shape, no rotation, or the recorded object does not move.
    """
    places = arrays.check_array(p_HO, "p_HO", (None, 3))
    axes = arrays.check_rotations(R_HO, "R_HO", len(places))
    ratio = arrays.check_number(size_ratio, "size_ratio", above=0.0)
    kept = [0]
    for k in range(1, len(places)):
        turn = np.linalg.norm(rotation_log(axes[k] @ axes[kept[-1]].T))
        if ratio * np.linalg.norm(places[k] - places[kept[-1]]) >= _LEAST_DISTANCE or turn >= _LEAST_TURN:
            kept.append(k)
    if len(kept) < 2:
        raise InvalidInput("p_HO", places, f"a motion by {_LEAST_DISTANCE:g} m or {_LEAST_TURN:g} rad at least")
    displacements, turns = places[kept] - places[0], axes[kept] @ axes[0].T
    return RecordedMotion(freeze(start.p_HO + ratio * displacements), freeze(turns @ start.R_HO))
