"""Figures 11 to 13 of e_GRASP in kind.

The figures of the source have no numbers, and its recordings are not published; these are of the same kinds, on data that are
generated here. *Figure 11*: the joint-space output of the network of the paper, fitted to 500 patterns, for the second finger
on another path, with its error. *Figure 12*: memberships of the fuzzy rules that learn the squeeze, evenly placed, and adapted
to 1500 runs by k-means. *Figure 13*: the training patterns of the network, each input and output divided by its largest
deviation from the mean.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.learning.squeeze import rule_centres, simulated_runs
from benchmarks.learning.start_values import PATTERNS, STEP, carry_patterns
from graspforce.core.arrays import Array
from graspforce.learning.inverse_kinematics import fit_network
from graspforce.learning.squeeze import FEATURES
from graspforce.view.figures import GREY, LINE_COLOURS, save_figures

TITLE = "Learners of e_GRASP"
_FINGER = slice(3, 6)  # outputs of the second finger
_RUNS = 1500
_CONSTANT = 1e-12  # largest deviation of an input that does not change
_SHOWN = 300  # patterns of the other path


def run(_records: Path, pictures: Path) -> dict[str, Any]:
    """Fit the learners, and draw the figures.

    Args:
        pictures: folder of the pictures.
    """
    x, y = carry_patterns(0.004, (0.5, 0.8), PATTERNS)
    other_x, other_y = carry_patterns(0.003, (0.7, 0.45), _SHOWN)
    predicted = fit_network(x, y).predict(other_x)
    features = simulated_runs(_RUNS).x
    save_figures(
        {
            "network_output": _output(other_y[:, _FINGER], predicted[:, _FINGER]),
            "memberships": _memberships(features),
            "training_patterns": _training(x, y),
        },
        pictures,
    )
    error = predicted[:, _FINGER] - other_y[:, _FINGER]
    return {
        "rms": float(np.degrees(np.sqrt(np.square(error).mean()))),
        "largest": float(np.degrees(np.abs(error).max())),
        "motion": float(np.degrees(np.sqrt(np.square(other_y[:, _FINGER]).mean()))),
    }


def _output(actual: Array, predicted: Array) -> Figure:
    """Return the joint changes of a finger, those of the network, and the error."""
    figure = Figure(figsize=(8, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    t = STEP * np.arange(len(actual))
    for j, colour in zip(range(actual.shape[1]), LINE_COLOURS, strict=False):
        above.plot(t, np.degrees(actual[:, j]), color=colour, linewidth=3.0, alpha=0.35, label=f"joint {j + 1}, actual")
        above.plot(t, np.degrees(predicted[:, j]), color=colour, linewidth=1.0, label=f"joint {j + 1}, network")
        below.plot(t, np.degrees(predicted[:, j] - actual[:, j]), color=colour, linewidth=1.0)
    above.set_ylabel("joint change in 10 ms (°)")
    above.legend(frameon=False, ncols=3, fontsize=8)
    below.set(xlabel="time (s)", ylabel="error (°)")
    for panel in (above, below):
        panel.grid(alpha=0.25)
    figure.suptitle("Second finger on another path: joint space and network")
    return figure


def _memberships(x: Array) -> Figure:
    """Return the memberships of the rules along each feature, before and after their adaptation."""
    scaled = (x - x.mean(axis=0)) / x.std(axis=0)
    centres = rule_centres(x, 0)
    count = min(3, x.shape[1])
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    rows = figure.subplots(2, count, sharex="col", sharey=True, squeeze=False)
    for k in range(count):
        z = np.linspace(scaled[:, k].min(), scaled[:, k].max(), 200)
        even = np.linspace(z[0], z[-1], len(centres))
        for panel, places in ((rows[0][k], even), (rows[1][k], np.sort(centres[:, k]))):
            for place in places:
                panel.plot(z, np.exp(-0.5 * np.square(z - place)), color=GREY, linewidth=0.8)
            panel.plot(places, np.ones(len(places)), "|", color=LINE_COLOURS[0], markersize=10)
            panel.grid(alpha=0.25)
        rows[0][k].set_title(FEATURES[k], fontsize=10)
        rows[1][k].set_xlabel("standard deviations")
    rows[0][0].set_ylabel("evenly placed")
    rows[1][0].set_ylabel("adapted")
    figure.suptitle(f"Memberships of {len(centres)} fuzzy rules")
    return figure


def _training(x: Array, y: Array) -> Figure:
    """Return the training patterns as pictures: a row for each input and output."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True, height_ratios=(x.shape[1], y.shape[1]))
    for panel, values, name in zip(panels, (x, y), ("input", "output"), strict=True):
        centred = values - values.mean(axis=0)
        scale = np.abs(centred).max(axis=0)
        picture = np.where(scale > _CONSTANT, centred / np.maximum(scale, _CONSTANT), 0.0).T
        shown = panel.imshow(picture, aspect="auto", cmap="RdBu", vmin=-1.0, vmax=1.0, interpolation="nearest")
        panel.set_ylabel(name)
        panel.set_yticks(range(0, values.shape[1], 3))
    panels[1].set_xlabel("pattern")
    figure.colorbar(shown, ax=list(panels), label="deviation from the mean, of its largest", shrink=0.8)
    figure.suptitle(f"{len(x)} training patterns: {x.shape[1]} inputs, {y.shape[1]} outputs")
    return figure


def page(result: dict[str, Any]) -> str:
    """Return the pictures.

    Args:
        result: of `run`.
    """
    text = (
        f"The network's error is {result['rms']:.4f}° RMS and {result['largest']:.4f}° at most, "
        f"for joint changes of {result['motion']:.4f}° RMS."
    )
    names = ("network_output", "memberships", "training_patterns")
    pictures = "\n\n".join(f"![{name.replace('_', ' ')}](learning/{name}.png)" for name in names)
    return f"{text}\n\n{pictures}"
