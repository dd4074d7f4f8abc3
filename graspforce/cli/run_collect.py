"""The command ``graspforce learn collect``: a library of postures from a recording of a simulation, a server or a glove."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from graspforce.cli.json_output import put_result
from graspforce.core.errors import InvalidInput
from graspforce.learning.glove.calibration import GloveCalibration
from graspforce.learning.glove.frames import load_frames
from graspforce.learning.posture_library import PostureLibrary
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.replay.label import recorded_postures
from graspforce.service.replay.replay import load_hands
from graspforce.simulation import Recording

_SERVER, _RUN = ".mcap", ".npz"


def from_recording(file: Path, hands: Sequence[str], every: float) -> PostureLibrary:
    """Return the postures of a simulation, or of all streams of a server.

    Args:
        file: the recording, .npz or .mcap.
        hands: names or description files of hands that replace recorded ones.
        every: least time between two postures, s.

    Raises:
        InvalidInput: no recording, no stream, or streams of hands with different joints.
        UnknownName: a hand is not found.
        OSError: the file cannot be read.
    """
    if file.suffix == _RUN:
        run = Recording.load(file)
        return PostureLibrary.from_motion(run.joints, run.t, run.q, every)
    if file.suffix != _SERVER:
        raise InvalidInput("FILE", str(file), "an .npz or .mcap recording, or frames of a glove with --calibration")
    server = ServerRecording.open(file)
    streams = recorded_postures(server, load_hands(server, hands)).values()
    libraries = [PostureLibrary.from_motion(one.hand.joint_names, one.t, one.array(), every) for one in streams if one.t]
    if not libraries:
        raise InvalidInput("FILE", str(file), "a recording with a stream")
    library = libraries[0]
    for each in libraries[1:]:
        library = library.joined(each)
    return library


def from_glove(file: Path, calibration: Path, glove_rate: float, every: float) -> PostureLibrary:
    """Return the postures of recorded frames of a glove.

    Args:
        file: the frames, a line each.
        calibration: file of the glove's calibration.
        glove_rate: frames per second, Hz.
        every: least time between two postures, s.

    Raises:
        InvalidInput: not such files.
        OSError: a file cannot be read.
    """
    glove = GloveCalibration.load(calibration)
    q = glove.postures(load_frames(file, len(glove.centre)))
    return PostureLibrary.from_motion(glove.joints, np.arange(len(q)) / glove_rate, q, every)


def save(library: PostureLibrary, target: Path, console: Console) -> None:
    """Write a library, and print its size.

    Args:
        library: the postures.
        target: the file, .csv or .parquet.
        console: shows the size.

    Raises:
        InvalidInput: another suffix.
        OSError: the file cannot be written.
    """
    library.save(target)
    console.print(f"{len(library)} postures of {len(library.joints)} joints: [bold]{target}[/]", soft_wrap=True)
    put_result(console, {"file": target, "postures": len(library), "joints": library.joints})
