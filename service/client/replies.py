"""Replies of the server: decode answers and errors, check sequence numbers, and deliver the progress of a plan."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import zenoh

from graspforce.core.errors import ErrorReply, InvalidInput, RequestRefused, ServiceError, ServiceTimeout, format_value
from graspforce.core.json_text import JsonRecord
from graspforce.planning import ProgressCallback
from graspforce.planning.progress import should_continue
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_progress

T = TypeVar("T")

_POLL_PERIOD = 0.01  # s, between checks for replies and progress of a plan


def report_progress(
    replies: zenoh.Handler[zenoh.Reply],
    progress_samples: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]],
    callback: ProgressCallback | None,
    cancel: Callable[[], None],
) -> Iterator[zenoh.Reply]:
    """Yield replies as they arrive, and call the callback with the progress in the meantime.

    Args:
        replies: replies to a planning request; it ends when no further reply can arrive.
        progress_samples: subscriber to the plan's progress.
        callback: called with each progress record, in this thread; return False to stop.
        cancel: called once if the callback returns False.
    """
    active = True
    while True:
        try:
            reply = replies.try_recv()
        except zenoh.ZError:  # no further reply can arrive
            return
        if reply is not None:
            yield reply
            continue
        sample = progress_samples.handler.try_recv()
        if sample is None:
            time.sleep(_POLL_PERIOD)
        elif callback is not None and active:
            with contextlib.suppress(InvalidInput):  # another program published on the same key
                now = read_progress(protocol.decode(sample.payload.to_bytes(), protocol.select_codec(str(sample.encoding))))
                if not should_continue(callback(now)):
                    active = False
                    cancel()


def read_replies(replies: Iterable[zenoh.Reply], sequence: int, timeout: float) -> JsonRecord | RequestRefused | None:
    """Return the first answer to a query, the refusal of a closing server, or None if there are no replies.

    Args:
        replies: the replies.
        sequence: sequence number of the query.
        timeout: time for the answer, s, for messages.

    Raises:
        ServiceError: there are other error replies only.
    """
    failure: ServiceError | None = None
    for reply in replies:
        if reply.ok is not None:
            return decode_answer(reply.ok, sequence)
        assert reply.err is not None  # a reply is one or the other
        # With several servers, one that does not know the hand does not decide for the others.
        if failure is None or getattr(failure, "code", "") == "unknown":
            failure = decode_error(reply.err, f"no answer within {timeout:g} s")
    if isinstance(failure, RequestRefused) and failure.code == "closing":
        return failure
    if failure is not None:
        raise failure
    return None


def decode_answer(sample: zenoh.Sample, sequence: int) -> JsonRecord:
    """Return the record of an answer.

    Args:
        sample: the answer.
        sequence: sequence number of the request, which the answer must repeat.

    Raises:
        ErrorReply: the answer cannot be read, or has another sequence number.
    """
    try:
        record = protocol.decode(sample.payload.to_bytes(), protocol.select_codec(str(sample.encoding)))
    except InvalidInput as error:
        raise make_unreadable_error(error) from None
    if not isinstance(record, dict) or record.get("sequence") != sequence:
        echo = record.get("sequence") if isinstance(record, dict) else None
        message = f"the answer has sequence {format_value(echo)}; the request had {sequence}"
        raise ErrorReply("internal", message, "sequence")
    return record


def decode_error(error: zenoh.ReplyError, timeout_message: str) -> ServiceError:
    """Return the exception of an error reply.

    Args:
        error: the reply: an error record of the server, or Zenoh's own error.
        timeout_message: text of the exception if Zenoh reports a timeout.
    """
    payload, encoding = error.payload.to_bytes(), str(error.encoding)
    if encoding not in (protocol.JSON, protocol.MSGPACK):  # Zenoh's own error
        if payload == b"Timeout":
            return ServiceTimeout(timeout_message)
        return ErrorReply("internal", f"Zenoh error: {format_value(payload)}", None)
    try:
        return protocol.read_error(protocol.decode(payload, encoding))
    except InvalidInput as unreadable:
        return make_unreadable_error(unreadable)


def parse_record(read: Callable[[JsonRecord], T], record: JsonRecord) -> T:
    """Return the typed record of an answer.

    Args:
        read: `from_dict` of the type.
        record: the answer; its envelope is removed.

    Raises:
        ErrorReply: the answer does not have the fields of the type.
    """
    try:
        return read({name: value for name, value in record.items() if name not in protocol.ANSWER_ENVELOPE})
    except InvalidInput as error:
        raise make_unreadable_error(error) from None


def make_unreadable_error(error: InvalidInput) -> ErrorReply:
    """Return the exception for an answer that cannot be read, with the reason and the field."""
    return ErrorReply("internal", f"the server's answer cannot be read: {error}", error.field or None)
