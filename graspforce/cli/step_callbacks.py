"""Callbacks of a simulation on the command line: a progress bar, the interactive viewer, a film."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn, track

from graspforce.cli.console import progress_console
from graspforce.cli.film_format import FilmFormat
from graspforce.simulation import ControllerCommand, Plant, PlantInterface
from graspforce.simulation.rendering import (
    CameraOptions,
    DisplayModel,
    FilmWriter,
    Overlay,
    SceneState,
    Viewer,
    capture_state,
    make_renderer,
)
from graspforce.simulation.rendering.coverage import filling_camera
from graspforce.simulation.rendering.film import ANIMATIONS
from graspforce.simulation.rendering.overlay import STRIP

StepCallback = Callable[[Plant, ControllerCommand], None]
ProgressCallback = Callable[[PlantInterface, ControllerCommand], None]  # also a StepCallback

_SWING = 0.30  # rad, of the film's camera
_LEAST_COVER = 0.38  # part of the frame that hand and object cover
_ROUNDING = 1e-6  # of a frame: sums of time steps
_PROGRESS_STEPS, _VIEWER_STEPS = 20, 16  # steps between two updates


@contextmanager
def progress_bar(duration: float) -> Iterator[ProgressCallback]:
    """Show the simulated time and the tracking error while a simulation of a duration in s runs."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.2f} of {task.total:g} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=progress_console()) as bar:
        task = bar.add_task("Simulating", total=duration)

        def callback(plant: PlantInterface, command: ControllerCommand) -> None:
            if round(plant.t / plant.dt) % _PROGRESS_STEPS == 0:
                error = 1e3 * float(np.linalg.norm(command.error[:3]))  # mm
                bar.update(task, completed=plant.t, description=f"Simulating, tracking error {error:.3f} mm")

        yield callback
        bar.update(task, completed=duration)


@contextmanager
def viewer_callback(plant: Plant, directories: tuple[Path, ...]) -> Iterator[StepCallback]:
    """Show the simulation in MuJoCo's viewer, in real time if the machine is fast enough; closing it does not end the run."""
    viewer = Viewer(DisplayModel(plant.scene, directories=directories))
    start = time.monotonic()

    def callback(plant: Plant, command: ControllerCommand) -> None:
        if round(plant.t / plant.dt) % _VIEWER_STEPS == 0 and viewer.is_running():
            viewer.show(plant)
            time.sleep(max(plant.t - (time.monotonic() - start), 0.0))

    try:
        yield callback
    finally:
        viewer.close()


@dataclass(frozen=True, slots=True)
class FilmOptions:
    """A film of a simulation.

    Args:
        video: file of the film; None for none.
        frames: directory of the frames; None for none.
        duration: of the simulation, s; the camera swings once in this time.
        directories: directories to search for mesh files.
        subtitle: second line of the panel.
        slow_motion: seconds of the film for each second of the simulation.
        format: size, rate and viewpoint.
    """

    video: Path | None
    frames: Path | None
    duration: float
    directories: tuple[Path, ...] = ()
    subtitle: str = "forces certified at 1 kHz"
    slow_motion: float = 1.0
    format: FilmFormat = field(default_factory=FilmFormat)

    @property
    def is_wanted(self) -> bool:
        """Return whether there is anything to write."""
        return self.video is not None or self.frames is not None


@contextmanager
def film_callback(plant: Plant, options: FilmOptions, console: Console) -> Iterator[StepCallback]:
    """Collect the states of a simulation; afterwards render them into a film and PNG files.

    Rendering follows the simulation, so that it does not delay the controller's messages.

    Args:
        plant: the plant that is simulated.
        options: files and contents of the film.
        console: shows the renderer, the progress and the files.
    """
    camera = options.format.camera(CameraOptions(swing=_SWING, period=options.duration))
    display = DisplayModel(plant.scene, directories=options.directories, camera=camera)
    writer = FilmWriter(options.video, options.frames, options.format.rate, options.format.width)
    rate = writer.rate * options.slow_motion  # frames per simulated second
    states: list[tuple[SceneState, float]] = []

    def callback(plant: Plant, command: ControllerCommand) -> None:
        if plant.t * rate >= len(states) - _ROUNDING:
            states.append((capture_state(plant), float(np.linalg.norm(command.error[:3]))))

    yield callback
    if states:
        display.update(states[0][0])
        display.camera = filling_camera(display, _LEAST_COVER / (1.0 - STRIP), *options.format.picture)
    renderer = make_renderer(display, *options.format.picture)
    fill = f"; {options.format.fill_text(display, [state for state, _ in states])}" if states else ""
    console.print(f"Film: {renderer.description}{fill}.", soft_wrap=True)
    is_compact = options.video is not None and options.video.suffix.lower() in ANIMATIONS
    title = plant.scene.grasp.hand.title.partition(":")[0]
    overlay = Overlay(title, options.subtitle, *options.format.size, is_compact, options.slow_motion)
    with writer:
        for state, error in track(states, "Rendering", console=progress_console()):
            writer.add(overlay.paint(renderer.render(state), state, error))
    for path in (options.video, options.frames):
        if path is not None:
            console.print(f"Film, {writer.count} frames: [bold]{path}[/]", soft_wrap=True)
