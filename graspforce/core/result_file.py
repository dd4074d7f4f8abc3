"""Files of results that grow line by line: JSON, written by one process at a time, continued after an interruption."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Mapping
from pathlib import Path

from graspforce.core import fields, json_text
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord


class ResultFile:
    """A file of results: a line of JSON with its conditions, then one for each result.

    The file is locked until `close`, or until the process ends. A partial last line, of a process that was killed, is removed.

    Args:
        path: the file; it is created if it is missing, otherwise it is continued.
        schema: name of the format, such as "graspforce/campaign/1".
        conditions: facts that distinguish the results, such as duration and options. They must be those in the file.

    Attributes:
        path: the file.
        conditions: first line of the file, with the schema.
        records: the results in the file, as plain records.

    Raises:
        InvalidInput: another process writes the file, its conditions differ, or it is no such file.
    """

    def __init__(self, path: Path, schema: str, conditions: Mapping[str, object]) -> None:
        self.path = path
        self.conditions: JsonRecord = json.loads(json.dumps({"schema": schema, **conditions}))
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.records = self._load(schema, self.conditions)
        except BlockingIOError:
            self._file.close()
            raise InvalidInput("results", str(path), "a file that no other process is writing") from None
        except BaseException:
            self._file.close()
            raise

    def _load(self, schema: str, header: JsonRecord) -> list[object]:
        """Return the results in the file; write the header into a new file."""
        if self.path.stat().st_size == 0:
            self._write(header)
            return []
        found, records = read_results(self.path, schema)
        different = sorted(name for name in {*header, *found} if header.get(name) != found.get(name))
        if different:
            allowed = f"a file with the same conditions, or a new file; it differs in {', '.join(different)}"
            raise InvalidInput("results", str(self.path), allowed)
        self._file.truncate(self.path.read_bytes().rfind(b"\n") + 1)
        return records

    def append(self, record: JsonRecord) -> None:
        """Add a result to the file.

        Args:
            record: the result, of JSON's types.
        """
        self._write(record)
        self.records.append(record)

    def _write(self, record: JsonRecord) -> None:
        """Write one line."""
        self._file.write(json.dumps(record) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file, and let other processes write it."""
        self._file.close()

    def __enter__(self) -> ResultFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_results(path: Path, schema: str) -> tuple[JsonRecord, list[object]]:
    """Return the conditions and the results of a file; a partial last line is skipped.

    Args:
        path: the file.
        schema: name of its format.

    Raises:
        InvalidInput: no such file, or a file of another format.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")[:-1]
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInput("results", str(path), f"a file of results: {error}") from None
    records = [json_text.decode(line.encode()) for line in lines]
    conditions = fields.check_record(records[0] if records else None, "results", required=["schema"], optional=None)
    fields.check_choice(conditions["schema"], "results.schema", [schema])
    return conditions, records[1:]
