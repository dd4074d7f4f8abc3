"""Free memory of the process: one heap for all threads, and its return to the operating system. For the GNU C library."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from functools import cache
from typing import Any

_M_ARENA_MAX = -8  # of malloc.h


def share_heap() -> None:
    """Let all threads that start later share one heap.

    The GNU C library gives most threads a heap of their own, and each keeps the free memory of its largest amount of work: the
    process grows for hours. Do nothing with another library, or if the environment variable ``MALLOC_ARENA_MAX`` is set.
    """
    set_option = _c_function("mallopt")
    if set_option is not None and "MALLOC_ARENA_MAX" not in os.environ:
        set_option(_M_ARENA_MAX, 1)


def release_free_memory() -> None:
    """Return the free memory of this process's heap to the operating system, with the GNU C library; otherwise do nothing.

    After large messages the heap keeps their memory. The call takes some milliseconds and does not hold Python's lock.
    """
    trim = _c_function("malloc_trim")
    if trim is not None:
        trim(0)


@cache
def _c_function(name: str) -> Any:
    """Return a function of the C library; None if it does not have it."""
    try:
        return getattr(ctypes.CDLL(ctypes.util.find_library("c")), name)
    except (OSError, AttributeError, TypeError):
        return None
