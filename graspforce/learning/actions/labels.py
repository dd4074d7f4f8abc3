"""Labels of the motions of all fingers: of a recording, and of a running stream.

Joint positions are resampled to a steady rate, and `segmentation` divides each finger's motion. A label has the finger, the
number of its meta motion, and the times at which it begins and ends.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import os
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.core.whole_file import write_text
from graspforce.hand.hand import Hand
from graspforce.learning.actions.finger_angles import finger_angles
from graspforce.learning.actions.gist_ranking import ActionGist
from graspforce.learning.actions.meta_motions import IDLE, META_MOTIONS
from graspforce.learning.actions.segmentation import GistSettings, segment_finger

LABEL_RATE = 100.0  # frames per second of the segmentation
DEADBAND = 0.03  # degrees per frame: 3 °/s
LABEL_SCHEMA: JsonRecord = {  # of a label in an MCAP file; its log time is when the motion begins
    "title": "graspforce.MotionLabel",
    "type": "object",
    "properties": {
        "finger": {"type": "string"},
        "motion": {"type": "integer", "description": "number of the meta motion, 1 to 9"},
        "name": {"type": "string", "description": "rest, or open or close with signs of the sideways angle and the base joint"},
        "duration": {"type": "number", "description": "of the motion, s"},
    },
}
_COLUMNS = ("finger", "motion", "begin", "end")
_WINDOW = 1.0  # s, of the motion from which a running stream is labelled
_LEAST_FRAMES = 10  # of a running stream
_SIDES = ("+ +", "− +", "− −", "+ −")  # signs of the sideways and the base angle of motions 1 to 4, and of 5 to 8


@dataclass(frozen=True, slots=True)
class MotionLabel:
    """A motion of a finger in a recording.

    Args:
        finger: name of the finger.
        motion: number of the meta motion, 1 to 9.
        begin: when it begins, s.
        end: when it ends, s, ≥ begin.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    finger: str
    motion: int
    begin: float
    end: float

    def __post_init__(self) -> None:
        begin = arrays.check_number(self.begin, "begin")
        set_fields(
            self,
            finger=fields.check_text(self.finger, "finger"),
            motion=fields.check_integer(self.motion, "motion", minimum=1, maximum=IDLE),
            begin=begin,
            end=arrays.check_number(self.end, "end", minimum=begin),
        )

    @property
    def text(self) -> str:
        """Name of the motion, such as "close (+ −)": with the signs of the sideways angle and of the base joint."""
        return motion_name(self.motion)

    def to_record(self) -> JsonRecord:
        """Return the message of an MCAP file: see `LABEL_SCHEMA`."""
        return {"finger": self.finger, "motion": self.motion, "name": self.text, "duration": self.end - self.begin}


def motion_name(motion: int) -> str:
    """Return the name of a meta motion: rest, or open or close with the signs of the sideways angle and of the base joint.

    Args:
        motion: number of the meta motion, 1 to 9.

    Raises:
        InvalidInput: no such number.
    """
    motion = fields.check_integer(motion, "motion", minimum=1, maximum=max(META_MOTIONS))
    if motion == IDLE:
        return "rest"
    return f"{'open' if motion <= len(_SIDES) else 'close'} ({_SIDES[(motion - 1) % len(_SIDES)]})"


def label_settings(deadband: float = DEADBAND) -> GistSettings:
    """Return the parameters of the segmentation at 100 frames per second.

    Args:
        deadband: largest change of an angle that counts as rest, degrees per frame, ≥ 0. Choose it above the noise.

    Raises:
        InvalidInput: the deadband is out of range.
    """
    return GistSettings(deadband=deadband)


def label_motions(
    hand: Hand,
    t: npt.ArrayLike,
    q: npt.ArrayLike,
    fingers: Sequence[str] | None = None,
    settings: GistSettings | None = None,
) -> tuple[MotionLabel, ...]:
    """Return the motions of the fingers in a recording, in the order in which they begin.

    The labels of a finger cover the recording from its first to its last time.

    Args:
        hand: the hand.
        t: (T,) times, s, increasing, over 0.02 s at least.
        q: (T, n) positions of the actuated joints, rad.
        fingers: names of the fingers; by default all.
        settings: parameters of the segmentation at 100 frames per second; by default `label_settings`.

    Raises:
        InvalidInput: an argument is not allowed.
        UnknownName: the hand has no such finger.
    """
    times = arrays.check_array(t, "t", (None,))
    positions = arrays.check_array(q, "q", (len(times), hand.n))
    if len(times) < 2 or times[-1] - times[0] < 2.0 / LABEL_RATE or (np.diff(times) < 0.0).any():
        raise InvalidInput("t", f"{len(times)} times", f"increasing times over {2.0 / LABEL_RATE:g} s at least")
    grid = np.arange(times[0], times[-1] + 0.5 / LABEL_RATE, 1.0 / LABEL_RATE)
    resampled = np.column_stack([np.interp(grid, times, column) for column in positions.T])
    settings = label_settings() if settings is None else settings
    last = float(times[-1])
    labels = []
    for name in [finger.name for finger in hand.fingers] if fingers is None else fingers:
        segments = segment_finger(finger_angles(hand, name, resampled), settings)
        for each in segments:
            end = last if each is segments[-1] else float(grid[each.end])
            labels.append(MotionLabel(name, each.motion, float(grid[each.begin]), end))
    return tuple(sorted(labels, key=lambda each: each.begin))


def labelled_gist(labels: Iterable[MotionLabel]) -> ActionGist:
    """Return the order in which fingers begin their motions, without rests.

    Args:
        labels: the labels.

    Raises:
        InvalidInput: no finger moves.
    """
    moving = sorted((each for each in labels if each.motion != IDLE), key=lambda each: each.begin)
    return ActionGist(tuple((each.finger, each.motion) for each in moving))


def labels_at(labels: Iterable[MotionLabel], t: float) -> dict[str, MotionLabel]:
    """Return the label of each finger at a time; fingers without one are missing.

    Args:
        labels: the labels.
        t: time, s.
    """
    found: dict[str, MotionLabel] = {}
    for each in labels:
        if each.begin <= t <= each.end and (each.finger not in found or each.begin > found[each.finger].begin):
            found[each.finger] = each
    return found


def save_labels(labels: Iterable[MotionLabel], path: str | os.PathLike[str]) -> None:
    """Write labels as CSV with the columns finger, motion, begin and end (s).

    Args:
        labels: the labels.
        path: the file.

    Raises:
        OSError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    writer.writerows(dataclasses.astuple(each) for each in labels)
    write_text(path, text.getvalue())


def load_labels(path: str | os.PathLike[str]) -> tuple[MotionLabel, ...]:
    """Read labels.

    Args:
        path: the file.

    Raises:
        InvalidInput: not such a file.
        OSError: the file cannot be read.
    """
    with Path(path).open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    labels = []
    for i, row in enumerate(rows):
        try:
            labels.append(MotionLabel(row["finger"], int(row["motion"]), float(row["begin"]), float(row["end"])))
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, InvalidInput):
                raise error.with_prefix(f"row {i + 1}") from None
            raise InvalidInput(f"row {i + 1}", row, f"the columns {', '.join(_COLUMNS)}") from None
    return tuple(labels)


class MotionMonitor:
    """Labels the present motion of the fingers in a running stream, from its last second.

    Args:
        hand: the hand.
        fingers: names of the fingers; by default all.
        settings: parameters of the segmentation at 100 frames per second; by default `label_settings`.

    Raises:
        UnknownName: the hand has no such finger.
    """

    def __init__(self, hand: Hand, fingers: Sequence[str] | None = None, settings: GistSettings | None = None) -> None:
        self._hand = hand
        self._fingers = tuple(finger.name for finger in hand.fingers) if fingers is None else tuple(fingers)
        for name in self._fingers:
            hand.finger(name)
        self._settings = dataclasses.replace(label_settings() if settings is None else settings, refine=False)
        self._frames: deque[Array] = deque(maxlen=round(_WINDOW * LABEL_RATE))
        self._next = -np.inf

    def is_due(self, t: float) -> bool:
        """Return whether `add` would take over joint positions of a time.

        Args:
            t: time, s.
        """
        return t >= self._next - 0.5e-3 / LABEL_RATE or t < self._next - 1.5 / LABEL_RATE

    def add(self, t: float, q: npt.ArrayLike) -> None:
        """Take over joint positions; more than 100 per second are left out.

        Args:
            t: time, s; an earlier one than the last begins anew.
            q: (n,) positions of the actuated joints, rad.

        Raises:
            InvalidInput: another shape.
        """
        if not self.is_due(t):
            return
        if t < self._next - 1.5 / LABEL_RATE:
            self._frames.clear()
        self._next = t + 1.0 / LABEL_RATE
        self._frames.append(arrays.check_array(q, "q", (self._hand.n,)))

    def present(self) -> dict[str, int]:
        """Return the number of the present motion of each finger; nothing in the first 0.1 s."""
        if len(self._frames) < _LEAST_FRAMES:
            return {}
        q = np.array(self._frames)
        return {name: segment_finger(finger_angles(self._hand, name, q), self._settings)[-1].motion for name in self._fingers}
