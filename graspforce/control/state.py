"""What is measured of a hand and the object that it holds, and what is wanted of both."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand


@dataclass(frozen=True, eq=False, slots=True)
class GraspState:
    """A hand and the object in it at one instant, as measured.

    Args:
        q: (n,) joint positions, rad.
        v: (n,) joint rates, rad/s.
        object: the object's pose and twist, seen from H; its acceleration is not read.

    Raises:
        InvalidInput: not finite, or of another shape than one another.
    """

    q: Array
    v: Array
    object: BodyMotion

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", arrays.check_array(self.q, "q", (None,)))
        object.__setattr__(self, "v", arrays.check_array(self.v, "v", self.q.shape))


@dataclass(frozen=True, eq=False, slots=True)
class GraspMotion:
    """How an object in a hand should move, and which of the ways in which its fingers can do that they should take.

    The object comes first: only what the contacts leave free of the joints follows q, v and a.

    Args:
        object: the object's desired pose, twist and acceleration.
        q: (n,) desired joint positions, rad.
        v: (n,) rates, rad/s.
        a: (n,) accelerations, rad/s².

    Raises:
        InvalidInput: not finite, or of another shape than one another.
    """

    object: BodyMotion
    q: Array
    v: Array
    a: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", arrays.check_array(self.q, "q", (None,)))
        for name in ("v", "a"):
            object.__setattr__(self, name, arrays.check_array(getattr(self, name), name, self.q.shape))


DesiredMotion = BodyMotion | GraspMotion  # of the object alone the fingers keep to the hold's posture


def object_motion(desired: DesiredMotion) -> BodyMotion:
    """What is wanted of the object."""
    return desired.object if isinstance(desired, GraspMotion) else desired


def check_joint_count(hand: Hand, q: Array, desired: DesiredMotion) -> None:
    """Refuse what is measured or wanted of another hand's joints.

    Raises:
        InvalidInput: not one number for each motor.
    """
    for field, joints in (("state.q", q), ("desired.q", desired.q if isinstance(desired, GraspMotion) else q)):
        if len(joints) != hand.n:
            raise InvalidInput(field, joints, f"a list of {hand.n} numbers, one for each motor of {hand.name}")
