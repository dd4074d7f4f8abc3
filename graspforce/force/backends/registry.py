"""The list of backends. To add one, write a module with ``BACKENDS``, as `protocol.Backend`, and add its name here."""

from __future__ import annotations

import importlib
import warnings
from functools import cache
from typing import cast

from graspforce.core.errors import UnknownName
from graspforce.force.backends.protocol import Backend, ConicBackend

_MODULES = ("structured", "clarabel", "proxqp", "qpsolvers")  # imported on demand, in this order
_PREFERRED = "structured"  # the fastest backend, which does not support every problem
_GENERAL = "clarabel"  # supports every problem


def available_backends() -> tuple[str, ...]:
    """Return the names of the backends that are available in this installation."""
    every = (backend for module in _MODULES for backend in _load(module))
    return tuple(dict.fromkeys(backend.name for backend in every if not backend.unavailable_reason))


def find_backend(name: str) -> Backend:
    """Return the backend of a name.

    Args:
        name: a name of `available_backends`.

    Raises:
        UnknownName: no such backend is available.
    """
    for module in _MODULES:
        for backend in _load(module):
            if backend.name == name and not backend.unavailable_reason:
                return backend
    raise UnknownName("backend", name, available_backends())


def preferred_backend() -> Backend:
    """Return the backend that solves a problem if the caller names none; if it is missing, warn and return the general one."""
    (backend,) = _load(_PREFERRED)
    if backend.unavailable_reason:
        _warn_unavailable(backend.unavailable_reason)
        return general_backend()
    return backend


def general_backend() -> ConicBackend:
    """Return the backend that supports every problem: the fallback, and the solver of infeasibility analysis."""
    (backend,) = _load(_GENERAL)
    return cast(ConicBackend, backend)


@cache
def _load(module: str) -> tuple[Backend, ...]:
    """Return the backends of a module of this package."""
    return cast("tuple[Backend, ...]", importlib.import_module(f"{__package__}.{module}").BACKENDS)


@cache
def _warn_unavailable(reason: str) -> None:
    """Warn once that a default backend is missing."""
    warnings.warn(f"{reason}: {_GENERAL} solves instead, more slowly", RuntimeWarning, stacklevel=4)
