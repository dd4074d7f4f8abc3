"""Samples of a stream for views: few of its states, each with its own command, on keys of no other stream."""

from __future__ import annotations

import time

import pytest
from support.control_requests import GRASP, desired, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT, wait_until

from graspforce.core.errors import InvalidInput
from graspforce.service import Client, Server
from graspforce.service.security.directory import init_directory
from graspforce.service.wire import protocol

STEPS = 200


@pytest.mark.parametrize("is_secure", [False, True], ids=["plain", "TLS"])
def test_samples_are_few_steps_of_the_stream(tmp_path, is_secure):
    """A monitor of samples receives no more than their rate allows, as (state, command) pairs of the same number."""
    directory = init_directory(tmp_path / "keys") if is_secure else None
    role, look = ({"secure": directory}, {"secure": directory, "name": "monitor"}) if is_secure else ({}, {})
    listen = "tls/127.0.0.1:0" if is_secure else ANY_LOCAL_PORT
    with Server(["four_finger"], listen=listen, **({"secure": directory} if is_secure else {})) as server:
        address = server.addresses[0].replace("127.0.0.1", "localhost") if is_secure else server.addresses[0]
        with (
            Client(address, timeout=TIMEOUT, **role) as driver,
            driver.open_stream(GRASP, validity=TIMEOUT) as stream,
            Client(address, timeout=TIMEOUT, **look) as watcher,
        ):
            monitor = watcher.monitor_stream(stream.id, sampled=True)
            monitor.read_setup({"four_finger": GRASP.hand})
            steps, last = [], -1

            def follow() -> object:
                nonlocal last
                last += 1
                stream.step(state(last), desired(), wait=TIMEOUT)
                steps.extend(monitor.take_all())
                return steps

            wait_until(follow)  # the subscription is known to the server
            steps.clear()
            start = time.monotonic()
            for _ in range(STEPS):
                follow()
            elapsed = time.monotonic() - start
            wait_until(follow)
            assert all(step.state.sequence == step.command.sequence for step in steps)
            numbers = [step.state.sequence for step in steps]
            assert numbers == sorted(set(numbers))
            assert len(steps) <= protocol.SAMPLE_RATE * elapsed + STEPS / 10
            newest = None

            def take() -> object:
                nonlocal newest
                stream.step(state(last + 1), desired(), wait=TIMEOUT)
                newest = monitor.take_newest() or newest
                return newest

            wait_until(take)
            assert newest.state.sequence == newest.command.sequence
            monitor.close()


def test_keys_of_samples_are_no_keys_of_streams():
    """The samples of a stream named like a client are not the states of that client's streams."""
    with pytest.raises(InvalidInput, match="stream"):
        protocol.check_named_id(f"arm/{protocol.SAMPLED}", "stream")
