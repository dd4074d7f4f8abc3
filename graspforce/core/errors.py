"""All errors that graspforce raises.

GraspForceError
├── InvalidInput (ValueError): a value that is not allowed: names the field, the value and what is allowed
│   ├── MissingField: a required field that is not given
│   ├── UnknownField: a field that the record does not have: suggests the nearest one
│   └── UnknownName: a name that does not exist: lists the known names and suggests the nearest one
├── ModelError: a hand model that cannot be read or contradicts its description
├── MissingLibrary (ImportError): an optional library that is not installed: names the extra that installs it
├── BackendError: a solver that is not installed or cannot run
│   └── UnsupportedProblem: a problem that the solver does not support
└── ServiceError: a failed exchange between client and server
    ├── NoServer: no server is alive
    │   └── ServerLost: the server ended, or the connection to it broke, before it answered
    ├── IncompatibleServer: the server's version lacks what the request needs
    ├── ServiceTimeout: a server is alive but did not reply in time
    ├── RequestRefused: the server rejected the request: overloaded, closing, past its deadline, too large or not permitted
    └── ErrorReply: the server replied with an error record
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable

import numpy as np

_MAX_VALUE_LENGTH = 80  # characters of a value in a message
_MAX_ITEMS = 20  # items of a list in a message
_MAX_NAME_LENGTH = 64  # characters of a name that is compared with the known names; the comparison is quadratic


class GraspForceError(Exception):
    """Base class of all errors that graspforce raises on purpose."""


class InvalidInput(GraspForceError, ValueError):
    """A value that is not allowed.

    Args:
        field: path of the value from the outermost record, such as ``contacts[2].friction``.
        value: the value as the caller gave it.
        allowed: the values that are allowed; it completes the sentence "must be …".

    Attributes:
        source: path of the file with the value; empty if the value is not from a file.
    """

    code = "invalid"
    source = ""

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(field, value, allowed)

    def __str__(self) -> str:
        return f"{self.source}: {self._sentence()}" if self.source else self._sentence()

    def _sentence(self) -> str:
        """Return the text of the error without its file."""
        return f"{self.field or 'input'} = {format_value(self.value)}: must be {self.allowed}"

    def with_field(self, field: str) -> InvalidInput:
        """Return the same error for another path.

        Args:
            field: the new path of the value.
        """
        return type(self)(field, *self.args[1:])

    def with_prefix(self, prefix: str) -> InvalidInput:
        """Return the same error with the path of the enclosing record in front: ``friction`` → ``contacts[2].friction``.

        Args:
            prefix: path of the enclosing record.
        """
        separator = "" if not self.field or not prefix or self.field.startswith("[") else "."
        return self.with_field(f"{prefix}{separator}{self.field}")


class MissingField(InvalidInput):
    """A required field that is not given.

    Args:
        field: path of the field.
        reason: when or why the field is required; empty if it always is.
    """

    def __init__(self, field: str, reason: str = "") -> None:
        super().__init__(field, None, "given" + (f": {reason}" if reason else ""))
        self.args = (field, reason)

    def _sentence(self) -> str:
        return f"Missing field {self.field!r}{self.allowed[len('given') :]}"


class UnknownField(InvalidInput):
    """A field that the record does not have.

    Args:
        field: path of the field.
        value: its value.
        known: names of the record's fields.
    """

    def __init__(self, field: str, value: object, known: Iterable[str]) -> None:
        self.known = tuple(known)
        super().__init__(field, value, "absent: the known fields are " + ", ".join(self.known))
        self.args = (field, value, self.known)

    def _sentence(self) -> str:
        name = self.field.rsplit(".", 1)[-1]
        hint = _suggestion(name, self.known) or f"; known fields: {', '.join(self.known)}"
        return f"Unknown field {format_value(self.field)}{hint}"


class UnknownName(InvalidInput):
    """A name that does not exist.

    Args:
        field: path of the name.
        value: the name as the caller gave it.
        known: the names that exist.
        allowed: completes the sentence "must be …"; by default "one of" and the known names.
    """

    code = "unknown"

    def __init__(self, field: str, value: object, known: Iterable[str] = (), allowed: str = "") -> None:
        self.known = tuple(known)
        super().__init__(field, value, (allowed or f"one of {', '.join(self.known)}") + _suggestion(value, self.known))
        self.args = (field, value, self.known, allowed)


class ModelError(GraspForceError):
    """A hand model that cannot be read or contradicts its description."""


class MissingLibrary(GraspForceError, ImportError):
    """An optional library that is not installed.

    Args:
        module: its module.
        library: its name.
        users: the features that need it, in the plural.
        extra: the extra of graspforce that installs it.
    """

    def __init__(self, module: str, library: str, users: str, extra: str) -> None:
        super().__init__(module, library, users, extra)
        self.name, self.library, self.users, self.extra = module, library, users, extra

    def __str__(self) -> str:
        return f'{self.library} is not installed; {self.users} need it. Install it: pip install "graspforce[{self.extra}]"'


class BackendError(GraspForceError):
    """A solver that is not installed or cannot run."""


class UnsupportedProblem(BackendError):
    """A problem that the solver does not support."""


class ServiceError(GraspForceError):
    """A failed exchange between client and server."""


class NoServer(ServiceError):
    """No server is alive under the requested key."""


class ServerLost(NoServer):
    """A server was alive, but it ended or the connection to it broke before it answered; no other server is alive."""


class IncompatibleServer(ServiceError):
    """The server is of another version, and lacks what the request needs; the message names both."""


class ServiceTimeout(ServiceError):
    """A server is alive but did not reply within the client's time limit."""


class RequestRefused(ServiceError):
    """The server rejected the request, which can be repeated: overloaded, past its deadline, too large or not permitted.

    Args:
        code: ``overloaded``, ``closing``, ``deadline``, ``too_large`` or ``forbidden``.
        message: the server's message.
        retry_after: time after which the request may be repeated, s; None if the server gives none.
    """

    def __init__(self, code: str, message: str, retry_after: float | None = None) -> None:
        self.code, self.message, self.retry_after = code, message, retry_after
        super().__init__(code, message, retry_after)

    def __str__(self) -> str:
        return self.message


class ErrorReply(ServiceError):
    """An error record from the server.

    Args:
        code: ``invalid``, ``unknown`` or ``internal``.
        message: the server's message.
        field: path of the invalid value in the request; None if the error concerns no single field.
    """

    def __init__(self, code: str, message: str, field: str | None) -> None:
        self.code, self.message, self.field = code, message, field
        super().__init__(code, message, field)

    def __str__(self) -> str:
        return self.message


def format_value(value: object) -> str:
    """Return the text of a value for an error message, at most 80 characters long.

    Arrays and tuples appear as lists, NumPy scalars as plain numbers. Large values are cut, not traversed.

    Args:
        value: any object.
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist() if value.size <= _MAX_ITEMS else np.ravel(value)[: _MAX_ITEMS + 1].tolist()
    elif isinstance(value, tuple):
        value = list(value)
    text = _value_repr.repr(value)
    return text if len(text) <= _MAX_VALUE_LENGTH else text[: _MAX_VALUE_LENGTH - 1] + "…"


def nearest_name(name: object, known: Iterable[str]) -> str | None:
    """Return the known name that is most similar to a misspelt one, ignoring case; None if none is similar.

    Args:
        name: the misspelt name; anything but text of at most 64 characters matches nothing.
        known: the names to choose from.
    """
    import difflib

    if not isinstance(name, str) or len(name) > _MAX_NAME_LENGTH:
        return None
    by_lower_case = {each.lower(): each for each in known}
    matches = difflib.get_close_matches(name.lower(), by_lower_case, n=1)
    return by_lower_case[matches[0]] if matches else None


def _suggestion(name: object, known: Iterable[str]) -> str:
    """Return "; did you mean …?" for a misspelt name, or nothing."""
    match = nearest_name(name, known)
    return "" if match is None else f"; did you mean {match!r}?"


_value_repr = reprlib.Repr()
_value_repr.maxlist = _value_repr.maxdict = _value_repr.maxset = _MAX_ITEMS
_value_repr.maxlevel = 4
_value_repr.maxstring = _value_repr.maxother = _value_repr.maxlong = _MAX_VALUE_LENGTH
