"""Compare exact friction cones with pyramids.

An inner pyramid costs more force than the exact cone; an outer pyramid costs less, and its forces may slip.
"""

import sys

from matplotlib.figure import Figure

import graspforce as gf

problem = gf.problems.load("nose-cone/5-force").problem
exact = gf.solve(problem).objective
facets = [3, 4, 5, 6, 8, 12, 16, 24, 32]
figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
for side, colour in (("inner", "#0072B2"), ("outer", "#D55E00")):
    costs = [gf.solve(gf.ForceProblem(problem.contacts, problem.w, cone=gf.Cone("pyramid", m, side))).objective for m in facets]
    print(side, [round(cost / exact, 4) for cost in costs])
    axes.semilogx(facets, [100 * (cost / exact - 1) for cost in costs], "o-", base=2, color=colour, label=f"{side} pyramid")
axes.axhline(0.0, color="#222222", linewidth=1, label="exact cone")
axes.set(xlabel="facets", ylabel="cost beyond the exact cone (%)", title="Pyramids approach the exact cone as facets are added")
axes.set_xticks(facets, [str(m) for m in facets])
axes.legend(frameon=False)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "friction_pyramids.png", dpi=110)
