"""Find a grasp of an object.

`find_grasp` searches postures and object poses in which the fingertips hold the object against gravity.
"""

import sys

import graspforce as gf
from graspforce.geometry import Cylinder

can = gf.Body.solid(Cylinder(radius=0.025, height=0.09), mass=0.1)
grasp = gf.find_grasp(gf.Hand.load("dlr_hit2"), can, friction=0.7)
print(grasp)
solution = gf.solve(grasp.force_problem())  # forces at rest, palm up
gf.view.show(grasp, solution).savefig(sys.argv[1] if len(sys.argv) > 1 else "find_grasp.png", dpi=110)
