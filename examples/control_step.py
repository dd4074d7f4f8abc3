"""Compute motor torques for a held object.

One step of the controller: the object is 1 mm below its reference, so the fingers lift it.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState
from graspforce.geometry import Sphere

grasp = gf.find_grasp(gf.Hand.load("dlr_hit2"), gf.Body.solid(Sphere(0.03), mass=0.05), friction=0.7)
state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
desired = BodyMotion(grasp.p_HO + [0.0, 0.0, 1e-3], grasp.R_HO)
hold, lift = (gf.ObjectController(grasp).step(state, motion) for motion in (state.object, desired))
print(f"acceleration {lift.acceleration[2]:.2f} m/s², slip margins {np.round(lift.slip_margin, 2)} N")

figure = Figure(figsize=(8, 3.6), layout="constrained")
axes = figure.subplots()
place = np.arange(grasp.hand.n)
axes.bar(place - 0.2, 1e3 * hold.tau, 0.4, color="#999999", label="to hold")
axes.bar(place + 0.2, 1e3 * lift.tau, 0.4, color="#0072B2", label="to lift by 1 mm")
axes.set(xlabel="motor", ylabel="torque (mN·m)", xticks=place, title="Torques to hold and to lift a ball")
axes.legend(frameon=False)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "control_step.png", dpi=110)
