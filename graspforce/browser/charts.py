"""Strip charts of a view: slip margins, forces, motor torques, errors, speeds, times of the controller, and temperatures."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from graspforce.browser.readings import Readings

MARGINS, TORQUE, ERROR, SPEED, STEP_TIME, TEMPERATURE = "margins", "torque", "error", "speed", "step", "winding"
FORCES, LEAST_MARGIN, JOINT_ERROR, TORQUE_ERROR = "forces", "least", "joints", "contact torque"
"""Names of charts."""

_TITLES = {
    MARGINS: "slip margin, N",
    TORQUE: "largest motor torque, % of its limit",
    ERROR: "position error, mm",
    SPEED: "speed of the object, mm/s",
    STEP_TIME: "controller's time, ms",
    TEMPERATURE: "hottest winding, °C",
    FORCES: "normal force, N",
    LEAST_MARGIN: "least slip margin, N",
    JOINT_ERROR: "largest joint error, °",
    TORQUE_ERROR: "largest error of a contact torque, N·m",
}
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
            values: one number for each line; a row of NaN is left out, because it would empty the chart.
        """
        if np.isnan(values).all():
            return
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
        names: the charts, of the names of this module.
    """

    def __init__(self, gui: Any, fingers: Sequence[str], span: float, names: Sequence[str]) -> None:
        with gui.add_folder("Charts"):
            self._charts = {
                name: StripChart(gui, _TITLES[name], fingers if name in (MARGINS, FORCES) else [name], span) for name in names
            }

    def add(self, readings: Readings) -> None:
        """Append the readings of an instant.

        Args:
            readings: the numbers.
        """
        for name, chart in self._charts.items():
            chart.add(readings.t, _values(name, readings))

    def draw(self) -> None:
        """Send the charts to the pages."""
        for chart in self._charts.values():
            chart.draw()

    def draw_all(self, readings: Sequence[Readings]) -> None:
        """Show the readings of a recording.

        Args:
            readings: of each step.
        """
        t = [each.t for each in readings]
        for name, chart in self._charts.items():
            chart.draw_all(t, [_values(name, each) for each in readings])


def _values(name: str, readings: Readings) -> list[float]:
    """Return the numbers of a chart at an instant."""
    if name == MARGINS:
        return [float(x) for x in readings.slip_margin]
    if name == FORCES:
        return [float(x) for x in readings.normal_force]
    if name == TORQUE:
        return [100.0 * float(readings.torque_use.max())]
    number = {
        ERROR: readings.position_error,
        SPEED: readings.speed,
        STEP_TIME: readings.step_time,
        TEMPERATURE: readings.temperature,
        LEAST_MARGIN: float(readings.slip_margin.min()) if len(readings.slip_margin) else np.nan,
        JOINT_ERROR: readings.joint_error,
        TORQUE_ERROR: readings.torque_error,
    }[name]
    return [number]
