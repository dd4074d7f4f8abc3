"""Streams of joint-space laws: their setup, the states and the commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from graspforce.control.joints.force_controller import ForceController
from graspforce.control.joints.force_loop import ForceGains
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_controller import JOINT_LAWS, JointController
from graspforce.control.joints.joint_laws import PDGains, PIDGains, PIDMemory
from graspforce.control.settings import check_period
from graspforce.core import arrays, fields, records
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import DEFAULT_VALIDITY, served_hand

JOINTS = "joints"
"""The `kind` of a setup of a joint-space law."""
FORCE = "force"
"""The `law` of a force loop."""
LAWS = (*JOINT_LAWS, FORCE)
DEFAULT_PERIOD = 1e-3  # s

_GAINS: dict[str, tuple[type[PDGains] | type[PIDGains] | type[ForceGains], tuple[str, ...]]] = {
    "pd_gravity": (PDGains, ("kp", "kv")),
    "computed_torque": (PDGains, ("kp", "kv")),
    "pid": (PIDGains, ("kp", "ki", "kd")),
    FORCE: (ForceGains, ("kp", "ki", "kv")),
}
_MOTION = ("posture", "velocity", "acceleration")


@dataclass(frozen=True, eq=False, slots=True)
class JointStreamSetup:
    """Fixed parameters of a stream of a joint-space law.

    Args:
        controller: law, gains and gravity.
        period: control period, s, from 1e-6 to 10 (default 0.001).
        validity: largest age of a good command, s, from when its state was sent (default 0.02).
        integral: (n,) integral of an earlier stream to continue from, N·m; None for a new start.
        authenticated: whether states and commands have authentication codes (`graspforce.service.wire.stream_authentication`).

    Raises:
        InvalidInput: a value is not allowed.
    """

    controller: JointController | ForceController
    period: float = DEFAULT_PERIOD
    validity: float = DEFAULT_VALIDITY
    integral: Array | None = None
    authenticated: bool = False

    def __post_init__(self) -> None:
        validity = arrays.check_number(self.validity, "validity", above=0.0)
        records.set_fields(self, period=check_period(self.period), validity=validity)
        if self.integral is not None:
            records.set_fields(self, integral=arrays.check_array(self.integral, "integral", (self.hand.n,)))

    @property
    def hand(self) -> Hand:
        """The hand."""
        return self.controller.hand

    @property
    def law(self) -> str:
        """Name of the law on the wire."""
        return FORCE if isinstance(self.controller, ForceController) else self.controller.law

    def opens(self, other: JointStreamSetup) -> bool:
        """Return whether another setup opens the same stream: only the integral may differ.

        Args:
            other: setup of a repeated request.
        """
        mine, theirs = ({**each.to_dict(), "integral": None} for each in (self, other))
        return mine == theirs

    @classmethod
    def from_dict(cls, hands: Mapping[str, Hand], record: object) -> JointStreamSetup:
        """Read the setup from its record.

        Args:
            hands: the served hands by name.
            record: as `to_dict` returns it, or for a law of motion `frequency` (Hz) in place of `gains`; `gravity`, `period`,
                `validity` and `integral` may be absent or null.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
            UnknownName: the hand is not served.
        """
        optional = ["gains", "frequency", "gravity", "period", "validity", "integral", "authenticated"]
        values = fields.check_record(record, "", required=["kind", "hand", "law"], optional=optional)
        given = {name: value for name, value in values.items() if value is not None}
        hand, law = served_hand(hands, values["hand"]), fields.check_choice(values["law"], "law", LAWS)
        return cls(
            controller=_read_controller(hand, law, given),
            period=given.get("period", DEFAULT_PERIOD),
            validity=given.get("validity", DEFAULT_VALIDITY),
            integral=given.get("integral"),
            authenticated=fields.check_boolean(given.get("authenticated", False), "authenticated"),
        )

    def to_dict(self) -> JsonRecord:
        """Return the plain record: `kind`, `hand`, `law`, `gains`, `gravity`, `period`, `validity`, and `integral` if given."""
        gains, gravity = self.controller.gains, arrays.check_array(self.controller.gravity_H, "gravity", (3,))
        record = {
            "kind": JOINTS,
            "hand": self.hand.name,
            "law": self.law,
            "gains": {name: getattr(gains, name).tolist() for name in _GAINS[self.law][1]},
            "gravity": gravity.tolist(),
            "period": self.period,
            "validity": self.validity,
        }
        if self.authenticated:
            record["authenticated"] = True
        return record if self.integral is None else {**record, "integral": self.integral.tolist()}


@dataclass(frozen=True, eq=False, slots=True)
class JointState:
    """A state of a stream of a joint-space law.

    Args:
        sequence: number of the state; the command repeats it.
        time: when it was sent, on the sender's clock, s; the command repeats it.
        measured: measured positions and rates.
        desired: desired motion; None for the force loop.
        torque: (n,) measured contact torques of the force loop, N·m; None for other laws.
        torque_desired: (n,) desired contact torques of the force loop, N·m; None for other laws.
    """

    sequence: int
    time: float
    measured: JointMotion
    desired: JointMotion | None = None
    torque: Array | None = None
    torque_desired: Array | None = None

    @classmethod
    def decode(cls, setup: JointStreamSetup, payload: bytes, codec: str) -> JointState:
        """Read a state from its payload.

        Args:
            setup: setup of the stream.
            payload: the encoded record.
            codec: `protocol.JSON` or `protocol.MSGPACK`.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        names = ["sequence", "time", "measured", "desired"]
        values = fields.check_record(protocol.decode(payload, codec), "", required=names)
        n, is_force = setup.hand.n, setup.law == FORCE
        torques: dict[str, Array] = {}
        if is_force:
            required = ("posture", "velocity", "torque")
            measured = fields.check_record(values["measured"], "measured", required=required)
            desired = fields.check_record(values["desired"], "desired", required=["torque"])
            torques["torque"] = arrays.check_array(measured.pop("torque"), "measured.torque", (n,))
            torques["torque_desired"] = arrays.check_array(desired["torque"], "desired.torque", (n,))
        return cls(
            fields.check_integer(values["sequence"], "sequence", minimum=0, maximum=protocol.LARGEST_SEQUENCE),
            arrays.check_number(values["time"], "time"),
            _read_motion(measured if is_force else values["measured"], "measured", n),
            None if is_force else _read_motion(values["desired"], "desired", n),
            **torques,
        )

    def encode(self, codec: str) -> bytes:
        """Return the payload.

        Args:
            codec: `protocol.JSON` or `protocol.MSGPACK`.
        """
        measured: JsonRecord = {"posture": self.measured.q, "velocity": self.measured.v}
        if self.desired is not None:
            target: JsonRecord = dict(zip(_MOTION, (self.desired.q, self.desired.v, self.desired.a), strict=True))
        else:
            measured["torque"], target = self.torque, {"torque": self.torque_desired}
        record = {"sequence": self.sequence, "time": self.time, "measured": measured, "desired": target}
        return protocol.encode(record, codec)


class JointCommandRecord(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The wire form of `JointCommand`.

    Args:
        torque: motor torques within their limits, N·m.
        torque_unlimited: torques of the law, N·m.
        integral: integral after the step, N·m.
        late: whether the command was finished later than its validity.
        server_seconds: time from receipt to answer at the server, s.
        sequence: sequence number of the state.
        time: time of the state, on the sender's clock, s.
    """

    torque: list[float]
    torque_unlimited: list[float]
    integral: list[float]
    late: bool = False
    server_seconds: float = 0.0
    sequence: int | None = None
    time: float | None = None


@dataclass(frozen=True, eq=False)
class RemoteJointCommand:
    """A command from a server: the fields of `JointCommand`, and those of the stream.

    Attributes:
        tau: (n,) motor torques, N·m: the server's or the watchdog's.
        warnings: messages of the stream.
        age: time since the state that it answers was sent, s.
        late: True if the age exceeds the validity of the stream: the torque is the watchdog's.
        resuming: True while the torque moves back to the server's, by at most `Watchdog.step` per period.
        record: the command as it was received.
    """

    tau: Array
    warnings: tuple[str, ...]
    age: float
    late: bool
    resuming: bool
    record: JointCommandRecord

    @classmethod
    def unpack(cls, record: JointCommandRecord) -> RemoteJointCommand:
        """Return the command of a record.

        Args:
            record: the record.
        """
        return cls(freeze(record.torque), (), 0.0, record.late, False, record)

    @property
    def tau_unlimited(self) -> Array:
        """(n,) torques of the law without limits, N·m: those of the last good command."""
        return freeze(self.record.torque_unlimited)

    @property
    def integral(self) -> Array:
        """(n,) integral after the step, N·m."""
        return freeze(self.record.integral)

    @property
    def sequence(self) -> int | None:
        """Sequence number of the state that it answers."""
        return self.record.sequence


def _read_controller(hand: Hand, law: str, given: JsonRecord) -> JointController | ForceController:
    """Return the controller of a setup."""
    gravity = arrays.check_array(given.get("gravity", GRAVITY_PALM_UP), "gravity", (3,))
    if ("gains" in given) == ("frequency" in given):
        raise InvalidInput("gains", given.get("gains"), "given, or `frequency` in its place for a law of motion")
    if "frequency" in given:
        if law == FORCE:
            raise InvalidInput("frequency", given["frequency"], "absent: the force loop takes `gains`")
        return JointController.with_frequency(hand, law, given["frequency"], gravity)  # type: ignore[arg-type]
    kind, names = _GAINS[law]
    values = fields.check_record(given["gains"], "gains", required=names)
    for name in names:
        arrays.check_array(values[name], f"gains.{name}", (hand.n,))
    try:
        gains = kind(**values)
    except InvalidInput as error:
        raise error.with_prefix("gains") from None
    if isinstance(gains, ForceGains):
        return ForceController(hand, gains, gravity)
    return JointController(hand, law, gains, gravity)  # type: ignore[arg-type]


def _read_motion(record: object, field: str, n: int) -> JointMotion:
    """Return a motion of n joints; `velocity` and `acceleration` may be absent."""
    values = fields.check_record(record, field, required=["posture"], optional=_MOTION[1:])
    rows = [None if values.get(name) is None else arrays.check_array(values[name], f"{field}.{name}", (n,)) for name in _MOTION]
    q = arrays.check_array(values["posture"], f"{field}.posture", (n,))
    return JointMotion(q, rows[1], rows[2])


def continued_memory(setup: JointStreamSetup, state: JointState) -> PIDMemory | None:
    """Return the memory of the PID law at the begin of a stream; None for a new start.

    Args:
        setup: setup of the stream.
        state: its first state.
    """
    if setup.integral is None or state.desired is None:
        return None
    return PIDMemory(setup.integral, freeze(state.desired.q - state.measured.q))
