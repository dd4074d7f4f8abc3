"""Ctrl-C in a long run: the run ends after the present step, and its results are shown and saved."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from graspforce.cli.console import progress_console


class Interruption:
    """Context in which Ctrl-C is a request to end. A second Ctrl-C raises `KeyboardInterrupt`.

    Attributes:
        is_requested: whether Ctrl-C was pressed.
    """

    def __init__(self) -> None:
        self.is_requested = False
        self._previous: Any = None

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():  # other threads get no signals
            self._previous = signal.signal(signal.SIGINT, self._request)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        if self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.is_requested:
            raise KeyboardInterrupt
        self.is_requested = True
        progress_console().print("Interrupted: the results are those so far. Ctrl-C again discards them.")
