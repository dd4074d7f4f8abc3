"""What a driver sends each period. Frames: H hand base, O object.

In JSON its arrays are lists. In MessagePack they may be lists, or binary: their float64, little-endian, by rows; the command's
then are so too, which spares both ends a Python object for every number. States have a quick way in: typed structs, all numbers
in one array, and that looked at once. What does not pass there is read again slowly, to be named by its path.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control import DesiredMotion, GraspMotion, GraspState, desired_from_dict, object_motion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import read_external

V = TypeVar("V")  # a row of numbers as it is on the wire
M = TypeVar("M")  # rows of them
_ZEROS = arrays.freeze(np.zeros(6))
_BYTES = 8  # of a float64
# The arrays in their order here, after posture and velocity: the object as it is, and as it should be.
_SHAPES = ((3,), (3, 3), (6,), (3,), (3, 3), (6,), (6,))


class StreamState(msgspec.Struct, frozen=True, eq=False):
    """A state of a stream.

    Args:
        sequence: the sender's number of this state, repeated in the command.
        time: the sender's clock when it was sent, s, repeated in the command.
        state: hand and object as measured.
        desired: the desired motion, of the object or of object and joints.
        external: (6,) an estimate of the wrench on the object that is neither gravity nor the fingers', about O's origin, in O,
            N and N·m; None for none.
        packed: its posture came as binary, and the command's arrays are to go so.
    """

    sequence: int
    time: float
    state: GraspState
    desired: DesiredMotion
    external: Array | None = None
    binary: bool = False

    @classmethod
    def decode(cls, hand: Hand, payload: bytes, codec: str) -> StreamState:
        """From the bytes of a sample.

        Raises:
            InvalidInput: a field that is missing, unknown, or holds what it may not; named with its path.
        """
        try:
            return _decode_fast(_STATE_DECODERS[codec].decode(payload), hand.n)
        except (msgspec.MsgspecError, ValueError, TypeError, RecursionError):  # ValueError: ragged lists, and InvalidInput
            return cls.from_dict(hand, protocol.decode(payload, codec))

    def encode(self, codec: str) -> bytes:
        """The bytes of a sample: in MessagePack with binary arrays."""
        return protocol.encode(self.to_dict() if codec == protocol.JSON else _to_binary_record(self), codec)

    @classmethod
    def from_dict(cls, hand: Hand, record: Mapping[str, Any]) -> StreamState:
        """From the state as it is on the wire.

        Raises:
            InvalidInput: a field that is missing, unknown, or holds what it may not; named with its path.
        """
        values = fields.check_record(record, "", required=["sequence", "time", "state", "desired"], optional=["external"])
        state = values["state"]
        return cls(
            fields.check_integer(values["sequence"], "sequence", minimum=0, maximum=protocol.LARGEST_SEQUENCE),
            arrays.check_number(values["time"], "time"),
            GraspState.from_dict(_to_lists(state), hand.n, "state"),
            desired_from_dict(_to_lists(values["desired"]), hand.n, "desired"),
            read_external(_to_lists(values.get("external"))),
            isinstance(state["posture"], bytes),
        )

    def to_dict(self) -> dict[str, Any]:
        """The state as it is on the wire, its arrays lists."""
        record = {
            "sequence": self.sequence,
            "time": self.time,
            "state": self.state.to_dict(),
            "desired": self.desired.to_dict(),
        }
        return record if self.external is None else {**record, "external": self.external.tolist()}


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


_STATE_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(_StateRecord[bytes | list[float], bytes | list[list[float]]]),
    protocol.JSON: msgspec.json.Decoder(_StateRecord[list[float], list[list[float]]]),
}


def _decode_fast(sent: _StateRecord[Any, Any], n: int) -> StreamState:
    """A state of a hand of n joints, its arrays parts of one that has been checked.

    Raises:
        ValueError: a wrong number, shape or rotation.
        TypeError: lists beside binary arrays.
    """
    measured, object_state, wanted, joints, external = (
        sent.state,
        sent.state.object,
        sent.desired,
        sent.desired.joints,
        sent.external,
    )
    parts: tuple[Any, ...] = (
        *(measured.posture, measured.velocity, object_state.position, object_state.rotation, object_state.twist),
        *(wanted.position, wanted.rotation, wanted.twist, wanted.acceleration),
    )
    if joints is not None:
        parts = (*parts, joints.posture, joints.velocity, joints.acceleration)
    if external is not None:
        parts = (*parts, external)
    binary = type(measured.posture) is bytes
    shapes, lengths = _sizes(n, joints is not None, external is not None)
    if not binary:
        parts = tuple(map(_to_bytes, parts, shapes))
    if tuple(map(len, parts)) != lengths:
        raise ValueError("a length")
    x = np.frombuffer(b"".join(parts))
    numbers = x.tolist()
    # The sum is finite where all are. Where it overflows the slow way tells; NumPy's own question costs more when asked rarely.
    if not (math.isfinite(sum(numbers) + sent.time) and 0 <= sent.sequence <= protocol.LARGEST_SEQUENCE):
        raise ValueError("a number")
    m = 2 * n
    if not (arrays.is_rotation(numbers[m + 3 : m + 12]) and arrays.is_rotation(numbers[m + 21 : m + 30])):
        raise ValueError("a rotation")
    now = _make_motion(x[m : m + 3], x[m + 3 : m + 12].reshape(3, 3), x[m + 12 : m + 18], _ZEROS)
    desired = _make_motion(x[m + 18 : m + 21], x[m + 21 : m + 30].reshape(3, 3), x[m + 30 : m + 36], x[m + 36 : m + 42])
    if joints is not None:
        q, v, a = x[m + 42 : m + 42 + 3 * n].reshape(3, n)
        desired = _make_grasp_motion(desired, q, v, a)
    return StreamState(
        sent.sequence, sent.time, _make_grasp_state(x[:n], x[n:m], now), desired, None if external is None else x[-6:], binary
    )


@cache
def _sizes(n: int, joints: bool, external: bool) -> tuple[tuple[tuple[int, ...], ...], tuple[int, ...]]:
    """The shapes of a state's arrays, for a hand of n joints, and how many bytes each has."""
    shapes = ((n,), (n,), *_SHAPES, *([(n,)] * 3 if joints else []), *([(6,)] if external else []))
    return shapes, tuple(_BYTES * math.prod(shape) for shape in shapes)


def _to_bytes(part: Any, shape: tuple[int, ...]) -> bytes:
    """The float64 of a list, which must have such a shape; what is binary stays."""
    if type(part) is bytes:
        return part
    numbers = np.array(part, dtype=np.float64)
    if numbers.shape != shape:
        raise ValueError("a shape")
    return numbers.tobytes()


def _unchecked_constructor(kind: type[Any]) -> Callable[..., Any]:
    """What makes a frozen record of values that have been checked, which it would check again."""
    new, put = object.__new__, [getattr(kind, name).__set__ for name in kind.__slots__]

    def made(*values: Any) -> Any:
        record = new(kind)
        for set_field, value in zip(put, values, strict=True):
            set_field(record, value)
        return record

    return made


_make_motion, _make_grasp_state, _make_grasp_motion = (
    _unchecked_constructor(BodyMotion),
    _unchecked_constructor(GraspState),
    _unchecked_constructor(GraspMotion),
)


def _to_binary_record(sent: StreamState) -> _StateRecord[bytes, bytes]:
    """A state with binary arrays."""
    state, object_state, wanted = sent.state, sent.state.object, object_motion(sent.desired)
    pose = _ObjectRecord(object_state.p_HO.tobytes(), object_state.R_HO.tobytes(), object_state.twist.tobytes())
    motion = _MotionRecord(wanted.p_HO.tobytes(), wanted.R_HO.tobytes(), wanted.twist.tobytes(), wanted.acceleration.tobytes())
    if isinstance(sent.desired, GraspMotion):
        motion.joints = _JointsRecord(sent.desired.q.tobytes(), sent.desired.v.tobytes(), sent.desired.a.tobytes())
    external = None if sent.external is None else sent.external.tobytes()
    return _StateRecord(
        sent.sequence, sent.time, _GraspStateRecord(state.q.tobytes(), state.v.tobytes(), pose), motion, external
    )


def _to_lists(value: Any, name: str = "") -> Any:
    """A record with lists for its binary arrays; what is no whole number of float64 stays, to be refused."""
    if isinstance(value, Mapping):
        return {name: _to_lists(item, name) for name, item in value.items()}
    if not isinstance(value, bytes) or len(value) % _BYTES:
        return value
    numbers = np.frombuffer(value)
    return (numbers.reshape(3, 3) if name == "rotation" and numbers.size == 9 else numbers).tolist()
