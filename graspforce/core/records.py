"""Fields of frozen records: set them in `__post_init__`, or make a record without validation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")

_set = object.__setattr__  # a frozen dataclass blocks only its own `__setattr__`


def set_fields(record: object, /, **values: object) -> None:
    """Set fields of a frozen dataclass. Call it from `__post_init__` to store validated values.

    Args:
        record: the instance under construction.
        **values: one value a field, by name.

    Raises:
        AttributeError: a record with slots has no such field.
    """
    for name, value in values.items():
        _set(record, name, value)


def make_unchecked(cls: type[T], /, **values: object) -> T:
    """Return an instance of a frozen dataclass without running `__init__` or `__post_init__`.

    Use it where the values were validated before, such as for a copy with one new field. Defaults are not filled in: pass
    every field.

    Args:
        cls: the dataclass.
        **values: one value a field, by name.

    Returns:
        The instance.

    Raises:
        AttributeError: a record with slots has no such field.
    """
    record = object.__new__(cls)
    if hasattr(record, "__dict__"):
        vars(record).update(values)  # faster than one attribute after another
        return record
    for name, value in values.items():
        _set(record, name, value)
    return record


def copy_unchecked(record: T, /, **changes: object) -> T:
    """Return a copy of a frozen dataclass without slots, with changed fields, without validation.

    Cached properties are copied too: delete those that depend on a changed field.

    Args:
        record: the instance to copy.
        **changes: one value a changed field, by name.
    """
    copy = object.__new__(type(record))
    values = vars(copy)
    values.update(vars(record))
    values.update(changes)
    return copy


def unchecked_constructor(cls: type[T]) -> Callable[..., T]:
    """Return a function that makes instances of a slotted dataclass without validation, from positional values.

    It takes the fields in the order of their declaration, without defaults, and is faster than `make_unchecked`: use it on hot
    paths.

    Args:
        cls: a dataclass with ``slots=True``.

    Returns:
        The function; it raises TypeError unless it gets one value for each field.
    """
    names: tuple[str, ...] = cls.__dict__["__slots__"]
    setters = {f"_set_{name}": getattr(cls, name).__set__ for name in names}
    # As `dataclass` and `namedtuple` do it: a loop over the fields takes more than twice the time.
    lines = [f"def make({', '.join(names)}):", " _record = _new(_cls)", *(f" _set_{name}(_record, {name})" for name in names)]
    scope: dict[str, Any] = {"_new": object.__new__, "_cls": cls, **setters}
    exec("\n".join([*lines, " return _record"]), scope)
    make: Callable[..., T] = scope["make"]
    return make
