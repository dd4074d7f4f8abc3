"""The view of a recording or a plan, with a timeline to scrub."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from graspforce.browser.browser_scene import BrowserScene, ViewAddress
from graspforce.browser.charts import Charts
from graspforce.browser.footage import planned_footage, recorded_footage
from graspforce.planning.plan import Plan
from graspforce.simulation.plants.scene import Scene
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.rendering.display_model import DisplayModel

_RATE = 30.0  # pictures per second
_SPEEDS = ("0.01 ×", "0.1 ×", "0.25 ×", "0.5 ×", "1 ×", "2 ×")
_SLOW = 1.0  # s: shorter motions begin at the lowest speed
_STEPS = 1000  # of the timeline


class Playback:
    """A web page that plays a recording or a plan.

    Args:
        scene: scene of the grasp, with which the motion begins.
        source: the recording, or the plan.
        address: where the page is served.

    Raises:
        MissingLibrary: viser is not installed.
    """

    def __init__(self, scene: Scene, source: Recording | Plan, address: ViewAddress | None = None) -> None:
        is_plan = isinstance(source, Plan)
        self._footage = planned_footage(scene, source) if isinstance(source, Plan) else recorded_footage(scene, source)
        footage, end = self._footage, float(self._footage.t[-1])
        self.view = BrowserScene(DisplayModel(scene), footage.title, address)
        gui = self.view.server.gui
        self._status = gui.add_markdown(f"**{footage.title}**")
        self._timeline: Any = gui.add_slider("time, s", min=0.0, max=end, step=end / _STEPS, initial_value=0.0)
        self._play = gui.add_button("Play")
        self._play.on_click(lambda _: self._toggle_play())
        self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value=_SPEEDS[0] if is_plan and end < _SLOW else "1 ×")
        Charts(gui, scene.grasp.fingers, end, footage.charts).draw_all(footage.readings)
        self._is_playing, self._shown, self._is_closed = False, -1, False
        self._lock = threading.Lock()  # the page closes between two updates
        self.update()

    @property
    def status(self) -> str:
        """Text above the controls: time, error, motions of the fingers, warning."""
        return str(self._status.content)

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.view.url

    def update(self) -> None:
        """Show the step at the timeline's time, unless it is shown already."""
        footage = self._footage
        row = int(np.searchsorted(footage.t, float(self._timeline.value), side="right")) - 1
        if row == self._shown:
            return
        self._shown = row
        state = footage.state(row)
        self.view.show(state)
        if footage.desired is not None:
            self.view.show_desired(*footage.desired(row))
        self._status.content = footage.status(row) + ("" if state.load is None else f"  \n{state.load.text}")

    def run(self, duration: float = np.inf) -> None:
        """Play and follow the timeline until `close`.

        Args:
            duration: time after which this ends, s.
        """
        end, last = float(self._footage.t[-1]), time.monotonic()
        start = due = last
        while time.monotonic() - start < duration:
            now = time.monotonic()
            with self._lock:
                if self._is_closed:
                    return
                if self._is_playing:
                    t = float(self._timeline.value) + float(self._speed.value.split()[0]) * (now - last)
                    self._timeline.value = t if t < end else 0.0
                self.update()
            last = now
            due = max(due + 1.0 / _RATE, now)  # without drift
            time.sleep(max(due - time.monotonic(), 0.0))

    def close(self) -> None:
        """Close the page, and end `run`."""
        with self._lock:
            self._is_closed = True
        self.view.close()

    def _toggle_play(self) -> None:
        """Play the recording, or hold it."""
        self._is_playing = not self._is_playing
        self._play.label = "Hold" if self._is_playing else "Play"
