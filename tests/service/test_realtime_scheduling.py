"""Real-time scheduling of a server and of drivers, each in a process of its own."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.realtime import needs_realtime

from graspforce.core.errors import InvalidInput
from graspforce.service import Client, use_realtime_scheduling
from graspforce.service.realtime_scheduling import ServerPriorities

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="real-time scheduling needs Linux")
_TIMEOUT = 60.0  # s, of a process

_TESTS = str(Path(__file__).parents[1])
_IMPORTS = """
import os, resource, subprocess, sys, threading
from graspforce.core.errors import InvalidInput
from graspforce.service import ordinary_scheduling, use_realtime_scheduling

def policies():
    return {os.sched_getscheduler(int(each)) for each in os.listdir("/proc/self/task")}

def child_policy():
    program = "import os; print(os.sched_getscheduler(0))"
    return int(subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout)
"""


def run(program: str) -> str:
    """Return what a program prints in a process of its own."""
    command, environment = [sys.executable, "-c", _IMPORTS + program], {**os.environ, "PYTHONPATH": _TESTS}
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_TIMEOUT, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@needs_realtime
def test_all_threads_become_realtime_those_that_run_and_those_that_start_later() -> None:
    program = """
event, later = threading.Event(), []
threading.Thread(target=event.wait).start()
use_realtime_scheduling(7)
assert policies() == {os.SCHED_FIFO}, policies()
thread = threading.Thread(target=lambda: later.append((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority)))
thread.start()
thread.join()
event.set()
print(later == [(os.SCHED_FIFO, 7)])
"""
    assert run(program) == "True"


@needs_realtime
def test_processes_are_realtime_unless_they_start_within_ordinary_scheduling() -> None:
    program = """
use_realtime_scheduling(7)
inherited = child_policy()
with ordinary_scheduling():
    ordinary = child_policy()
print(inherited == os.SCHED_FIFO, ordinary == os.SCHED_OTHER, policies() == {os.SCHED_FIFO})
"""
    assert run(program) == "True True True"


def test_ordinary_scheduling_changes_nothing_in_an_ordinary_thread() -> None:
    program = """
before = policies()
with ordinary_scheduling():
    print(child_policy() == os.SCHED_OTHER, policies() == before == {os.SCHED_OTHER})
"""
    assert run(program) == "True True"


def test_the_error_names_the_limit_if_the_system_does_not_permit_it() -> None:
    program = """
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
if os.getuid() == 0:
    os.setuid(65534)  # nobody: without CAP_SYS_NICE
try:
    use_realtime_scheduling()
except InvalidInput as error:
    print(error, policies() == {os.SCHED_OTHER})
"""
    found = run(program)
    assert found.endswith("True")
    for part in ("priority = 10", "ulimit -r", "LimitRTPRIO", "CAP_SYS_NICE"):
        assert part in found


@pytest.mark.parametrize("priority", [0, 50, 2.5, True])
def test_priorities_out_of_range_are_refused(priority: float) -> None:
    with pytest.raises(InvalidInput, match="priority"):
        use_realtime_scheduling(priority)  # type: ignore[arg-type]
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


@pytest.fixture
def realtime_server(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a server with real-time scheduling, and yield its process when it serves."""
    command = [sys.executable, "-m", "graspforce", "serve", "--listen", "tcp/127.0.0.1:0", "--realtime", "7"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().removeprefix("Serving on ").split(";")[0]
            with Client(address, timeout=_TIMEOUT) as client:
                assert client.status().streams == 0  # Zenoh starts its receivers with the first connection
                yield process
        finally:
            process.terminate()
            process.wait(_TIMEOUT)


@needs_realtime
def test_all_threads_of_a_realtime_server_are_realtime_and_its_workers_are_not(
    realtime_server: subprocess.Popen[str],
) -> None:
    tasks = Path(f"/proc/{realtime_server.pid}/task")
    names = {int(each.name): (each / "comm").read_text().strip() for each in tasks.iterdir()}
    priorities = {thread: os.sched_getparam(thread).sched_priority for thread in names}
    assert {os.sched_getscheduler(each) for each in names} == {os.SCHED_FIFO}
    receivers = [thread for thread, name in names.items() if name.startswith(("rx-", "tx-"))]
    assert {priorities[each] for each in receivers} == {7}  # Zenoh's
    assert priorities[realtime_server.pid] == 2
    assert set(priorities.values()) == {2, 7}
    children = [int(each) for task in tasks.iterdir() for each in (task / "children").read_text().split()]
    assert len(children) >= 3
    assert {os.sched_getscheduler(each) for each in children} == {os.SCHED_OTHER}


@needs_realtime
def test_a_stream_has_a_higher_priority_than_slower_streams_and_requests() -> None:
    program = """

from graspforce.control import ControlSettings
from graspforce.service import Client, Server
from support.control_requests import GRASP

def priorities(prefix):
    found = (thread.native_id for thread in threading.enumerate() if thread.name.startswith(prefix))
    return [os.sched_getparam(each).sched_priority for each in found]

with Server([GRASP.hand], listen="tcp/127.0.0.1:0", realtime=9) as server, Client(server.addresses[0]) as client:
    found = []
    for period in (1e-3, 4e-3, 0.1):
        with client.open_stream(GRASP, ControlSettings(period=period)):
            found += priorities("stream-")
    print(found, priorities("idle-streams"), end=" ")
print(policies() == {os.SCHED_OTHER})
"""
    assert run(program) == "[9, 7, 5] [4] True"


@pytest.mark.parametrize("highest", [1, 3, 10, 49])
def test_priorities_of_streams_never_rise_with_the_period_and_stay_in_range(highest: int) -> None:
    priorities = ServerPriorities(highest)
    found = [priorities.of_stream(period) for period in np.geomspace(1e-5, 10.0, 200)]
    assert all(a is not None and b is not None and a >= b for a, b in itertools.pairwise(found))
    assert found[0] == highest
    lowest, requests = found[-1], priorities.requests
    assert lowest is not None
    assert requests is not None
    assert 1 <= requests <= lowest
    assert requests < lowest or highest <= 5  # too few priorities below the highest


def test_ordinary_priorities_change_nothing() -> None:
    priorities = ServerPriorities(None)
    priorities.apply()
    with priorities.for_messages():
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
    priorities.end()
    assert (priorities.requests, priorities.of_stream(1e-3)) == (None, None)


def test_a_server_that_cannot_start_leaves_its_process_ordinary() -> None:
    program = """
from graspforce.core.errors import GraspForceError
from graspforce.service import Server

try:
    Server(listen="tcp/256.0.0.1:0", realtime=5, insecure=True).start()
except GraspForceError as error:
    print(policies() == {os.SCHED_OTHER})
"""
    assert run(program) == "True"
