"""Plot the solution of a force problem: forces by contact, friction used, and torques as shares of their limits."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from graspforce.core.errors import InvalidInput
from graspforce.force.solution import Solution

_OBJECTIVE_UNITS = {"force": "N²", "max_normal": "N", "sum_normal": "N", "margin": "N"}  # torques are weighted
NORMAL, TANGENTIAL, LIMIT, MOTOR = "#0072B2", "#E69F00", "#CC3311", "#56B4E9"


def plot_solution(solution: Solution) -> Figure:
    """Return a figure of a solution's forces, friction use and torques.

    Args:
        solution: one with forces.

    Raises:
        InvalidInput: the solution has no forces.
    """
    if not solution.f.size:
        raise InvalidInput("solution", solution.status.value, "one with forces: optimal or inaccurate")
    with_motors = solution.torques.size > 0
    figure = Figure(figsize=(9.5 if with_motors else 6.5, 3.6), layout="constrained")
    panels = figure.subplots(1, 3 if with_motors else 2, squeeze=False)[0]
    _plot_forces(panels[0], solution)
    _plot_friction(panels[1], solution)
    if with_motors:
        _plot_torques(panels[2], solution)
    worst = 100.0 * float(solution.friction_used.max(initial=0.0))
    status, kind = solution.status.value.capitalize(), solution.original_problem.objective.type
    unit = f" {_OBJECTIVE_UNITS[kind]}" if kind in _OBJECTIVE_UNITS else ""
    figure.suptitle(f"{status}: friction used at most {worst:.0f} %, objective {solution.objective:.4g}{unit}", fontsize=11)
    return figure


def _plot_forces(axes: Axes, solution: Solution) -> None:
    contacts = solution.original_problem.contacts
    padded = contacts.pad(solution.f)
    place = np.arange(len(padded))
    axes.bar(place - 0.2, padded[:, 2], 0.4, color=NORMAL, label="normal")
    axes.bar(place + 0.2, np.linalg.norm(padded[:, :2], axis=1), 0.4, color=TANGENTIAL, label="tangential")
    axes.set(xlabel="contact", ylabel="force (N)", xticks=place)
    axes.set_ylim(0.0, 1.25 * max(float(padded[:, 2].max()), 1e-9))
    axes.legend(frameon=False, fontsize=9, ncols=2, loc="upper center")


def _plot_friction(axes: Axes, solution: Solution) -> None:
    used = 100.0 * solution.friction_used
    axes.bar(np.arange(len(used)), used, 0.6, color=TANGENTIAL)
    axes.axhline(100.0, color=LIMIT, linestyle="--", linewidth=1.2)
    axes.set(
        xlabel="contact", ylabel="friction used (%)", xticks=np.arange(len(used)), ylim=(0.0, max(108.0, 1.05 * used.max()))
    )


def _plot_torques(axes: Axes, solution: Solution) -> None:
    actuation = solution.original_problem.actuation
    assert actuation is not None  # torques exist only with an actuation
    tau = solution.torques
    limit = np.where(tau >= 0.0, actuation.upper, -actuation.lower)
    bounded = np.isfinite(limit).all() and bool((limit > 0.0).all())
    values = 100.0 * tau / limit if bounded else tau
    axes.bar(np.arange(len(tau)), values, 0.8, color=MOTOR)
    if bounded:
        for side in (-100.0, 100.0):
            axes.axhline(side, color=LIMIT, linestyle="--", linewidth=1.2)
    axes.set(xlabel="motor", ylabel="torque (% of limit)" if bounded else "torque (N·m)")
