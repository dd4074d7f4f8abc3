"""A server and its clients at a Zenoh router between them."""

from __future__ import annotations

import contextlib
import json

import pytest
import zenoh
from support.control_requests import GRASP, desired, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT, wait_until
from support.service_requests import pinch

from graspforce.cli import main
from graspforce.core.errors import InvalidInput
from graspforce.service import Client, Server
from graspforce.service.server.configuration import check_endpoints, server_configuration
from graspforce.service.zenoh_session import build_configuration, find_addresses


@pytest.fixture
def router():
    """Return the address of a router session."""
    settings = {"mode": "router", "listen/endpoints": [ANY_LOCAL_PORT], "adminspace/enabled": True}
    config = build_configuration(None, {}, settings)
    session = zenoh.open(config)
    yield find_addresses(session, config)[0]
    with contextlib.suppress(zenoh.ZError):
        session.close()


def test_clients_of_a_router_reach_a_server_that_joined_it(router):
    with (
        Server([GRASP.hand], listen=ANY_LOCAL_PORT, connect=[router]) as server,
        Client(router, timeout=TIMEOUT) as client,
    ):
        wait_until(lambda: client.servers() == (server.id,))
        assert client.solve(pinch()).found
        with client.open_stream(GRASP, validity=TIMEOUT) as stream:
            commands = [stream.step(state(k), desired(), wait=TIMEOUT) for k in range(20)]
        assert all(command is not None for command in commands)
        with Client(server.addresses[0], timeout=TIMEOUT) as direct:
            assert direct.status().server == server.id


def test_a_router_beyond_this_machine_needs_tls():
    config = server_configuration(None, ANY_LOCAL_PORT, connect=["tcp/192.168.1.4:7447"])
    with pytest.raises(InvalidInput, match="--insecure") as caught:
        check_endpoints(config, insecure=False)
    assert caught.value.field == "connect"
    check_endpoints(server_configuration(None, ANY_LOCAL_PORT, connect=["tls/192.168.1.4:7447"]), insecure=False)


def test_ask_prints_answers_and_errors_of_the_server(capsys, tmp_path):
    with Server([GRASP.hand], listen=ANY_LOCAL_PORT) as server:
        address = server.addresses[0]
        assert main(["ask", "status", "--connect", address]) == 0
        assert json.loads(capsys.readouterr().out)["server"] == server.id
        file = tmp_path / "pinch.json"
        file.write_text(json.dumps(pinch()))
        assert main(["ask", "solve", str(file), "--connect", address]) == 0
        assert json.loads(capsys.readouterr().out)["status"] == "optimal"
        for key, text, message in (
            ("solve", "{}", "schema"),
            ("hands/four_fingr/forward", "{}", "four_finger"),
            ("sovle", "{}", "solve"),
            ("solve", "[1]", "a JSON object"),
            ("solve", "{", "JSON"),
        ):
            file.write_text(text)
            assert main(["ask", key, str(file), "--connect", address]) == 1
            out, err = capsys.readouterr()
            assert out == ""
            assert message in err
            assert err.count("\n") == 1
