"""Numbered changes of the contacts of a stream: another thread prepares them, and each begins once.

The laws of a change take longer to prepare than a control period. The change begins with the first state after that.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import NamedTuple, Protocol, TypeVar

from graspforce.control import ContactChange
from graspforce.control.grasp_control import PreparedChange
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.service.server.silent_context import make_silent_context
from graspforce.service.wire.change_records import ContactChangeRecord, NumberedChange

_PREPARATIONS = ThreadPoolExecutor(max_workers=1, thread_name_prefix="contact-change")


class ChangingControl(Protocol):
    """The part of a control record that changes of contacts need."""

    @property
    def grasp(self) -> Grasp:
        """The present grasp."""

    @property
    def is_changing(self) -> bool:
        """Whether contacts let go or join."""

    def check(self, change: ContactChange) -> None:
        """Check that a change can begin."""


C = TypeVar("C", bound=ChangingControl)


class _Preparation(NamedTuple):
    """A change that another thread prepares."""

    number: int
    prepared: Future[PreparedChange]


class ChangePreparation:
    """The numbers of a stream's changes, and the change that another thread prepares.

    Args:
        number: number of the last change of an earlier stream; 0 for none.
        is_changing: whether contacts let go or join at the start.
        executor: runs the preparations; None for the thread of all streams of this process.

    Attributes:
        is_used: whether the stream has or had changes.
    """

    def __init__(self, number: int, is_changing: bool, executor: Executor | None = None) -> None:
        self._executor = executor or _PREPARATIONS
        self._number, self._refused = number, 0
        self._preparation: _Preparation | None = None
        self.is_used = number > 0 or is_changing

    def request(
        self, given: NumberedChange, control: ChangingControl, prepare: Callable[[ContactChange], PreparedChange]
    ) -> None:
        """Prepare a change in another thread if its number is new.

        Args:
            given: the change of a state.
            control: the present control.
            prepare: prepares the change.

        Raises:
            InvalidInput: the change is refused.
        """
        preparing = 0 if self._preparation is None else self._preparation.number
        if given.number <= max(self._number, self._refused, preparing):
            return
        self.is_used = True
        try:
            if preparing:
                raise InvalidInput("number", given.number, f"the number of the last change, {preparing}: it has not begun yet")
            control.check(given.change)
        except InvalidInput as error:
            self._refused = given.number
            raise error.with_prefix("contacts") from None
        self._preparation = _Preparation(given.number, self._executor.submit(make_silent_context().run, prepare, given.change))

    def begin(self, control: C, begin: Callable[[PreparedChange], C]) -> tuple[int, C]:
        """Return the number of the last change and the control, after the begin of a change that is prepared.

        The number counts from `accept` on, when the step of the state has succeeded.

        Args:
            control: the present control.
            begin: returns the control at the begin of a change.

        Raises:
            InvalidInput: the change is refused.
        """
        preparation = self._preparation
        if preparation is None or not preparation.prepared.done():
            return self._number, control
        try:
            return preparation.number, begin(preparation.prepared.result())
        except Exception as error:
            self._refused, self._preparation = preparation.number, None
            if isinstance(error, InvalidInput):
                raise error.with_prefix("contacts") from None
            raise

    def accept(self, number: int) -> None:
        """Count a change as begun.

        Args:
            number: its number, from `begin`.
        """
        if number != self._number:
            self._number, self._preparation = number, None

    def record(self, control: ChangingControl) -> ContactChangeRecord | None:
        """Return the contacts of a command; None if the stream has no changes.

        Args:
            control: the control after the step of the command.
        """
        if not self.is_used:
            return None
        return ContactChangeRecord(self._number, control.grasp.fingers, control.is_changing, self._refused or None)
