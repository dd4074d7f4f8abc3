"""The commands ``graspforce learn label`` and ``similar``: the motions of fingers in recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.text import Text

from graspforce.cli.json_output import put_result
from graspforce.cli.output_files import check_new_file
from graspforce.cli.tables import make_table
from graspforce.core.errors import InvalidInput
from graspforce.core.foxglove_messages import log_time
from graspforce.core.printable import escape_controls
from graspforce.hand.hand import Hand
from graspforce.learning.actions.gist_ranking import ActionGist
from graspforce.learning.actions.labels import (
    DEADBAND,
    LABEL_SCHEMA,
    MotionLabel,
    label_settings,
    labelled_gist,
    save_labels,
)
from graspforce.learning.actions.retrieval import find_similar
from graspforce.service.recording.annotation import Annotation, annotate
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.replay.label import LabelledStream, label_recording
from graspforce.service.replay.replay import load_hands
from graspforce.simulation import Recording

_SERVER = ".mcap"  # suffix of a server's recording


@dataclass(frozen=True, slots=True)
class LabelOptions:
    """The recording to label.

    Args:
        file: an .npz file of a simulation, or an .mcap file of a server.
        hands: names or description files of hands that replace recorded ones.
        deadband: largest change of an angle that counts as rest, degrees per frame of 10 ms.
        save: CSV file of the labels; with several streams one file each, with the stream's id in its name. None for none.
        record: .mcap file for a copy of a server's recording with the labels; None for none.
        force: whether existing files are replaced.

    Raises:
        InvalidInput: names the option and what is allowed.
    """

    file: Path
    hands: tuple[str, ...] = ()
    deadband: float = DEADBAND
    save: Path | None = None
    record: Path | None = None
    force: bool = False

    def __post_init__(self) -> None:
        label_settings(self.deadband)
        check_new_file(self.save, "--save", self.force)
        check_new_file(self.record, "--record", self.force)
        if self.record is not None and self.file.suffix != _SERVER:
            allowed = "absent for a simulation, whose `--record` already writes the labels"
            raise InvalidInput("--record", str(self.record), allowed)


def run(options: LabelOptions, console: Console) -> None:
    """Show the motions of the fingers, and write the labels.

    Args:
        options: the recording.
        console: shows the labels.

    Raises:
        InvalidInput: no recording, or nothing in it can be labelled.
        UnknownName: a hand is not found.
        MissingLibrary: a library of a server's recording is not installed.
        OSError: a file cannot be read or written.
    """
    if options.file.suffix != _SERVER:
        recording = Recording.load(options.file)
        hand = Hand.load(options.hands[0] if options.hands else recording.hand)
        labels = recording.motion_labels(hand, label_settings(options.deadband))
        _show(f"{recording.hand}, {recording.t[-1]:.3g} s", labels, float(recording.t[0]), console)
        if options.save is not None:
            _save(labels, options.save, console)
        put_result(console, {"file": options.file, "labels": _records(labels)})
        return
    server = ServerRecording.open(options.file)
    streams = label_recording(server, load_hands(server, options.hands), label_settings(options.deadband))
    if not streams:
        raise InvalidInput("FILE", str(options.file), "a recording with a stream of 0.02 s at least")
    for id, each in streams.items():
        _show(f"Stream {escape_controls(id)}, {each.hand}", each.labels, each.start, console)
        if options.save is not None:
            file = options.save if len(streams) == 1 else _named(options.save, id)
            _save([_since(label, each.start) for label in each.labels], file, console)
    if options.record is not None:
        _annotate(server, streams, options.record)
        console.print(f"Recording with labels: [bold]{options.record}[/]", soft_wrap=True)
    found = {id: [_since(label, each.start) for label in each.labels] for id, each in streams.items()}
    put_result(console, {"file": options.file, "streams": {id: _records(labels) for id, labels in found.items()}})


def run_similar(file: Path, others: Sequence[Path], deadband: float, count: int, console: Console) -> None:
    """Show the recordings whose order of motions is most like that of a recording.

    Args:
        file: recording of a simulation, .npz.
        others: recordings to compare with.
        deadband: largest change of an angle that counts as rest, degrees per frame of 10 ms.
        count: number of recordings to show at most.
        console: shows the recordings.

    Raises:
        InvalidInput: a file is no recording, no finger moves in the first one, or in all others.
        UnknownName: a hand is not found.
        OSError: a file cannot be read.
    """
    gist = _recorded_gist(file, deadband)
    if gist is None:
        raise InvalidInput("FILE", str(file), f"a recording in which a finger moves by more than {deadband:g}° in 10 ms")
    gists = {str(path): _recorded_gist(path, deadband) for path in others}
    moving = {name: each for name, each in gists.items() if each is not None}
    for name in sorted(gists.keys() - moving.keys()):
        console.print(Text(f"{name}: no finger moves"))
    found = find_similar(gist, moving, count)
    console.print(Text(f"Order in {file}: {gist}"))
    columns = [
        ("similarity", [f"{each.similarity:.2f}" for each in found]),
        ("recording", [each.name for each in found]),
        ("order", [str(moving[each.name]) for each in found]),
    ]
    console.print(make_table(columns))
    put_result(console, {"file": file, "similar": found})


def _recorded_gist(file: Path, deadband: float) -> ActionGist | None:
    """Return the gist of a recording; None if no finger moves."""
    recording = Recording.load(file)
    return _order(recording.motion_labels(Hand.load(recording.hand), label_settings(deadband)))


def _show(title: str, labels: Sequence[MotionLabel], start: float, console: Console) -> None:
    """Show labels as a table with times since the start, and the order of the motions."""
    console.print(Text(title))
    columns = [
        ("finger", [each.finger for each in labels]),
        ("motion", [f"{each.motion} {each.text}" for each in labels]),
        ("begin, s", [f"{each.begin - start:.2f}" for each in labels]),
        ("end, s", [f"{each.end - start:.2f}" for each in labels]),
    ]
    console.print(make_table(columns))
    console.print(Text(f"Order: {_order(labels) or 'no finger moves'}"))


def _order(labels: Sequence[MotionLabel]) -> ActionGist | None:
    """Return the gist of labels; None if no finger moves."""
    try:
        return labelled_gist(labels)
    except InvalidInput:
        return None


def _save(labels: Sequence[MotionLabel], file: Path, console: Console) -> None:
    """Write labels, and print the name of the file."""
    save_labels(labels, file)
    console.print(f"Labels: [bold]{file}[/]", soft_wrap=True)


def _annotate(server: ServerRecording, streams: dict[str, LabelledStream], target: Path) -> None:
    """Write a copy of a server's recording with the labels."""
    annotations = {
        f"/streams/{id}/actions": [Annotation(server.clock + log_time(label.begin), label.to_record()) for label in each.labels]
        for id, each in streams.items()
    }
    annotate(server.path, target, annotations, LABEL_SCHEMA)


def _since(label: MotionLabel, start: float) -> MotionLabel:
    """Return a label with times since the start."""
    return MotionLabel(label.finger, label.motion, label.begin - start, label.end - start)


def _records(labels: Sequence[MotionLabel]) -> list[dict[str, object]]:
    """Return the labels as plain records."""
    return [{**label.to_record(), "begin": label.begin, "end": label.end} for label in labels]


def _named(path: Path, id: str) -> Path:
    """Return the file of a stream."""
    safe = "".join(each if each.isalnum() or each in "-_" else "_" for each in id)
    return path.with_name(f"{path.stem}_{safe}{path.suffix}")
