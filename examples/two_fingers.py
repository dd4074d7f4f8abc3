"""Hold a weight between two fingers.

The smallest force problem: each finger carries half of the weight by friction, with the smallest sufficient normal force.
"""

import sys

import graspforce as gf

contacts = [
    gf.Contact(position=[0.0, -0.03, 0.0], normal=[0, 1, 0], friction=0.5, max_normal=20.0),
    gf.Contact(position=[0.0, 0.03, 0.0], normal=[0, -1, 0], friction=0.5, max_normal=20.0),
]
problem = gf.ForceProblem(contacts, w=[0, 0, 1.962, 0, 0, 0], name="pinch")  # hold 200 g: N and N·m
solution = gf.solve(problem)
print(solution)
gf.view.show(problem, solution).savefig(sys.argv[1] if len(sys.argv) > 1 else "two_fingers.png", dpi=110)
