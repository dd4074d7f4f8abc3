"""Plots of a hand: workspaces of its fingertips, and their mobility along the ranges of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from graspforce.hand.hand import Hand
from graspforce.hand.workspace import JointSweep, TipMeasures, speed_unit
from graspforce.view.figures import GREY, LINE_COLOURS, save_figures

_VIEWS = ((0, 2, "front"), (1, 2, "side"), (0, 1, "top"))  # axes of H across the view, and its name
_ROUNDING = 1e-9  # of σ_min in its unit
_MAX_POINTS = 4000  # of each finger, so that all fingers can be seen


def save_hand_plots(
    hand: Hand, workspaces: Sequence[TipMeasures], sweeps: Sequence[tuple[JointSweep, ...]], folder: Path
) -> list[Path]:
    """Write workspace.png, and mobility_FINGER.png for each finger, and return the files.

    Args:
        hand: the hand.
        workspaces: a sample of each finger's workspace.
        sweeps: the sweeps of each finger's joints.
        folder: the folder; created if missing.
    """
    figures = {"workspace": plot_workspace(hand, workspaces)}
    figures.update({f"mobility_{each[0].tip.finger}": plot_joint_sweeps(hand, each) for each in sweeps})
    return save_figures(figures, folder)


def plot_workspace(hand: Hand, workspaces: Sequence[TipMeasures]) -> Figure:
    """Return a figure of the points that fingertips reach, from three sides, with the hand in its neutral posture.

    Args:
        hand: the hand.
        workspaces: a sample of each finger's workspace.
    """
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    for panel, (across, up, name) in zip(figure.subplots(1, 3), _VIEWS, strict=True):
        for i, each in enumerate(workspaces):
            p = 1e3 * each.p_HF[:_MAX_POINTS]  # mm
            colour = LINE_COLOURS[i % len(LINE_COLOURS)]
            panel.scatter(p[:, across], p[:, up], s=1.0, color=colour, alpha=0.25, linewidths=0, rasterized=True)
            if panel.get_subplotspec().colspan.start == 0:
                panel.scatter([], [], s=20, color=colour, label=f"{each.finger}: {1e6 * each.hull_volume:.0f} cm³")
        _draw_skeleton(panel, hand, across, up)
        panel.set_aspect("equal")
        panel.set_xlabel(f"{'xyz'[across]} in H (mm)")
        panel.set_ylabel(f"{'xyz'[up]} in H (mm)")
        panel.set_title(name, fontsize=10)
        panel.grid(alpha=0.25)
    figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    largest = max(workspaces, key=lambda each: each.hull_volume)
    volume = f"{1e6 * largest.hull_volume:.0f} cm³"
    figure.suptitle(f"{hand.name}: where the fingertips can be; the {largest.finger} has the largest hull, {volume}")
    return figure


def plot_joint_sweeps(hand: Hand, sweeps: Sequence[JointSweep]) -> Figure:
    """Return a figure of σ_min and manipulability of a fingertip while each joint moves through its range.

    Args:
        hand: the hand.
        sweeps: the sweeps of one finger's joints.
    """
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    directions = min(3, len(sweeps))
    factor, unit = speed_unit(hand, sweeps[0].tip.finger)
    for colour, each in zip((*LINE_COLOURS, *LINE_COLOURS), sweeps, strict=False):
        share = 100.0 * (each.x - each.x[0]) / (each.x[-1] - each.x[0])  # %
        left.plot(share, factor * each.tip.min_singular_value, color=colour, label=_range_text(hand, each))
        right.plot(share, factor**directions * each.tip.manipulability, color=colour)
    left.set_ylabel(f"σ_min: slowest direction ({unit})")
    right.set_ylabel(f"manipulability (({unit}){'¹²³'[directions - 1]})")
    for panel in (left, right):
        panel.set_xlabel("position in the joint's range (%)")
        panel.set_ylim(bottom=0.0)
        panel.grid(alpha=0.25)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    worst = min(sweeps, key=lambda each: each.tip.min_singular_value.min())
    value = factor * worst.tip.min_singular_value.min()
    least = f"{value:.2g} {unit}" if value > _ROUNDING else f"0 {unit}: a singular posture"
    figure.suptitle(f"{hand.name}, {sweeps[0].tip.finger}: the tip moves slowest along the range of {worst.joint}, {least}")
    return figure


def _range_text(hand: Hand, sweep: JointSweep) -> str:
    """Return a joint with its range in degrees or millimetres."""
    joint = next(each for each in hand.joints if each.name == sweep.joint)
    factor, unit = (1e3, " mm") if joint.is_prismatic else (np.degrees(1.0), "°")
    return f"{joint.name}: {factor * sweep.x[0]:.0f}{unit} to {factor * sweep.x[-1]:.0f}{unit}"


def _draw_skeleton(panel: Axes, hand: Hand, across: int, up: int) -> None:
    """Draw the chain of link origins of each finger in the neutral posture."""
    poses = hand.link_poses(hand.neutral)
    for finger in hand.fingers:
        links = [joint.child for joint in hand.urdf.chain(finger.tip)]
        points = 1e3 * np.array([poses[hand.urdf.root][0], *(poses[link][0] for link in links)])  # mm
        panel.plot(points[:, across], points[:, up], color=GREY, linewidth=1.2, marker="o", markersize=2.5, zorder=3)
