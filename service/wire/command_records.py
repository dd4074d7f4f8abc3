"""Commands on the wire: typed structs for encoding and decoding, and the command as a client gets it.

Frames: H hand base, O object. A stream sends and receives a thousand commands a second. The arrays of a struct are therefore
lists or, if the states of the stream are so, binary (`graspforce.service.wire.stream_state`). `RemoteCommand` converts each
array on first use.
"""

from __future__ import annotations

from functools import cache, cached_property
from typing import Any, Protocol

import msgspec
import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.control import Command, ControlMemory
from graspforce.control.command import read_step_arrays
from graspforce.control.drives.drive_commands import DriveCommand, DriveMap
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.printable import escape_controls
from graspforce.force.solution import Solution
from graspforce.grasp.grasp import Grasp
from graspforce.hand.collision import LinkGap
from graspforce.service.wire import protocol
from graspforce.service.wire.change_records import ContactChangeRecord
from graspforce.service.wire.estimate_record import EstimateRecord
from graspforce.service.wire.memory_records import ControlMemoryRecord, WireMatrix, WireVector, to_array


class ReceivedCommand(Protocol):
    """A command as it was received: the facts that each period needs, and the complete record."""

    @property
    def sequence(self) -> int | None: ...  # pragma: no cover
    @property
    def time(self) -> float | None: ...  # pragma: no cover
    @property
    def server_seconds(self) -> float: ...  # pragma: no cover
    @property
    def late(self) -> bool: ...  # pragma: no cover
    @property
    def saturated(self) -> bool: ...  # pragma: no cover
    @property
    def held(self) -> bool: ...  # pragma: no cover
    @property
    def estimate(self) -> EstimateRecord | None: ...  # pragma: no cover
    @property
    def contact_change(self) -> ContactChangeRecord | None: ...  # pragma: no cover
    @property
    def record(self) -> CommandRecord: ...  # pragma: no cover


class RemoteCommand(msgspec.Struct, frozen=True, eq=False, dict=True):
    """A command from a server: the fields of `graspforce.control.Command`, and those of the stream.

    If the torque is the watchdog's (`late` or `resuming`), all other fields are those of the last good command.

    Attributes:
        tau: (n,) motor torques, N·m: the server's or the watchdog's.
        warnings: messages for the user, of the controller and of the stream.
        age: time since the state that it answers was sent, s; 0 for the answer to a request.
        late: True if the age exceeds the validity of the stream: the torque is the watchdog's.
        resuming: True while the torque moves back to the server's, by at most `Watchdog.step` per period.
        message: the command as it was received.
        grasp: hand, object and contacts of the command.
    """

    tau: Array
    warnings: tuple[str, ...]
    age: float
    late: bool
    resuming: bool
    message: ReceivedCommand
    grasp: Grasp

    @property
    def record(self) -> CommandRecord:
        """The complete record of the command."""
        return self.message.record

    @cached_property
    def f(self) -> Array:
        """(k,) planned contact forces, stacked in the contact frames, N and N·m."""
        return to_array(self.record.force)

    @cached_property
    def contacts(self) -> ContactSet:
        """Contacts at their current positions and in their current frames, in O."""
        initial = self.grasp.contacts
        p_OC, R_OC = to_array(self.record.positions, -1, 3), self.memory.R_OC
        return ContactSet(p_OC, R_OC, initial.models, initial.mu, initial.gamma, initial.min_normal, initial.max_normal)

    @cached_property
    def w(self) -> Array:
        """(6,) wrench that the contacts must supply, about O's origin, in O, N and N·m."""
        return to_array(self.record.wrench)

    @cached_property
    def acceleration(self) -> Array:
        """(6,) commanded acceleration of the object in H, m/s² and rad/s²."""
        return to_array(self.record.acceleration)

    @cached_property
    def joint_acceleration(self) -> Array:
        """(n,) commanded joint accelerations, rad/s²."""
        return to_array(self.record.joint_acceleration)

    @cached_property
    def error(self) -> Array:
        """(6,) pose error of the object in H, m and rad."""
        return to_array(self.record.pose_error)

    @cached_property
    def slip_margin(self) -> Array:
        """(N,) slip margin μ f_n − ‖f_t‖ of each contact, N."""
        return to_array(self.record.slip_margin)

    @cached_property
    def guaranteed_margin(self) -> Array:
        """(N,) slip margin that remains for all torque errors of the drives, N."""
        given = self.record.guaranteed_margin
        return self.slip_margin if given is None else to_array(given)

    @cached_property
    def drive(self) -> DriveCommand:
        """What the drives of the joints take: the set-points of the last good command."""
        if self.record.drive is not None:
            return DriveCommand.from_dict(self.record.drive)
        tau = to_array(self.record.torque)
        return DriveMap(self.grasp.hand).set_points(tau, np.zeros(len(tau)), np.zeros(len(tau)))

    @property
    def saturated(self) -> bool:
        """True if a motor is at its limit."""
        return self.message.saturated

    @cached_property
    def uncontrollable(self) -> Array:
        """(m, 6) orthonormal directions in which the fingers cannot move the object, in H."""
        return to_array(self.record.uncontrollable, -1, 6)

    @cached_property
    def structural_wrench(self) -> Array:
        """(6,) part of `w` that the structure of the hand carries without motor torque, in O, N and N·m."""
        return to_array(self.record.borne)

    @cached_property
    def creep(self) -> Array:
        """(N,) recent sliding of each fingertip on the object, m."""
        creep = self.memory.creep
        return np.asarray(np.hypot(creep[:, 0], creep[:, 1]))

    @property
    def forces_reused(self) -> bool:
        """True if no certified forces were found, so that `f` are the forces of the last step."""
        return self.message.held

    @cached_property
    def memory(self) -> ControlMemory:
        """State of the controller after this step. Pass it on to continue from here."""
        return self.record.memory.unpack()

    @cached_property
    def solution(self) -> Solution | None:
        """Certified solution of the force problem; None in a stream."""
        return None if self.record.solution is None else Solution.from_dict(self.record.solution)

    @property
    def estimate(self) -> EstimateRecord | None:
        """Estimated state of the command; None in a stream without sensors."""
        return self.message.estimate

    @property
    def contact_change(self) -> ContactChangeRecord | None:
        """Fingers at the contacts, and whether they change; None in a stream whose contacts have not changed."""
        return self.message.contact_change

    @cached_property
    def clearance(self) -> LinkGap | None:
        """The nearest two bodies that must not touch, in the commands of `ControlSettings.clearance_steps`; None in others."""
        return None if self.record.clearance is None else self.record.clearance.unpack()

    @cached_property
    def winding_temperature(self) -> Array | None:
        """(n,) estimated temperatures of the motors' windings, °C; None without thermal data of the drives."""
        given = self.record.winding_temperature
        return None if given is None else to_array(given)

    @property
    def sequence(self) -> int | None:
        """Sequence number of the state or request that it answers."""
        return self.message.sequence

    @property
    def server_seconds(self) -> float:
        """Time from receipt to answer at the server, s."""
        return self.message.server_seconds

    def __str__(self) -> str:
        """Return a table of the contacts, and lines with the phase of the stream, torques and warnings."""
        number = "" if self.sequence is None else f" {self.sequence}"
        phase = "late, torque of the watchdog" if self.late else "resuming" if self.resuming else "in time"
        lines = [f"command{number} for {self.grasp.hand.name}: {phase}, age {1e3 * self.age:.2f} ms"]
        width = max(map(len, (*self.grasp.fingers, "contact")))
        lines.append(f"{'contact':<{width}}   f_t1 N   f_t2 N    f_n N  slip margin N  creep mm")
        forces, margins, creeps = self.contacts.pad(self.f).tolist(), self.slip_margin.tolist(), self.creep.tolist()
        for finger, (f_t1, f_t2, f_n, _), margin, creep in zip(self.grasp.fingers, forces, margins, creeps, strict=True):
            lines.append(f"{finger:<{width}} {f_t1:8.3f} {f_t2:8.3f} {f_n:8.3f} {margin:14.3f} {1e3 * creep:9.3f}")
        state = ", saturated" if self.saturated else ""
        lines.append(f"motor torques: {self.tau.min():.3f} to {self.tau.max():.3f} N·m{state}")
        return "\n".join([*lines, *(f"warning: {escape_controls(warning)}" for warning in self.warnings)])


class ClearanceRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The wire form of `Command.clearance`.

    Args:
        first: name of a body.
        second: name of the body nearest to it that it must not touch.
        distance: their distance, m.
        points: their nearest points in H, m.
    """

    first: str
    second: str
    distance: float
    points: tuple[tuple[float, float, float], tuple[float, float, float]]

    @classmethod
    def pack(cls, command: Command, steps: int, sequence: int = 0) -> ClearanceRecord | None:
        """Return the clearance of a command whose sequence number the steps divide; None for other commands.

        Args:
            command: the command.
            steps: `ControlSettings.clearance_steps`.
            sequence: sequence number of its state.
        """
        if steps == 0 or sequence % steps or command.clearance is None:
            return None
        gap = command.clearance
        return cls(gap.first, gap.second, gap.distance, gap.points.tolist())

    def unpack(self) -> LinkGap:
        """Return the two bodies."""
        return LinkGap(self.first, self.second, self.distance, freeze(np.array(self.points)))


class CommandRecord(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The wire form of `Command` and the memory after its step.

    Args:
        torque: motor torques, N·m.
        force: planned contact forces, stacked in the contact frames, N and N·m.
        positions: contact points in O, m; their frames are in the memory.
        wrench: wrench that the contacts must supply, about O's origin, in O, N and N·m.
        acceleration: commanded acceleration of the object in H, m/s² and rad/s².
        joint_acceleration: commanded joint accelerations, rad/s².
        pose_error: pose error of the object in H, m and rad.
        slip_margin: slip margin μ f_n − ‖f_t‖ of each contact, N.
        uncontrollable: orthonormal directions in which the fingers cannot move the object, in H, by rows.
        borne: part of `wrench` that the structure of the hand carries without motor torque, N and N·m.
        saturated: whether a motor is at its limit.
        held: whether no certified forces were found, so that `force` is that of the last step.
        warnings: messages for the user.
        memory: state of the controller after the step.
        late: whether the command of a stream was finished later than its validity.
        server_seconds: time from receipt to answer at the server, s.
        sequence: sequence number of the state or request.
        time: time of the state of a stream, on the sender's clock, s.
        solution: certified solution of the force problem, in the reply to a request.
        estimate: estimated state, in a stream with sensors.
        guaranteed_margin: slip margin that remains for all torque errors of drives that are not ideal, N.
        drive: set-points of drives that are not ideal.
        joints: names of the joints in the order of the torques, in the reply to a request.
        contact_change: fingers at the contacts, in a stream whose contacts have changed.
        clearance: nearest two bodies that must not touch, with `clearance_steps` in the settings.
        winding_temperature: estimated temperatures of the motors' windings, °C, in a stream whose drives have thermal data.
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
    estimate: EstimateRecord | None = None
    guaranteed_margin: WireVector | None = None
    drive: dict[str, Any] | None = None
    joints: tuple[str, ...] | None = None
    contact_change: ContactChangeRecord | None = None
    clearance: ClearanceRecord | None = None
    winding_temperature: WireVector | None = None

    @property
    def record(self) -> CommandRecord:
        """The record itself: it is complete."""
        return self

    @classmethod
    def pack(cls, command: Command, memory: ControlMemory, binary: bool = False, has_drive: bool = False) -> CommandRecord:
        """Return the wire form of a command.

        Args:
            command: the command.
            memory: memory after its step.
            binary: True for binary arrays, False for lists.
            has_drive: whether it has the set-points of the drives and the guaranteed margin, which ideal drives do not need.
        """
        write = np.ndarray.tobytes if binary else np.ndarray.tolist
        tips = memory.tip_contacts  # at the present contacts
        w, acceleration, joint_acceleration, error, slip_margin, uncontrollable, borne = read_step_arrays(command)
        return cls(
            torque=write(command.tau),
            force=write(command.f),
            positions=write(command.contacts.p_OC if tips is None else tips.p_OC),
            wrench=write(w),
            acceleration=write(acceleration),
            joint_acceleration=write(joint_acceleration),
            pose_error=write(error),
            slip_margin=write(slip_margin),
            uncontrollable=write(uncontrollable),
            borne=write(borne),
            saturated=command.saturated,
            held=command.forces_reused,
            warnings=command.warnings,
            memory=ControlMemoryRecord.pack(memory, binary),
            late=False,
            guaranteed_margin=write(command.guaranteed_margin) if has_drive else None,
            drive=command.drive.to_dict() if has_drive else None,
        )

    def unpack(self, grasp: Grasp) -> RemoteCommand:
        """Return the command.

        Args:
            grasp: grasp of the request or stream; it determines the sizes of the arrays.

        Raises:
            ValueError: an array other than the torque has the wrong size, or only some arrays are binary.
        """
        memory, tips = self.memory, self.memory.touched
        parts: tuple[Any, ...] = (
            *(self.joint_acceleration, self.wrench, self.acceleration, self.pose_error, self.borne, memory.integral),
            *(self.force, self.slip_margin, self.positions, memory.frames, memory.creep),
        )
        if memory.force is not None:
            parts = (*parts, memory.force)
        if tips is not None:
            parts = (*parts, tips.tips, tips.tip_frames, tips.positions)
        binary = type(self.force) is bytes
        if binary and not {bytes}.issuperset(map(type, (*parts, self.uncontrollable))):
            raise ValueError("either all arrays are binary, or none")
        unit, measure = (protocol.FLOAT_BYTES, len) if binary else (1, np.size)
        sizes = _part_sizes(
            grasp.hand.n, grasp.contacts.size, len(grasp.contacts), memory.force is not None, tips is not None, unit
        )
        if tuple(map(measure, parts)) != sizes or measure(self.uncontrollable) % (6 * unit):
            raise ValueError("an array has the wrong size")
        return RemoteCommand(to_array(self.torque), self.warnings, 0.0, self.late, False, self, grasp)


@cache
def _part_sizes(n: int, k: int, count: int, has_force: bool, has_tips: bool, unit: int) -> tuple[int, ...]:
    """Return the sizes of a command's arrays in the order of `unpack`.

    Args:
        n: number of joints.
        k: number of force components.
        count: number of contacts.
        has_force: whether the memory has forces.
        has_tips: whether the memory has tip contacts.
        unit: size of one number, 1 or the bytes of a float64.
    """
    sizes: tuple[int, ...] = (n, 6, 6, 6, 6, 6, k, count, 3 * count, 9 * count, 2 * count)
    sizes += (k,) if has_force else ()
    sizes += (3 * count, 9 * count, 3 * count) if has_tips else ()
    return tuple(unit * size for size in sizes)


def read_command(grasp: Grasp, record: object) -> RemoteCommand:
    """Read a command from its decoded record.

    Args:
        grasp: grasp of the request.
        record: the decoded answer.

    Raises:
        InvalidInput: not the record of a command.
    """
    try:
        return msgspec.convert(record, CommandRecord).unpack(grasp)
    except (msgspec.ValidationError, ValueError) as error:
        raise InvalidInput("input", "the record", f"a command ({error})") from None
