"""What a hand holds, on the wire and back: pose and motion, shape, body, contacts with their fingers, hold.

Frames: H hand base, O object. Every reader names what is wrong by its path from the outermost record.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.geometry import Box, Cylinder, Shape, Solid, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

_SHAPES: dict[str, type[Sphere | Cylinder | Box | Superquadric]] = {
    "sphere": Sphere,
    "cylinder": Cylinder,
    "box": Box,
    "superquadric": Superquadric,
}


def read_pose(value: Any, field: str, optional: Collection[str] = ()) -> tuple[Array, Array, dict[str, Any]]:
    """p_HO, R_HO, and the whole record: ``position``, and ``rotation`` (rows of the matrix) or ``quaternion`` (w, x, y, z).

    Args:
        value: the record.
        field: its path.
        optional: what else it may hold.
    """
    values = fields.check_record(value, field, required=["position"], optional=["rotation", "quaternion", *optional])
    if ("rotation" in values) == ("quaternion" in values):
        raise InvalidInput(field, value, "given with either rotation or quaternion")
    p_HO = arrays.check_array(values["position"], f"{field}.position", (3,))
    if "rotation" in values:
        return p_HO, arrays.check_rotation(values["rotation"], f"{field}.rotation"), values
    return p_HO, _quaternion(values["quaternion"], f"{field}.quaternion"), values


def write_pose(p_HO: Array, R_HO: Array) -> dict[str, Any]:
    """The record of a pose."""
    return {"position": p_HO.tolist(), "rotation": R_HO.tolist()}


def read_motion(
    value: Any, field: str, optional: Collection[str] = ("twist", "acceleration"), extra_fields: Collection[str] = ()
) -> BodyMotion:
    """A pose with ``twist`` and ``acceleration``, zeros by default.

    Args:
        value: the record.
        field: its path.
        optional: which of both it may hold.
        beside: what else it may hold, for others to read.
    """
    p_HO, R_HO, values = read_pose(value, field, (*optional, *extra_fields))
    rates = {
        name: arrays.check_array(values[name], f"{field}.{name}", (6,)) for name in optional if values.get(name) is not None
    }
    return BodyMotion(p_HO, R_HO, **rates)


def write_motion(motion: BodyMotion) -> dict[str, Any]:
    """The record of a motion."""
    rates = {"twist": motion.twist.tolist(), "acceleration": motion.acceleration.tolist()}
    return {**write_pose(motion.p_HO, motion.R_HO), **rates}


def read_shape(value: Any, field: str) -> Solid:
    """A sphere, cylinder, box or superquadric: its ``type``, and the measures that it has in Python."""
    if not isinstance(value, Mapping) or "type" not in value:
        raise InvalidInput(f"{field}.type", None, "one of " + ", ".join(_SHAPES))
    shape = _SHAPES[fields.check_choice(value["type"], f"{field}.type", _SHAPES)]
    measures = _shape_fields(shape)
    values = fields.check_record(value, field, required=["type", *measures])
    try:
        return shape(**{name: values[name] for name in measures})
    except InvalidInput as error:
        raise error.with_prefix(field) from None


def write_shape(shape: Shape) -> dict[str, Any]:
    """The record of a shape.

    Raises:
        InvalidInput: an implicit surface: its function cannot be sent.
    """
    for name, kind in _SHAPES.items():
        if isinstance(shape, kind):
            measures = {measure: getattr(shape, measure) for measure in _shape_fields(kind)}
            return {"type": name, **{m: v.tolist() if isinstance(v, np.ndarray) else v for m, v in measures.items()}}
    raise InvalidInput("shape", type(shape).__name__, f"one of {', '.join(_SHAPES)}: a function cannot be sent")


def _shape_fields(shape: type[Box | Cylinder | Sphere | Superquadric]) -> list[str]:
    """What a shape is made of, without what it works out by itself."""
    return [measure.name for measure in dataclasses.fields(shape) if measure.init]


def read_body(value: Any, field: str) -> Body:
    """``mass``; ``shape``; ``inertia`` about the centre of mass and ``centre_of_mass`` in O.

    Without ``inertia`` the body is of one material throughout and needs its shape.
    """
    values = fields.check_record(value, field, required=["mass"], optional=["inertia", "centre_of_mass", "shape"])
    given = {name: item for name, item in values.items() if item is not None}
    shape = read_shape(given["shape"], f"{field}.shape") if "shape" in given else None
    try:
        if "inertia" in given:
            centre = arrays.check_array(given.get("centre_of_mass", (0.0, 0.0, 0.0)), "centre_of_mass", (3,))
            return Body(values["mass"], given["inertia"], centre, shape)
        if shape is None:
            raise InvalidInput("inertia", None, "given: this field is required without a shape")
        if "centre_of_mass" in given:
            raise InvalidInput("centre_of_mass", given["centre_of_mass"], "absent without inertia")
        return Body.solid(shape, values["mass"])
    except InvalidInput as error:
        raise error.with_prefix(field) from None


def write_body(body: Body) -> dict[str, Any]:
    """The record of a body."""
    record = {"mass": body.mass, "inertia": body.inertia.tolist(), "centre_of_mass": body.p_OM.tolist()}
    return record if body.shape is None else {**record, "shape": write_shape(body.shape)}


def read_contacts(value: Any, field: str) -> tuple[tuple[Contact, ...], tuple[str, ...]]:
    """Contacts in O, and the finger that makes each, by name."""
    contacts, fingers = [], []
    for i, item in enumerate(fields.check_sequence(value, field, at_least=1)):
        other_fields = item if isinstance(item, Mapping) else ()  # the contact itself checks what else it holds
        contact = fields.check_record(item, f"{field}[{i}]", required=["finger"], optional=other_fields)
        fingers.append(contact.pop("finger"))
        contacts.append(Contact.from_dict(contact, f"{field}[{i}]"))
    return tuple(contacts), tuple(fields.check_text(name, f"{field}[{i}].finger") for i, name in enumerate(fingers))


def write_contacts(contacts: Collection[Contact], fingers: Collection[str]) -> list[dict[str, Any]]:
    """The records of contacts with their fingers."""
    return [{**contact.to_dict(), "finger": finger} for contact, finger in zip(contacts, fingers, strict=True)]


def check_fingers(hand: Hand, fingers: Collection[str], field: str) -> None:
    """Refuse a finger that the hand has not.

    Raises:
        UnknownName: names the contact and the fingers that there are.
    """
    names = [finger.name for finger in hand.fingers]
    for i, name in enumerate(fingers):
        if name not in names:
            raise UnknownName(f"{field}[{i}].finger", name, "one of " + ", ".join(names))


def read_grasp(hand: Hand, value: Any, field: str) -> Grasp:
    """``body``, ``contacts`` (each with its ``finger``), and the ``posture`` and ``object`` pose in which they touch."""
    values = fields.check_record(value, field, required=["body", "contacts", "posture", "object"])
    body = read_body(values["body"], f"{field}.body")
    contacts, fingers = read_contacts(values["contacts"], f"{field}.contacts")
    check_fingers(hand, fingers, f"{field}.contacts")
    q = arrays.check_array(values["posture"], f"{field}.posture", (hand.n,))
    p_HO, R_HO, _ = read_pose(values["object"], f"{field}.object")
    try:
        return Grasp(hand, body, fingers, ContactSet.stack(contacts), q, p_HO, R_HO)
    except InvalidInput as error:
        raise error.with_prefix(field) from None


def write_grasp(grasp: Grasp) -> dict[str, Any]:
    """The record of a hold, without its hand."""
    return {
        "body": write_body(grasp.body),
        "contacts": write_contacts(grasp.contacts.contacts, grasp.fingers),
        "posture": grasp.q.tolist(),
        "object": write_pose(grasp.p_HO, grasp.R_HO),
    }


def _quaternion(value: Any, field: str) -> Array:
    """The rotation matrix of a quaternion (w, x, y, z) of any length but zero."""
    quaternion = arrays.check_array(value, field, (4,))
    largest = float(np.abs(quaternion).max())
    if largest == 0.0:
        raise InvalidInput(field, value, "a quaternion (w, x, y, z) that is not zero")
    w, x, y, z = quaternion / largest
    return arrays.freeze(Rotation.from_quat([x, y, z, w]).as_matrix())
