"""How links and fingertips move: what one pass over a hand's joints says of them, for control."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.core.arrays import Array


@dataclass(frozen=True, eq=False, slots=True)
class LinkMotion:
    """A hand's joints and links at one instant, in H's axes, linear before angular.

    The arrays are the workspace's own: the thread's next sweep writes them anew, and nobody else may.

    Attributes:
        J: (6, n_full) the twist, at H's origin, of what a joint carries, for its unit rate, m/rad and 1.
        J_rate: (6, n_full) J̇, its time derivative.
        places: p_HL (3,), m, and R_HL (3, 3) of the base and of every joint's link, one after the other.
    """

    J: Array
    J_rate: Array
    link_poses: tuple[Array, ...]
