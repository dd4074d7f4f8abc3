"""The state that a driver sends in each period of a stream: exact, or as measured. Frames: H hand base, O object.

In JSON, arrays are lists. In MessagePack each array is a list, or binary: its float64 numbers, little-endian, by rows. If
`posture` is binary, the arrays of the command are binary too. Binary arrays avoid a Python object for each number.

Decoding has fast paths: compiled code for exact states in MessagePack with the fields in their order, and typed structs. Both
check all numbers together. A state that fails there is read again by `StreamState.from_dict`, which names the invalid field.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control import DesiredMotion, GraspMotion, GraspState, desired_from_dict, object_motion
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, native
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import unchecked_constructor
from graspforce.estimation.measurement import Measurement
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.change_records import NumberedChange
from graspforce.service.wire.control_records import read_external
from graspforce.service.wire.measured_state import read_measured, write_measurement
from graspforce.service.wire.state_block import check_usual, read_block, view_block, view_desired
from graspforce.service.wire.state_structs import (
    STATE_DECODERS,
    GraspStateStruct,
    JointsStruct,
    MotionStruct,
    ObjectStruct,
    StateStruct,
)

_ZEROS = arrays.freeze(np.zeros(6))
# Shapes of binary matrices by name; other binary arrays are vectors.
_MATRIX_SHAPES = {"rotation": (3, 3), "covariance": (6, 6), "tip_wrenches": (-1, 6), "contact_points": (-1, 3)}


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

    def encode(self, codec: str, binary: bool | None = None) -> bytes:
        """Return the payload.

        Args:
            codec: `protocol.JSON` or `protocol.MSGPACK`.
            binary: whether arrays are binary in MessagePack; by default those of exact states, but not those of measurements.
        """
        is_binary = codec == protocol.MSGPACK and (isinstance(self.state, GraspState) if binary is None else binary)
        return protocol.encode(_to_binary_struct(self) if is_binary else self.to_dict(), codec)

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


_make_motion = unchecked_constructor(BodyMotion)
_make_grasp_state = unchecked_constructor(GraspState)


def _decode_fast(payload: bytes, codec: str, hand: Hand) -> StreamState:
    """Return a state. Its arrays are views of one block, and all numbers are checked together.

    Raises:
        ValueError: a number, a shape or a rotation is wrong.
        TypeError: a number is no float.
    """
    if native is not None and codec == protocol.MSGPACK:
        found = native.read_stream_state(payload, hand.n)
        if found is not None:
            sequence, time, flags, numbers = found
            check_usual(numbers)
            parts = bool(flags & native.STATE_JOINTS), bool(flags & native.STATE_EXTERNAL)
            block, binary = view_block(numbers, hand.n, *parts), bool(flags & native.STATE_BINARY)
            return StreamState(sequence, time, _view_exact(block), *view_desired(block, *parts), None, binary)
    return _state_of(STATE_DECODERS[codec].decode(payload), hand)


def _state_of(record: StateStruct[Any, Any], hand: Hand) -> StreamState:
    """Return the state of a record. Raises ValueError and TypeError as `_decode_fast`."""
    if not (math.isfinite(record.time) and 0 <= record.sequence <= protocol.LARGEST_SEQUENCE):
        raise ValueError("a number is not finite, or out of range")
    exact, measured = record.state, record.measurement
    state: GraspState | Measurement
    if exact is not None and measured is None:
        state, desired, wrench = _read_exact(exact, record.desired, record.external, hand.n)
        binary = type(exact.posture) is bytes
    elif measured is not None and exact is None:
        state, desired, wrench = read_measured(measured, record.desired, record.external, hand.n)
        binary = type(measured.posture) is bytes
    else:
        raise ValueError("neither or both of a state and a measurement")
    conditions, fingers = _read_conditions(record.conditions)
    change = _read_change(record.contacts, hand)
    return StreamState(record.sequence, record.time, state, desired, wrench, conditions, binary, change, fingers)


def _read_exact(
    measured: GraspStateStruct[Any, Any], motion: MotionStruct[Any, Any], external: Any, n: int
) -> tuple[GraspState, DesiredMotion, Array | None]:
    """Return the exact state, the desired motion and the external wrench of a state. Raises as `_decode_fast`."""
    pose = measured.object
    now = measured.posture, measured.velocity, pose.position, pose.rotation, pose.twist
    block = read_block(now, motion, external, n)
    return _view_exact(block), *view_desired(block, motion.joints is not None, external is not None)


def _view_exact(block: Block) -> GraspState:
    """Return the exact state of a block."""
    return _make_grasp_state(block["q"], block["v"], _make_motion(block["p_HO"], block["R_HO"], block["twist"], _ZEROS))


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


def _to_binary_struct(state: StreamState) -> StateStruct[bytes, bytes]:
    """Return the wire form of a state with binary arrays."""
    motion, measured = object_motion(state.desired), state.state
    desired = MotionStruct(motion.p_HO.tobytes(), motion.R_HO.tobytes(), motion.twist.tobytes(), motion.acceleration.tobytes())
    if isinstance(state.desired, GraspMotion):
        desired.joints = JointsStruct(state.desired.q.tobytes(), state.desired.v.tobytes(), state.desired.a.tobytes())
    exact = None
    if isinstance(measured, GraspState):
        pose = measured.object
        body = ObjectStruct(pose.p_HO.tobytes(), pose.R_HO.tobytes(), pose.twist.tobytes())
        exact = GraspStateStruct(measured.q.tobytes(), measured.v.tobytes(), body)
    return StateStruct(
        sequence=state.sequence,
        time=state.time,
        state=exact,
        measurement=write_measurement(measured) if isinstance(measured, Measurement) else None,
        desired=desired,
        external=None if state.external is None else state.external.tobytes(),
        conditions=_conditions_to_dict(state),
        contacts=None if state.contacts is None else state.contacts.to_dict(),
    )


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
    if not isinstance(value, bytes) or len(value) % protocol.FLOAT_BYTES:
        return value
    numbers, shape = np.frombuffer(value), _MATRIX_SHAPES.get(name, (-1,))
    fits = numbers.size % shape[-1] == 0 if shape[0] < 0 else numbers.size == math.prod(shape)
    return (numbers.reshape(shape) if fits else numbers).tolist()
