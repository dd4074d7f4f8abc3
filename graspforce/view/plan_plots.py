"""Plots of a plan: speed and active limits, motor torques, contact forces in their cones, and rolling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from graspforce.contact import friction
from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.planning.limit_usage import FRICTION, MOTOR, NORMAL, SPEED, limit_usage
from graspforce.planning.plan import Plan
from graspforce.planning.task import GraspTask, HandTask, ObjectTask
from graspforce.view.figures import AMBER, BLUE, GREEN, GREY, PURPLE, RED, plot_torques, save_figures

_COLOURS = {MOTOR: BLUE, SPEED: GREEN, FRICTION: RED, NORMAL: AMBER}
_SAMPLES = 600
_ROUNDING = 1e-9
_MAX_LIMITS = 12  # limits shown, the longest first


def save_plots(plan: Plan, folder: Path, hand: Hand | None = None) -> list[Path]:
    """Write speed.png; torques.png with a hand, cones.png with an object, rolling.png if contacts roll.

    Args:
        plan: the plan.
        folder: the folder; created if missing.
        hand: the hand with its whole torque limits, of which torques are in %; None for that of the plan's task.

    Returns:
        The files.
    """
    figures = {"speed": plot_plan(plan)}
    if isinstance(plan.task, HandTask):
        figures["torques"] = _torques(plan, plan.task, plan.task.hand if hand is None else hand)
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
        lines += turning.plot(ms, spin, color=PURPLE, linestyle="--", label="rate of turn")
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


def _torques(plan: Plan, task: HandTask, hand: Hand) -> Figure:
    """All motors in % of their limits, with a line for the part that the plan may use."""
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    ms = 1e3 * times
    names = [joint.name for joint in hand.joints]
    figure, panel = plot_torques(ms, plan.at(times).tau, hand.torque_lower, hand.torque_upper, names)
    with np.errstate(divide="ignore", invalid="ignore"):
        allowed = float(np.nan_to_num(task.hand.torque_upper / hand.torque_upper, nan=1.0, posinf=1.0).min())
    if allowed < 1.0 - _ROUNDING:
        for side in (-100.0, 100.0):
            panel.axhline(side * allowed, color=GREY, linestyle=":", linewidth=1.0)
    panel.set_xlim(0.0, ms[-1])
    panel.set_ylabel("torque (% of the motor's limit)")
    panel.set_xlabel("time (ms)")
    note = f"; the plan may use {100.0 * allowed:.0f} %" if allowed < 1.0 - _ROUNDING else ""
    figure.suptitle(f"{_title(plan)}: motor torques{note}")
    return figure


def _cones(plan: Plan, task: ObjectTask) -> Figure:
    """Each contact's use of friction in %, with what the slip margin leaves of it, and its normal force."""
    contacts = task.contacts
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    f, ms = contacts.pad(plan.at(times).f), 1e3 * times
    figure = Figure(figsize=(10, 2.0 * len(contacts) + 1.0), layout="constrained")
    rows = figure.subplots(len(contacts), 2, sharex=True, sharey="col", squeeze=False)
    for i, (use, force) in enumerate(rows):
        bound = contacts.mu[i] * f[:, i, friction.F_N]  # N
        margin = friction.slip_margin(f[:, i], contacts.mu[i], contacts.gamma[i])
        use.plot(ms, _percent_used(margin, bound), color=GREEN, label="friction in use")
        use.axhline(100.0, color=RED, linewidth=1.0, label="the finger slips")
        if task.slip_margin > 0.0:
            left = _percent_used(np.full_like(bound, task.slip_margin), bound)
            use.plot(ms, left, color=GREY, linestyle="--", linewidth=1.0, label="less the slip margin")
        force.plot(ms, f[:, i, friction.F_N], color=BLUE, label="normal force")
        use.set_ylabel(f"{task.contact_names[i]}\nuse of friction (%)")
        force.set_ylabel("force (N)")
        for panel in (use, force):
            panel.grid(alpha=0.25)
    rows[0, 0].set_ylim(0.0, 105.0)
    rows[0, 1].set_ylim(bottom=0.0)
    rows[0, 0].set_xlim(0.0, ms[-1])
    for panel in rows[-1]:
        panel.set_xlabel("time (ms)")
    handles, labels = (a + b for a, b in zip(*(each.get_legend_handles_labels() for each in rows[0]), strict=True))
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{_title(plan)}: contact forces")
    return figure


def _percent_used(margin: Array, bound: Array) -> Array:
    """Return the part of friction in use, %: 100 (1 − margin / bound), from 0; 100 without normal force."""
    used = 100.0 - 100.0 * np.divide(margin, bound, out=np.zeros_like(bound), where=bound > 0.0)
    return np.asarray(np.maximum(used, 0.0))


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
