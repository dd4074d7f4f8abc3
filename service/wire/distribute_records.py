"""The request to compute the contact forces and motor torques of a hand at rest or in motion."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from graspforce.contact.contact import Contact
from graspforce.core import arrays, fields, records
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.force.problem_options import Cone, Objective
from graspforce.force.uncertainty import Uncertainty
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.hand_contacts import contacts_from_dicts, contacts_to_dicts


@dataclass(frozen=True, eq=False)
class DistributeRequest:
    """A hand's posture, an object, its contacts and its load. Frames: H hand base, O object.

    Args:
        q: (n,) posture, actuated joint positions, rad.
        contacts: the contacts, in O.
        fingers: name of the finger of each contact.
        p_HO: (3,) position of O's origin in H, m.
        R_HO: (3, 3) rotation matrix of O in H.
        w: (6,) wrench that the contacts must supply, about O's origin, in O, N and N·m.
        gravity: (3,) gravity in H, m/s²; None for (0, 0, -9.81), palm up.
        v: (n,) joint rates, rad/s; None for zero.
        a: (n,) joint accelerations, rad/s²; None for zero.
        cone: friction cones, exact by default.
        objective: cost, ``"torque"`` by default.
        uncertainty: errors that the forces must survive; None for exact data.

    Raises:
        InvalidInput: a value has the wrong type, shape or range; names the field of the record.
    """

    q: Array
    contacts: tuple[Contact, ...]
    fingers: tuple[str, ...]
    p_HO: Array
    R_HO: Array
    w: Array
    gravity: Array | None = None
    v: Array | None = None
    a: Array | None = None
    cone: Cone = dataclasses.field(default_factory=Cone)
    objective: Objective = dataclasses.field(default_factory=lambda: Objective("torque"))
    uncertainty: Uncertainty | None = None

    def __post_init__(self) -> None:
        contacts = tuple(fields.check_sequence(self.contacts, "contacts", at_least=1))
        fingers = tuple(fields.check_text(name, f"contacts[{i}].finger") for i, name in enumerate(self.fingers))
        if len(fingers) != len(contacts):
            raise InvalidInput("contacts", f"{len(fingers)} fingers", f"one finger for each of {len(contacts)} contacts")
        checked: JsonRecord = {
            "q": arrays.check_array(self.q, "posture", (None,)),
            "contacts": contacts,
            "fingers": fingers,
            "p_HO": arrays.check_array(self.p_HO, "object.position", (3,)),
            "R_HO": arrays.check_rotation(self.R_HO, "object.rotation"),
            "w": arrays.check_array(self.w, "wrench", (6,)),
        }
        for name, field, length in (("gravity", "gravity", 3), ("v", "velocity", None), ("a", "acceleration", None)):
            if getattr(self, name) is not None:
                checked[name] = arrays.check_array(getattr(self, name), field, (length,))
        records.set_fields(self, **checked)

    @classmethod
    def from_dict(cls, record: object) -> DistributeRequest:
        """Read the request from its record.

        Args:
            record: as `to_dict` returns it.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = ["gravity", "velocity", "acceleration", "cone", "objective", "uncertainty"]
        values = fields.check_record(record, "", required=["posture", "object", "contacts", "wrench"], optional=optional)
        p_HO, R_HO, _ = pose_from_dict(values["object"], "object")
        contacts, fingers = contacts_from_dicts(values["contacts"], "contacts")
        return cls(
            q=values["posture"],
            contacts=contacts,
            fingers=fingers,
            p_HO=p_HO,
            R_HO=R_HO,
            w=values["wrench"],
            gravity=values.get("gravity"),
            v=values.get("velocity"),
            a=values.get("acceleration"),
            cone=Cone() if values.get("cone") is None else Cone.from_dict(values["cone"]),
            objective=Objective("torque") if values.get("objective") is None else Objective.from_dict(values["objective"]),
            uncertainty=None if values.get("uncertainty") is None else Uncertainty.from_dict(values["uncertainty"]),
        )

    def to_dict(self) -> JsonRecord:
        """Return the plain record: `posture`, `object`, `contacts` with their `finger`, `wrench`, and non-default values."""
        record: JsonRecord = {
            "posture": self.q.tolist(),
            "object": pose_to_dict(self.p_HO, self.R_HO),
            "contacts": contacts_to_dicts(self.contacts, self.fingers),
            "wrench": self.w.tolist(),
            "cone": self.cone.to_dict(),
            "objective": self.objective.to_dict(),
        }
        if self.uncertainty is not None:
            record["uncertainty"] = self.uncertainty.to_dict()
        for name, value in (("gravity", self.gravity), ("velocity", self.v), ("acceleration", self.a)):
            if value is not None:
                record[name] = value.tolist()
        return record
