"""Commands of a stream with binary arrays in MessagePack, encoded and read by compiled code.

Most commands have the same parts: torques, forces, and the memory of a step. They need neither a Python object for each array
nor the general encoder. The payload equals that of `CommandRecord`, byte by byte. A client reads the torques and checks the
other arrays; it decodes these when they are read first.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar, cast

import msgspec

from graspforce.control import Command, ControlMemory
from graspforce.control.command import read_step_arrays
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.grasp.grasp import Grasp
from graspforce.service.wire.command_records import CommandRecord, RemoteCommand
from graspforce.service.wire.memory_records import to_array

_decode_record = msgspec.msgpack.Decoder(CommandRecord).decode


class BinaryCommand(msgspec.Struct):
    """A command of a stream and the memory after its step, as far as `CommandRecord` requires them.

    Args:
        torque: motor torques, N·m, or the bytes of their float64 numbers.
        arrays: the other arrays of `CommandRecord` and of its memory, in their order.
        saturated: as in `CommandRecord`.
        held: as in `CommandRecord`.
        warnings: as in `CommandRecord`.
        late: as in `CommandRecord`.
        server_seconds: as in `CommandRecord`, s.
        sequence: as in `CommandRecord`.
        time: as in `CommandRecord`, s.
    """

    torque: Array | bytes
    arrays: tuple[Array, ...]
    saturated: bool
    held: bool
    warnings: tuple[str, ...]
    late: bool = False
    server_seconds: float = 0.0
    sequence: int = 0
    time: float = 0.0

    @classmethod
    def pack(cls, command: Command, memory: ControlMemory) -> BinaryCommand | None:
        """Return a command; None if `CommandRecord` must encode it: other parts of the memory, or no compiled code.

        Args:
            command: the command.
            memory: memory after its step.
        """
        tips, f = memory.tip_contacts, memory.f
        if native is None or tips is None or f is None or _has_other_parts(memory):
            return None
        arrays = (
            *(command.f, tips.p_OC, *read_step_arrays(command)),
            *(memory.integral, memory.R_OC, memory.creep, f, tips.p_OF, tips.R_OF, tips.p_OC),
        )
        return cls(command.tau, arrays, command.saturated, command.forces_reused, command.warnings)

    def encode(self) -> bytes:
        """Return the payload in MessagePack."""
        facts = self.saturated, self.held, self.warnings, self.late, self.server_seconds, self.sequence, self.time
        return cast(bytes, native.write_stream_command(self.torque, self.arrays, *facts))


def _has_other_parts(memory: ControlMemory) -> bool:
    """Return whether a memory has parts that `BinaryCommand` has not."""
    return not (
        memory.friction is None
        and memory.reflex is None
        and memory.stop is None
        and memory.ramp is None
        and memory.spin is None
        and memory.margin is None
        and memory.torque_factors is None
    )


AnyCommand = CommandRecord | BinaryCommand


class CommandMessage(msgspec.Struct, frozen=True, eq=False, dict=True):
    """A received command: its torque and facts, and the payload with the rest.

    Args:
        payload: the encoded record.
        torque: bytes of the float64 torques, N·m.
        warnings: as in `CommandRecord`.
        late: as in `CommandRecord`.
        server_seconds: as in `CommandRecord`, s.
        sequence: as in `CommandRecord`.
        time: as in `CommandRecord`, s.
        saturated: as in `CommandRecord`.
        held: as in `CommandRecord`.
    """

    payload: bytes
    torque: bytes
    warnings: tuple[str, ...]
    late: bool
    server_seconds: float
    sequence: int
    time: float
    saturated: bool
    held: bool
    estimate: ClassVar[Any] = None
    contact_change: ClassVar[Any] = None

    @cached_property
    def record(self) -> CommandRecord:
        """The complete record."""
        return _decode_record(self.payload)


def read_binary_command(payload: bytes, grasp: Grasp) -> RemoteCommand | None:
    """Return a command; None if `CommandRecord` must decode it: another form, or no compiled code.

    Args:
        payload: the encoded record.
        grasp: grasp of the stream; it determines the sizes of the arrays.
    """
    if native is None:
        return None
    found = native.read_stream_command(payload, grasp.hand.n, grasp.contacts.size, len(grasp.contacts))
    if found is None:
        return None
    message = CommandMessage(payload, *found)
    return RemoteCommand(to_array(message.torque), message.warnings, 0.0, message.late, False, message, grasp)
