"""Contacts between a hand and an object: the force problem of holding the object at rest."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays, fields, json_text
from graspforce.core.arrays import Array
from graspforce.core.constants import LARGEST_DISTANCE, LARGEST_MOTION
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.whole_file import write_text
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Cone, Objective
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.body import Body
from graspforce.hand.actuation import Actuation
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand

ContactKey = Literal["finger", "link"]  # of the name in the record of a contact

G = TypeVar("G", bound="HandContacts")


class HandContacts:
    """Base of grasps: a hand and an object in contact at one instant, with the same forces wherever the contacts are.

    Attributes:
        schema: name of the format of the files.
        contact_key: key of the finger's or link's name in the record of a contact.
    """

    __slots__ = ()

    schema: ClassVar[str]
    contact_key: ClassVar[ContactKey]

    if TYPE_CHECKING:  # the grasps have these as fields, except the links of fingertips

        def __init__(self, *parts: Any) -> None: ...

        @property
        def hand(self) -> Hand:
            """The hand."""

        @property
        def body(self) -> Body:
            """The object, with its frame O."""

        @property
        def links(self) -> tuple[str, ...]:
            """At each contact the link that touches, or the finger whose tip touches."""

        @property
        def contacts(self) -> ContactSet:
            """The contacts in O, in the order of `links`."""

        @property
        def q(self) -> Array:
            """(n,) joint positions, rad."""

        @property
        def p_HO(self) -> Array:
            """(3,) position of the object in H, m."""

        @property
        def R_HO(self) -> Array:
            """(3, 3) axes of the object in H."""

    def actuation(self, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP) -> Actuation:
        """Return the hand's actuation at rest in this grasp; see `Hand.actuation`.

        Args:
            gravity_H: (3,) acceleration of gravity in H, m/s².
        """
        return self.hand.actuation(self.q, self.links, self.contacts, self.p_HO, self.R_HO, gravity_H=gravity_H)

    def force_problem(
        self,
        gravity_H: npt.ArrayLike = GRAVITY_PALM_UP,
        *,
        cone: Cone | None = None,
        objective: Objective | None = None,
    ) -> ForceProblem:
        """Return the force problem of holding the object at rest.

        Args:
            gravity_H: (3,) acceleration of gravity in H, m/s².
            cone: friction cone; exact by default.
            objective: objective; least motor torque by default.
        """
        w = self.body.wrench(BodyMotion(self.p_HO, self.R_HO), gravity_H)
        return ForceProblem(self.contacts, w, self.actuation(gravity_H), cone, objective)

    @classmethod
    def check_names(cls, hand: Hand, names: Collection[str], field: str) -> None:
        """Check that a hand has the fingers or links of a list of contact records.

        Args:
            hand: the hand.
            names: name at each contact.
            field: path of the list of contacts, for error messages.

        Raises:
            UnknownName: the hand has no finger or link of that name.
        """
        check_contact_links(hand, names, field, f".{cls.contact_key}")

    @classmethod
    def from_dict(cls: type[G], record: object, hand: Hand, field: str = "grasp") -> G:
        """Return the grasp of a record.

        Args:
            record: mapping with `body`, `contacts`, `posture` (rad) and `object` (the pose in H). Each contact has its
                `finger`, or its `link` in a `LinkGrasp`.
            hand: the hand, which the record does not contain.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
            UnknownName: the hand has no finger or link of that name.
        """
        values = fields.check_record(record, field, required=["body", "contacts", "posture", "object"])
        body = Body.from_dict(values["body"], f"{field}.body")
        contacts, names = contacts_from_dicts(values["contacts"], f"{field}.contacts", cls.contact_key)
        cls.check_names(hand, names, f"{field}.contacts")
        q = arrays.check_array(values["posture"], f"{field}.posture", (hand.n,), limit=LARGEST_MOTION)
        p_HO, R_HO, _ = pose_from_dict(values["object"], f"{field}.object")
        try:
            return cls(hand, body, names, ContactSet.stack(contacts), q, p_HO, R_HO)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the record of the grasp, without its hand.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        return {
            "body": self.body.to_dict(),
            "contacts": contacts_to_dicts(self.contacts.contacts, self.links, self.contact_key),
            "posture": self.q.tolist(),
            "object": pose_to_dict(self.p_HO, self.R_HO),
        }

    @classmethod
    def load(cls: type[G], path: str | os.PathLike[str], hand: Hand | None = None) -> G:
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
        fields.check_choice(record["schema"], "schema", [cls.schema])
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
        record = {"schema": self.schema, "hand": self.hand.name, "grasp": self.to_dict()}
        write_text(path, json.dumps(record) + "\n")


def contacts_from_dicts(records: object, field: str, key: ContactKey = "finger") -> tuple[tuple[Contact, ...], tuple[str, ...]]:
    """Return the contacts in O, and the name of the finger or link at each, of a list of records.

    Args:
        records: list of mappings, each the record of a `Contact` with its `finger` or `link`; positions are at most 1e3 m.
        field: path of the list, for error messages.
        key: the key of the name.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    contacts, names = [], []
    for i, item in enumerate(fields.check_sequence(records, field, at_least=1)):
        contact_fields = item if isinstance(item, Mapping) else ()  # Contact.from_dict checks them
        record = fields.check_record(item, f"{field}[{i}]", required=[key], optional=contact_fields)
        names.append(fields.check_text(record.pop(key), f"{field}[{i}].{key}"))
        contacts.append(Contact.from_dict(record, f"{field}[{i}]"))
        arrays.check_array(contacts[-1].position, f"{field}[{i}].position", (3,), limit=LARGEST_DISTANCE)
    return tuple(contacts), tuple(names)


def contacts_to_dicts(contacts: Collection[Contact], names: Collection[str], key: ContactKey = "finger") -> list[JsonRecord]:
    """Return the records of contacts with the fingers or links that make them.

    Args:
        contacts: the contacts in O.
        names: name of the finger or link at each contact.
        key: the key of the name.
    """
    return [{**contact.to_dict(), key: name} for contact, name in zip(contacts, names, strict=True)]


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
