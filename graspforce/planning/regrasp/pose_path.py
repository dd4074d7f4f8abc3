"""Path of an object through poses, with its motions from rest to rest along parts of the path."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import make_unchecked, set_fields
from graspforce.geometry.rotations import rotation_exp, rotation_log

LENGTH_PER_RADIAN = 0.03  # m: the displacement that counts as much as a turn of one radian
MAX_DISTANCE = 10.0  # m, of one leg: far beyond the reach of any hand
_MAX_TURN = math.radians(170.0)  # of one leg: the axis of a half turn is not unique


@dataclass(frozen=True, eq=False, slots=True)
class PosePath:
    """A path through poses: between two of them O moves on a straight line and the object turns about one axis.

    The path parameter u counts radians of turn, or displacement divided by `LENGTH_PER_RADIAN`, whichever is larger in a leg.

    Args:
        p_HO: (M, 3) positions of O in H, m, M ≥ 2; at most `MAX_DISTANCE` from each to the next.
        R_HO: (M, 3, 3) axes of the object in H; less than 170° from each to the next.

    Attributes:
        turns: (M − 1, 3) rotation vectors of the legs in H, rad.
        knots: (M,) values of u at the poses; the first is zero.

    Raises:
        InvalidInput: a wrong shape, no rotation, too long a leg, too large a turn, or two equal poses in succession.
    """

    p_HO: Array
    R_HO: Array
    turns: Array = field(init=False)
    knots: Array = field(init=False)

    def __post_init__(self) -> None:
        p_HO = arrays.check_array(self.p_HO, "p_HO", (None, 3))
        R_HO = arrays.check_rotations(self.R_HO, "R_HO", len(p_HO))
        if len(p_HO) < 2:
            raise InvalidInput("p_HO", p_HO, "at least two poses")
        turns = np.array([rotation_log(after @ before.T) for before, after in pairwise(R_HO)])  # rad, in H
        with np.errstate(over="ignore"):
            distances = np.linalg.norm(np.diff(p_HO, axis=0), axis=1)  # m
        for k, (distance, turn) in enumerate(zip(distances, turns, strict=True)):
            if np.linalg.norm(turn) > _MAX_TURN:
                raise InvalidInput(f"R_HO[{k + 1}]", R_HO[k + 1], "less than 170° from the pose before")
            if distance > MAX_DISTANCE:
                raise InvalidInput(f"p_HO[{k + 1}]", p_HO[k + 1], f"at most {MAX_DISTANCE:g} m from the pose before")
            if distance == 0.0 and not turn.any():
                raise InvalidInput(f"p_HO[{k + 1}]", p_HO[k + 1], "a pose that differs from the one before")
        lengths = np.maximum(np.linalg.norm(turns, axis=1), distances / LENGTH_PER_RADIAN)
        knots = np.concatenate([[0.0], np.cumsum(lengths)])
        set_fields(self, p_HO=p_HO, R_HO=R_HO, turns=freeze(turns), knots=freeze(knots))

    @classmethod
    def turn(cls, p_HO: npt.ArrayLike, R_HO: npt.ArrayLike, axis_H: npt.ArrayLike, angle: float) -> PosePath:
        """Return a turn about an axis through O, of any angle.

        Args:
            p_HO: (3,) position of O in H, m.
            R_HO: (3, 3) axes of the object in H at the start.
            axis_H: (3,) axis in H, of any length but zero.
            angle: rad, not zero; its sign is the sense about the axis.

        Raises:
            InvalidInput: a value out of range.
        """
        p, R = arrays.check_array(p_HO, "p_HO", (3,)), arrays.check_rotation(R_HO, "R_HO")
        axis = arrays.check_array(axis_H, "axis_H", (3,))
        if not axis.any():
            raise InvalidInput("axis_H", axis_H, "a direction: not zero")
        angle = arrays.check_number(angle, "angle")
        if angle == 0.0:
            raise InvalidInput("angle", angle, "not zero")
        legs = math.ceil(abs(angle) / (math.pi / 2.0) - 1e-9)
        angles = np.linspace(0.0, angle, legs + 1)
        turns = [rotation_exp(each * axis / np.linalg.norm(axis)) @ R for each in angles]
        return cls(freeze(np.tile(p, (legs + 1, 1))), freeze(np.array(turns)))

    @property
    def length(self) -> float:
        """The value of u at the end."""
        return float(self.knots[-1])

    def motion(self, u: float, rate: float = 0.0, acceleration: float = 0.0) -> BodyMotion:
        """Return pose, twist and acceleration of the object in H.

        Args:
            u: path parameter, between 0 and `length`.
            rate: du/dt, 1/s.
            acceleration: d²u/dt², 1/s².
        """
        knots = self.knots
        k = min(max(bisect_right(knots.tolist(), u) - 1, 0), len(knots) - 2)
        length = knots[k + 1] - knots[k]
        share = (u - knots[k]) / length
        slope = np.concatenate([self.p_HO[k + 1] - self.p_HO[k], self.turns[k]]) / length  # m and rad, per u
        R = rotation_exp(share * length * slope[3:]) @ self.R_HO[k]
        p = self.p_HO[k] + share * length * slope[:3]
        return make_unchecked(BodyMotion, p_HO=p, R_HO=R, twist=rate * slope, acceleration=acceleration * slope)

    def next_knot(self, u: float) -> float:
        """Return the first knot after u, or the end.

        Args:
            u: path parameter.
        """
        later = self.knots[self.knots > u + 1e-9]
        return float(later[0]) if len(later) else self.length
