"""Control of a stream whose states are exact, and changes of its contacts.

The laws of a change take longer to prepare than a control period. Another thread prepares them, and the change begins with the
first state after that.
"""

from __future__ import annotations

import contextvars
import math
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from graspforce.control import Command, ContactConditions, ControlMemory, GraspState
from graspforce.control.grasp_control import GraspControl, PreparedChange
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.service.wire.binary_command import AnyCommand, BinaryCommand
from graspforce.service.wire.change_records import ContactChangeRecord, NumberedChange
from graspforce.service.wire.command_records import ClearanceRecord, CommandRecord
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.stream_state import StreamState

_PREPARATIONS = ThreadPoolExecutor(max_workers=1, thread_name_prefix="contact-change")


class _Preparation(NamedTuple):
    """A change that another thread prepares."""

    number: int
    prepared: Future[PreparedChange]


class ExactControl:
    """Control law, memory and changes of contacts of a stream whose states are exact.

    Args:
        setup: fixed parameters of the stream.
        changes: runs the preparations of changes; None for the thread of all streams of this process.
    """

    def __init__(self, setup: StreamSetup, changes: Executor | None = None) -> None:
        self._control = GraspControl.start(setup.grasp, setup.settings, setup.memory)
        self._hand, self._changes = setup.grasp.hand, changes or _PREPARATIONS
        self._has_drive = not self._hand.drives.is_ideal
        self._has_heat = self._hand.drives.has_thermal_data
        self._clearance_steps = setup.settings.clearance_steps
        self._number, self._refused = setup.change_number, 0
        self._preparation: _Preparation | None = None
        self._has_changes = setup.change_number > 0 or self._control.is_changing

    def decode(self, payload: bytes, codec: str) -> StreamState:
        """Return a state.

        Args:
            payload: the encoded state.
            codec: its encoding.

        Raises:
            InvalidInput: as in `StreamState.decode`.
        """
        return StreamState.decode(self._hand, payload, codec)

    @property
    def _is_plain(self) -> bool:
        """Whether commands have no parts beside those of `BinaryCommand`."""
        return not (self._has_drive or self._has_changes or self._clearance_steps or self._has_heat)

    def step(self, state: StreamState) -> AnyCommand:
        """Return the command for a state.

        Args:
            state: the state; a change of contacts with a new number begins with one of the next states.

        Raises:
            InvalidInput: the state is a measurement, does not fit the contacts, or has too large numbers; or its change is
                refused.
        """
        measured = state.state
        if not isinstance(measured, GraspState):
            raise InvalidInput("measurement", "a measurement", "absent: a stream without sensors takes `state`")
        if state.contacts is not None:
            self._request(state.contacts, measured)
        number, control = self._begin_prepared(measured)
        conditions = present_conditions(state, control.grasp)
        command, control = control.step(measured, state.desired, state.external, conditions)
        check_finite(command, control.memory)
        if number != self._number:
            self._number, self._preparation = number, None
        self._control = control.without_released(measured)
        record = BinaryCommand.pack(command, control.memory) if state.binary and self._is_plain else None
        return record or self._full_record(command, control, state, number)

    def _full_record(self, command: Command, control: GraspControl, state: StreamState, number: int) -> CommandRecord:
        """Return the record of a command with all its parts."""
        record = CommandRecord.pack(command, control.memory, state.binary, self._has_drive)
        record.clearance = ClearanceRecord.pack(command, self._clearance_steps, state.sequence)
        if self._has_changes:
            refused = self._refused or None
            record.contact_change = ContactChangeRecord(number, control.grasp.fingers, control.is_changing, refused)
        return record

    def _request(self, given: NumberedChange, state: GraspState) -> None:
        """Prepare a change in another thread if its number is new.

        Raises:
            InvalidInput: the change is refused.
        """
        preparing = 0 if self._preparation is None else self._preparation.number
        if given.number <= max(self._number, self._refused, preparing):
            return
        self._has_changes = True
        try:
            if preparing:
                raise InvalidInput("number", given.number, f"the number of the last change, {preparing}: it has not begun yet")
            self._control.check(given.change)
        except InvalidInput as error:
            self._refused = given.number
            raise error.with_prefix("contacts") from None
        prepared = self._changes.submit(make_silent_context().run, self._control.prepare, given.change, state)
        self._preparation = _Preparation(given.number, prepared)

    def _begin_prepared(self, state: GraspState) -> tuple[int, GraspControl]:
        """Return the number of the last change and the control, after the begin of a change that is prepared.

        Raises:
            InvalidInput: the change is refused.
        """
        preparation = self._preparation
        if preparation is None or not preparation.prepared.done():
            return self._number, self._control
        try:
            return preparation.number, self._control.begin(preparation.prepared.result(), state)
        except Exception as error:
            self._refused, self._preparation = preparation.number, None
            if isinstance(error, InvalidInput):
                raise error.with_prefix("contacts") from None
            raise


def present_conditions(state: StreamState, grasp: Grasp) -> ContactConditions | None:
    """Return the conditions of a state in the order of the present contacts.

    Args:
        state: the state.
        grasp: the present grasp.

    Raises:
        InvalidInput: the conditions do not fit the fingers that the state names for them.
    """
    if state.conditions is None or state.fingers is None:
        return state.conditions
    try:
        return state.conditions.for_grasp(grasp, state.fingers)
    except InvalidInput as error:
        raise error.with_prefix("conditions") from None


def check_finite(command: Command, memory: ControlMemory) -> None:
    """Check that torques and memory are finite.

    Args:
        command: the command.
        memory: memory after its step.

    Raises:
        InvalidInput: a number is not finite, because the state has too large numbers.
    """
    if native is not None:
        is_finite = native.has_finite_sum(command.tau, memory.integral)
    else:
        is_finite = math.isfinite(sum(command.tau.tolist()) + sum(memory.integral.tolist()))
    if not is_finite:
        raise InvalidInput("state", "too large numbers", "of a magnitude that gives finite torques")


def make_silent_context() -> contextvars.Context:
    """Return a context without NumPy's warnings on overflow. It is faster to enter than `np.errstate`.

    Results that overflow are rejected later: they are not finite, or fail certification.
    """
    context = contextvars.copy_context()
    context.run(np.seterr, all="ignore")
    return context
