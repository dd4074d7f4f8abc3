"""The state that a driver sends in each period of a stream: exact, or as measured. Frames: H hand base, O object.

In JSON, arrays are lists. In MessagePack each array is a list, or binary: its float64 numbers, little-endian, by rows. If
`posture` is binary, the arrays of the command are binary too. Binary arrays avoid a Python object for each number.

Decoding exact states has fast paths: compiled code for MessagePack with the fields in their order, and typed structs. Both
check all numbers together. A state that fails there is read again by `StreamState.from_dict`, which names the invalid field.
Measurements are always read there.
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
from graspforce.core.compiled import native
from graspforce.core.constants import LARGEST_DISTANCE
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
# Shapes of binary matrices by name; other binary arrays are vectors.
_MATRIX_SHAPES = {"rotation": (3, 3), "covariance": (6, 6), "tip_wrenches": (-1, 6), "contact_points": (-1, 3)}
_OBJECT_NUMBERS = 18  # position, rotation and twist of the object
STACKED_NUMBERS = "measured"
"""Field of the block of a state: joint positions and rates, and position, rotation and twist of the object."""


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
            return _decode_fast(payload, codec, hand)
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
            state = Measurement.from_dict(to_lists(given), "measurement")
        else:
            state = GraspState.from_dict(to_lists(given), hand.n, "state")
        conditions, fingers = _read_conditions(values.get("conditions"))
        return cls(
            fields.check_integer(values["sequence"], "sequence", minimum=0, maximum=protocol.LARGEST_SEQUENCE),
            arrays.check_number(values["time"], "time"),
            state,
            desired_from_dict(to_lists(values["desired"]), hand.n, "desired"),
            read_external(to_lists(values.get("external"))),
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

_encode_record = msgspec.msgpack.Encoder().encode


def msgpack_from_json(payload: bytes) -> bytes | None:
    """Return an exact state of JSON in MessagePack, with its fields in order; None if it is not an exact state.

    Args:
        payload: the state in JSON.
    """
    try:
        return _encode_record(_STATE_DECODERS[protocol.JSON].decode(payload))
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError):  # OverflowError: an integer above 64 bits
        return None


_make_motion = unchecked_constructor(BodyMotion)
_make_grasp_state = unchecked_constructor(GraspState)
_make_grasp_motion = unchecked_constructor(GraspMotion)


def _decode_fast(payload: bytes, codec: str, hand: Hand) -> StreamState:
    """Return an exact state. Its arrays are views of one block, whose numbers are checked once.

    Raises:
        ValueError: a number, a shape or a rotation is wrong.
        TypeError: a number is no float.
    """
    if native is not None and codec == protocol.MSGPACK:
        found = native.read_stream_state(payload, hand.n)
        if found is not None:
            sequence, time, flags, numbers = found
            _check_usual(numbers)
            binary, has_joints = bool(flags & native.STATE_BINARY), bool(flags & native.STATE_JOINTS)
            state, desired, wrench = _view_block(hand.n, has_joints, bool(flags & native.STATE_EXTERNAL), numbers)
            return StreamState(sequence, time, state, desired, wrench, None, binary)
    return _state_of(_STATE_DECODERS[codec].decode(payload), hand)


def _check_usual(numbers: bytes) -> None:
    """Raise ValueError if the numbers of a state may be out of range: then they are read and checked one by one."""
    if native is not None:
        is_usual = native.is_plausible_state(numbers, None, 0.0, usual_range(len(numbers) // 8))
    else:
        is_usual = np.abs(np.frombuffer(numbers)).max() <= LARGEST_DISTANCE
    if not is_usual:
        raise ValueError("a number may be out of range")


@cache
def usual_range(count: int) -> Array:
    """Return the rules of numbers within the least of all bounds, as `is_plausible_state` in C takes them, (4, count).

    Args:
        count: number of numbers.
    """
    return np.repeat([[0.0], [LARGEST_DISTANCE], [math.inf], [math.inf]], count, axis=1)


def _state_of(record: _StateRecord[Any, Any], hand: Hand) -> StreamState:
    """Return the state of a record. Raises ValueError and TypeError as `_decode_fast`."""
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
    n, has_joints, has_external = hand.n, joints is not None, external is not None
    shapes = _part_shapes(n, has_joints, has_external)
    join = _join_parts if native is None else native.join_stream_state
    numbers = join(parts, shapes, n)
    if numbers is None or not (math.isfinite(record.time) and 0 <= record.sequence <= protocol.LARGEST_SEQUENCE):
        raise ValueError("a number is not finite, or out of range")
    _check_usual(numbers)
    state, desired, wrench = _view_block(n, has_joints, has_external, numbers)
    binary = type(measured.posture) is bytes
    if record.conditions is None and record.contacts is None:
        return StreamState(record.sequence, record.time, state, desired, wrench, None, binary)
    conditions, fingers = _read_conditions(record.conditions)
    change = _read_change(record.contacts, hand)
    return StreamState(record.sequence, record.time, state, desired, wrench, conditions, binary, change, fingers)


def _join_parts(parts: tuple[Any, ...], shapes: tuple[tuple[int, int], ...], n: int) -> bytes | None:
    """Return the float64 numbers of a state's arrays; None if one is not finite, or a matrix is no rotation.

    Raises:
        ValueError: an array has the wrong shape.
    """
    joined = b"".join(map(_to_bytes, parts, shapes))
    numbers = np.frombuffer(joined).tolist()
    # The sum is finite only if all numbers are. If it overflows, the slow path decides.
    is_valid = math.isfinite(sum(numbers)) and all(
        arrays.is_rotation(numbers[start : start + 9]) for start in (2 * n + 3, 2 * n + 21)
    )
    return joined if is_valid else None


def _view_block(n: int, has_joints: bool, has_external: bool, numbers: bytes) -> tuple[GraspState, DesiredMotion, Array | None]:
    """Return the state, the desired motion and the external wrench of checked numbers."""
    block = np.ndarray((), block_layout(n, has_joints, has_external), numbers)
    now = _make_motion(block["p_HO"], block["R_HO"], block["twist"], _ZEROS)
    desired: DesiredMotion = _make_motion(block["p_d"], block["R_d"], block["twist_d"], block["acceleration_d"])
    if has_joints:
        desired = _make_grasp_motion(desired, block["q_d"], block["v_d"], block["a_d"])
    return _make_grasp_state(block["q"], block["v"], now), desired, block["external"] if has_external else None


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
    return None if record is None else NumberedChange.from_dict(to_lists(record), hand)


def _conditions_to_dict(state: StreamState) -> JsonRecord | None:
    """Return the record of a state's conditions with the names of their fingers, or None."""
    if state.conditions is None:
        return None
    return {**state.conditions.to_dict(), **({} if state.fingers is None else {"fingers": list(state.fingers)})}


def _block_fields(n: int, joints: bool, external: bool) -> list[tuple[str, tuple[int, ...]]]:
    """Return the names and shapes of a state's arrays in their order on the wire, for a hand with n joints."""
    motion = [("p_d", (3,)), ("R_d", (3, 3)), ("twist_d", (6,)), ("acceleration_d", (6,))]
    shapes: list[tuple[str, tuple[int, ...]]] = [("q", (n,)), ("v", (n,)), ("p_HO", (3,)), ("R_HO", (3, 3)), ("twist", (6,))]
    shapes += motion
    shapes += [(name, (n,)) for name in ("q_d", "v_d", "a_d")] if joints else []
    return [*shapes, ("external", (6,))] if external else shapes


@cache
def _part_shapes(n: int, joints: bool, external: bool) -> tuple[tuple[int, int], ...]:
    """Return rows and columns of a state's arrays; a vector has one row."""
    return tuple((1 if len(shape) == 1 else shape[0], shape[-1]) for _, shape in _block_fields(n, joints, external))


@cache
def block_layout(n: int, joints: bool, external: bool) -> np.dtype[np.void]:
    """Return the layout of a state's numbers. Its field `STACKED_NUMBERS` overlaps the five arrays that were measured.

    Args:
        n: number of joints.
        joints: whether the state has desired joint motions.
        external: whether it has an external wrench.
    """
    given = _block_fields(n, joints, external)
    sizes = [_FLOAT_BYTES * math.prod(shape) for _, shape in given]
    return np.dtype(
        {
            "names": [STACKED_NUMBERS, *(name for name, _ in given)],
            "formats": [("f8", (2 * n + _OBJECT_NUMBERS,)), *(("f8", shape) for _, shape in given)],
            "offsets": [0, *(sum(sizes[:i]) for i in range(len(sizes)))],
            "itemsize": sum(sizes),
        }
    )


def _to_bytes(values: Any, shape: tuple[int, int]) -> bytes:
    """Return the float64 bytes of an array: bytes, or a list, with a list for each row of a matrix.

    Raises:
        ValueError: it has another shape.
    """
    if type(values) is bytes:
        joined = values
    else:
        numbers = np.array(values, dtype=np.float64)
        if numbers.shape not in (shape, shape[1:]) or (numbers.ndim == 2 and shape[0] == 1):
            raise ValueError("an array has the wrong shape")
        joined = numbers.tobytes()
    if len(joined) != _FLOAT_BYTES * math.prod(shape):
        raise ValueError("an array has the wrong size")
    return joined


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


def to_lists(value: Any, name: str = "") -> Any:
    """Return a record with lists in place of binary arrays. Other bytes are kept, and fail a later check.

    Args:
        value: the record, or a part of it.
        name: field of the part: it determines the shape of a matrix.
    """
    if isinstance(value, Mapping):
        return {name: to_lists(item, name) for name, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return [to_lists(item) for item in value]
    if not isinstance(value, bytes) or len(value) % _FLOAT_BYTES:
        return value
    numbers, shape = np.frombuffer(value), _MATRIX_SHAPES.get(name, (-1,))
    fits = numbers.size % shape[-1] == 0 if shape[0] < 0 else numbers.size == math.prod(shape)
    return (numbers.reshape(shape) if fits else numbers).tolist()
