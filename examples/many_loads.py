"""Solve a thousand problems at once.

`solve_stack` takes arrays with one row for each problem, and uses all cores. Here it finds the loads that a grasp can hold.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf

angles = 2 * np.pi * np.arange(3) / 3
points = [[0.03 * np.cos(a), 0.03 * np.sin(a), 0.0] for a in angles]
capped = [gf.Contact(p, [-p[0], -p[1], 0.0], friction=0.5, max_normal=2.0) for p in points]
x, z = np.meshgrid(np.linspace(-3, 3, 41), np.linspace(-3, 3, 41))  # N
loads = np.zeros((x.size, 6))
loads[:, 0], loads[:, 2] = x.ravel(), z.ravel()
answers = gf.solve_stack(gf.ForceProblem(capped, [0, 0, 1, 0, 0, 0]), w=loads)
largest = np.linalg.norm(answers.f, axis=1).reshape(x.shape)
print(f"{np.isfinite(largest).sum()} of {x.size} loads can be held")

figure = Figure(figsize=(6, 4.6), layout="constrained")
axes = figure.subplots()
shades = axes.pcolormesh(x, z, largest, cmap="cividis")
axes.set(
    xlabel="load along x (N)",
    ylabel="load along z (N)",
    aspect="equal",
    title="Feasible loads of three fingers with at most 2 N each",
)
figure.colorbar(shades, label="‖f‖ (N)")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "many_loads.png", dpi=110)
