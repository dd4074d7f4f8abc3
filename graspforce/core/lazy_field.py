"""Fields that are computed at their first access, without the lock of `functools.cached_property` in Python 3.10 and 3.11.

The lock takes longer than most fields of a control step. Without it, two threads that read a field at the same time may both
compute it; both get an equal value.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

V = TypeVar("V")


class LazyField(Generic[V]):
    """Field of a class with a `__dict__`, computed at its first access and then stored.

    Args:
        compute: function of the instance that returns the value.
    """

    def __init__(self, compute: Callable[[Any], V]) -> None:
        self._compute, self.__doc__ = compute, compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        """Return the value; the field itself if it is read from the class."""
        if instance is None:
            return self
        value = instance.__dict__[self._name] = self._compute(instance)
        return value
