"""Directories with certificates and roles: nothing is lost by a repeated command, and names fit certificates and keys."""

from __future__ import annotations

import json

import pytest

from graspforce.core.errors import InvalidInput
from graspforce.service import Server
from graspforce.service.security.certificates import is_issued_by_newest
from graspforce.service.security.directory import (
    add_client,
    begin_rotation,
    client_settings,
    finish_rotation,
    init_directory,
    renew_server,
)
from graspforce.service.wire import protocol


@pytest.fixture
def keys(tmp_path):
    return init_directory(tmp_path / "keys")


def contents(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir()}


@pytest.mark.parametrize("moved", ["ca.key", "ca.pem", "roles.json"])
def test_init_replaces_nothing_even_if_a_file_was_moved_elsewhere(keys, moved):
    (keys / moved).unlink()
    before = contents(keys)
    with pytest.raises(InvalidInput) as caught:
        init_directory(keys)
    assert caught.value.field == "directory"
    assert contents(keys) == before


def test_a_second_rotation_waits_for_the_end_of_the_first(keys):
    begin_rotation(keys)
    before = contents(keys)
    with pytest.raises(InvalidInput, match="--finish"):
        begin_rotation(keys)
    assert contents(keys) == before
    renew_server(keys)
    for name in ("controller", "monitor"):
        add_client(keys, name)
    finish_rotation(keys)
    begin_rotation(keys)
    assert not is_issued_by_newest(keys, "server")


@pytest.mark.parametrize("name", [" ", "arm 7", " arm", "@arm", ".hidden", "-x", "ünï", "é", "a,b", "a\u200b", "..", "x" * 65])
def test_names_that_fit_no_certificate_or_key_are_refused(keys, name):
    before = contents(keys)
    for call in (lambda: add_client(keys, name, "controller"), lambda: client_settings(keys, name)):
        with pytest.raises(InvalidInput) as caught:
            call()
        assert caught.value.field in ("name", "secure")
    assert contents(keys) == before


def test_clients_load_no_files_outside_their_directory(keys):
    with pytest.raises(InvalidInput, match="name"):
        client_settings(keys / "..", "keys/controller")


def test_a_renewed_client_keeps_its_role(keys):
    assert add_client(keys, "arm-7", "controller") == "controller"
    assert add_client(keys, "arm-7") == "controller"
    assert add_client(keys, "screen") == "monitor"
    assert add_client(keys, "screen", "controller") == "controller"
    roles = json.loads((keys / "roles.json").read_text())
    assert (roles["arm-7"], roles["screen"]) == ("controller", "controller")


def test_roles_that_are_missing_are_not_replaced_by_new_ones(keys):
    (keys / "roles.json").unlink()
    before = contents(keys)
    with pytest.raises(InvalidInput, match=r"roles\.json"):
        add_client(keys, "arm-7", "controller")
    assert contents(keys) == before


def test_a_server_with_certificates_listens_with_tls_only(keys):
    with pytest.raises(InvalidInput, match="TLS") as caught:
        Server(["four_finger"], listen="tcp/127.0.0.1:0", secure=keys)
    assert caught.value.field == "listen"
    Server(["four_finger"], listen="tcp/127.0.0.1:0", secure=keys, insecure=True)
    Server(["four_finger"], listen="tls/127.0.0.1:0", secure=keys)


def test_ids_do_not_begin_with_a_sign_that_wildcards_do_not_match():
    assert protocol.check_named_id("arm/a@b") == "arm/a@b"
    for id in ("@a", "arm/@a", "@arm/a"):
        with pytest.raises(InvalidInput, match="no @ at the begin"):
            protocol.check_named_id(id)
