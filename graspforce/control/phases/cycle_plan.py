"""Plan of a grasp cycle: the grasp, the postures around it, and the motion of the hand's base."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.motion_profile import CarryProfiles, MotionProfile
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.grasp.grasp import Grasp
from graspforce.hand.contact_tips import check_fingertips
from graspforce.hand.hand import Hand

_MOVE_SPEED = 0.1  # m/s: mean speed of the base
_LEAST_MOVE_TIME = 0.3  # s
_SLOW_DISTANCE, _TOUCHDOWN_SPEED = 0.01, 0.03  # m, end of the way to the table, and largest speed in it, m/s
_VECTORS = {"gravity": "gravity_H", "pregrasp": "q_pregrasp", "standoff": "standoff", "lift": "lift", "move": "move"}
_ABOVE = {"standoff": 0.0}  # m: numbers that vectors must exceed
_SHAPE = "given: the touch shows where the object's surface is"
STOP_DECELERATION = 1.0  # m/s², of the base in a safe stop
_REQUIRED = ("hold", "gravity", "pregrasp", "standoff", "approach")  # fields of the record


class BaseMotion(NamedTuple):
    """Motion of the hand's base from its place at the start, which an arm makes. The base does not rotate.

    Attributes:
        p: (3,) displacement in the axes of H, m.
        v: (3,) velocity, m/s.
        a: (3,) acceleration, m/s².
    """

    p: Array
    v: Array
    a: Array

    @classmethod
    def at_rest(cls, p: npt.ArrayLike) -> BaseMotion:
        """Return the motion of a base at rest.

        Args:
            p: (3,) displacement, m.
        """
        zero = freeze(np.zeros(3))
        return cls(freeze(p), zero, zero)


@dataclass(frozen=True, eq=False, slots=True)
class CyclePlan:
    """Plan of a grasp cycle: grasp, postures, approach and base motion.

    Args:
        grasp: the grasp with the object where it is expected on the table.
        gravity_H: (3,) acceleration of gravity in H, m/s²; the table's normal is opposite.
        q_pregrasp: (n,) pre-grasp posture, rad.
        standoff: (N,) distance of each fingertip from its contact in that posture, m.
        approach: motion from the start posture to `q_pregrasp`, from rest to rest.
        lift: (3,) displacement of the base that lifts the object, in H, m.
        move: (3,) displacement of the base from there to above the goal, in H, m.
        profiles: time profiles of the base. Default: least jerk, with a mean speed of 0.1 m/s and at least 0.3 s; the last
            10 mm to the table with 30 mm/s at most, because the object may hang lower than the hand knows.

    Raises:
        InvalidInput: a value is not finite or of the wrong shape, gravity is zero, a stand-off distance is not positive, or the
            object has no shape.
    """

    grasp: Grasp
    gravity_H: Array
    q_pregrasp: Array
    standoff: Array
    approach: JointTrajectory
    lift: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    move: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    profiles: CarryProfiles | None = None

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            grasp: Grasp,
            gravity_H: npt.ArrayLike,
            q_pregrasp: npt.ArrayLike,
            standoff: npt.ArrayLike,
            approach: JointTrajectory,
            lift: npt.ArrayLike = ...,
            move: npt.ArrayLike = ...,
            profiles: CarryProfiles | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        check_fingertips(self.grasp.hand, self.grasp.fingers, "cycles")
        if self.grasp.body.shape is None:
            raise InvalidInput("grasp.body.shape", None, _SHAPE)
        n, count = self.grasp.hand.n, len(self.grasp.fingers)
        shapes = {"gravity_H": (3,), "q_pregrasp": (n,), "standoff": (count,), "lift": (3,), "move": (3,)}
        for name, shape in shapes.items():
            set_fields(self, **{name: arrays.check_array(getattr(self, name), name, shape, above=_ABOVE.get(name))})
        if not self.gravity_H.any():
            raise InvalidInput("gravity_H", self.gravity_H, "not zero: the table is below the object")
        if self.approach.q.shape[1] != n:
            raise InvalidInput("approach", self.approach.q.shape, f"a motion of {n} joints")

    @property
    def q_start(self) -> Array:
        """(n,) posture at the start, rad."""
        return np.asarray(self.approach.q[0])

    @property
    def down(self) -> Array:
        """(3,) unit vector along gravity, in H."""
        return np.asarray(self.gravity_H / np.linalg.norm(self.gravity_H))

    @property
    def carry_profiles(self) -> CarryProfiles:
        """Time profiles of the base: those of the plan, or the default ones."""
        if self.profiles is not None:
            return self.profiles
        lift, move = (MotionProfile.least_jerk(move_time(each)) for each in (self.lift, self.move))
        return CarryProfiles(lift, move, place_profile(float(np.linalg.norm(self.lift))))

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `hold`, the grasp; `gravity`, `pregrasp`, `standoff`, `approach`, `lift`, `move`, `profiles`.

        Raises:
            InvalidInput: the object's shape is an implicit surface, whose function cannot be stored.
        """
        vectors = {name: getattr(self, attribute).tolist() for name, attribute in _VECTORS.items()}
        profiles = {} if self.profiles is None else {"profiles": self.profiles.to_dict()}
        return {"hold": self.grasp.to_dict(), **vectors, "approach": self.approach.to_dict(), **profiles}

    @classmethod
    def from_dict(cls, record: object, hand: Hand, field: str = "plan") -> CyclePlan:
        """Read a plan from a plain record.

        Args:
            record: as `to_dict` returns it; `lift`, `move` and `profiles` may be absent.
            hand: the hand.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=_REQUIRED, optional=("lift", "move", "profiles"))
        grasp = Grasp.from_dict(values["hold"], hand, f"{field}.hold")
        if grasp.body.shape is None:
            raise InvalidInput(f"{field}.hold.body.shape", None, _SHAPE)
        sizes = {"gravity": 3, "pregrasp": hand.n, "standoff": len(grasp.fingers), "lift": 3, "move": 3}
        vectors = {
            attribute: arrays.check_array(values[name], f"{field}.{name}", (sizes[name],), above=_ABOVE.get(name))
            for name, attribute in _VECTORS.items()
            if name in values
        }
        if not vectors["gravity_H"].any():
            raise InvalidInput(f"{field}.gravity", values["gravity"], "not zero: the table is below the object")
        approach = JointTrajectory.from_dict(values["approach"], hand.n, f"{field}.approach")
        given = values.get("profiles")
        profiles = None if given is None else CarryProfiles.from_dict(given, f"{field}.profiles")
        return cls(grasp=grasp, approach=approach, profiles=profiles, **vectors)


def move_time(displacement: Array) -> float:
    """Return the time of a motion of the base without a profile, s.

    Args:
        displacement: (3,) m.
    """
    return max(float(np.linalg.norm(displacement)) / _MOVE_SPEED, _LEAST_MOVE_TIME)


def place_profile(distance: float) -> MotionProfile:
    """Return the time profile of a motion down to the table, whose last 10 mm are slow.

    Args:
        distance: of the whole motion, m.
    """
    slow = 2.0 * _SLOW_DISTANCE / _TOUCHDOWN_SPEED  # s
    if distance <= 2.0 * _SLOW_DISTANCE:
        return MotionProfile.least_jerk(max(2.0 * distance / _TOUCHDOWN_SPEED, _LEAST_MOVE_TIME))
    fast = max((distance - _SLOW_DISTANCE) / _MOVE_SPEED, _LEAST_MOVE_TIME)  # s
    share, rate = 1.0 - _SLOW_DISTANCE / distance, _TOUCHDOWN_SPEED / distance
    return MotionProfile([0.0, fast, fast + slow], [0.0, share, 1.0], [0.0, rate, 0.0], np.zeros(3))


def base_motion(start: Array, displacement: Array, profile: MotionProfile, t: float) -> BaseMotion:
    """Return the motion of the base at a time.

    Args:
        start: (3,) displacement at t = 0, m.
        displacement: (3,) further displacement, m.
        profile: its time profile.
        t: time since the start of the motion, s.
    """
    s, ds, dds = profile(t)
    return BaseMotion(freeze(start + s * displacement), freeze(ds * displacement), freeze(dds * displacement))


def braked_motion(motion: BaseMotion, t: float, deceleration: float) -> BaseMotion:
    """Return the motion of a base that brakes along its path until it rests.

    Args:
        motion: motion when the brake begins.
        t: time since then, s.
        deceleration: m/s², > 0.
    """
    speed = float(np.linalg.norm(motion.v))
    end = speed / deceleration  # s
    if t >= end:
        return BaseMotion.at_rest(motion.p + 0.5 * end * motion.v)
    direction = motion.v / speed
    p = motion.p + (speed * t - 0.5 * deceleration * t**2) * direction
    return BaseMotion(freeze(p), freeze((speed - deceleration * t) * direction), freeze(-deceleration * direction))
