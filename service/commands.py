"""What control answers over the wire: a command as it is sent, and as it came.

Frames: H hand base, O object. A thousand of them a second are written and read: plain lists in typed structs, which take a few
microseconds either way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from graspforce.arrays import Array
from graspforce.contact import ContactSet
from graspforce.control import Command, ControlMemory
from graspforce.control.rolling import Touched
from graspforce.errors import InvalidInput
from graspforce.hold import Hold
from graspforce.solution import Solution


@dataclass(frozen=True, eq=False, slots=True)
class RemoteCommand:
    """A command that came over the wire: what `graspforce.control.Command` says, and how it came.

    Attributes:
        tau, f, contacts, w, acceleration, joint_acceleration, error, slip_margin, saturated, uncontrollable, borne, creep,
        warnings, held: as in `graspforce.control.Command`.
        memory: what the step left to the next.
        solution: the force problem's answer with its certificate; None from a stream, where ``held`` says whether there is one.
        sequence: of the state or request that it answers.
        age: since that state was sent, s; zero from a request.
        late: older than its validity; the torque is then the watchdog's, and all else the last good command's.
        resuming: the torque is on its way back to the server's, by bounded steps.
        server_seconds: from receipt to answer, s.
    """

    tau: Array
    f: Array
    contacts: ContactSet
    w: Array
    acceleration: Array
    joint_acceleration: Array
    error: Array
    slip_margin: Array
    saturated: bool
    uncontrollable: Array
    borne: Array
    creep: Array
    warnings: tuple[str, ...]
    held: bool
    memory: ControlMemory
    solution: Solution | None = None
    sequence: int | None = None
    age: float = 0.0
    late: bool = False
    resuming: bool = False
    server_seconds: float = 0.0


class SentCommand(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """A command as it is on the wire: the fields of `Command` by their wire names, plain lists; ``error`` is an error record's.

    ``positions`` are the contacts' in O, their frames are the memory's; ``time``, ``sequence`` and ``late`` come from a stream.
    """

    torque: list[float]
    force: list[float]
    positions: list[list[float]]
    wrench: list[float]
    acceleration: list[float]
    joint_acceleration: list[float]
    pose_error: list[float]
    slip_margin: list[float]
    uncontrollable: list[list[float]]
    borne: list[float]
    saturated: bool
    held: bool
    warnings: tuple[str, ...]
    memory: SentMemory
    late: bool
    server_seconds: float = 0.0
    sequence: int | None = None
    time: float | None = None
    solution: dict[str, Any] | None = None

    @classmethod
    def of(cls, command: Command, memory: ControlMemory) -> SentCommand:
        """A command and what it leaves, ready to be encoded."""
        return cls(
            torque=command.tau.tolist(),
            force=command.f.tolist(),
            positions=command.contacts.p_OC.tolist(),
            wrench=command.w.tolist(),
            acceleration=command.acceleration.tolist(),
            joint_acceleration=command.joint_acceleration.tolist(),
            pose_error=command.error.tolist(),
            slip_margin=command.slip_margin.tolist(),
            uncontrollable=command.uncontrollable.tolist(),
            borne=command.borne.tolist(),
            saturated=command.saturated,
            held=command.held,
            warnings=command.warnings,
            memory=SentMemory.of(memory),
            late=False,
        )

    def received(self, hold: Hold) -> RemoteCommand:
        """The command, for a hold that its reader knows."""
        before = hold.contacts
        memory = self.memory.received()
        contacts = ContactSet(
            np.array(self.positions), memory.R_OC, before.models, before.mu, before.gamma, before.min_normal, before.max_normal
        )
        return RemoteCommand(
            tau=np.array(self.torque),
            f=np.array(self.force),
            contacts=contacts,
            w=np.array(self.wrench),
            acceleration=np.array(self.acceleration),
            joint_acceleration=np.array(self.joint_acceleration),
            error=np.array(self.pose_error),
            slip_margin=np.array(self.slip_margin),
            saturated=self.saturated,
            uncontrollable=np.array(self.uncontrollable).reshape(-1, 6),
            borne=np.array(self.borne),
            creep=np.hypot(memory.creep[:, 0], memory.creep[:, 1]),
            warnings=self.warnings,
            held=self.held,
            memory=memory,
            solution=None if self.solution is None else Solution.from_dict(self.solution),
            sequence=self.sequence,
            late=self.late,
            server_seconds=self.server_seconds,
        )


class SentTouched(msgspec.Struct, forbid_unknown_fields=True):
    """`Touched` as it is on the wire: the tip frames in O, and where they touched."""

    tips: list[list[float]]
    tip_frames: list[list[list[float]]]
    positions: list[list[float]]

    @classmethod
    def of(cls, touched: Touched) -> SentTouched:
        """Where the tips stood, ready to be encoded."""
        return cls(touched.p_OF.tolist(), touched.R_OF.tolist(), touched.p_OC.tolist())

    def received(self) -> Touched:
        """Where the tips stood, as its own server sent it."""
        return Touched(np.array(self.tips), np.array(self.tip_frames), np.array(self.positions))


class SentMemory(msgspec.Struct, forbid_unknown_fields=True):
    """`ControlMemory` as it is on the wire: the contact frames by rows, the sliding along both tangents."""

    integral: list[float]
    frames: list[list[list[float]]]
    creep: list[list[float]]
    force: list[float] | None = None
    touched: SentTouched | None = None

    @classmethod
    def of(cls, memory: ControlMemory) -> SentMemory:
        """A memory, ready to be encoded."""
        force = None if memory.f is None else memory.f.tolist()
        touched = None if memory.touched is None else SentTouched.of(memory.touched)
        return cls(memory.integral.tolist(), memory.R_OC.tolist(), memory.creep.tolist(), force, touched)

    def received(self) -> ControlMemory:
        """The memory, as its own server sent it."""
        force = None if self.force is None else np.array(self.force)
        touched = None if self.touched is None else self.touched.received()
        return ControlMemory(np.array(self.integral), np.array(self.frames), np.array(self.creep), force, touched)


def read_command(hold: Hold, record: Mapping[str, Any]) -> RemoteCommand:
    """A command from its record.

    Raises:
        InvalidInput: not such a record.
    """
    try:
        return msgspec.convert(record, SentCommand).received(hold)
    except (msgspec.ValidationError, ValueError) as error:
        raise InvalidInput("input", "the record", f"a command ({error})") from None
