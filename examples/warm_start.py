"""Solve a sequence of similar problems with warm starts.

A `Solver` starts from its last solution, so that each step takes fewer iterations than a first solve.
"""

import sys

from matplotlib.figure import Figure

import graspforce as gf
from graspforce.problems.carry import sinusoidal_carry

steps = sinusoidal_carry(gf.Hand.load("four_finger"), steps=101)
solver = gf.Solver(steps[0].problem)
warm, cold, normals = [], [], []
for step in steps:
    now = step.problem
    solution = solver.solve(w=now.w, J=now.actuation.J, tau_u=now.actuation.tau_u)
    warm.append(solution.iterations)
    cold.append(gf.solve(now).iterations)
    normals.append([f[2] for f in solution.forces])
print(f"{sum(warm) / len(warm):.1f} iterations warm, {sum(cold) / len(cold):.1f} cold")

figure = Figure(figsize=(7, 4.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
times = [step.time for step in steps]
above.plot(times, normals)
above.set(ylabel="normal force (N)", title="Warm starts halve the iterations along a carry")
below.step(times, cold, color="#999999", label="cold")
below.step(times, warm, color="#0072B2", label="warm")
below.set(xlabel="time (s)", ylabel="iterations", ylim=(0, None))
below.legend(frameon=False)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "warm_start.png", dpi=110)
