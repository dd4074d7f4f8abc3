"""Strip charts of a view: slip margins, motor torques, position error and the controller's time."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from graspforce.browser.readings import Readings

_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9")  # Okabe and Ito: safe for colour-blind readers
_HEIGHT = 120  # pixels
_LARGEST = 2000  # points of a chart


class StripChart:
    """A chart of numbers over time.

    Args:
        gui: of viser.
        title: what is shown, with the unit.
        names: name of each line.
        span: time that the chart shows, s.
    """

    def __init__(self, gui: Any, title: str, names: Sequence[str], span: float) -> None:
        from viser import uplot

        self._span, self._rows = span, deque[tuple[float, ...]](maxlen=_LARGEST)
        lines = [
            uplot.Series(label=name, stroke=_COLOURS[i % len(_COLOURS)], width=1.5, points=uplot.Series_Points(show=False))
            for i, name in enumerate(names)
        ]
        empty = tuple(np.zeros(1) for _ in range(len(names) + 1))
        axes = (uplot.Axis(label="s", size=32, labelSize=14), uplot.Axis(size=44))
        self._chart = gui.add_uplot(
            data=empty, series=(uplot.Series(label="t"), *lines), title=title, axes=axes, height=_HEIGHT,
            scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
        )  # fmt: skip

    def add(self, t: float, values: Sequence[float]) -> None:
        """Append a row, and forget those that are older than the span.

        Args:
            t: time, s; an earlier one than the last begins the chart anew.
            values: one number for each line.
        """
        if self._rows and t <= self._rows[-1][0]:
            self._rows.clear()
        self._rows.append((t, *values))
        while self._rows[0][0] < t - self._span:
            self._rows.popleft()

    def draw(self) -> None:
        """Send the chart to the pages."""
        if self._rows:
            self._chart.data = tuple(np.ascontiguousarray(column) for column in np.array(self._rows).T)

    def draw_all(self, t: Sequence[float], rows: Sequence[Sequence[float]]) -> None:
        """Show all rows of a recording, thinned to the largest number of points.

        Args:
            t: times, s.
            rows: numbers at these times.
        """
        step = max(1, len(t) // _LARGEST)
        columns = np.array(rows, dtype=float)[::step].T
        self._chart.data = (np.ascontiguousarray(np.asarray(t, dtype=float)[::step]), *map(np.ascontiguousarray, columns))


class Charts:
    """The charts of a grasp.

    Args:
        gui: of viser.
        fingers: names of the fingers in contact.
        span: time that the charts show, s.
        shows_step_time: whether the controller's time is measured.
    """

    def __init__(self, gui: Any, fingers: Sequence[str], span: float, shows_step_time: bool) -> None:
        with gui.add_folder("Charts"):
            self._margins = StripChart(gui, "slip margin, N", fingers, span)
            self._torques = StripChart(gui, "largest motor torque, % of its limit", ["torque"], span)
            self._error = StripChart(gui, "position error, mm", ["error"], span)
            self._time = StripChart(gui, "controller's time, ms", ["step"], span) if shows_step_time else None

    def add(self, readings: Readings) -> None:
        """Append the readings of an instant.

        Args:
            readings: the numbers.
        """
        self._margins.add(readings.t, readings.slip_margin.tolist())
        self._torques.add(readings.t, [100.0 * float(readings.torque_use.max())])
        self._error.add(readings.t, [readings.position_error])
        if self._time is not None:
            self._time.add(readings.t, [readings.step_time])

    def draw(self) -> None:
        """Send the charts to the pages."""
        for chart in (self._margins, self._torques, self._error, self._time):
            if chart is not None:
                chart.draw()

    def draw_all(self, readings: Sequence[Readings]) -> None:
        """Show the readings of a recording.

        Args:
            readings: of each step.
        """
        t = [each.t for each in readings]
        self._margins.draw_all(t, [each.slip_margin.tolist() for each in readings])
        self._torques.draw_all(t, [[100.0 * float(each.torque_use.max())] for each in readings])
        self._error.draw_all(t, [[each.position_error] for each in readings])
