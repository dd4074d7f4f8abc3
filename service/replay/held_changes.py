"""Preparations of contact changes that begin when a replay says so, not when a thread is ready."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any


class HeldChanges(Executor):
    """An executor that keeps its work until it is released, and runs it in the calling thread."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Future[Any], Callable[[], Any]]] = []
        self._is_released = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Keep a function until `release`, or run it at once after `release`.

        Args:
            fn: the function.
            args: its arguments.
            kwargs: its arguments by name.
        """
        future: Future[Any] = Future()
        self._waiting.append((future, lambda: fn(*args, **kwargs)))
        if self._is_released:
            self.release()
        return future

    def release(self) -> None:
        """Run what waits, and what is submitted until `hold`: a change may begin with the state that asks for it."""
        self._is_released = True
        while self._waiting:
            future, work = self._waiting.pop(0)
            try:
                future.set_result(work())
            except Exception as error:
                future.set_exception(error)

    def hold(self) -> None:
        """Keep what is submitted from now on."""
        self._is_released = False
