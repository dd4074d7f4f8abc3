"""Real-time priorities of streams: bounds on the states a second of one stream and of all."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.realtime import needs_realtime

from graspforce.service.realtime_scheduling import ORDINARY, ServerPriorities
from graspforce.service.server.stream_priorities import StreamPriorities, StreamPriority

PERIOD = 1e-3  # s
OWN, LOWER = 10, 5


def make_priority() -> StreamPriority:
    return StreamPriority("one", PERIOD, OWN, LOWER)


def present_after(priority: StreamPriority, times: np.ndarray) -> list[int]:
    """Return the priority after each state, and check that `count_state` reports its changes."""
    found = [priority.present]
    for time in times:
        changes = priority.count_state(float(time))
        found.append(priority.present)
        assert changes == (found[-1] != found[-2])
    return found[1:]


@given(
    rate=st.floats(0.01, 1.2),
    jitter=st.lists(st.floats(-3.0, 3.0), min_size=400, max_size=400),
    start=st.floats(0.0, 1e6),
)
def test_a_stream_of_its_declared_rate_keeps_its_priority_with_jitter(rate: float, jitter: list[float], start: float) -> None:
    times = start + PERIOD * np.sort(np.arange(len(jitter)) / rate + jitter)
    assert set(present_after(make_priority(), times)) == {OWN}


@given(st.integers(1, 20), st.floats(0.0, 1e6))
def test_a_burst_after_a_pause_keeps_the_priority(burst: int, start: float) -> None:
    assert set(present_after(make_priority(), np.full(burst, start))) == {OWN}


@given(st.floats(1.5, 1e3))
def test_a_stream_that_is_too_fast_loses_its_priority_within_a_bounded_number_of_states(rate: float) -> None:
    found = present_after(make_priority(), np.arange(200) * PERIOD / rate)
    states = int(np.ceil(20.0 / (1.0 - 1.25 / rate)))  # each adds one and drains 1.25 / rate
    assert set(found[: 20 - 1]) == {OWN}
    assert set(found[states + 1 :]) == {LOWER}


def test_the_priority_returns_within_fifty_periods_of_the_declared_rate() -> None:
    priority = make_priority()
    flood = np.arange(5000) * PERIOD / 50.0
    assert present_after(priority, flood)[-1] == LOWER
    found = present_after(priority, flood[-1] + PERIOD * np.arange(1, 100))
    assert found[0] == LOWER
    assert set(found[50:]) == {OWN}  # 11 states drain by a quarter of a state each


def test_a_stream_that_is_too_fast_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    priority = make_priority()
    with caplog.at_level(logging.WARNING, "graspforce.service"):
        for start in (0.0, 10.0, 20.0):
            present_after(priority, start + np.arange(100) * PERIOD / 10.0)
    (record,) = caplog.records
    assert record.getMessage() == "stream one is faster than its period of 0.001 s: its priority is lowered"


def test_streams_beyond_the_states_of_the_server_get_the_priority_of_requests(caplog: pytest.LogCaptureFixture) -> None:
    priorities = StreamPriorities(ServerPriorities(OWN), 3000)
    with caplog.at_level(logging.WARNING, "graspforce.service"):
        opened = [priorities.open(f"fast-{k}", PERIOD) for k in range(4)]
    assert [each and each.present for each in opened] == [OWN, OWN, OWN, LOWER]
    assert "fast-3" in caplog.text
    slow = priorities.open("slow", 1.0)
    assert slow is not None
    assert slow.present == LOWER  # the three take it all
    priorities.close("fast-3")  # had no share
    priorities.close("fast-1")
    again = [priorities.open(f"again-{k}", 4 * PERIOD) for k in range(5)]
    assert [each and each.present for each in again] == [OWN - 2] * 4 + [LOWER]


def test_streams_of_an_ordinary_server_have_no_priority() -> None:
    assert StreamPriorities(ORDINARY, 1).open("one", PERIOD) is None


@needs_realtime
def test_a_stream_that_is_too_fast_runs_at_the_priority_of_requests_until_it_slows_down() -> None:
    program = """
import os, threading, time
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.service import Client, Server
from support.control_requests import GRASP

def priority():
    (found,) = (thread.native_id for thread in threading.enumerate() if thread.name.startswith("stream-"))
    return os.sched_getparam(found).sched_priority

rest = BodyMotion(GRASP.p_HO, GRASP.R_HO)
state = GraspState(GRASP.q, 0.0 * GRASP.q, rest)
with Server([GRASP.hand], listen="tcp/127.0.0.1:0", realtime=9) as server, Client(server.addresses[0]) as client:
    with client.open_stream(GRASP, ControlSettings(period=0.02)) as stream:
        found = [priority()]
        for _ in range(60):
            stream.step(state, rest, wait=5.0)
        found.append(priority())
        for _ in range(60):
            time.sleep(0.02)
            stream.step(state, rest, wait=5.0)
        found.append(priority())
print(found)
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60.0, env=environment)
    assert done.stdout.strip() == "[5, 4, 5]", done.stderr
