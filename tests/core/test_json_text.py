"""JSON text: plain values come out, and invalid text raises InvalidInput with its first characters."""

from __future__ import annotations

import math

import pytest

from graspforce import InvalidInput
from graspforce.core.json_text import decode


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
