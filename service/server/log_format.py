"""Log lines of a server, as text or as JSON, on standard error."""

from __future__ import annotations

import datetime
import json
import logging
import sys
from typing import TYPE_CHECKING, TextIO

from graspforce.core import fields
from graspforce.core.printable import escape_controls

if TYPE_CHECKING:
    _Handler = logging.StreamHandler[TextIO]
else:
    _Handler = logging.StreamHandler

LEVELS = ("debug", "info", "warning", "error")
FORMATS = ("text", "json")
REQUEST_FIELDS = ("client", "sequence")  # attributes of records about a request


class LogFormatter(logging.Formatter):
    """One line for each record: time (UTC), level and message, and `client` and `sequence` of a request.

    Control characters are escaped.

    Args:
        style: "text", or "json" for one JSON object a line with `time`, `level`, `logger`, `message` and maybe `client`,
            `sequence` and `exception`.
    """

    def __init__(self, style: str) -> None:
        super().__init__()
        self.style = fields.check_choice(style, "log_format", FORMATS)

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record; in text, its traceback follows.

        Args:
            record: the record.
        """
        time = datetime.datetime.fromtimestamp(record.created, datetime.timezone.utc).isoformat(timespec="milliseconds")
        message, level = escape_controls(record.getMessage()), record.levelname.lower()
        trace = "" if not record.exc_info else self.formatException(record.exc_info)
        request = {name: value for name in REQUEST_FIELDS if (value := getattr(record, name, None)) not in (None, "")}
        lines = [escape_controls(line) for line in trace.split("\n")] if trace else []
        if self.style == "text":
            about = ", ".join(f"{name} {escape_controls(str(value))}" for name, value in request.items())
            return "\n".join([f"{time} {level} {message}{f' ({about})' if about else ''}", *lines])
        values = {"time": time, "level": level, "logger": record.name, "message": message, **request}
        return json.dumps({**values, "exception": lines} if lines else values, ensure_ascii=False)


def configure_logging(level: str, style: str) -> None:
    """Write the log of graspforce in this process to standard error.

    Args:
        level: lowest level that is written, one of `LEVELS`.
        style: "text" or "json".

    Raises:
        InvalidInput: another level or style.
    """
    checked = fields.check_choice(level, "log_level", LEVELS)
    handler = _StandardError()
    handler.setFormatter(LogFormatter(style))
    logger = logging.getLogger("graspforce")
    logger.handlers = [handler]
    logger.setLevel(checked.upper())


def present_logging() -> tuple[str, str] | None:
    """Return the level and the style that `configure_logging` has set, for other processes; None if it was not called."""
    logger = logging.getLogger("graspforce")
    styles = [each.formatter.style for each in logger.handlers if isinstance(each.formatter, LogFormatter)]
    return (logging.getLevelName(logger.level).lower(), styles[0]) if styles else None


class _StandardError(_Handler):
    """A handler that writes to the present `sys.stderr`."""

    def __init__(self) -> None:
        logging.Handler.__init__(self)

    @property
    def stream(self) -> TextIO:  # type: ignore[override]
        """The present standard error."""
        return sys.stderr
