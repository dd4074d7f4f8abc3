"""Shapes of objects: sphere, cylinder, box, superquadric, implicit surface; point → inward normal, curvature.

`shape` says what every shape answers and by which law; the other files are the shapes.
"""

from graspforce.shapes.implicit import ImplicitSurface
from graspforce.shapes.primitives import Box, Cylinder, Sphere
from graspforce.shapes.shape import SURFACE, Shape, Solid
from graspforce.shapes.superquadric import Superquadric

__all__ = ["SURFACE", "Box", "Cylinder", "ImplicitSurface", "Shape", "Solid", "Sphere", "Superquadric"]
