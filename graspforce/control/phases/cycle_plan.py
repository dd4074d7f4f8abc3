"""Plan of a grasp cycle: the grasp, the postures around it, and the motion of the hand's base."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_reference import JointReference
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.records import set_fields
from graspforce.geometry.minimum_jerk import minimum_jerk
from graspforce.grasp.grasp import Grasp

_MOVE_SPEED = 0.1  # m/s: mean speed of the base
_LEAST_MOVE_TIME = 0.3  # s


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
    """What a hand is to do with an object on a table.

    Args:
        grasp: the grasp with the object where it is expected on the table.
        gravity_H: (3,) acceleration of gravity in H, m/s²; the table's normal is opposite.
        q_start: (n,) posture at the start, rad.
        q_pregrasp: (n,) pre-grasp posture, rad.
        standoff: (N,) distance of each fingertip from its contact in that posture, m.
        approach: motion from `q_start` to `q_pregrasp`.
        approach_time: time of that motion, s.
        lift: (3,) displacement of the base that lifts the object, in H, m.
        move: (3,) displacement of the base from there to above the goal, in H, m.

    Raises:
        InvalidInput: a value is not finite, or of the wrong shape.
    """

    grasp: Grasp
    gravity_H: Array
    q_start: Array
    q_pregrasp: Array
    standoff: Array
    approach: JointReference
    approach_time: float
    lift: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    move: Array = field(default_factory=lambda: freeze(np.zeros(3)))

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            grasp: Grasp,
            gravity_H: npt.ArrayLike,
            q_start: npt.ArrayLike,
            q_pregrasp: npt.ArrayLike,
            standoff: npt.ArrayLike,
            approach: JointReference,
            approach_time: float,
            lift: npt.ArrayLike = ...,
            move: npt.ArrayLike = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        n, count = self.grasp.hand.n, len(self.grasp.fingers)
        shapes = {"gravity_H": (3,), "q_start": (n,), "q_pregrasp": (n,), "standoff": (count,), "lift": (3,), "move": (3,)}
        for name, shape in shapes.items():
            set_fields(self, **{name: arrays.check_array(getattr(self, name), name, shape)})
        set_fields(self, approach_time=arrays.check_number(self.approach_time, "approach_time", above=0.0))

    @property
    def down(self) -> Array:
        """(3,) unit vector along gravity, in H."""
        return np.asarray(self.gravity_H / np.linalg.norm(self.gravity_H))


def move_time(displacement: Array) -> float:
    """Return the time of a motion of the base, s.

    Args:
        displacement: (3,) m.
    """
    return max(float(np.linalg.norm(displacement)) / _MOVE_SPEED, _LEAST_MOVE_TIME)


def base_motion(start: Array, displacement: Array, t: float) -> BaseMotion:
    """Return the motion of the base with least jerk at a time.

    Args:
        start: (3,) displacement at t = 0, m.
        displacement: (3,) further displacement, m.
        t: time since the start of the motion, s.
    """
    s, ds, dds = minimum_jerk(t, move_time(displacement))
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
