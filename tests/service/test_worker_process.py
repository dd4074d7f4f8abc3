"""Processes that work for the server: environment, process group, session and pipe."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from graspforce.service.workers import worker_process
from graspforce.service.workers.worker_process import start_piped_worker, start_worker, worker_environment

_SEND_GROUPS = """
import os, sys
from multiprocessing.connection import Connection
pipe = Connection(int(sys.argv[-1]))
pipe.send((os.getpid(), os.getpgid(0), os.getsid(0)))
"""
_SEND_NICENESS = """
import os, sys
from multiprocessing.connection import Connection
pipe = Connection(int(sys.argv[-1]))
pipe.recv()
pipe.send(os.getpriority(os.PRIO_PROCESS, 0))
"""


def test_worker_uses_one_thread_in_any_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("LANG", "C.UTF-8")
    assert worker_environment()["OMP_NUM_THREADS"] == "1"
    assert worker_environment()["LANG"] == "C.UTF-8"


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Popen has no argument process_group")
def test_worker_has_its_own_process_group_in_the_session_of_the_server() -> None:
    """Ctrl-C does not reach it, and its niceness counts beside the server's threads."""
    process, pipe = start_piped_worker([sys.executable, "-c", _SEND_GROUPS], 0)
    with process, pipe:
        assert pipe.recv() == (process.pid, process.pid, os.getsid(0))


@pytest.mark.skipif(not hasattr(os, "setpriority"), reason="this system has no niceness")
@pytest.mark.parametrize(("is_realtime", "niceness"), [(False, 12), (True, 2)])
def test_niceness_of_a_worker_is_ten_less_beside_a_realtime_server(
    is_realtime: bool, niceness: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_process, "is_realtime", lambda: is_realtime)
    process, pipe = start_piped_worker([sys.executable, "-c", _SEND_NICENESS], 12)
    with process, pipe:
        pipe.send("started")
        assert pipe.recv() == min(os.getpriority(os.PRIO_PROCESS, 0) + niceness, 19)


def test_worker_reads_its_standard_input_and_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    program = "import sys; text = sys.stdin.read(); print(text); sys.exit(len(text))"
    process = start_worker([sys.executable, "-c", program], 0, stdin=subprocess.PIPE)
    process.communicate(b"hello", timeout=60.0)
    assert process.returncode == 5
    assert capfd.readouterr().out == ""


def test_missing_program_of_a_worker_is_an_operating_system_error() -> None:
    with pytest.raises(OSError, match="no-such-program"):
        start_piped_worker(["no-such-program"], 0)
