"""How fingertips move: what one pass over a hand's joints says of them, for control."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.arrays import Array


@dataclass(frozen=True, eq=False, slots=True)
class TipMotion:
    """Some fingertips at one instant, each at its tip frame's origin, in H's axes, linear before angular.

    twist = J v, and its rate J v̇ + drift.

    Attributes:
        p_HF: (N, 3) origins of the tip frames in H, m.
        R_HF: (N, 3, 3) their axes in H, columns.
        J: (N, 6, n) their twists for each unit actuated rate, m/rad and 1.
        twist: (N, 6) velocities, m/s, and angular velocities, rad/s.
        drift: (N, 6) J̇ v: their accelerations, m/s² and rad/s², where no joint accelerates.
    """

    p_HF: Array
    R_HF: Array
    J: Array
    twist: Array
    drift: Array
