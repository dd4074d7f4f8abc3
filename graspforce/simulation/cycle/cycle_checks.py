"""Checks of objects and grasps before a cycle: the width of the object, and forces that hold its weight.

The distance of two fingertips is at most the sum of the link lengths between them. Contacts that hold a ball, a cylinder or a
box with μ ≤ 0.7 oppose each other: their distance is at least 0.75 of the least width. A wider object cannot be held.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.settings import ControlSettings
from graspforce.control.state import GraspState
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Tip

_LARGEST_FRICTION = 0.7  # coefficient: with more, three contacts at the corner of a box hold it
_OPPOSITE_SHARE = 0.75  # of the least width: least distance of contacts that oppose each other


def check_size(hand: Hand, body: Body, friction: float) -> None:
    """Check that the fingertips of a hand can be on opposite sides of an object.

    Args:
        hand: the hand.
        body: the object. Only balls, cylinders and boxes are checked.
        friction: coefficient of friction; objects with more than 0.7 are not checked.

    Raises:
        InvalidInput: the object is too wide; gives its least width and the largest distance of two fingertips.
    """
    width = _least_width(body)
    if width is None or friction > _LARGEST_FRICTION:
        return
    distance = largest_tip_distance(hand)
    if _OPPOSITE_SHARE * width > distance:
        name = type(body.shape).__name__
        raise InvalidInput(
            "body",
            f"{name}, {1e3 * width:.0f} mm wide or more in every direction",
            f"an object that {hand.name} can grasp: its fingertips are {1e3 * distance:.0f} mm apart at most",
        )


def check_weight(grasp: Grasp, control: ControlSettings) -> None:
    """Check that the controller's forces hold the heaviest object at rest with the least friction that it assumes.

    The controller then keeps at least a slip margin of zero for all assumed errors of friction, contact normals and mass.
    Without such forces it would count on all the modelled friction.

    Args:
        grasp: the grasp.
        control: settings of the object controller, with gravity and assumed errors.

    Raises:
        InvalidInput: no forces within the limits of motors and contacts hold this weight with this friction.
    """
    heavy, body = 1.0 + control.mass_error, grasp.body
    heaviest = replace(body, mass=heavy * body.mass, inertia=heavy * body.inertia)
    law, at_rest = ObjectControlLaw(replace(grasp, body=heaviest), control), BodyMotion(grasp.p_HO, grasp.R_HO)
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), at_rest)
    targets = law.compute_targets(law.initial_memory(), state, at_rest, None)
    result = law.force_solver.solve(targets, grasp.hand.gravity_torque(grasp.q, control.gravity_H), margin=0.0)
    if result.f is None or result.warning:
        least = float(law.force_solver.least[0].min()) * (1.0 - control.friction_reserve)
        raise InvalidInput(
            "grasp",
            f"contacts that do not hold the weight of {heaviest.mass:.3g} kg with μ = {least:.2g}",
            "one that holds the heaviest object with the least friction",
        )


def largest_tip_distance(hand: Hand) -> float:
    """Return an upper bound of the distance between the surfaces' far sides of any two fingertips, m.

    Args:
        hand: the hand.
    """
    tree = hand.tree()
    return max((_pair_distance(tree, *pair) for pair in itertools.combinations(tree.tips, 2)), default=0.0)


def _least_width(body: Body) -> float | None:
    """Return the least width of a ball, a cylinder or a box, m; None for other shapes."""
    shape = body.shape
    if isinstance(shape, Sphere):
        return 2.0 * shape.radius
    if isinstance(shape, Cylinder):
        return min(2.0 * shape.radius, shape.height)
    return float(np.min(shape.edges)) if isinstance(shape, Box) else None


def _pair_distance(tree: KinematicTree, first: Tip, second: Tip) -> float:
    """Return the length of the way between two fingertips along the links, m.

    The origins of the first links that differ are at constant places on the link before, so their distance counts as it is.
    """
    chains = [_chain(tree, tip) for tip in (first, second)]
    shared = 0
    while shared < min(map(len, chains)) and chains[0][shared] == chains[1][shared]:
        shared += 1
    length, starts = 0.0, []
    for tip, chain in zip((first, second), chains, strict=True):
        own = chain[shared:]
        points = [tree.links[i].p_PL for i in own] + [tip.p_LF]
        starts.append(points[0])
        length += sum(float(np.linalg.norm(p)) for p in points[1:]) + (tip.radius or 0.0)
        length += sum(max(abs(tree.links[i].lower), abs(tree.links[i].upper)) for i in own if tree.links[i].is_prismatic)
    return length + float(np.linalg.norm(starts[0] - starts[1]))


def _chain(tree: KinematicTree, tip: Tip) -> list[int]:
    """Return the links from the base to a fingertip."""
    chain, link = [], tip.link
    while link >= 0:
        chain.append(link)
        link = tree.links[link].parent
    return chain[::-1]
