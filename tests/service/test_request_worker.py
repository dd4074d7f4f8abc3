"""Worker processes: their answers, and the replacement of dead or hanging ones."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

import pytest
from support.control_requests import CONTROL, HAND, request
from support.servers import ANY_LOCAL_PORT, TIMEOUT, get, plain_session
from support.service_requests import pinch

from graspforce.service import Client, RequestHandler, Server, ServerLimits
from graspforce.service.server.request_worker import COMMAND, RequestWorker
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK

# Replacements of a worker process: each receives its setup and a request, and then does what its name says.
_SILENT = "import sys; from multiprocessing.connection import Connection; p = Connection(int(sys.argv[-1])); "
_SILENT += "[p.recv_bytes() for _ in range(2)]; "
DIES = (sys.executable, "-c", _SILENT + "sys.exit(3)")
HANGS = (sys.executable, "-c", _SILENT + "import time; time.sleep(600)")


def decoded(reply):
    record = protocol.decode(reply.payload, reply.encoding)
    record.pop("server_seconds", None)
    for each in (record, record.get("solution", {})):
        each.get("solver", {}).pop("seconds", None)
    return record


@pytest.fixture(scope="module")
def worker():
    """Yield a worker with a real process."""
    running = RequestWorker([HAND], ServerLimits(), niceness=1)
    yield running
    running.close()


@pytest.mark.parametrize("codec", [JSON, MSGPACK])
@pytest.mark.parametrize(
    ("key", "record"),
    [("solve", pinch()), (CONTROL, request()), ("solve", {"schema": 3}), ("hands/none", {})],
    ids=["solve", "control", "invalid", "unknown"],
)
def test_answer_is_that_of_the_handler(worker, codec, key, record):
    payload, now = protocol.encode(record if isinstance(record, dict) else record.to_dict(), codec), time.perf_counter()
    outcome, reply = worker.compute(key, payload, codec, now)
    expected_outcome, expected = RequestHandler([HAND]).compute(key, payload, codec, now)
    assert (outcome, reply.ok, reply.encoding) == (expected_outcome, expected.ok, codec)
    assert decoded(reply) == decoded(expected)


def test_time_before_the_work_counts_against_the_budget(worker):
    payload = protocol.encode({**pinch(), "budget": 0.5, "sequence": 3}, MSGPACK)
    outcome, reply = worker.compute("solve", payload, MSGPACK, time.perf_counter() - 0.6)
    assert (outcome, decoded(reply)["sequence"]) == ("deadline", 3)


def test_signals_of_a_service_manager_do_not_end_a_process(worker):
    solve = protocol.encode(pinch(), MSGPACK)
    assert worker.compute("solve", solve, MSGPACK, time.perf_counter())[0] == "ok"
    process = worker._process
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        os.kill(process.pid, number)
    assert worker.compute("solve", solve, MSGPACK, time.perf_counter())[0] == "ok"
    assert worker._process is process


@pytest.mark.parametrize(("command", "code"), [(DIES, "internal"), (HANGS, "deadline")])
def test_process_without_an_answer_is_replaced(command, code, caplog):
    worker = RequestWorker([HAND], ServerLimits(stall_time=1.0), niceness=1, command=command)
    solve = protocol.encode(pinch(), MSGPACK)
    outcome, reply = worker.compute("solve", solve, MSGPACK, time.perf_counter())
    assert (outcome, decoded(reply)["error"], reply.ok) == (code, code, False)
    assert len(caplog.records) == 1
    worker._command = COMMAND
    worker._setup = RequestWorker([HAND], ServerLimits(), niceness=1)._setup
    assert worker.compute("solve", solve, MSGPACK, time.perf_counter())[0] == "ok"
    worker.close()


def test_close_ends_the_request_in_progress():
    worker, outcomes = RequestWorker([HAND], ServerLimits(), niceness=1, command=HANGS), []
    worker.start()
    solve = protocol.encode(pinch(), JSON)
    asking = threading.Thread(target=lambda: outcomes.append(worker.compute("solve", solve, None, time.perf_counter())[0]))
    asking.start()
    time.sleep(0.1)
    worker.close()
    asking.join(TIMEOUT)
    assert outcomes == ["closing"]
    assert worker.compute("solve", solve, None, time.perf_counter())[0] == "closing"


def test_server_with_worker_processes_answers_and_counts():
    with (
        Server(["four_finger"], listen=ANY_LOCAL_PORT, solver_threads=1, worker_processes=True) as server,
        Client(server.addresses[0], timeout=TIMEOUT) as client,
        plain_session(server.addresses[0]) as session,
    ):
        assert client.solve(pinch()).found
        [(ok, _, _)] = get(session, "explain", payload=protocol.encode(pinch(), JSON))
        assert ok
        [(ok, _, _)] = get(session, "hands/four_finger/inverse", payload='{"tips": {}, "sequence": 1}')
        assert not ok
        status = client.status()
        assert status.counts["solve"] == {"ok": 1}
        assert status.counts["explain"] == {"ok": 1}
        assert len(status.latencies["solve"]) == 1
