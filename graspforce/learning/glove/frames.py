"""Frames of a glove: recorded ones at a fixed rate, or live ones, which a thread reads as they arrive.

A frame is a line of numbers, separated by commas, one number for each sensor.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import errors_of_file

_ROUNDING = 1e-9  # of a frame: sums of time steps


class GloveFrame(NamedTuple):
    """One frame.

    Attributes:
        number: index of the frame, from 0.
        reading: (m,) readings of the sensors.
    """

    number: int
    reading: Array


class GloveFrames(Protocol):
    """A source of frames."""

    def at(self, t: float) -> GloveFrame | None:
        """Return the newest frame at a time since the start, s; None before the first."""
        ...  # pragma: no cover


class RecordedFrames:
    """Frames of a recording, which arrive at a fixed rate. The last one stays.

    Args:
        readings: (T, m) readings, T ≥ 1.
        rate: frames per second, Hz, > 0.

    Attributes:
        duration: time of all frames, s.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    def __init__(self, readings: npt.ArrayLike, rate: float) -> None:
        self._readings = arrays.check_array(readings, "readings", (None, None))
        self._rate = arrays.check_number(rate, "rate", above=0.0)
        if not len(self._readings):
            raise InvalidInput("readings", readings, "at least one frame")
        self.duration = len(self._readings) / self._rate

    def at(self, t: float) -> GloveFrame | None:
        """Return the newest frame at a time, or None before the first.

        Args:
            t: time since the first frame, s.
        """
        if t < 0.0:
            return None
        number = min(int(t * self._rate + _ROUNDING), len(self._readings) - 1)
        return GloveFrame(number, self._readings[number])


class LiveFrames:
    """Frames of a running glove: a thread reads the lines, such as those of a serial device or of standard input.

    If the lines end, the last frame stays, so that a hand stays where it is.

    Args:
        lines: the lines; each arrives when the glove has measured it.
        sensors: number m of sensors; None for that of the first line.

    Attributes:
        is_over: whether the lines have ended.
    """

    def __init__(self, lines: Iterable[str], sensors: int | None = None) -> None:
        self._lines, self._sensors = lines, sensors
        self._newest: GloveFrame | None = None
        self._error: InvalidInput | None = None
        self._start: float | None = None
        self.is_over = False
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._read, name="glove", daemon=True)
        self._thread.start()

    def at(self, t: float) -> GloveFrame | None:
        """Wait until a time on the clock, and return the newest frame; None before the first.

        A simulation that asks for its frames therefore runs in real time.

        Args:
            t: time since the first call of this function, s.

        Raises:
            InvalidInput: a line is not a frame.
        """
        now = time.monotonic()
        if self._start is None:
            self._start = now - t
        time.sleep(max(self._start + t - now, 0.0))
        return self.newest()

    def newest(self) -> GloveFrame | None:
        """Return the newest frame without waiting; None before the first.

        Raises:
            InvalidInput: a line is not a frame.
        """
        with self._lock:
            if self._error is not None:
                raise self._error
            return self._newest

    def _read(self) -> None:
        """Keep the newest frame until the lines end."""
        number = 0
        for line in self._lines:
            if not line.strip():
                continue
            try:
                reading = parse_frame(line, number + 1, self._sensors)
            except InvalidInput as error:
                with self._lock:
                    self._error = error
                break
            self._sensors = len(reading)
            with self._lock:
                self._newest = GloveFrame(number, reading)
            number += 1
        self.is_over = True


def parse_frame(line: str, number: int, sensors: int | None = None) -> Array:
    """Return the readings (m,) of a line.

    Args:
        line: numbers, separated by commas.
        number: number of the line for errors, from 1.
        sensors: number m of sensors; None for any.

    Raises:
        InvalidInput: not such a line.
    """
    try:
        reading = np.array([float(word) for word in line.split(",")])
    except ValueError:
        raise InvalidInput(f"frame {number}", line.strip(), "numbers, separated by commas") from None
    if sensors is not None and len(reading) != sensors:
        raise InvalidInput(f"frame {number}", line.strip(), f"{sensors} numbers, one for each sensor")
    if not np.isfinite(reading).all():
        raise InvalidInput(f"frame {number}", line.strip(), "finite numbers")
    return freeze(reading)


def load_frames(path: str | os.PathLike[str], sensors: int | None = None) -> Array:
    """Return the readings (T, m) of a text file with a line for each frame.

    Args:
        path: the file.
        sensors: number m of sensors; None for that of the first line.

    Raises:
        InvalidInput: not such a file, or one without frames.
        OSError: the file cannot be read.
    """
    lines = [line for line in Path(path).read_text(encoding="utf-8").splitlines() if line.strip()]
    frames: list[Array] = []
    with errors_of_file(path):
        for i, line in enumerate(lines):
            frames.append(parse_frame(line, i + 1, len(frames[0]) if frames else sensors))
    if not frames:
        raise InvalidInput("frames", str(path), "a file with at least one frame")
    return freeze(np.array(frames))


def guided_readings(lines: Iterable[str], count: int, frames: int, skipped: int) -> Iterator[Array]:
    """Yield the mean readings (m,) of one posture after the other from the lines of a running glove.

    Before each posture, frames are skipped: in this time the operator takes the posture. Frames are counted instead of
    seconds, so that the sequence keeps the glove's own rate.

    Args:
        lines: the lines; each arrives when the glove has measured it.
        count: number of postures.
        frames: number of frames to average in each, ≥ 1.
        skipped: number of frames to skip before each, ≥ 0.

    Raises:
        InvalidInput: a line is not a frame, or the lines end too early.
    """
    numbered = ((i + 1, line) for i, line in enumerate(each for each in lines if each.strip()))
    sensors: int | None = None
    for posture in range(count):
        taken: list[Array] = []
        for k in range(skipped + frames):
            number, line = next(numbered, (0, ""))
            if not number:
                raise InvalidInput("frames", f"the end in posture {posture + 1}", f"frames for {count} postures")
            reading = parse_frame(line, number, sensors)
            sensors = len(reading)
            if k >= skipped:
                taken.append(reading)
        yield freeze(np.mean(taken, axis=0))
