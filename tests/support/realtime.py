"""Tests of real-time scheduling, where the system permits it."""

from __future__ import annotations

import subprocess
import sys

import pytest

_PROGRAM = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))"


def _is_permitted() -> bool:
    """Return whether this system permits real-time scheduling."""
    return subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, check=False, timeout=60.0).returncode == 0


needs_realtime = pytest.mark.skipif(not _is_permitted(), reason="this system does not permit real-time scheduling")
