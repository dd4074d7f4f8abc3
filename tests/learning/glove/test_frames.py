"""Frames of a glove: recorded ones keep their rate, live ones arrive as they are written, and guided ones are averaged."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from graspforce.core.errors import InvalidInput
from graspforce.learning import LiveFrames, RecordedFrames
from graspforce.learning.glove.frames import guided_readings, load_frames

TIMEOUT = 20.0  # s, only a failing test waits so long


def wait_for(frames: LiveFrames, number: int) -> np.ndarray:
    deadline = time.monotonic() + TIMEOUT
    while (frame := frames.newest()) is None or frame.number < number:
        assert time.monotonic() < deadline, "the frame did not arrive"
        time.sleep(0.002)
    return frame.reading


def test_recorded_frames_keep_their_rate_and_the_last_one_stays():
    frames = RecordedFrames([[0.0], [1.0], [2.0]], rate=10.0)
    assert frames.at(-0.01) is None
    numbers = [frames.at(t).number for t in (0.0, 0.09, 0.1, 0.19, 0.2, 5.0)]
    assert numbers == [0, 0, 1, 1, 2, 2]
    assert frames.at(5.0).reading == [2.0]
    assert frames.duration == pytest.approx(0.3)


def test_live_frames_are_the_newest_that_arrived():
    out, into = os.pipe()
    with os.fdopen(out) as lines, os.fdopen(into, "w", buffering=1) as glove:
        frames = LiveFrames(lines)
        assert frames.newest() is None
        glove.write("1,2\n")
        np.testing.assert_array_equal(wait_for(frames, 0), [1.0, 2.0])
        glove.write("\n3,4\n5,6\n")
        np.testing.assert_array_equal(wait_for(frames, 2), [5.0, 6.0])
        glove.write("7,8,9\n")
        deadline = time.monotonic() + TIMEOUT
        while not frames.is_over and time.monotonic() < deadline:
            time.sleep(0.002)
        with pytest.raises(InvalidInput, match=r"frame 4 .*2 numbers"):
            frames.newest()


def test_live_frames_run_at_the_pace_of_the_clock():
    frames = LiveFrames(iter(["1\n"]))
    wait_for(frames, 0)
    begin = time.monotonic()
    for t in (0.0, 0.01, 0.05):
        assert frames.at(t).number == 0
        assert time.monotonic() - begin >= t


def test_guided_readings_skip_frames_before_each_posture():
    lines = [f"{k}\n" for k in range(10)]
    means = list(guided_readings(lines, count=2, frames=3, skipped=2))
    np.testing.assert_allclose(means, [[3.0], [8.0]])
    with pytest.raises(InvalidInput, match="the end in posture 3"):
        list(guided_readings(lines, count=3, frames=3, skipped=2))


@pytest.mark.parametrize("text", ["", "\n", "1,x\n", "1,2\n3\n", "1,nan\n"])
def test_files_that_are_no_frames_are_refused(text, tmp_path):
    (tmp_path / "frames.csv").write_text(text)
    with pytest.raises(InvalidInput):
        load_frames(tmp_path / "frames.csv")
