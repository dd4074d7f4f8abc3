"""Free memory goes back to the operating system after large messages."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest
from support.servers import wait_until
from support.service_requests import pinch

from graspforce.service.server.free_memory import release_free_memory
from graspforce.service.server.plan_turns import PlanTurns
from graspforce.service.server.server_load import resident_bytes
from graspforce.service.server.work_queues import CostClass, QueuedQuery, QueueOptions, WorkQueues
from graspforce.service.workers.planning_worker import PlanningWorker


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="malloc_trim is of the GNU C library")
def test_heap_shrinks_after_many_blocks_are_freed():
    blocks = [bytes(100_000) for _ in range(600)]  # below the size that malloc maps alone
    top = resident_bytes()
    keep = blocks[-1]
    del blocks
    release_free_memory()
    assert len(keep) == 100_000
    assert top - resident_bytes() > 40e6


_COUNT_HEAPS = """
import ctypes, sys, threading
from graspforce.service.server.free_memory import share_heap

if sys.argv[1] == "shared":
    share_heap()
barrier = threading.Barrier(5)

def work():
    blocks = [bytes(5000 + i) for i in range(50)]  # larger than those that Python allocates itself
    barrier.wait(10.0)

threads = [threading.Thread(target=work) for _ in range(4)]
for thread in threads:
    thread.start()
c = ctypes.CDLL(None)
c.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(c.fopen(sys.argv[2].encode(), b"w"))
barrier.wait(10.0)
c.malloc_info(0, file)
c.fclose(file)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="malloc_info is of the GNU C library")
@pytest.mark.parametrize(("mode", "limit", "heaps"), [("shared", None, {1}), ("own", None, {2, 3, 4, 5}), ("shared", "3", {3})])
def test_threads_share_one_heap_unless_the_environment_has_a_number_of_heaps(mode, limit, heaps, tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    if limit is not None:
        environment["MALLOC_ARENA_MAX"] = limit
    report = tmp_path / "report.xml"
    subprocess.run([sys.executable, "-c", _COUNT_HEAPS, mode, str(report)], check=True, timeout=60.0, env=environment)
    assert report.read_text().count("<heap nr=") in heaps


@pytest.mark.parametrize(("size", "released"), [(32 * 2**20, 1), (2**10, 0)])
def test_queues_release_memory_once_after_large_requests(size, released, monkeypatch):
    calls = []
    monkeypatch.setattr("graspforce.service.server.work_queues.release_free_memory", lambda: calls.append(1))
    queues = WorkQueues(QueueOptions(1, 1, 10, 2**30), lambda item: None, lambda item: None, lambda item: None)
    client = type("Client", (), {"session": b"", "name": b""})()
    queues.offer(QueuedQuery("solve", pinch(), time.perf_counter(), client, CostClass.LARGE, size))
    wait_until(lambda: queues.waiting_bytes == 0)
    queues.release_memory()
    queues.release_memory()
    assert len(calls) == released


def test_planning_processes_start_before_the_first_plan_and_only_once():
    worker = PlanningWorker((sys.executable, "-c", "import time; time.sleep(60)"))
    PlanTurns([worker]).start_processes()
    process = worker._process
    assert process is not None
    assert process.poll() is None
    worker.start()
    assert worker._process is process
    worker.close()
    worker.start()
    assert worker._process is None
