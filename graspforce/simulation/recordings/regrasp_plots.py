"""Plots of an executed regrasp plan: slip margins, pose error and motor torques over its phases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from graspforce.hand.hand import Hand
from graspforce.planning.regrasp import RegraspPhase
from graspforce.simulation.recordings.regrasp_run import RegraspRun
from graspforce.view.figures import LINE_COLOURS, RED, plot_torques, save_figures

_PHASES = {
    RegraspPhase.RELEASE: ("#e69f00", "a finger lets go"),
    RegraspPhase.STEP: ("#999999", "it moves"),
    RegraspPhase.LOAD: ("#009e73", "it joins"),
}
_HEADROOM = 1.15  # of the largest margin that is shown


def save_regrasp_plots(run: RegraspRun, hand: Hand, folder: Path) -> list[Path]:
    """Write regrasp.png and torques.png, and return the files.

    Args:
        run: the recording.
        hand: the hand.
        folder: the folder; created if missing.
    """
    return save_figures({"regrasp": plot_regrasp(run, hand.name), "torques": _plot_torques(run, hand)}, folder)


def plot_regrasp(run: RegraspRun, name: str) -> Figure:
    """Return the figure of the least slip margins and of the pose error.

    Args:
        run: the recording.
        name: name of the hand, for the title.
    """
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    margins, errors = figure.subplots(2, 1, sharex=True)
    margins.plot(run.t, run.true_margin, color=LINE_COLOURS[4], lw=0.8, label="true, fingers that touch")
    margins.plot(run.t, run.planned_margin, color=LINE_COLOURS[0], lw=1.0, label="planned, fingers that hold")
    margins.axhline(0.0, color=RED, lw=1.0, ls="--")
    margins.set_ylabel("least slip margin (N)")
    highest = float(run.planned_margin[np.isfinite(run.planned_margin)].max(initial=0.0))
    margins.set_ylim(min(-0.02, 1.1 * float(run.planned_margin.min())), _HEADROOM * highest if highest > 0.0 else 1.0)
    errors.plot(run.t, 1e3 * np.linalg.norm(run.error[:, :3], axis=1), color=LINE_COLOURS[0], lw=0.9, label="position (mm)")
    errors.plot(
        run.t, np.degrees(np.linalg.norm(run.error[:, 3:], axis=1)), color=LINE_COLOURS[5], lw=0.9, label="rotation (°)"
    )
    errors.set(xlabel="time (s)", ylabel="pose error (mm, °)")
    errors.set_ylim(bottom=0.0)
    for axes in (margins, errors):
        _mark_phases(axes, run)
        axes.grid(alpha=0.25)
    margins.legend(loc="upper right", ncols=5, frameon=False, fontsize=8, bbox_to_anchor=(1.0, 1.14))
    errors.legend(loc="upper right", frameon=False, fontsize=8, handles=errors.lines)
    errors.set_xlim(0.0, run.t[-1])
    moving = np.array([phase is RegraspPhase.STEP for phase in run.phase])
    steps = np.count_nonzero(moving[1:] & ~moving[:-1])
    least = round(float(run.planned_margin.min()), 2) + 0.0  # never -0.00
    figure.suptitle(f"{name}, {steps} finger steps: the planned margin never falls below {least:.2f} N")
    return figure


def _mark_phases(axes: Axes, run: RegraspRun) -> None:
    """Shade the phases of the finger steps."""
    for phase, (colour, label) in _PHASES.items():
        where, place = np.array([each is phase for each in run.phase]), axes.get_xaxis_transform()
        axes.fill_between(run.t, 0.0, 1.0, where=where, transform=place, color=colour, alpha=0.25, lw=0.0, label=label)


def _plot_torques(run: RegraspRun, hand: Hand) -> Figure:
    """Plot the motor torques in percent of their limits."""
    figure, axes = plot_torques(run.t, run.tau, hand.torque_lower, hand.torque_upper, hand.joint_names)
    share = 100.0 * float(np.abs(np.where(run.tau >= 0.0, run.tau / hand.torque_upper, run.tau / hand.torque_lower)).max())
    axes.set(
        xlabel="time (s)", ylabel="torque (% of the motor's limit)", title=f"{hand.name}: at most {share:.0f} % of a limit"
    )
    axes.set_xlim(0.0, run.t[-1])
    return figure
