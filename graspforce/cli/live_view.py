"""The web page of a running simulation on the command line: pictures at a steady rate, pace, pause and stop."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rich.console import Console

from graspforce.browser.live_view import LiveView
from graspforce.browser.readings import Readings
from graspforce.browser.steering import SteeredController, SteeredReference
from graspforce.control import ObjectController
from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.hand.heat import ThermalModel
from graspforce.learning.actions.labels import MotionMonitor, motion_name
from graspforce.simulation import ControllerCommand, Plant, Reference
from graspforce.simulation.rendering import DisplayModel, capture_state

_RATE = 30.0  # pictures per second
_LABEL_PERIOD = 0.25  # simulated s between two labels of the motions
_LONGEST_LAG = 0.2  # s: a simulation that is later than this does not hurry to catch up


class LiveRun:
    """A running simulation and its view.

    Args:
        view: the view.
    """

    def __init__(self, view: LiveView) -> None:
        self._view = view
        self._start = self._last_step = time.monotonic()
        self._due, self._next_label = -np.inf, 0.0  # s: of the next picture, and the next label
        self._monitor: MotionMonitor | None = None
        self._motions: dict[str, str] = {}
        self._heat: _WindingHeat | None = None

    def steered(self, controller: ObjectController) -> SteeredController:
        """Return the controller with the slip margin of the view."""
        return SteeredController(controller, self._view)

    def steered_reference(self, reference: Reference) -> Reference:
        """Return the reference motion, moved by the sliders of the view."""
        return SteeredReference(reference, self._view)

    def follow(self, plant: Plant, command: ControllerCommand) -> bool:
        """Show a step if a picture is due, keep real time, and return whether the run goes on.

        Args:
            plant: the plant after the step.
            command: command of the step.
        """
        now = time.monotonic()
        step_time = 1e3 * (now - self._last_step)  # ms
        self._label(plant)
        if self._heat is None and plant.scene.grasp.hand.drives.has_thermal_data:
            self._heat = _WindingHeat(plant.scene.grasp.hand, plant.t)
        if self._heat is not None:
            self._heat.add(np.asarray(command.tau))
        if now >= self._due:
            self._due, hand = max(self._due + 1.0 / _RATE, now), plant.scene.grasp.hand
            heat = np.nan if self._heat is None else self._heat.take(plant.t)
            readings = Readings.of_command(plant.t, command, hand, step_time, self._motions, heat)
            self._view.show(capture_state(plant), readings)
        before = time.monotonic()
        self._view.wait_while_paused()
        self._start += time.monotonic() - before
        lag = time.monotonic() - self._start - plant.t  # s
        if lag < 0.0:
            time.sleep(-lag)
        elif lag > _LONGEST_LAG:
            self._start += lag - _LONGEST_LAG
        self._last_step = time.monotonic()
        return not self._view.is_stopped

    def _label(self, plant: Plant) -> None:
        """Label the present motions of the fingers in contact, four times in each simulated second.

        Args:
            plant: the plant.
        """
        if self._monitor is None:
            grasp = plant.scene.grasp
            self._monitor = MotionMonitor(grasp.hand, grasp.fingers)
        if not self._monitor.is_due(plant.t):
            return
        self._monitor.add(plant.t, plant.state().q)
        if plant.t >= self._next_label:
            self._motions = {finger: motion_name(motion) for finger, motion in self._monitor.present().items()}
            self._next_label = plant.t + _LABEL_PERIOD if self._motions else plant.t


class _WindingHeat:
    """Temperature of the hottest winding of a run that begins with cold motors.

    Args:
        hand: the hand, with thermal data.
        t: time, s.
    """

    def __init__(self, hand: Hand, t: float) -> None:
        self._model, self._t = ThermalModel.for_hand(hand), t
        self._now, self._squares, self._count = self._model.at_rest(), np.zeros(hand.n), 0

    def add(self, tau: Array) -> None:
        """Take the torques of a step, (n,), N·m."""
        self._squares, self._count = self._squares + tau**2, self._count + 1

    def take(self, t: float) -> float:
        """Return the temperature at a time, °C, and begin the next interval."""
        if t > self._t:
            current = self._model.currents(np.sqrt(self._squares / max(self._count, 1)))
            self._now = self._model.step(self._now, current, t - self._t)
            self._t, self._squares, self._count = t, np.zeros_like(self._squares), 0
        return float(self._now.winding.max())


@contextmanager
def live_view(
    plant: Plant, slip_margin: float, directories: tuple[Path, ...], console: Console, *, has_squeeze: bool = True
) -> Iterator[LiveRun]:
    """Serve a web page that shows a simulation, and print its address.

    Args:
        plant: the plant that is simulated.
        slip_margin: slip margin of the controller, N.
        directories: directories to search for mesh files.
        console: shows the address.
        has_squeeze: whether the slip margin can be changed.
    """
    title = plant.scene.grasp.hand.title.partition(":")[0]
    view = LiveView(DisplayModel(plant.scene, directories=directories), title, slip_margin if has_squeeze else None)
    console.print(f"View: [bold]{view.url}[/]", soft_wrap=True)
    try:
        yield LiveRun(view)
    finally:
        view.close()
