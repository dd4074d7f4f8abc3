"""Plots of a grasp cycle: forces and load transfer, and heights, over the phases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from graspforce.core.arrays import Array
from graspforce.simulation.cycle.cycle_run import CycleRecording
from graspforce.view.figures import LINE_COLOURS, plot_torques, save_figures

_SMOOTHING = 10  # steps of the moving mean of forces


def save_cycle_plots(recording: CycleRecording, folder: Path) -> list[Path]:
    """Write cycle.png and torques.png, and return the files.

    Args:
        recording: the cycle.
        folder: the folder; created if missing.
    """
    return save_figures({"cycle": plot_cycle(recording), "torques": _plot_torques(recording)}, folder)


def plot_cycle(recording: CycleRecording) -> Figure:
    """Return the figure of normal forces, load transfer and heights over the phases.

    Args:
        recording: the cycle.
    """
    figure = Figure(figsize=(10, 7.5), layout="constrained")
    forces, load, height = figure.subplots(3, 1, sharex=True)
    t, up = recording.t, -recording.scene.down
    for i, name in enumerate(recording.scene.grasp.fingers):
        forces.plot(t, _smooth(recording.f[:, i, 2]), color=LINE_COLOURS[i], label=name)
        forces.plot(t, recording.f_planned[:, i], color=LINE_COLOURS[i], linestyle="--", linewidth=0.9)
    forces.set_ylabel("normal force (N),\nplanned dashed")
    load.plot(t, _smooth(recording.contact_force_H @ up), color=LINE_COLOURS[0], label="fingers")
    load.plot(t, _smooth(recording.table_force), color=LINE_COLOURS[1], label="table")
    load.axhline(recording.weight, color="0.4", linestyle=":", label="weight")
    load.set_ylabel("vertical load (N)")
    place = recording.p_HO + recording.base
    height.plot(t, 1e3 * (place - place[0]) @ up, color=LINE_COLOURS[0], label="object")
    height.plot(t, 1e3 * recording.base @ up, color=LINE_COLOURS[1], linestyle="--", label="hand")
    height.set_ylabel("height (mm)")
    height.set_xlabel("time (s)")
    for axes in (forces, load, height):
        axes.grid(alpha=0.25)
        corner = "center right" if axes is load else "upper right"  # clear of the lines
        axes.legend(loc=corner, frameon=False, fontsize=9)
        _mark_phases(axes, recording, names=axes is forces)
    height.set_xlim(0.0, t[-1])
    result = recording.message or "done"
    figure.suptitle(f"{recording.scene.grasp.hand.name}: {result}")
    return figure


def _mark_phases(axes: Axes, recording: CycleRecording, names: bool) -> None:
    """Mark the begin of each phase, with its name."""
    for k, record in enumerate(recording.records):
        axes.axvspan(record.start, record.end, color="0.5", alpha=0.08 * (k % 2), linewidth=0)
        if names:
            middle = 0.5 * (record.start + record.end)
            axes.annotate(record.phase, (middle, 1.02), xycoords=("data", "axes fraction"), ha="center", fontsize=8)


def _plot_torques(recording: CycleRecording) -> Figure:
    """Plot the motor torques in percent of their limits."""
    hand = recording.scene.grasp.hand
    figure, axes = plot_torques(recording.t, recording.tau, hand.torque_lower, hand.torque_upper, hand.joint_names)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("torque (% of the motor's limit)")
    axes.set_xlim(0.0, recording.t[-1])
    _mark_phases(axes, recording, names=True)
    return figure


def _smooth(values: Array) -> Array:
    """Return the moving mean of values."""
    return np.convolve(values, np.full(_SMOOTHING, 1.0 / _SMOOTHING), mode="same")
