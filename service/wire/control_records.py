"""What control is asked over the wire: a request that stands for itself, and a stream's opening.

Frames: H hand base, O object.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from graspforce.contact.kinematics import TipContactState
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    ControlMemory,
    ControlSettings,
    DesiredMotion,
    GraspMotion,
    GraspState,
    PoseGains,
    object_motion,
)
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.core.pose import pose_to_dict
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.service.wire.command_records import ControlMemoryRecord

DEFAULT_VALIDITY = 0.02  # s: by default a command is good for twenty periods of a kilohertz
_WIRE_NAMES = {"gravity_H": "gravity"}  # the others are spelt on the wire as in Python


@dataclass(frozen=True, eq=False, slots=True)
class ControlRequest:
    """One control step that needs nothing from before it.

    Args:
        hold: the hand, the object and the contacts.
        state: hand and object as measured.
        desired: the desired motion, of the object or of object and joints.
        settings: of the controller.
        external: (6,) an estimate of the wrench on the object that is neither gravity nor the fingers', about O's origin, in O,
            N and N·m; None for none.
        memory: what the step before left, from its answer; None for a first step.
    """

    grasp: Grasp
    state: GraspState
    desired: DesiredMotion
    settings: ControlSettings = dataclasses.field(default_factory=ControlSettings)
    external: Array | None = None
    memory: ControlMemory | None = None

    @classmethod
    def from_dict(cls, hand: Hand, record: Mapping[str, Any]) -> ControlRequest:
        """From the request as it is on the wire.

        Raises:
            InvalidInput: a field that is missing, unknown, or holds what it may not; named with its path.
        """
        optional = ["settings", "external", "memory"]
        values = fields.check_record(record, "", required=["hold", "state", "desired"], optional=optional)
        grasp = Grasp.from_dict(values["hold"], hand, "hold")
        return cls(
            grasp=grasp,
            state=read_state(hand, values["state"], "state"),
            desired=read_desired(hand, values["desired"], "desired"),
            settings=read_settings(values.get("settings"), "settings"),
            external=read_external(values.get("external")),
            memory=None if values.get("memory") is None else read_memory(grasp, values["memory"], "memory"),
        )

    def to_dict(self) -> dict[str, Any]:
        """The request as it is on the wire."""
        record = {
            "hold": self.grasp.to_dict(),
            "state": write_state(self.state),
            "desired": write_desired(self.desired),
            "settings": write_settings(self.settings),
        }
        if self.external is not None:
            record["external"] = self.external.tolist()
        if self.memory is not None:
            record["memory"] = write_memory(self.memory)
        return record


@dataclass(frozen=True, eq=False, slots=True)
class StreamSetup:
    """What stays fixed while a stream is open: it is sent once.

    Args:
        hold: the hand, the object and the contacts.
        settings: of the controller; its period is the stream's.
        validity: how old a command may be, s, counted from when the state that it answers was sent.
        memory: what the last step of an earlier stream left, to go on from there; None for a fresh start.
    """

    grasp: Grasp
    settings: ControlSettings = dataclasses.field(default_factory=ControlSettings)
    validity: float = DEFAULT_VALIDITY
    memory: ControlMemory | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "validity", arrays.check_number(self.validity, "validity", above=0.0))

    @classmethod
    def from_dict(cls, hands: Mapping[str, Hand], record: Mapping[str, Any]) -> StreamSetup:
        """From the opening as it is on the wire.

        Args:
            hands: those that are served, by name.
            record: the opening.

        Raises:
            InvalidInput: a field that is missing, unknown, or holds what it may not; named with its path.
            UnknownName: a hand that is not served.
        """
        values = fields.check_record(record, "", required=["hand", "hold"], optional=["settings", "validity", "memory"])
        name = fields.check_text(values["hand"], "hand")
        if name not in hands:
            raise UnknownName("hand", name, "one of " + ", ".join(hands) if hands else "absent: no hand is served")
        grasp = Grasp.from_dict(values["hold"], hands[name], "hold")
        return cls(
            grasp=grasp,
            settings=read_settings(values.get("settings"), "settings"),
            validity=DEFAULT_VALIDITY if values.get("validity") is None else values["validity"],
            memory=None if values.get("memory") is None else read_memory(grasp, values["memory"], "memory"),
        )

    def to_dict(self) -> dict[str, Any]:
        """The opening as it is on the wire."""
        record = {
            "hand": self.grasp.hand.name,
            "hold": self.grasp.to_dict(),
            "settings": write_settings(self.settings),
            "validity": self.validity,
        }
        return record if self.memory is None else {**record, "memory": write_memory(self.memory)}


def read_state(hand: Hand, value: Any, field: str) -> GraspState:
    """``posture``, ``velocity`` (at rest by default), and ``object``: its pose and ``twist``."""
    values = fields.check_record(value, field, required=["posture", "object"], optional=["velocity"])
    q = arrays.check_array(values["posture"], f"{field}.posture", (hand.n,))
    v = values.get("velocity")
    v = np.zeros(hand.n) if v is None else arrays.check_array(v, f"{field}.velocity", (hand.n,))
    return GraspState(q, v, BodyMotion.from_dict(values["object"], f"{field}.object", ("twist",)))


def write_state(state: GraspState) -> dict[str, Any]:
    """The record of a state."""
    object_state = {**pose_to_dict(state.object.p_HO, state.object.R_HO), "twist": state.object.twist.tolist()}
    return {"posture": state.q.tolist(), "velocity": state.v.tolist(), "object": object_state}


def read_desired(hand: Hand, value: Any, field: str) -> DesiredMotion:
    """The object's pose with ``twist`` and ``acceleration``, zeros by default; and ``joints``, where their motion is wanted.

    Of these ``posture``, and ``velocity`` and ``acceleration``, zeros by default.
    """
    motion = BodyMotion.from_dict(value, field, ("twist", "acceleration", "joints"))
    joints = value.get("joints")
    if joints is None:
        return motion
    values = fields.check_record(joints, f"{field}.joints", required=["posture"], optional=["velocity", "acceleration"])
    given = {name: item for name, item in values.items() if item is not None or name == "posture"}
    named = {name: arrays.check_array(item, f"{field}.joints.{name}", (hand.n,)) for name, item in given.items()}
    rest = arrays.freeze(np.zeros(hand.n))
    return GraspMotion(motion, named["posture"], named.get("velocity", rest), named.get("acceleration", rest))


def write_desired(desired: DesiredMotion) -> dict[str, Any]:
    """The record of what is wanted."""
    record = object_motion(desired).to_dict()
    if not isinstance(desired, GraspMotion):
        return record
    joints = {"posture": desired.q, "velocity": desired.v, "acceleration": desired.a}
    return {**record, "joints": {name: each.tolist() for name, each in joints.items()}}


def read_settings(value: Any, field: str) -> ControlSettings:
    """The controller's settings, those that are not named by their defaults. None for all defaults."""
    if value is None:
        return ControlSettings()
    names = {_WIRE_NAMES.get(each.name, each.name): each.name for each in dataclasses.fields(ControlSettings)}
    given = {names[name]: item for name, item in fields.check_record(value, field, optional=names).items() if item is not None}
    if "gains" in given:
        gains = fields.check_record(
            given["gains"], f"{field}.gains", optional=[each.name for each in dataclasses.fields(PoseGains)]
        )
        given["gains"] = _build(PoseGains, gains, f"{field}.gains")
    settings: ControlSettings = _build(ControlSettings, given, field)
    return settings


def write_settings(settings: ControlSettings) -> dict[str, Any]:
    """The record of the controller's settings, all of them."""
    record = {_WIRE_NAMES.get(each.name, each.name): getattr(settings, each.name) for each in dataclasses.fields(settings)}
    return {**record, "gravity": settings.gravity_H.tolist(), "gains": dataclasses.asdict(settings.gains)}


def read_memory(grasp: Grasp, value: Any, field: str) -> ControlMemory:
    """What an earlier step left: ``integral``, ``frames``, ``creep``, ``force`` and ``touched``, as its answer said them."""
    values = fields.check_record(value, field, required=["integral", "frames", "creep"], optional=["force", "touched"])
    count, force, touched = len(grasp.contacts), values.get("force"), values.get("touched")
    return ControlMemory(
        arrays.check_array(values["integral"], f"{field}.integral", (6,)),
        _frames(values["frames"], f"{field}.frames", count),
        arrays.check_array(values["creep"], f"{field}.creep", (count, 2)),
        None if force is None else arrays.check_array(force, f"{field}.force", (grasp.contacts.size,)),
        None if touched is None else _read_touched(touched, f"{field}.touched", count),
    )


def _read_touched(value: Any, field: str, count: int) -> TipContactState:
    values = fields.check_record(value, field, required=["tips", "tip_frames", "positions"])
    return TipContactState(
        arrays.check_array(values["tips"], f"{field}.tips", (count, 3)),
        _frames(values["tip_frames"], f"{field}.tip_frames", count),
        arrays.check_array(values["positions"], f"{field}.positions", (count, 3)),
    )


def _frames(value: Any, field: str, count: int) -> Array:
    frames = arrays.check_array(value, field, (count, 3, 3))
    for i, frame in enumerate(frames):
        arrays.check_rotation(frame, f"{field}[{i}]")
    return frames


def write_memory(memory: ControlMemory) -> dict[str, Any]:
    """The record of a memory."""
    return dict(msgspec.to_builtins(ControlMemoryRecord.pack(memory)))


def read_external(value: Any) -> Array | None:
    """The estimate of an external wrench; None where there is none."""
    return None if value is None else arrays.check_array(value, "external", (6,))


def _build(kind: Any, values: Mapping[str, Any], field: str) -> Any:
    """A record of Python's, its errors named as the wire spells them."""
    try:
        return kind(**values)
    except InvalidInput as error:
        name, dot, rest = error.field.partition("[")
        raise InvalidInput(_WIRE_NAMES.get(name, name) + dot + rest, error.value, error.allowed).with_prefix(field) from None
