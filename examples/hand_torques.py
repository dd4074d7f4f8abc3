"""Hold a box with minimum motor torque.

With a hand, the objective is motor torque, and the torque limits apply.
"""

import sys

import graspforce as gf
from graspforce.problems.carry import sinusoidal_carry

step = sinusoidal_carry(gf.Hand.load("four_finger"), steps=5)[2]
solution = gf.solve(step.problem)
print(solution)
gf.view.plot_solution(solution).savefig(sys.argv[1] if len(sys.argv) > 1 else "hand_torques.png", dpi=110)
