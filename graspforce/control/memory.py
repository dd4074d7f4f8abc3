"""What one step of the controller leaves to the next."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.contact.kinematics import TipContactState
from graspforce.core.arrays import Array


@dataclass(frozen=True, eq=False, slots=True)
class ControlMemory:
    """What a step leaves to the next.

    Attributes:
        integral: (6,) ∫e dt in H, m·s and rad·s.
        R_OC: (N, 3, 3) the contact frames in O.
        creep: (N, 2) lately slid along t₁ and t₂, m.
        f: (k,) the last certified forces, N and N·m; None before there are any.
        touched: where the fingertips stood on the object; where it is None, sliding is taken from the velocities.
    """

    integral: Array
    R_OC: Array
    creep: Array
    f: Array | None
    tip_contacts: TipContactState | None = None
