"""Tasks: hand, object and contacts of a move, gravity, and the slip margin to keep.

`GraspTask` is a hand that moves an object, `IdealTask` an object between ideal fingers, and `FingerTask` fingers alone.
Planners of objects take an `ObjectTask`, planners of fingers a `FingerTask`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.force.problem import ForceProblem
from graspforce.grasp.body import Body
from graspforce.grasp.collision.settings import DEFAULT_COLLISIONS, CollisionSettings, check_collision_settings
from graspforce.grasp.grasp import check_contact_fingers
from graspforce.grasp.hand_contacts import contacts_from_dicts, contacts_to_dicts
from graspforce.hand.contact_tips import check_fingertips
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.planning.acceleration_limits import UNLIMITED, AccelerationLimits, check_acceleration_limits
from graspforce.planning.hand_limits import hand_with_limits, limits_to_dict
from graspforce.planning.interpolation import Indices
from graspforce.planning.task_records import (
    FINGER_TASK_FIELDS,
    GRASP_TASK_FIELDS,
    IDEAL_TASK_FIELDS,
    OBJECT_FIELDS,
    acceleration_limits_of_record,
    acceleration_limits_to_record,
    collisions_of_record,
    collisions_to_record,
    given_fields,
    gravity_of_record,
)

_SURFACE_TOLERANCE = 1e-4  # m: largest distance of a rolling contact from the object's surface at the start

Mask = npt.NDArray[np.bool_]


def _gravity_palm_up() -> Array:
    return arrays.freeze(GRAVITY_PALM_UP)


@dataclass(frozen=True, eq=False, slots=True)
class GraspTask:
    """A hand that moves an object with its fingertips.

    Args:
        hand: the hand; its torque, speed and position limits bound the motion.
        body: the object.
        contacts: the N contacts at the start, in O.
        fingers: the finger at each contact, by name, each once.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        slip_margin: friction to keep in reserve at every contact: load ≤ μ f_n − slip_margin, N.
        rolling: True if round fingertips roll on the object; False if their centres stay fixed relative to it. The surface of
            an object without a shape is a plane at each contact. Tips without a radius never roll.
        collisions: obstacles, and the distance that links, object and obstacles keep; None for no collision checks.
        acceleration_limits: limits of the accelerations of object and joints.

    Raises:
        InvalidInput: a value out of range, the wrong number of fingers, or a rolling tip that does not start on the surface.
    """

    hand: Hand
    body: Body
    contacts: ContactSet
    fingers: tuple[str, ...]
    gravity_H: Array = field(default_factory=_gravity_palm_up)
    slip_margin: float = 0.0
    rolling: bool = True
    collisions: CollisionSettings | None = DEFAULT_COLLISIONS
    acceleration_limits: AccelerationLimits = UNLIMITED

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            hand: Hand,
            body: Body,
            contacts: ContactSet,
            fingers: Sequence[str],
            gravity_H: npt.ArrayLike = ...,
            slip_margin: float = 0.0,
            rolling: bool = True,
            collisions: CollisionSettings | None = DEFAULT_COLLISIONS,
            acceleration_limits: AccelerationLimits = UNLIMITED,
        ) -> None: ...

    def __post_init__(self) -> None:
        gravity_H = arrays.check_array(self.gravity_H, "gravity_H", (3,))
        slip_margin = arrays.check_number(self.slip_margin, "slip_margin", minimum=0.0)
        set_fields(self, gravity_H=gravity_H, slip_margin=slip_margin)
        check_collision_settings(self.collisions)
        check_acceleration_limits(self.acceleration_limits)
        fingers: object = self.fingers
        if isinstance(fingers, str):
            raise InvalidInput("fingers", fingers, "a list of finger names, one for each contact")
        set_fields(self, fingers=tuple(self.hand.finger(name).name for name in self.fingers))
        count = len(self.contacts)
        if len(self.fingers) != count or len(set(self.fingers)) < count:
            raise InvalidInput("fingers", self.fingers, f"{count} different finger names, one for each contact")
        check_fingertips(self.hand, self.fingers, "plans")
        fields.check_boolean(self.rolling, "rolling")
        self._check_tips_on_surface()

    def __repr__(self) -> str:
        return f"<{self}>"

    def __str__(self) -> str:
        return f"GraspTask: {self.hand.name}, {', '.join(self.fingers)}, {self.body.mass:.4g} kg"

    @classmethod
    def from_dict(cls, record: object, hand: Hand, field: str = "") -> GraspTask:
        """Return the task of a record.

        Args:
            record: mapping that `to_dict` made; all except `body` and `contacts` is optional.
            hand: the hand, which the record does not contain.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
            UnknownName: the hand has no finger of that name.
        """
        try:
            values = given_fields(record, GRASP_TASK_FIELDS, OBJECT_FIELDS)
            contacts, fingers = contacts_from_dicts(values["contacts"], "contacts")
            check_contact_fingers(hand, fingers, "contacts")
            options: JsonRecord = {name: values[name] for name in ("slip_margin", "rolling") if name in values}
            options |= collisions_of_record(values) | acceleration_limits_of_record(values)
            body, limited = Body.from_dict(values["body"], "body"), hand_with_limits(hand, values)
            return cls(limited, body, ContactSet.stack(contacts), fingers, **gravity_of_record(values), **options)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the task as a record for JSON, with the hand's limits but not the hand.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        return {
            "gravity": self.gravity_H.tolist(),
            "slip_margin": self.slip_margin,
            **limits_to_dict(self.hand),
            "body": self.body.to_dict(),
            "rolling": self.rolling,
            **collisions_to_record(self.collisions),
            **acceleration_limits_to_record(self.acceleration_limits),
            "contacts": contacts_to_dicts(self.contacts.contacts, self.fingers),
        }

    @property
    def joint_count(self) -> int:
        """Return n, the number of actuated joints."""
        return self.hand.n

    @property
    def force_size(self) -> int:
        """Return k, the number of stacked contact force components."""
        return self.contacts.size

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Return the name of each contact: its finger's."""
        return self.fingers

    @property
    def tip_radii(self) -> Array:
        """Return the radii (N,) of the fingertips, m; zero for a tip without a radius."""
        return np.array([self.hand.finger(name).tip_radius or 0.0 for name in self.fingers])

    @property
    def is_rolling(self) -> Mask:
        """Return (N,) whether each contact rolls."""
        return np.asarray((self.tip_radii > 0.0) & self.rolling)

    @property
    def constrained(self) -> tuple[Mask, Indices]:
        """Return which relative motions the contacts prevent.

        Returns:
            (3 N,) whether sliding along t₁, t₂ and n of each contact is prevented, and the contacts that prevent spin about n.
        """
        rough = (self.contacts.mu > 0.0) | ~self.is_rolling
        rows = np.stack([rough, rough, np.ones(len(rough), dtype=bool)], axis=1).ravel()
        return rows, np.flatnonzero((self.contacts.gamma > 0.0) & self.is_rolling)

    @property
    def tip_centres(self) -> Array:
        """Return the centres (N, 3) of the fingertips at the start, in O: p_OC − r n, m."""
        return np.asarray(self.contacts.p_OC - self.tip_radii[:, None] * self.contacts.R_OC[:, :, 2])

    def static_problem(self, p_HO: Array, R_HO: Array, q: Array, contacts: ContactSet | None = None) -> ForceProblem:
        """Return the force problem of static equilibrium.

        Args:
            p_HO: (3,) position of the object, m.
            R_HO: (3, 3) its orientation.
            q: (n,) posture, rad.
            contacts: the contacts in that pose; those at the start by default.
        """
        contacts = self.contacts if contacts is None else contacts
        w = self.body.wrench(BodyMotion(p_HO, R_HO), self.gravity_H)
        return ForceProblem(contacts, w, self.hand.actuation(q, self.fingers, contacts, p_HO, R_HO, gravity_H=self.gravity_H))

    def _check_tips_on_surface(self) -> None:
        """Raise InvalidInput unless every rolling tip touches the surface with the surface's normal."""
        if self.body.shape is None or not self.is_rolling.any():
            return
        error = np.linalg.norm(self.body.shape.closest_points(self.tip_centres) - self.contacts.p_OC, axis=1)  # m
        for i in np.flatnonzero(self.is_rolling & (error > _SURFACE_TOLERANCE)):
            allowed = f"on the object's surface, with its normal, where a tip rolls; it is off by {1e3 * error[i]:.2g} mm"
            raise InvalidInput(f"contacts[{i}].position", self.contacts.p_OC[i], allowed)


@dataclass(frozen=True, eq=False, slots=True)
class IdealTask:
    """An object between ideal fingers, which follow any motion: only friction and normal forces limit the move.

    Args:
        body: the object.
        contacts: the N contacts, in O; they do not move over the object.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        slip_margin: friction to keep in reserve at every contact: load ≤ μ f_n − slip_margin, N.
        acceleration_limits: limits of the object's accelerations.

    Raises:
        InvalidInput: a value out of range.
    """

    body: Body
    contacts: ContactSet
    gravity_H: Array = field(default_factory=_gravity_palm_up)
    slip_margin: float = 0.0
    acceleration_limits: AccelerationLimits = UNLIMITED

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            body: Body,
            contacts: ContactSet,
            gravity_H: npt.ArrayLike = ...,
            slip_margin: float = 0.0,
            acceleration_limits: AccelerationLimits = UNLIMITED,
        ) -> None: ...

    def __post_init__(self) -> None:
        gravity_H = arrays.check_array(self.gravity_H, "gravity_H", (3,))
        slip_margin = arrays.check_number(self.slip_margin, "slip_margin", minimum=0.0)
        set_fields(self, gravity_H=gravity_H, slip_margin=slip_margin)
        check_acceleration_limits(self.acceleration_limits)

    def __repr__(self) -> str:
        return f"<{self}>"

    def __str__(self) -> str:
        return f"IdealTask: {len(self.contacts)} contacts, {self.body.mass:.4g} kg"

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> IdealTask:
        """Return the task of a record.

        Args:
            record: mapping that `to_dict` made; gravity and slip margin are optional.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        try:
            values = given_fields(record, IDEAL_TASK_FIELDS, OBJECT_FIELDS)
            items = fields.check_sequence(values["contacts"], "contacts", at_least=1)
            contacts = [Contact.from_dict(item, f"contacts[{i}]") for i, item in enumerate(items)]
            options = {"slip_margin": values["slip_margin"]} if "slip_margin" in values else {}
            options |= gravity_of_record(values) | acceleration_limits_of_record(values)
            return cls(Body.from_dict(values["body"], "body"), ContactSet.stack(contacts), **options)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the task as a record for JSON.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        return {
            "gravity": self.gravity_H.tolist(),
            "slip_margin": self.slip_margin,
            "body": self.body.to_dict(),
            **acceleration_limits_to_record(self.acceleration_limits),
            "contacts": [contact.to_dict() for contact in self.contacts.contacts],
        }

    @property
    def joint_count(self) -> int:
        """Return n = 0: ideal fingers have no joints."""
        return 0

    @property
    def force_size(self) -> int:
        """Return k, the number of stacked contact force components."""
        return self.contacts.size

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Return the name of each contact: "contact 0", "contact 1", …"""
        return tuple(f"contact {i}" for i in range(len(self.contacts)))

    @property
    def is_rolling(self) -> Mask:
        """Return (N,) whether each contact rolls: none does."""
        return np.zeros(len(self.contacts), dtype=bool)

    def static_problem(self, p_HO: Array, R_HO: Array, q: Array, contacts: ContactSet | None = None) -> ForceProblem:
        """Return the force problem of static equilibrium. Arguments as `GraspTask.static_problem`; q is empty."""
        w = self.body.wrench(BodyMotion(p_HO, R_HO), self.gravity_H)
        return ForceProblem(self.contacts if contacts is None else contacts, w)


@dataclass(frozen=True, eq=False, slots=True)
class FingerTask:
    """Fingers that move alone, without an object.

    Args:
        hand: the hand; its torque, speed and position limits bound the motion.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        collisions: obstacles, and the distance that links and obstacles keep; None for no collision checks.
        acceleration_limits: limits of the joints' accelerations.

    Raises:
        InvalidInput: gravity_H is not three finite numbers.
    """

    hand: Hand
    gravity_H: Array = field(default_factory=_gravity_palm_up)
    collisions: CollisionSettings | None = DEFAULT_COLLISIONS
    acceleration_limits: AccelerationLimits = UNLIMITED

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            hand: Hand,
            gravity_H: npt.ArrayLike = ...,
            collisions: CollisionSettings | None = DEFAULT_COLLISIONS,
            acceleration_limits: AccelerationLimits = UNLIMITED,
        ) -> None: ...

    def __post_init__(self) -> None:
        set_fields(self, gravity_H=arrays.check_array(self.gravity_H, "gravity_H", (3,)))
        check_collision_settings(self.collisions)
        check_acceleration_limits(self.acceleration_limits)

    def __repr__(self) -> str:
        return f"<{self}>"

    def __str__(self) -> str:
        return f"FingerTask: {self.hand.name}"

    @classmethod
    def from_dict(cls, record: object, hand: Hand, field: str = "") -> FingerTask:
        """Return the task of a record.

        Args:
            record: mapping that `to_dict` made; gravity and limits are optional.
            hand: the hand, which the record does not contain.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        try:
            values = given_fields(record, FINGER_TASK_FIELDS)
            options = gravity_of_record(values) | collisions_of_record(values) | acceleration_limits_of_record(values)
            return cls(hand_with_limits(hand, values), **options)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the task as a record for JSON, with the hand's limits but not the hand."""
        options = collisions_to_record(self.collisions) | acceleration_limits_to_record(self.acceleration_limits)
        return {"gravity": self.gravity_H.tolist(), **limits_to_dict(self.hand), **options}

    @property
    def joint_count(self) -> int:
        """Return n, the number of actuated joints."""
        return self.hand.n

    @property
    def force_size(self) -> int:
        """Return k = 0: there are no contacts."""
        return 0

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Return no names: there are no contacts."""
        return ()


ObjectTask = GraspTask | IdealTask
HandTask = GraspTask | FingerTask
Task = GraspTask | IdealTask | FingerTask


def task_from_dict(record: object, hand: Hand | None, field: str = "") -> Task:
    """Return the task of a record: fingers alone if it has no body, else a hand with an object or ideal fingers.

    Args:
        record: mapping that a task's `to_dict` made.
        hand: the hand, which the record does not contain; None for ideal fingers.
        field: path of the record, for errors.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    if hand is None:
        return IdealTask.from_dict(record, field)
    if isinstance(record, Mapping) and "body" in record:
        return GraspTask.from_dict(record, hand, field)
    return FingerTask.from_dict(record, hand, field)
