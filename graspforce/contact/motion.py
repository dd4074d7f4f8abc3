"""Motions of the two bodies that touch: the held object, and the fingertips."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import make_unchecked, set_fields
from graspforce.geometry.poses import pose_from_dict, pose_to_dict


@dataclass(frozen=True, eq=False, slots=True)
class BodyMotion:
    """Where an object is and how it moves, seen from the hand's base H.

    Args:
        p_HO: (3,) its origin in H, m.
        R_HO: (3, 3) its axes in H, columns.
        twist: (6,) the velocity of its origin, m/s, and its angular velocity, rad/s, both in H's axes; at rest by default.
        acceleration: (6,) the time derivatives of both, m/s² and rad/s²; zeros by default.

    Raises:
        InvalidInput: not finite, another shape, or R_HO not a rotation.
    """

    p_HO: Array
    R_HO: Array
    twist: Array = field(default_factory=lambda: freeze(np.zeros(6)))
    acceleration: Array = field(default_factory=lambda: freeze(np.zeros(6)))

    def __post_init__(self) -> None:
        set_fields(
            self,
            p_HO=arrays.check_array(self.p_HO, "p_HO", (3,)),
            R_HO=arrays.check_rotation(self.R_HO, "R_HO"),
            twist=arrays.check_array(self.twist, "twist", (6,)),
            acceleration=arrays.check_array(self.acceleration, "acceleration", (6,)),
        )

    @classmethod
    def from_dict(
        cls, record: object, field: str = "motion", optional: Collection[str] = ("twist", "acceleration")
    ) -> BodyMotion:
        """Return the motion of a record: a pose, with `twist` and `acceleration`, zeros by default.

        Args:
            record: mapping with `position` (m), `rotation` or `quaternion`, and optional fields.
            field: path of the record, for errors.
            optional: names of the optional fields that the record may have. The caller reads those besides `twist` and
                `acceleration`.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        p_HO, R_HO, values = pose_from_dict(record, field, optional)
        rates = {
            name: arrays.check_array(values[name], f"{field}.{name}", (6,))
            for name in ("twist", "acceleration")
            if values.get(name) is not None
        }
        return cls(p_HO, R_HO, **rates)

    def to_dict(self) -> JsonRecord:
        """Return the record of the motion."""
        rates = {"twist": self.twist.tolist(), "acceleration": self.acceleration.tolist()}
        return {**pose_to_dict(self.p_HO, self.R_HO), **rates}

    def with_acceleration(self, acceleration: npt.ArrayLike) -> BodyMotion:
        """Return the motion with another acceleration. Pose and twist are not checked again.

        Args:
            acceleration: (6,) m/s² and rad/s², in H.

        Raises:
            InvalidInput: not six finite numbers.
        """
        checked = arrays.check_array(acceleration, "acceleration", (6,))
        return make_unchecked(BodyMotion, p_HO=self.p_HO, R_HO=self.R_HO, twist=self.twist, acceleration=checked)


@dataclass(frozen=True, eq=False, slots=True)
class TipMotion:
    """Some fingertips at one instant, each at its tip frame's origin, in H's axes, linear before angular.

    twist = J v, and its rate J v̇ + drift.

    Attributes:
        p_HF: (N, 3) origins of the tip frames in H, m.
        R_HF: (N, 3, 3) their axes in H, columns.
        rates: (N, 6, n + 2) J, twist and drift side by side, as they are taken to the contacts.
    """

    p_HF: Array
    R_HF: Array
    rates: Array

    @property
    def J(self) -> Array:
        """(N, 6, n) the tips' twists for each unit actuated rate, m/rad and 1."""
        return self.rates[:, :, :-2]

    @property
    def twist(self) -> Array:
        """(N, 6) velocities, m/s, and angular velocities, rad/s."""
        return self.rates[:, :, -2]

    @property
    def drift(self) -> Array:
        """(N, 6) J̇ v: their accelerations, m/s² and rad/s², where no joint accelerates."""
        return self.rates[:, :, -1]
