"""Move contacts by gradient until the forces are least.

Three contacts on a ring hold a weight. The derivatives of the objective with respect to contact positions and frames turn into
derivatives along the ring. The best places are 120° apart, with the objective W²(1 + 1/μ²)/(2n).
"""

import sys

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import minimize

import graspforce as gf

RADIUS, FRICTION, WEIGHT = 0.04, 0.5, 2.0  # m, 1, N


def grasp(angles):
    """Return the force problem of contacts on the ring."""
    normals = np.column_stack([-np.cos(angles), -np.sin(angles), np.zeros(3)])
    contacts = [gf.Contact(-RADIUS * n, n, FRICTION) for n in normals]
    return gf.ForceProblem(contacts, [0, 0, WEIGHT, 0, 0, 0])


def value_and_slope(angles):
    """Return the objective, N², and its derivative along the ring, N²/rad."""
    answer = gf.sensitivities(gf.solve(grasp(angles)))
    gradient = answer.adjoint(objective=1.0)
    along = RADIUS * np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(3)])  # m/rad
    value = answer.optimum.problem.cost(answer.optimum.f)
    history.append((np.array(angles), value / best - 1))
    return value, np.sum(gradient["p"] * along, axis=1) + gradient["rotation"][:, 2]


best = WEIGHT**2 * (1 + 1 / FRICTION**2) / 6  # N²
history = []
minimize(value_and_slope, np.radians([0.0, 100.0, 215.0]), jac=True, method="BFGS")
values = np.array([value for _, value in history])
print(f"objective {100 * values[0]:.1f} % above the best at the start, {100 * values.min():.4f} % at the end")
print("angles", np.degrees(np.diff(history[int(values.argmin())][0])).round(2), "degrees apart")

figure = Figure(figsize=(9, 3.6), layout="constrained")
left, right = figure.subplots(1, 2)
path = np.array([places for places, _ in history])
for i, colour in enumerate(("#0072B2", "#E69F00", "#009E73")):
    left.plot(np.degrees(path[:, i]), color=colour, label=f"contact {i}")
left.set(xlabel="evaluation", ylabel="angle on the ring (°)", title="The contacts end 120° apart")
left.set_ylim(-60, 340)
left.legend(frameon=False, ncols=3, loc="upper center")
right.semilogy(100 * np.abs(values), color="#0072B2")
title = f"From {100 * values[0]:.0f} % above the best to {100 * abs(values[-1]):.0e} %"
right.set(xlabel="evaluation", ylabel="objective above the best (%)", title=title)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "optimise_contacts.png", dpi=110)
