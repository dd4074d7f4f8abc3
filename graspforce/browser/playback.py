"""The view of a recording, with a timeline to scrub."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from graspforce.browser.browser_scene import BrowserScene, ViewAddress
from graspforce.browser.charts import Charts
from graspforce.browser.readings import Readings
from graspforce.learning.actions.labels import labels_at
from graspforce.simulation.plants.scene import Scene
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.rendering.display_model import DisplayModel
from graspforce.simulation.rendering.marks import recorded_state

_RATE = 30.0  # pictures per second
_SPEEDS = ("0.1 ×", "0.25 ×", "0.5 ×", "1 ×", "2 ×")


class Playback:
    """A web page that plays a recording.

    Args:
        scene: scene of the recorded grasp.
        recording: the recording.
        address: where the page is served.

    Raises:
        MissingLibrary: viser is not installed.
    """

    def __init__(self, scene: Scene, recording: Recording, address: ViewAddress | None = None) -> None:
        title = f"{recording.hand}, {recording.t[-1]:.2f} s"
        self.view = BrowserScene(DisplayModel(scene), title, address)
        self._scene, self._recording = scene, recording
        gui, end = self.view.server.gui, float(recording.t[-1])
        self._status = gui.add_markdown(f"**{title}**")
        self._timeline: Any = gui.add_slider("time, s", min=0.0, max=end, step=end / 1000.0, initial_value=0.0)
        self._play = gui.add_button("Play")
        self._play.on_click(lambda _: self._toggle_play())
        self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value="1 ×")
        self._readings = Readings.of_recording(recording)
        self._labels = recording.motion_labels(scene.grasp.hand)
        Charts(gui, recording.fingers, end, shows_step_time=False).draw_all(self._readings)
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
        row = int(np.searchsorted(self._recording.t, float(self._timeline.value), side="right")) - 1
        if row == self._shown:
            return
        self._shown = row
        recording, readings = self._recording, self._readings[row]
        self.view.show(recorded_state(self._scene, recording, row))
        self.view.show_desired(recording.p_desired[row], recording.R_desired[row])
        warnings = [text for t, text in recording.warnings if 0.0 <= readings.t - t < 1.0]
        warning = f"  \n⚠ {warnings[-1]}" if warnings else ""
        now = labels_at(self._labels, readings.t)
        motions = "".join(f"  \n{name}: {label.text}" for name, label in now.items())
        self._status.content = f"t = {readings.t:.3f} s, position error {readings.position_error:.3f} mm{motions}{warning}"

    def run(self, duration: float = np.inf) -> None:
        """Play and follow the timeline until `close`.

        Args:
            duration: time after which this ends, s.
        """
        end, last = float(self._recording.t[-1]), time.monotonic()
        start = last
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
            time.sleep(max(1.0 / _RATE - (time.monotonic() - now), 0.0))

    def close(self) -> None:
        """Close the page, and end `run`."""
        with self._lock:
            self._is_closed = True
        self.view.close()

    def _toggle_play(self) -> None:
        """Play the recording, or hold it."""
        self._is_playing = not self._is_playing
        self._play.label = "Hold" if self._is_playing else "Play"
