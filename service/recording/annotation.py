"""Copies of recordings with further messages, such as the labels of motions.

A copy has all messages, schemas and metadata of the recording with their bytes and times, and topics of JSON messages. It can
be replayed as the recording itself.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.optional_libraries import optional_imports
from graspforce.core.whole_file import replace_file


class Annotation(NamedTuple):
    """A message that is added.

    Attributes:
        time: since 1970, or of the clock of the recording, ns.
        record: the message.
    """

    time: int
    record: JsonRecord


def annotate(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    annotations: Mapping[str, Iterable[Annotation]],
    schema: JsonRecord,
) -> None:
    """Write a copy of a recording with further topics. Topics of the same names in the recording are replaced.

    Args:
        source: the recording, a complete MCAP file.
        target: the copy, another file.
        annotations: messages by topic.
        schema: JSON Schema of the messages; its title is its name.

    Raises:
        InvalidInput: the recording is not complete, or both files are the same.
        MissingLibrary: the library mcap is not installed.
        OSError: a file cannot be read or written.
    """
    with optional_imports():
        from mcap.exceptions import McapError
        from mcap.writer import CompressionType, Writer
    if Path(target).exists() and Path(source).samefile(target):
        raise InvalidInput("target", str(target), "another file than the recording")
    with Path(source).open("rb") as file, replace_file(Path(target)) as temporary, temporary.open("wb") as out:
        writer = Writer(out, compression=CompressionType.ZSTD)
        try:
            _copy(file, writer, set(annotations))
        except McapError as error:
            raise InvalidInput("source", str(source), f"a complete MCAP file: {error}") from None
        text = json.dumps(schema).encode()
        number = writer.register_schema(str(schema["title"]), "jsonschema", text)
        for topic, messages in annotations.items():
            channel = writer.register_channel(topic, "json", number)
            for i, each in enumerate(messages):
                writer.add_message(channel, each.time, json.dumps(each.record).encode(), each.time, i)
        writer.finish()  # type: ignore[no-untyped-call]


def _copy(file: Any, writer: Any, left_out: set[str]) -> None:
    """Copy all messages of other topics, and the metadata."""
    from mcap.reader import SeekingReader

    reader = SeekingReader(file, validate_crcs=True)
    header = reader.get_header()
    writer.start(profile=header.profile, library=header.library)
    metadata = list(reader.iter_metadata())
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for each in metadata[:1]:  # the header of a server's recording comes first
        writer.add_metadata(each.name, each.metadata)
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if channel.topic in left_out:
            continue
        if channel.id not in channels:
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            number = 0 if schema is None else schemas[schema.id]
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number, channel.metadata)
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
    for each in metadata[1:]:
        writer.add_metadata(each.name, each.metadata)
