"""The two halves of a step about its forces: what is wanted before any is known, and what is settled when all are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graspforce.contact.kinematics import RollingContacts, TipContactState
from graspforce.control.mobility import Accelerations
from graspforce.core.arrays import Array


@dataclass(frozen=True, eq=False)
class StepTargets:
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
    uncontrollable_error: Array | None
    acceleration: Array
    joints: Array
    w: Array
    p_OC: Array
    R_OC: Array
    J: Array
    tip_contacts: TipContactState
    rolling: RollingContacts
    accelerations: Accelerations

    def apply_slip_margin(self, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        """(6,) w − G n s/μ and (n,) tau_u + Jᵀ n s/μ: with these the usual cones keep the margin s.

        Args:
            tau_u: (n,) what the hand's own motion takes, N·m.
            shift: (N,) s/μ, N.
        """
        normal = slice(2, None, 3)  # of each contact's three rows
        return self.w - shift @ self.rolling.B[normal], np.asarray(tau_u + shift @ self.rolling.A[normal])


class StepResult(NamedTuple):
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
    creep_distance: Array
    integral: Array
    has_warnings: bool
