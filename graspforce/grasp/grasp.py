"""A grasp: a hand and an object in contact at one instant."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.contact.closure import is_force_closed
from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.core.text_table import Table
from graspforce.geometry import ImplicitSurface
from graspforce.grasp.body import Body
from graspforce.grasp.hand_contacts import HandContacts
from graspforce.hand.contact_tips import check_fingertips
from graspforce.hand.hand import Hand

if TYPE_CHECKING:
    from graspforce.grasp.posture_repair import PostureOptions


@dataclass(frozen=True, eq=False, slots=True)
class Grasp(HandContacts):
    """A hand that holds an object at one instant: the start of control, planning and simulation.

    Args:
        hand: the hand.
        body: the object, with its frame O.
        fingers: name of the finger at each contact, each once.
        contacts: the contacts in O, in the order of `fingers`.
        q: (n,) joint positions, rad.
        p_HO: (3,) position of the object in H, m.
        R_HO: (3, 3) axes of the object in H.

    Raises:
        InvalidInput: names the field and what is allowed.
        UnknownName: the hand has no finger of that name.
    """

    schema = "graspforce/grasp/1"
    contact_key = "finger"

    hand: Hand
    body: Body
    fingers: tuple[str, ...]
    contacts: ContactSet
    q: Array
    p_HO: Array
    R_HO: Array

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            hand: Hand,
            body: Body,
            fingers: Sequence[str],
            contacts: ContactSet,
            q: npt.ArrayLike,
            p_HO: npt.ArrayLike,
            R_HO: npt.ArrayLike,
        ) -> None: ...

    def __post_init__(self) -> None:
        set_fields(self, fingers=tuple(self.hand.finger(name).name for name in self.fingers))
        if len(set(self.fingers)) != len(self.contacts) or len(self.fingers) != len(self.contacts):
            allowed = f"{len(self.contacts)} different fingers, one for each contact"
            raise InvalidInput("fingers", self.fingers, allowed)
        set_fields(
            self,
            q=arrays.check_array(self.q, "q", (self.hand.n,)),
            p_HO=arrays.check_array(self.p_HO, "p_HO", (3,)),
            R_HO=arrays.check_rotation(self.R_HO, "R_HO"),
        )

    @property
    def links(self) -> tuple[str, ...]:
        """At each contact the finger whose tip touches: `fingers`."""
        return self.fingers

    @classmethod
    def check_names(cls, hand: Hand, names: Collection[str], field: str) -> None:
        """Check that a hand has the fingers of a list of contact records; see `check_contact_fingers`.

        Args:
            hand: the hand.
            names: name of the finger at each contact.
            field: path of the list of contacts, for error messages.
        """
        check_contact_fingers(hand, names, field)

    def __repr__(self) -> str:
        return f"<Grasp: {self.hand.name}, {', '.join(self.fingers)}, {self.body.mass:.4g} kg>"

    def __str__(self) -> str:
        return str(self._table())

    def _repr_html_(self) -> str:
        return self._table().to_html()

    @classmethod
    def from_posture(
        cls,
        hand: Hand,
        body: Body,
        q: npt.ArrayLike,
        p_HO: npt.ArrayLike,
        R_HO: npt.ArrayLike,
        fingers: Sequence[str] | None = None,
        *,
        options: PostureOptions | None = None,
    ) -> Grasp:
        """Return the grasp of a posture from elsewhere: find its contacts, close its gaps, and check it.

        Fingertips near the surface are moved onto it by the least joint motion; see `posture_repair`. The grasp then has exact
        contacts, no overlaps, and force closure. Whether motors bear the object's weight is a question for `force_problem`.

        Args:
            hand: the hand.
            body: the object, with a shape.
            q: (n,) joint positions, rad.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
            fingers: names of the fingers that touch; by default all whose tip is at most `options.repair` off the surface.
            options: what the posture may lack, friction, and the largest normal forces.

        Raises:
            InvalidInput: the posture does not hold the object, for example because a finger is 12 mm from it; the text names
                every fault. Or a field is out of range.
            UnknownName: the hand has no finger of that name.
        """
        from graspforce.grasp.posture_repair import PostureOptions, repair_posture  # loads the collision geometry

        options = PostureOptions() if options is None else options
        if body.shape is None or isinstance(body.shape, ImplicitSurface):
            given = None if body.shape is None else type(body.shape).__name__
            raise InvalidInput("body.shape", given, "a sphere, cylinder, box, superquadric or mesh")
        posture = arrays.check_array(q, "q", (hand.n,))
        place, axes = arrays.check_array(p_HO, "p_HO", (3,)), arrays.check_rotation(R_HO, "R_HO")
        found = repair_posture(hand, body.shape, posture, place, axes, fingers, options)
        contacts = ContactSet.stack(
            [
                pad_contact(hand, name, Contact(p, n, options.friction, max_normal=options.max_normal))
                for name, p, n in zip(found.fingers, found.p_OC, found.normals, strict=True)
            ]
        )
        if not is_force_closed(contacts):
            faults = [f"the contacts of {', '.join(found.fingers)} are not force-closed", *found.apart]
            raise InvalidInput("q", posture, "a posture that holds the object: " + "; ".join(faults))
        return cls(hand, body, found.fingers, contacts, found.q, place, axes)

    def to_dict(self) -> JsonRecord:
        """Return the record of the grasp, without its hand.

        Raises:
            InvalidInput: a contact is not at a fingertip: save the `LinkGrasp` instead. Or the body's shape is an implicit
                surface, whose function cannot be saved or sent.
        """
        check_fingertips(self.hand, self.fingers, "files and streams of a Grasp")
        return HandContacts.to_dict(self)

    def with_pads(self) -> Grasp:
        """Return the grasp with the contact models of the fingers' pads.

        A contact with friction of a finger with a soft pad becomes a soft contact with the pad's torsional friction; one of a
        finger without becomes a point contact. Frictionless contacts stay.
        """
        contacts = [
            contact if contact.model is ContactModel.FRICTIONLESS else pad_contact(self.hand, name, contact)
            for name, contact in zip(self.fingers, self.contacts.contacts, strict=True)
        ]
        return replace(self, contacts=ContactSet.stack(contacts))

    def contact_errors(self) -> Array:
        """Return the distance between each fingertip's contact point and its contact.

        A tip of radius r has its contact point at p_HF + r n, n the inward normal; a tip without radius at its origin p_HF.

        Returns:
            (N,), m; zero if the posture matches the contacts.
        """
        distances = []
        for i, name in enumerate(self.fingers):
            n_H = self.R_HO @ self.contacts.R_OC[i, :, 2]
            point = self.hand.tip_pose(self.q, name)[0] + (self.hand.finger(name).tip_radius or 0.0) * n_H
            distances.append(np.linalg.norm(point - self.p_HO - self.R_HO @ self.contacts.p_OC[i]))
        return freeze(distances)

    def _table(self) -> Table:
        shape = "body" if self.body.shape is None else type(self.body.shape).__name__.lower()
        place = ", ".join(f"{1e3 * x:.1f}" for x in self.p_HO)
        title = f"{self.hand.name} holds a {shape} of {self.body.mass:.4g} kg at ({place}) mm in H"
        rows = [
            (
                finger,
                contact.model.value,
                *(f"{1e3 * x:.2f}" for x in contact.position),
                *(f"{x:.3f}" for x in contact.normal),
                "" if contact.friction is None else f"{contact.friction:g}",
            )
            for finger, contact in zip(self.fingers, self.contacts.contacts, strict=True)
        ]
        return Table(("finger", "contact", "x mm", "y mm", "z mm", "n x", "n y", "n z", "μ"), tuple(rows), title)


def pad_contact(hand: Hand, finger: str, contact: Contact) -> Contact:
    """Return a contact with the model of a finger's pad: soft with torsional friction, otherwise a point contact.

    Args:
        hand: the hand.
        finger: name of the finger at the contact.
        contact: the contact, with friction.

    Raises:
        UnknownName: the hand has no finger of that name.
    """
    gamma = hand.finger(finger).torsional_friction
    model = ContactModel.POINT if gamma is None else ContactModel.SOFT
    return replace(contact, model=model, torsional_friction=gamma)


def check_contact_fingers(hand: Hand, fingers: Collection[str], field: str) -> None:
    """Check that a hand has the fingers of a list of contact records.

    Args:
        hand: the hand.
        fingers: name of the finger at each contact.
        field: path of the list of contacts, for error messages.

    Raises:
        UnknownName: the hand has no finger of that name; names the contact and lists the hand's fingers.
    """
    names = [finger.name for finger in hand.fingers]
    for i, name in enumerate(fingers):
        if name not in names:
            raise UnknownName(f"{field}[{i}].finger", name, names)


def check_grasp(value: object, field: str = "grasp") -> Grasp:
    """Return a grasp for control, simulation or streams.

    Args:
        value: the value to check.
        field: its name, for error messages.

    Raises:
        InvalidInput: another type, such as a `LinkGrasp`.
    """
    if not isinstance(value, Grasp):
        raise InvalidInput(field, type(value).__name__, "a Grasp; LinkGrasp.as_grasp returns one for control and simulation")
    return value
