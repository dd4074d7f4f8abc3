"""Data of a control step before and after the force solve."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from graspforce.contact.kinematics import RollingContacts, TipContactState
from graspforce.control.contacts.mobility import Accelerations
from graspforce.control.friction.friction_compensation import FrictionMemory
from graspforce.core.arrays import Array


@dataclass(frozen=True, eq=False)
class StepTargets:
    """Target accelerations of object and joints and the target wrench, at the present contacts.

    Attributes:
        error: (6,) pose error in H, m and rad.
        uncontrollable_error: (6,) part of the error that no finger motion can remove; None if every twist is feasible.
        object_acceleration: (6,) feasible acceleration of the object nearest to the commanded one, in H, m/s² and rad/s².
        joint_acceleration: (n,) joint accelerations, rad/s².
        w: (6,) wrench that the contacts must supply, about O's origin, in O, N and N·m.
        p_OC, R_OC, J, tip_contacts: as in `RollingContacts`.
        rolling: the contacts.
        accelerations: both accelerations with the uncontrollable twists; the object's in O.
    """

    error: Array
    uncontrollable_error: Array | None
    object_acceleration: Array
    joint_acceleration: Array
    w: Array
    p_OC: Array
    R_OC: Array
    J: Array
    tip_contacts: TipContactState
    rolling: RollingContacts
    accelerations: Accelerations

    @property
    def velocity_rows(self) -> tuple[Array, Array]:
        """A (3 N, n) and B (3 N, 6): contact velocities (t₁, t₂, n) per joint rate and per twist of the object in O."""
        return self.rolling.A, self.rolling.B

    def apply_slip_margin(self, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        """Return w − G n s/μ, (6,), and tau_u + Jᵀ n s/μ, (n,): with them the usual cones keep the slip margin s.

        Args:
            tau_u: (n,) torques without contact forces, N·m.
            shift: (N,) shift s/μ of each normal force, N.
        """
        normal = slice(2, None, 3)  # of the three rows of each contact
        return self.w - shift @ self.rolling.B[normal], np.asarray(tau_u + shift @ self.rolling.A[normal])


class FreeTorques(NamedTuple):
    """Torques of a step without contact forces.

    Attributes:
        own: (n,) torques of the hand's own motion, M q̈ + h, N·m.
        tau_u: (n,) the same with joint friction, within the limits of motors without contact, N·m.
        friction: memory of the friction compensation; None without one.
        is_at_rest: whether its plan is at rest.
    """

    own: Array
    tau_u: Array
    friction: FrictionMemory | None
    is_at_rest: bool


class IntegralRule(IntEnum):
    """When the integral of the pose error grows; the values of `gf_integral_rule` in C."""

    NEVER = 0
    UNLESS_SATURATED = 1  # unless a motor is at its torque limit
    ALWAYS = 2


class StepResult(NamedTuple):
    """Result of a control step.

    Attributes:
        tau: (n,) motor torques within their limits, N·m.
        saturated: whether a motor is at its limit.
        creep: (N, 2) recent sliding of each fingertip along t₁ and t₂, m.
        creep_distance: (N,) length of that sliding, m.
        integral: (6,) integral of the pose error in H, m·s and rad·s.
        has_warnings: whether a fingertip slips or has lost contact, or a joint is at the end of its range.
    """

    tau: Array
    saturated: bool
    creep: Array
    creep_distance: Array
    integral: Array
    has_warnings: bool
