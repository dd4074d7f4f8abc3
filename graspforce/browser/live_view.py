"""The view of a running simulation, with controls: pause, stop, desired pose and squeeze."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from graspforce.browser.browser_scene import BrowserScene, ViewAddress
from graspforce.browser.charts import ERROR, MARGINS, STEP_TIME, TEMPERATURE, TORQUE, Charts
from graspforce.browser.readings import Readings
from graspforce.core.arrays import Array, freeze
from graspforce.simulation.rendering.display_model import DisplayModel
from graspforce.simulation.rendering.marks import SceneState

_CHART_PERIOD = 0.2  # s between two drawings of the charts
_SPAN = 10.0  # s that the charts show
_LARGEST_MOVE, _LARGEST_TURN = 15.0, 20.0  # mm and degrees, of the sliders
_LARGEST_MARGIN = 3.0  # N
_POLL = 0.02  # s


class LiveView:
    """A web page that follows a simulation and steers it.

    Args:
        display: the model to show.
        title: heading of the panel.
        slip_margin: slip margin of the controller at the start, N; None for a controller whose margin cannot be changed.
        address: where the page is served.

    Raises:
        MissingLibrary: viser is not installed.
    """

    def __init__(
        self, display: DisplayModel, title: str, slip_margin: float | None, address: ViewAddress | None = None
    ) -> None:
        self.scene = BrowserScene(display, title, address)
        gui = self.scene.server.gui
        self._running, self._stopped = threading.Event(), threading.Event()
        self._running.set()
        self._status = gui.add_markdown(f"**{title}**")
        self._pause = gui.add_button("Pause")
        self._pause.on_click(lambda _: self._toggle_pause())
        gui.add_button("Stop", color="red").on_click(lambda _: self._stop())
        with gui.add_folder("Desired pose"):
            self._sliders = [_slider(gui, f"{axis}, mm", _LARGEST_MOVE) for axis in "xyz"]
            self._sliders += [_slider(gui, f"turn about {axis}, °", _LARGEST_TURN) for axis in "xyz"]
            gui.add_button("Back to the start").on_click(lambda _: self._reset_pose())
        self._margin: Any = None
        if slip_margin is not None:
            largest = max(_LARGEST_MARGIN, 2.0 * slip_margin)
            with gui.add_folder("Squeeze"):
                self._margin = gui.add_slider("slip margin, N", min=0.0, max=largest, step=0.05, initial_value=slip_margin)
        heat = (TEMPERATURE,) if display.scene.grasp.hand.drives.has_thermal_data else ()
        self._charts = Charts(gui, display.scene.grasp.fingers, _SPAN, (MARGINS, TORQUE, ERROR, STEP_TIME, *heat))
        self._last_drawn = -np.inf

    @property
    def status(self) -> str:
        """Text above the controls: time, error, motions of the fingers, warning."""
        return str(self._status.content)

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.scene.url

    @property
    def is_stopped(self) -> bool:
        """Whether somebody clicked on Stop."""
        return self._stopped.is_set()

    @property
    def offset(self) -> Array:
        """(6,) wanted change of the desired pose in H: translation, m, and rotation vector, rad."""
        values = [slider.value for slider in self._sliders]
        return freeze([*(1e-3 * np.array(values[:3])), *np.radians(values[3:])])

    @property
    def slip_margin(self) -> float | None:
        """Wanted slip margin, N; None without a slider for it."""
        return None if self._margin is None else float(self._margin.value)

    def wait_while_paused(self) -> None:
        """Return at once, or after the end of a pause."""
        while not self._running.wait(_POLL) and not self.is_stopped:
            pass

    def show(self, state: SceneState, readings: Readings) -> None:
        """Show a state and its numbers.

        Args:
            state: the state.
            readings: the numbers.
        """
        self.scene.show(state)
        self._charts.add(readings)
        if time.monotonic() - self._last_drawn >= _CHART_PERIOD:
            self._last_drawn = time.monotonic()
            self._charts.draw()
            warning = f"  \n⚠ {readings.warnings[0]}" if readings.warnings else ""
            motions = f"  \n{readings.motion_text}" if readings.motions else ""
            load = "" if state.load is None else f"  \n{state.load.text}"
            self._status.content = f"{readings.text}{load}{motions}{warning}"

    def close(self) -> None:
        """Close the page."""
        self.scene.close()

    def _toggle_pause(self) -> None:
        """Pause the simulation, or let it continue."""
        if self._running.is_set():
            self._running.clear()
            self._pause.label = "Continue"
        else:
            self._pause.label = "Pause"
            self._running.set()

    def _stop(self) -> None:
        """Ask the simulation to end."""
        self._stopped.set()
        self._status.content = "stopped"

    def _reset_pose(self) -> None:
        """Set the desired pose back to the start."""
        for slider in self._sliders:
            slider.value = 0.0


def _slider(gui: Any, name: str, largest: float) -> Any:
    """Return a slider from −largest to largest."""
    return gui.add_slider(name, min=-largest, max=largest, step=0.1, initial_value=0.0)
