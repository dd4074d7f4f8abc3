"""Cost classes of requests: their queues, and workers of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest
from support.servers import ANY_LOCAL_PORT, TIMEOUT, get, plain_session
from support.service_requests import pinch

from graspforce.service import Client, Server
from graspforce.service.server import request_handler
from graspforce.service.server.work_queues import CostClass, cost_class

SERVE_AND_COUNT_THREADS = """
import os, signal
from threadpoolctl import threadpool_info
from graspforce.service import serve

def count(server):
    print(*(each["num_threads"] for each in threadpool_info()), flush=True)
    os.kill(os.getpid(), signal.SIGTERM)

serve([], listen="tcp/127.0.0.1:0", on_ready=count)
"""


@pytest.mark.parametrize(
    ("key", "size", "cost"),
    [
        ("status", 0, CostClass.STATUS),
        ("hands/four_finger", 0, CostClass.STATUS),
        ("hands/plan", 0, CostClass.STATUS),  # the description of a hand of this name
        ("hands/four_finger/forward", 10**6, CostClass.STATUS),
        ("hands/four_finger/control", 10**6, CostClass.SMALL),
        ("hands/four_finger/inverse", 0, CostClass.SMALL),
        ("streams/a", 10**5, CostClass.SMALL),
        ("solve", 8 * 2**10, CostClass.SMALL),
        ("solve", 8 * 2**10 + 1, CostClass.LARGE),
        ("hands/four_finger/distribute", 8000, CostClass.SMALL),
        ("hands/four_finger/distribute", 10**5, CostClass.LARGE),
        ("explain", 0, CostClass.LARGE),
        ("quality", 0, CostClass.LARGE),
        ("hands/four_finger/plan", 0, CostClass.PLAN),
        ("hands/four_finger/grasp", 0, CostClass.PLAN),
    ],
)
def test_key_and_size_decide_the_class(key, size, cost):
    assert cost_class(key, size) is cost


def test_explanations_delay_no_small_requests(monkeypatch):
    is_open, entered = threading.Event(), threading.Semaphore(0)

    def wait(problem, direction, seconds):
        entered.release()
        assert is_open.wait(TIMEOUT)
        raise RuntimeError

    monkeypatch.setattr(request_handler, "explain", wait)
    with Server(["four_finger"], listen=ANY_LOCAL_PORT, solver_threads=1) as server:
        address = server.addresses[0]
        with Client(address, timeout=TIMEOUT) as client, plain_session(address) as session:
            for _ in range(3):
                session.get("graspforce/1/explain", lambda reply: None, payload=str(pinch()).replace("'", '"'), timeout=TIMEOUT)
            assert entered.acquire(timeout=TIMEOUT)
            assert client.solve(pinch()).found
            [(ok, _, _)] = get(session, "hands/four_finger/forward", payload='{"posture": [0,0,0,0,0,0,0,0,0,0,0,0]}')
            assert ok
            assert client.status().queue == 2  # two explanations wait, one is at work
            is_open.set()


def test_serving_process_has_one_thread_of_linear_algebra():
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "4", "OMP_NUM_THREADS": "4"}
    command = [sys.executable, "-c", SERVE_AND_COUNT_THREADS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) == {"1"}
