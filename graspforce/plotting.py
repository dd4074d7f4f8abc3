"""What all plots of runs and of plans share: their colours, and how they come into a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

BLUE, RED, GREEN, GREY, PALE = "#1f4e8c", "#c0392b", "#2e8b57", "#888888", "#dddddd"


def write(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write figures as PNG, each under its name, into a folder that is made where it is not there; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, figure in figures.items():
        FigureCanvasAgg(figure)
        written.append(folder / f"{name}.png")
        figure.savefig(written[-1], dpi=130)
    return written
