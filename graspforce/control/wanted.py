"""The two halves of a step about its forces: what is wanted before any is known, and what is settled when all are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graspforce.arrays import Array
from graspforce.control.mobility import Accelerations
from graspforce.control.rolling import RollingContacts, Touched


@dataclass(frozen=True, eq=False)
class Wanted:
    """What object and joints shall do, at the contacts where they are now.

    Attributes:
        error: (6,) from where the object is to where it should be, in H, m and rad.
        lost: (6,) the part of it that no motion of the fingers can take away; None where they can make every motion.
        acceleration: (6,) the object's, in H, the nearest to the command that the fingers can make, m/s² and rad/s².
        joints: (n,) the joints', rad/s².
        w: (6,) the wrench that the contacts must supply for that, in O, N and N·m.
        p_OC, R_OC, J, touched: as `RollingContacts` has them.
        rolling: the contacts.
        moves: both accelerations, and what the fingers cannot make.
    """

    error: Array
    lost: Array | None
    acceleration: Array
    joints: Array
    w: Array
    p_OC: Array
    R_OC: Array
    J: Array
    touched: Touched
    rolling: RollingContacts
    moves: Accelerations

    def tightened(self, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        """(6,) w − G n s/μ and (n,) tau_u + Jᵀ n s/μ: with these the usual cones keep the margin s.

        Args:
            tau_u: (n,) what the hand's own motion takes, N·m.
            shift: (N,) s/μ, N.
        """
        normal = slice(2, None, 3)  # of each contact's three rows
        return self.w - shift @ self.rolling.B[normal], np.asarray(tau_u + shift @ self.rolling.A[normal])


class Settled(NamedTuple):
    """What comes of the forces.

    Attributes:
        tau: (n,) the motors' torques, within their limits, N·m.
        saturated: whether a motor is at its limit.
        creep: (N, 2) lately slid along t₁ and t₂, m.
        crept: (N,) how far that is, m.
        integral: (6,) ∫e dt, m·s and rad·s.
        noted: whether a tip slips or is off the object, or a joint is at the end of its range.
    """

    tau: Array
    saturated: bool
    creep: Array
    crept: Array
    integral: Array
    noted: bool
