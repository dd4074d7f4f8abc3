"""The program of the process that writes a recording. It receives exchanges through its standard input, until that is closed.

The process finishes the file even if the server is killed.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import msgspec

from graspforce.service.recording.exchange import LENGTH_BYTES, Batch, End, Header, Message
from graspforce.service.recording.recording_writer import RecordingWriter

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


def main() -> None:
    """Write the recording whose path is the last command-line argument."""
    for name in _SIGNALS:  # a service manager signals all processes; this one ends after the last exchange
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    try:
        write_recording(sys.stdin.buffer, Path(sys.argv[-1]))
    except OSError as error:
        print(f"{sys.argv[-1]}: {error.strerror or error}", file=sys.stderr)
        sys.exit(1)


def write_recording(pipe: IO[bytes], path: Path) -> None:
    """Write messages to a file until their end.

    Args:
        pipe: the messages, each with its length before it.
        path: the file.

    Raises:
        OSError: the file cannot be written.
    """
    messages = read_messages(pipe)
    header = next(messages, None)
    if not isinstance(header, Header):
        return
    with path.open("wb") as file, RecordingWriter(file, header) as writer:
        for message in messages:
            if isinstance(message, Batch):
                for exchange in message.exchanges:
                    writer.write(exchange)
            elif isinstance(message, End):
                writer.end(message)


def read_messages(pipe: IO[bytes]) -> Iterator[Message]:
    """Yield messages until the pipe is closed. A message that is cut off is left out.

    Args:
        pipe: the pipe.
    """
    decoder = msgspec.msgpack.Decoder(Message)
    while len(length := pipe.read(LENGTH_BYTES)) == LENGTH_BYTES:
        size = int.from_bytes(length, "little")
        if len(payload := pipe.read(size)) == size:
            yield decoder.decode(payload)
