"""The service over real Zenoh on this machine: nothing is left without a reply, nobody stops anybody else, ends are orderly."""

from __future__ import annotations

import concurrent.futures
import contextlib
import json
import math
import os
import queue
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from functools import partial

import pytest
import zenoh
from support.servers import ANY_LOCAL_PORT, PATIENCE, get, plain_session, python_process, server_process, suspend, wait_until
from support.service_requests import BAD_RECORDS, PINCH_OBJECTIVE, distribute_request, infeasible_pinch, pinch

import graspforce as gf
from graspforce.core.errors import (
    ErrorReply,
    InvalidInput,
    NoServer,
    RequestRefused,
    ServiceError,
    ServiceTimeout,
    UnknownName,
)
from graspforce.hand.hand import Hand
from graspforce.service import Client, Server
from graspforce.service.server import request_handler
from graspforce.service.wire import protocol

FREEZE = """
import os, signal, sys, zenoh
from graspforce.service.zenoh_session import build_configuration
session = zenoh.open(build_configuration(None, {"mode": "client", "connect/endpoints": [sys.argv[1]]}, {}))
channels = [session.get("graspforce/1/solve", payload='{"%s": 1}' % ("x" * 4000), timeout=60.0) for _ in range(5000)]
os.kill(os.getpid(), signal.SIGSTOP)
"""

SLOW = """
import time
from graspforce.service import serve
from graspforce.service.server import request_handler
request_handler.solve = lambda *arguments, **keywords: (print("at work", flush=True), time.sleep(600))
serve([], listen="tcp/127.0.0.1:0", on_ready=lambda server: print(server.addresses[0], flush=True), grace=600.0)
print("closed", flush=True)
"""


@pytest.fixture
def process():
    """A server in a process of its own, and its address."""
    with server_process("four_finger") as served:
        yield served


class Gate:
    """A stand-in for `solve` that waits until it is opened."""

    def __init__(self):
        self.open, self.entered = threading.Event(), threading.Semaphore(0)

    def __call__(self, problem, backend, explain):
        self.entered.release()
        assert self.open.wait(PATIENCE)
        return gf.solve(problem, backend, explain=explain)


# ── answers ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_the_client_gets_what_python_gets(server, encoding):
    hand, problem = Hand.load("four_finger"), gf.ForceProblem.from_dict(pinch())
    with Client(server.addresses[0], timeout=PATIENCE, encoding=encoding) as client:
        solution = client.solve(problem, backend="clarabel")
        assert solution.status is gf.Status.OPTIMAL
        assert solution.objective == pytest.approx(PINCH_OBJECTIVE, rel=1e-7)  # the certificate's tolerance with room
        assert client.solve(pinch()).forces[0] == pytest.approx(solution.forces[0])
        assert client.solve(infeasible_pinch()).status is gf.Status.INFEASIBLE
        held = client.distribute("four_finger", distribute_request(hand))
        assert held.status is gf.Status.OPTIMAL
        assert held.torques.shape == (hand.n,)
        assert client.hands() == ("four_finger",)
        assert client.hand("four_finger") == json.loads(json.dumps(hand.describe()))
        assert client.servers() == (server.id,)
        status = client.status()
        assert (status.server, status.version) == (server.id, gf.__version__)
        assert status.counts["solve"]["ok"] >= 3
        answer = client.query("solve", pinch(), budget=5.0)
        assert 0.0 < answer["server_seconds"] < 5.0
        assert client.query("status", {})["sequence"] == answer["sequence"] + 1


def test_anybody_can_ask_in_json(raw):
    [(ok, encoding, payload)] = get(raw, "solve", json.dumps({**pinch(), "sequence": 5}))
    assert (ok, encoding) == (True, "application/json")
    answer = json.loads(payload)
    assert (answer["status"], answer["sequence"]) == ("optimal", 5)
    for key, field, value in (("status", "hands", ["four_finger"]), ("hands/four_finger", "name", "four_finger")):
        [(ok, encoding, payload)] = get(raw, key)
        assert (ok, encoding) == (True, "application/json")
        assert json.loads(payload)[field] == value


def test_a_question_to_many_keys_gets_each_keys_reply_once(raw):
    replies = get(raw, "**", b"{}")
    # solve, distribute, control and plan lack their fields, status and the description do not; streams are opened one by one
    assert sorted(ok for ok, _, _ in replies) == [False, False, False, False, True, True]


# ── errors ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_bad_input_gets_the_text_that_python_gives(client):
    for name, record in BAD_RECORDS:
        if not isinstance(record, dict) or name == "a huge whole number":  # the client itself would not send them
            continue
        with pytest.raises(InvalidInput) as caught:
            gf.ForceProblem.from_dict(record)
        with pytest.raises(ErrorReply) as replied:
            client.solve(record)
        assert (replied.value.code, str(replied.value)) == (caught.value.code, str(caught.value)), name
        assert replied.value.field == (caught.value.field or None)
    assert client.solve(pinch()).found


def test_bytes_of_any_kind_get_an_error_and_the_server_lives(raw, client):
    chance = random.Random(7)
    for encoding, whole in (
        (None, json.dumps(pinch()).encode()),
        ("application/msgpack", protocol.encode(pinch(), protocol.MSGPACK)),
    ):
        cuts = [whole[: chance.randrange(len(whole))] for _ in range(20)]
        noise = [chance.randbytes(chance.randrange(1, 300)) for _ in range(20)]
        for payload in [*cuts, *noise, b"", None]:
            [(ok, said, reply)] = get(raw, "solve", payload, encoding)
            assert not ok
            assert protocol.decode(reply, said)["error"] == "invalid"
    assert client.solve(pinch()).found


def test_unknown_names_are_told_the_known_ones(client, raw):
    for ask in (partial(client.hand, "left"), partial(client.distribute, "left", {})):
        with pytest.raises(ErrorReply, match="hand = 'left': must be one of four_finger") as caught:
            ask()
        assert caught.value.code == "unknown"
    with pytest.raises(UnknownName, match="a hand's name"):
        client.hand("a/b")
    [(ok, _, reply)] = get(raw, "hands/four_finger/dance")
    assert not ok
    assert json.loads(reply)["error"] == "unknown"


def test_a_key_that_is_not_served_is_refused_and_not_silent(client):
    with pytest.raises(RequestRefused, match="nowhere got no answer") as caught:
        client.query("nowhere", {})
    assert caught.value.code == "not_permitted"


def test_too_large_is_refused(client):
    with pytest.raises(RequestRefused, match="501 contacts") as caught:
        client.solve(pinch(contacts=[{}] * 501))
    assert caught.value.code == "too_large"


def test_an_argument_of_the_client_is_checked(server):
    for arguments in ({"timeout": 0}, {"timeout": math.nan}, {"encoding": "xml"}, {"config": "/no/such/file.json5"}):
        with pytest.raises(InvalidInput) as caught:
            Client(server.addresses[0], **arguments)
        assert caught.value.field in arguments


def test_a_reply_of_another_question_is_an_error(monkeypatch, client):
    monkeypatch.setattr(protocol, "find_sequence", lambda request: 10**9)
    with pytest.raises(ErrorReply, match="sequence") as caught:
        client.status()
    assert caught.value.code == "internal"


# ── four ways to get no answer ─────────────────────────────────────────────────────────────────────────────────────────────


def test_no_server_timeout_and_a_server_that_returns_are_told_apart(process):
    child, address = process
    with Client(address, timeout=PATIENCE) as client:
        assert client.solve(pinch()).found
        suspend(child)
        with pytest.raises(ServiceTimeout, match=r"within 0\.2 s"):
            client.solve(pinch(), timeout=0.2)
        with pytest.raises(ServiceTimeout, match="opening"):
            Client(address, timeout=0.2)
        child.send_signal(signal.SIGCONT)
        assert client.solve(pinch()).found
        child.kill()
        child.wait(PATIENCE)
        wait_until(lambda: not client.servers())
        with pytest.raises(NoServer, match=address):
            client.status()
        assert client.servers() == ()
    with pytest.raises(NoServer, match=address):
        Client(address, timeout=PATIENCE)


def test_a_server_that_dies_over_a_question_ends_the_wait(process):
    child, address = process
    with Client(address, timeout=PATIENCE) as client:
        suspend(child)
        threading.Timer(0.2, child.kill).start()
        with pytest.raises(NoServer):
            client.solve(pinch())


def test_the_client_finds_a_server_that_comes_back():
    with Server(listen=ANY_LOCAL_PORT) as first:
        address = first.addresses[0]
        client = Client(address, timeout=PATIENCE)
        assert client.solve(pinch()).found
    with client:
        with pytest.raises(NoServer):
            client.solve(pinch())
        with Server(listen=address) as second:
            wait_until(client.servers)
            assert client.servers() == (second.id,)
            assert client.solve(pinch()).found


def test_an_address_that_is_taken_is_named(server):
    with pytest.raises(ServiceError, match=f"cannot listen on {server.addresses[0]}: .*in use"):
        Server(listen=server.addresses[0]).start()


def test_a_hand_that_is_not_there_is_named_before_anything_listens():
    with pytest.raises(UnknownName, match="four_finger"):
        Server(["no_hand"], listen=ANY_LOCAL_PORT)


# ── floods and slow work ───────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_flood_gets_a_reply_to_every_query_and_status_is_not_delayed(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    payload, count = protocol.encode({**pinch(), "sequence": 4}, protocol.MSGPACK), 2000
    with Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=5) as server, contextlib.ExitStack() as stack:
        flooder = stack.enter_context(plain_session(server.addresses[0]))
        other = stack.enter_context(Client(server.addresses[0], timeout=PATIENCE))
        ask = partial(flooder.get, "graspforce/1/solve", payload=payload, encoding=protocol.MSGPACK, timeout=PATIENCE)
        channels = [ask() for _ in range(count)]
        # The worker stands at the gate, so whoever answers now is not the worker.
        assert gate.entered.acquire(timeout=PATIENCE)
        wait_until(lambda: other.status().counts.get("solve", {}).get("overloaded", 0) == count - 6)
        assert other.status().queue == 5
        with concurrent.futures.ThreadPoolExecutor(1) as pool:
            asked = pool.submit(other.solve, pinch())
            wait_until(
                lambda: other.status().counts["solve"]["overloaded"] == count - 5
            )  # the flood's newest makes room for it
            gate.open.set()
            assert asked.result(PATIENCE).found
        outcomes = Counter()
        for channel in channels:
            [reply] = channel
            record = protocol.decode((reply.ok or reply.err).payload.to_bytes(), protocol.MSGPACK)
            assert record["sequence"] == 4
            outcomes[record.get("error", "ok")] += 1
        assert outcomes == {"ok": 5, "overloaded": count - 5}  # one at the gate, four that waited
        assert other.solve(pinch()).found


def test_a_client_that_freezes_over_its_replies_stops_nobody():
    """Replies of 8 kB that nobody reads, 40 MB of them, are more than sockets and queues hold."""
    with Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=10_000) as server:
        with subprocess.Popen([sys.executable, "-c", FREEZE, server.addresses[0]]) as frozen:
            try:
                os.waitid(os.P_PID, frozen.pid, os.WSTOPPED)
                with Client(server.addresses[0], timeout=PATIENCE) as client:
                    assert client.solve(pinch()).found
                    assert client.status().counts["solve"]["ok"] == 1
            finally:
                frozen.kill()
        with Client(server.addresses[0], timeout=PATIENCE) as client:
            assert client.solve(pinch()).found


def test_time_in_the_queue_counts_against_the_budget(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    with Server(listen=ANY_LOCAL_PORT, solver_threads=1) as server:
        with plain_session(server.addresses[0]) as session:
            first, second = (
                session.get("graspforce/1/solve", payload=json.dumps({**pinch(), "budget": budget}), timeout=PATIENCE)
                for budget in (PATIENCE, 0.05)
            )
            assert gate.entered.acquire(timeout=PATIENCE)
            time.sleep(0.1)
            gate.open.set()
            [late] = second
            [in_time] = first
            assert in_time.ok is not None
            assert json.loads(late.err.payload.to_bytes())["error"] == "deadline"
        assert not gate.entered.acquire(blocking=False)  # the second was refused, not done late


def test_the_receiving_thread_only_takes_in(monkeypatch):
    """With every worker blocked and no room, what Zenoh calls returns at once, and asks of the query only whose it is."""
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)

    class Untouchable:
        attachment = None

        def __getattr__(self, name):
            raise AssertionError(f"the receiving thread asks for {name}")

    refused = queue.SimpleQueue()
    monkeypatch.setattr(Server, "_refuse", lambda self, code, message, arrival: refused.put(arrival))
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=2)
    with server, Client(server.addresses[0], timeout=PATIENCE) as client:
        asking = threading.Thread(target=client.solve, args=(pinch(),))
        asking.start()
        assert gate.entered.acquire(timeout=PATIENCE)
        queries = [Untouchable() for _ in range(5)]
        for query in queries:
            server._receive(server._work_queue, "solve", query)
        assert [arrival.query for arrival in server._work_queue.take_all()] == queries[:2]
        assert [refused.get(timeout=PATIENCE).query for _ in queries[2:]] == queries[2:]
        gate.open.set()
        asking.join(PATIENCE)


def test_one_client_is_served_beside_another_that_asks_for_everything(monkeypatch):
    """A hundred requests of one wait; another's one request is the second to be worked on, and none is refused for it."""
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    order: list[str] = []
    work = Server._answer

    def noted(self, arrival):
        order.append("flood" if arrival.query.attachment.to_bytes() == b"flood" else "client")
        work(self, arrival)

    monkeypatch.setattr(Server, "_answer", noted)
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1, capacity=40)
    with server, Client(server.addresses[0], timeout=PATIENCE) as client, plain_session(server.addresses[0]) as session:
        payload, outcomes = json.dumps(pinch()).encode(), queue.SimpleQueue()
        for _ in range(100):
            said = zenoh.handlers.Callback(lambda reply: outcomes.put(reply.ok is not None))
            session.get("graspforce/1/solve", said, payload=payload, attachment=b"flood", timeout=PATIENCE)
        wait_until(lambda: len(server._work_queue) == 40)
        assert [outcomes.get(timeout=PATIENCE) for _ in range(59)] == [False] * 59  # no room; one is being worked on
        asking = threading.Thread(target=client.solve, args=(pinch(),))
        asking.start()
        assert outcomes.get(timeout=PATIENCE) is False  # the newest of the flood makes room
        gate.open.set()
        asking.join(PATIENCE)
        wait_until(lambda: len(order) == 41)
        assert order.index("client") <= 2  # behind the one at work, and one whose turn it was


# ── ends ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_closes_the_server_in_order(process, number):
    child, address = process
    with Client(address, timeout=PATIENCE) as client:
        assert client.solve(pinch()).found
        child.send_signal(number)
        assert child.wait(PATIENCE) == 0
        assert child.stdout.read() == "closed\n"
        wait_until(lambda: not client.servers())
        with pytest.raises(NoServer):
            client.solve(pinch())


def test_a_second_signal_does_not_wait_for_work():
    with python_process(SLOW) as (child, address), plain_session(address) as session:
        asked = session.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=PATIENCE)
        assert child.stdout.readline() == "at work\n"
        child.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(0.3)  # it waits for its work
        child.send_signal(signal.SIGINT)
        assert child.wait(PATIENCE) == 0
        assert child.stdout.read() == "closed\n"
        assert list(asked) == []


def test_what_waits_is_answered_before_the_end(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1)
    server.start()
    with plain_session(server.addresses[0]) as session:
        channels = [session.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=PATIENCE) for _ in range(4)]
        assert gate.entered.acquire(timeout=PATIENCE)
        wait_until(lambda: len(server._work_queue) == 3)
        closing = threading.Thread(target=server.close)
        closing.start()
        gate.open.set()
        for channel in channels:
            [reply] = channel
            assert reply.ok is not None
        closing.join(PATIENCE)
        server.close()  # a second time: nothing


def test_work_that_does_not_end_does_not_stop_the_end(monkeypatch):
    gate = Gate()
    monkeypatch.setattr(request_handler, "solve", gate)
    server = Server(listen=ANY_LOCAL_PORT, solver_threads=1)
    server.start()
    with plain_session(server.addresses[0]) as session:
        busy, waiting = (session.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=PATIENCE) for _ in range(2))
        assert gate.entered.acquire(timeout=PATIENCE)
        wait_until(lambda: len(server._work_queue) == 1)
        server.close(grace=0.1)
        [refused] = waiting
        assert json.loads(refused.err.payload.to_bytes())["error"] == "overloaded"
        gate.open.set()
        for reply in busy:  # its session is gone: no answer, but no wait either
            assert reply.err is not None


@pytest.mark.parametrize("forgotten", ["Server(listen='tcp/127.0.0.1:0').start()", "c = Client(sys.argv[1]); c.status()"])
def test_a_script_that_forgets_to_close_ends(server, forgotten):
    script = f"import sys; from graspforce.service import Client, Server; {forgotten}; print('end')"
    done = subprocess.run([sys.executable, "-c", script, server.addresses[0]], timeout=PATIENCE, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "end\n"), done.stderr


def test_a_configuration_file_says_where(tmp_path):
    with Server(listen=ANY_LOCAL_PORT) as free:
        address = free.addresses[0]
    quiet = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}
    served, asked = tmp_path / "server.json5", tmp_path / "client.json5"
    served.write_text(json.dumps({"mode": "peer", "listen": {"endpoints": [address]}, **quiet}))
    asked.write_text(json.dumps({"mode": "client", "connect": {"endpoints": [address]}, **quiet}))
    with Server(config=served) as server, Client(config=asked, timeout=PATIENCE) as client:
        assert server.addresses == (address,)
        assert client.solve(pinch()).found
    served.write_text("{mode: 'emperor'}")
    with pytest.raises(InvalidInput, match="a Zenoh configuration file") as caught:
        Server(config=served)
    assert caught.value.field == "config"
