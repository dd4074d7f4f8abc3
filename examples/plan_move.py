"""Plan the fastest move of a held ball.

The ball moves 5 mm along a straight line. Torque and friction limits determine the duration.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce.control import ControlSettings
from graspforce.geometry import Sphere
from graspforce.planning import StraightPath, plan_along, tracking

grasp = gf.find_grasp(gf.Hand.load("dlr_hit2"), gf.Body.solid(Sphere(0.03), mass=0.05), friction=0.7)
path = StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + [-3e-3, 0, 4e-3], grasp.R_HO)
plan = plan_along(tracking.object_task(grasp, ControlSettings(slip_margin=1.0)), path, grasp.q)
print(f"{1e3 * plan.duration:.1f} ms")

times = np.linspace(0.0, plan.duration, 300)
motion = plan.at(times)
used = 100.0 * motion.tau / np.where(motion.tau > 0, grasp.hand.torque_upper, -grasp.hand.torque_lower)
figure = Figure(figsize=(7, 4.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(1e3 * times, 1e3 * np.linalg.norm(motion.twist[:, :3], axis=1), color="#0072B2", linewidth=2)
above.set(ylabel="speed (mm/s)", title=f"5 mm in {1e3 * plan.duration:.1f} ms from rest to rest")
below.plot(1e3 * times, used, linewidth=1)
below.set(xlabel="time (ms)", ylabel="motor torque (% of limit)")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "plan_move.png", dpi=110)
