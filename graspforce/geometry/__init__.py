"""Shapes of objects, with normals, closest points and curvatures.

Sphere, cylinder, box and superquadric have closed forms; a triangle mesh and an implicit surface are of any form.

`shape` defines the interface of all shapes and the law that they obey; the other modules hold the shapes, and the vectors,
rotations and poses that all packages use.
"""

from graspforce.geometry.implicit_surface import ImplicitSurface
from graspforce.geometry.primitives import Box, Cylinder, Sphere
from graspforce.geometry.rotations import rotation_from_quaternion, rotation_log
from graspforce.geometry.shape import SURFACE_TOLERANCE, Shape, Solid
from graspforce.geometry.superquadric import Superquadric
from graspforce.geometry.triangle_mesh import TriangleMesh

__all__ = [
    "SURFACE_TOLERANCE",
    "Box",
    "Cylinder",
    "ImplicitSurface",
    "Shape",
    "Solid",
    "Sphere",
    "Superquadric",
    "TriangleMesh",
    "rotation_from_quaternion",
    "rotation_log",
]
