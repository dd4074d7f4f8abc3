"""Measured state of a grasp, and its desired motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.constants import LARGEST_MOTION
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.geometry.poses import pose_to_dict
from graspforce.hand.hand import Hand


@dataclass(frozen=True, eq=False, slots=True)
class GraspState:
    """Measured state of a hand and its object at one instant.

    Args:
        q: (n,) joint positions, rad.
        v: (n,) joint rates, rad/s.
        object: pose and twist of the object in H; its acceleration is not used.

    Raises:
        InvalidInput: a value is not finite, or `q` and `v` differ in length.
    """

    q: Array
    v: Array
    object: BodyMotion

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, q: npt.ArrayLike, v: npt.ArrayLike, object: BodyMotion) -> None: ...

    def __post_init__(self) -> None:
        q = arrays.check_array(self.q, "q", (None,))
        set_fields(self, q=q, v=arrays.check_array(self.v, "v", q.shape))

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `posture`, `velocity`, and the pose and `twist` of the `object`."""
        pose = pose_to_dict(self.object.p_HO, self.object.R_HO)
        return {
            "posture": self.q.tolist(),
            "velocity": self.v.tolist(),
            "object": {**pose, "twist": self.object.twist.tolist()},
        }

    @classmethod
    def from_dict(cls, record: JsonRecord, n: int, field: str = "state") -> GraspState:
        """Read a state from a plain record.

        Args:
            record: `posture` in rad, `velocity` in rad/s (zeros by default), and `object`: pose and `twist` in H.
            n: number of joints of the hand.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["posture", "object"], optional=["velocity"])
        q = arrays.check_array(values["posture"], f"{field}.posture", (n,), limit=LARGEST_MOTION)
        v = values.get("velocity")
        v = np.zeros(n) if v is None else arrays.check_array(v, f"{field}.velocity", (n,), limit=LARGEST_MOTION)
        return cls(q, v, BodyMotion.from_dict(values["object"], f"{field}.object", ("twist",)))


@dataclass(frozen=True, eq=False, slots=True)
class GraspMotion:
    """Desired motion of an object and of the joints that hold it.

    The object has priority. The joints follow q, v and a in the null space of the contacts, and fingers without contact fully.

    Args:
        object: desired pose, twist and acceleration of the object in H.
        q: (n,) desired joint positions, rad.
        v: (n,) desired joint rates, rad/s.
        a: (n,) desired joint accelerations, rad/s².

    Raises:
        InvalidInput: a value is not finite, or `q`, `v` and `a` differ in length.
    """

    object: BodyMotion
    q: Array
    v: Array
    a: Array

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, object: BodyMotion, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        q = arrays.check_array(self.q, "q", (None,))
        set_fields(self, q=q, v=arrays.check_array(self.v, "v", q.shape), a=arrays.check_array(self.a, "a", q.shape))

    def to_dict(self) -> JsonRecord:
        """Return a plain record: the object's motion, and `joints` with `posture`, `velocity` and `acceleration`."""
        joints = {"posture": self.q.tolist(), "velocity": self.v.tolist(), "acceleration": self.a.tolist()}
        return {**self.object.to_dict(), "joints": joints}

    @classmethod
    def from_dict(cls, record: JsonRecord, n: int, field: str = "motion") -> GraspMotion:
        """Read a motion from a plain record.

        Args:
            record: the object's motion, and `joints`: `posture` in rad, `velocity` in rad/s and `acceleration` in rad/s²
                (zeros by default).
            n: number of joints of the hand.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        motion = BodyMotion.from_dict(record, field, ("twist", "acceleration", "joints"))
        values = fields.check_record(
            record.get("joints"), f"{field}.joints", required=["posture"], optional=["velocity", "acceleration"]
        )
        given = {name: value for name, value in values.items() if value is not None or name == "posture"}
        named = {
            name: arrays.check_array(value, f"{field}.joints.{name}", (n,), limit=LARGEST_MOTION)
            for name, value in given.items()
        }
        rest = freeze(np.zeros(n))
        return cls(motion, named["posture"], named.get("velocity", rest), named.get("acceleration", rest))


DesiredMotion = BodyMotion | GraspMotion  # with a BodyMotion the joints keep the posture of the grasp


def object_motion(desired: DesiredMotion) -> BodyMotion:
    """Return the object's part of a desired motion.

    Args:
        desired: motion of the object, or of object and joints.
    """
    return desired.object if isinstance(desired, GraspMotion) else desired


def desired_from_dict(record: object, n: int, field: str = "desired") -> DesiredMotion:
    """Read a desired motion from a plain record: a `GraspMotion` if it has `joints`, otherwise a `BodyMotion`.

    Args:
        record: as in `GraspMotion.from_dict`; `joints` may be absent or null.
        n: number of joints of the hand.
        field: path of the record, for errors.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    if isinstance(record, Mapping) and record.get("joints") is not None:
        return GraspMotion.from_dict(dict(record), n, field)
    return BodyMotion.from_dict(record, field, ("twist", "acceleration", "joints"))


def check_joint_count(hand: Hand, q: Array, desired: DesiredMotion) -> None:
    """Check that measured and desired joints are the joints of the hand.

    Args:
        hand: the hand.
        q: (n,) measured joint positions, rad.
        desired: desired motion, with or without joints.

    Raises:
        InvalidInput: a number of joints differs from the number of motors.
    """
    for field, joints in (("state.q", q), ("desired.q", desired.q if isinstance(desired, GraspMotion) else q)):
        if len(joints) != hand.n:
            raise InvalidInput(field, joints, f"a list of {hand.n} numbers, one for each motor of {hand.name}")
