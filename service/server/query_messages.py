"""Payloads of Zenoh queries, and their replies."""

from __future__ import annotations

import logging

import zenoh

from graspforce.core.printable import escape_controls
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply
from graspforce.service.wire.schemas.catalogue import SCHEMA, SCHEMA_NAMES
from graspforce.service.zenoh_session import describe_zenoh_error

log = logging.getLogger("graspforce.service")


def read_query(query: zenoh.Query, max_bytes: int | None = None) -> tuple[bytes, str | None]:
    """Return the payload and the encoding of a query.

    Args:
        query: the query.
        max_bytes: size beyond which the payload is not copied, and empty in the result; None for none.
    """
    payload, encoding = query.payload, query.encoding
    copied = b""
    if payload is not None and (max_bytes is None or len(payload) <= max_bytes):
        copied = payload.to_bytes()
    return copied, None if encoding is None else str(encoding)


def matching_keys(key: str) -> tuple[str, ...]:
    """Return the keys that a query asks for: those of the schemas that a key expression with wildcards matches, else its own.

    Args:
        key: key of the query after the prefix.
    """
    if "*" not in key or not key.startswith(SCHEMA):
        return (key,)
    asked = zenoh.KeyExpr(key)
    found = [each for each in (f"{SCHEMA}/{name}" for name in SCHEMA_NAMES) if asked.intersects(zenoh.KeyExpr(each))]
    return tuple(found) or (key,)


def send_reply(query: zenoh.Query, key: str, reply: Reply) -> None:
    """Send the reply to a query. A failure is only logged.

    Args:
        query: the query.
        key: its key after the prefix.
        reply: the reply.
    """
    try:
        if reply.ok:
            query.reply(f"{protocol.PREFIX}/{key}", reply.payload, encoding=reply.encoding)
        else:
            query.reply_err(reply.payload, encoding=reply.encoding)
    except zenoh.ZError as error:
        log.warning("cannot send the reply to a request to %s: %s", escape_controls(key), describe_zenoh_error(error))
