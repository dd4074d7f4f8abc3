"""The request for a hand's force distribution."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from graspforce.contact.contact import Contact
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import Cone, Objective
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.grasp import contacts_from_dicts, contacts_to_dicts


@dataclass(frozen=True, eq=False)
class DistributeRequest:
    """What a hand must be told to say which forces and torques hold the object. Frames: H hand base, O object.

    Args:
        q: (n,) posture, actuated joint positions, rad.
        contacts: the contacts, in O.
        fingers: the finger that makes each contact, by name.
        p_HO: (3,) the object's origin in H, m.
        R_HO: (3, 3) its axes in H, columns.
        w: (6,) the wrench that the contacts must supply, about O's origin, in O, N and N·m.
        gravity: (3,) the acceleration of gravity in H, m/s²; None for (0, 0, -9.81), the palm looking up.
        v: (n,) joint rates, rad/s; None at rest.
        a: (n,) joint accelerations, rad/s²; None at rest.
        cone: exact by default.
        objective: "torque" by default.

    Raises:
        InvalidInput: names the field as the wire spells it.
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

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("q", arrays.check_array(self.q, "posture", (None,)))
        put("contacts", tuple(fields.check_sequence(self.contacts, "contacts", at_least=1)))
        put("fingers", tuple(fields.check_text(name, f"contacts[{i}].finger") for i, name in enumerate(self.fingers)))
        if len(self.fingers) != len(self.contacts):
            raise InvalidInput(
                "contacts", f"{len(self.fingers)} fingers", f"one finger for each of {len(self.contacts)} contacts"
            )
        put("p_HO", arrays.check_array(self.p_HO, "object.position", (3,)))
        put("R_HO", arrays.check_rotation(self.R_HO, "object.rotation"))
        put("w", arrays.check_array(self.w, "wrench", (6,)))
        for name, field, length in (("gravity", "gravity", 3), ("v", "velocity", None), ("a", "acceleration", None)):
            if getattr(self, name) is not None:
                put(name, arrays.check_array(getattr(self, name), field, (length,)))

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> DistributeRequest:
        """From the request as it is on the wire.

        Raises:
            InvalidInput: a field that is missing, unknown, or holds what it may not; named with its path.
        """
        optional = ["gravity", "velocity", "acceleration", "cone", "objective"]
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
        )

    def to_dict(self) -> dict[str, Any]:
        """The request as it is on the wire."""
        record: dict[str, Any] = {
            "posture": self.q.tolist(),
            "object": pose_to_dict(self.p_HO, self.R_HO),
            "contacts": contacts_to_dicts(self.contacts, self.fingers),
            "wrench": self.w.tolist(),
            "cone": self.cone.to_dict(),
            "objective": self.objective.to_dict(),
        }
        for name, value in (("gravity", self.gravity), ("velocity", self.v), ("acceleration", self.a)):
            if value is not None:
                record[name] = value.tolist()
        return record
