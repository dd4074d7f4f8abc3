"""Measure the quality of a grasp without a hand.

Three contacts on a ball: force closure, and the largest wrench that they resist in every direction.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce.contact import ContactSet, ferrari_canny, is_force_closed
from graspforce.geometry import Sphere

ball = Sphere(radius=0.03)
heights = np.linspace(-0.025, 0.025, 21)  # m: height of the contacts above the centre of the ball
qualities = []
for height in heights:
    angles = 2 * np.pi * np.arange(3) / 3
    points = [ball.project_to_surface([np.cos(a), np.sin(a), height / np.sqrt(0.03**2 - height**2)]) for a in angles]
    grasp = ContactSet.stack([gf.Contact(p, ball.inward_normal(p), friction=0.6) for p in points])
    qualities.append(ferrari_canny(grasp) if is_force_closed(grasp) else 0.0)
print(f"best quality {max(qualities):.3f} N at the equator")

figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(1e3 * heights, qualities, "o-", color="#009E73")
axes.set(xlabel="height of the contacts (mm)", ylabel="ε (N)", title="Grasp quality is highest at the equator of the ball")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "grasp_quality.png", dpi=110)
