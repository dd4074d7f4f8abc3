"""Motion of joints through knots in time, as data: a reference that can be stored and sent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_command import JointMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.geometry.hermite import hermite, locate_intervals

_FIELDS = ("times", "posture", "velocity", "acceleration")


@dataclass(frozen=True, eq=False, slots=True)
class JointTrajectory:
    """Motion of n joints through K knots; between them quintic polynomials, so that accelerations are continuous.

    It is a `JointReference`: call it with a time. Before the first knot and after the last one the joints rest there.

    Args:
        t: (K,) times of the knots from 0 on, s, increasing; K ≥ 2.
        q: (K, n) positions, rad.
        v: (K, n) rates, rad/s.
        a: (K, n) accelerations, rad/s².

    Raises:
        InvalidInput: a value is not finite, or of the wrong shape, or the times do not increase from 0.
    """

    t: Array
    q: Array
    v: Array
    a: Array

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, t: npt.ArrayLike, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        t = arrays.check_times(self.t, "t")
        q = arrays.check_array(self.q, "q", (len(t), None))
        set_fields(self, t=t, q=q, **{name: arrays.check_array(getattr(self, name), name, q.shape) for name in ("v", "a")})

    @classmethod
    def between(cls, start: npt.ArrayLike, goal: npt.ArrayLike, duration: float) -> JointTrajectory:
        """Return the motion from rest to rest with least jerk, as `minimum_jerk_reference`.

        Args:
            start: (n,) posture at t = 0, rad.
            goal: (n,) posture at the end, rad.
            duration: s, > 0.

        Raises:
            InvalidInput: a value is not finite, or lengths differ.
        """
        q0 = arrays.check_array(start, "start", (None,))
        q = np.array([q0, arrays.check_array(goal, "goal", q0.shape)])
        rest = np.zeros_like(q)
        return cls(np.array([0.0, arrays.check_number(duration, "duration", above=0.0)]), q, rest, rest)

    @property
    def duration(self) -> float:
        """Time of the last knot, s."""
        return float(self.t[-1])

    def __call__(self, t: float) -> JointMotion:
        """Return the motion at a time.

        Args:
            t: time since the start, s.
        """
        if t <= 0.0 or t >= self.duration:
            return JointMotion(self.q[0 if t <= 0.0 else -1])
        i, u = locate_intervals(self.t, np.array([t]))
        j = i + 1
        q, v, a = hermite(u, self.t[j] - self.t[i], (self.q[i], self.v[i], self.a[i], self.q[j], self.v[j], self.a[j]))
        return JointMotion(q[0], v[0], a[0])

    def reversed(self) -> JointTrajectory:
        """Return the same motion backwards."""
        t = freeze(self.duration - self.t[::-1])
        return JointTrajectory(t, self.q[::-1], -self.v[::-1], self.a[::-1])

    def followed_by(self, other: JointTrajectory) -> JointTrajectory:
        """Return this motion and then another one, which begins with rest where this one rests.

        Args:
            other: the motion that follows.
        """
        t = np.append(self.t, self.duration + other.t[1:])
        parts = ((self.q, other.q), (self.v, other.v), (self.a, other.a))
        return JointTrajectory(t, *(np.vstack([first, second[1:]]) for first, second in parts))

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `times`, `posture`, `velocity` and `acceleration`."""
        values = (self.t, self.q, self.v, self.a)
        return {name: value.tolist() for name, value in zip(_FIELDS, values, strict=True)}

    @classmethod
    def from_dict(cls, record: object, n: int, field: str = "trajectory") -> JointTrajectory:
        """Read a motion from a plain record.

        Args:
            record: as `to_dict` returns it.
            n: number of joints.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=_FIELDS)
        t = arrays.check_array(values["times"], f"{field}.times", (None,))
        rows = [arrays.check_array(values[name], f"{field}.{name}", (len(t), n)) for name in _FIELDS[1:]]
        try:
            return cls(t, *rows)
        except InvalidInput as error:
            raise error.with_prefix(field) from None
