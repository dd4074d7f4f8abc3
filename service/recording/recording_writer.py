"""The file of a recording: MCAP with the exact bytes of all messages, their JSON Schemas, and Foxglove's messages.

| topic | messages |
|---|---|
| `/requests/<key>`, `/replies/<key>`, `/errors/<key>` | a request and its reply |
| `/streams/<id>/state`, `/streams/<id>/command`, `/streams/<id>/error` | a state and its command |
| `/dropped` | number of exchanges that are missing here, of requests or of a stream |
| see `stream_topics` | poses, joints and forces of streams, 50 a second |

A message and its reply have the same `sequence` and follow each other. The `log_time` of the first is when the server received
it, that of the second when it was answered, in nanoseconds since 1970. Secrets are not written: the `key` of a stream with
authentication, and proofs of its owner.
"""

from __future__ import annotations

import json
from types import TracebackType
from typing import IO

from mcap.well_known import SchemaEncoding
from mcap.writer import CompressionType, Writer

from graspforce.core import foxglove_messages as fox
from graspforce.core.errors import InvalidInput
from graspforce.service.recording.channel_schemas import MessageChannel, reply_channel, request_channel, schema_text
from graspforce.service.recording.exchange import DROPPED, END, FORMAT, HEADER, OTHER, STATE, End, Exchange, Header
from graspforce.service.recording.stream_topics import StreamTopics
from graspforce.service.wire import protocol

_MAX_KEYS = 500  # clients could send requests to any number of keys that do not exist
_SECRETS = ("key", "proof")
_STREAMS = "streams/"
_WRAP = 2**32  # of MCAP's sequence numbers


class RecordingWriter:
    """A recording that is being written. Use it as a context manager.

    Args:
        file: the open file.
        header: about the server.
    """

    def __init__(self, file: IO[bytes], header: Header) -> None:
        self._writer = Writer(file, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"graspforce {header.version}")
        self._clock = header.clock
        hands = json.dumps([{"name": each.name, "file": each.file, "fingerprint": each.fingerprint} for each in header.hands])
        self._writer.add_metadata(
            HEADER,
            {
                "format": FORMAT,
                "clock": str(header.clock),
                "version": header.version,
                "machine": header.machine,
                "hands": hands,
                "limits": json.dumps(header.limits),
            },
        )
        self._channels: dict[tuple[str, ...], int] = {}
        self._schemas: dict[str, int] = {"": 0}
        self._streams: dict[str, StreamTopics] = {}
        self._keys: set[str] = set()
        self._count = 0

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]

    def write(self, exchange: Exchange) -> None:
        """Write an exchange.

        Args:
            exchange: the exchange.
        """
        if exchange.kind != STATE and exchange.key.startswith(_STREAMS):
            exchange = without_secrets(exchange)
            self._open_stream(exchange)
        if len(self._keys) >= _MAX_KEYS and exchange.key not in self._keys:
            exchange = Exchange(exchange.kind, OTHER, exchange.received, exchange.sent, b"", None, False, b"", protocol.JSON)
        self._keys.add(exchange.key)
        channels = request_channel(exchange), reply_channel(exchange)
        if exchange.dropped:
            self._write_dropped(exchange)
        sequence = self._count % _WRAP
        self._count += 1
        times = exchange.received, exchange.sent
        contents = (exchange.payload, exchange.encoding), (exchange.reply, exchange.reply_encoding)
        for part, channel, t, (payload, encoding) in zip(("request", "reply"), channels, times, contents, strict=True):
            about = {"part": part, "kind": exchange.kind, "key": exchange.key, "ok": str(int(exchange.ok))}
            number = self._channel(channel, {**about, **({} if encoding is None else {"encoding": encoding})})
            self._add(number, t, payload, sequence)
        if exchange.kind == STATE and exchange.key in self._streams:
            self._write_foxglove(exchange)

    def end(self, end: End) -> None:
        """Write the totals.

        Args:
            end: the totals.
        """
        self._writer.add_metadata(END, {"written": str(end.written), "dropped": json.dumps(end.dropped)})

    def _open_stream(self, exchange: Exchange) -> None:
        """Begin the Foxglove messages of a stream that is opened; streams of other kinds have none."""
        id = exchange.key.removeprefix(_STREAMS)
        try:
            request = protocol.decode(exchange.payload, protocol.select_codec(exchange.encoding))
            reply = protocol.decode(exchange.reply, exchange.reply_encoding)
            if exchange.ok and isinstance(reply, dict) and reply.get("opened") is True:
                self._streams[id] = StreamTopics(id, request, reply["joints"])
        except InvalidInput:
            self._streams.pop(id, None)

    def _write_foxglove(self, exchange: Exchange) -> None:
        """Write the Foxglove messages of a state."""
        for topic, message in self._streams[exchange.key].messages(exchange):
            schema = message.get_schema()
            if schema.name not in self._schemas:
                self._schemas[schema.name] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            number = self._channel(MessageChannel(topic, "protobuf", schema.name), {})
            self._add(number, exchange.received, message.encode(), 0)

    def _write_dropped(self, exchange: Exchange) -> None:
        """Write how many exchanges are missing before one."""
        record = {"source": exchange.source, "count": exchange.dropped}
        self._add(self._channel(MessageChannel(DROPPED, "json", ""), {}), exchange.received, json.dumps(record).encode(), 0)

    def _channel(self, channel: MessageChannel, about: dict[str, str]) -> int:
        """Return the number of a channel, which is made at its first message."""
        key = (*channel, about.get("encoding", ""))
        if key not in self._channels:
            if channel.schema not in self._schemas:
                text, name = schema_text(channel.schema), f"graspforce/{channel.schema}"
                self._schemas[channel.schema] = self._writer.register_schema(name, SchemaEncoding.JSONSchema, text)
            number = self._schemas[channel.schema]
            self._channels[key] = self._writer.register_channel(channel.topic, channel.encoding, number, about)
        return self._channels[key]

    def _add(self, channel: int, t: float, data: bytes, sequence: int) -> None:
        """Write a message of a time on the server's clock."""
        time = self._clock + fox.log_time(t)
        self._writer.add_message(channel, time, data, time, sequence)


def without_secrets(exchange: Exchange) -> Exchange:
    """Return the opening of a stream without its key and proofs.

    Args:
        exchange: the exchange.
    """
    payload = _remove(exchange.payload, exchange.encoding, _SECRETS)
    reply = _remove(exchange.reply, exchange.reply_encoding, _SECRETS)
    times, codecs = (exchange.received, exchange.sent), (exchange.encoding, exchange.reply_encoding)
    return Exchange(exchange.kind, exchange.key, *times, payload, codecs[0], exchange.ok, reply, codecs[1], exchange.dropped)


def _remove(payload: bytes, encoding: str | None, names: tuple[str, ...]) -> bytes:
    """Return a payload without some fields; one that cannot be read is empty."""
    try:
        codec = protocol.select_codec(encoding)
        record = protocol.decode(payload, codec)
    except InvalidInput:
        return b""
    if not isinstance(record, dict) or not any(name in record for name in names):
        return payload
    return protocol.encode({name: value for name, value in record.items() if name not in names}, codec)
