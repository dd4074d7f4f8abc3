"""Replies of the server as records, exceptions and progress."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import zenoh

from graspforce.core.errors import ErrorReply, InvalidInput, ServiceError, ServiceTimeout, format_value
from graspforce.planning import ProgressCallback
from graspforce.planning.progress import should_continue
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_progress

T = TypeVar("T")

_POLL_PERIOD = 0.01  # s between looks at what has come about a plan


def report_progress(
    replies: zenoh.Handler[zenoh.Reply],
    progress_samples: zenoh.Subscriber[Any],
    progress: ProgressCallback | None,
    cancel: Callable[[], None],
) -> Iterator[zenoh.Reply]:
    """The replies as they come; meanwhile ``progress`` is told how far it is."""
    active = True
    while True:
        try:
            reply = replies.try_recv()
        except zenoh.ZError:  # nobody else will answer
            return
        if reply is not None:
            yield reply
            continue
        sample = progress_samples.handler.try_recv()
        if sample is None:
            time.sleep(_POLL_PERIOD)
        elif progress is not None and active:
            with contextlib.suppress(InvalidInput):  # of another program under the same id
                now = read_progress(protocol.decode(sample.payload.to_bytes(), protocol.select_codec(str(sample.encoding))))
                if not should_continue(progress(now)):
                    active = False
                    cancel()


def decode_error(error: zenoh.ReplyError, late: str) -> ServiceError:
    """A reply that is no answer, as the exception to raise."""
    payload, encoding = error.payload.to_bytes(), str(error.encoding)
    if encoding not in (protocol.JSON, protocol.MSGPACK):  # Zenoh's own word
        return (
            ServiceTimeout(late)
            if payload == b"Timeout"
            else ErrorReply("internal", f"Zenoh says {format_value(payload)}", None)
        )
    try:
        return protocol.read_error(protocol.decode(payload, encoding))
    except InvalidInput as unreadable:
        return make_unreadable_error(unreadable)


def decode_answer(sample: zenoh.Sample, sequence: int) -> dict[str, Any]:
    """The record of an answer, which must carry the number of its question."""
    try:
        record = protocol.decode(sample.payload.to_bytes(), protocol.select_codec(str(sample.encoding)))
    except InvalidInput as unreadable:
        raise make_unreadable_error(unreadable) from None
    echo = record.get("sequence") if isinstance(record, dict) else None
    if echo != sequence:
        raise ErrorReply(
            "internal", f"the answer carries the sequence {format_value(echo)} where {sequence} was asked", "sequence"
        )
    return dict(record)


def parse_record(read: Callable[[Mapping[str, Any]], T], record: dict[str, Any]) -> T:
    """A server's record, without its envelope, as a typed one."""
    try:
        return read({name: value for name, value in record.items() if name not in ("sequence", "server_seconds")})
    except InvalidInput as unreadable:
        raise make_unreadable_error(unreadable) from None


def make_unreadable_error(error: InvalidInput) -> ErrorReply:
    return ErrorReply("internal", f"the server's answer could not be read: {error}", error.field or None)
