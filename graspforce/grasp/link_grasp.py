"""An enveloping grasp: contacts on any links of a hand, several on one finger, and on the palm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.hand_contacts import HandContacts, check_contact_links
from graspforce.hand.collision import hand_collision
from graspforce.hand.contact_tips import ContactTip, add_contact_tips
from graspforce.hand.hand import Hand

_RADIUS = 0.005  # m, of the surface of links without collision shapes


@dataclass(frozen=True, eq=False, slots=True)
class LinkGrasp(HandContacts):
    """A hand that holds an object with contacts on any of its links, at one instant.

    A contact on a link loads only the motors before that link, and one on the palm none. So the motors do not determine all
    internal forces: a force problem chooses forces of least torque among those that the structure can bear.

    Its forces have certificates. For control and simulation, `as_grasp` returns a `Grasp`; plans and streams need contacts of
    fingertips.

    Args:
        hand: the hand.
        body: the object, with its frame O.
        links: at each contact the URDF link that touches; the name of a finger stands for its tip.
        contacts: the contacts in O, in the order of `links`.
        q: (n,) joint positions, rad.
        p_HO: (3,) position of the object in H, m.
        R_HO: (3, 3) axes of the object in H.

    Raises:
        InvalidInput: names the field and what is allowed.
        UnknownName: the hand has no link or finger of that name.
    """

    schema = "graspforce/link_grasp/1"
    contact_key = "link"

    hand: Hand
    body: Body
    links: tuple[str, ...]
    contacts: ContactSet
    q: Array
    p_HO: Array
    R_HO: Array

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            hand: Hand,
            body: Body,
            links: Sequence[str],
            contacts: ContactSet,
            q: npt.ArrayLike,
            p_HO: npt.ArrayLike,
            R_HO: npt.ArrayLike,
        ) -> None: ...

    def __post_init__(self) -> None:
        set_fields(self, links=tuple(self.links))
        check_contact_links(self.hand, self.links, "links")
        if len(self.links) != len(self.contacts):
            raise InvalidInput("links", self.links, f"{len(self.contacts)} names of links, one for each contact")
        set_fields(
            self,
            q=arrays.check_array(self.q, "q", (self.hand.n,)),
            p_HO=arrays.check_array(self.p_HO, "p_HO", (3,)),
            R_HO=arrays.check_rotation(self.R_HO, "R_HO"),
        )

    def __repr__(self) -> str:
        return f"<LinkGrasp: {self.hand.name}, {', '.join(self.links)}, {self.body.mass:.4g} kg>"

    @classmethod
    def from_grasp(cls, grasp: Grasp, contacts: Sequence[Contact] = (), links: Sequence[str] = ()) -> LinkGrasp:
        """Return a fingertip grasp with further contacts.

        Args:
            grasp: the grasp.
            contacts: the further contacts, in O.
            links: the link at each of them.

        Raises:
            InvalidInput: the numbers of contacts and links differ.
            UnknownName: the hand has no link of that name.
        """
        every = ContactSet.stack([*grasp.contacts.contacts, *contacts])
        return cls(grasp.hand, grasp.body, (*grasp.fingers, *links), every, grasp.q, grasp.p_HO, grasp.R_HO)

    def as_grasp(self) -> Grasp:
        """Return the grasp for control and simulation: that of a hand with a finger for each contact.

        A sphere, half as thick as the link, stands for the link's surface at each contact. It rolls on the object like a
        fingertip. A finger's own tip stays, with its radius. Only the hand of the result has these fingers: save this grasp
        instead of the result.
        """
        hand, own = self.hand, {finger.name for finger in self.hand.fingers}
        bodies = hand_collision(hand).bodies
        names, tips = list[str | None](), list[ContactTip]()
        for i, name in enumerate(self.links):
            if name in own and name not in names:
                names.append(name)
                continue
            link = hand.finger(name).tip if name in own else name
            radius = min((float(body.half_extents.min()) for body in bodies if body.name == link), default=_RADIUS)
            p = self.contacts.p_OC[i] - radius * self.contacts.R_OC[i, :, 2]
            gamma = float(self.contacts.gamma[i]) or None
            tips.append(ContactTip(link, self.p_HO + self.R_HO @ p, radius, gamma))
            names.append(None)
        hand, added = add_contact_tips(hand, tips, self.q)
        rest = iter(added)
        fingers = [next(rest) if name is None else name for name in names]
        return Grasp(hand, self.body, fingers, self.contacts, self.q, self.p_HO, self.R_HO)
