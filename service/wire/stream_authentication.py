"""Authentication of the states and commands of a stream: a key for each opening, a counter and a code for each message.

The server makes the key and sends it in its answer to the query that opens the stream; queries and answers reach no third
client. The attachment of each state and command is then ::

    counter (8 bytes, little-endian) + HMAC-SHA256(key, direction + counter + payload)[:16]

with ``S`` (state) or ``C`` (command) as the direction. The receiver accepts a message if its code is right and its counter is
larger than that of the last accepted one. Forged, replayed, duplicated and reordered messages are therefore refused, and so are
those of an earlier opening. A program that reads the network traffic can read the key: only TLS protects against it.

Compiled code computes the codes on processors with SHA instructions, and `hashlib` on others.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections import Counter
from typing import Any, cast

from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput

STATE, COMMAND = b"S", b"C"  # directions
FORGED, REPLAYED = "forged", "replayed"  # outcomes
_KEY_BYTES, _COUNTER_BYTES, _CODE_BYTES = 32, 8, 16
_BLOCK_BYTES = 64  # of SHA-256; the key is shorter
_CompiledCode: Any = getattr(native, "MessageCode", None)  # None without a C compiler or SHA instructions
_OUTCOMES: dict[int, str] = {} if _CompiledCode is None else {native.FORGED: FORGED, native.REPLAYED: REPLAYED}


def make_key() -> bytes:
    """Return a new random key."""
    return secrets.token_bytes(_KEY_BYTES)


def read_key(value: object) -> bytes:
    """Return the key of a server's answer.

    Args:
        value: its text in hexadecimal.

    Raises:
        InvalidInput: not such a text.
    """
    try:
        key = bytes.fromhex(value) if isinstance(value, str) else b""
    except ValueError:
        key = b""
    if len(key) != _KEY_BYTES:
        raise InvalidInput("key", type(value).__name__, f"{2 * _KEY_BYTES} hexadecimal digits")
    return key


def ownership_proof(key: bytes, id: str) -> str:
    """Return the text by which a client proves that it opened a stream.

    Args:
        key: key of the stream.
        id: id of the stream.
    """
    return hmac.digest(key, b"owner" + id.encode(), "sha256").hex()


class _MessageCode:
    """Authentication codes of the messages in one direction: HMAC-SHA256 with the blocks of its key hashed once."""

    def __init__(self, key: bytes, direction: bytes) -> None:
        block = key.ljust(_BLOCK_BYTES, b"\0")
        self._inner = hashlib.sha256(bytes(each ^ 0x36 for each in block) + direction)
        self._outer = hashlib.sha256(bytes(each ^ 0x5C for each in block))

    def __call__(self, counter: bytes, payload: bytes) -> bytes:
        """Return the code of a message."""
        inner, outer = self._inner.copy(), self._outer.copy()
        inner.update(counter + payload)
        outer.update(inner.digest())
        return outer.digest()[:_CODE_BYTES]


class MessageSigner:
    """Attachments of the messages in one direction. One thread at a time uses it.

    Args:
        key: key of the stream.
        direction: `STATE` or `COMMAND`.
    """

    def __init__(self, key: bytes, direction: bytes) -> None:
        self._compiled = None if _CompiledCode is None else _CompiledCode(key, direction)
        self._code, self._counter = _MessageCode(key, direction), 0

    def sign(self, payload: bytes) -> bytes:
        """Return the attachment of the next message.

        Args:
            payload: its payload.
        """
        if self._compiled is not None:
            return cast(bytes, self._compiled.sign(payload))
        self._counter += 1
        counter = self._counter.to_bytes(_COUNTER_BYTES, "little")
        return counter + self._code(counter, payload)


class MessageVerifier:
    """Checks of the messages in one direction. One thread at a time uses it.

    Attributes:
        refused: number of refused messages by outcome.

    Args:
        key: key of the stream.
        direction: `STATE` or `COMMAND`.
    """

    def __init__(self, key: bytes, direction: bytes) -> None:
        self._compiled = None if _CompiledCode is None else _CompiledCode(key, direction)
        self._code, self._last = _MessageCode(key, direction), 0
        self.refused: Counter[str] = Counter()

    def accept(self, payload: bytes, attachment: bytes) -> bool:
        """Return whether a message is genuine and newer than the last accepted one, and count it otherwise.

        Args:
            payload: its payload.
            attachment: its attachment; empty for none.
        """
        if self._compiled is not None:
            outcome = self._compiled.check(payload, attachment)
            if outcome:
                self.refused[_OUTCOMES[outcome]] += 1
            return not outcome
        counter, code = attachment[:_COUNTER_BYTES], attachment[_COUNTER_BYTES:]
        if not hmac.compare_digest(code, self._code(counter, payload)):
            self.refused[FORGED] += 1
            return False
        number = int.from_bytes(counter, "little")
        if number <= self._last:
            self.refused[REPLAYED] += 1
            return False
        self._last = number
        return True
