"""Servers of adjacent versions: they work, or the client says why not."""

from __future__ import annotations

import json

import pytest
import zenoh
from support.control_requests import GRASP, desired, setup, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT, wait_until

from graspforce.core.errors import ErrorReply, IncompatibleServer
from graspforce.estimation.sensor_model import SensorModel
from graspforce.service import Client, RequestHandler
from graspforce.service.client.server_version import check_server
from graspforce.service.wire import protocol
from graspforce.service.wire.status_records import ServerStatus
from graspforce.service.zenoh_session import build_configuration, find_addresses


class SimulatedServer:
    """A server of another version: the status of this one with changes, and nothing else."""

    def __init__(self, version="1", **changes):
        settings = {"mode": "peer", "listen/endpoints": [ANY_LOCAL_PORT], "adminspace/enabled": True}
        config = build_configuration(None, {}, settings)
        self._session, self._version = zenoh.open(config), version
        self.address = find_addresses(self._session, config)[0]
        self._status = {**RequestHandler([GRASP.hand]).status().to_dict(), **changes}
        self._queryables = [
            self._session.declare_queryable(f"{protocol.NAMESPACE}/{version}/status", self._answer, complete=True),
            self._session.declare_queryable(f"{protocol.NAMESPACE}/**", self._refuse, complete=False),
        ]
        self._token = self._session.liveliness().declare_token(f"{protocol.NAMESPACE}/{version}/alive/simulated")

    def _answer(self, query):
        sequence = protocol.decode(query.payload.to_bytes(), str(query.encoding))["sequence"]
        with query:
            query.reply(query.key_expr, json.dumps({**self._status, "sequence": sequence}), encoding=protocol.JSON)

    def _refuse(self, query):
        if not str(query.key_expr).startswith(f"{protocol.NAMESPACE}/{self._version}/"):
            record = protocol.error_record("unknown", f"version {self._version} only", "version")
            query.reply_err(json.dumps(record), encoding=protocol.JSON)
        query.drop()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._session.close()


def test_older_server_without_a_capability_is_named():
    with (
        SimulatedServer(version="1", capabilities=["grasp_search"]) as old,
        Client(old.address, timeout=TIMEOUT) as client,
    ):
        wait_until(client.servers)
        with pytest.raises(IncompatibleServer, match="lacks authenticated_streams") as caught:
            client.open_stream(GRASP)
        assert "update the server" in str(caught.value)


def test_older_server_without_measurements_is_named():
    with (
        SimulatedServer(capabilities=["authenticated_streams"]) as old,
        Client(old.address, timeout=TIMEOUT) as client,
    ):
        wait_until(client.servers)
        with pytest.raises(IncompatibleServer, match="lacks measurements"):
            client.open_stream(GRASP, sensors=SensorModel())


def test_newer_server_with_further_fields_and_versions_works():
    with (
        SimulatedServer(versions=["1", "2"], capabilities=["later"], later={"x": 1}) as new,
        Client(new.address, timeout=TIMEOUT) as client,
    ):
        wait_until(client.servers)
        status = client.status()
        assert status.versions == ("1", "2")
        check_server(status, ["later"])


def test_server_of_another_wire_says_so():
    with SimulatedServer(version="2") as new, Client(new.address, timeout=TIMEOUT) as client:
        with pytest.raises(ErrorReply, match="version 2 only") as caught:
            client.status()
        assert (caught.value.code, caught.value.field) == ("unknown", "version")
    status = ServerStatus.from_dict({**RequestHandler([]).status().to_dict(), "versions": ["2"]})
    with pytest.raises(IncompatibleServer, match="version 2 of the wire"):
        check_server(status, [])


def test_capabilities_are_asked_once(client, monkeypatch):
    asked = []
    monkeypatch.setattr(Client, "status", lambda self, status=Client.status: asked.append(1) or status(self))
    for _ in range(2):
        with client.open_stream(GRASP, setup().settings, validity=TIMEOUT) as stream:
            stream.step(state(), desired(), wait=TIMEOUT)
    assert len(asked) == 1
