"""Parse options of the bodies around a hand: obstacles, a table under the object, and the distance to keep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.cli.options import parse_object, parse_vector
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric, TriangleMesh
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.grasp.grasp import Grasp

_FORM = "SHAPE@X,Y,Z or SHAPE@X,Y,Z,RX,RY,RZ with SHAPE sphere:RADIUS, cylinder:RADIUS,HEIGHT or box:X,Y,Z (m, rad)"
_TABLE = (1.0, 1.0, 0.02)  # m: edges of the plate


def parse_obstacle(text: str) -> Obstacle:
    """Return the obstacle of an option such as box:0.1,0.1,0.02@0,0,-0.05.

    Args:
        text: a sphere, cylinder or box with its position in H, m, and optionally its rotation vector in H, rad.

    Raises:
        InvalidInput: another form, or values that are not allowed.
    """
    shape, separator, pose = text.partition("@")
    if not separator or shape.partition(":")[0] not in ("sphere", "cylinder", "box"):
        raise InvalidInput("obstacle", text, _FORM)
    numbers = parse_vector(pose, "obstacle", 6 if pose.count(",") > 2 else 3)
    try:
        body, _ = parse_object(shape, None, None)
    except InvalidInput as error:
        raise error.with_field("obstacle") from None
    R_HO = Rotation.from_rotvec(numbers[3:] or np.zeros(3)).as_matrix()
    if not isinstance(body.shape, Solid):
        raise InvalidInput("obstacle", text, _FORM)
    return Obstacle(body.shape, numbers[:3], R_HO)


def parse_table(text: str | None) -> Array | None:
    """Return the unit vector of an option such as 0,0,1, the direction in O away from a table; None without one.

    Args:
        text: three numbers separated by commas; None for no table.

    Raises:
        InvalidInput: not three numbers, or all zero.
    """
    if text is None:
        return None
    up_O = arrays.check_array(parse_vector(text, "table"), "table", (3,))
    if not up_O.any():
        raise InvalidInput("table", text, "a direction: not zero")
    return np.asarray(up_O / np.linalg.norm(up_O))


def table_under(grasp: Grasp, up_O: Array) -> Obstacle:
    """Return the plate of 1 m by 1 m on which the object of a grasp stands.

    Args:
        grasp: the grasp.
        up_O: (3,) unit vector in O away from the table.
    """
    shape = grasp.body.shape
    if not isinstance(shape, Solid):
        raise InvalidInput("table", "an object without a solid shape", "a solid that can stand on a table")
    down = -grasp.R_HO @ up_O
    centre = grasp.p_HO + (support(shape, -up_O) + 0.5 * _TABLE[2]) * down
    x = np.cross(down, [1.0, 0.0, 0.0] if abs(down[0]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return Obstacle(Box(_TABLE), centre, np.stack([x, np.cross(down, x), down], axis=1))


def support(shape: Solid, direction: Array) -> float:
    """Return the largest distance of a solid's points from O along a direction, m.

    Args:
        shape: the solid.
        direction: (3,) unit vector in O.
    """
    if isinstance(shape, Sphere):
        return shape.radius
    if isinstance(shape, Cylinder):
        return shape.radius * float(np.hypot(*direction[:2])) + 0.5 * shape.height * abs(float(direction[2]))
    if isinstance(shape, Box):
        return 0.5 * float(np.abs(direction) @ shape.edges)
    if isinstance(shape, Superquadric):  # nested p-norms with p = 2/ε: the dual ones have q = 2/(2 − ε)
        e1, e2 = (np.inf if e == 2.0 else 2.0 / (2.0 - e) for e in shape.exponents.tolist())
        x, y, z = direction * shape.axes
        return float(np.linalg.norm([np.linalg.norm([x, y], ord=e2), z], ord=e1))
    if isinstance(shape, TriangleMesh):
        return float((shape.vertices @ direction).max())
    raise InvalidInput("table", type(shape).__name__, "a sphere, cylinder, box, superquadric or mesh")


def collision_settings(margin: float, obstacles: Sequence[str]) -> CollisionSettings:
    """Return the settings of two options.

    Args:
        margin: least distance of links, object and obstacles, m.
        obstacles: obstacles, as for `parse_obstacle`.

    Raises:
        InvalidInput: a value out of range.
    """
    margin = arrays.check_number(margin, "clearance", minimum=0.0)
    return CollisionSettings(margin, [parse_obstacle(text) for text in obstacles])
