"""How links and fingertips move: what one pass over a hand's joints says of them, for control."""

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
        rates: (N, 6, n + 2) J, twist and drift side by side, as they are taken to the contacts.
    """

    p_HF: Array
    R_HF: Array
    rates: Array

    @property
    def J(self) -> Array:
        """(N, 6, n) the tips' twists for each unit actuated rate, m/rad and 1."""
        return self.rates[:, :, :-2]

    @property
    def twist(self) -> Array:
        """(N, 6) velocities, m/s, and angular velocities, rad/s."""
        return self.rates[:, :, -2]

    @property
    def drift(self) -> Array:
        """(N, 6) J̇ v: their accelerations, m/s² and rad/s², where no joint accelerates."""
        return self.rates[:, :, -1]


@dataclass(frozen=True, eq=False, slots=True)
class Sweep:
    """A hand's joints and links at one instant, in H's axes, linear before angular.

    The arrays are the workspace's own: the thread's next sweep writes them anew, and nobody else may.

    Attributes:
        J: (6, n_full) the twist, at H's origin, of what a joint carries, for its unit rate, m/rad and 1.
        J_rate: (6, n_full) J̇, its time derivative.
        places: p_HL (3,), m, and R_HL (3, 3) of the base and of every joint's link, one after the other.
    """

    J: Array
    J_rate: Array
    places: tuple[Array, ...]
