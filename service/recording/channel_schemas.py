"""JSON Schemas of the recorded messages by topic."""

from __future__ import annotations

import json
from functools import cache
from typing import NamedTuple

from graspforce.service.recording.exchange import STATE, Exchange
from graspforce.service.wire import protocol
from graspforce.service.wire.schemas.catalogue import SCHEMA_NAMES, wire_schema

_ENCODINGS = {protocol.JSON: "json", protocol.MSGPACK: "msgpack"}
_NO_CONTENT = "none"  # message encoding of an empty payload


class MessageChannel(NamedTuple):
    """A channel of the file.

    Attributes:
        topic: its topic.
        encoding: encoding of its messages: ``json``, ``msgpack``, ``none`` for empty ones, or an unknown encoding.
        schema: name of the JSON Schema of its messages, as in the key ``schema/<name>``; empty for none.
    """

    topic: str
    encoding: str
    schema: str


def request_channel(exchange: Exchange) -> MessageChannel:
    """Return the channel of a request or a state.

    Args:
        exchange: the exchange.
    """
    encoding = _message_encoding(exchange.payload, exchange.encoding)
    if exchange.kind == STATE:
        return MessageChannel(f"/streams/{exchange.key}/state", encoding, "streams/state")
    return MessageChannel(f"/requests/{exchange.key}", encoding, _request_schema(exchange.key, "request"))


def reply_channel(exchange: Exchange) -> MessageChannel:
    """Return the channel of a reply or a command. Error records have channels of their own.

    Args:
        exchange: the exchange.
    """
    encoding = _message_encoding(exchange.reply, exchange.reply_encoding)
    is_state = exchange.kind == STATE
    if not exchange.ok:
        topic = f"/streams/{exchange.key}/error" if is_state else f"/errors/{exchange.key}"
        return MessageChannel(topic, encoding, "error")
    if is_state:
        return MessageChannel(f"/streams/{exchange.key}/command", encoding, "streams/command")
    return MessageChannel(f"/replies/{exchange.key}", encoding, _request_schema(exchange.key, "reply"))


@cache
def schema_text(name: str) -> bytes:
    """Return a JSON Schema.

    Args:
        name: its name.
    """
    return json.dumps(wire_schema(name)).encode()


def _request_schema(key: str, part: str) -> str:
    """Return the name of the schema of a key's requests or replies; an empty text for none."""
    first, *rest = key.split("/")
    name = first if first != "hands" or len(rest) < 2 else f"hands/{rest[-1]}"
    name = f"{name}/{part}"
    return name if name in SCHEMA_NAMES else ""


def _message_encoding(payload: bytes, encoding: str | None) -> str:
    """Return the encoding of a channel for a payload."""
    if not payload:
        return _NO_CONTENT
    try:
        return _ENCODINGS[protocol.select_codec(encoding)]
    except ValueError:  # the request is refused for its encoding
        return str(encoding)
