"""Changes of the contacts of a stream at its client: the change to send, and the present grasp."""

from __future__ import annotations

import dataclasses

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.control import ContactChange, GraspState
from graspforce.core.arrays import Array
from graspforce.core.errors import ErrorReply, InvalidInput, ServiceError
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.pose.pose_fusion import PoseOffset
from graspforce.grasp.grasp import Grasp
from graspforce.service.wire.change_records import NumberedChange
from graspforce.service.wire.command_records import CommandRecord, RemoteCommand
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.estimate_record import EstimateRecord
from graspforce.service.wire.memory_records import to_array


class StreamChanges:
    """Changes of the contacts of a stream. Each state carries a change until a command acknowledges it.

    Attributes:
        grasp: the grasp of the last command.
        pending: the change that no command has acknowledged; None if there is none.
        error: reason why the server refused the last change; None if it did not.

    Args:
        setup: fixed parameters of the stream.
    """

    def __init__(self, setup: StreamSetup) -> None:
        self.grasp = setup.grasp
        self.pending: NumberedChange | None = None
        self.error: ServiceError | None = None
        self._number = setup.change_number  # of the last change that was requested
        self._is_changing = False
        self._contacts = dict(zip(setup.grasp.fingers, setup.grasp.contacts.contacts, strict=True))

    @property
    def is_changing(self) -> bool:
        """Whether a change waits for its acknowledgement or is in progress."""
        return self.pending is not None or self._is_changing

    @property
    def fingers(self) -> tuple[str, ...] | None:
        """Names of the fingers in the order of a state's conditions; None if no contacts have changed."""
        return self.grasp.fingers if self._number > 0 else None

    def request(self, change: ContactChange) -> None:
        """Send a change with the next states.

        Args:
            change: the change.

        Raises:
            InvalidInput: another change is in progress, or the present grasp cannot change so.
            UnknownName: no such finger, or a finger that lets go has no contact.
        """
        change.check(self.grasp, self.is_changing)
        self._number, self.error = self._number + 1, None
        self._contacts.update(change.add)
        self.pending = NumberedChange(self._number, change)

    def grasp_of(self, record: CommandRecord, state: GraspState | Measurement | None) -> Grasp:
        """Return the grasp of a command.

        Args:
            record: the command.
            state: the last state that was sent.

        Raises:
            InvalidInput: the command has fingers that the stream does not know.
            ValueError: an array has the wrong size.
        """
        change, pending = record.contact_change, self.pending
        if change is None or state is None:
            return self.grasp
        has_joined = pending is not None and change.number == pending.number and len(pending.change.add) > 0
        if change.fingers == self.grasp.fingers and not has_joined:
            return self.grasp
        if not set(change.fingers) <= set(self._contacts):
            raise InvalidInput("contact_change.fingers", change.fingers, f"some of {', '.join(self._contacts)}")
        modelled = ContactSet.stack([self._contacts[name] for name in change.fingers])
        p_OC, R_OC = to_array(record.positions, -1, 3), to_array(record.memory.frames, -1, 3, 3)
        if not len(p_OC) == len(R_OC) == len(modelled):
            raise ValueError("an array has the wrong size")
        contacts = dataclasses.replace(modelled, p_OC=p_OC, R_OC=R_OC)
        hand, body = self.grasp.hand, self.grasp.body
        if isinstance(state, GraspState):
            pose = state.object
            return Grasp(hand, body, change.fingers, contacts, state.q, pose.p_HO, pose.R_HO)
        if record.estimate is None:
            raise ValueError("a command for a measurement has no estimate")
        return Grasp(hand, body, change.fingers, contacts, *_estimated_pose(record.estimate))

    def accept(self, command: RemoteCommand) -> None:
        """Continue with the contacts of a good command.

        Args:
            command: the command.
        """
        change = command.contact_change
        if change is None:
            return
        self.grasp, self._is_changing = command.grasp, change.changing
        if self.pending is None:
            return
        number = self.pending.number
        if change.refused == number:
            self.refuse(ErrorReply("invalid", f"the server refused change {number} of the contacts", "contacts"))
        elif change.number >= number:
            self.pending = None

    def refuse(self, error: ServiceError) -> None:
        """Stop to send a change if the server's error is about it.

        Args:
            error: error in place of a command.
        """
        field = error.field if isinstance(error, ErrorReply) else None
        if self.pending is not None and field is not None and field.partition(".")[0] == "contacts":
            self.pending, self.error = None, error


def resumed_setup(setup: StreamSetup, last: RemoteCommand) -> StreamSetup:
    """Return the setup with which a server continues after the last good command.

    The memory of the controller is in the command, with the ramp of a change in progress. An estimator starts from the
    estimated pose, with the contacts of then.

    Args:
        setup: setup of the stream.
        last: the last good command.
    """
    number = setup.change_number if last.contact_change is None else last.contact_change.number
    if last.estimate is None:
        return dataclasses.replace(setup, grasp=last.grasp, memory=last.memory, change_number=number)
    estimate = last.estimate
    q, p, R = _estimated_pose(estimate)
    fused_p, fused_R = np.array(estimate.fused_position), np.array(estimate.fused_rotation)
    grasp = dataclasses.replace(last.grasp, contacts=last.contacts, q=q, p_HO=p, R_HO=R)
    offset = PoseOffset(R.T @ (fused_p - p), R.T @ fused_R)
    return dataclasses.replace(setup, grasp=grasp, memory=last.memory, offset=offset, change_number=number)


def _estimated_pose(estimate: EstimateRecord) -> tuple[Array, Array, Array]:
    """Return the estimated posture, rad, and the position, m, and axes of the object in H."""
    return np.array(estimate.posture), np.array(estimate.position), np.array(estimate.rotation)
