"""The film of a grasp cycle: states are collected while it runs, and rendered afterwards."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import track

from graspforce.control.phases.phase_step import PhaseCommand
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
from graspforce.simulation.rendering.overlay import COVERED

_FILM_SIZE = (1280, 720)  # pixels
_SWING = 0.15  # rad, of the film's camera
_ROUNDING = 1e-6  # of a frame: sums of time steps


class CycleFilm:
    """The film of a cycle.

    Args:
        video: file of the film; None for none.
        frames: directory of the frames; None for none.
        console: shows the renderer, the progress and the files.
    """

    def __init__(self, video: Path | None, frames: Path | None, console: Console) -> None:
        self._video, self._frames, self._console = video, frames, console
        self._writer = FilmWriter(video, frames)
        self._states: list[tuple[SceneState, str]] = []
        self._plant: Plant | None = None

    def add(self, plant: Plant, command: PhaseCommand) -> None:
        """Keep the state of a plant if a frame is due.

        Args:
            plant: the plant.
            command: the newest command.
        """
        self._plant = plant
        if plant.t * self._writer.rate >= len(self._states) - _ROUNDING:
            self._states.append((capture_state(plant), command.phase))

    def render(self) -> None:
        """Render the frames, and write the film."""
        if self._plant is None:
            return
        scene = self._plant.scene
        camera = CameraOptions(_FILM_SIZE[0] / _FILM_SIZE[1], COVERED, _SWING, self._states[-1][0].t)
        display = DisplayModel(scene, camera=camera)
        renderer = make_renderer(display, *_FILM_SIZE)
        self._console.print(f"Film: {renderer.description}.", soft_wrap=True)
        is_compact = self._video is not None and self._video.suffix.lower() in ANIMATIONS
        title = scene.grasp.hand.title.partition(":")[0]
        overlay = Overlay(title, "a grasp cycle, from measurements", *_FILM_SIZE, is_compact=is_compact)
        with self._writer:
            for state, phase in track(self._states, "Rendering", console=self._console):
                self._writer.add(overlay.paint(renderer.render(state), state, phase))
        for path in (self._video, self._frames):
            if path is not None:
                self._console.print(f"Film, {self._writer.count} frames: [bold]{path}[/]", soft_wrap=True)
