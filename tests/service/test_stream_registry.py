"""Opening, closing and expiry of control streams, without a network."""

from __future__ import annotations

import time

import pytest
from support.control_requests import (
    CONTROL,
    HAND,
    HANDS,
    request,
    setup,
    stream_state,
    with_change,
)

from graspforce.core.errors import InvalidInput, RequestRefused, UnknownName
from graspforce.service import RequestHandler, ServerLimits
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import MSGPACK

JOINTS = [joint.name for joint in HAND.joints]


def make_registry(**change):
    """Return a registry, and the lists of the streams that it opens and closes."""
    opened, closed = [], []
    limits = {"capacity": 3, "idle_timeout": 10.0, **change}
    return StreamRegistry(HANDS, on_open=opened.append, on_close=closed.append, **limits), opened, closed


def test_stream_is_opened_once_and_closed_once():
    streams, opened, closed = make_registry()
    answer = streams.answer("a", setup().to_dict())
    assert len(bytes.fromhex(answer.pop("epoch"))) == 8
    assert answer == {"stream": "a", "opened": True, "idle": 10.0, "joints": JOINTS}
    assert len(streams) == 1
    assert opened == [streams["a"]]
    # the same request again, with or without memory, changes nothing
    assert streams.answer("a", setup(memory=None).to_dict())["opened"] is False
    assert len(opened) == 1
    with pytest.raises(InvalidInput, match="a new id: the open stream with this id has other parameters"):
        streams.answer("a", setup(validity=0.06).to_dict())
    streams["a"].command(b"", None)
    assert streams.outcomes() == {"invalid": 1}
    assert streams.answer("a", {"close": True}) == {"stream": "a", "outcomes": {"invalid": 1}, "skipped": 0}
    assert (len(streams), closed) == (0, opened)
    assert streams.outcomes() == {"invalid": 1}
    with pytest.raises(UnknownName, match="the id of an open stream"):
        streams.answer("a", {"close": True})
    assert len(closed) == 1


def test_number_of_open_streams_is_limited():
    streams, opened, _ = make_registry(capacity=2)
    for id in ("a", "b", "a"):
        streams.answer(id, setup().to_dict())
    with pytest.raises(RequestRefused, match="2 streams are open") as caught:
        streams.answer("c", setup().to_dict())
    assert caught.value.code == "overloaded"
    streams.answer("a", {"close": True})
    assert streams.answer("c", setup().to_dict())["opened"]
    assert [stream.id for stream in opened] == ["a", "b", "c"]


def test_only_idle_streams_expire():
    streams, _, closed = make_registry(idle_timeout=10.0)
    for id in ("dead", "alive"):
        streams.answer(id, setup().to_dict())
    now = time.perf_counter()
    valid = stream_state().encode(MSGPACK)
    streams["dead"].command(b"junk", None, received=now + 9.0)  # junk keeps no stream alive
    streams["alive"].command(valid, MSGPACK, received=now + 9.0)
    streams.expire(now + 9.9)
    assert len(streams) == 2
    streams.expire(now + 11.0)
    assert [stream.id for stream in closed] == ["dead"]
    streams.close()
    assert [stream.id for stream in closed] == ["dead", "alive"]
    assert len(streams) == 0


def test_handler_opens_counts_and_closes_streams():
    handler = RequestHandler([HAND], limits=ServerLimits(streams=1))

    def ask(key, record):
        reply = handler.answer(key, protocol.encode(record, MSGPACK), MSGPACK)
        return reply.ok, protocol.decode(reply.payload, MSGPACK)

    ok, answer = ask("streams/a", {**setup().to_dict(), "sequence": 5})
    assert ok
    assert (answer["stream"], answer["sequence"], answer["opened"]) == ("a", 5, True)
    assert handler.streams["a"].command(protocol.encode(stream_state().to_dict(), MSGPACK), MSGPACK).ok
    assert ask("streams/b", setup().to_dict())[1]["error"] == "overloaded"
    assert ask("status", {})[1]["streams"] == 1
    assert ask("streams/a", {"close": True})[0]
    status = ask("status", {})[1]
    assert status["streams"] == 0
    assert status["counts"]["streams"] == {"ok": 2, "overloaded": 1}
    assert status["counts"]["streams/*/state"] == {"ok": 1}
    assert ask("streams/a/state", {})[1]["error"] == "unknown"
    many = with_change(setup().to_dict(), ("hold", "contacts"), [{}] * 501)
    assert ask("streams/a", many)[1]["error"] == "too_large"
    for key, record in (("streams/a", setup().to_dict()), (CONTROL, request().to_dict())):
        ok, error = ask(key, {**record, "backend": "clarabel"})
        assert (ok, error["error"], error["field"]) == (False, "invalid", "backend")


@pytest.mark.parametrize("id", ["a", "arm-7/a", "x" * 64 + "/" + "y" * 64])
def test_id_may_begin_with_the_name_of_the_client(id):
    streams, _, _ = make_registry()
    assert streams.answer(id, setup().to_dict())["stream"] == id
    assert streams.answer(id, {"close": True})["stream"] == id


@pytest.mark.parametrize("id", ["", "/a", "a/", "a/b/c", "a//b", "*/a", "a/$", "x" * 65, "x" * 65 + "/a", "a\n/b"])
def test_other_ids_are_refused(id):
    with pytest.raises(InvalidInput) as caught:
        make_registry()[0].answer(id, setup().to_dict())
    assert caught.value.field == "stream"
