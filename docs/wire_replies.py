"""Write docs/wire_replies.md: send every request of docs/wire.md to a server, and record its reply.

    python docs/wire_replies.py

Any program can do the same: the requests are the JSON blocks that follow a comment with their key.
"""

from __future__ import annotations

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
        kind: "query", or "state" for a message to a stream.
        key: key after ``graspforce/1/``.
        request: the record of the page.
        reply: the record of the reply: for a state, of the stream's command.
    """

    kind: str
    key: str
    request: Any
    reply: Any


def page_requests() -> list[tuple[str, str, Any]]:
    """Return kind, key and record of every request on the page."""
    found = re.findall(r"<!-- (query|state) (\S+) -->\n```json\n(.*?)```", PAGE.read_text(), flags=re.S)
    return [(kind, key, json.loads(text)) for kind, key, text in found]


def exchanges(session: zenoh.Session, codec: str) -> Iterator[Exchange]:
    """Send the requests in the order of the page, and yield them with their replies.

    Args:
        session: a Zenoh session that is connected to the server.
        codec: ``application/json`` or ``application/msgpack``.

    Raises:
        RuntimeError: the server refuses a request.
    """
    for kind, key, request in page_requests():
        payload = protocol.encode(request, codec)
        if kind == "state":
            commands = session.declare_subscriber(f"graspforce/1/{key}/command", zenoh.handlers.FifoChannel(4))
            session.put(f"graspforce/1/{key}/state", payload, encoding=codec)
            content = commands.recv().payload
            commands.undeclare()
        else:
            (answer,) = session.get(f"graspforce/1/{key}", payload=payload, encoding=codec, timeout=TIMEOUT)
            if answer.err is not None:
                raise RuntimeError(f"{key}: {answer.err.payload.to_bytes()!r}")
            content = answer.ok.payload
        yield Exchange(kind, key, request, protocol.decode(content.to_bytes(), codec))


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
            for kind, key, _, reply in exchanges(session, protocol.JSON):
                title = f"Command of a state: `{key}`" if kind == "state" else f"Query: `{key}`"
                parts.append(f"## {title}\n\n```json\n{compact(shortened(reply))}\n```\n")
    TARGET.write_text("\n".join(parts))


if __name__ == "__main__":
    main()
