"""Clients that flood, disconnect or send junk: quotas, memory, and the end of their work."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
import time

import pytest
from support.control_requests import GRASP, desired, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT, get, plain_session, python_process, wait_until
from support.service_requests import pinch

from graspforce.core.errors import RequestRefused
from graspforce.service import Client, Server, ServerLimits
from graspforce.service.server import request_handler
from graspforce.service.server.client_sessions import OTHERS, ClientSessions
from graspforce.service.server.work_queues import CostClass
from graspforce.service.wire.reply import describe_error
from graspforce.service.zenoh_session import MAX_MESSAGE_BYTES

DRIVER = """
import sys, time
sys.path.append("tests")
from support.control_requests import GRASP, desired, state
from support.plan_requests import slow_move
from graspforce.service import Client
import threading
client = Client(sys.argv[1], timeout=20.0)
stream = client.open_stream(GRASP)
stream.step(state(0), desired())
threading.Thread(target=lambda: client.plan(slow_move(), budget=60.0), daemon=True).start()
print("ready", flush=True)
while True:
    stream.publish(state(0), desired())
    time.sleep(0.01)
"""


def test_names_without_a_connected_session_belong_to_one_client():
    sessions = ClientSessions()
    sessions.connect("ab12")
    assert sessions.identify(b"ab12") == (b"ab12", b"")
    assert sessions.identify(b"ab12/arm") == (b"ab12", b"arm")
    for made_up in (b"", b"ab1", b"ab123", b"/", b"x" * 5000):
        assert sessions.identify(made_up).session == OTHERS
    sessions.disconnect("ab12")
    assert sessions.identify(b"ab12").session == OTHERS
    assert sessions.ended.get() == b"ab12"


def test_work_of_a_killed_client_ends_within_a_second(server, client):
    with python_process(DRIVER, server.addresses[0]) as (child, line):
        assert line == "ready"
        wait_until(lambda: client.status().streams == 1 and client.status().plans == 1)
        child.kill()
        child.wait(TIMEOUT)
        start = time.monotonic()
        wait_until(lambda: client.status().streams == 0)
        assert time.monotonic() - start <= 1.0
    wait_until(lambda: client.status().plans == 0)


def test_waiting_requests_of_a_client_that_has_disconnected_are_dropped(monkeypatch):
    entered, gate = threading.Semaphore(0), threading.Event()
    solved = queue.SimpleQueue()

    def solve(problem, backend, **limits):
        entered.release()
        assert gate.wait(TIMEOUT)
        solved.put(problem)
        raise RequestRefused("overloaded", "the end of the test")

    monkeypatch.setattr(request_handler, "solve", solve)
    with Server(listen=ANY_LOCAL_PORT, solver_threads=1) as server, plain_session(server.addresses[0]) as gone:
        payload, zid = json.dumps(pinch()), str(gone.zid()).encode()
        for _ in range(10):
            gone.get("graspforce/1/solve", lambda reply: None, payload=payload, attachment=zid, timeout=TIMEOUT)
        assert entered.acquire(timeout=TIMEOUT)
        wait_until(lambda: len(server._queues[CostClass.SMALL]) == 9)
        gone.close()
        wait_until(lambda: len(server._queues[CostClass.SMALL]) == 0)
        gate.set()
    assert solved.qsize() == 1


def test_flood_of_names_gets_one_share(monkeypatch):
    """A session with a thousand names and a polite client are served in turn."""
    entered, gate = threading.Semaphore(0), threading.Event()
    order = []

    def solve(problem, backend, **limits):
        entered.release()
        assert gate.wait(TIMEOUT)
        order.append(problem.name)
        raise RequestRefused("overloaded", "the end of the test")

    monkeypatch.setattr(request_handler, "solve", solve)
    with (
        Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=60) as server,
        plain_session(server.addresses[0]) as flood,
        plain_session(server.addresses[0]) as polite,
    ):

        def send(session, name, attachment):
            payload = json.dumps(pinch(name=name))
            session.get("graspforce/1/solve", replies.put, payload=payload, attachment=attachment, timeout=TIMEOUT)

        replies = queue.SimpleQueue()
        for i in range(200):
            send(flood, "flood", str(i).encode())
        assert entered.acquire(timeout=TIMEOUT)
        wait_until(lambda: len(server._queues[CostClass.SMALL]) == 60 and replies.qsize() == 139)
        refusal = json.loads(replies.get().err.payload.to_bytes())
        assert refusal["error"] == "overloaded"
        assert refusal["retry_after"] > 0.0
        for _ in range(10):
            send(polite, "polite", str(polite.zid()).encode())
        wait_until(lambda: len(server._queues[CostClass.SMALL]._waiting) == 2 and replies.qsize() == 148)
        gate.set()
        wait_until(lambda: len(order) == 61)
    assert order[1:21].count("polite") == 10


def test_quota_of_streams_is_by_client():
    limits = ServerLimits(client_streams=2)
    with (
        Server(["four_finger"], listen=ANY_LOCAL_PORT, limits=limits) as server,
        Client(server.addresses[0], timeout=TIMEOUT) as greedy,
        Client(server.addresses[0], timeout=TIMEOUT) as other,
    ):
        for _ in range(2):
            greedy.open_stream(GRASP).step(state(0), desired())
        with pytest.raises(RequestRefused, match="this client has 2 open streams") as caught:
            greedy.open_stream(GRASP).step(state(0), desired())
        assert caught.value.retry_after > 0.0
        assert other.open_stream(GRASP).step(state(0), desired()).tau.shape == (GRASP.hand.n,)


def test_too_large_messages_are_refused_before_they_are_sent_or_read(server, client):
    with pytest.raises(RequestRefused, match="at most 8388608") as caught:
        client.query("solve", {"schema": "x" * MAX_MESSAGE_BYTES})
    assert caught.value.code == "too_large"
    with plain_session(server.addresses[0]) as raw:
        reply = [*raw.get("graspforce/1/solve", payload=b"x" * (2 * MAX_MESSAGE_BYTES), timeout=0.5)]
        assert all(each.ok is None for each in reply)  # Zenoh has dropped it
        assert get(raw, "status")[0][0]


def test_request_without_a_budget_gets_the_default_one(monkeypatch):
    entered, gate = threading.Semaphore(0), threading.Event()

    def solve(problem, backend, **limits):
        entered.release()
        assert gate.wait(TIMEOUT)
        raise RequestRefused("overloaded", "the end of the test")

    monkeypatch.setattr(request_handler, "solve", solve)
    with (
        Server(listen=ANY_LOCAL_PORT, solver_threads=1, limits=ServerLimits(budget=0.2)) as server,
        plain_session(server.addresses[0]) as raw,
    ):
        running, waiting = (raw.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=TIMEOUT) for _ in range(2))
        assert entered.acquire(timeout=TIMEOUT)
        time.sleep(0.3)
        gate.set()
        assert [json.loads(reply.err.payload.to_bytes())["error"] for reply in (*running, *waiting)] == [
            "overloaded",
            "deadline",
        ]


def test_planning_process_has_a_memory_limit():
    script = (
        "import numpy as np; from graspforce.service.workers.planning_process import limit_memory\n"
        "limit_memory(2**31); np.ones(2**20)\n"
        "try: np.ones(2**29)\n"
        "except MemoryError: print('refused')"
    )
    done = subprocess.run([sys.executable, "-c", script], timeout=TIMEOUT, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "refused\n"), done.stderr
    code, message, field = describe_error(MemoryError(), "hands/four_finger/plan")
    assert (code, field) == ("too_large", None)
    assert "memory" in message
