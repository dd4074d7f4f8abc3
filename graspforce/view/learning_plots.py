"""Plots of synergies: variance, reconstruction errors, postures along components, and correlation with object sizes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.learning.object_size import SizeCorrelation
from graspforce.learning.posture_library import SIZE_COLUMNS
from graspforce.learning.synergies import Synergies
from graspforce.view.figures import BLUE, GREY, LINE_COLOURS, PALE, RED

_BINS = np.arange(-22.5, 25.0, 5.0)  # degrees, about -20, -15, … 20
_MAX_COMPONENTS = 10


def plot_cumulative_variance(synergies: Mapping[str, Synergies], fraction: float = 0.9) -> Figure:
    """Return a figure of the fraction of the variance that the first components explain.

    Args:
        synergies: synergies by the name of their library.
        fraction: fraction for which the title states the numbers of components.
    """
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    panel = figure.subplots()
    for colour, (name, each) in zip((*LINE_COLOURS, *LINE_COLOURS), synergies.items(), strict=False):
        values = np.concatenate([[0.0], each.cumulative_variance[:_MAX_COMPONENTS]])
        panel.plot(range(len(values)), 100.0 * values, marker="o", markersize=4, color=colour, label=name)
    panel.axhline(100.0 * fraction, color=GREY, linestyle="--", linewidth=1.0)
    panel.set_xlabel("number of components")
    panel.set_ylabel("explained variance (%)")
    panel.set_ylim(0.0, 102.0)
    panel.grid(alpha=0.25)
    panel.legend(frameon=False, fontsize=9)
    counts = [each.count_for(fraction) for each in synergies.values()]
    between = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    figure.suptitle(f"{between} components explain {100 * fraction:.0f} % of the variance")
    return figure


def plot_reconstruction_errors(errors: Mapping[str, Array], count: int) -> Figure:
    """Return a figure with the histograms of reconstruction errors.

    Args:
        errors: (N, n) errors of all postures and joints, rad, by the name of the library.
        count: number of components with which the postures were reconstructed.
    """
    figure = Figure(figsize=(3.2 * len(errors), 3.4), layout="constrained")
    panels = figure.subplots(1, len(errors), sharey=True, squeeze=False)[0]
    shares = []
    for panel, (name, error) in zip(panels, errors.items(), strict=True):
        degrees = np.degrees(error).ravel()
        shares.append(float((np.abs(degrees) <= 5.0).mean()))
        heights = 100.0 * np.histogram(np.clip(degrees, _BINS[0], _BINS[-1]), _BINS)[0] / len(degrees)
        panel.bar((_BINS[1:] + _BINS[:-1]) / 2.0, heights, width=4.2, color=BLUE)
        panel.set_title(f"{name}: {100 * shares[-1]:.0f} % within ±5°", fontsize=10)
        panel.set_xlabel("joint error (°), outer bins open")
        panel.grid(alpha=0.25, axis="y")
    panels[0].set_ylabel("joints (%)")
    figure.suptitle(f"Errors of reconstruction with {count} components")
    return figure


def plot_component_postures(hand: Hand, synergies: Synergies, components: int = 2, span: float = 2.0) -> Figure:
    """Return a figure of a hand's fingers in the mean posture and at both ends of its first components, from the side.

    Args:
        hand: the hand, whose joints the synergies have.
        synergies: the synergies.
        components: number of components, each a row.
        span: amplitude at the ends in standard deviations.
    """
    columns = [synergies.joints.index(joint.name) for joint in hand.joints]
    figure = Figure(figsize=(10, 3.6 * components), layout="constrained")
    rows = figure.subplots(components, 3, squeeze=False, subplot_kw={"projection": "3d"})
    for k, panels in enumerate(rows):
        for panel, factor in zip(panels, (-span, 0.0, span), strict=True):
            a = np.zeros(k + 1)
            a[k] = factor * np.sqrt(synergies.variances[k])
            q = np.clip(synergies.posture(a)[columns], hand.q_lower, hand.q_upper)
            _draw_fingers(panel, hand, q)
            name = "mean" if factor == 0.0 else f"component {k + 1}, {factor:+g} σ"
            panel.set_title(name, fontsize=10)
    handles = [f"{finger.name}" for finger in hand.fingers]
    lines = rows[0][0].get_lines()[: len(handles)]
    figure.legend(lines, handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    share = 100.0 * synergies.cumulative_variance[components - 1]
    figure.suptitle(f"{hand.name}: the first {components} components explain {share:.0f} % of the variance")
    return figure


def plot_size_correlation(name: str, correlation: SizeCorrelation, components: int = 5) -> Figure:
    """Return a figure of the correlation of components with the object's size; pale bars are not significant.

    Args:
        name: name of the library.
        correlation: the correlation.
        components: number of components shown.
    """
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    count = min(components, len(correlation.r))
    for j, panel in enumerate(panels):
        colours = [BLUE if one else PALE for one in correlation.significant[:count, j]]
        panel.bar(range(1, count + 1), correlation.r[:count, j], color=colours)
        panel.axhline(0.0, color=GREY, linewidth=0.8)
        panel.set_title(SIZE_COLUMNS[j], fontsize=10)
        panel.set_xlabel("component")
        panel.set_ylim(-1.0, 1.0)
        panel.grid(alpha=0.25, axis="y")
    panels[0].set_ylabel("correlation coefficient")
    dark = int(correlation.significant[:count].sum())
    figure.suptitle(
        f"{name}: {dark} of {3 * count} correlations are significant at {correlation.level:g}, N = {correlation.count}"
    )
    return figure


def _draw_fingers(panel: Axes, hand: Hand, q: Array) -> None:
    """Draw the chain of link origins of each finger in H, with equal scales."""
    poses = hand.link_poses(q)
    for i, finger in enumerate(hand.fingers):
        links = [joint.child for joint in hand.urdf.chain(finger.tip)]
        points = 1e3 * np.array([poses[hand.urdf.root][0], *(poses[link][0] for link in links)])  # mm
        colour = LINE_COLOURS[i % len(LINE_COLOURS)]
        panel.plot(*points.T, color=colour, linewidth=2.0, marker="o", markersize=3)
    for axis in ("x", "y", "z"):
        getattr(panel, f"set_{axis}ticklabels")([])
    panel.set_aspect("equal")
    panel.plot([0.0], [0.0], [0.0], color=RED, marker="s", markersize=4)
