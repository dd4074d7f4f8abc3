"""Motions of the two bodies in contact: the held object (`BodyMotion`) and the fingertips (`TipMotion`)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import make_unchecked, set_fields
from graspforce.geometry.poses import pose_from_dict, pose_to_dict


@dataclass(frozen=True, eq=False, slots=True)
class BodyMotion:
    """Pose, twist and acceleration of an object in the hand's base frame H.

    Args:
        p_HO: (3,) position of the object's origin in H, m.
        R_HO: (3, 3) orientation: the object's axes in H as columns.
        twist: (6,) velocity of the origin, m/s, and angular velocity, rad/s, in H. Default: zeros.
        acceleration: (6,) time derivatives of both, m/s² and rad/s², in H. Default: zeros.

    Raises:
        InvalidInput: a value that is not finite, another shape, or R_HO that is not a rotation matrix.
    """

    p_HO: Array
    R_HO: Array
    twist: Array = field(default_factory=lambda: freeze(np.zeros(6)))
    acceleration: Array = field(default_factory=lambda: freeze(np.zeros(6)))

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike, twist: npt.ArrayLike = ..., acceleration: npt.ArrayLike = ...
        ) -> None: ...

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
            field: path of the record, for error messages.
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
    """Motion of N fingertips at one instant, at the origins of their tip frames, in H, linear before angular.

    The twists are J v, and their time derivatives J v̇ + drift.

    Attributes:
        p_HF: (N, 3) origins of the tip frames in H, m.
        R_HF: (N, 3, 3) axes of the tip frames in H, columns.
        rates: (N, 6, n + 2) J, twist and drift side by side, so that one product transforms all three.
    """

    p_HF: Array
    R_HF: Array
    rates: Array

    @property
    def J(self) -> Array:
        """(N, 6, n) Jacobians of the tips with respect to the actuated joints, m/rad and 1."""
        return self.rates[:, :, :-2]

    @property
    def twist(self) -> Array:
        """(N, 6) velocities, m/s, and angular velocities, rad/s."""
        return self.rates[:, :, -2]

    @property
    def drift(self) -> Array:
        """(N, 6) J̇ v: accelerations, m/s² and rad/s², at zero joint acceleration."""
        return self.rates[:, :, -1]
