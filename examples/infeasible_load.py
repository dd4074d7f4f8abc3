"""Prove that a load cannot be held.

Two fingers push with at most 20 N each. The solver returns a proof, and the friction and the load that would be feasible.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf

sides = ([0.0, -0.03, 0.0], [0, 1, 0]), ([0.0, 0.03, 0.0], [0, -1, 0])
contacts = [gf.Contact(position, normal, friction=0.5, max_normal=20.0) for position, normal in sides]
problem = gf.ForceProblem(contacts, w=[0, 0, 30.0, 0, 0, 0])
proof = gf.solve(problem).infeasibility
print(proof.explanation)
print(f"feasible with {proof.friction_factor:.2f} times the friction, or with a load of {proof.nearest_wrench[2]:.1f} N")

loads = np.linspace(1.0, 30.0, 30)  # N
answers = [gf.solve(problem.replace(w=[0, 0, load, 0, 0, 0]), explain=False) for load in loads]
figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(loads, [a.f[2] if a.found else np.nan for a in answers], color="#0072B2", linewidth=2)
axes.axvspan(proof.nearest_wrench[2], loads[-1], color="#CC3311", alpha=0.15)
axes.set(xlabel="load (N)", ylabel="normal force (N)", title="Loads above 20 N are infeasible: normal forces reach their limit")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "infeasible_load.png", dpi=110)
