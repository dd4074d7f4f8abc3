"""Pick a cylinder from a table, carry it, place it and let it go.

The cylinder stands 8 mm and 5° from where the controller expects it. The fingers find it by touch.
"""

import sys

import graspforce as gf
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.geometry import Cylinder
from graspforce.simulation import World
from graspforce.simulation.cycle.cycle_outcome import judge_cycle, phase_table
from graspforce.simulation.cycle.cycle_plots import plot_cycle
from graspforce.simulation.cycle.cycle_run import TablePlant, run_cycle
from graspforce.simulation.cycle.plan_cycle import find_cycle
from graspforce.simulation.cycle.pose_errors import displaced_pose

hand = gf.Hand.load("dlr_hit2")
scene, plan = find_cycle(hand, gf.Body.solid(Cylinder(0.025, 0.08), 0.1))
pose = displaced_pose(scene, (0.008, 0.0), 0.09)

world = World()
table = TablePlant(scene, world, pose, plan.q_start)
recording = run_cycle(table, PhaseController(plan), scene, world)

outcome = judge_cycle(recording)
print(phase_table(recording))
print(f"{outcome.status}; moved {1e3 * outcome.moved_before_squeeze:.2f} mm before the squeeze")
plot_cycle(recording).savefig(sys.argv[1] if len(sys.argv) > 1 else "grasp_cycle.png", dpi=110)
