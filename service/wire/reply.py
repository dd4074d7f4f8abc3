"""A reply as it goes out, and how an exception becomes one."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from graspforce.core.errors import BackendError, InvalidInput, ModelError, RequestRefused
from graspforce.service.wire import protocol

log = logging.getLogger("graspforce.service")


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer as it goes out.

    Args:
        ok: a record; otherwise an error record.
        payload: its bytes.
        encoding: their Zenoh encoding.
    """

    ok: bool
    payload: bytes
    encoding: str


def make_error_reply(codec: str, code: str, message: str, field: str | None, sequence: int | None) -> Reply:
    """The reply that says what went wrong."""
    return Reply(False, protocol.encode(protocol.error_record(code, message, field, sequence), codec), codec)


def describe_error(error: Exception, key: str) -> tuple[str, str, str | None]:
    """An exception as an error record's code, message and field. A fault of our own is logged, and not shown.

    Args:
        error: what was raised.
        key: of the request that raised it.
    """
    if isinstance(error, InvalidInput):
        return error.code, str(error), error.field or None
    if isinstance(error, RequestRefused):
        return error.code, error.message, None
    if isinstance(error, BackendError):
        return "invalid", str(error), "backend"
    if isinstance(error, ModelError):
        return "internal", str(error), None
    log.error("a request to %s failed", key, exc_info=error)
    return "internal", f"the server failed at this request ({type(error).__name__}); its log says more", None
