"""Results as JSON in place of tables, with the option ``--json`` of a command."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from graspforce.cli.console import report_console


class JsonConsole(Console):
    """A console that prints no tables, texts and progress. `put_result` prints a record instead."""

    def __init__(self) -> None:
        super().__init__(quiet=True)


def result_console(as_json: bool) -> Console:
    """Return the console for the results of a command.

    Args:
        as_json: whether the result is a JSON record; then nothing else is printed on standard output.
    """
    if as_json:
        return JsonConsole()
    console: Console = report_console()
    return console


def put_result(console: Console, record: Mapping[str, object]) -> None:
    """Print the result of a command as JSON, if its console is a `JsonConsole`.

    Args:
        console: the console of the command.
        record: the result. Data classes, arrays, paths and enumerations become plain values; NaN and infinity become null.
    """
    if isinstance(console, JsonConsole):
        print_json(record)


def print_json(record: Mapping[str, object]) -> None:
    """Print a result as JSON.

    Args:
        record: as in `put_result`.
    """
    print(json.dumps(_plain(record), indent=2, ensure_ascii=False))


def _plain(value: Any) -> Any:
    """Return a value that JSON has."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    return value
