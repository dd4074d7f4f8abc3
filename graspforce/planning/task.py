"""What a move is about, whichever way it goes: the hand, the object, the contacts between them, gravity and what to keep back.

Three kinds of task are planned by the same equations: a hand that moves an object between its fingertips; fingers that move
alone; and an object between ideal fingers, of which only the contacts' limits are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce import arrays
from graspforce.arrays import Array
from graspforce.body import Body, BodyMotion
from graspforce.contact import Contact, ContactSet
from graspforce.errors import InvalidInput
from graspforce.hand import EARTH, Hand
from graspforce.problem import ForceProblem


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """What a move is about.

    Args:
        hand: the hand; None for ideal fingers, of which only the contacts' limits count.
        body: the object; None where fingers move alone.
        contacts: the contacts, in O, where they stay throughout the move; none where fingers move alone.
        fingers: the finger at each contact, by name, each once; empty without a hand or an object.
        gravity_H: (3,) the acceleration of gravity in H, m/s².
        slip_margin: the friction to keep back at every contact: load ≤ μ f_n − slip_margin, N.

    Raises:
        InvalidInput: things that do not belong together.
    """

    hand: Hand | None = None
    body: Body | None = None
    contacts: ContactSet | None = None
    fingers: tuple[str, ...] = ()
    gravity_H: Array = EARTH  # type: ignore[assignment]  # __post_init__ makes the array
    slip_margin: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "gravity_H", arrays.array(self.gravity_H, "gravity_H", (3,)))
        object.__setattr__(self, "slip_margin", arrays.number(self.slip_margin, "slip_margin", minimum=0.0))
        if self.hand is None and self.body is None:
            raise InvalidInput("hand", None, "given where there is no body")
        if (self.body is None) != (self.contacts is None):
            raise InvalidInput("contacts", None, "given with a body, and only then")
        fingers: Any = self.fingers
        if isinstance(fingers, str):
            raise InvalidInput("fingers", fingers, "a list of finger names, one for each contact")
        object.__setattr__(self, "fingers", tuple(fingers))
        wanted = len(self.contacts) if self.contacts is not None and self.hand is not None else 0
        if len(self.fingers) != wanted or len(set(self.fingers)) < wanted:
            raise InvalidInput("fingers", self.fingers, f"{wanted} different finger names, one for each contact of the hand")
        if self.hand is not None:
            for name in self.fingers:
                self.hand.finger(name)

    @classmethod
    def holding(
        cls, hand: Hand | None, body: Body, contacts: Sequence[Contact], fingers: Sequence[str] = (), **rest: Any
    ) -> Task:
        """A hand, or ideal fingers, with an object between them. Arguments as above."""
        return cls(hand, body, ContactSet.stack(contacts), tuple(fingers), **rest)

    @property
    def joints(self) -> int:
        """n, the number of actuated joints; 0 without a hand."""
        return 0 if self.hand is None else self.hand.n

    @property
    def components(self) -> int:
        """k, the number of stacked contact force components; 0 without an object."""
        return 0 if self.contacts is None else self.contacts.size

    @property
    def ball_centres(self) -> Array:
        """(N, 3) where the middles of the fingers' round tips stand in O, p_OC − r n, m."""
        assert self.contacts is not None  # asked only where fingers hold an object
        assert self.hand is not None
        radius = np.array([self.hand.finger(name).tip_radius or 0.0 for name in self.fingers])  # m
        return np.asarray(self.contacts.p_OC - radius[:, None] * self.contacts.R_OC[:, :, 2])

    def resting(self, R_HO: Array, p_HO: Array, q: Array) -> ForceProblem:
        """The force problem of holding the object still in a pose."""
        assert self.contacts is not None  # asked only where there is an object
        assert self.body is not None
        w = self.body.wrench(BodyMotion(p_HO, R_HO), self.gravity_H)
        actuation = None
        if self.hand is not None:
            actuation = self.hand.actuation(q, self.fingers, self.contacts, p_HO, R_HO, gravity_H=self.gravity_H)
        return ForceProblem(self.contacts, w, actuation)
