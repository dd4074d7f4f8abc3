"""Control of a stream whose states are exact, and changes of its contacts."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

from graspforce.control import Command, ContactConditions, ControlMemory, GraspState
from graspforce.control.compiled_control_law import CompiledControlLaw
from graspforce.control.grasp_control import GraspControl
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.service.server.change_preparation import ChangePreparation
from graspforce.service.wire.binary_command import AnyCommand, BinaryCommand
from graspforce.service.wire.command_records import ClearanceRecord, CommandRecord
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.stream_state import StreamState

Warn: TypeAlias = Callable[[Array, Array, Array], tuple[str, ...]]  # `StepWarnings.of_step`


class ExactControl:
    """Control law, memory and changes of contacts of a stream whose states are exact.

    Args:
        setup: fixed parameters of the stream.
        changes: runs the preparations of changes; None for the thread of all streams of this process.
        law_type: type of the control law.
    """

    def __init__(self, setup: StreamSetup, changes: Executor | None, law_type: type[ObjectControlLaw]) -> None:
        self._control = GraspControl.start(setup.grasp, setup.settings, setup.memory, law_type)
        self._hand = setup.grasp.hand
        self._has_drive = not self._hand.drives.is_ideal
        self._has_heat = self._hand.drives.has_thermal_data
        self._clearance_steps = setup.settings.clearance_steps
        self._changes = ChangePreparation(setup.change_number, self._control.is_changing, changes)

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
        return not (self._has_drive or self._changes.is_used or self._clearance_steps or self._has_heat)

    def usual_step(self) -> tuple[Any, Warn, ControlMemory] | None:
        """Return the step in C, its warnings and the memory if the next step may be usual and its command plain, else None."""
        law, memory = self._control.law, self._control.memory
        if not (self._is_plain and isinstance(law, CompiledControlLaw)):
            return None
        step = law.usual_step(memory)
        return None if step is None else (step, law.warnings.of_step, memory)

    def resume(self, memory: ControlMemory) -> None:
        """Continue from the memory of a step that was taken elsewhere.

        Args:
            memory: memory after the step.
        """
        self._control = replace(self._control, memory=memory)

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
            prepare = partial(self._control.prepare, state=measured)
            self._changes.request(state.contacts, self._control, prepare)
        number, control = self._changes.begin(self._control, partial(self._control.begin, state=measured))
        conditions = present_conditions(state, control.grasp)
        command, control = control.step(measured, state.desired, state.external, conditions)
        check_finite(command, control.memory)
        self._changes.accept(number)
        self._control = control.without_released(measured)
        record = BinaryCommand.pack(command, control.memory) if state.binary and self._is_plain else None
        return record or self._full_record(command, control, state)

    def _full_record(self, command: Command, control: GraspControl, state: StreamState) -> CommandRecord:
        """Return the record of a command with all its parts."""
        record = CommandRecord.pack(command, control.memory, state.binary, self._has_drive)
        record.clearance = ClearanceRecord.pack(command, self._clearance_steps, state.sequence)
        record.contact_change = self._changes.record(control)
        return record


def present_conditions(state: StreamState, grasp: Grasp) -> ContactConditions | None:
    """Return the conditions of a state in the order of the present contacts.

    Args:
        state: the state.
        grasp: the present grasp.

    Raises:
        InvalidInput: the conditions do not fit the contacts, or the fingers that the state names for them.
        UnknownName: a lost finger that the grasp does not use.
    """
    conditions = state.conditions
    if conditions is None:
        return None
    try:
        if state.fingers is not None:
            return conditions.for_grasp(grasp, state.fingers)
        conditions.check(grasp)
        return conditions
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
