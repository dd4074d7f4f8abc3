"""A hold: which fingers of a hand touch an object where, and the posture and pose in which they do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand


@dataclass(frozen=True, eq=False, slots=True)
class Grasp:
    """A hand that holds an object at one instant: where control, planning and simulation begin.

    Args:
        hand: the hand.
        body: the object, its frame O.
        fingers: the finger at each contact, by name, each once.
        contacts: the contacts in O, in the fingers' order.
        q: (n,) the hand's posture, rad.
        p_HO: (3,) the object's origin in H, m.
        R_HO: (3, 3) its axes in H.

    Raises:
        InvalidInput: names the field and what is allowed.
        UnknownName: a finger that the hand does not have.
    """

    hand: Hand
    body: Body
    fingers: tuple[str, ...]
    contacts: ContactSet
    q: Array
    p_HO: Array
    R_HO: Array

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("fingers", tuple(self.hand.finger(name).name for name in self.fingers))
        if len(set(self.fingers)) != len(self.contacts) or len(self.fingers) != len(self.contacts):
            allowed = f"{len(self.contacts)} different fingers, one for each contact"
            raise InvalidInput("fingers", self.fingers, allowed)
        put("q", arrays.check_array(self.q, "q", (self.hand.n,)))
        put("p_HO", arrays.check_array(self.p_HO, "p_HO", (3,)))
        put("R_HO", arrays.check_rotation(self.R_HO, "R_HO"))

    def contact_errors(self) -> Array:
        """(N,) how far each fingertip's touching point is from its contact, m: zero where the finger touches as said.

        A ball of radius r about the tip touches at its foot p_HF + r n; a tip without a radius touches with its origin.
        """
        distances = []
        for i, name in enumerate(self.fingers):
            n_H = self.R_HO @ self.contacts.R_OC[i, :, 2]
            foot = self.hand.tip_pose(self.q, name)[0] + (self.hand.finger(name).tip_radius or 0.0) * n_H
            distances.append(np.linalg.norm(foot - self.p_HO - self.R_HO @ self.contacts.p_OC[i]))
        return freeze(distances)
