"""Shapes of objects: sphere, cylinder, box, superquadric, implicit surface; point → inward normal, curvature.

`shape` says what every shape answers and by which law; the other files are the shapes.
"""

from graspforce.geometry.implicit_surface import ImplicitSurface
from graspforce.geometry.primitives import Box, Cylinder, Sphere
from graspforce.geometry.shape import SURFACE_TOLERANCE, Shape, Solid
from graspforce.geometry.superquadric import Superquadric

__all__ = ["SURFACE_TOLERANCE", "Box", "Cylinder", "ImplicitSurface", "Shape", "Solid", "Sphere", "Superquadric"]
