"""Control characters of a client reach neither error records nor logs; those of a server do not reach the client's messages."""

from __future__ import annotations

import logging

from hypothesis import given
from hypothesis import strategies as st
from support.request_handler import HAND, HANDLER

from benchmarks.fuzz_service import wire_examples
from graspforce.core.printable import has_controls
from graspforce.service.wire import protocol
from graspforce.service.wire.status_records import ServerStatus

EVIL = "\x1b]0;owned\x07\n\u202e"
NAMES = st.text(min_size=1, max_size=8).map(lambda text: text + EVIL)


@given(name=NAMES)
def test_error_records_have_no_control_characters(name):
    [hold] = [record["hold"] for _, key, record in wire_examples() if key.endswith("/control")]
    requests = [
        ("solve", {name: 1}),
        ("solve", {"schema": name}),
        (f"hands/{HAND.name}/inverse", {"tips": {name: [0, 0, 0]}}),
        (f"hands/{HAND.name}/distribute", {"posture": [0] * HAND.n, name: 1}),
        (f"hands/{name}", {}),
        (f"streams/{name}", {"hand": HAND.name, "hold": hold}),
        (name, {}),
    ]
    for key, record in requests:
        reply = HANDLER.answer(key, protocol.encode(record, protocol.JSON), protocol.JSON)
        error = protocol.decode(reply.payload, reply.encoding)
        assert not reply.ok
        assert not has_controls(error["message"] + (error["field"] or "")), error


def test_message_of_a_server_is_escaped():
    for code in ("overloaded", "invalid"):
        error = protocol.read_error({"error": code, "message": EVIL, "field": EVIL})
        assert not has_controls(str(error))
        assert not has_controls(getattr(error, "field", None) or "")


def test_status_table_is_escaped():
    latency = {"count": 0, "p50": None, "p99": None, "max": None}
    status = ServerStatus(EVIL, EVIL, 1.0, (EVIL,), 0, 0, 0, {EVIL: {"ok": 1}}, latency)
    assert not any(has_controls(line) for line in str(status).splitlines())


def test_log_lines_of_failed_requests_are_escaped(monkeypatch, caplog):
    def fail(*arguments):
        raise RuntimeError("a fault")

    monkeypatch.setattr(HANDLER, "_find_task", fail)
    with caplog.at_level(logging.ERROR):
        HANDLER.answer("solve" + EVIL, b"{}")
    assert caplog.records
    assert not has_controls(caplog.records[-1].getMessage())
