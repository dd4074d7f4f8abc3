"""Rest of round objects on a table: the orientation in which the centre of mass is lowest.

With the vertical u in O, the height of the centre of mass of an object that touches the table is

    V(u) = u · p_OM + h(−u),    h(d) = max over the surface of d · p,

with the support function h. At rest V has a local minimum. A ball rolls until its centre of mass is below its centre. A box or
a cylinder on a flat face stays on it.
"""

from __future__ import annotations

import math

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Shape, Sphere, Superquadric
from graspforce.geometry.rotations import rotation_exp
from graspforce.geometry.vectors import table_axes

_PROBE = 0.02  # rad: a direction is stable if V is not lower this far beside it
_PROBES = 16  # directions beside it
_ROUNDING = 1e-9  # m, of V
_FIRST_STEP = 0.05  # rad, of the descent: small, so that it ends in the nearest minimum


def is_stable(shape: Superquadric, down: Array) -> bool:
    """Return whether a homogeneous superquadric rests with a direction down.

    Args:
        shape: the surface.
        down: (3,) unit vector in O.
    """
    least = _support(shape, down)
    first, second = table_axes(down)
    for angle in np.linspace(0.0, 2.0 * math.pi, _PROBES, endpoint=False):
        beside = math.cos(_PROBE) * down + math.sin(_PROBE) * (math.cos(angle) * first + math.sin(angle) * second)
        if _support(shape, beside) < least - _ROUNDING:
            return False
    return True


def resting_pose(shape: Shape | None, p_OM: Array, pose: tuple[Array, Array], down: Array) -> tuple[Array, Array]:
    """Return the pose of an object on a table after it has come to rest; balls and superquadrics roll, others stay.

    It rolls in place: its origin moves along the vertical only.

    Args:
        shape: surface of the object.
        p_OM: (3,) centre of mass in O, m.
        pose: p_HO (3,), m, and R_HO (3, 3) of the object on the table.
        down: (3,) unit vector along gravity, in H.
    """
    if not isinstance(shape, Sphere | Superquadric):
        return pose
    p_HO, R_HO = pose
    before = R_HO.T @ down
    after = _lowest(shape, p_OM, before)
    axis = np.cross(after, before)
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, float(after @ before))
    if sine < _ROUNDING:
        axis, sine = table_axes(before)[0], 1.0
    p = p_HO + (_support(shape, before) - _support(shape, after)) * down
    return np.asarray(p), np.asarray(R_HO @ rotation_exp(angle * axis / sine))


def _lowest(shape: Sphere | Superquadric, p_OM: Array, start: Array) -> Array:
    """Return the direction (3,) in O that points down at rest, near one that points down at the start."""
    if isinstance(shape, Sphere):
        distance = float(np.linalg.norm(p_OM))
        return p_OM / distance if distance > _ROUNDING else start
    from scipy.optimize import minimize  # imported here, because it is slow to import

    across = table_axes(start)
    simplex = _FIRST_STEP * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])

    def direction(x: Array) -> Array:
        return np.asarray(rotation_exp(x @ across) @ start)

    def height(x: Array) -> float:
        d = direction(x)
        return _support(shape, d) - float(d @ p_OM)

    found = minimize(height, np.zeros(2), method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-7})
    return direction(found.x)


def _support(shape: Sphere | Superquadric, d: Array) -> float:
    """Return the support function h(d) of a unit vector d in O, m. That of a norm is the dual norm."""
    if isinstance(shape, Sphere):
        return shape.radius
    outer, inner = (2.0 / max(2.0 - e, _ROUNDING) for e in shape.exponents.tolist())
    x, y, z = np.abs(shape.axes * d).tolist()
    return _norm(_norm(x, y, inner), z, outer)


def _norm(x: float, y: float, p: float) -> float:
    """Return the p-norm of two numbers, which are at least 0."""
    largest = max(x, y)
    return largest * ((x / largest) ** p + (y / largest) ** p) ** (1.0 / p) if largest > 0.0 else 0.0
