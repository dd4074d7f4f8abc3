"""Push a held ball in a physics engine.

The controller holds a ball in MuJoCo. A push of 0.5 N moves it by a millimetre; it returns.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce import simulation
from graspforce.contact.motion import BodyMotion
from graspforce.geometry import Sphere

grasp = gf.find_grasp(gf.Hand.load("dlr_hit2"), gf.Body.solid(Sphere(0.03), mass=0.05), friction=0.7)
push = simulation.Push(np.array([0.5, 0.0, 0.0]), 0.1, 0.1)  # N, s, s
plant = simulation.Plant(simulation.build_scene(grasp), disturbances=[push])
still = simulation.constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO))
run = simulation.simulate(plant, gf.ObjectController(grasp), still, duration=0.6)
offset = 1e3 * np.linalg.norm(run.p_HO - grasp.p_HO, axis=1)  # mm
print(f"largest error {offset.max():.2f} mm, final error {offset[-1]:.3f} mm")

figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
axes.axvspan(0.1, 0.2, color="#E69F00", alpha=0.25, label="push of 0.5 N")
axes.plot(run.t, offset, color="#0072B2", linewidth=2)
axes.set(
    xlabel="time (s)", ylabel="distance from the goal (mm)", title=f"A push moves the ball by {offset.max():.1f} mm; it returns"
)
axes.legend(frameon=False)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "simulate_push.png", dpi=110)
