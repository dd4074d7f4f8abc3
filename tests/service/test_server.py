"""Server and client over Zenoh: answers, errors, and missing answers."""

from __future__ import annotations

import json
import math
import random
import signal
import threading
from functools import partial

import pytest
from support.servers import ANY_LOCAL_PORT, TIMEOUT, get, server_process, suspend, wait_until
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
from graspforce.service import Client, Server, zenoh_session
from graspforce.service.wire import protocol


@pytest.fixture
def process():
    """Run a server in a child process; yields the process and the address."""
    with server_process("four_finger") as served:
        yield served


# ── answers ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_client_returns_the_results_of_python(server, encoding):
    hand, problem = Hand.load("four_finger"), gf.ForceProblem.from_dict(pinch())
    with Client(server.addresses[0], timeout=TIMEOUT, encoding=encoding) as client:
        solution = client.solve(problem, backend="clarabel")
        assert solution.status is gf.Status.OPTIMAL
        assert solution.objective == pytest.approx(PINCH_OBJECTIVE, rel=1e-7)  # the certificate's tolerance with room
        assert client.solve(pinch()).forces[0] == pytest.approx(solution.forces[0])
        assert client.solve(infeasible_pinch()).status is gf.Status.INFEASIBLE
        distributed = client.distribute("four_finger", distribute_request(hand))
        assert distributed.status is gf.Status.OPTIMAL
        assert distributed.torques.shape == (hand.n,)
        assert client.hands() == ("four_finger",)
        assert client.hand("four_finger") == json.loads(json.dumps(hand.describe()))
        assert client.servers() == (server.id,)
        status = client.status()
        assert (status.server, status.version) == (server.id, gf.__version__)
        assert status.counts["solve"]["ok"] >= 3
        answer = client.query("solve", pinch(), budget=5.0)
        assert 0.0 < answer["server_seconds"] < 5.0
        assert client.query("status", {})["sequence"] == answer["sequence"] + 1


def test_plain_zenoh_session_gets_answers_in_json(raw):
    [(ok, encoding, payload)] = get(raw, "solve", json.dumps({**pinch(), "sequence": 5}))
    assert (ok, encoding) == (True, "application/json")
    answer = json.loads(payload)
    assert (answer["status"], answer["sequence"]) == ("optimal", 5)
    for key, field, value in (("status", "hands", ["four_finger"]), ("hands/four_finger", "name", "four_finger")):
        [(ok, encoding, payload)] = get(raw, key)
        assert (ok, encoding) == (True, "application/json")
        assert json.loads(payload)[field] == value


def test_query_of_a_wildcard_gets_one_reply_for_each_key(raw):
    replies = get(raw, "**", b"{}")
    # errors of solve, quality, explain, distribute, control, forward, inverse, grasp, plan and regrasp (missing fields);
    # answers of status and description
    assert sorted(ok for ok, _, _ in replies) == [False] * 10 + [True] * 2


# ── errors ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_invalid_input_gets_the_message_of_python(client):
    for name, record in BAD_RECORDS:
        if not isinstance(record, dict) or name == "a huge integer":  # the client does not send them
            continue
        with pytest.raises(InvalidInput) as caught:
            gf.ForceProblem.from_dict(record)
        with pytest.raises(ErrorReply) as replied:
            client.solve(record)
        assert (replied.value.code, str(replied.value)) == (caught.value.code, str(caught.value)), name
        assert replied.value.field == (caught.value.field or None)
    assert client.solve(pinch()).found


def test_arbitrary_bytes_get_an_error_and_do_not_harm_the_server(raw, client):
    chance = random.Random(7)
    for encoding, whole in (
        (None, json.dumps(pinch()).encode()),
        ("application/msgpack", protocol.encode(pinch(), protocol.MSGPACK)),
    ):
        cuts = [whole[: chance.randrange(len(whole))] for _ in range(20)]
        noise = [chance.randbytes(chance.randrange(1, 300)) for _ in range(20)]
        for payload in [*cuts, *noise, b"", None]:
            [(ok, reply_encoding, reply)] = get(raw, "solve", payload, encoding)
            assert not ok
            assert protocol.decode(reply, reply_encoding)["error"] == "invalid"
    assert client.solve(pinch()).found


def test_unknown_names_list_the_known_ones(client, raw):
    for request in (partial(client.hand, "left"), partial(client.distribute, "left", {})):
        with pytest.raises(ErrorReply, match="hand = 'left': must be one of four_finger") as caught:
            request()
        assert caught.value.code == "unknown"
    with pytest.raises(UnknownName, match="a hand's name"):
        client.hand("a/b")
    [(ok, _, reply)] = get(raw, "hands/four_finger/dance")
    assert not ok
    assert json.loads(reply)["error"] == "unknown"


@pytest.mark.parametrize(
    "key", ["nowhere", "solve/it", "streams/a/b/c", "streams/a/state", "hands", "plans/x/progress", "no/**"]
)
def test_unknown_key_lists_the_known_ones(key, raw):
    [(ok, _, reply)] = get(raw, key)
    assert not ok
    record = json.loads(reply)
    assert record["error"] == "unknown"
    for known in ("solve", "status", "hands/four_finger/plan", "streams/<id>") if not key.startswith("hands") else ():
        assert known in record["message"]


def test_unknown_version_lists_the_known_one(raw):
    [reply] = raw.get("graspforce/2/solve", timeout=TIMEOUT)
    record = json.loads(reply.err.payload.to_bytes())
    assert (record["error"], record["field"]) == ("unknown", "version")
    assert "'2': must be one of 1" in record["message"]


def test_served_key_gets_one_reply(raw):
    for key in ("solve", "status", "hands/four_finger", "hands/four_finger/plan", "streams/a"):
        assert len(get(raw, key, b"{}")) == 1, key


def test_encoding_of_zenoh_pico_is_messagepack(raw):
    payload = protocol.encode(pinch(sequence=7), protocol.MSGPACK)
    [(ok, encoding, reply)] = get(raw, "solve", payload, "zenoh/bytes;application/msgpack")
    assert (ok, encoding) == (True, protocol.MSGPACK)
    assert protocol.decode(reply, protocol.MSGPACK)["sequence"] == 7


def test_too_large_request_raises_request_refused(client):
    with pytest.raises(RequestRefused, match="501 contacts") as caught:
        client.solve(pinch(contacts=[{}] * 501))
    assert caught.value.code == "too_large"


def test_arguments_of_the_client_are_validated(server):
    for arguments in ({"timeout": 0}, {"timeout": math.nan}, {"encoding": "xml"}, {"config": "/no/such/file.json5"}):
        with pytest.raises(InvalidInput) as caught:
            Client(server.addresses[0], **arguments)
        assert caught.value.field in arguments


def test_answer_with_another_sequence_is_an_error(monkeypatch, client):
    monkeypatch.setattr(protocol, "find_sequence", lambda request: 10**9)
    with pytest.raises(ErrorReply, match="sequence") as caught:
        client.status()
    assert caught.value.code == "internal"


# ── no answer ─────────────────────────────────────────────────────────────────────────────────────────────


def test_no_server_timeout_and_resumed_server_are_distinguished(process):
    child, address = process
    with Client(address, timeout=TIMEOUT) as client:
        assert client.solve(pinch()).found
        suspend(child)
        with pytest.raises(ServiceTimeout, match=r"within 0\.2 s"):
            client.solve(pinch(), timeout=0.2)
        with pytest.raises(ServiceTimeout, match="opening"):
            Client(address, timeout=0.2)
        child.send_signal(signal.SIGCONT)
        assert client.solve(pinch()).found
        child.kill()
        child.wait(TIMEOUT)
        wait_until(lambda: not client.servers())
        with pytest.raises(NoServer, match=address):
            client.status()
        assert client.servers() == ()
    with pytest.raises(NoServer, match=address):
        Client(address, timeout=TIMEOUT)


def test_death_of_the_server_ends_the_wait(process):
    child, address = process
    with Client(address, timeout=TIMEOUT) as client:
        suspend(child)
        threading.Timer(0.2, child.kill).start()
        with pytest.raises(NoServer):
            client.solve(pinch())


def test_client_reconnects_to_a_restarted_server():
    with Server(listen=ANY_LOCAL_PORT) as first:
        address = first.addresses[0]
        client = Client(address, timeout=TIMEOUT)
        assert client.solve(pinch()).found
    with client:
        with pytest.raises(NoServer):
            client.solve(pinch())
        with Server(listen=address) as second:
            wait_until(client.servers)
            assert client.servers() == (second.id,)
            assert client.solve(pinch()).found


def test_default_endpoint_is_local_avoids_the_port_of_ros_2_and_does_not_scout():
    assert zenoh_session.DEFAULT_ADDRESS == "tcp/127.0.0.1:7450"
    config = zenoh_session.build_configuration(None, {}, {})
    assert config.get_json("scouting/multicast/enabled") == "false"
    assert config.get_json("scouting/gossip/enabled") == "false"


def test_address_in_use_is_named(server):
    with pytest.raises(
        ServiceError,
        match=f"cannot listen on {server.addresses[0]}: .*in use.*; stop the other program, or listen on another port",
    ):
        Server(listen=server.addresses[0]).start()


def test_unknown_hand_is_named_before_the_server_listens():
    with pytest.raises(UnknownName, match="four_finger"):
        Server(["no_hand"], listen=ANY_LOCAL_PORT)
