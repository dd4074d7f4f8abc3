"""Motion of a hand's links at one instant."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.core.arrays import Array


@dataclass(frozen=True, eq=False, slots=True)
class LinkMotion:
    """Joints and links of a hand at one instant, in H's axes, linear first.

    The arrays are views of a thread's workspace: the next call in the same thread overwrites them. Do not write to them.

    Attributes:
        J: (6, n_full) column j: twist at H's origin of the bodies that joint j moves, per unit rate, m/rad and 1.
        J_rate: (6, n_full) J̇, 1/s.
        link_poses: p_HL (3,), m, and R_HL (3, 3) by turns, for the base and then for the link of each joint.
    """

    J: Array
    J_rate: Array
    link_poses: tuple[Array, ...]
