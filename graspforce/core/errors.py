"""Every error that graspforce raises.

GraspForceError
├── InvalidInput (ValueError)     a value that is not allowed: names field, value and what is allowed
│   └── UnknownName               a name that is not known: lists the names that are
├── ModelError                    a hand model that cannot be used as it stands
├── BackendError                  a solver that is not installed, or cannot take this problem
└── ServiceError                  what can go wrong between a client and the service
    ├── NoServer                  nobody answers: no server is alive
    ├── ServiceTimeout            a server lives, its answer did not come in time
    ├── RequestRefused                   the server would not do the work: overloaded, too late, too large, not permitted
    └── ErrorReply                the server answered with an error record
"""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

_MAX_VALUE_LENGTH = 80  # characters of a value that an error shows


class GraspForceError(Exception):
    """The root: catch this to catch everything that graspforce raises on purpose."""


class InvalidInput(GraspForceError, ValueError):
    """A value that is not allowed.

    Args:
        field: path of the value from the outermost record, such as ``contacts[2].friction``.
        value: the value as the caller gave it.
        allowed: what would have been allowed, as the end of the sentence "must be …".
    """

    code = "invalid"

    def __init__(self, field: str, value: Any, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(field, value, allowed)

    def __str__(self) -> str:
        return f"{self.field or 'input'} = {format_value(self.value)}: must be {self.allowed}"

    def with_prefix(self, prefix: str) -> InvalidInput:
        """The same error, its field one record further out: ``friction`` inside ``contacts[2]``."""
        separator = "" if not self.field or self.field.startswith("[") else "."
        return type(self)(f"{prefix}{separator}{self.field}", self.value, self.allowed)


class UnknownName(InvalidInput):
    """A name that nothing here carries; ``allowed`` lists the names that exist."""

    code = "unknown"


class ModelError(GraspForceError):
    """A hand model that cannot be read, or that contradicts its description."""


class BackendError(GraspForceError):
    """A solver that is not installed, or that cannot take the problem it was given."""


class ServiceError(GraspForceError):
    """What can go wrong between a client and the service."""


class NoServer(ServiceError):
    """No server is alive under the key that was asked."""


class ServiceTimeout(ServiceError):
    """A server is there, but no answer came within the client's time limit."""


class RequestRefused(ServiceError):
    """The work was not done, and may be asked for again: overloaded, past its deadline, too large, or not permitted."""

    def __init__(self, code: str, message: str) -> None:
        self.code, self.message = code, message
        super().__init__(code, message)

    def __str__(self) -> str:
        return self.message


class ErrorReply(ServiceError):
    """The server's own error record: ``code`` is ``invalid``, ``unknown`` or ``internal``."""

    def __init__(self, code: str, message: str, field: str | None) -> None:
        self.code, self.message, self.field = code, message, field
        super().__init__(code, message, field)

    def __str__(self) -> str:
        return self.message


def format_value(value: Any) -> str:
    """A value as an error shows it: plain numbers and lists, cut to a readable length without walking through all of it."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist() if value.size <= _MAX_ITEMS else np.ravel(value)[: _MAX_ITEMS + 1].tolist()
    elif isinstance(value, tuple):
        value = list(value)
    text = _value_repr.repr(value)
    return text if len(text) <= _MAX_VALUE_LENGTH else text[: _MAX_VALUE_LENGTH - 1] + "…"


_MAX_ITEMS = 20  # of a list that an error shows
_value_repr = reprlib.Repr()
_value_repr.maxlist = _value_repr.maxdict = _value_repr.maxset = _MAX_ITEMS
_value_repr.maxlevel = 4
_value_repr.maxstring = _value_repr.maxother = _value_repr.maxlong = _MAX_VALUE_LENGTH
