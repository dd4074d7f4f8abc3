"""The command ``graspforce learn synergies``: principal components of a library of postures, their plots and their film."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from graspforce.cli.console import progress_console
from graspforce.cli.hand_scene import hand_scene
from graspforce.cli.json_output import put_result
from graspforce.cli.options import RunFiles
from graspforce.cli.tables import make_table
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand
from graspforce.learning.object_size import correlate_with_size
from graspforce.learning.posture_library import SIZE_COLUMNS, PostureLibrary
from graspforce.learning.synergies import Synergies, fit_synergies
from graspforce.simulation.plants.scene import Scene
from graspforce.simulation.rendering import CameraOptions, DisplayModel, FilmWriter, Overlay, SceneState, make_renderer
from graspforce.simulation.rendering.film import ANIMATIONS
from graspforce.simulation.rendering.marks import posture_state

_SHOWN = 10  # components in the table
_MOST = 20  # components in a film


@dataclass(frozen=True, slots=True)
class SynergiesOptions:
    """The library and what to show of it.

    Args:
        postures: file of the library, .csv or .parquet.
        hand: name or description file of the hand; needed for plots and film.
        components: number of components of the film and of the plots of postures.
        span: amplitude of the film in standard deviations.
        duration: time of each component in the film, s.
        files: film, its frames, and the directory of the plots.

    Raises:
        InvalidInput: names the option and what is allowed.
    """

    postures: Path
    hand: str | None = None
    components: int = 2
    span: float = 2.0
    duration: float = 4.0
    files: RunFiles = field(default_factory=RunFiles)

    def __post_init__(self) -> None:
        fields.check_integer(self.components, "--components", minimum=1, maximum=_MOST)
        arrays.check_number(self.span, "--span", above=0.0)
        arrays.check_number(self.duration, "--duration", above=0.0)
        wants_hand = (self.files.video, self.files.frames, self.files.plots) != (None, None, None)
        if self.hand is None and wants_hand:
            raise InvalidInput("--hand", None, "given with --video, --frames and --plots")


def run(options: SynergiesOptions, console: Console) -> None:
    """Fit the components, show them, and write plots and film.

    Args:
        options: the library.
        console: shows the components.

    Raises:
        InvalidInput: not a library, or not one of the hand.
        UnknownName: no such hand.
        MissingLibrary: scikit-learn is not installed.
        OSError: a file cannot be read or written.
    """
    library = PostureLibrary.load(options.postures)
    hand = None if options.hand is None else Hand.load(options.hand)
    library = library if hand is None else library.for_hand(hand)
    synergies = fit_synergies(library)
    _show(library, synergies, console)
    if hand is not None and options.files.plots is not None:
        _plot(hand, library, synergies, options, console)
    if hand is not None and (options.files.video is not None or options.files.frames is not None):
        _film(hand, synergies, options, console)
    cumulative = synergies.cumulative_variance.tolist()
    put_result(console, {"postures": len(library), "joints": library.joints, "cumulative_variance": cumulative})


def _show(library: PostureLibrary, synergies: Synergies, console: Console) -> None:
    """Show variance and error by number of components."""
    count = min(_SHOWN, len(synergies.components))
    errors = np.degrees(np.sqrt(np.square(synergies.reconstruction_error(library.q)).mean(axis=1)))
    deviations = np.degrees(np.sqrt(synergies.variances))
    main = [library.joints[int(np.abs(each).argmax())] for each in synergies.components]
    columns = [
        ("component", [str(k + 1) for k in range(count)]),
        ("σ", [f"{x:.1f}°" for x in deviations[:count]]),
        ("explained", [f"{100.0 * x:.1f} %" for x in synergies.cumulative_variance[:count]]),
        ("error", [f"{x:.2f}°" for x in errors[1 : count + 1]]),
        ("largest joint", main[:count]),
    ]
    console.print(f"{len(library)} postures of {len(library.joints)} joints")
    console.print(make_table(columns))


def _plot(hand: Hand, library: PostureLibrary, synergies: Synergies, options: SynergiesOptions, console: Console) -> None:
    """Write the plots: variance, errors, postures, and the correlation with the object's size if the library has it."""
    from graspforce.view import learning_plots
    from graspforce.view.figures import save_figures

    assert options.files.plots is not None
    count = min(options.components, len(synergies.components))
    errors = library.q - synergies.reconstruct(library.q, count)
    figures = {
        "variance": learning_plots.plot_cumulative_variance({hand.name: synergies}),
        "errors": learning_plots.plot_reconstruction_errors({hand.name: errors}, count),
        "postures": learning_plots.plot_component_postures(hand, synergies, count, options.span),
    }
    if library.sizes is not None and len(library) > len(SIZE_COLUMNS):
        figures["size"] = learning_plots.plot_size_correlation(hand.name, correlate_with_size(library, synergies))
    for path in save_figures(figures, options.files.plots):
        console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)


def _film(hand: Hand, synergies: Synergies, options: SynergiesOptions, console: Console) -> None:
    """Write the film: one component after the other, from the mean posture to both ends and back."""
    files, form = options.files, options.files.film
    writer = FilmWriter(files.video, files.frames, form.rate, form.width)
    scene = hand_scene(hand)
    width, height = form.size  # no contacts: the picture takes the whole frame
    camera = replace(form.camera(CameraOptions()), aspect=width / height)
    display = DisplayModel(scene, camera=camera, shows_object=False)
    renderer = make_renderer(display, *form.size)
    console.print(f"Film: {renderer.description}.", soft_wrap=True)
    is_compact = files.video is not None and files.video.suffix.lower() in ANIMATIONS
    count = min(options.components, len(synergies.components))
    subtitle = f"{count} of {len(synergies.components)} synergies"
    overlay = Overlay(hand.title.partition(":")[0], subtitle, *form.size, is_compact=is_compact)
    states = list(_states(hand, scene, synergies, options, writer.rate))
    with writer:
        for state, status in track(states, "Rendering", console=progress_console()):
            writer.add(overlay.paint(renderer.render(state), state, status))
    for path in (files.video, files.frames):
        if path is not None:
            console.print(f"Film, {writer.count} frames: [bold]{path}[/]", soft_wrap=True)


def _states(
    hand: Hand, scene: Scene, synergies: Synergies, options: SynergiesOptions, rate: float
) -> Iterator[tuple[SceneState, str]]:
    """Yield the states of the film with the amplitude in words."""
    frames = max(round(options.duration * rate), 2)
    factors = options.span * np.sin(np.linspace(0.0, 2.0 * np.pi, frames))
    for k in range(min(options.components, len(synergies.components))):
        postures = np.clip(synergies.sweep(k, options.span, frames), hand.q_lower, hand.q_upper)
        for i, (q, factor) in enumerate(zip(postures, factors, strict=True)):
            yield posture_state(scene, (k * frames + i) / rate, q), f"synergy {k + 1}: {factor:+.1f} σ"
