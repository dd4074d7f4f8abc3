"""Certificates and roles: who may do what in a service with TLS."""

from __future__ import annotations

import json
import shutil
import stat

import numpy as np
import pytest
import zenoh
from support.control_requests import GRASP, desired, setup, state
from support.plan_requests import slow_move
from support.servers import TIMEOUT, get, wait_until
from support.service_requests import pinch

from graspforce.core.errors import InvalidInput, RequestRefused, ServiceError
from graspforce.planning import Plan
from graspforce.service import Client, Server
from graspforce.service.security.certificates import hosts_of
from graspforce.service.security.directory import (
    add_client,
    begin_rotation,
    client_settings,
    finish_rotation,
    init_directory,
    renew_server,
    server_settings,
)
from graspforce.service.wire import protocol
from graspforce.service.zenoh_session import build_configuration

LISTEN = "tls/127.0.0.1:0"


def stream_setup():
    """Return the record of a setup, as a client sends it."""
    return json.loads(protocol.encode(setup().to_dict(), protocol.JSON))


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    path = init_directory(tmp_path_factory.mktemp("keys") / "robot")
    add_client(path, "arm-7", "controller")
    return path


@pytest.fixture(scope="module")
def served(directory):
    """Run a server with TLS, and yield its address by name."""
    with Server(["four_finger"], listen=LISTEN, secure=directory) as server:
        yield server.addresses[0].replace("127.0.0.1", "localhost")


@pytest.fixture
def session_of(directory, served):
    """Return a function that opens a plain Zenoh session with the certificate of a client."""
    opened = []

    def open_as(name):
        settings = {**client_settings(directory, name), "connect/endpoints": [served]}
        opened.append(zenoh.open(build_configuration(None, {"mode": "client"}, settings)))
        return opened[-1]

    yield open_as
    for session in opened:
        session.close()


@pytest.mark.parametrize("name", ["controller", "arm-7"])
def test_controllers_use_all_of_the_service(directory, served, name):
    with Client(served, secure=directory, name=name, timeout=TIMEOUT) as client:
        assert len(client.servers()) == 1
        assert client.solve(pinch()).found
        assert client.hand("four_finger")["name"] == "four_finger"
        with client.open_stream(GRASP, validity=TIMEOUT) as stream:
            assert np.isfinite(stream.step(state(0), desired(), wait=TIMEOUT).tau).all()
            assert client.status().streams == 1
        assert client.status().streams == 0


def test_monitors_only_look(directory, served):
    with Client(served, secure=directory, name="monitor", timeout=2.0) as client:
        assert client.status().hands == ("four_finger",)
        assert client.hand("four_finger")["name"] == "four_finger"
        assert client.forward("four_finger", np.zeros(12))
        for key in ("solve", "hands/four_finger/control", "hands/four_finger/plan", "streams/a"):
            with pytest.raises(RequestRefused, match="not permitted") as caught:
                client.query(key, {})
            assert caught.value.code == "forbidden"


def test_monitors_follow_streams_and_cannot_drive_them(directory, served):
    with Client(served, secure=directory, timeout=TIMEOUT) as driver, driver.open_stream(GRASP, validity=TIMEOUT) as stream:
        with Client(served, secure=directory, name="monitor", timeout=TIMEOUT) as client:
            monitor = client.monitor_stream(stream.id)
            assert monitor.read_setup({"four_finger": GRASP.hand}).grasp.to_dict() == GRASP.to_dict()
            steps = []
            for i in range(200):
                command = stream.step(state(i), desired(), wait=TIMEOUT)
                steps += monitor.take_all()
                if steps:
                    break
            wait_until(lambda: steps.extend(monitor.take_all()) or steps)
            assert command.tau.shape == (12,)
            assert steps[0].command.sequence == steps[0].state.sequence
        with Client(served, secure=directory, name="arm-7", timeout=TIMEOUT) as other:
            unheard = other.monitor_stream(stream.id)
            unheard.read_setup({"four_finger": GRASP.hand})
            for i in range(20):
                stream.step(state(i), desired(), wait=TIMEOUT)
            assert unheard.take_all() == []


def test_clients_without_a_certificate_of_the_authority_are_refused(served, tmp_path):
    stranger = init_directory(tmp_path / "stranger")
    for options in ({"secure": stranger}, {}):
        with pytest.raises(ServiceError):
            Client(served, timeout=2.0, **options)


def test_server_proves_itself_to_its_clients(directory, tmp_path):
    """A client does not talk to a server of another authority."""
    with (
        Server(["four_finger"], listen=LISTEN, secure=init_directory(tmp_path / "rogue")) as rogue,
        pytest.raises(ServiceError),
    ):
        Client(rogue.addresses[0].replace("127.0.0.1", "localhost"), secure=directory, timeout=2.0)


def test_other_clients_answer_no_queries_and_forge_no_tokens_and_commands(session_of, directory, served):
    rogue, asked = session_of("arm-7"), []
    queryable = rogue.declare_queryable("graspforce/1/**", lambda query: asked.append(query), complete=True)
    token = rogue.liveliness().declare_token("graspforce/1/alive/rogue")
    with Client(served, secure=directory, timeout=TIMEOUT) as client, client.open_stream(GRASP, validity=TIMEOUT) as stream:
        commands = rogue.declare_publisher(f"graspforce/1/streams/{stream.id}/command")
        for i in range(20):
            commands.put(b"\x80")
            assert np.isfinite(stream.step(state(i), desired(), wait=TIMEOUT).tau).all()
            assert client.solve(pinch()).found
        assert len(client.servers()) == 1
        assert stream._connection.refused == {}  # not one forged command has reached it
    assert asked == []
    token.undeclare()
    queryable.undeclare()


def test_session_of_a_monitor_cannot_publish_states_or_cancel(session_of, directory, served):
    monitor = session_of("monitor")
    with Client(served, secure=directory, timeout=TIMEOUT) as client, client.open_stream(GRASP, validity=TIMEOUT) as stream:
        stream.step(state(0), desired(), wait=TIMEOUT)
        for _ in range(20):
            monitor.put(f"graspforce/1/streams/{stream.id}/state", b"junk")
        assert get(monitor, "solve", json.dumps(pinch())) == []
        wait_until(lambda: client.status().counts["streams/*/state"]["ok"] >= 1)
        assert set(client.status().counts["streams/*/state"]) == {"ok"}


def test_controllers_cannot_touch_streams_and_plans_of_others(session_of, directory, served):
    other, seen = session_of("arm-7"), []
    other.declare_subscriber("graspforce/1/streams/*/*/command", seen.append)
    with Client(served, secure=directory, timeout=TIMEOUT) as client, client.open_stream(GRASP, validity=TIMEOUT) as stream:
        assert stream.id.startswith("controller/")
        stream.step(state(0), desired(), wait=TIMEOUT)
        for _ in range(20):
            other.put(f"graspforce/1/streams/{stream.id}/state", b"junk")
        for record in ({"close": True}, stream_setup()):
            assert get(other, f"streams/{stream.id}", json.dumps(record)) == []
        assert np.isfinite(stream.step(state(1), desired(), wait=TIMEOUT).tau).all()
        wait_until(lambda: client.status().counts["streams/*/state"]["ok"] >= 2)
        [status] = client.status().active_streams
        assert dict(status.outcomes) == {"ok": 2}
    assert seen == []


def test_controllers_open_streams_below_their_own_name_only(session_of):
    session = session_of("arm-7")
    for key in ("streams/a", "streams/controller/a", "streams/arm-7/a/b"):
        assert get(session, key, json.dumps(stream_setup())) == []
    [(ok, _, answer)] = get(session, "streams/arm-7/a", json.dumps(stream_setup()))
    assert (ok, json.loads(answer)["stream"]) == (True, "arm-7/a")
    [(ok, _, _)] = get(session, "streams/arm-7/a", json.dumps({"close": True}))
    assert ok


def test_plans_of_a_controller_are_cancelled_by_itself_only(session_of, directory, served):
    other, stages = session_of("arm-7"), []

    def callback(progress):
        stages.append(progress.stage)
        if len(stages) == 1:
            other.put("graspforce/1/plans/controller/mine/cancel", b"")
        return len(stages) < 3  # then the client stops the plan itself

    with Client(served, secure=directory, timeout=TIMEOUT) as client:
        answer = client.plan(slow_move(), budget=TIMEOUT, callback=callback, id="mine")
    assert len(stages) >= 3
    assert answer.stopped if isinstance(answer, Plan) else answer.kind == "stopped"


def test_keys_are_private_and_certificates_are_renewed(directory):
    for path in directory.glob("*.key"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    before = (directory / "arm-7.pem").read_bytes()
    add_client(directory, "arm-7", "controller")
    assert (directory / "arm-7.pem").read_bytes() != before
    assert json.loads((directory / "roles.json").read_text()) == {
        "controller": "controller",
        "monitor": "monitor",
        "arm-7": "controller",
    }


def test_invalid_names_roles_and_directories_are_named(directory, tmp_path):
    for call, field in [
        (lambda: add_client(directory, "a/b", "monitor"), "name"),
        (lambda: add_client(directory, "ca", "monitor"), "name"),
        (lambda: add_client(directory, "x", "king"), "role"),
        (lambda: add_client(tmp_path, "x", "monitor"), "directory"),
        (lambda: init_directory(directory), "directory"),
        (lambda: server_settings(tmp_path), "secure"),
        (lambda: client_settings(directory, "nobody"), "secure"),
    ]:
        with pytest.raises(InvalidInput) as caught:
            call()
        assert caught.value.field == field


def test_written_configurations_serve_and_connect(directory):
    with Server(["four_finger"], listen=LISTEN, config=directory / "server.json5") as server:
        address = server.addresses[0].replace("127.0.0.1", "localhost")
        with Client(address, config=directory / "controller.json5", timeout=TIMEOUT) as client:
            assert client.solve(pinch()).found
        with Client(address, config=directory / "monitor.json5", timeout=2.0) as client:
            assert client.status().hands == ("four_finger",)
            with pytest.raises(RequestRefused, match="not permitted"):
                client.solve(pinch())


def test_sessions_and_messages_are_limited(session_of, directory):
    assert server_settings(directory)["transport/unicast/max_sessions"] == 64
    monitor = session_of("monitor")
    assert get(monitor, "status", b"{}")
    assert get(monitor, "status", b" " * 100_000) == []


def test_server_accepts_old_and_new_certificates_during_a_rotation(tmp_path):
    keys = init_directory(tmp_path / "keys", ["robot.local"])
    before = tmp_path / "before"
    shutil.copytree(keys, before)
    begin_rotation(keys)
    with pytest.raises(InvalidInput, match="still old: server, controller, monitor"):
        finish_rotation(keys)
    with Server(listen=LISTEN, secure=keys) as server:  # old certificate of the server, both authorities
        address = server.addresses[0].replace("127.0.0.1", "localhost")
        for directory in (before, keys):
            with Client(address, secure=directory, timeout=TIMEOUT) as client:
                assert client.solve(pinch()).found
    renew_server(keys)
    assert "robot.local" in hosts_of(keys, "server")
    for name in ("controller", "monitor"):
        add_client(keys, name, name)
    finish_rotation(keys)
    with Server(listen=LISTEN, secure=keys) as server:
        address = server.addresses[0].replace("127.0.0.1", "localhost")
        with Client(address, secure=keys, timeout=TIMEOUT) as client:
            assert client.solve(pinch()).found
        with pytest.raises(ServiceError):
            Client(address, secure=before, timeout=2.0)
    with pytest.raises(InvalidInput, match="secure init"):
        renew_server(tmp_path)
