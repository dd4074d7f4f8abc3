"""Write docs/wire_replies.md: send every request of docs/wire.md to a server, and record its reply.

    python docs/wire_replies.py

Any program can do the same: the requests are the JSON blocks that follow a comment with their key. Its first word says how a
block is sent: as a `query`; as a `state` of a stream, or `signed` with the key of the stream; as the query of a plan that is
`followed` until its first progress; or as a message that is to `cancel` it. A `token` is asked for by a liveliness query, which
has no payload: the page shows the key of its reply.
"""

from __future__ import annotations

import hmac
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from graspforce.service import Server
from graspforce.service.wire import protocol

PAGE = Path(__file__).parent / "wire.md"
TARGET = PAGE.with_name("wire_replies.md")
HAND = "four_finger"
TIMEOUT = 30.0  # s
_TITLES = {
    "query": "Query",
    "state": "Command of a state",
    "signed": "Command of a signed state",
    "followed": "First progress of a plan",
    "cancel": "Reply to the query of a cancelled plan",
    "token": "Liveliness token",
}
_DIGITS = 6  # significant digits on the page
_WIDTH = 120  # columns
_MOST_NUMBERS, _MOST_PARTS, _SHOWN = 20, 4, 2  # items of an array on the page
_HEADING = """# Replies on the wire

The replies of a server to the requests of [the wire](wire.md), in their order. Numbers are rounded to six digits,
and of arrays with more than 20 items, or more than 4 arrays or records, the first two are shown.
`python docs/wire_replies.py` writes this page.
"""


class Exchange(NamedTuple):
    """A request of the page, and its reply.

    Attributes:
        kind: "query"; "state" or "signed" for a message to a stream; "followed" or "cancel" for a plan; "token" for a query of
            liveliness.
        key: key after ``graspforce/1/``.
        request: the record of the page.
        reply: the record of the reply: of a state, the stream's command; of a followed plan, its first progress; of a
            cancelled one, the reply to its query; of a token, its key.
        sizes: bytes of request and reply.
    """

    kind: str
    key: str
    request: Any
    reply: Any
    sizes: tuple[int, int]


def page_requests() -> list[tuple[str, str, Any]]:
    """Return kind, key and record of every request on the page."""
    block = rf"<!-- ({'|'.join(_TITLES)}) (\S+) -->\n```json\n(.*?)```"
    found = re.findall(block, PAGE.read_text(), flags=re.S)
    return [(kind, key, json.loads(text)) for kind, key, text in found]


class PageClient:
    """A program that sends the requests of the page by Zenoh alone.

    Args:
        session: a Zenoh session that is connected to the server.
        codec: ``application/json`` or ``application/msgpack``.
    """

    def __init__(self, session: zenoh.Session, codec: str) -> None:
        self._session, self._codec = session, codec
        self._keys: dict[str, bytes] = {}  # of the streams with authentication
        self._plan: Any = None  # replies to the query of the followed plan

    def send(self, kind: str, key: str, payload: bytes) -> bytes:
        """Send a request, and return its reply.

        Args:
            kind: as in `Exchange`.
            key: key after ``graspforce/1/``.
            payload: the encoded request.
        """
        full = f"graspforce/1/{key}"
        if kind in ("state", "signed"):
            return self._send_state(full, payload, self._sign(key, payload) if kind == "signed" else None)
        if kind == "followed":
            return self._follow(full, payload)
        if kind == "token":
            (token,) = self._session.liveliness().get(full, timeout=TIMEOUT)
            return protocol.encode({"key": str(token.ok.key_expr)}, self._codec)
        if kind == "cancel":
            self._session.put(f"{full}/cancel", b"")
            return self._answer(key, self._plan)
        return self._answer(key, self._ask(full, payload))

    def _ask(self, full: str, payload: bytes) -> Any:
        """Send a query, and return the channel of its replies."""
        return self._session.get(full, payload=payload, encoding=self._codec, timeout=TIMEOUT)

    def _answer(self, key: str, replies: Any) -> bytes:
        """Return the payload of the only reply to a query, and keep the key of a stream."""
        (answer,) = replies
        if answer.err is not None:
            raise RuntimeError(f"{key}: {answer.err.payload.to_bytes()!r}")
        payload: bytes = answer.ok.payload.to_bytes()
        record: Any = protocol.decode(payload, self._codec)
        if key.startswith("streams/") and "key" in record:
            self._keys[key] = bytes.fromhex(record["key"])
        return payload

    def _sign(self, key: str, payload: bytes) -> bytes:
        """Return the attachment of the first state of a stream with authentication."""
        counter = (1).to_bytes(8, "little")
        return counter + hmac.digest(self._keys[key], b"S" + counter + payload, "sha256")[:16]

    def _send_state(self, full: str, payload: bytes, attachment: bytes | None) -> bytes:
        """Send a state, and return its command."""
        commands = self._session.declare_subscriber(f"{full}/command", zenoh.handlers.FifoChannel(4))
        self._session.put(f"{full}/state", payload, encoding=self._codec, attachment=attachment)
        command: bytes = commands.recv().payload.to_bytes()
        commands.undeclare()
        return command

    def _follow(self, full: str, payload: bytes) -> bytes:
        """Begin a plan, and return its first progress."""
        record: Any = protocol.decode(payload, self._codec)
        key = f"graspforce/1/plans/{record['id']}/progress"
        progress = self._session.declare_subscriber(key, zenoh.handlers.RingChannel(1))
        self._plan = self._ask(full, payload)
        first: bytes = progress.recv().payload.to_bytes()
        progress.undeclare()
        return first


def exchanges(session: zenoh.Session, codec: str) -> Iterator[Exchange]:
    """Send the requests in the order of the page, and yield them with their replies.

    Args:
        session: a Zenoh session that is connected to the server.
        codec: ``application/json`` or ``application/msgpack``.

    Raises:
        RuntimeError: the server refuses a request.
    """
    client = PageClient(session, codec)
    for kind, key, request in page_requests():
        payload = protocol.encode(request, codec)
        reply = client.send(kind, key, payload)
        yield Exchange(kind, key, request, protocol.decode(reply, codec), (len(payload), len(reply)))


def shortened(value: Any) -> Any:
    """Return a record with rounded numbers, and with the first items of long arrays."""
    if isinstance(value, dict):
        return {name: shortened(item) for name, item in value.items()}
    if isinstance(value, list):
        most = _MOST_PARTS if value and isinstance(value[0], dict | list) else _MOST_NUMBERS
        return [shortened(item) for item in (value if len(value) <= most else value[:_SHOWN])]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def compact(value: Any, indent: int = 0, used: int = 0) -> str:
    """Return JSON with records and arrays on one line where they fit.

    Args:
        value: the record.
        indent: indentation of its line.
        used: characters of the line before it.
    """
    line = json.dumps(value, ensure_ascii=False)
    if len(line) + indent + used <= _WIDTH or not value or not isinstance(value, dict | list):
        return line
    inner = " " * (indent + 1)
    if isinstance(value, dict):
        names = {name: json.dumps(name) + ": " for name in value}
        parts = [inner + names[name] + compact(item, indent + 1, len(names[name])) for name, item in value.items()]
        return "{\n" + ",\n".join(parts) + "\n" + " " * indent + "}"
    if not isinstance(value[0], dict | list):
        return line
    return "[\n" + ",\n".join(inner + compact(item, indent + 1) for item in value) + "\n" + " " * indent + "]"


def main() -> None:
    """Write the page."""
    parts = [_HEADING]
    with Server([HAND], listen="tcp/127.0.0.1:0") as server:
        config = zenoh.Config()
        config.insert_json5("mode", json.dumps("client"))
        config.insert_json5("connect/endpoints", json.dumps([server.addresses[0]]))
        config.insert_json5("scouting/multicast/enabled", "false")
        with zenoh.open(config) as session:
            for kind, key, _, reply, _ in exchanges(session, protocol.JSON):
                title = f"{_TITLES[kind]}: `{key}`"
                parts.append(f"## {title}\n\n```json\n{compact(shortened(reply))}\n```\n")
    TARGET.write_text("\n".join(parts))


if __name__ == "__main__":
    main()
