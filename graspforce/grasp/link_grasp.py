"""An enveloping grasp: contacts on any links of a hand, several on one finger, and on the palm."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core import arrays, fields, json_text
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.core.whole_file import write_text
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.hand_contacts import HandContacts
from graspforce.hand.hand import Hand

LINK_SCHEMA = "graspforce/link_grasp/1"


@dataclass(frozen=True, eq=False, slots=True)
class LinkGrasp(HandContacts):
    """A hand that holds an object with contacts on any of its links, at one instant.

    A contact on a link loads only the motors before that link, and one on the palm none. So the motors do not determine all
    internal forces: a force problem chooses forces of least torque among those that the structure can bear.

    Its forces have certificates. Control, planning and simulation need a `Grasp`, with one contact at each fingertip.

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

    @classmethod
    def from_dict(cls, record: object, hand: Hand, field: str = "grasp") -> LinkGrasp:
        """Return the grasp of a record.

        Args:
            record: mapping with `body`, `contacts` (each with its `link`), `posture` (rad) and `object` (the pose in H).
            hand: the hand, which the record does not contain.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
            UnknownName: the hand has no link of that name.
        """
        values = fields.check_record(record, field, required=["body", "contacts", "posture", "object"])
        contacts, links = [], []
        for i, item in enumerate(fields.check_sequence(values["contacts"], f"{field}.contacts", at_least=1)):
            place = f"{field}.contacts[{i}]"
            names = list(item) if isinstance(item, dict) else []  # Contact.from_dict checks them
            entry = fields.check_record(item, place, required=["link"], optional=names)
            links.append(fields.check_text(entry.pop("link"), f"{place}.link"))
            contacts.append(Contact.from_dict(entry, place))
        p_HO, R_HO, _ = pose_from_dict(values["object"], f"{field}.object")
        body = Body.from_dict(values["body"], f"{field}.body")
        q = arrays.check_array(values["posture"], f"{field}.posture", (hand.n,))
        try:
            return cls(hand, body, links, ContactSet.stack(contacts), q, p_HO, R_HO)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    @classmethod
    def load(cls, path: str | os.PathLike[str], hand: Hand | None = None) -> LinkGrasp:
        """Return the grasp of a file that `save` wrote.

        Args:
            path: the file.
            hand: the hand; by default it is loaded by the name in the file.

        Raises:
            InvalidInput: not such a file, a field is out of range, or the grasp is of another hand.
            UnknownName: the hand in the file does not ship with graspforce, and `hand` is not given.
            OSError: the file cannot be read.
        """
        record = fields.check_record(json_text.read(path), "", required=["schema", "hand", "grasp"])
        fields.check_choice(record["schema"], "schema", [LINK_SCHEMA])
        name = fields.check_text(record["hand"], "hand")
        if hand is not None and hand.name != name:
            raise InvalidInput("hand", hand.name, f"{name}, the hand of the grasp in {path}")
        return cls.from_dict(record["grasp"], Hand.load(name) if hand is None else hand)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the grasp to a JSON file, with the name of its hand.

        Args:
            path: the file; an existing file is replaced.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved.
            OSError: the file cannot be written.
        """
        record = {"schema": LINK_SCHEMA, "hand": self.hand.name, "grasp": self.to_dict()}
        write_text(path, json.dumps(record) + "\n")

    def to_dict(self) -> JsonRecord:
        """Return the record of the grasp, without its hand.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        pairs = zip(self.contacts.contacts, self.links, strict=True)
        return {
            "body": self.body.to_dict(),
            "contacts": [{**contact.to_dict(), "link": link} for contact, link in pairs],
            "posture": self.q.tolist(),
            "object": pose_to_dict(self.p_HO, self.R_HO),
        }


def check_contact_links(hand: Hand, names: Collection[str], field: str, suffix: str = "") -> None:
    """Check that a hand has the links or fingers of a list of contacts.

    Args:
        hand: the hand.
        names: name of the link or finger at each contact.
        field: path of the list, for error messages.
        suffix: the rest of the path of a name, such as ".finger".

    Raises:
        UnknownName: the hand has no link or finger of that name.
    """
    for i, name in enumerate(names):
        hand.contact_frame_id(name, f"{field}[{i}]{suffix}")
