"""Streams of replicas behind a router: one command a state through every fault, and bounded torque steps."""

from __future__ import annotations

import json
import signal
import time
from itertools import pairwise

import msgspec
import pytest
from support.control_requests import setup
from support.servers import TIMEOUT, get, plain_session, python_process, wait_until

from benchmarks import replicas
from graspforce.core.errors import InvalidInput, RequestRefused
from graspforce.service.server.configuration import server_configuration
from graspforce.service.server.process_lease import ProcessLease
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire.stream_authentication import ownership_proof


@pytest.fixture(scope="module")
def cell():
    with replicas.start_cell(("tcp", "udp")) as running:
        yield running


def count_lapses(periods):
    """Return how often the driver's watchdog became active. Each time, either replica may open the stream again."""
    return sum(after.late and not before.late for before, after in pairwise(periods))


@pytest.mark.parametrize("fault", [replicas.freeze, replicas.cut, replicas.kill])
def test_stream_moves_to_the_other_replica_and_each_state_gets_at_most_one_command(cell, fault):
    """Each server is first behind a lossy link, one of TCP and one of UDP."""
    owner, other = cell.find_owner()
    assert not other.has_stream()
    cell.run.periods.clear()
    cell.run.commands.clear()
    replicas.lose(cell, owner, 0.4)
    assert owner.link.lost > 0
    if count_lapses(cell.run.periods) == 0:  # a busy machine may delay commands for longer than their validity
        assert owner.has_stream()
    owner, other = cell.find_owner()
    before = count_lapses(cell.run.periods)
    start = fault(cell, owner)
    outcome = replicas.Outcome.of("", cell.run, start)
    assert outcome.notice < outcome.move <= outcome.reach < replicas.TIMEOUT
    assert outcome.commands == 1
    assert outcome.step <= replicas.WATCHDOG.step * (1.0 + 1e-9)  # rounding
    if count_lapses(cell.run.periods) == before + 1:
        wait_until(other.has_stream)  # the status counts a command after it was sent
        if owner.process.poll() is None:
            assert not owner.has_stream()
    else:
        wait_until(lambda: other.has_stream() or owner.has_stream())


def make_lease(seconds):
    """Return a lease, its clock as a list of one time, and the list of its losses."""
    clock, lost = [0.0], []
    return ProcessLease(seconds, lambda: lost.append(clock[0]), lambda: clock[0]), clock, lost


def test_lease_ends_when_the_process_did_not_run_for_its_duration():
    lease, clock, lost = make_lease(0.5)
    for clock[0] in (0.1, 0.4, 0.9):
        assert lease.holds
        lease.renew()
    clock[0] = 1.5
    assert not lease.holds
    lease.renew()
    assert lost == [1.5]
    assert lease.holds


def test_lease_holds_no_state_until_the_streams_are_given_up():
    held = []
    lease = ProcessLease(0.5, lambda: held.append(lease.holds), clock := iter([0.0, 9.0, 9.0, 9.0, 9.0, 9.0]).__next__)
    assert clock is not None
    lease.renew()
    assert held == [False]


def test_a_process_is_waking_from_the_end_of_its_lease_until_a_tenth_of_a_second_after_the_renewal():
    lease, clock, _ = make_lease(0.5)
    for clock[0], expected in ((0.4, False), (1.5, True)):
        assert lease.is_waking is expected
    lease.renew()
    for clock[0], expected in ((1.55, True), (1.65, False)):
        assert lease.is_waking is expected


_REPLICA = """
import sys, time
from graspforce.service import Server
server = Server(sys.argv[1:], listen="tcp/127.0.0.1:0", lease=20.0)
server._lease._seconds = 0.3  # shorter than that of its connections, as behind a router
with server:
    print(server.addresses[0], flush=True)
    time.sleep(60.0)
"""


def test_a_thawed_process_opens_no_streams_of_the_time_when_it_was_frozen():
    record = json.dumps(msgspec.to_builtins(setup().to_dict()))
    with python_process(_REPLICA, "four_finger") as (process, address), plain_session(address) as session:
        wait_until(lambda: get(session, "status", "{}"))
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.1)  # until all threads have stopped
        asked = session.get("graspforce/1/streams/frozen", payload=record, timeout=TIMEOUT)
        time.sleep(1.0)  # longer than the lease
        process.send_signal(signal.SIGCONT)
        assert [reply for reply in asked if reply.ok is not None] == []
        wait_until(lambda: any(ok for ok, _, _ in get(session, "streams/later", record)))
        [(_, _, status)] = get(session, "status", "{}")
        assert [each["id"] for each in json.loads(status)["active_streams"]] == ["later"]


def test_lease_without_duration_never_ends():
    lease, clock, lost = make_lease(None)
    clock[0] = 1e6
    assert lease.holds
    lease.renew()
    assert not lost


@pytest.mark.parametrize("lease", [0.0, -1.0, float("nan")])
def test_lease_must_be_positive(lease):
    with pytest.raises(InvalidInput) as caught:
        server_configuration(None, lease=lease)
    assert caught.value.field == "lease"


def test_plain_stream_ignores_states_for_another_opening():
    stream, other = (ServerStream("a", setup(memory=None)) for _ in range(2))
    assert stream.epoch != other.epoch
    assert stream.accepts(b"state", b"")
    assert stream.accepts(b"state", stream.epoch)
    assert not stream.accepts(b"state", other.epoch)
    assert stream.outcomes == {"replaced": 1}
    assert stream.sign(b"command") == stream.epoch


def make_registry():
    hand = setup().hand
    return StreamRegistry({hand.name: hand}, capacity=4, idle_timeout=10.0)


def test_client_that_returns_from_another_server_gets_a_new_stream():
    record = setup(authenticated=True, memory=None).to_dict()
    first, second = make_registry(), make_registry()
    proofs = []
    for registry in (first, second):
        answer = registry.answer("a", {**record, "proof": list(proofs)})
        proofs.insert(0, ownership_proof(bytes.fromhex(answer["key"]), "a"))
    again = first.answer("a", {**record, "proof": proofs})
    assert again["opened"]
    repeated = first.answer("a", {**record, "proof": ownership_proof(bytes.fromhex(again["key"]), "a")})
    assert not repeated["opened"]
    assert repeated["key"] == again["key"]
    with pytest.raises(RequestRefused, match="another client"):
        first.answer("a", {**record, "proof": "ef" * 32})


def test_client_proves_an_opening_whose_answer_got_lost():
    record, token = setup(authenticated=True, memory=None).to_dict(), "ab" * 32
    registry = make_registry()
    lost = registry.answer("a", {**record, "proof": [token]})
    again = registry.answer("a", {**record, "proof": [token]})
    assert (again["opened"], again["key"]) == (False, lost["key"])
    for proof in (None, [], ["cd" * 32], "", [""], ["ab"], 7, [None]):
        with pytest.raises(RequestRefused, match="another client"):
            registry.answer("a", {**record, "proof": proof})
