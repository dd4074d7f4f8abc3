"""Films of runs with phases: states are collected during the run, and rendered afterwards."""

from __future__ import annotations

from dataclasses import replace

from rich.console import Console
from rich.progress import track

from graspforce.cli.console import progress_console
from graspforce.cli.options import RunFiles
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.rendering import (
    CameraOptions,
    DisplayModel,
    FilmWriter,
    Overlay,
    SceneState,
    capture_state,
    make_renderer,
)
from graspforce.simulation.rendering.film import ANIMATIONS

_SWING = 0.15  # rad, of the film's camera
_TOWARDS_OBJECT, _DISTANCE = 0.5, 0.7  # of a camera that follows a hand: part of the way to the object, and of the distance
_ROUNDING = 1e-6  # of a frame: sums of time steps


class PhaseFilm:
    """The film of a run with phases.

    Args:
        subtitle: what the film shows.
        files: film, frames and format.
        console: shows the renderer, the progress and the files.
        view: the camera's elevation and radius; by default it shows the whole hand.
    """

    def __init__(
        self,
        subtitle: str,
        files: RunFiles,
        console: Console,
        view: CameraOptions | None = None,
    ) -> None:
        self._subtitle, self._video, self._frames, self._console = subtitle, files.video, files.frames, console
        self._format = files.film
        self._view = CameraOptions() if view is None else view
        self._writer = FilmWriter(files.video, files.frames, files.film.rate, files.film.width)
        self._states: list[tuple[SceneState, str]] = []
        self._plant: Plant | None = None

    def add(self, plant: Plant, phase: str) -> None:
        """Keep the state of a plant if a frame is due.

        Args:
            plant: the plant.
            phase: the present phase.
        """
        self._plant = plant
        if plant.t * self._writer.rate >= len(self._states) - _ROUNDING:
            self._states.append((capture_state(plant), phase))

    def render(self) -> None:
        """Render the frames, and write the film."""
        if self._plant is None:
            return
        scene = self._plant.scene
        form, period = self._format, self._states[-1][0].t
        camera = form.camera(replace(self._view, swing=_SWING, period=period))
        display = DisplayModel(scene, camera=camera)
        if len(self._states[0][0].mocap):  # a hand that moves over a table
            self._follow_hand(display)
        renderer = make_renderer(display, *form.picture)
        fill = form.fill_text(display, [state for state, _ in self._states])
        self._console.print(f"Film: {renderer.description}; {fill}.", soft_wrap=True)
        is_compact = self._video is not None and self._video.suffix.lower() in ANIMATIONS
        title = scene.grasp.hand.title.partition(":")[0]
        overlay = Overlay(title, self._subtitle, *form.size, is_compact=is_compact)
        with self._writer:
            for state, phase in track(self._states, "Rendering", console=progress_console()):
                self._writer.add(overlay.paint(renderer.render(state), state, phase))
        for path in (self._video, self._frames):
            if path is not None:
                self._console.print(f"Film, {self._writer.count} frames: [bold]{path}[/]", soft_wrap=True)

    def _follow_hand(self, display: DisplayModel) -> None:
        """Let the camera move with the hand, nearer than one that shows the whole hand from the floor.

        Args:
            display: the model of the film.
        """
        display.follows_hand = True
        camera, middle = display.camera, display.contact_points.mean(axis=0)
        target = camera.target + _TOWARDS_OBJECT * (middle - camera.target)
        display.camera = replace(camera, target=target, distance=_DISTANCE * camera.distance)
