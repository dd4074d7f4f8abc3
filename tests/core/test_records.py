"""Frozen records: validated values are stored, and unchecked records equal checked ones."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, dataclass

import pytest

from graspforce.core.records import make_unchecked, set_fields, unchecked_constructor


class Checked(Exception):
    """Raised by validation that should not have run."""


@dataclass(frozen=True)
class Plain:
    low: float
    high: float = 1.0

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise Checked
        set_fields(self, low=float(self.low), high=float(self.high))


@dataclass(frozen=True, slots=True)
class Slotted:
    low: float
    high: float = 1.0

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise Checked
        set_fields(self, low=float(self.low), high=float(self.high))


KINDS = pytest.mark.parametrize("kind", [Plain, Slotted])


@KINDS
def test_set_fields_stores_validated_values_in_a_frozen_record(kind: type[Plain] | type[Slotted]) -> None:
    record = kind(0, 2)
    assert (type(record.low), type(record.high)) == (float, float)
    with pytest.raises(FrozenInstanceError):
        record.low = 1.0  # type: ignore[misc]


@KINDS
def test_an_unchecked_record_equals_the_checked_one(kind: type[Plain] | type[Slotted]) -> None:
    record = make_unchecked(kind, low=0.0, high=2.0)
    assert record == kind(0.0, 2.0)
    assert type(record) is kind
    with pytest.raises(FrozenInstanceError):
        record.low = 1.0  # type: ignore[misc]


@KINDS
def test_make_unchecked_skips_validation(kind: type[Plain] | type[Slotted]) -> None:
    with pytest.raises(Checked):
        kind(3.0, 2.0)
    assert make_unchecked(kind, low=3.0, high=2.0).low == 3.0


def test_an_unknown_field_of_a_slotted_record_is_an_error() -> None:
    with pytest.raises(AttributeError, match="middle"):
        make_unchecked(Slotted, low=0.0, high=1.0, middle=0.5)
    with pytest.raises(AttributeError, match="middle"):
        set_fields(Slotted(0.0), middle=0.5)


def test_an_unchecked_constructor_takes_the_fields_in_their_order() -> None:
    make = unchecked_constructor(Slotted)
    assert make(0.0, 2.0) == Slotted(0.0, 2.0)
    assert make(3.0, 2.0) == make_unchecked(Slotted, low=3.0, high=2.0)
    for values in ((), (1.0,), (1.0, 2.0, 3.0)):
        with pytest.raises(TypeError, match="positional argument"):
            make(*values)
