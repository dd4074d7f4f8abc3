"""Obstacles of fingers that move alone, and the distances that their tips keep, as equations.

The distance from a sphere is kept as a squared distance. A box or cylinder is enlarged by the tip's radius and kept out by

    log Σ exp(κ eᵢ)/κ ≥ 0,    eᵢ the distance of the tip's centre beyond each pair of faces

This is smooth where the largest of the eᵢ is not. It equals that one next to a face, and exceeds it only near edges, where
the enlarged box extends beyond the true clearance of a round tip.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.core.records import set_fields
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.hand.hand import Hand
from graspforce.planning.nlp.equations import Equations, make_equations
from graspforce.planning.nlp.symbolic_finger import symbolic_finger

_SHARPNESS = 5.0  # κ times the clearance
_ABS_SMOOTHING = 1e-4  # ε of |x| ≈ √(x² + ε²) − ε, relative to the clearance


@dataclass(frozen=True, eq=False, slots=True)
class Obstacle:
    """A sphere, cylinder or box at rest.

    Args:
        shape: its surface, in its own frame O.
        p_HO: (3,) position in H, m.
        R_HO: (3, 3) orientation in H; the identity by default.

    Raises:
        InvalidInput: another shape, or a value out of range.
    """

    shape: Solid
    p_HO: Array
    R_HO: Array = field(default_factory=lambda: arrays.freeze(np.eye(3)))

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            shape: Solid,
            p_HO: npt.ArrayLike,
            R_HO: npt.ArrayLike = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        if not isinstance(self.shape, Sphere | Cylinder | Box):
            raise InvalidInput("shape", type(self.shape).__name__, "a Sphere, a Cylinder or a Box")
        p_HO, R_HO = arrays.check_array(self.p_HO, "p_HO", (3,)), arrays.check_rotation(self.R_HO, "R_HO")
        set_fields(self, p_HO=p_HO, R_HO=R_HO)

    @classmethod
    def from_dict(cls, record: object, field: str = "obstacle") -> Obstacle:
        """Return the obstacle of a record.

        Args:
            record: mapping with `shape` and the pose in H.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        p_HO, R_HO, values = pose_from_dict(record, field, ("shape",))
        if "shape" not in values:
            raise MissingField(f"{field}.shape")
        try:
            return cls(Solid.from_dict(values["shape"], "shape"), p_HO, R_HO)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> dict[str, object]:
        """Return the record of the obstacle."""
        return {"shape": self.shape.to_dict(), **pose_to_dict(self.p_HO, self.R_HO)}

    def distance(self, p_H: Array) -> Array:
        """Return the distances (M,) of points from the surface, m; negative inside.

        Args:
            p_H: (M, 3) points in H, m.
        """
        return np.asarray(self.shape.phi((p_H - self.p_HO) @ self.R_HO))

    @property
    def parameter_values(self) -> Array:
        """Return its pose and half sizes, the last parameters of `obstacle_equations`."""
        return np.concatenate([self.p_HO, self.R_HO.ravel(), _half_sizes(self.shape)])


def _half_sizes(shape: Solid) -> Array:
    """Return the radius of a sphere, radius and half height of a cylinder, or half edges of a box, m."""
    if isinstance(shape, Sphere):
        return np.array([shape.radius])
    if isinstance(shape, Cylinder):
        return np.array([shape.radius, shape.height / 2.0])
    if isinstance(shape, Box):
        return shape.edges / 2.0
    raise InvalidInput("shape", type(shape).__name__, "a Sphere, a Cylinder or a Box")


@lru_cache(maxsize=64)
def tip_distance_equations(hand: Hand, one: str, other: str) -> Equations:
    """Return the squared distance of two tips relative to its least value; ≥ 1 if they keep it.

    Variables: y of both fingers. Parameters: the scale of y, the least distance.

    Args:
        hand: the hand.
        one: one finger.
        other: the other finger.
    """
    joint, least = ca.SX.sym("joint"), ca.SX.sym("least")
    models = [symbolic_finger(hand, name, hand.neutral) for name in (one, other)]
    variables = [ca.SX.sym(f"y{i}", len(model.joints)) for i, model in enumerate(models)]
    offset = models[0].tip(joint * variables[0]) - models[1].tip(joint * variables[1])
    return make_equations("tip_distance", ca.vertcat(*variables), ca.vertcat(joint, least), ca.dot(offset, offset) / least**2)


@lru_cache(maxsize=64)
def obstacle_equations(hand: Hand, finger: str, kind: type[Solid]) -> Equations:
    """Return the equation of a tip that stays outside an obstacle; ≥ 1 if it keeps its clearance.

    Variables: y of the finger. Parameters: the scale of y, the clearance from the tip's centre, and the obstacle's own.

    Args:
        hand: the hand.
        finger: the finger.
        kind: Sphere, Cylinder or Box.
    """
    joint, least = ca.SX.sym("joint"), ca.SX.sym("least")
    p, R = ca.SX.sym("p", 3), ca.SX.sym("R", 9)
    sizes = ca.SX.sym("sizes", {Sphere: 1, Cylinder: 2, Box: 3}[kind])
    model = symbolic_finger(hand, finger, hand.neutral)
    y = ca.SX.sym("y", len(model.joints))
    x = ca.reshape(R, 3, 3) @ (model.tip(joint * y) - p)  # R is given by rows and reshaped by columns: this is Rᵀ
    if kind is Sphere:
        g = ca.dot(x, x) / (sizes + least) ** 2
    else:
        epsilon = _ABS_SMOOTHING * least
        distances = [x[0], x[1], x[2]] if kind is Box else [ca.sqrt(x[0] ** 2 + x[1] ** 2 + epsilon**2), x[2]]
        excess = ca.vertcat(*(ca.sqrt(each**2 + epsilon**2) - epsilon for each in distances)) - sizes - least
        g = 1.0 + ca.logsumexp(_SHARPNESS * excess / least) / _SHARPNESS
    return make_equations("outside", y, ca.vertcat(joint, least, p, R, sizes), g)
