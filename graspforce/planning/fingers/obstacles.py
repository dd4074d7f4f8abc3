"""Distances that the tips of fingers that move alone keep from one another and from obstacles, as equations."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.hand.hand import Hand
from graspforce.planning.nlp.equations import Equations, make_equations
from graspforce.planning.nlp.outside import outside_level
from graspforce.planning.nlp.symbolic_finger import symbolic_finger


def obstacle_parameters(obstacle: Obstacle) -> Array:
    """Return an obstacle's pose and half sizes, the last parameters of `obstacle_equations`.

    Args:
        obstacle: the obstacle.
    """
    return np.concatenate([obstacle.p_HO, obstacle.R_HO.ravel(), _half_sizes(obstacle.shape)])


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
    g = outside_level(kind, x, sizes, least)
    return make_equations("outside", y, ca.vertcat(joint, least, p, R, sizes), g)
