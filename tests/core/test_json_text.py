"""JSON text: plain values come out, and invalid text raises InvalidInput with its first characters."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import pytest

from graspforce import InvalidInput
from graspforce.core.json_text import decode, errors_of_file, read


def test_decodes_plain_values() -> None:
    assert decode('{"a": [1, 2.5, null, true, "µ"]}'.encode()) == {"a": [1, 2.5, None, True, "µ"]}


def test_reads_nan_and_infinity_which_many_programs_write() -> None:
    nan, infinity = decode(b"[NaN, -Infinity]")
    assert math.isnan(nan)
    assert infinity == -math.inf


@pytest.mark.parametrize("text", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b"{'a': 1}", b"x" * 1000])
def test_invalid_text_is_an_error_that_shows_its_beginning(text: bytes) -> None:
    with pytest.raises(InvalidInput, match=r"^input = .*: must be JSON \(") as caught:
        decode(text)
    assert len(str(caught.value.value)) <= 40


@pytest.mark.parametrize(("text", "line", "column"), [(b"[1,\n 2,\n  x]", 3, 3), ('{"µµ": y}'.encode(), 1, 8)])
def test_error_in_a_file_has_name_line_and_column(tmp_path: Path, text: bytes, line: int, column: int) -> None:
    path = tmp_path / "problem.json"
    path.write_bytes(text)
    with pytest.raises(InvalidInput) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: input = ")
    assert f"line {line}, column {column}" in str(caught.value)


def test_innermost_file_is_named_and_the_name_survives_pickling() -> None:
    with (
        pytest.raises(InvalidInput, match=r"^inner\.json: friction = -1: must be at least 0$") as caught,
        errors_of_file("outer.json"),
        errors_of_file("inner.json"),
    ):
        raise InvalidInput("friction", -1, "at least 0")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
