"""Floods, slow clients and shutdown of a server over Zenoh."""

from __future__ import annotations

import concurrent.futures
import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from functools import partial

import pytest
import zenoh
from support.servers import ANY_LOCAL_PORT, TIMEOUT, plain_session, python_process, server_process, wait_until
from support.service_requests import pinch

import graspforce as gf
from graspforce.core.errors import (
    InvalidInput,
    NoServer,
)
from graspforce.service import Client, Server
from graspforce.service.server import request_handler
from graspforce.service.server.work_queues import CostClass
from graspforce.service.wire import protocol

FREEZE = """
import os, signal, sys, zenoh
from graspforce.service.zenoh_session import build_configuration
session = zenoh.open(build_configuration(None, {"mode": "client", "connect/endpoints": [sys.argv[1]]}, {}))
channels = [session.get("graspforce/1/solve", payload='{"%s": 1}' % ("x" * 4000), timeout=60.0) for _ in range(5000)]
os.kill(os.getpid(), signal.SIGSTOP)
"""

SLOW = """
import logging, sys, time
logging.basicConfig(level=logging.INFO, stream=sys.stdout, format="%(message)s")
from graspforce.service import serve
from graspforce.service.server import request_handler
from graspforce.service.server.work_queues import CostClass
request_handler.solve = lambda *arguments, **keywords: (print("solving", flush=True), time.sleep(600))
serve([], listen="tcp/127.0.0.1:0", on_ready=lambda server: print(server.addresses[0], flush=True), grace=600.0)
print("closed", flush=True)
"""


@pytest.fixture
def process():
    """Run a server in a child process; yields the process and the address."""
    with server_process("four_finger") as served:
        yield served


class Gate:
    """A replacement of `solve` that waits until the gate is open."""

    def __init__(self):
        self.open, self.entered = threading.Event(), threading.Semaphore(0)

    def __call__(self, problem, backend, explain_seconds, deadline):
        self.entered.release()
        assert self.open.wait(TIMEOUT)
        return gf.solve(problem, backend, explain_seconds=explain_seconds, deadline=deadline)


# ── floods and slow work ───────────────────────────────────────────────────────────────────────────────────────────────────


def test_flood_gets_a_reply_to_each_query_and_does_not_delay_status(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    payload, count = protocol.encode({**pinch(), "sequence": 4}, protocol.MSGPACK), 2000
    with Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=5) as server, contextlib.ExitStack() as stack:
        flooder = stack.enter_context(plain_session(server.addresses[0]))
        other = stack.enter_context(Client(server.addresses[0], timeout=TIMEOUT))
        ask = partial(flooder.get, "graspforce/1/solve", payload=payload, encoding=protocol.MSGPACK, timeout=TIMEOUT)
        channels = [ask() for _ in range(count)]
        # The solver thread waits at the gate, so that other threads answer from here on.
        assert gate.entered.acquire(timeout=TIMEOUT)
        wait_until(lambda: other.status().counts.get("solve", {}).get("overloaded", 0) == count - 6)
        assert other.status().queue == 5
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            answer = pool.submit(other.solve, pinch())
            # the newest request of the flood is rejected for it
            wait_until(lambda: other.status().counts["solve"]["overloaded"] == count - 5)
            gate.open.set()
            assert answer.result(TIMEOUT).found
        outcomes = Counter()
        for channel in channels:
            [reply] = channel
            record = protocol.decode((reply.ok or reply.err).payload.to_bytes(), protocol.MSGPACK)
            assert record["sequence"] == 4
            outcomes[record.get("error", "ok")] += 1
        assert outcomes == {"ok": 5, "overloaded": count - 5}  # one at the gate, four waiting
        assert other.solve(pinch()).found


def test_client_that_stops_reading_replies_delays_no_other_client():
    """40 MB of unread replies exceed the buffers of sockets and queues."""
    with Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=10_000) as server:
        with subprocess.Popen([sys.executable, "-c", FREEZE, server.addresses[0]]) as frozen:
            try:
                os.waitid(os.P_PID, frozen.pid, os.WSTOPPED)
                with Client(server.addresses[0], timeout=TIMEOUT) as client:
                    assert client.solve(pinch()).found
                    assert client.status().counts["solve"]["ok"] == 1
            finally:
                frozen.kill()
        with Client(server.addresses[0], timeout=TIMEOUT) as client:
            assert client.solve(pinch()).found


def test_time_in_the_queue_counts_against_the_budget(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    with Server(listen=ANY_LOCAL_PORT, solver_threads=1) as server:
        with plain_session(server.addresses[0]) as session:
            first, second = (
                session.get("graspforce/1/solve", payload=json.dumps({**pinch(), "budget": budget}), timeout=TIMEOUT)
                for budget in (TIMEOUT, 0.05)
            )
            assert gate.entered.acquire(timeout=TIMEOUT)
            time.sleep(0.1)
            gate.open.set()
            [late] = second
            [in_time] = first
            assert in_time.ok is not None
            assert json.loads(late.err.payload.to_bytes())["error"] == "deadline"
        assert not gate.entered.acquire(blocking=False)  # the second was refused without being solved


def test_receiving_thread_only_enqueues(monkeypatch):
    """With all threads blocked and a full queue, the callback returns at once and reads only the client's id and sizes."""
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)

    class QueryWithoutContent:
        attachment = payload = None

        def __getattr__(self, name):
            raise AssertionError(f"the receiving thread reads {name}")

    refused = queue.SimpleQueue()
    monkeypatch.setattr(Server, "_refuse", lambda self, code, message, item, retry: refused.put(item))
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=2)
    with server, Client(server.addresses[0], timeout=TIMEOUT) as client:
        asking = threading.Thread(target=client.solve, args=(pinch(),))
        asking.start()
        assert gate.entered.acquire(timeout=TIMEOUT)
        queries = [QueryWithoutContent() for _ in range(5)]
        for query in queries:
            server._intake.receive("solve", query)
        assert [item.query for item in server._queues[CostClass.SMALL].take_all()] == queries[:2]
        assert [refused.get(timeout=TIMEOUT).query for _ in queries[2:]] == queries[2:]
        gate.open.set()
        asking.join(TIMEOUT)


def test_flood_of_one_client_does_not_delay_another(monkeypatch):
    """While a hundred requests of one client wait, the request of another is handled next."""
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    order: list[str] = []
    answer = Server._answer

    def record_order(self, item):
        order.append("flood" if item.query.attachment.to_bytes() == b"flood" else "client")
        answer(self, item)

    monkeypatch.setattr(Server, "_answer", record_order)
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=40)
    with server, Client(server.addresses[0], timeout=TIMEOUT) as client, plain_session(server.addresses[0]) as session:
        payload, outcomes = json.dumps(pinch()).encode(), queue.SimpleQueue()
        for _ in range(100):
            callback = zenoh.handlers.Callback(lambda reply: outcomes.put(reply.ok is not None))
            session.get("graspforce/1/solve", callback, payload=payload, attachment=b"flood", timeout=TIMEOUT)
        wait_until(lambda: len(server._queues[CostClass.SMALL]) == 40)
        # 40 requests wait and one is being solved; the other 59 are refused
        assert [outcomes.get(timeout=TIMEOUT) for _ in range(59)] == [False] * 59
        asking = threading.Thread(target=client.solve, args=(pinch(),))
        asking.start()
        assert outcomes.get(timeout=TIMEOUT) is False  # the newest request of the flood is rejected
        gate.open.set()
        asking.join(TIMEOUT)
        wait_until(lambda: len(order) == 41)
        assert order.index("client") <= 2  # behind the current request and at most one more


# ── ends ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_shuts_the_server_down_gracefully(process, number):
    child, address = process
    with Client(address, timeout=TIMEOUT) as client:
        assert client.solve(pinch()).found
        child.send_signal(number)
        assert child.wait(TIMEOUT) == 0
        assert child.stdout.read() == "closed\n"
        wait_until(lambda: not client.servers())
        with pytest.raises(NoServer):
            client.solve(pinch())


def test_second_signal_ends_the_wait_for_work():
    with python_process(SLOW) as (child, address), plain_session(address) as session:
        answer = session.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=TIMEOUT)
        assert child.stdout.readline() == "solving\n"
        child.send_signal(signal.SIGINT)
        assert child.stdout.readline().startswith("answering the waiting requests")
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(0.3)  # it waits for the answer
        child.send_signal(signal.SIGINT)
        assert child.wait(TIMEOUT) == 0
        assert child.stdout.read() == "closed\n"
        assert list(answer) == []


def test_waiting_requests_are_answered_before_the_end(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1)
    server.start()
    with plain_session(server.addresses[0]) as session:
        channels = [session.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=TIMEOUT) for _ in range(4)]
        assert gate.entered.acquire(timeout=TIMEOUT)
        wait_until(lambda: len(server._queues[CostClass.SMALL]) == 3)
        closing = threading.Thread(target=server.close)
        closing.start()
        gate.open.set()
        for channel in channels:
            [reply] = channel
            assert reply.ok is not None
        closing.join(TIMEOUT)
        server.close()  # a second call does nothing


def test_endless_work_does_not_prevent_the_end(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1)
    server.start()
    with plain_session(server.addresses[0]) as session:
        busy, waiting = (session.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=TIMEOUT) for _ in range(2))
        assert gate.entered.acquire(timeout=TIMEOUT)
        wait_until(lambda: len(server._queues[CostClass.SMALL]) == 1)
        server.close(grace=0.1)
        [refused] = waiting
        assert json.loads(refused.err.payload.to_bytes())["error"] == "closing"
        gate.open.set()
        for reply in busy:  # the session is closed: the query ends without an answer
            assert reply.err is not None


@pytest.mark.parametrize("forgotten", ["Server(listen='tcp/127.0.0.1:0').start()", "c = Client(sys.argv[1]); c.status()"])
def test_script_without_close_ends(server, forgotten):
    script = f"import sys; from graspforce.service import Client, Server; {forgotten}; print('end')"
    done = subprocess.run([sys.executable, "-c", script, server.addresses[0]], timeout=TIMEOUT, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "end\n"), done.stderr


def test_configuration_file_sets_the_endpoint(tmp_path):
    with Server(listen=ANY_LOCAL_PORT) as free:
        address = free.addresses[0]
    quiet = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}
    served, answer = tmp_path / "server.json5", tmp_path / "client.json5"
    served.write_text(json.dumps({"mode": "peer", "listen": {"endpoints": [address]}, **quiet}))
    answer.write_text(json.dumps({"mode": "client", "connect": {"endpoints": [address]}, **quiet}))
    with Server(config=served) as server, Client(config=answer, timeout=TIMEOUT) as client:
        assert server.addresses == (address,)
        assert client.solve(pinch()).found
    served.write_text("{mode: 'emperor'}")
    with pytest.raises(InvalidInput, match="a Zenoh configuration file") as caught:
        Server(config=served)
    assert caught.value.field == "config"
