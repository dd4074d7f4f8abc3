"""Time profiles of straight motions of the hand's base: the part of the displacement over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.geometry.hermite import hermite, locate_intervals

_FIELDS = {"times": "t", "share": "s", "rate": "rate", "acceleration": "acceleration"}
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class MotionProfile:
    """The share s of a displacement over time, from rest to rest: quintic polynomials between K knots.

    Args:
        t: (K,) times of the knots from 0 on, s, increasing; K ≥ 2.
        s: (K,) shares, from 0 at the first knot to 1 at the last one.
        rate: (K,) rates ṡ, 1/s; zero at both ends.
        acceleration: (K,) s̈, 1/s².

    Raises:
        InvalidInput: a value is not finite or of the wrong shape, or the ends are not as above.
    """

    t: Array
    s: Array
    rate: Array
    acceleration: Array

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, t: npt.ArrayLike, s: npt.ArrayLike, rate: npt.ArrayLike, acceleration: npt.ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        t = arrays.check_times(self.t, "t")
        names = ("s", "rate", "acceleration")
        set_fields(self, t=t, **{name: arrays.check_array(getattr(self, name), name, t.shape) for name in names})
        if abs(self.s[0]) > _ROUNDING or abs(self.s[-1] - 1.0) > _ROUNDING:
            raise InvalidInput("s", [float(self.s[0]), float(self.s[-1])], "0 at the first knot and 1 at the last one")
        if np.abs(self.rate[[0, -1]]).max() > _ROUNDING / t[-1]:
            raise InvalidInput("rate", [float(self.rate[0]), float(self.rate[-1])], "0 at the first and the last knot")

    @classmethod
    def least_jerk(cls, duration: float) -> MotionProfile:
        """Return the profile with least jerk, without acceleration at both ends.

        Args:
            duration: s, > 0.

        Raises:
            InvalidInput: the duration is not greater than 0.
        """
        zero = np.zeros(2)
        return cls(np.array([0.0, arrays.check_number(duration, "duration", above=0.0)]), np.array([0.0, 1.0]), zero, zero)

    @property
    def duration(self) -> float:
        """Time of the last knot, s."""
        return float(self.t[-1])

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Return s, ṡ in 1/s and s̈ in 1/s² at a time; at rest before the first knot and after the last one.

        Args:
            t: time since the start, s.
        """
        if t <= 0.0 or t >= self.duration:
            return (0.0 if t <= 0.0 else 1.0), 0.0, 0.0
        s, rate, acceleration = self.sample(np.array([t]))
        return float(s[0]), float(rate[0]), float(acceleration[0])

    def sample(self, t: Array) -> tuple[Array, Array, Array]:
        """Return s, ṡ in 1/s and s̈ in 1/s² at times between the first and the last knot, (M,) each.

        Args:
            t: (M,) times, s.
        """
        i, u = locate_intervals(self.t, t)
        j = i + 1
        step = self.t[j] - self.t[i]
        return hermite(u, step, (self.s[i], self.rate[i], self.acceleration[i], self.s[j], self.rate[j], self.acceleration[j]))

    def stretched(self, factor: float) -> MotionProfile:
        """Return the same motion in another time.

        Args:
            factor: new duration over the present one, > 0.
        """
        return MotionProfile(factor * self.t, self.s, self.rate / factor, self.acceleration / factor**2)

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `times`, `share`, `rate` and `acceleration`."""
        return {name: getattr(self, attribute).tolist() for name, attribute in _FIELDS.items()}

    @classmethod
    def from_dict(cls, record: object, field: str = "profile") -> MotionProfile:
        """Read a profile from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=tuple(_FIELDS))
        t = arrays.check_array(values["times"], f"{field}.times", (None,))
        rows = [arrays.check_array(values[name], f"{field}.{name}", t.shape) for name in list(_FIELDS)[1:]]
        try:
            return cls(t, *rows)
        except InvalidInput as error:
            by_attribute = {attribute: name for name, attribute in _FIELDS.items()}
            raise error.with_field(f"{field}.{by_attribute[error.field]}") from None


class CarryProfiles(NamedTuple):
    """Profiles of the base while the object is held.

    Attributes:
        lift: from the table to the lift height.
        move: from there to above the goal.
        place: from there back to the table.
    """

    lift: MotionProfile
    move: MotionProfile
    place: MotionProfile

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `lift`, `move` and `place`."""
        return {name: profile.to_dict() for name, profile in self._asdict().items()}

    @classmethod
    def from_dict(cls, record: object, field: str = "profiles") -> CarryProfiles:
        """Read profiles from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=cls._fields)
        return cls(*(MotionProfile.from_dict(values[name], f"{field}.{name}") for name in cls._fields))
