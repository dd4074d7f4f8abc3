"""Parts that plots of runs and plans share: colours, motor torques, and saving figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from graspforce.core.arrays import Array
from graspforce.core.whole_file import replace_file

# Distinguishable with colour-blindness (Okabe and Ito 2008), for lines that need no meaning of their own.
LINE_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
BLUE, RED, GREEN, AMBER, PURPLE = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7"  # of the same colours
GREY, PALE = "#888888", "#dddddd"
_OTHER_COLOUR = "#cccccc"  # of motors without a label
_MAX_NAMED = len(LINE_COLOURS)  # motors with a label


def plot_torques(t: Array, tau: Array, lower: Array, upper: Array, names: Sequence[str]) -> tuple[Figure, Axes]:
    """Plot all motor torques in percent of their limits, with labels for the most loaded. The caller sets labels and title.

    Args:
        t: (T,) instants, in the unit of the time axis.
        tau: (T, n) motor torques, N·m.
        lower: (n,) lower limits of the motors, N·m.
        upper: (n,) upper limits of the motors, N·m.
        names: (n,) names of the motors.
    """
    share = 100.0 * tau / np.where(tau >= 0.0, upper, -lower)  # %
    busiest = np.argsort(-np.abs(share).max(axis=0))[:_MAX_NAMED]
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    panel = figure.subplots()
    for i in range(len(names)):
        if i not in busiest:
            panel.plot(t, share[:, i], color=_OTHER_COLOUR, linewidth=0.8)
    for colour, i in zip(LINE_COLOURS, busiest, strict=False):  # a hand may have fewer motors than colours
        panel.plot(t, share[:, i], color=colour, label=f"{names[i]} ({upper[i]:.3g} N·m)")
    for limit in (-100.0, 100.0):
        panel.axhline(limit, color=RED, linestyle="--", linewidth=1.0)
    panel.set_ylim(-110.0, 110.0)
    panel.grid(alpha=0.25)
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    return figure, panel


def save_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write figures as PNG into a folder, which is created if missing, and return the files.

    Args:
        figures: the figures by file name without suffix.
        folder: the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, figure in figures.items():
        FigureCanvasAgg(figure)
        written.append(folder / f"{name}.png")
        with replace_file(written[-1]) as temporary:
            figure.savefig(temporary, dpi=130)
    return written
