"""Hands that change while a server runs: new requests use them, open streams go on."""

from __future__ import annotations

import json
import logging
import os
import time

import numpy as np
import pytest
from support.control_requests import GRASP, HAND, desired, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT

from graspforce.core.errors import UnknownName
from graspforce.hand.hand import Hand
from graspforce.service import Client, RequestHandler, Server
from graspforce.service.server.hand_files import HandFiles
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.request_worker import RequestWorker
from graspforce.service.wire import protocol


def other_hand():
    """Return the hand of the tests with half its torques."""
    return HAND.with_torque_limits(0.5 * HAND.torque_upper)


def test_open_stream_goes_on_while_new_requests_use_the_changed_hand():
    changed = other_hand()
    with Server([HAND], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=TIMEOUT) as client:
        with client.open_stream(GRASP, validity=TIMEOUT) as stream:
            before = stream.step(state(), desired(), wait=TIMEOUT)
            description = client.hand(HAND.name)
            server.reload_hand(changed)
            assert client.hand(HAND.name) != description
            after = [stream.step(state(), desired(), wait=TIMEOUT) for _ in range(20)]
            assert all(not command.late for command in after)
            np.testing.assert_allclose(after[0].tau, before.tau, atol=1e-3)
            assert client.status().active_streams[0].outcomes["ok"] == 21
        with pytest.raises(UnknownName):
            server.reload_hand(Hand.load("allegro_right"))


def test_worker_process_uses_the_changed_hand():
    worker = RequestWorker([HAND], ServerLimits(), 0)
    key, request = f"hands/{HAND.name}", b"{}"

    def ask():
        outcome, reply = worker.compute(key, request, protocol.JSON, time.perf_counter())
        assert outcome == "ok"
        return {name: value for name, value in json.loads(reply.payload).items() if name != "server_seconds"}

    try:
        first = ask()
        worker.serve([other_hand()])
        assert ask() != first
        worker.serve([HAND])
        assert ask() == first
    finally:
        worker.close()


def test_files_are_read_again_when_they_change(tmp_path, caplog):
    path, loaded = tmp_path / "hand.json", []
    path.write_text(json.dumps({}))
    files = HandFiles([path, "four_finger", HAND], loaded.append)
    files.check()
    assert not loaded
    os.utime(path, ns=(1, 1))
    with caplog.at_level(logging.ERROR):
        files.check()  # not a hand
    assert not loaded
    assert "stays as it was" in caplog.text
    files.check()
    assert len(caplog.records) == 1
    path.unlink()
    files.check()
    assert len(caplog.records) == 1


def test_plans_send_the_changed_hand_again():
    handler = RequestHandler([HAND])
    for worker in handler.plans._workers:
        worker._sent_hands.add(HAND.name)
    handler.replace_hand(other_hand())
    assert all(HAND.name not in worker._sent_hands for worker in handler.plans._workers)
