"""A hold: which fingers of a hand touch an object where, and the posture and pose in which they do."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core import arrays, fields, json_text
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand

SCHEMA = "graspforce/grasp/1"  # of the file that `Grasp.save` writes


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

    @classmethod
    def from_dict(cls, record: object, hand: Hand, field: str = "grasp") -> Grasp:
        """Return the grasp of a record.

        Args:
            record: mapping with `body`, `contacts` (each with its `finger`), `posture` (rad) and `object` (the pose in H).
            hand: the hand, which the record does not contain.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
            UnknownName: the hand has no finger of that name.
        """
        values = fields.check_record(record, field, required=["body", "contacts", "posture", "object"])
        body = Body.from_dict(values["body"], f"{field}.body")
        contacts, fingers = contacts_from_dicts(values["contacts"], f"{field}.contacts")
        check_contact_fingers(hand, fingers, f"{field}.contacts")
        q = arrays.check_array(values["posture"], f"{field}.posture", (hand.n,))
        p_HO, R_HO, _ = pose_from_dict(values["object"], f"{field}.object")
        try:
            return cls(hand, body, fingers, ContactSet.stack(contacts), q, p_HO, R_HO)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> dict[str, Any]:
        """Return the record of the grasp, without its hand.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        return {
            "body": self.body.to_dict(),
            "contacts": contacts_to_dicts(self.contacts.contacts, self.fingers),
            "posture": self.q.tolist(),
            "object": pose_to_dict(self.p_HO, self.R_HO),
        }

    @classmethod
    def load(cls, path: str | os.PathLike[str], hand: Hand | None = None) -> Grasp:
        """Return the grasp of a file that `save` wrote.

        Args:
            path: the file.
            hand: the hand; by default it is loaded by the name in the file.

        Raises:
            InvalidInput: not such a file, a field is out of range, or the grasp is of another hand.
            UnknownName: the hand in the file does not ship with graspforce, and `hand` is not given.
            OSError: the file cannot be read.
        """
        record = fields.check_record(json_text.decode(Path(path).read_bytes()), "", required=["schema", "hand", "grasp"])
        fields.check_choice(record["schema"], "schema", [SCHEMA])
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
        record = {"schema": SCHEMA, "hand": self.hand.name, "grasp": self.to_dict()}
        Path(path).write_text(json.dumps(record) + "\n", encoding="utf-8")

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


def contacts_from_dicts(records: object, field: str) -> tuple[tuple[Contact, ...], tuple[str, ...]]:
    """Return the contacts in O, and the name of the finger at each, of a list of records.

    Args:
        records: list of mappings, each the record of a `Contact` with its `finger`.
        field: path of the list, for errors.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    contacts, fingers = [], []
    for i, item in enumerate(fields.check_sequence(records, field, at_least=1)):
        contact_fields = item if isinstance(item, Mapping) else ()  # Contact.from_dict checks them
        record = fields.check_record(item, f"{field}[{i}]", required=["finger"], optional=contact_fields)
        fingers.append(fields.check_text(record.pop("finger"), f"{field}[{i}].finger"))
        contacts.append(Contact.from_dict(record, f"{field}[{i}]"))
    return tuple(contacts), tuple(fingers)


def contacts_to_dicts(contacts: Collection[Contact], fingers: Collection[str]) -> list[dict[str, Any]]:
    """Return the records of contacts with the fingers that make them.

    Args:
        contacts: the contacts in O.
        fingers: name of the finger at each contact.
    """
    return [{**contact.to_dict(), "finger": finger} for contact, finger in zip(contacts, fingers, strict=True)]


def check_contact_fingers(hand: Hand, fingers: Collection[str], field: str) -> None:
    """Check that a hand has the fingers of a list of contact records.

    Args:
        hand: the hand.
        fingers: name of the finger at each contact.
        field: path of the list of contacts, for errors.

    Raises:
        UnknownName: the hand has no finger of that name; names the contact and lists the hand's fingers.
    """
    names = [finger.name for finger in hand.fingers]
    for i, name in enumerate(fingers):
        if name not in names:
            raise UnknownName(f"{field}[{i}].finger", name, names)
