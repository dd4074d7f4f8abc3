"""A Zenoh queryable that refuses every request at once: what a flood costs without a service."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator

import zenoh

from benchmarks.service_load import LOCAL, TIMEOUT, python_process, read_line
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import make_error_reply
from graspforce.service.zenoh_session import build_configuration


@contextlib.contextmanager
def start_bare_refusals() -> Iterator[str]:
    """Start the process, and return its endpoint."""
    with python_process("benchmarks.bare_refusals") as child:
        yield read_line(child)


def main() -> None:
    """Refuse all requests until standard input closes."""
    sys.setswitchinterval(1e-4)  # as `graspforce serve` does
    refusal = make_error_reply(protocol.MSGPACK, "overloaded", "this server refuses every request", None, None, 0.1)

    def refuse(query: zenoh.Query) -> None:
        query.reply_err(refusal.payload, encoding=protocol.MSGPACK)

    settings = {"listen/endpoints": [LOCAL], "adminspace/enabled": True}
    with zenoh.open(build_configuration(None, {"mode": "peer"}, settings)) as session:
        queryable = session.declare_queryable(f"{protocol.PREFIX}/**", refuse)
        [reply] = session.get(f"@/{session.zid()}/*", timeout=TIMEOUT)
        print(json.loads(reply.ok.payload.to_bytes())["locators"][0], flush=True)
        sys.stdin.read()
        queryable.undeclare()


if __name__ == "__main__":
    main()
