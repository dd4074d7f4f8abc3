"""Strangers of an authenticated stream: forged, replayed and reordered messages have no effect; only the owner closes it."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control_requests import GRASP, desired, setup, state, stream_state
from support.servers import TIMEOUT, get, plain_session, wait_until

from graspforce.control import ControlSettings, ObjectController
from graspforce.core.errors import InvalidInput, RequestRefused
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.stream_authentication import (
    COMMAND,
    STATE,
    MessageSigner,
    MessageVerifier,
    make_key,
    ownership_proof,
    read_key,
)

TRIES = 300
SETTINGS = ControlSettings(period=2e-3)


@given(payloads=st.lists(st.binary(max_size=200), min_size=1, max_size=10))
def test_each_message_is_accepted_once_and_in_order(payloads):
    key = make_key()
    signer, verifier = MessageSigner(key, STATE), MessageVerifier(key, STATE)
    codes = [signer.sign(payload) for payload in payloads]
    assert all(verifier.accept(payload, code) for payload, code in zip(payloads, codes, strict=True))
    assert not any(verifier.accept(payload, code) for payload, code in zip(payloads, codes, strict=True))
    assert verifier.refused == {"replayed": len(payloads)}
    late = MessageVerifier(key, STATE)
    assert late.accept(payloads[-1], codes[-1])
    assert not any(late.accept(payload, code) for payload, code in zip(payloads[:-1], codes[:-1], strict=True))


@given(payload=st.binary(min_size=1, max_size=100), place=st.integers(0, 10**6), bit=st.integers(0, 7))
def test_any_changed_bit_is_noticed(payload, place, bit):
    key = make_key()
    code = MessageSigner(key, STATE).sign(payload)
    for index, text in enumerate((payload, code)):
        changed = bytearray(text)
        changed[place % len(changed)] ^= 1 << bit
        verifier = MessageVerifier(key, STATE)
        assert not verifier.accept(*((bytes(changed), code) if index == 0 else (payload, bytes(changed))))
        assert verifier.refused == {"forged": 1}


@given(attachment=st.binary(max_size=40))
def test_messages_without_the_key_are_forged(attachment):
    key, payload = make_key(), b"a state"
    verifier = MessageVerifier(key, STATE)
    for code in (attachment, MessageSigner(make_key(), STATE).sign(payload), MessageSigner(key, COMMAND).sign(payload)):
        assert not verifier.accept(payload, code)
    assert verifier.refused == {"forged": 3}


def test_only_the_owner_opens_a_stream_again_or_closes_it():
    streams = StreamRegistry({GRASP.hand.name: GRASP.hand}, capacity=3, idle_timeout=10.0)
    record = replace(setup(memory=None), authenticated=True).to_dict()
    key = read_key(streams.answer("a", record, b"owner")["key"])
    proof = ownership_proof(key, "a")
    for client, fields in [(b"", {}), (b"other", {}), (b"", {"proof": "0" * 64}), (b"", {"proof": ownership_proof(key, "b")})]:
        for request in (record, {"close": True}):
            with pytest.raises(RequestRefused, match="belongs to another client") as caught:
                streams.answer("a", {**request, **fields}, client)
            assert caught.value.code == "forbidden"
    assert streams.answer("a", record, b"owner")["key"] == key.hex()
    assert streams.answer("a", {**record, "proof": proof})["opened"] is False
    assert streams.answer("a", {"close": True, "proof": proof})["stream"] == "a"
    again = read_key(streams.answer("a", record, b"owner")["key"])
    assert again != key


def test_key_of_an_answer_is_checked():
    for invalid in (None, 5, "", "zz", "00" * 31):
        with pytest.raises(InvalidInput):
            read_key(invalid)


def test_strangers_have_no_effect_on_a_stream(server, client):
    """A stranger forges, replays and repeats states and commands, closes and opens: the torques stay those of a controller."""
    rng, controller = np.random.default_rng(2), ObjectController(GRASP, SETTINGS)
    with plain_session(server.addresses[0]) as stranger, client.open_stream(GRASP, SETTINGS, validity=TIMEOUT) as stream:
        key = f"graspforce/1/streams/{stream.id}"
        seen: list[tuple[bytes, bytes]] = []

        def record(sample):
            if sample.attachment is not None and len(seen) < 50:
                seen.append((sample.payload.to_bytes(), sample.attachment.to_bytes()))

        eavesdropper = stranger.declare_subscriber(f"{key}/state", record)
        forged_state = stream_state().encode(protocol.MSGPACK)
        outcomes = server._handler.streams[stream.id].outcomes
        for i in range(30):
            for _ in range(TRIES // 30):
                stranger.put(f"{key}/state", forged_state, encoding=protocol.MSGPACK, attachment=rng.bytes(24))
                stranger.put(f"{key}/command", b"\x80", encoding=protocol.MSGPACK, attachment=rng.bytes(24))
                if seen:
                    payload, code = seen[int(rng.integers(len(seen)))]
                    stranger.put(f"{key}/state", payload, encoding=protocol.MSGPACK, attachment=code)
            time.sleep(0.01)  # the stranger's messages arrive before the state
            command = stream.step(state(i), desired(), wait=TIMEOUT)
            np.testing.assert_allclose(command.tau, controller.step(state(i), desired()).tau, rtol=1e-9, atol=1e-12)
            assert stream.last_error is None
        eavesdropper.undeclare()
        for request in ({"close": True}, stream.setup.to_dict()):
            [(ok, _, payload)] = get(stranger, f"streams/{stream.id}", json.dumps(request))
            assert not ok
            assert json.loads(payload)["error"] == "forbidden"
        wait_until(lambda: outcomes["forged"] > 0 and outcomes["replayed"] > 0)
        assert outcomes["ok"] == 30
        assert set(outcomes) <= {"ok", "forged", "replayed"}
        assert stream._connection.refused["forged"] > 0
        assert client.status().streams == 1
    assert client.status().streams == 0  # its owner has closed it
