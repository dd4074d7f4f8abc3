"""Learn synergies from grasps, and search a grasp of another object with them.

The synergies are the principal components of the postures. The search samples from the first ones, and refines in all joints.
"""

import sys

import numpy as np

import graspforce as gf
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.learning import PostureLibrary, fit_synergies
from graspforce.view.learning_plots import plot_component_postures

hand, fingers = gf.Hand.load("dlr_hit2"), ("thumb", "index", "middle")
shapes = [*(Sphere(r) for r in (0.025, 0.03, 0.035)), *(Box([0.04, 0.04, z]) for z in (0.04, 0.06, 0.08))]
grasps = [gf.find_grasp(hand, gf.Body.solid(shape, mass=0.05), fingers) for shape in shapes]
synergies = fit_synergies(PostureLibrary.from_grasps(grasps))
print("explained variance:", synergies.cumulative_variance[:4].round(3))

errors = synergies.reconstruction_error([grasp.q for grasp in grasps])
print("error with 0, 1, … synergies in degrees:", np.degrees(errors.mean(axis=1)).round(2))
print(gf.find_grasp(hand, gf.Body.solid(Cylinder(0.025, 0.08), mass=0.05), fingers, prior=synergies.prior(3)))

plot_component_postures(hand, synergies).savefig(sys.argv[1] if len(sys.argv) > 1 else "learn_synergies.png", dpi=80)
