"""Distances of all pairs of links by Pinocchio's own reader of a URDF and its shapes: a second opinion on collisions."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from graspforce.hand.descriptions.description import robot_data_folders
from graspforce.hand.hand import Hand


def least_link_distance(hand: Hand, q: np.ndarray) -> tuple[float, str]:
    """Return the least distance of two links that may not touch, m, and their shapes' names.

    Links may touch if a joint connects them, or a chain of joints with links without shapes in between; and a link and an
    ancestor may if they overlap in the neutral posture.
    """
    text, packages = hand.urdf_path.read_text(), [str(folder.parent) for folder in robot_data_folders()]
    model = pin.buildModelFromXML(text)
    shapes = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION, package_dirs=packages)
    carriers = [each.parentJoint for each in shapes.geometryObjects]
    above = {joint: _carrier_above(model, joint, set(carriers)) for joint in set(carriers)}
    for i, a in enumerate(carriers):
        for j, b in enumerate(carriers[:i]):
            if a != b and above[a] != b and above[b] != a:
                shapes.addCollisionPair(pin.CollisionPair(j, i))
    data, placed = model.createData(), shapes.createData()
    pin.computeDistances(model, data, shapes, placed, hand.T @ hand.neutral + hand.q0)
    for index, pair in reversed(list(enumerate(shapes.collisionPairs))):
        a, b = carriers[pair.first], carriers[pair.second]
        is_chain = a in list(model.supports[b]) or b in list(model.supports[a])
        if is_chain and placed.distanceResults[index].min_distance < 0.0:
            shapes.removeCollisionPair(pin.CollisionPair(pair.first, pair.second))
    placed = shapes.createData()
    pin.computeDistances(model, data, shapes, placed, hand.T @ q + hand.q0)
    distances = [result.min_distance for result in placed.distanceResults]
    pair = shapes.collisionPairs[int(np.argmin(distances))]
    names = " and ".join(shapes.geometryObjects[index].name for index in (pair.first, pair.second))
    return float(min(distances)), names


def _carrier_above(model: pin.Model, joint: int, carriers: set[int]) -> int:
    """Return the nearest ancestor of a joint whose link has shapes, or the base; -1 above the base."""
    if joint == 0:
        return -1
    joint = model.parents[joint]
    while joint > 0 and joint not in carriers:
        joint = model.parents[joint]
    return int(joint)
