"""Compute contact forces that hold for errors of friction and mass.

Three fingers lift a load that is known to 20 % on contacts whose friction is known to 25 %. The squeeze of least force holds
for every combination, and the certificate says how far the errors may go.
"""

import sys

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import graspforce as gf

angles = 2 * np.pi * np.arange(3) / 3
contacts = [
    gf.Contact((0.03 * np.cos(a), 0.03 * np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), friction=0.6, max_normal=20.0)
    for a in angles
]
load = [0, 0, 4.0, 0, 0, 0]  # N


def squeeze(friction_error: float, mass_error: float) -> gf.Solution:
    """Return the forces that hold for errors of friction and mass."""
    errors = gf.Uncertainty(friction_error=friction_error, mass_error=mass_error)
    return gf.solve(gf.ForceProblem(contacts, load, uncertainty=errors))


nominal, safe = squeeze(0.0, 0.0), squeeze(0.25, 0.2)
print(f"normal forces {nominal.f[2]:.2f} N for the model, {safe.f[2]:.2f} N for all errors")
print(safe.robust)
holds, _ = safe.robust.error_factor
member = safe.robust.slipping_member(1.01 * holds)
print(
    f"1 % larger errors: contact {member.contact} slips with mu {member.friction[member.contact]:.3f}, {member.wrench[2]:.2f} N"
)

mu, mass = np.meshgrid(np.linspace(0.3, 0.75, 91), np.linspace(2.5, 5.5, 91))  # a load beyond 4 N is shared equally
figure = Figure(figsize=(7.5, 3.8), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
for axes, solution, title in zip(panels, (nominal, safe), ("for the model", "for all errors"), strict=True):
    margin = mu * solution.f[2] - mass / 3.0  # N
    shades = axes.contourf(mu, mass, margin, np.linspace(-1.5, 2.5, 17), cmap="RdBu", vmin=-1.5, vmax=1.5, extend="both")
    axes.contour(mu, mass, margin, [0.0], colors="black")
    axes.add_patch(Rectangle((0.45, 3.2), 0.3, 1.6, fill=False, linestyle="--"))
    axes.set(xlabel="true friction", title=f"{solution.f[2]:.1f} N, {title}")
panels[0].set_ylabel("true load (N)")
figure.colorbar(shades, ax=panels, label="slip margin (N)")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "uncertain_load.png", dpi=110)
