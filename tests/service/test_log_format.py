"""Log lines: one record a line, in JSON or text, without control characters."""

from __future__ import annotations

import io
import json
import logging

import pytest

from graspforce.core.errors import InvalidInput
from graspforce.core.printable import has_controls
from graspforce.service import RequestHandler
from graspforce.service.server.log_format import LogFormatter, configure_logging, present_logging
from graspforce.service.server.server_load import client_label

EVIL = "a\x1b[2Jb\nforged line"


def logged(style, call):
    """Return the lines that a logger writes in a style."""
    stream, logger = io.StringIO(), logging.Logger("graspforce.test")
    handler = logging.StreamHandler(stream)
    handler.setFormatter(LogFormatter(style))
    logger.addHandler(handler)
    call(logger)
    return stream.getvalue().splitlines()


def fail(logger):
    try:
        raise ValueError(EVIL)
    except ValueError:
        logger.exception("a request to %s failed", EVIL)


def test_json_has_one_object_a_line():
    [line] = logged("json", lambda logger: logger.warning("%s is late", EVIL))
    record = json.loads(line)
    assert (record["level"], record["logger"]) == ("warning", "graspforce.test")
    assert record["message"] == r"a\x1b[2Jb\x0aforged line is late"
    assert record["time"].endswith("+00:00")
    [line] = logged("json", fail)
    assert "ValueError" in json.loads(line)["exception"][-2] + json.loads(line)["exception"][-1]


def test_text_has_time_level_and_message():
    [line] = logged("text", lambda logger: logger.info("%s connects", EVIL))
    time, level, message = line.split(" ", 2)
    assert (level, message) == ("info", r"a\x1b[2Jb\x0aforged line connects")
    assert time[4] == time[7] == "-"


@pytest.mark.parametrize("style", ["text", "json"])
def test_no_line_has_control_characters(style):
    assert not any(has_controls(line) for line in logged(style, fail))


def test_level_and_format_are_checked():
    for level, style, field in [("loud", "text", "log_level"), ("info", "xml", "log_format")]:
        with pytest.raises(InvalidInput) as caught:
            configure_logging(level, style)
        assert caught.value.field == field


def test_other_processes_get_level_and_format(monkeypatch):
    logger = logging.getLogger("graspforce")
    monkeypatch.setattr(logger, "handlers", [])
    monkeypatch.setattr(logger, "level", logging.NOTSET)
    assert present_logging() is None
    configure_logging("error", "json")
    assert present_logging() == ("error", "json")


def test_lines_about_a_request_name_its_client_and_sequence():
    def refuse(logger):
        logger.error("a request to solve failed", extra={"client": "3f2a", "sequence": 7})
        logger.error("a request to solve failed", extra={"client": "", "sequence": None})

    first, second = logged("text", refuse)
    assert first.endswith("a request to solve failed (client 3f2a, sequence 7)")
    assert second.endswith("a request to solve failed")
    first, second = map(json.loads, logged("json", refuse))
    assert (first["client"], first["sequence"]) == ("3f2a", 7)
    assert not {"client", "sequence"} & set(second)


def test_handler_logs_client_and_sequence_of_each_request(caplog):
    handler = RequestHandler([])
    with caplog.at_level(logging.DEBUG, logger="graspforce.service"):
        handler.answer("status", b'{"sequence": 7}', client=b"session")
    [record] = caplog.records
    assert record.getMessage().startswith("status: ok in ")
    assert (record.sequence, record.client) == (7, client_label(b"session"))
