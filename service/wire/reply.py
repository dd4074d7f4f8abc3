"""Replies of the server, and the conversion of exceptions to error records."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from types import MappingProxyType

import msgspec
import numpy as np

from graspforce.core.errors import BackendError, InvalidInput, ModelError, RequestRefused, UnknownField
from graspforce.core.printable import escape_controls
from graspforce.service.wire import protocol

log = logging.getLogger("graspforce.service")


class Reply(msgspec.Struct, frozen=True):
    """A reply, ready to be sent.

    Args:
        ok: True for a record, False for an error record.
        payload: the encoded record.
        encoding: its Zenoh encoding.
    """

    ok: bool
    payload: bytes
    encoding: str


def make_error_reply(
    codec: str, code: str, message: str, field: str | None, sequence: int | None, retry_after: float | None = None
) -> Reply:
    """Return the reply with an error record.

    Args:
        codec: `protocol.JSON` or `protocol.MSGPACK`.
        code: as in `protocol.error_record`.
        message: as in `protocol.error_record`.
        field: as in `protocol.error_record`.
        sequence: as in `protocol.error_record`.
        retry_after: as in `protocol.error_record`, s.
    """
    return Reply(False, protocol.encode(protocol.error_record(code, message, field, sequence, retry_after), codec), codec)


def make_failure_reply(codec: str, error: Exception, key: str, sequence: int | None, client: str = "") -> tuple[str, Reply]:
    """Return the code and the reply of a request that raised an exception.

    Args:
        codec: `protocol.JSON` or `protocol.MSGPACK`.
        error: the exception.
        key: key of the request, for the log.
        sequence: sequence number of the request.
        client: label of its client, for the log.
    """
    code, message, field = describe_error(error, key, {"client": client, "sequence": sequence})
    return code, make_error_reply(codec, code, message, field, sequence, getattr(error, "retry_after", None))


def describe_error(
    error: Exception, key: str, request: Mapping[str, object] = MappingProxyType({})
) -> tuple[str, str, str | None]:
    """Return the code, message and field of an exception's error record.

    An unexpected exception is logged with its traceback; its message does not leave the server. Arithmetic that fails for the
    numbers of a request is no fault of the server: the code is `invalid`. It is logged, too.

    Args:
        error: the exception.
        key: key of the request, for the log.
        request: `client` and `sequence` of the request, for the log.
    """
    if isinstance(error, InvalidInput):
        is_named = error.field or isinstance(error, UnknownField)  # the name of an unknown field may be empty
        return error.code, str(error), error.field if is_named else None
    if isinstance(error, RequestRefused):
        return error.code, error.message, None
    if isinstance(error, MemoryError):
        return "too_large", "the request needs more memory than a worker may have", None
    if isinstance(error, BackendError):
        return "invalid", str(error), "backend"
    if isinstance(error, ModelError):
        return "internal", str(error), None
    if isinstance(error, OverflowError | FloatingPointError | np.linalg.LinAlgError):
        log.warning(
            "too large or too small numbers in a request to %s", escape_controls(key), exc_info=error, extra=dict(request)
        )
        return "invalid", f"numbers in the request are too large or too small to compute with ({type(error).__name__})", None
    log.error("a request to %s failed", escape_controls(key), exc_info=error, extra=dict(request))
    return "internal", f"internal error ({type(error).__name__}); the server's log has the details", None
