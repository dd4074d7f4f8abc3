"""Control of a stream whose states are measurements, and changes of its contacts."""

from __future__ import annotations

from concurrent.futures import Executor

from graspforce.control.feedback_control import FeedbackControl
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.output_feedback_law import OutputFeedbackLaw
from graspforce.core.errors import InvalidInput
from graspforce.estimation.measurement import Measurement
from graspforce.service.server.change_preparation import ChangePreparation
from graspforce.service.server.exact_control import check_finite, present_conditions
from graspforce.service.wire.command_records import ClearanceRecord, CommandRecord
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.estimate_record import EstimateRecord
from graspforce.service.wire.stream_state import StreamState


class MeasuredControl:
    """Estimator, control law, memory and changes of contacts of a stream whose states are measurements.

    A change begins at the estimated state of the last step. With the first state no state is estimated yet; a change in it is
    prepared after its step.

    Args:
        setup: fixed parameters of the stream.
        changes: runs the preparations of changes; None for the thread of all streams of this process.
        law_type: type of the control law.
    """

    def __init__(self, setup: StreamSetup, changes: Executor | None, law_type: type[ObjectControlLaw]) -> None:
        law = OutputFeedbackLaw(setup.grasp, setup.settings, setup.sensors, law_type=law_type)
        self._control = FeedbackControl.start(law, setup.memory, setup.offset)
        self._hand = setup.grasp.hand
        self._has_drive = not self._hand.drives.is_ideal
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

    def step(self, state: StreamState) -> CommandRecord:
        """Return the command for a measurement, with the estimated state.

        Args:
            state: the state; a change of contacts with a new number begins with one of the next states.

        Raises:
            InvalidInput: the state is exact, does not fit the contacts, or has too large numbers; or its change is refused.
        """
        if not isinstance(state.state, Measurement):
            raise InvalidInput("state", "an exact state", "absent: a stream with sensors takes `measurement`")
        is_first = self._control.estimate is None
        if not is_first:
            self._request(state)
        number, control = self._changes.begin(self._control, self._control.begin)
        conditions = present_conditions(state, control.grasp)
        step, control = control.step(state.state, state.desired, state.external, conditions)
        check_finite(step.command, step.memory.control)
        self._changes.accept(number)
        self._control = control.without_released()
        if is_first:
            self._request(state)
        record = CommandRecord.pack(step.command, step.memory.control, state.binary, self._has_drive)
        record.clearance = ClearanceRecord.pack(step.command, self._clearance_steps, state.sequence)
        record.estimate = EstimateRecord.pack(step.estimate, step.monitor)
        record.contact_change = self._changes.record(control)
        return record

    def _request(self, state: StreamState) -> None:
        """Prepare the change of a state in another thread if its number is new. Raise InvalidInput if it is refused."""
        if state.contacts is not None:
            self._changes.request(state.contacts, self._control, self._control.prepare)
