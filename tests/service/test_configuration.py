"""Zenoh configurations: defaults under files, and endpoints beyond this machine."""

from __future__ import annotations

import json

import pytest
from support.servers import ANY_LOCAL_PORT, TIMEOUT
from support.service_requests import pinch

from graspforce.core.errors import InvalidInput
from graspforce.service import Client, Server
from graspforce.service.server.configuration import server_configuration
from graspforce.service.zenoh_session import MAX_MESSAGE_BYTES, build_configuration, exposed_endpoints, show_configuration

FILE = """
// a comment, unquoted names and a trailing comma: JSON5
{
  mode: 'peer',
  scouting: {gossip: {enabled: true},},
  transport: {link: {rx: {max_message_size: 5000000}}},
}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "zenoh.json5"
    path.write_text(FILE)
    return path


def test_defaults_lie_under_the_settings_of_a_file(file):
    config = server_configuration(file, "tcp/127.0.0.1:7000")
    for key, value in {
        "scouting/gossip/enabled": "true",  # the file's
        "transport/link/rx/max_message_size": "5000000",
        "listen/endpoints": '["tcp/127.0.0.1:7000"]',
        "scouting/multicast/enabled": "false",  # the defaults
        "transport/shared_memory/enabled": "false",
        "transport/link/tx/queue/congestion_control/block/wait_before_close": "500000",
    }.items():
        assert config.get_json(key) == value, key
    assert int(build_configuration(None, {}, {}).get_json("transport/link/rx/max_message_size")) > MAX_MESSAGE_BYTES


def test_file_without_settings_changes_nothing(tmp_path):
    path = tmp_path / "empty.json5"
    path.write_text("{}")
    assert json.loads(show_configuration(server_configuration(path, "tcp/127.0.0.1:7000"))) == json.loads(
        show_configuration(server_configuration(None, "tcp/127.0.0.1:7000"))
    )


def test_printed_configuration_hides_secrets(tmp_path):
    path = tmp_path / "secret.json5"
    path.write_text("{transport: {auth: {usrpwd: {user: 'me', password: 'swordfish'}}}}")
    text = show_configuration(server_configuration(path, "tcp/127.0.0.1:7000"))
    assert "swordfish" not in text
    assert json.loads(text)["transport"]["auth"]["usrpwd"]["user"] == "me"


@pytest.mark.parametrize(
    ("endpoint", "is_exposed"),
    [
        ("tcp/127.0.0.1:7450", False),
        ("tcp/127.9.9.9:0", False),
        ("tcp/[::1]:7450", False),
        ("tcp/localhost:7450", False),
        ("unixsock-stream//tmp/graspforce", False),
        ("tls/0.0.0.0:7450", False),
        ("quic/robot:7450", False),
        ("tcp/0.0.0.0:7450", True),
        ("tcp/[::]:7450", True),
        ("udp/192.168.1.4:7450", True),
        ("ws/robot:7450#iface=eth0", True),
        ("tcp/localhost.example.org:7450", True),
    ],
)
def test_endpoints_beyond_this_machine_need_tls(endpoint, is_exposed):
    config = build_configuration(None, {}, {"listen/endpoints": [endpoint]})
    assert exposed_endpoints(config) == ((endpoint,) if is_exposed else ())
    if is_exposed:
        with pytest.raises(InvalidInput, match="--insecure") as caught:
            Server(listen=endpoint)
        assert caught.value.field == "listen"


def test_insecure_server_warns_and_serves(caplog):
    with Server(listen="tcp/0.0.0.0:0", insecure=True) as server:
        assert "without TLS" in caplog.text
        port = server.addresses[0].rpartition(":")[2]
        with Client(f"tcp/127.0.0.1:{port}", timeout=TIMEOUT) as client:
            assert client.solve(pinch()).found


def test_exposed_endpoint_of_a_file_is_refused(tmp_path):
    path = tmp_path / "exposed.json5"
    path.write_text("{listen: {endpoints: {peer: ['tcp/0.0.0.0:7000'], router: ['tcp/127.0.0.1:7000']}}}")
    with pytest.raises(InvalidInput, match=r"tcp/0\.0\.0\.0:7000"):
        Server(config=path)
    assert exposed_endpoints(server_configuration(path, ANY_LOCAL_PORT)) == ()


def test_file_that_is_not_json5_is_named(tmp_path):
    path = tmp_path / "bad.json5"
    path.write_text("{mode: ")
    with pytest.raises(InvalidInput, match="a Zenoh configuration file") as caught:
        Server(config=path)
    assert caught.value.field == "config"
