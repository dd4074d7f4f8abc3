"""The state that a driver sends in each period of a stream: exact, or as measured. Frames: H hand base, O object.

In JSON, arrays are lists. In MessagePack each array is a list, or binary: its float64 numbers, little-endian, by rows. If
`posture` is binary, the arrays of the command are binary too. Binary arrays avoid a Python object for each number.

Decoding exact states has a fast path: typed structs, and one check of all numbers together. A state that fails there is read
again by `StreamState.from_dict`, which names the invalid field. Measurements are always read there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control import DesiredMotion, GraspMotion, GraspState, desired_from_dict, object_motion
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import unchecked_constructor
from graspforce.estimation.measurement import Measurement
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.change_records import NumberedChange
from graspforce.service.wire.control_records import read_external

V = TypeVar("V")  # wire type of a vector
M = TypeVar("M")  # wire type of a matrix
_ZEROS = arrays.freeze(np.zeros(6))
_FLOAT_BYTES = 8  # bytes of a float64
# Shapes of the arrays that follow posture and velocity: position, rotation and twist of the object; the desired position,
# rotation, twist and acceleration.
# Shapes of binary matrices by name; other binary arrays are vectors.
_MATRIX_SHAPES = {"rotation": (3, 3), "covariance": (6, 6), "tip_wrenches": (-1, 6), "contact_points": (-1, 3)}
_MOTION_SHAPES = ((3,), (3, 3), (6,), (3,), (3, 3), (6,), (6,))


class StreamState(msgspec.Struct, frozen=True, eq=False):
    """A state of a stream.

    Args:
        sequence: number of the state; the command repeats it.
        time: when it was sent, on the sender's clock, s; the command repeats it.
        state: state of hand and object, or what the hand measured if the stream has sensors.
        desired: desired motion of the object, or of object and joints.
        external: (6,) estimated wrench on the object apart from gravity and finger forces, about O's origin, in O, N and N·m.
            None for zero.
        conditions: slip, friction and lost drives of the contacts; None for contacts as modelled.
        binary: True if the posture was binary; the arrays of the command then are too.
        contacts: change of the contacts to begin; None for none. States may repeat it.
        fingers: names of the fingers in the order of `conditions`; None for those of the present contacts.
    """

    sequence: int
    time: float
    state: GraspState | Measurement
    desired: DesiredMotion
    external: Array | None = None
    conditions: ContactConditions | None = None
    binary: bool = False
    contacts: NumberedChange | None = None
    fingers: tuple[str, ...] | None = None

    @classmethod
    def decode(cls, hand: Hand, payload: bytes, codec: str) -> StreamState:
        """Read a state from its payload.

        Args:
            hand: the hand of the stream.
            payload: the encoded record.
            codec: `protocol.JSON` or `protocol.MSGPACK`.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        try:
            return _decode_fast(_STATE_DECODERS[codec].decode(payload), hand)
        except (msgspec.MsgspecError, ValueError, TypeError, RecursionError):  # ValueError: ragged lists, and InvalidInput
            return cls.from_dict(hand, protocol.decode(payload, codec))

    def encode(self, codec: str) -> bytes:
        """Return the payload, in MessagePack with binary arrays.

        Args:
            codec: `protocol.JSON` or `protocol.MSGPACK`.
        """
        is_plain = codec == protocol.JSON or isinstance(self.state, Measurement)
        return protocol.encode(self.to_dict() if is_plain else _to_binary_record(self), codec)

    @classmethod
    def from_dict(cls, hand: Hand, record: object) -> StreamState:
        """Read a state from its record.

        Args:
            hand: the hand of the stream.
            record: as `to_dict` returns it, or with binary arrays; `external` may be absent or null. It has either `state`, or
                `measurement` as in `Measurement.to_dict`.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = ["state", "measurement", "external", "conditions", "contacts"]
        values = fields.check_record(record, "", required=["sequence", "time", "desired"], optional=optional)
        given = values.get("measurement") if values.get("state") is None else values["state"]
        if given is None:
            raise InvalidInput("state", None, "given, or `measurement` in a stream with sensors")
        if values.get("measurement") is not None and values.get("state") is not None:
            raise InvalidInput("state", "a state beside a measurement", "absent, or without `measurement`")
        state: GraspState | Measurement
        if values.get("state") is None:
            state = Measurement.from_dict(_to_lists(given), "measurement")
        else:
            state = GraspState.from_dict(_to_lists(given), hand.n, "state")
        conditions, fingers = _read_conditions(values.get("conditions"))
        return cls(
            fields.check_integer(values["sequence"], "sequence", minimum=0, maximum=protocol.LARGEST_SEQUENCE),
            arrays.check_number(values["time"], "time"),
            state,
            desired_from_dict(_to_lists(values["desired"]), hand.n, "desired"),
            read_external(_to_lists(values.get("external"))),
            conditions,
            isinstance(given["posture"], bytes),
            _read_change(values.get("contacts"), hand),
            fingers,
        )

    def to_dict(self) -> JsonRecord:
        """Return the plain record, its arrays as lists."""
        record = {
            "sequence": self.sequence,
            "time": self.time,
            "measurement" if isinstance(self.state, Measurement) else "state": self.state.to_dict(),
            "desired": self.desired.to_dict(),
        }
        if self.external is not None:
            record["external"] = self.external.tolist()
        if self.conditions is not None:
            record["conditions"] = _conditions_to_dict(self)
        if self.contacts is not None:
            record["contacts"] = self.contacts.to_dict()
        return record


class _ObjectRecord(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True):
    position: V
    rotation: M
    twist: V


class _JointsRecord(msgspec.Struct, Generic[V], forbid_unknown_fields=True):
    posture: V
    velocity: V
    acceleration: V


class _MotionRecord(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True, omit_defaults=True):
    position: V
    rotation: M
    twist: V
    acceleration: V
    joints: _JointsRecord[V] | None = None


class _GraspStateRecord(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True):
    posture: V
    velocity: V
    object: _ObjectRecord[V, M]


class _StateRecord(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True, omit_defaults=True):
    sequence: int
    time: float
    state: _GraspStateRecord[V, M]
    desired: _MotionRecord[V, M]
    external: V | None = None
    conditions: dict[str, Any] | None = None
    contacts: dict[str, Any] | None = None


_STATE_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(_StateRecord[bytes | list[float], bytes | list[list[float]]]),
    protocol.JSON: msgspec.json.Decoder(_StateRecord[list[float], list[list[float]]]),
}

_make_motion = unchecked_constructor(BodyMotion)
_make_grasp_state = unchecked_constructor(GraspState)
_make_grasp_motion = unchecked_constructor(GraspMotion)


def _decode_fast(record: _StateRecord[Any, Any], hand: Hand) -> StreamState:
    """Return the state of a hand. Its arrays are views of one array, which is checked once.

    Raises:
        ValueError: a number, a shape or a rotation is wrong.
        TypeError: lists and binary arrays are mixed.
    """
    measured, pose = record.state, record.state.object
    motion, joints, external = record.desired, record.desired.joints, record.external
    parts: tuple[Any, ...] = (
        *(measured.posture, measured.velocity, pose.position, pose.rotation, pose.twist),
        *(motion.position, motion.rotation, motion.twist, motion.acceleration),
    )
    if joints is not None:
        parts = (*parts, joints.posture, joints.velocity, joints.acceleration)
    if external is not None:
        parts = (*parts, external)
    binary, n = type(measured.posture) is bytes, hand.n
    shapes, lengths = _part_shapes(n, joints is not None, external is not None)
    if not binary:
        parts = tuple(map(_to_bytes, parts, shapes))
    if tuple(map(len, parts)) != lengths:
        raise ValueError("an array has the wrong size")
    x = np.frombuffer(b"".join(parts))
    numbers = x.tolist()
    # The sum is finite only if all numbers are, and costs less than np.isfinite. If it overflows, the slow path decides.
    if not (math.isfinite(sum(numbers) + record.time) and 0 <= record.sequence <= protocol.LARGEST_SEQUENCE):
        raise ValueError("a number is not finite, or out of range")
    m = 2 * n
    if not (arrays.is_rotation(numbers[m + 3 : m + 12]) and arrays.is_rotation(numbers[m + 21 : m + 30])):
        raise ValueError("a matrix is not a rotation")
    now = _make_motion(x[m : m + 3], x[m + 3 : m + 12].reshape(3, 3), x[m + 12 : m + 18], _ZEROS)
    desired: DesiredMotion = _make_motion(
        x[m + 18 : m + 21], x[m + 21 : m + 30].reshape(3, 3), x[m + 30 : m + 36], x[m + 36 : m + 42]
    )
    if joints is not None:
        q, v, a = x[m + 42 : m + 42 + 3 * n].reshape(3, n)
        desired = _make_grasp_motion(desired, q, v, a)
    wrench = None if external is None else x[-6:]
    state = _make_grasp_state(x[:n], x[n:m], now)
    if record.conditions is None and record.contacts is None:
        return StreamState(record.sequence, record.time, state, desired, wrench, None, binary)
    conditions, fingers = _read_conditions(record.conditions)
    change = _read_change(record.contacts, hand)
    return StreamState(record.sequence, record.time, state, desired, wrench, conditions, binary, change, fingers)


def _read_conditions(record: object) -> tuple[ContactConditions | None, tuple[str, ...] | None]:
    """Return the conditions of a record, and the names of their fingers, both None if absent."""
    if record is None:
        return None, None
    values = dict(record) if isinstance(record, Mapping) else record
    given = values.pop("fingers", None) if isinstance(values, dict) else None
    fingers = None
    if given is not None:
        names = fields.check_sequence(given, "conditions.fingers")
        fingers = tuple(fields.check_text(name, f"conditions.fingers[{i}]") for i, name in enumerate(names))
    return ContactConditions.from_dict(values), fingers


def _read_change(record: object, hand: Hand) -> NumberedChange | None:
    """Return the change of a record, or None."""
    return None if record is None else NumberedChange.from_dict(_to_lists(record), hand)


def _conditions_to_dict(state: StreamState) -> JsonRecord | None:
    """Return the record of a state's conditions with the names of their fingers, or None."""
    if state.conditions is None:
        return None
    return {**state.conditions.to_dict(), **({} if state.fingers is None else {"fingers": list(state.fingers)})}


@cache
def _part_shapes(n: int, joints: bool, external: bool) -> tuple[tuple[tuple[int, ...], ...], tuple[int, ...]]:
    """Return the shapes and byte counts of a state's arrays for a hand with n joints."""
    shapes = ((n,), (n,), *_MOTION_SHAPES, *([(n,)] * 3 if joints else []), *([(6,)] if external else []))
    return shapes, tuple(_FLOAT_BYTES * math.prod(shape) for shape in shapes)


def _to_bytes(values: Any, shape: tuple[int, ...]) -> bytes:
    """Return the float64 bytes of a list of the given shape; a binary array stays as it is."""
    if type(values) is bytes:
        return values
    numbers = np.array(values, dtype=np.float64)
    if numbers.shape != shape:
        raise ValueError("an array has the wrong shape")
    return numbers.tobytes()


def _to_binary_record(state: StreamState) -> _StateRecord[bytes, bytes]:
    """Return the wire form of an exact state with binary arrays."""
    assert isinstance(state.state, GraspState)  # encode() has sorted out measurements
    measured, pose, motion = state.state, state.state.object, object_motion(state.desired)
    desired = _MotionRecord(motion.p_HO.tobytes(), motion.R_HO.tobytes(), motion.twist.tobytes(), motion.acceleration.tobytes())
    if isinstance(state.desired, GraspMotion):
        desired.joints = _JointsRecord(state.desired.q.tobytes(), state.desired.v.tobytes(), state.desired.a.tobytes())
    body = _ObjectRecord(pose.p_HO.tobytes(), pose.R_HO.tobytes(), pose.twist.tobytes())
    grasp_state = _GraspStateRecord(measured.q.tobytes(), measured.v.tobytes(), body)
    external = None if state.external is None else state.external.tobytes()
    change = None if state.contacts is None else state.contacts.to_dict()
    return _StateRecord(state.sequence, state.time, grasp_state, desired, external, _conditions_to_dict(state), change)


def _to_lists(value: Any, name: str = "") -> Any:
    """Return a record with lists in place of binary arrays. Other bytes are kept, and fail a later check."""
    if isinstance(value, Mapping):
        return {name: _to_lists(item, name) for name, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return [_to_lists(item) for item in value]
    if not isinstance(value, bytes) or len(value) % _FLOAT_BYTES:
        return value
    numbers, shape = np.frombuffer(value), _MATRIX_SHAPES.get(name, (-1,))
    fits = numbers.size % shape[-1] == 0 if shape[0] < 0 else numbers.size == math.prod(shape)
    return (numbers.reshape(shape) if fits else numbers).tolist()
