"""The command `top` against a live server."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console
from support.control_requests import GRASP, desired, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT
from support.service_requests import pinch

from graspforce.cli import main
from graspforce.cli.server_tables import server_report
from graspforce.service import Client, Server
from graspforce.service.wire.status_records import ServerStatus


@pytest.fixture
def server():
    with Server([GRASP.hand], listen=ANY_LOCAL_PORT) as running:
        yield running


def text_of(status, previous=None):
    """Return the tables as text."""
    file = io.StringIO()
    Console(file=file, width=200).print(server_report(status, previous))
    return file.getvalue()


def test_one_reading_shows_streams_clients_and_requests(server, capsys):
    with Client(server.addresses[0], timeout=TIMEOUT) as client:
        assert client.solve(pinch()).found
        with client.open_stream(GRASP, validity=TIMEOUT) as stream:
            stream.step(state(0), desired(), wait=TIMEOUT)
            assert main(["top", "--connect", server.addresses[0], "--once"]) == 0
            out = capsys.readouterr().out
            for text in (stream.id, "four_finger", "ready", "solve", "1 stream,"):
                assert text in out
            assert main(["top", "--connect", server.addresses[0], "--json"]) == 0
            status = ServerStatus.from_dict(json.loads(capsys.readouterr().out))
            assert [each.id for each in status.active_streams] == [stream.id]


def test_rates_are_those_between_two_readings(server):
    with Client(server.addresses[0], timeout=TIMEOUT) as client, client.open_stream(GRASP, validity=TIMEOUT) as stream:
        first = client.status()
        for k in range(40):
            stream.step(state(k), desired(), wait=TIMEOUT)
        second = replace(client.status(), uptime=first.uptime + 2.0)
    (line,) = [line for line in text_of(second, first).splitlines() if stream.id in line]
    assert line.split()[3:5] == ["20", "40"]  # states/s, states
    (line,) = [line for line in text_of(second).splitlines() if stream.id in line]
    assert line.split()[3] == "–"
    restarted = replace(second, server="other", uptime=1.0)
    (line,) = [line for line in text_of(restarted, second).splitlines() if stream.id in line]
    assert line.split()[3] == "–"


def test_a_server_with_a_problem_gives_exit_code_1(server, capsys, monkeypatch):
    with Client(server.addresses[0], timeout=TIMEOUT) as client:
        broken = replace(client.status(), problem="a request has been in progress for 61 s")
    monkeypatch.setattr(Client, "status", lambda self: broken)
    assert main(["top", "--connect", server.addresses[0], "--once"]) == 1
    assert "61 s" in capsys.readouterr().out


def test_without_a_server_the_error_is_one_line(capsys):
    assert main(["top", "--connect", "tcp/127.0.0.1:1", "--once"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
