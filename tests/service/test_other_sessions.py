"""Other sessions at a server: they get no queries of its clients, and their replies are no answers."""

from __future__ import annotations

import json

import pytest
import zenoh
from support.control_requests import GRASP
from support.servers import TIMEOUT, plain_session, wait_until

from graspforce.core.errors import InvalidInput, ServiceError
from graspforce.service import Client, Server
from graspforce.service.server.configuration import server_configuration
from graspforce.service.wire import protocol
from graspforce.service.zenoh_session import build_configuration

ANY_LOCAL_PORT = "tcp/127.0.0.1:0"
FALSE_TOKENS = ("alive/other", "alive/*", "*/other", "**")


def answer_falsely(query: zenoh.Query) -> None:
    """Reply with the sequence number of the request, as a server does."""
    payload = query.payload.to_bytes() if query.payload is not None else b"{}"
    sequence = protocol.decode(payload, protocol.MSGPACK)["sequence"]
    query.reply(query.key_expr, json.dumps({"sequence": sequence, "version": "false"}).encode(), encoding=protocol.JSON)


def session_in_mode(mode: str, address: str) -> zenoh.Session:
    """Open a plain session in a mode of Zenoh."""
    return zenoh.open(build_configuration(None, {"mode": mode, "listen/endpoints": []}, {"connect/endpoints": [address]}))


@pytest.mark.parametrize("mode", ["client", "peer", "router"])
@pytest.mark.parametrize("key", ["graspforce/1/status", "graspforce/1/**", "graspforce/**", "*/1/**", "**"])
def test_a_session_gets_no_queries_of_other_clients(key, mode):
    with Server([GRASP.hand], listen=ANY_LOCAL_PORT) as server, session_in_mode(mode, server.addresses[0]) as other:
        seen: list[zenoh.Query] = []
        other.declare_queryable(key, seen.append, complete=True)
        tokens = [other.liveliness().declare_token(f"{protocol.PREFIX}/{each}") for each in FALSE_TOKENS]
        with Client(server.addresses[0], timeout=TIMEOUT) as client, client.open_stream(GRASP):
            for _ in range(20):
                assert client.status().hands == (GRASP.hand.name,)
                found = client.servers()
                assert found == (server.id,) or (mode == "router" and not found)  # Zenoh asks routers for tokens
        assert not seen
        assert len(tokens) == len(FALSE_TOKENS)


def test_clients_take_no_answers_of_other_sessions_where_these_get_queries(tmp_path):
    """The configuration lets others answer; the client still knows which sessions it is connected to."""
    config = tmp_path / "open.json5"
    config.write_text('{"access_control": {"enabled": false}}')
    with Server([GRASP.hand], listen=ANY_LOCAL_PORT, config=config) as server, plain_session(server.addresses[0]) as other:
        seen: list[None] = []

        def reply(query: zenoh.Query) -> None:
            seen.append(None)
            answer_falsely(query)

        other.declare_queryable(f"{protocol.PREFIX}/status", reply, complete=True)
        with Client(server.addresses[0], timeout=TIMEOUT) as client:

            def is_asked() -> bool:
                assert client.status().hands == (GRASP.hand.name,)
                return len(seen) >= 10

            wait_until(is_asked)


def test_routers_and_servers_behind_them_let_others_answer(tmp_path):
    """Replicas behind a router answer the same keys; a server that is a router relays queries of other programs."""
    config = tmp_path / "router.json5"
    config.write_text('{"mode": "router"}')
    for built, is_guarded in (
        (server_configuration(None, ANY_LOCAL_PORT), True),
        (server_configuration(None, ANY_LOCAL_PORT, connect=["tcp/127.0.0.1:7447"]), False),
        (server_configuration(config, ANY_LOCAL_PORT), False),
    ):
        assert json.loads(built.get_json("access_control/enabled")) is is_guarded


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan")])
def test_budgets_are_checked_before_the_request(budget):
    with Server(["four_finger"], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=TIMEOUT) as client:
        with pytest.raises(InvalidInput) as caught:
            client.query("status", {}, budget=budget)
        assert caught.value.field == "budget"


def test_a_closed_client_says_so():
    with Server([GRASP.hand], listen=ANY_LOCAL_PORT) as server:
        client = Client(server.addresses[0], timeout=TIMEOUT)
        client.close()
        for call in (client.status, client.servers, lambda: client.open_stream(GRASP)):
            with pytest.raises(ServiceError, match="closed"):
                call()
