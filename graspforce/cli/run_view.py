"""The command ``graspforce view`` with a file: show a recording in a web browser."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from graspforce.browser import Playback, ViewAddress
from graspforce.cli.json_output import put_result
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.planning.plan import Plan
from graspforce.simulation import Recording, build_scene
from graspforce.simulation.plants.scene import Scene


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """The recording that the command's options describe.

    Args:
        file: the recording.
        gravity_H: (x, y, z) acceleration of gravity in H, m/s².
        address: where the page is served.
        opens_page: whether to open the page in the default browser.
    """

    file: Path
    gravity_H: tuple[float, ...]
    address: ViewAddress
    opens_page: bool


def run(options: ViewOptions, console: Console, duration: float = np.inf) -> None:
    """Show a recording until Ctrl-C.

    Args:
        options: the recording.
        console: shows the address.
        duration: time after which this ends, s.

    Raises:
        InvalidInput: not a recording, or one without its grasp.
        MissingLibrary: viser is not installed.
    """
    recording = Recording.load(options.file)
    if recording.grasp is None:
        raise InvalidInput("FILE", str(options.file), "a recording with its grasp; record the run again")
    grasp = Grasp.from_dict(recording.grasp, Hand.load(recording.hand))
    scene = build_scene(grasp, gravity_H=options.gravity_H)
    show(scene, recording, console, options.address, options.opens_page, duration)


def show(
    scene: Scene,
    source: Recording | Plan,
    console: Console,
    address: ViewAddress | None = None,
    opens_page: bool = False,
    duration: float = np.inf,
) -> None:
    """Show a recording or a plan until Ctrl-C.

    Args:
        scene: scene of the grasp.
        source: the recording, or the plan.
        console: shows the address.
        address: where the page is served.
        opens_page: whether to open the page in the default browser.
        duration: time after which this ends, s.

    Raises:
        MissingLibrary: viser is not installed.
    """
    playback = Playback(scene, source, address)
    try:
        console.print(f"View: [bold]{playback.url}[/] (Ctrl-C ends it)", soft_wrap=True)
        if isinstance(source, Recording):
            put_result(console, {"url": playback.url})
        if opens_page:
            webbrowser.open(playback.url)
        playback.run(duration)
    except KeyboardInterrupt:
        pass
    finally:
        playback.close()
