"""Find a grasp of an object.

`find_grasp` searches postures and object poses in which the fingertips hold the object against gravity.
"""

import sys

import graspforce as gf
from graspforce.geometry import Cylinder

can = gf.Body.solid(Cylinder(radius=0.025, height=0.09), mass=0.1)
grasp = gf.find_grasp(gf.Hand.load("dlr_hit2"), can, friction=0.7)
print(grasp)
actuation = grasp.hand.actuation(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
weight = grasp.R_HO.T @ [0, 0, 0.1 * 9.81]  # N: what the contacts must supply, in the object's frame
solution = gf.solve(gf.ForceProblem(grasp.contacts, [*weight, 0, 0, 0], actuation))
gf.view.show(grasp, solution).savefig(sys.argv[1] if len(sys.argv) > 1 else "find_grasp.png", dpi=110)
