"""The ends of a server process: signals while it solves, plans and controls."""

from __future__ import annotations

import contextlib
import json
import math
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest
from support.control_requests import GRASP, desired, state
from support.plan_requests import slow_move
from support.servers import TIMEOUT, get, plain_session, suspend, wait_until
from support.service_requests import pinch
from zenoh.handlers import Callback

from graspforce.service import Client
from graspforce.service.client.watchdog import Watchdog
from graspforce.service.wire import protocol

END_LIMIT = 2.0  # s, from the signal to the end of the process
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]

ENDLESS = r"""
import sys, time
from graspforce.service import serve
from graspforce.service.server import request_handler
def solve(*arguments, **keywords):
    sys.stdout.write("solving\n")
    sys.stdout.flush()
    time.sleep(600)
request_handler.solve = solve
def ready(server):
    print(server.addresses[0], flush=True)
serve(["four_finger"], listen="tcp/127.0.0.1:0", on_ready=ready, end_process=True)
"""


@contextlib.contextmanager
def process(*command):
    """Run a server process and yield it with its address."""
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        try:
            words = child.stdout.readline().replace(";", " ").split()
            yield child, next(word for word in words if word.startswith("tcp/"))
        finally:
            child.kill()


def serve_command():
    return process("-m", "graspforce", "serve", "--hand", "four_finger", "--listen", "tcp/127.0.0.1:0")


def end(child, number):
    """Send a signal, and return the exit code and the time until the process ended, s."""
    start = time.monotonic()
    child.send_signal(number)
    return child.wait(TIMEOUT), time.monotonic() - start


@pytest.mark.parametrize("number", SIGNALS)
def test_busy_server_ends_within_two_seconds_and_answers_or_refuses(number):
    """Two solves run without end, others wait, a plan and a stream are active: all get a message, and the exit code is 0."""
    with process("-c", ENDLESS) as (child, address), plain_session(address) as session, Client(address) as client:
        query = partial(session.get, timeout=TIMEOUT)
        running = [query("graspforce/1/solve", payload=json.dumps(pinch())) for _ in range(2)]
        for _ in running:
            assert child.stdout.readline() == "solving\n"
        waiting = [query("graspforce/1/solve", payload=json.dumps(pinch())) for _ in range(20)]
        plan = query("graspforce/1/hands/four_finger/plan", payload=json.dumps({**slow_move().to_dict(), "budget": 30.0}))
        wait_until(lambda: client.status().queue == len(waiting) and client.status().plans == 1)
        code, seconds = end(child, number)
        assert (code, child.stderr.read()) == (0, "")
        assert seconds <= END_LIMIT
        for replies in waiting:
            [reply] = replies
            assert json.loads(reply.err.payload.to_bytes())["error"] == "closing"
        [reply] = plan
        assert set(json.loads(reply.ok.payload.to_bytes())) >= {"plan", "refusal"}
        for replies in running:
            assert all(reply.ok is None for reply in replies)  # no answer


def test_second_signal_ends_the_process_at_once():
    with process("-c", ENDLESS) as (child, address), plain_session(address) as session:
        replies = session.get("graspforce/1/solve", payload=json.dumps(pinch()), timeout=TIMEOUT)
        assert child.stdout.readline() == "solving\n"
        child.send_signal(signal.SIGTERM)
        wait_until(lambda: not get(session, "status"))  # it accepts no more requests, but waits for the solver
        assert child.poll() is None
        code, seconds = end(child, signal.SIGTERM)
        assert code == 0
        assert seconds < 0.5
        assert all(reply.ok is None for reply in replies)


def test_idle_server_ends_at_once_and_leaves_no_processes():
    with serve_command() as (child, address), Client(address) as client:
        wait_until(client.servers)
        code, seconds = end(child, signal.SIGTERM)
        assert (code, child.stderr.read()) == (0, "")
        assert seconds < 1.0
        assert client.servers() == ()


def test_client_that_does_not_read_does_not_prevent_the_end():
    """A client is frozen while ten megabytes of replies wait for it."""
    script = (
        "import os, signal, sys; sys.path.append('tests'); from support.servers import plain_session\n"
        "s = plain_session(sys.argv[1])\n"
        "c = [s.get('graspforce/1/hands/four_finger', timeout=60.0) for _ in range(2000)]; c[0].recv()\n"
        "os.kill(os.getpid(), signal.SIGSTOP)  # after the first reply, so that the requests have left"
    )
    with (
        serve_command() as (child, address),
        subprocess.Popen([sys.executable, "-c", script, address]) as frozen,
        Client(address, timeout=TIMEOUT) as client,
    ):
        try:
            wait_until(lambda: client.status().counts.get("hands/four_finger"))
            time.sleep(0.2)
            code, seconds = end(child, signal.SIGTERM)
            assert code == 0
            assert seconds <= END_LIMIT
        finally:
            frozen.kill()


def test_stream_is_told_and_goes_on_at_another_server():
    """The first server closes; the stream opens at the second one, and no torque step exceeds the watchdog's."""
    dog, period = Watchdog(hold=TIMEOUT), 0.002
    with contextlib.ExitStack() as stack:
        child, address = stack.enter_context(serve_command())
        _, other = stack.enter_context(serve_command())
        client = stack.enter_context(Client([address, other], timeout=TIMEOUT))
        stream = stack.enter_context(client.open_stream(GRASP, validity=0.1, watchdog=dog))
        session, messages = stack.enter_context(plain_session(address)), []
        session.declare_subscriber(f"graspforce/1/streams/{stream.id}/command", Callback(messages.append, indirect=False))
        taus, first_after_end = [stream.step(state(0), desired()).tau], math.inf

        def steps():
            """Step the stream, and return the number of the state and the newest command."""
            sequence = stream.publish(state(0), desired())
            time.sleep(period)
            command = stream.latest()
            taus.append(command.tau)
            return sequence, command

        wait_until(lambda: steps() and messages)  # the subscriber is known to the server
        child.send_signal(signal.SIGTERM)

        def resumed():
            nonlocal first_after_end
            sequence, command = steps()
            if child.poll() is not None:
                first_after_end = min(first_after_end, sequence)
            return command.sequence >= first_after_end and not command.resuming and not command.late

        wait_until(resumed)
        wait_until(lambda: str(messages[-1].encoding) == protocol.JSON)  # a loaded machine delivers it late
        last = messages[-1]  # of the first server
        assert json.loads(last.payload.to_bytes())["error"] == "closing"
        assert client.status().streams == 1  # at the other server
        assert np.abs(np.diff(taus, axis=0)).max() <= dog.step + 1e-9


def test_frozen_server_ends_after_it_wakes():
    with serve_command() as (child, _):
        suspend(child)
        child.send_signal(signal.SIGTERM)
        code, seconds = end(child, signal.SIGCONT)
        assert code == 0
        assert seconds <= END_LIMIT
