"""Read recordings of servers."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from graspforce.core.errors import InvalidInput
from graspforce.core.foxglove_messages import NANOSECONDS
from graspforce.core.optional_libraries import optional_imports
from graspforce.service.recording.exchange import DROPPED, END, FORMAT, HEADER, REQUEST, STATE, Exchange, RecordedHand


@dataclass(frozen=True, slots=True)
class ServerRecording:
    """A recording: its header, and its exchanges on demand.

    Attributes:
        path: the file.
        version: version of graspforce that wrote it.
        machine: processor, system and version of NumPy of the server.
        clock: time since 1970 at zero of the server's clock, ns.
        hands: the served hands.
        limits: the limits of the server by name.
        dropped: number of dropped exchanges by stream; empty if the end is missing.
        is_complete: whether the recording has its end.
    """

    path: Path
    version: str
    machine: str
    clock: int
    hands: tuple[RecordedHand, ...]
    limits: dict[str, int | float]
    dropped: dict[str, int] = field(default_factory=dict)
    is_complete: bool = True

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> ServerRecording:
        """Read the header of a recording.

        Args:
            path: the file.

        Raises:
            InvalidInput: no recording of a server.
            MissingLibrary: the library mcap is not installed.
            OSError: the file cannot be read.
        """
        with optional_imports():
            import mcap.reader  # noqa: F401
        found, is_complete = _read_metadata(Path(path))
        header, end = found.get(HEADER), found.get(END)
        if header is None or header.get("format") != FORMAT:
            raise InvalidInput("FILE", str(path), "a recording that `graspforce serve --record` wrote")
        return cls(
            Path(path),
            header["version"],
            header["machine"],
            int(header["clock"]),
            msgspec.convert(json.loads(header["hands"]), tuple[RecordedHand, ...]),
            json.loads(header["limits"]),
            json.loads(end["dropped"]) if end is not None and is_complete else {},
            end is not None and is_complete,
        )

    def exchanges(self) -> Iterator[Exchange]:
        """Yield the exchanges in the order in which they were recorded.

        The last ones are missing if the file is not complete.
        """
        from mcap.exceptions import McapError
        from mcap.reader import NonSeekingReader

        with self.path.open("rb") as file:
            first: Exchange | None = None
            dropped: dict[str, int] = {}
            messages = NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)
            try:
                for _, channel, message in messages:
                    part, about = channel.metadata.get("part"), channel.metadata
                    if channel.topic == DROPPED:
                        gap = json.loads(message.data)
                        dropped[gap["source"]] = gap["count"]
                    elif part == "request":
                        first = self._begin(about, message)
                        first.dropped = dropped.pop(first.source, 0)
                    elif part == "reply" and first is not None:
                        first.sent, first.reply = self._time(message.log_time), message.data
                        first.ok, first.reply_encoding = about["ok"] == "1", about["encoding"]
                        yield first
                        first = None
            except McapError:
                if self.is_complete:
                    raise

    def _begin(self, about: dict[str, str], message: Any) -> Exchange:
        """Return the exchange of a request or state, without its reply."""
        kind = STATE if about["kind"] == STATE else REQUEST
        received = self._time(message.log_time)
        return Exchange(kind, about["key"], received, received, message.data, about.get("encoding"), True, b"", "")

    def _time(self, nanoseconds: int) -> float:
        """Return a time on the server's clock, s."""
        return (nanoseconds - self.clock) / NANOSECONDS


def _read_metadata(path: Path) -> tuple[dict[str, dict[str, str]], bool]:
    """Return the metadata of a file by name, and whether the file has its end.

    Raises:
        OSError: the file cannot be read.
    """
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader, SeekingReader

    with path.open("rb") as file:
        for kind in (SeekingReader, NonSeekingReader):
            found: dict[str, dict[str, str]] = {}
            try:
                file.seek(0)
                for each in kind(file).iter_metadata():
                    found[each.name] = each.metadata
                return found, True
            except (McapError, OSError):  # cut off: the first reader seeks the end, the second one reads up to it
                continue
    return found, False
