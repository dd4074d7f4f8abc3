"""Limits of the accelerations of object and joints, and of their rates, the jerk."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields

_NAMES = ("linear", "angular", "joints", "linear_jerk", "angular_jerk", "joint_jerk")
_LEAST = 1e-6  # m/s² or rad/s², and of the jerk in m/s³ or rad/s³: with less a move of a millimetre takes a minute


@dataclass(frozen=True, slots=True)
class AccelerationLimits:
    """Limits of accelerations and of their rates in a move; infinite ones do not limit.

        ‖p̈‖ ≤ linear,    ‖α‖ ≤ angular,    |q̈ⱼ| ≤ joints for each joint j

    and the same for the time derivatives of p̈, α and q̈. With a limit of jerk, a move starts and ends without acceleration.

    Args:
        linear: of the object's origin O in H, m/s².
        angular: of the object's rotation, rad/s².
        joints: of each joint, rad/s² (m/s² for a prismatic joint).
        linear_jerk: of the time derivative of p̈, m/s³.
        angular_jerk: of the time derivative of α in H, rad/s³.
        joint_jerk: of the time derivative of each q̈ⱼ, rad/s³ (m/s³ for a prismatic joint).

    Raises:
        InvalidInput: a limit below 1e-6, or not a number.
    """

    linear: float = float("inf")
    angular: float = float("inf")
    joints: float = float("inf")
    linear_jerk: float = float("inf")
    angular_jerk: float = float("inf")
    joint_jerk: float = float("inf")

    def __post_init__(self) -> None:
        for name in _NAMES:
            value = getattr(self, name)
            if value != float("inf"):
                set_fields(self, **{name: arrays.check_number(value, name, minimum=_LEAST)})

    @property
    def object_limits(self) -> tuple[float, float]:
        """Return the limits of the object, m/s² and rad/s²."""
        return self.linear, self.angular

    @property
    def object_jerks(self) -> tuple[float, float]:
        """Return the limits of the object's jerk, m/s³ and rad/s³."""
        return self.linear_jerk, self.angular_jerk

    @property
    def has_jerk(self) -> bool:
        """Whether a jerk is limited."""
        return min(*self.object_jerks, self.joint_jerk) < float("inf")

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> AccelerationLimits:
        """Return the limits of a record; those that are missing or null are infinite.

        Args:
            record: mapping that `to_dict` made.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=(), optional=_NAMES)
        try:
            return cls(**{name: value for name, value in values.items() if value is not None})
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the finite limits as a record for JSON."""
        return {name: getattr(self, name) for name in _NAMES if isfinite(getattr(self, name))}


UNLIMITED = AccelerationLimits()


def check_acceleration_limits(limits: object) -> None:
    """Raise an error unless a value is a record of limits.

    Args:
        limits: the value.

    Raises:
        InvalidInput: another type.
    """
    if not isinstance(limits, AccelerationLimits):
        raise InvalidInput("acceleration_limits", type(limits).__name__, "an AccelerationLimits")
