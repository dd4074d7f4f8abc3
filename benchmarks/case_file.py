"""Finished cases of a long benchmark in a file, so that it can be measured in slices.

The file has a JSON record in each line. The first one names the sources that were measured; cases of other sources are not
mixed with them. Several processes may append to the same file.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
_SOURCES = ("graspforce/estimation", "graspforce/contact", "graspforce/control", "graspforce/csrc", "graspforce/simulation")

Record = dict[str, Any]


class CaseFile:
    """File of finished cases.

    Args:
        path: the file; it is made if it does not exist.
        benchmark: files of the benchmark itself.

    Raises:
        SystemExit: the file holds cases of other sources.
    """

    def __init__(self, path: Path, benchmark: Iterable[str]) -> None:
        self._path, key = path, sources_key(benchmark)
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or not path.read_text():
            self._append({"sources": key})
        found = json.loads(path.read_text().splitlines()[0])
        if found != {"sources": key}:
            raise SystemExit(f"{path} holds cases of other sources: delete it, or name another file with --cases")

    def records(self) -> list[Record]:
        """Return the finished cases."""
        return [json.loads(line) for line in self._path.read_text().splitlines()[1:]]

    def add(self, record: Record) -> None:
        """Append a finished case."""
        self._append(record)

    def _append(self, record: Record) -> None:
        with self._path.open("a") as file:
            file.write(json.dumps(record) + "\n")


def sources_key(benchmark: Iterable[str]) -> str:
    """Return a hash of the sources that decide the results.

    Args:
        benchmark: names of files in `benchmarks`.
    """
    files = [path for folder in _SOURCES for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".c", ".h", ".inc")]
    files += [ROOT / "benchmarks" / name for name in benchmark]
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class Slice:
    """The part of the cases that one call measures: those of one part in turn, until its time is over.

    Args:
        part: "k/n" for part k of n, from 0.
        seconds: time after which no further case is begun; None for no limit.
    """

    def __init__(self, part: str, seconds: float | None) -> None:
        index, _, count = part.partition("/")
        self._index, self._count = int(index), int(count)
        self._end = None if seconds is None else time.monotonic() + seconds

    def holds(self, case: int) -> bool:
        """Return whether a case belongs to this part."""
        return case % self._count == self._index

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return self._end is not None and time.monotonic() > self._end
