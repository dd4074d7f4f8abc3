"""What a move is about, whichever way it goes: the hand, the object, the contacts between them, gravity and what to keep back.

Three kinds of task are planned by the same equations: a hand that moves an object between its fingertips; fingers that move
alone; and an object between ideal fingers, of which only the contacts' limits are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem
from graspforce.grasp.body import Body
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand

_SURFACE_TOLERANCE = 1e-4  # m: contacts of tips that roll are this near to the object's surface


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """What a move is about.

    Args:
        hand: the hand; None for ideal fingers, of which only the contacts' limits count.
        body: the object; None where fingers move alone.
        contacts: the contacts, in O, where the move begins; none where fingers move alone.
        fingers: the finger at each contact, by name, each once; empty without a hand or an object.
        gravity_H: (3,) the acceleration of gravity in H, m/s².
        slip_margin: the friction to keep back at every contact: load ≤ μ f_n − slip_margin, N.
        rolling: whether round tips roll on the object's surface, as they do, or stay with their middles where they begin on it.
            An object without a shape is flat about each contact. Tips without a radius stay in any case.

    Raises:
        InvalidInput: things that do not belong together; a tip that rolls but does not begin on the surface.
    """

    hand: Hand | None = None
    body: Body | None = None
    contacts: ContactSet | None = None
    fingers: tuple[str, ...] = ()
    gravity_H: Array = GRAVITY_PALM_UP  # type: ignore[assignment]  # __post_init__ makes the array
    slip_margin: float = 0.0
    rolling: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "gravity_H", arrays.check_array(self.gravity_H, "gravity_H", (3,)))
        object.__setattr__(self, "slip_margin", arrays.check_number(self.slip_margin, "slip_margin", minimum=0.0))
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
        if not isinstance(self.rolling, bool):
            raise InvalidInput("rolling", self.rolling, "true or false")
        self._check_tips_on_surface()

    @classmethod
    def with_contacts(
        cls, hand: Hand | None, body: Body, contacts: Sequence[Contact], fingers: Sequence[str] = (), **rest: Any
    ) -> Task:
        """A hand, or ideal fingers, with an object between them. Arguments as above."""
        return cls(hand, body, ContactSet.stack(contacts), tuple(fingers), **rest)

    @property
    def joints(self) -> int:
        """n, the number of actuated joints; 0 without a hand."""
        return 0 if self.hand is None else self.hand.n

    @property
    def force_size(self) -> int:
        """k, the number of stacked contact force components; 0 without an object."""
        return 0 if self.contacts is None else self.contacts.size

    @property
    def tip_radii(self) -> Array:
        """(N,) of the fingers' round tips, m; zero for a tip that touches with its origin, and for ideal fingers."""
        if self.hand is None:
            return np.zeros(0 if self.contacts is None else len(self.contacts))
        return np.array([self.hand.finger(name).tip_radius or 0.0 for name in self.fingers])

    @property
    def is_rolling(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(N,) which contacts roll."""
        return np.asarray((self.tip_radii > 0.0) & self.rolling)

    @property
    def constrained(self) -> tuple[np.ndarray[Any, np.dtype[np.bool_]], np.ndarray[Any, np.dtype[np.intp]]]:
        """What contacts keep from moving: (3 N,) whether along t₁, t₂ and n of each, and those whose fingers may not spin."""
        assert self.contacts is not None  # asked only where fingers hold an object
        rough = (self.contacts.mu > 0.0) | ~self.is_rolling
        rows = np.stack([rough, rough, np.ones(len(rough), dtype=bool)], axis=1).ravel()
        return rows, np.flatnonzero((self.contacts.gamma > 0.0) & self.is_rolling)

    @property
    def tip_centres(self) -> Array:
        """(N, 3) where the middles of the fingers' round tips stand in O where the move begins, p_OC − r n, m."""
        assert self.contacts is not None  # asked only where fingers hold an object
        return np.asarray(self.contacts.p_OC - self.tip_radii[:, None] * self.contacts.R_OC[:, :, 2])

    def contacts_at(self, p_OC: Array, R_OC: Array) -> ContactSet:
        """The contacts elsewhere on the object: at p_OC (N, 3), m, with frames R_OC (N, 3, 3)."""
        assert self.contacts is not None  # asked only where there is an object
        return replace(self.contacts, p_OC=arrays.freeze(p_OC), R_OC=arrays.freeze(R_OC))

    def static_problem(self, R_HO: Array, p_HO: Array, q: Array, contacts: ContactSet | None = None) -> ForceProblem:
        """The force problem of holding the object still in a pose, with the contacts where they are then."""
        contacts = self.contacts if contacts is None else contacts
        assert contacts is not None  # asked only where there is an object
        assert self.body is not None
        w = self.body.wrench(BodyMotion(p_HO, R_HO), self.gravity_H)
        actuation = None
        if self.hand is not None:
            actuation = self.hand.actuation(q, self.fingers, contacts, p_HO, R_HO, gravity_H=self.gravity_H)
        return ForceProblem(contacts, w, actuation)

    def _check_tips_on_surface(self) -> None:
        """Where tips roll, they must begin on the surface, which lies across their normals."""
        if self.body is None or self.body.shape is None or not self.is_rolling.any():
            return
        assert self.contacts is not None  # a body's
        off = np.linalg.norm(self.body.shape.closest_points(self.tip_centres) - self.contacts.p_OC, axis=1)  # m
        for i in np.flatnonzero(self.is_rolling & (off > _SURFACE_TOLERANCE)):
            allowed = f"on the surface of the object with its normal, where a tip rolls: it is {1e3 * off[i]:.2g} mm off"
            raise InvalidInput(f"contacts[{i}].position", self.contacts.p_OC[i], allowed)
