"""The scene of a hand alone: with a ball in its grasp, which pictures leave out, because scenes need an object."""

from __future__ import annotations

from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.simulation import build_scene
from graspforce.simulation.plants.scene import Scene

_BALL, _MASS = 0.03, 0.05  # m, kg


def hand_scene(hand: Hand) -> Scene:
    """Return the scene of a hand.

    Args:
        hand: the hand.

    Raises:
        InvalidInput: no grasp of the ball is found.
        ModelError: MuJoCo cannot build the hand.
    """
    return build_scene(find_grasp(hand, Body.solid(Sphere(_BALL), _MASS), gravity_H=GRAVITY_PALM_UP))
