"""Motions of the two bodies in contact: the held object (`BodyMotion`) and the fingertips (`TipMotion`)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import Block, native, new_block
from graspforce.core.constants import LARGEST_MOTION
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields, unchecked_constructor
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.geometry.rotations import rotation_exp


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
            record: mapping with `position` (m), `rotation` or `quaternion`, and optional fields. Positions are at most 1e3 m,
                other numbers at most 1e6.
            field: path of the record, for error messages.
            optional: names of the optional fields that the record may have. The caller reads those besides `twist` and
                `acceleration`.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        p_HO, R_HO, values = pose_from_dict(record, field, optional)
        rates = {
            name: arrays.check_array(values[name], f"{field}.{name}", (6,), limit=LARGEST_MOTION)
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
        return _make_body_motion(self.p_HO, self.R_HO, self.twist, checked)

    def of_fixed_frame(self, p_OP: Array, R_OP: Array) -> BodyMotion:
        """Return the motion of a frame P that is fixed in the object: T_HP = T_HO T_OP.

        Args:
            p_OP: (3,) position of P in O, m. Not checked.
            R_OP: (3, 3) axes of P in O. Not checked.
        """
        if native is None:
            return fixed_frame_motion_reference(self, p_OP, R_OP)
        block = new_block(_motion_dtype())
        native.fixed_frame_motion(
            p_HO=self.p_HO,
            R_HO=self.R_HO,
            twist=self.twist,
            acceleration=self.acceleration,
            p_OP=p_OP,
            R_OP=R_OP,
            motion=block,
        )
        return _from_block(block)

    def of_parent_frame(self, p_PO: Array, R_PO: Array, duration: float = 0.0) -> BodyMotion:
        """Return the motion after a short time of a frame P in which the object is fixed: T_HP = T_HO T_PO⁻¹.

        Args:
            p_PO: (3,) position of the object in P, m. Not checked.
            R_PO: (3, 3) axes of the object in P. Not checked.
            duration: the time, with constant acceleration as in `after`, s. Not checked.
        """
        if native is None:
            return self.after(duration).of_fixed_frame(-(p_PO @ R_PO), R_PO.T)
        block = new_block(_motion_dtype())
        native.parent_frame_motion(
            p_HO=self.p_HO,
            R_HO=self.R_HO,
            twist=self.twist,
            acceleration=self.acceleration,
            duration=duration,
            p_PO=p_PO,
            R_PO=R_PO,
            motion=block,
        )
        return _from_block(block)

    def after(self, duration: float) -> BodyMotion:
        """Return the motion after a short time, with constant acceleration: p + v t + a t²/2 and exp(ω t + α t²/2) R.

        Args:
            duration: t, s. Not checked.
        """
        if native is None:
            return motion_after_reference(self, duration)
        block = new_block(_motion_dtype())
        native.motion_after(
            p_HO=self.p_HO,
            R_HO=self.R_HO,
            twist=self.twist,
            acceleration=self.acceleration,
            duration=duration,
            motion=block,
        )
        return _from_block(block)


_make_body_motion = unchecked_constructor(BodyMotion)


@cache
def _motion_dtype() -> np.dtype[np.void]:
    """Return the layout of a motion that the C code writes."""
    dtype: np.dtype[np.void] = np.dtype(native.body_motion_layout())
    return dtype


def _from_block(block: Block) -> BodyMotion:
    """Return the motion that the C code wrote to a block."""
    block.setflags(write=False)
    return _make_body_motion(block["p_HO"], block["R_HO"], block["twist"], block["acceleration"])


def fixed_frame_motion_reference(body: BodyMotion, p_OP: Array, R_OP: Array) -> BodyMotion:
    """Return the same as `BodyMotion.of_fixed_frame`, in NumPy.

    Args:
        body: motion of the body.
        p_OP: (3,) position of P in O, m.
        R_OP: (3, 3) axes of P in O.
    """
    lever = body.R_HO @ p_OP  # m, in H
    rates = _rates_at(lever.tolist(), body.twist.tolist(), body.acceleration.tolist())
    return _make_body_motion(freeze(body.p_HO + lever), freeze(body.R_HO @ R_OP), *rates)


def motion_after_reference(body: BodyMotion, duration: float) -> BodyMotion:
    """Return the same as `BodyMotion.after`, in NumPy.

    Args:
        body: motion of the body.
        duration: t, s.
    """
    way = duration * body.twist + 0.5 * duration**2 * body.acceleration  # m and rad, in H
    p, R = body.p_HO + way[:3], rotation_exp(way[3:]) @ body.R_HO
    return _make_body_motion(freeze(p), freeze(R), freeze(body.twist + duration * body.acceleration), body.acceleration)


def _rates_at(lever: list[float], twist: list[float], acceleration: list[float]) -> tuple[Array, Array]:
    """Return twist and acceleration of a body with another reference point: v + ω × l and v̇ + α × l + ω × (ω × l).

    Args:
        lever: from the old to the new reference point, m.
        twist: at the old reference point, m/s and rad/s.
        acceleration: at the old reference point, m/s² and rad/s².
    """
    x, y, z = lever
    vx, vy, vz, wx, wy, wz = twist
    ax, ay, az, bx, by, bz = acceleration
    ux, uy, uz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x  # m/s: ω × l
    ax += by * z - bz * y + wy * uz - wz * uy
    ay += bz * x - bx * z + wz * ux - wx * uz
    az += bx * y - by * x + wx * uy - wy * ux
    return freeze([vx + ux, vy + uy, vz + uz, wx, wy, wz]), freeze([ax, ay, az, bx, by, bz])


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
