"""Typed structs of a state on the wire, with which msgspec decodes it fast. `StreamState` checks and converts them.

An array is a list or, in MessagePack, maybe binary.
"""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import msgspec

from graspforce.service.wire import protocol

V = TypeVar("V")  # wire type of a vector
M = TypeVar("M")  # wire type of a matrix


class ObjectStruct(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True):
    """Motion of the object as it is."""

    position: V
    rotation: M
    twist: V


class JointsStruct(msgspec.Struct, Generic[V], forbid_unknown_fields=True):
    """Desired motion of the joints."""

    posture: V
    velocity: V
    acceleration: V


class MotionStruct(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True, omit_defaults=True):
    """Desired motion of the object, and maybe of the joints."""

    position: V
    rotation: M
    twist: V
    acceleration: V
    joints: JointsStruct[V] | None = None


class GraspStateStruct(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True):
    """Exact state of hand and object."""

    posture: V
    velocity: V
    object: ObjectStruct[V, M]


class PoseStruct(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True, omit_defaults=True):
    """Measured pose of the object, with its rotation as a matrix."""

    t: float
    position: V
    rotation: M
    covariance: M | None = None


class MeasurementStruct(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True, omit_defaults=True):
    """Measured quantities of a hand."""

    t: float
    posture: V
    velocity: V | None = None
    torque: V | None = None
    current: V | None = None
    tip_wrenches: M | None = None
    contact_points: M | None = None
    object: PoseStruct[V, M] | None = None


class StateStruct(msgspec.Struct, Generic[V, M], forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """A state of a stream: exact, or a measurement."""

    sequence: int
    time: float
    state: GraspStateStruct[V, M] | None = None
    measurement: MeasurementStruct[V, M] | None = None
    desired: MotionStruct[V, M]
    external: V | None = None
    conditions: dict[str, Any] | None = None
    contacts: dict[str, Any] | None = None


STATE_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(StateStruct[bytes | list[float], bytes | list[list[float]]]),
    protocol.JSON: msgspec.json.Decoder(StateStruct[list[float], list[list[float]]]),
}
"""Decoders of states by encoding."""

_encode_struct = msgspec.msgpack.Encoder().encode


def msgpack_from_json(payload: bytes) -> bytes | None:
    """Return an exact state of JSON in MessagePack, with its fields in order; None if it is not an exact state.

    Args:
        payload: the state in JSON.
    """
    try:
        record = STATE_DECODERS[protocol.JSON].decode(payload)
        return None if record.state is None else _encode_struct(record)
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError):  # OverflowError: an integer above 64 bits
        return None
