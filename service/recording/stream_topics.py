"""Poses, joints and forces of a control stream as Foxglove's messages, so that its viewer shows them.

| topic | schema | contents |
|---|---|---|
| `/tf` | `foxglove.FrameTransforms` | pose of the object, in the frame `hand` |
| `/streams/<id>/pose`, `/streams/<id>/desired` | `foxglove.PoseInFrame` | measured and desired pose of the object |
| `/streams/<id>/joint_states` | `foxglove.JointStates` | measured positions and rates, commanded torques |
| `/streams/<id>/forces` | `foxglove.SceneUpdate` | arrows of the planned contact forces, and friction cones |
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.use_colour import friction_use, use_colour
from graspforce.core import foxglove_messages as fox
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry.poses import pose_from_dict
from graspforce.grasp.hand_contacts import contacts_from_dicts
from graspforce.service.recording.exchange import Exchange
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.memory_records import to_array
from graspforce.service.wire.stream_state import to_lists

PERIOD = 0.02  # s, between two sets of messages
_FRAME = "hand"  # name of the frame H
_GRAVITY = 9.81  # m/s²
_HEIGHT = 0.02  # of the cones, m; the arrow of twice the object's weight is as long
_LENGTH_EXPONENT = 0.6  # of arrows over the force: 10 times the force is 4 times as long
_POSE_FIELDS = ("position", "rotation", "quaternion")
_RADIUS = 0.0013  # of the arrows, m


class FoxgloveMessage(NamedTuple):
    """A message with its topic.

    Attributes:
        topic: its topic.
        message: of foxglove-sdk; it has `encode` and `get_schema`.
    """

    topic: str
    message: Any


@dataclass(frozen=True, eq=False, slots=True)
class _Mark:
    """A contact of a command: see `foxglove_messages.ForceMark`."""

    finger: str
    apex: Array
    R_HC: Array
    arrow: Array
    mu: float
    colour: Array
    touching: bool = True
    radius: float = _RADIUS
    height: float = _HEIGHT


class StreamTopics:
    """The messages of one control stream.

    Args:
        id: id of the stream.
        setup: the plain record with which it was opened.
        joints: names of its joints.

    Raises:
        InvalidInput: the setup has no grasp: the stream controls joints or phases.
    """

    def __init__(self, id: str, setup: object, joints: list[str]) -> None:
        hold = setup.get("hold") if isinstance(setup, dict) else None
        if not isinstance(hold, dict):
            raise InvalidInput("hold", hold, "a grasp")
        contacts, self._fingers = contacts_from_dicts(hold["contacts"], "hold.contacts")
        self._contacts, self._joints, self._topic = ContactSet.stack(contacts), joints, f"/streams/{id}"
        self._object = f"object of {id}"
        self._weight = _GRAVITY * float(hold["body"]["mass"])  # N
        self._next = -np.inf

    def messages(self, exchange: Exchange) -> Iterator[FoxgloveMessage]:
        """Yield the messages of a state and its command, at most every `PERIOD`.

        Args:
            exchange: the exchange.
        """
        if exchange.received < self._next or not exchange.ok:
            return
        self._next = exchange.received + PERIOD
        state = to_lists(protocol.decode(exchange.payload, protocol.select_codec(exchange.encoding)))
        command = _DECODERS[exchange.reply_encoding].decode(exchange.reply)
        measured = state["measurement"] if state.get("state") is None else state["state"]
        t, q = exchange.received, np.array(measured["posture"])
        rates = measured.get("velocity")
        v = np.zeros_like(q) if rates is None else np.array(rates)
        yield self._message("joint_states", fox.joint_states(t, self._joints, q, v, to_array(command.torque)))
        yield self._message("desired", fox.pose_in_frame(t, _FRAME, *_read_pose(state["desired"])))
        if command.contact_change is not None or measured.get("object") is None:
            return  # other contacts than those of the setup, or no pose
        p_HO, R_HO = _read_pose(measured["object"])
        yield self._message("pose", fox.pose_in_frame(t, _FRAME, p_HO, R_HO))
        from foxglove import messages

        yield FoxgloveMessage("/tf", messages.FrameTransforms(transforms=[fox.transform(t, _FRAME, self._object, p_HO, R_HO)]))
        entities = [fox.contact_entity(t, _FRAME, mark) for mark in self._marks(command, p_HO, R_HO)]
        yield self._message("forces", messages.SceneUpdate(entities=entities))

    def _message(self, name: str, message: Any) -> FoxgloveMessage:
        """Return a message of a topic of the stream."""
        return FoxgloveMessage(f"{self._topic}/{name}", message)

    def _marks(self, command: CommandRecord, p_HO: Array, R_HO: Array) -> Iterator[_Mark]:
        """Yield the marks of the planned forces."""
        forces, positions = self._contacts.pad(to_array(command.force)), to_array(command.positions, -1, 3)
        frames = to_array(command.memory.frames, -1, 3, 3)
        margins = to_array(command.slip_margin).tolist()
        for i, finger in enumerate(self._fingers):
            f, mu, R_HC = forces[i, :3], float(self._contacts.mu[i]), R_HO @ frames[i]
            norm = float(np.linalg.norm(f))
            length = _HEIGHT * (norm / (2.0 * self._weight)) ** _LENGTH_EXPONENT
            arrow = R_HC @ f * (length / norm if norm > 0.0 else 0.0)
            yield _Mark(
                finger, p_HO + R_HO @ positions[i], R_HC, arrow, mu, use_colour(friction_use(margins[i], mu, float(f[2])))
            )


_DECODERS: dict[str, Any] = {
    protocol.JSON: msgspec.json.Decoder(CommandRecord),
    protocol.MSGPACK: msgspec.msgpack.Decoder(CommandRecord),
}


def _read_pose(record: dict[str, Any]) -> tuple[Array, Array]:
    """Return the pose of a state's record."""
    p, R, _ = pose_from_dict({name: record[name] for name in _POSE_FIELDS if name in record}, "")
    return p, R
