"""A recording as pictures: how far the object is from where it should be, forces in their cones, torques and their limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from graspforce.simulation.recording import Recording
from graspforce.view.figures import BLUE, GREEN, PALE, RED, plot_torques, save_figures


def save_plots(recording: Recording, folder: Path) -> list[Path]:
    """Write error.png, forces.png and torques.png.

    Args:
        recording: the run.
        folder: where they go; made where it is not there.

    Returns:
        The files.
    """
    return save_figures({"error": _error(recording), "forces": _forces(recording), "torques": _torques(recording)}, folder)


def _error(r: Recording) -> Figure:
    figure = Figure(figsize=(10, 7), layout="constrained")
    path, error, turn = figure.subplots(3, 1, sharex=True)
    for i, (axis, colour) in enumerate(zip("xyz", (RED, GREEN, BLUE), strict=True)):
        path.plot(r.t, 1e3 * (r.p_HO[:, i] - r.p_HO[0, i]), color=colour, label=axis)
        path.plot(r.t, 1e3 * (r.p_desired[:, i] - r.p_HO[0, i]), color=colour, linestyle=":", linewidth=2.5)
        error.plot(r.t, 1e6 * r.error[:, i], color=colour)
        turn.plot(r.t, np.degrees(r.orientation_error[:, i]), color=colour)
    path.set_ylabel("moved (mm)\ndotted: desired")
    error.set_ylabel("position error (µm)")
    turn.set_ylabel("attitude error (°)")
    turn.set_xlabel("time (s)")
    for panel in (path, error, turn):
        panel.grid(alpha=0.25)
    figure.legend(*path.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
    figure.suptitle(f"{r.hand}: the object, in the hand's axes")
    return figure


def _forces(r: Recording) -> Figure:
    figure = Figure(figsize=(10, 2.4 * len(r.fingers) + 1.0), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(r.fingers), 1, sharex=True, sharey=True))
    for i, panel in enumerate(panels):
        tangential = np.linalg.norm(r.f[:, i, :2], axis=1)
        panel.set_ylabel(f"{r.fingers[i]} (N)")
        panel.fill_between(r.t, 0.0, r.mu[:, i] * r.f[:, i, 2], color=PALE, label="inside the cone")
        panel.plot(r.t, r.f[:, i, 2], color=BLUE, label="normal force")
        panel.plot(r.t, r.planned[:, i, 2], color=BLUE, linestyle=":", linewidth=2.5, label="planned")
        panel.plot(r.t, tangential, color=RED, label="tangential force")
        panel.plot(r.t, np.linalg.norm(r.planned[:, i, :2], axis=1), color=RED, linestyle=":", linewidth=2.5)
        panel.grid(alpha=0.25)
    panels[0].set_ylim(bottom=0.0)
    panels[-1].set_xlabel("time (s)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{r.hand}: contact forces of the plant, and as they were planned (dotted)")
    return figure


def _torques(r: Recording) -> Figure:
    figure, panel = plot_torques(r.t, r.tau, r.torque_lower, r.torque_upper, r.joints)
    panel.set_ylabel("torque (% of the motor's limit)")
    panel.set_xlabel("time (s)")
    figure.suptitle(f"{r.hand}: motor torques, the six busiest by name")
    return figure
