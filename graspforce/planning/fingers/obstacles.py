"""What fingertips must keep away from when they move without an object, and how far they are from it.

A ball is kept out by its squared distance. A box and a cylinder are kept out, grown by the tip's radius, by

    log Σ exp(κ excess_i)/κ ≥ 0,    excess_i how far beyond each pair of faces the tip's middle is:

smooth where the largest of the excesses is not, equal to it next to a face, and above it only where edges of the grown box
stick out further than a round tip would reach.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.hand.hand import Hand
from graspforce.planning.nlp.equations import Equations, equations
from graspforce.planning.nlp.symbolic_finger import symbolic_finger

_SHARPNESS = 5.0  # κ times the distance that is kept: how sharp edges are
_ABS_SMOOTHING = 1e-4  # of the distance that is kept: |x| is taken as √(x² + this²) − this


@dataclass(frozen=True, eq=False, slots=True)
class Obstacle:
    """A sphere, cylinder or box that stands still.

    Args:
        shape: its surface, in its own frame O.
        p_HO: (3,) where that stands in H, m.
        R_HO: (3, 3) its axes in H; H's by default.

    Raises:
        InvalidInput: another shape.
    """

    shape: Solid
    p_HO: Array
    R_HO: Array = field(default_factory=lambda: arrays.freeze(np.eye(3)))

    def __post_init__(self) -> None:
        if not isinstance(self.shape, Sphere | Cylinder | Box):
            raise InvalidInput("shape", type(self.shape).__name__, "a Sphere, a Cylinder or a Box")
        object.__setattr__(self, "p_HO", arrays.check_array(self.p_HO, "p_HO", (3,)))
        object.__setattr__(self, "R_HO", arrays.check_rotation(self.R_HO, "R_HO"))

    def distance(self, p: Array) -> Array:
        """(M,) from points p (M, 3) in H, m; negative inside."""
        return np.asarray(self.shape.phi((p - self.p_HO) @ self.R_HO))

    @property
    def numbers(self) -> Array:
        """Its pose and half sizes, as `obstacle_equations` takes them."""
        shape = self.shape
        if isinstance(shape, Sphere):
            sizes = [shape.radius]
        elif isinstance(shape, Cylinder):
            sizes = [shape.radius, shape.height / 2.0]
        else:
            assert isinstance(shape, Box)  # checked at the door
            sizes = (shape.edges / 2.0).tolist()
        return np.concatenate([self.p_HO, self.R_HO.ravel(), sizes])


@lru_cache(maxsize=64)
def tip_distance_equations(hand: Hand, one: str, other: str) -> Equations:
    """Two tips' squared distance over the least one's, ≥ 1. Variables: y of both. Numbers: y's unit, the least distance."""
    joint, least = ca.SX.sym("joint"), ca.SX.sym("least")
    models = [symbolic_finger(hand, name, hand.neutral) for name in (one, other)]
    variables = [ca.SX.sym(f"y{i}", len(model.joints)) for i, model in enumerate(models)]
    offset = models[0].tip(joint * variables[0]) - models[1].tip(joint * variables[1])
    return equations("apart", ca.vertcat(*variables), ca.vertcat(joint, least), ca.dot(offset, offset) / least**2)


@lru_cache(maxsize=64)
def obstacle_equations(hand: Hand, finger: str, kind: type[Solid]) -> Equations:
    """A tip outside a shape: ≥ 1. Variables: y. Numbers: the unit of y, the least distance, the obstacle's own."""
    joint, least = ca.SX.sym("joint"), ca.SX.sym("least")
    p, R = ca.SX.sym("p", 3), ca.SX.sym("R", 9)
    sizes = ca.SX.sym("sizes", {Sphere: 1, Cylinder: 2, Box: 3}[kind])
    model = symbolic_finger(hand, finger, hand.neutral)
    y = ca.SX.sym("y", len(model.joints))
    x = ca.reshape(R, 3, 3) @ (model.tip(joint * y) - p)  # the numbers are R by rows, so this is Rᵀ
    if kind is Sphere:
        g = ca.dot(x, x) / (sizes + least) ** 2
    else:
        blunt = _ABS_SMOOTHING * least
        away = [x[0], x[1], x[2]] if kind is Box else [ca.sqrt(x[0] ** 2 + x[1] ** 2 + blunt**2), x[2]]
        excess = ca.vertcat(*(ca.sqrt(each**2 + blunt**2) - blunt for each in away)) - sizes - least
        g = 1.0 + ca.logsumexp(_SHARPNESS * excess / least) / _SHARPNESS
    return equations("outside", y, ca.vertcat(joint, least, p, R, sizes), g)
