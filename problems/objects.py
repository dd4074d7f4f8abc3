"""The IST object set: twelve objects in twenty configurations.

Table 1 of the report of the HANDLE project, Parameterizing and creating new actions (undated), gives dimensions and materials.
Density and friction are assumed values, typical of each material. Every object is solid: m = ρ V.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.geometry import Box, Cylinder, Solid, Sphere

DENSITIES = {"sponge": 30.0, "rubber": 1100.0, "wood": 700.0, "metal": 2700.0}  # kg/m³; the metal is aluminium
FRICTION = {"sponge": 0.8, "rubber": 0.9, "wood": 0.5, "metal": 0.3}  # μ against a rubber-coated fingertip
SOURCE = "HANDLE project, Parameterizing and creating new actions (undated), Table 1"

# rows of the table: name, pose, width, height and length in mm, material
_TABLE = (
    ("big green ball", "", 86, 86, 86, "sponge"),
    ("medium green ball", "", 64, 64, 64, "rubber"),
    ("small white ball", "", 54, 54, 54, "sponge"),
    ("big red cylinder", "top", 64, 76, 76, "metal"),
    ("big red cylinder", "side", 64, 76, 76, "metal"),
    ("medium green cylinder", "top", 38, 38, 38, "sponge"),
    ("medium green cylinder", "side", 38, 38, 38, "sponge"),
    ("small red cylinder", "top", 59, 27, 27, "wood"),
    ("small red cylinder", "side", 59, 27, 27, "wood"),
    ("pen", "side", 150, 12, 12, "metal"),
    ("small purple cube", "", 30, 30, 30, "wood"),
    ("large blue box", "long side", 77, 39, 39, "sponge"),
    ("large blue box", "short side", 77, 39, 39, "sponge"),
    ("medium orange box", "long side", 60, 30, 30, "wood"),
    ("medium orange box", "short side", 60, 30, 30, "wood"),
    ("small red box", "long side", 60, 14, 29, "wood"),
    ("small red box", "short side", 60, 14, 29, "wood"),
    ("small red box", "medium side", 60, 14, 29, "wood"),
    ("large yellow box", "short side", 80, 80, 38, "sponge"),
    ("large yellow box", "long side", 80, 80, 38, "sponge"),
)


@dataclass(frozen=True, eq=False, slots=True)
class GraspObject:
    """An object, with the direction and the axis along which it is grasped.

    The origin of O is the centre of the object. The edges of a box are along the axes of O: width along x, height along y,
    length along z. The axis of a cylinder is z.

    Args:
        name: name in the table.
        pose: "top", "side", "long side", "medium side", "short side", or "" if the table names none.
        material: "sponge", "rubber", "wood" or "metal".
        shape: shape in O, m.
        mass: mass, kg: density of the material times volume of the shape.
        com: (3,) centre of mass in O, m.
        inertia: (3, 3) inertia about the centre of mass, in O, kg·m².
        friction: μ of the material against a rubber-coated fingertip.
        closing_axis: (3,) unit axis in O along which the fingers close; for a box, along the edge that the pose names.
        approach: (3,) unit approach direction of the hand in O; −z for a cylinder that is grasped from the top.
        source: origin of dimensions and material.
    """

    name: str
    pose: str
    material: str
    shape: Solid
    mass: float
    com: Array
    inertia: Array
    friction: float
    closing_axis: Array
    approach: Array
    source: str

    @property
    def title(self) -> str:
        """Name and pose."""
        return f"{self.name}, {self.pose}" if self.pose else self.name

    @property
    def span(self) -> float:
        """Width of the object along ``closing_axis``, m."""
        far = 1e3 * np.asarray(self.closing_axis)  # m: on the axis, far outside; its closest point is where the axis exits
        return 2.0 * float(np.linalg.norm(self.shape.project_to_surface(far)))


@cache
def ist_objects() -> tuple[GraspObject, ...]:
    """Return all twenty configurations, in the order of the table."""
    return tuple(_make_object(*row) for row in _TABLE)


def _make_object(name: str, pose: str, width: float, height: float, length: float, material: str) -> GraspObject:
    sizes = np.array([width, height, length]) * 1e-3  # m
    shape: Solid
    closing_axis, approach = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
    if "ball" in name:
        shape = Sphere(float(sizes[0]) / 2.0)
    elif "cylinder" in name or name == "pen":  # width in the table is the length along the axis
        shape = Cylinder(float(sizes[1]) / 2.0, float(sizes[0]))
        approach = approach if pose == "top" else np.array([0.0, -1.0, 0.0])
    else:
        shape = Box(sizes)
        closing_axis = np.eye(3)[_spanned_edge(sizes, pose)]
        free = [axis for axis in range(3) if not closing_axis[axis]]
        approach = -np.eye(3)[free[-1]]
    mass, inertia = shape.inertia(DENSITIES[material])
    return GraspObject(
        name=name,
        pose=pose,
        material=material,
        shape=shape,
        mass=mass,
        com=freeze(np.zeros(3)),
        inertia=inertia,
        friction=FRICTION[material],
        closing_axis=freeze(closing_axis),
        approach=freeze(approach),
        source=SOURCE,
    )


def _spanned_edge(sizes: Array, pose: str) -> int:
    """Return the axis of the box edge that the pose names: longest, middle or shortest; 0 for a cube."""
    different = np.unique(sizes)
    if not pose or len(different) == 1:
        return 0
    wanted = different[-1] if pose == "long side" else different[0] if pose == "short side" else different[1]
    return int(np.flatnonzero(sizes == wanted)[0])
