"""Streams of the phases of a grasp: their setup, the states and the commands. Frame: H hand base."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from graspforce.control import ControlSettings
from graspforce.control.drives.drive_commands import DriveCommand, DriveMap
from graspforce.control.phases.cycle_plan import BaseMotion, CyclePlan
from graspforce.control.phases.phase_rules import PhaseName
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_step import PhaseCommand
from graspforce.core import arrays, fields, records
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import DEFAULT_VALIDITY, served_hand

PHASES = "phases"
"""The `kind` of a setup of the phases of a grasp."""

_MAX_REASON_CHARACTERS = 200


@dataclass(frozen=True, eq=False, slots=True)
class PhaseStreamSetup:
    """Fixed parameters of a stream of the phases of a grasp.

    Args:
        plan: the plan.
        phases: settings of the phases.
        sensors: what the hand measures; their rate is the stream's.
        settings: settings of the object controller.
        validity: largest age of a good command, s, from when its state was sent (default 0.02).
        authenticated: whether states and commands have authentication codes (`graspforce.service.wire.stream_authentication`).

    Raises:
        InvalidInput: `validity` is not a finite number above 0.
    """

    plan: CyclePlan
    phases: PhaseSettings = dataclasses.field(default_factory=PhaseSettings)
    sensors: SensorModel = dataclasses.field(default_factory=SensorModel)
    settings: ControlSettings = dataclasses.field(default_factory=ControlSettings)
    validity: float = DEFAULT_VALIDITY
    authenticated: bool = False

    def __post_init__(self) -> None:
        records.set_fields(self, validity=arrays.check_number(self.validity, "validity", above=0.0))

    @property
    def hand(self) -> Hand:
        """The hand."""
        return self.plan.grasp.hand

    @property
    def period(self) -> float:
        """Control period, s."""
        return 1.0 / self.sensors.rate

    def opens(self, other: PhaseStreamSetup) -> bool:
        """Return whether another setup opens the same stream.

        Args:
            other: setup of a repeated request.
        """
        return self.to_dict() == other.to_dict()

    @classmethod
    def from_dict(cls, hands: Mapping[str, Hand], record: object) -> PhaseStreamSetup:
        """Read the setup from its record.

        Args:
            hands: the served hands by name.
            record: as `to_dict` returns it; all fields but `kind`, `hand` and `plan` may be absent or null.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
            UnknownName: the hand is not served.
        """
        optional = ["phases", "sensors", "settings", "validity", "authenticated"]
        values = fields.check_record(record, "", required=["kind", "hand", "plan"], optional=optional)
        given = {name: value for name, value in values.items() if value is not None}
        return cls(
            plan=CyclePlan.from_dict(values["plan"], served_hand(hands, values["hand"]), "plan"),
            phases=PhaseSettings.from_dict(given.get("phases", {}), "phases"),
            sensors=SensorModel.from_dict(given.get("sensors", {}), "sensors"),
            settings=ControlSettings.from_dict(given.get("settings", {}), "settings"),
            validity=given.get("validity", DEFAULT_VALIDITY),
            authenticated=fields.check_boolean(given.get("authenticated", False), "authenticated"),
        )

    def to_dict(self) -> JsonRecord:
        """Return the plain record: `kind`, `hand`, `plan`, `phases`, `sensors`, `settings` and `validity`."""
        record = {
            "kind": PHASES,
            "hand": self.hand.name,
            "plan": self.plan.to_dict(),
            "phases": self.phases.to_dict(),
            "sensors": self.sensors.to_dict(),
            "settings": self.settings.to_dict(),
            "validity": self.validity,
        }
        return {**record, "authenticated": True} if self.authenticated else record


@dataclass(frozen=True, eq=False, slots=True)
class PhaseState:
    """A state of a stream of phases.

    Args:
        sequence: number of the state; the command repeats it.
        time: when it was sent, on the sender's clock, s; the command repeats it.
        measurement: what the hand measured.
        stop: reason to stop the cycle with the safe stop of its phase; empty for none.
    """

    sequence: int
    time: float
    measurement: Measurement
    stop: str = ""

    @classmethod
    def decode(cls, hand: Hand, payload: bytes, codec: str) -> PhaseState:
        """Read a state from its payload.

        Args:
            hand: the hand of the stream.
            payload: the encoded record.
            codec: `protocol.JSON` or `protocol.MSGPACK`.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        names = ["sequence", "time", "measurement"]
        values = fields.check_record(protocol.decode(payload, codec), "", required=names, optional=["stop"])
        measurement = Measurement.from_dict(values["measurement"], "measurement")
        if len(measurement.q) != hand.n:
            allowed = f"a list of {hand.n}, one for each motor of {hand.name}"
            raise InvalidInput("measurement.posture", f"{len(measurement.q)} numbers", allowed)
        stop = fields.check_text(values["stop"], "stop") if values.get("stop") is not None else ""
        if len(stop) > _MAX_REASON_CHARACTERS:
            raise InvalidInput("stop", stop, f"at most {_MAX_REASON_CHARACTERS} characters")
        return cls(
            fields.check_integer(values["sequence"], "sequence", minimum=0, maximum=protocol.LARGEST_SEQUENCE),
            arrays.check_number(values["time"], "time"),
            measurement,
            stop,
        )

    def encode(self, codec: str) -> bytes:
        """Return the payload.

        Args:
            codec: `protocol.JSON` or `protocol.MSGPACK`.
        """
        record = {"sequence": self.sequence, "time": self.time, "measurement": self.measurement.to_dict()}
        return protocol.encode({**record, "stop": self.stop} if self.stop else record, codec)


class BaseMotionRecord(msgspec.Struct, forbid_unknown_fields=True):
    """The wire form of `BaseMotion`, in the axes of H.

    Args:
        position: displacement of the hand's base from its start, m.
        velocity: its velocity, m/s.
        acceleration: its acceleration, m/s².
    """

    position: list[float]
    velocity: list[float]
    acceleration: list[float]


class PhaseCommandRecord(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The wire form of `PhaseCommand`.

    Args:
        torque: motor torques, N·m.
        phase: name of the phase that made the command.
        base: motion of the hand's base, for the arm.
        touching: sign of contact of each finger; empty for fingers without.
        normal_force: planned normal forces, N; zero in phases without planned forces.
        message: why the cycle has stopped; empty while it runs.
        t: time of the measurement since the start of the cycle, s.
        posture: estimated joint positions when the torques act, rad.
        velocity: estimated joint rates when the torques act, rad/s.
        slip_margin: least slip margin of the planned forces, N; absent without planned forces.
        drive: set-points of drives that are not ideal.
        late: whether the command was finished later than its validity.
        server_seconds: time from receipt to answer at the server, s.
        sequence: sequence number of the state.
        time: time of the state, on the sender's clock, s.
    """

    torque: list[float]
    phase: str
    base: BaseMotionRecord
    touching: list[str]
    normal_force: list[float]
    message: str
    t: float
    posture: list[float]
    velocity: list[float]
    slip_margin: float | None = None
    drive: dict[str, Any] | None = None
    late: bool = False
    server_seconds: float = 0.0
    sequence: int | None = None
    time: float | None = None

    @classmethod
    def pack(cls, command: PhaseCommand, has_drive: bool) -> PhaseCommandRecord:
        """Return the wire form of a command.

        Args:
            command: the command.
            has_drive: whether it has the set-points of the drives, which ideal drives do not need.
        """
        q, v = command.joints
        base = BaseMotionRecord(*(each.tolist() for each in command.base))
        return cls(
            torque=command.tau.tolist(),
            phase=command.phase,
            base=base,
            touching=list(command.touching),
            normal_force=command.f_normal.tolist(),
            message=command.message,
            t=command.t,
            posture=q.tolist(),
            velocity=v.tolist(),
            slip_margin=None if np.isnan(command.slip_margin) else command.slip_margin,
            drive=command.drive.to_dict() if has_drive else None,
        )


@dataclass(frozen=True, eq=False)
class RemotePhaseCommand:
    """A command from a server: the fields of `PhaseCommand`, and those of the stream.

    If the torque is the watchdog's (`late` or `resuming`), the other fields but `base` are those of the last good command.

    Attributes:
        tau: (n,) motor torques, N·m: the server's or the watchdog's.
        base: motion of the hand's base, for the arm; it brakes while the command is late.
        warnings: messages of the stream.
        age: time since the state that it answers was sent, s.
        late: True if the age exceeds the validity of the stream: the torque is the watchdog's.
        resuming: True while the torque moves back to the server's, by at most `Watchdog.step` per period.
        record: the command as it was received.
        hand: the hand.
    """

    tau: Array
    base: BaseMotion
    warnings: tuple[str, ...]
    age: float
    late: bool
    resuming: bool
    record: PhaseCommandRecord
    hand: Hand

    @classmethod
    def unpack(cls, record: PhaseCommandRecord, hand: Hand) -> RemotePhaseCommand:
        """Return the command of a record.

        Args:
            record: the record.
            hand: the hand of the stream.

        Raises:
            ValueError: the base's motion has the wrong size.
        """
        p, v, a = (freeze(each) for each in (record.base.position, record.base.velocity, record.base.acceleration))
        if not p.shape == v.shape == a.shape == (3,):
            raise ValueError("an array has the wrong size")
        return cls(freeze(record.torque), BaseMotion(p, v, a), (), 0.0, record.late, False, record, hand)

    @property
    def phase(self) -> PhaseName:
        """Name of the phase that made the command."""
        return self.record.phase  # type: ignore[return-value]

    @property
    def t(self) -> float:
        """Time of the measurement since the start of the cycle, s."""
        return self.record.t

    @property
    def touching(self) -> tuple[str, ...]:
        """(N,) signs of contact of the guarded close; empty for fingers without."""
        return tuple(self.record.touching)

    @property
    def f_normal(self) -> Array:
        """(N,) planned normal forces, N; zero in phases without planned forces."""
        return freeze(self.record.normal_force)

    @property
    def slip_margin(self) -> float:
        """Least slip margin of the planned forces, N; NaN without planned forces."""
        return float("nan") if self.record.slip_margin is None else self.record.slip_margin

    @property
    def message(self) -> str:
        """Why the cycle has stopped; empty while it runs."""
        return self.record.message

    @property
    def joints(self) -> tuple[Array, Array]:
        """Estimated positions, rad, and rates, rad/s, of the joints when the torques act."""
        return freeze(self.record.posture), freeze(self.record.velocity)

    @property
    def drive(self) -> DriveCommand:
        """Set-points of the drives: those of the last good command."""
        if self.record.drive is not None:
            return DriveCommand.from_dict(self.record.drive)
        return DriveMap(self.hand).set_points(freeze(self.record.torque), *self.joints)

    @property
    def sequence(self) -> int | None:
        """Sequence number of the state that it answers."""
        return self.record.sequence
