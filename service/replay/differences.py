"""Differences between recorded and replayed replies, to the bit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from graspforce.core.json_text import JsonRecord

TIMES = ("server_seconds", "seconds", "late", "effort")  # fields that state how long the work took
_FLOAT_BYTES = 8
_MAX_CHARACTERS = 60  # of a value in a text


@dataclass(frozen=True, slots=True)
class Difference:
    """A value that differs.

    Attributes:
        path: its field, such as ``forces[0][2]``.
        recorded: text of the recorded value.
        replayed: text of the value now.
        size: largest difference of its numbers, over the larger magnitude; infinite if they are not comparable.
        is_missing: whether exactly one of the values is null.
    """

    path: str
    recorded: str
    replayed: str
    size: float
    is_missing: bool = False

    def to_dict(self) -> JsonRecord:
        """Return a plain record."""
        size = self.size if math.isfinite(self.size) else None
        return {"field": self.path, "recorded": self.recorded, "replayed": self.replayed, "relative_difference": size}

    def __str__(self) -> str:
        size = f", relative difference {self.size:.1e}" if math.isfinite(self.size) else ""
        return f"{self.path or 'the reply'}: recorded {self.recorded}, now {self.replayed}{size}"


def find_differences(recorded: object, replayed: object, path: str = "") -> Iterator[Difference]:
    """Yield the differences of two plain values. Fields of `TIMES` are ignored.

    Args:
        recorded: the recorded value.
        replayed: the value now.
        path: path of both.
    """
    if isinstance(recorded, Mapping) and isinstance(replayed, Mapping):
        for name in dict.fromkeys((*recorded, *replayed)):
            if name not in TIMES:
                yield from find_differences(recorded.get(name), replayed.get(name), f"{path}.{name}" if path else str(name))
    elif isinstance(recorded, list | tuple) and isinstance(replayed, list | tuple) and len(recorded) == len(replayed):
        for i, (before, now) in enumerate(zip(recorded, replayed, strict=True)):
            yield from find_differences(before, now, f"{path}[{i}]")
    elif not _is_same(recorded, replayed):
        is_missing = (recorded is None) != (replayed is None)
        yield Difference(path, _text(recorded), _text(replayed), _relative(recorded, replayed), is_missing)


def _is_same(recorded: object, replayed: object) -> bool:
    """Return whether two values are equal; NaN equals NaN."""
    if isinstance(recorded, float) and isinstance(replayed, float) and math.isnan(recorded):
        return math.isnan(replayed)
    return type(recorded) is type(replayed) and recorded == replayed


def _relative(recorded: object, replayed: object) -> float:
    """Return the relative difference of two numbers or binary arrays; infinite for others."""
    before, now = _numbers(recorded), _numbers(replayed)
    if before is None or now is None or before.shape != now.shape:
        return math.inf
    scale = float(max(np.abs(before).max(initial=0.0), np.abs(now).max(initial=0.0)))
    return float(np.abs(before - now).max(initial=0.0)) / scale if scale > 0.0 else 0.0


def _numbers(value: object) -> np.ndarray | None:
    """Return the numbers of a value; None if it has none."""
    if isinstance(value, bytes) and len(value) % _FLOAT_BYTES == 0:
        return np.frombuffer(value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return np.array([float(value)])
    return None


def _text(value: object) -> str:
    """Return a short text of a value."""
    text = str(np.frombuffer(value).tolist()) if isinstance(value, bytes) and len(value) % _FLOAT_BYTES == 0 else repr(value)
    return text if len(text) <= _MAX_CHARACTERS else text[: _MAX_CHARACTERS - 1] + "…"
