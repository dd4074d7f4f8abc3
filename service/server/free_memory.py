"""Return of free memory to the operating system."""

from __future__ import annotations

import ctypes
import ctypes.util
from functools import cache
from typing import Any


def release_free_memory() -> None:
    """Return the free memory of this process's heap to the operating system, with the GNU C library; otherwise do nothing.

    After large messages the heap keeps their memory. The call takes some milliseconds and does not hold Python's lock.
    """
    trim = _trim_function()
    if trim is not None:
        trim(0)


@cache
def _trim_function() -> Any:
    """Return ``malloc_trim``; None if the C library does not have it."""
    try:
        return ctypes.CDLL(ctypes.util.find_library("c")).malloc_trim
    except (OSError, AttributeError, TypeError):
        return None
