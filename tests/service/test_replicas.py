"""A refused connection, a lost server and no server are told apart, and another replica answers once."""

from __future__ import annotations

import socket
import threading
import time

import pytest
from support.servers import ANY_LOCAL_PORT, TIMEOUT, server_process, suspend, wait_until
from support.service_requests import pinch

from graspforce.core.errors import NoServer, RequestRefused, ServerLost
from graspforce.service import Client, Server


def test_refused_connection_is_told_apart_from_no_server():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]

        def refuse():
            while True:
                try:
                    listener.accept()[0].close()
                except OSError:  # the test has ended
                    return

        thread = threading.Thread(target=refuse, daemon=True)
        thread.start()
        for address in (f"tcp/127.0.0.1:{port}", f"tls/127.0.0.1:{port}"):
            with pytest.raises(RequestRefused, match="refused the connection") as caught:
                Client(address, timeout=TIMEOUT)
            assert caught.value.code == "forbidden"
        listener.shutdown(socket.SHUT_RDWR)
    thread.join(TIMEOUT)
    with pytest.raises(NoServer):
        Client(f"tcp/127.0.0.1:{port}", timeout=TIMEOUT)


def test_server_that_ends_before_its_answer_is_lost():
    with server_process() as (child, address), Client(address, timeout=TIMEOUT) as client:
        assert client.solve(pinch()).found
        suspend(child)
        kill_after_request(client, child)
        with pytest.raises(ServerLost, match="before it answered"):
            client.solve(pinch())
        time.sleep(0.2)  # a query that Zenoh sends into a connection that breaks ends at its timeout only
        wait_until(lambda: error_of(client) is NoServer)  # when Zenoh has closed the connection


def kill_after_request(client, child):
    """Kill a server 0.2 s after the client's next request has been sent."""
    send = client._requests._send_query

    def send_and_kill(*arguments):
        replies = send(*arguments)
        client._requests._send_query = send
        threading.Timer(0.2, child.kill).start()
        return replies

    client._requests._send_query = send_and_kill


def error_of(client):
    """Return the type of the exception of a request to a server that has ended."""
    with pytest.raises(NoServer) as caught:
        client.solve(pinch())
    return type(caught.value)


def test_request_goes_to_another_replica_when_the_first_dies():
    with (
        Server(listen=ANY_LOCAL_PORT) as second,
        server_process() as (child, address),
        Client([address, second.addresses[0]], timeout=TIMEOUT) as client,
    ):
        first = client.status().server
        assert first != second.id
        suspend(child)
        kill_after_request(client, child)
        assert client.solve(pinch()).found
        assert client.status().server == second.id


def test_client_uses_the_first_endpoint_that_it_reaches(server):
    with Client(["tcp/127.0.0.1:1", server.addresses[0]], timeout=TIMEOUT) as client:
        wait_until(client.servers)
        assert client.status().server == server.id
