"""Plots of a hand without an object: positions with their references, and motor torques."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from graspforce.simulation.free_hand.joint_run import JointRun, StepResponse, step_responses
from graspforce.view.figures import LINE_COLOURS, plot_torques, save_figures


def save_joint_plots(run: JointRun, folder: Path) -> list[Path]:
    """Write positions.png and torques.png, and return the files.

    Args:
        run: the run.
        folder: the folder; created if missing.
    """
    return save_figures({"positions": _plot_positions(run), "torques": _plot_torques(run)}, folder)


def _plot_positions(run: JointRun) -> Figure:
    """Plot the positions of the joints that move, with dashed references."""
    responses = {response.joint: response for response in step_responses(run)}
    units = tuple(dict.fromkeys(run.units))
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    axes = figure.subplots()
    moved = [j for j, joint in enumerate(run.joints) if joint in responses]
    for colour, j in zip(LINE_COLOURS * (len(moved) // len(LINE_COLOURS) + 1), moved, strict=False):
        factor, unit = (1e3, "mm") if run.units[j] == "m" else (float(np.degrees(1.0)), "°")
        label = f"{run.joints[j]}: {factor * run.q[0, j]:.1f} to {factor * run.q_desired[-1, j]:.1f} {unit}"
        axes.plot(run.t, factor * run.q[:, j], color=colour, label=label)
        axes.plot(run.t, factor * run.q_desired[:, j], color=colour, linestyle="--", linewidth=0.9)
    axes.set_xlabel("time (s)")
    labels = {"m": "position (mm)", "rad": "position (°)"}
    axes.set_ylabel(labels[units[0]] if len(units) == 1 else "position (°; mm of sliding joints)")
    axes.set_xlim(0.0, run.t[-1])
    axes.grid(alpha=0.25)
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    figure.suptitle(_result(run, list(responses.values())))
    return figure


def _plot_torques(run: JointRun) -> Figure:
    """Plot the motor torques in percent of their limits."""
    figure, axes = plot_torques(run.t, run.tau, -run.torque_limit, run.torque_limit, run.joints)
    use = np.abs(run.tau / run.torque_limit).max(axis=0)
    busiest = int(use.argmax())
    axes.set_xlabel("time (s)")
    axes.set_ylabel("torque (% of the motor's limit)")
    axes.set_xlim(0.0, run.t[-1])
    span = 110.0 * max(float(use.max()), 0.05)  # %
    axes.set_ylim(-span, span)
    figure.suptitle(f"{run.hand}, {run.law}: {run.joints[busiest]} uses most of its torque, {100.0 * use[busiest]:.0f} %")
    return figure


def _result(run: JointRun, responses: list[StepResponse]) -> str:
    """Return the result of the run as a title."""
    if not responses:
        return f"{run.hand}, {run.law}: the hand holds its posture"
    slow = [response.joint for response in responses if np.isnan(response.settling_time)]
    if slow:
        return f"{run.hand}, {run.law}: {', '.join(slow[:3])} not within 2 % of the travel at the end"
    last = max(responses, key=lambda response: response.settling_time)
    overshoot = max(response.overshoot for response in responses)
    return f"{run.hand}, {run.law}: settled within {last.settling_time:.2f} s, overshoot at most {100.0 * overshoot:.1f} %"
