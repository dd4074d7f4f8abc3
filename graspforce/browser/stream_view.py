"""The view of a running stream: it follows the stream, pauses, and goes back through the last minute."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from graspforce.browser.browser_scene import BrowserScene, ViewAddress
from graspforce.browser.charts import Charts
from graspforce.browser.readings import Readings
from graspforce.core.arrays import Array
from graspforce.simulation.rendering.display_model import DisplayModel
from graspforce.simulation.rendering.marks import SceneState

_CHART_PERIOD = 0.2  # s between two drawings of the charts and the numbers
_SPAN = 10.0  # s that the charts show
_HISTORY = 60.0  # s to go back through
_KEPT = 1800  # states of the history


class StreamView:
    """A web page that shows a running stream, and steers nothing.

    Args:
        display: the model to show.
        title: heading of the panel.
        charts: names of the charts, of `graspforce.browser.charts`.
        address: where the page is served.

    Raises:
        MissingLibrary: viser is not installed.
    """

    def __init__(self, display: DisplayModel, title: str, charts: Sequence[str], address: ViewAddress | None = None) -> None:
        self.scene = BrowserScene(display, title, address)
        gui = self.scene.server.gui
        self._title = title
        self._status = gui.add_markdown(f"**{title}**  \nwaiting for states")
        self._pause = gui.add_button("Pause")
        self._pause.on_click(lambda _: self._toggle_pause())
        self._back: Any = gui.add_slider("back, s", min=0.0, max=_HISTORY, step=0.05, initial_value=0.0)
        self._back.disabled = True
        self._charts = Charts(gui, display.scene.grasp.fingers, _SPAN, charts)
        self._history: deque[tuple[SceneState, tuple[Array, Array] | None, Readings]] = deque(maxlen=_KEPT)
        self._is_paused, self._last_drawn, self._shown = False, -np.inf, -1

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.scene.url

    def show(self, state: SceneState, desired: tuple[Array, Array] | None, readings: Readings) -> None:
        """Show a state and its numbers; while the page is paused, nothing is kept.

        Args:
            state: the state.
            desired: (3,) desired position, m, and (3, 3) orientation of the object in H; None without.
            readings: the numbers.
        """
        if self._is_paused:
            return
        if self._history and state.t <= self._history[-1][0].t:  # the driver has started again
            self._history.clear()
        self._history.append((state, desired, readings))
        self._charts.add(readings)
        now = time.monotonic()
        is_due = now - self._last_drawn >= _CHART_PERIOD
        with self.scene.server.atomic():  # one message to the pages
            self._draw(-1, is_due)
            if is_due:
                self._last_drawn = now
                self._charts.draw()

    def update(self) -> None:
        """While the page is paused, show the state at the slider's time."""
        if not self._is_paused or not self._history:
            return
        wanted = self._history[-1][0].t - float(self._back.value)
        row = max(int(np.searchsorted([each[0].t for each in self._history], wanted, side="right")) - 1, 0)
        if row != self._shown:
            self._shown = row
            self._draw(row)

    def note(self, text: str) -> None:
        """Show a text in place of the numbers.

        Args:
            text: the text.
        """
        self._status.content = f"**{self._title}**  \n{text}"

    def close(self) -> None:
        """Close the page."""
        self.scene.close()

    def _draw(self, row: int, has_text: bool = True) -> None:
        """Show a row of the history, with its numbers or without."""
        state, desired, readings = self._history[row]
        self.scene.show(state)
        if desired is not None:
            self.scene.show_desired(*desired)
        if not has_text:
            return
        warning = f"  \n⚠ {readings.warnings[0]}" if readings.warnings else ""
        load = "" if state.load is None else f"  \n{state.load.text}"
        self._status.content = f"{readings.text}{load}{warning}"

    def _toggle_pause(self) -> None:
        """Pause the picture, or follow the stream again."""
        self._is_paused = not self._is_paused
        self._pause.label = "Follow" if self._is_paused else "Pause"
        self._back.value, self._back.disabled, self._shown = 0.0, not self._is_paused, -1
