"""Real-time scheduling of a server and of drivers, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from graspforce.core.errors import InvalidInput
from graspforce.service import use_realtime_scheduling

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="real-time scheduling needs Linux")
_TIMEOUT = 60.0  # s, of a process

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
    command = [sys.executable, "-c", _IMPORTS + program]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=_TIMEOUT).stdout.strip()


@pytest.fixture
def permitted() -> None:
    """Skip a test if this system does not permit real-time scheduling."""
    program = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))"
    if subprocess.run([sys.executable, "-c", program], capture_output=True, check=False, timeout=_TIMEOUT).returncode != 0:
        pytest.skip("this system does not permit real-time scheduling")


@pytest.mark.usefixtures("permitted")
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


@pytest.mark.usefixtures("permitted")
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
            assert process.stdout.readline().startswith("Serving on")
            yield process
        finally:
            process.terminate()
            process.wait(_TIMEOUT)


@pytest.mark.usefixtures("permitted")
def test_all_threads_of_a_realtime_server_are_realtime_and_its_workers_are_not(
    realtime_server: subprocess.Popen[str],
) -> None:
    tasks = Path(f"/proc/{realtime_server.pid}/task")
    threads = [int(each.name) for each in tasks.iterdir()]
    assert len(threads) > 10  # those of Zenoh among them
    assert {os.sched_getscheduler(each) for each in threads} == {os.SCHED_FIFO}
    assert {os.sched_getparam(each).sched_priority for each in threads} == {7}
    children = [int(each) for task in tasks.iterdir() for each in (task / "children").read_text().split()]
    assert len(children) >= 3
    assert {os.sched_getscheduler(each) for each in children} == {os.SCHED_OTHER}
