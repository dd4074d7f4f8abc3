"""Plots of a plan: speed and active limits, motor torques, contact forces in their cones, and rolling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from graspforce.contact import friction
from graspforce.planning.limit_usage import FRICTION, MOTOR, NORMAL, SPEED, limit_usage
from graspforce.planning.plan import Plan
from graspforce.planning.task import GraspTask, HandTask, ObjectTask
from graspforce.view.figures import BLUE, GREEN, GREY, PALE, RED, plot_torques, save_figures

_COLOURS = {MOTOR: BLUE, SPEED: GREEN, FRICTION: RED, NORMAL: "#b8860b"}
_SAMPLES = 600
_MAX_LIMITS = 12  # limits shown, the longest first


def save_plots(plan: Plan, folder: Path) -> list[Path]:
    """Write speed.png; torques.png with a hand, cones.png with an object, rolling.png if contacts roll.

    Args:
        plan: the plan.
        folder: the folder; created if missing.

    Returns:
        The files.
    """
    figures = {"speed": plot_plan(plan)}
    if isinstance(plan.task, HandTask):
        figures["torques"] = _torques(plan, plan.task)
    if isinstance(plan.task, ObjectTask):
        figures["cones"] = _cones(plan, plan.task)
    if isinstance(plan.task, GraspTask) and plan.task.is_rolling.any():
        figures["rolling"] = _rolling(plan, plan.task)
    return save_figures(figures, folder)


def _title(plan: Plan) -> str:
    who = plan.task.hand.name if isinstance(plan.task, HandTask) else "ideal fingers"
    return f"{who}: a move of {1e3 * plan.duration:.1f} ms"


def plot_plan(plan: Plan) -> Figure:
    """Return a figure of the speed above, and the active limits below.

    Args:
        plan: the plan.
    """
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    at, ms = plan.at(times), 1e3 * times
    reached = [limit for limit in limit_usage(plan, times) if limit.active.any()][:_MAX_LIMITS]
    figure = Figure(figsize=(10, 4.6 + 0.25 * len(reached)), layout="constrained")
    heights = [3.0, 0.6 + 0.28 * len(reached)]
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=heights)
    lines = []
    if len(plan.knots.p_HO):
        lines += above.plot(ms, 1e3 * np.linalg.norm(at.twist[:, :3], axis=1), color=BLUE, label="speed of the object")
        above.set_ylabel("speed (mm/s)")
        turning = above.twinx()
        spin = np.degrees(np.linalg.norm(at.twist[:, 3:], axis=1))
        lines += turning.plot(ms, spin, color="#7d3c98", linestyle="--", label="rate of turn")
        turning.set_ylabel("rate of turn (°/s)")
        turning.set_ylim(0.0, max(1.05 * float(spin.max()), 1e-3))
    else:
        lines += above.plot(ms, np.abs(at.v).max(axis=1), color=BLUE, label="quickest joint")
        above.set_ylabel("joint rate (rad/s)")
    above.set_ylim(bottom=0.0)
    above.grid(alpha=0.25)
    above.legend(handles=lines, frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for row, limit in enumerate(reached):
        spans = [(1e3 * a, max(1e3 * (b - a), 2e-3 * ms[-1])) for a, b in limit.spans(times)]
        below.broken_barh(spans, (row - 0.35, 0.7), color=_COLOURS[limit.kind])
    below.set_yticks(range(len(reached)), [str(limit) for limit in reached], fontsize=9)
    below.set_ylim(len(reached) - 0.4, -0.6)
    below.set_xlim(0.0, ms[-1])
    below.set_xlabel("time (ms)")
    below.grid(alpha=0.25, axis="x")
    below.set_title("what limits the move, and when", fontsize=10, loc="left")
    figure.suptitle(_title(plan))
    return figure


def _torques(plan: Plan, task: HandTask) -> Figure:
    """All motors as parts of what the plan may use of them."""
    hand = task.hand
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    ms = 1e3 * times
    names = [joint.name for joint in hand.joints]
    figure, panel = plot_torques(ms, plan.at(times).tau, hand.torque_lower, hand.torque_upper, names)
    panel.set_xlim(0.0, ms[-1])
    panel.set_ylabel("torque (% of what the plan may use)")
    panel.set_xlabel("time (ms)")
    figure.suptitle(f"{_title(plan)}: motor torques, the busiest by name")
    return figure


def _cones(plan: Plan, task: ObjectTask) -> Figure:
    """Each contact's load beside the friction that it has."""
    contacts = task.contacts
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    f, ms = contacts.pad(plan.at(times).f), 1e3 * times
    figure = Figure(figsize=(10, 2.2 * len(contacts) + 1.0), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(contacts), 1, sharex=True, sharey=True))
    for i, panel in enumerate(panels):
        most = contacts.mu[i] * f[:, i, friction.F_N]  # N
        load = most - friction.slip_margin(f[:, i], contacts.mu[i], contacts.gamma[i])
        panel.set_ylabel(f"{task.contact_names[i]} (N)")
        panel.fill_between(ms, 0.0, most, color=PALE, label="inside the cone, with the friction planned for")
        if task.slip_margin > 0.0:
            panel.plot(ms, most - task.slip_margin, color=GREY, linestyle="--", linewidth=1.0, label="less the slip margin")
        panel.plot(ms, f[:, i, friction.F_N], color=BLUE, label="normal force")
        panel.plot(ms, load, color=RED, label="load on friction")
        panel.grid(alpha=0.25)
    panels[0].set_ylim(bottom=0.0)
    panels[0].set_xlim(0.0, ms[-1])
    panels[-1].set_xlabel("time (ms)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{_title(plan)}: contact forces")
    return figure


def _rolling(plan: Plan, task: GraspTask) -> Figure:
    """How far each contact goes over the object, and how fast."""
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    at, ms = plan.at(times), 1e3 * times
    figure = Figure(figsize=(10, 5.0), layout="constrained")
    far, fast = figure.subplots(2, 1, sharex=True)
    speed = np.linalg.norm(at.p_OC_d, axis=2)  # m/s
    way = np.linalg.norm(at.p_OC - plan.knots.p_OC[0], axis=2)  # m
    for i in np.flatnonzero(task.is_rolling):
        (line,) = far.plot(ms, 1e3 * way[:, i], label=task.fingers[i])
        fast.plot(ms, 1e3 * speed[:, i], color=line.get_color())
    far.set_ylabel("from where it began (mm)")
    fast.set_ylabel("over the object (mm/s)")
    fast.set_xlabel("time (ms)")
    fast.set_xlim(0.0, ms[-1])
    for panel in (far, fast):
        panel.set_ylim(bottom=0.0)
        panel.grid(alpha=0.25)
    figure.legend(*far.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{_title(plan)}: where contacts roll")
    return figure
