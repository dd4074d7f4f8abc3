"""What control answers over the wire: a command as it is sent, and as it came.

Frames: H hand base, O object. A thousand of them a second are written and read: typed structs of plain lists or, for a stream
whose states do so, of binary arrays (`graspforce.service.wire.stream_state`). Who reads one makes an array when it is asked
for.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, cached_property
from typing import Any

import msgspec
import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.kinematics import TipContactState
from graspforce.control import Command, ControlMemory
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.solution import Solution
from graspforce.grasp.grasp import Grasp

WireVector = bytes | list[float]
WireMatrix = bytes | list[list[float]]
WireMatrices = bytes | list[list[list[float]]]

_BYTES = 8  # of a float64


class RemoteCommand(msgspec.Struct, frozen=True, eq=False, dict=True):
    """A command that came over the wire: what `graspforce.control.Command` says, and how it came.

    ``f``, ``contacts``, ``w``, ``acceleration``, ``joint_acceleration``, ``error``, ``slip_margin``, ``saturated``,
    ``uncontrollable``, ``structural_wrench``, ``creep`` and ``forces_reused`` are as there.

    Attributes:
        tau: (n,) motor torques, N·m: the server's, or the watchdog's.
        warnings: what a person should know, in sentences.
        age: since the state that it answers was sent, s; zero from a request.
        late: older than its validity; the torque is then the watchdog's, and all else the last good command's.
        resuming: the torque is on its way back to the server's, by bounded steps.
        record: the record as it came.
        hold: what it is for.
    """

    tau: Array
    warnings: tuple[str, ...]
    age: float
    late: bool
    resuming: bool
    record: CommandRecord
    grasp: Grasp

    @cached_property
    def f(self) -> Array:
        return _to_array(self.record.force)

    @cached_property
    def contacts(self) -> ContactSet:
        before = self.grasp.contacts
        p_OC, R_OC = _to_array(self.record.positions, -1, 3), self.memory.R_OC
        return ContactSet(p_OC, R_OC, before.models, before.mu, before.gamma, before.min_normal, before.max_normal)

    @cached_property
    def w(self) -> Array:
        return _to_array(self.record.wrench)

    @cached_property
    def acceleration(self) -> Array:
        return _to_array(self.record.acceleration)

    @cached_property
    def joint_acceleration(self) -> Array:
        return _to_array(self.record.joint_acceleration)

    @cached_property
    def error(self) -> Array:
        return _to_array(self.record.pose_error)

    @cached_property
    def slip_margin(self) -> Array:
        return _to_array(self.record.slip_margin)

    @property
    def saturated(self) -> bool:
        return self.record.saturated

    @cached_property
    def uncontrollable(self) -> Array:
        return _to_array(self.record.uncontrollable, -1, 6)

    @cached_property
    def structural_wrench(self) -> Array:
        return _to_array(self.record.borne)

    @cached_property
    def creep(self) -> Array:
        creep = self.memory.creep
        return np.asarray(np.hypot(creep[:, 0], creep[:, 1]))

    @property
    def forces_reused(self) -> bool:
        return self.record.held

    @cached_property
    def memory(self) -> ControlMemory:
        """What the step left to the next."""
        return self.record.memory.unpack()

    @cached_property
    def solution(self) -> Solution | None:
        """The force problem's answer with its certificate; None from a stream, where ``forces_reused`` says whether there is one."""
        return None if self.record.solution is None else Solution.from_dict(self.record.solution)

    @property
    def sequence(self) -> int | None:
        """The number of the state or request that it answers."""
        return self.record.sequence

    @property
    def server_seconds(self) -> float:
        """From receipt to answer, s."""
        return self.record.server_seconds


class CommandRecord(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """A command as it is on the wire: the fields of `Command` by their wire names, ``pose_error`` its ``error``.

    ``positions`` are the contacts' in O, their frames are the memory's; ``time``, ``sequence`` and ``late`` come from a stream.
    """

    torque: WireVector
    force: WireVector
    positions: WireMatrix
    wrench: WireVector
    acceleration: WireVector
    joint_acceleration: WireVector
    pose_error: WireVector
    slip_margin: WireVector
    uncontrollable: WireMatrix
    borne: WireVector
    saturated: bool
    held: bool
    warnings: tuple[str, ...]
    memory: ControlMemoryRecord
    late: bool
    server_seconds: float = 0.0
    sequence: int | None = None
    time: float | None = None
    solution: dict[str, Any] | None = None

    @classmethod
    def pack(cls, command: Command, memory: ControlMemory, binary: bool = False) -> CommandRecord:
        """A command and what it leaves, ready to be encoded.

        Args:
            command: the command.
            memory: what its step left.
            packed: whether its arrays are to be binary.
        """
        write = np.ndarray.tobytes if binary else np.ndarray.tolist
        return cls(
            torque=write(command.tau),
            force=write(command.f),
            positions=write(command.contacts.p_OC),
            wrench=write(command.w),
            acceleration=write(command.acceleration),
            joint_acceleration=write(command.joint_acceleration),
            pose_error=write(command.error),
            slip_margin=write(command.slip_margin),
            uncontrollable=write(command.uncontrollable),
            borne=write(command.structural_wrench),
            saturated=command.saturated,
            held=command.forces_reused,
            warnings=command.warnings,
            memory=ControlMemoryRecord.pack(memory, binary),
            late=False,
        )

    def unpack(self, grasp: Grasp) -> RemoteCommand:
        """The command, for a hold that its reader knows.

        Raises:
            ValueError: an array, not the torque, of another size than such a hold's command has.
        """
        left, touched = self.memory, self.memory.touched
        rows: tuple[Any, ...] = (
            *(self.joint_acceleration, self.wrench, self.acceleration, self.pose_error, self.borne, left.integral),
            *(self.force, self.slip_margin, self.positions, left.frames, left.creep),
        )
        if left.force is not None:
            rows = (*rows, left.force)
        if touched is not None:
            rows = (*rows, touched.tips, touched.tip_frames, touched.positions)
        binary = type(self.force) is bytes
        if binary and not {bytes}.issuperset(map(type, (*rows, self.uncontrollable))):
            raise ValueError("lists beside binary arrays")
        unit, measure = (_BYTES, len) if binary else (1, np.size)
        sizes = _sizes(grasp.hand.n, grasp.contacts.size, len(grasp.contacts), left.force is None, touched is None, unit)
        if tuple(map(measure, rows)) != sizes or measure(self.uncontrollable) % (6 * unit):
            raise ValueError("an array of another size")
        return RemoteCommand(_to_array(self.torque), self.warnings, 0.0, self.late, False, self, grasp)


@cache
def _sizes(n: int, k: int, count: int, first: bool, apart: bool, unit: int) -> tuple[int, ...]:
    """Of a command's arrays in the order in which they are looked at: n joints, k numbers of force, so many contacts."""
    sizes: tuple[int, ...] = (n, 6, 6, 6, 6, 6, k, count, 3 * count, 9 * count, 2 * count)
    sizes += () if first else (k,)
    sizes += () if apart else (3 * count, 9 * count, 3 * count)
    return tuple(unit * size for size in sizes)


class TipContactRecord(msgspec.Struct, forbid_unknown_fields=True):
    """`TipContactState` as it is on the wire: the tip frames in O, and where they touched."""

    tips: WireMatrix
    tip_frames: WireMatrices
    positions: WireMatrix

    @classmethod
    def pack(cls, touched: TipContactState, binary: bool = False) -> TipContactRecord:
        """Where the tips stood, ready to be encoded."""
        write = np.ndarray.tobytes if binary else np.ndarray.tolist
        return cls(write(touched.p_OF), write(touched.R_OF), write(touched.p_OC))

    def unpack(self) -> TipContactState:
        """Where the tips stood, as its own server sent it."""
        return TipContactState(
            _to_array(self.tips, -1, 3), _to_array(self.tip_frames, -1, 3, 3), _to_array(self.positions, -1, 3)
        )


class ControlMemoryRecord(msgspec.Struct, forbid_unknown_fields=True):
    """`ControlMemory` as it is on the wire: the contact frames by rows, the sliding along both tangents."""

    integral: WireVector
    frames: WireMatrices
    creep: WireMatrix
    force: WireVector | None = None
    touched: TipContactRecord | None = None

    @classmethod
    def pack(cls, memory: ControlMemory, binary: bool = False) -> ControlMemoryRecord:
        """A memory, ready to be encoded."""
        write = np.ndarray.tobytes if binary else np.ndarray.tolist
        force = None if memory.f is None else write(memory.f)
        touched = None if memory.tip_contacts is None else TipContactRecord.pack(memory.tip_contacts, binary)
        return cls(write(memory.integral), write(memory.R_OC), write(memory.creep), force, touched)

    def unpack(self) -> ControlMemory:
        """The memory, as its own server sent it."""
        force = None if self.force is None else _to_array(self.force)
        touched = None if self.touched is None else self.touched.unpack()
        frames, creep = _to_array(self.frames, -1, 3, 3), _to_array(self.creep, -1, 2)
        return ControlMemory(_to_array(self.integral), frames, creep, force, touched)


def read_command(grasp: Grasp, record: Mapping[str, Any]) -> RemoteCommand:
    """A command from its record.

    Raises:
        InvalidInput: not such a record.
    """
    try:
        return msgspec.convert(record, CommandRecord).unpack(grasp)
    except (msgspec.ValidationError, ValueError) as error:
        raise InvalidInput("input", "the record", f"a command ({error})") from None


def _to_array(sent: Any, *shape: int) -> Array:
    """An array as it was sent: a list, or binary."""
    numbers = np.frombuffer(sent) if type(sent) is bytes else np.array(sent, dtype=np.float64)
    return numbers.reshape(shape) if shape else numbers
