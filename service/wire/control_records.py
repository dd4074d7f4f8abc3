"""Requests of control: a single step, and the setup of a stream. Frames: H hand base, O object."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from graspforce.control import ControlMemory, ControlSettings, DesiredMotion, GraspState, desired_from_dict
from graspforce.core import arrays, fields, records
from graspforce.core.arrays import Array
from graspforce.core.constants import LARGEST_MOTION
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.pose.pose_fusion import PoseOffset
from graspforce.estimation.sensor_model import SensorModel
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.grasp import Grasp, check_grasp
from graspforce.hand.contact_tips import check_fingertips
from graspforce.hand.hand import Hand
from graspforce.service.wire.change_records import read_change_number

DEFAULT_VALIDITY = 0.02  # s, twenty periods at 1 kHz
DEFAULT_TORQUE_STEP = 0.25  # of half the torque range; control with sensor noise needs less than 0.05


@dataclass(frozen=True, eq=False, slots=True)
class ControlRequest:
    """One control step with all its inputs.

    Args:
        grasp: hand, object and contacts.
        state: measured state of hand and object.
        desired: desired motion of the object, or of object and joints.
        settings: controller settings.
        external: (6,) estimated wrench on the object apart from gravity and finger forces, about O's origin, in O, N and N·m.
            None for zero.
        memory: memory of the last step, from its answer; None for a first step.

    Raises:
        InvalidInput: `external` is not six finite numbers.
    """

    grasp: Grasp
    state: GraspState
    desired: DesiredMotion
    settings: ControlSettings = dataclasses.field(default_factory=ControlSettings)
    external: Array | None = None
    memory: ControlMemory | None = None

    def __post_init__(self) -> None:
        records.set_fields(self, external=read_external(self.external))

    @classmethod
    def from_dict(cls, hand: Hand, record: object) -> ControlRequest:
        """Read the request from its record.

        Args:
            hand: the hand.
            record: as `to_dict` returns it; `settings`, `external` and `memory` may be absent or null.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = ["settings", "external", "memory"]
        values = fields.check_record(record, "", required=["hold", "state", "desired"], optional=optional)
        grasp = Grasp.from_dict(values["hold"], hand, "hold")
        return cls(
            grasp=grasp,
            state=GraspState.from_dict(values["state"], hand.n, "state"),
            desired=desired_from_dict(values["desired"], hand.n, "desired"),
            settings=_read_settings(values.get("settings")),
            external=values.get("external"),
            memory=_read_memory(values.get("memory"), grasp),
        )

    def to_dict(self) -> JsonRecord:
        """Return the plain record: `hold`, `state`, `desired`, `settings`, and `external` and `memory` if given."""
        record = {
            "hold": self.grasp.to_dict(),
            "state": self.state.to_dict(),
            "desired": self.desired.to_dict(),
            "settings": self.settings.to_dict(),
        }
        if self.external is not None:
            record["external"] = self.external.tolist()
        if self.memory is not None:
            record["memory"] = self.memory.to_dict()
        return record


@dataclass(frozen=True, eq=False, slots=True)
class StreamSetup:
    """Fixed parameters of a stream. The client sends them once, when it opens the stream.

    Args:
        grasp: hand, object and contacts.
        settings: controller settings; their period is the stream's.
        validity: largest age of a good command, s, from when its state was sent (default 0.02).
        memory: memory of an earlier stream to continue from; None for a new start.
        sensors: sensors of the hand. If given, the states of the stream are measurements, and the server estimates the state.
        offset: offset of the object from its pose in the grasp, from the estimate of an earlier stream; None for none.
        change_number: number of the last change of contacts of an earlier stream; 0 for none.
        torque_step: largest change of a joint's torque from command to command, as a fraction of half its torque range, from 0
            to 2 (default 0.25).
        authenticated: whether states and commands have authentication codes (`graspforce.service.wire.stream_authentication`).

    Raises:
        InvalidInput: `validity` is not a finite number above 0, `torque_step` is out of range, or a contact is not at a
            fingertip.
    """

    grasp: Grasp
    settings: ControlSettings = dataclasses.field(default_factory=ControlSettings)
    validity: float = DEFAULT_VALIDITY
    memory: ControlMemory | None = None
    sensors: SensorModel | None = None
    offset: PoseOffset | None = None
    change_number: int = 0
    torque_step: float = DEFAULT_TORQUE_STEP
    authenticated: bool = False

    def __post_init__(self) -> None:
        check_fingertips(check_grasp(self.grasp).hand, self.grasp.fingers, "streams")
        number = read_change_number(self.change_number, "change_number")
        step = arrays.check_number(self.torque_step, "torque_step", above=0.0)
        if step > 2.0:
            raise InvalidInput("torque_step", step, "at most 2, the whole range")
        validity = arrays.check_number(self.validity, "validity", above=0.0)
        records.set_fields(self, validity=validity, change_number=number, torque_step=step)

    @property
    def hand(self) -> Hand:
        """The hand."""
        return self.grasp.hand

    @property
    def period(self) -> float:
        """Control period, s."""
        return self.settings.period

    def opens(self, other: StreamSetup) -> bool:
        """Return whether another setup opens the same stream: only the memory may differ, and the grasp after a change.

        Args:
            other: setup of a repeated request.
        """
        ignored = ("memory", "change_number", *(("hold", "offset") if other.change_number > 0 else ()))
        mine, theirs = ({k: v for k, v in each.to_dict().items() if k not in ignored} for each in (self, other))
        return mine == theirs

    @classmethod
    def from_dict(cls, hands: Mapping[str, Hand], record: object) -> StreamSetup:
        """Read the setup from its record.

        Args:
            hands: the served hands by name.
            record: as `to_dict` returns it; all fields but `hand` and `hold` may be absent or null.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
            UnknownName: the hand is not served.
        """
        optional = ["settings", "validity", "memory", "sensors", "offset", "change_number", "torque_step", "authenticated"]
        values = fields.check_record(record, "", required=["hand", "hold"], optional=optional)
        grasp = Grasp.from_dict(values["hold"], served_hand(hands, values["hand"]), "hold")
        return cls(
            grasp=grasp,
            settings=_read_settings(values.get("settings")),
            validity=DEFAULT_VALIDITY if values.get("validity") is None else values["validity"],
            memory=_read_memory(values.get("memory"), grasp),
            sensors=None if values.get("sensors") is None else SensorModel.from_dict(values["sensors"], "sensors"),
            offset=None if values.get("offset") is None else _read_offset(values["offset"]),
            change_number=0 if values.get("change_number") is None else values["change_number"],
            authenticated=fields.check_boolean(values.get("authenticated") or False, "authenticated"),
            torque_step=DEFAULT_TORQUE_STEP if values.get("torque_step") is None else values["torque_step"],
        )

    def to_dict(self) -> JsonRecord:
        """Return the plain record: `hand`, `hold`, `settings`, `validity`, and those of the others that are given."""
        record = {
            "hand": self.grasp.hand.name,
            "hold": self.grasp.to_dict(),
            "settings": self.settings.to_dict(),
            "validity": self.validity,
        }
        if self.memory is not None:
            record["memory"] = self.memory.to_dict()
        if self.sensors is not None:
            record["sensors"] = self.sensors.to_dict()
        if self.offset is not None:
            record["offset"] = pose_to_dict(self.offset.p, self.offset.R)
        if self.change_number > 0:
            record["change_number"] = self.change_number
        if self.authenticated:
            record["authenticated"] = True
        if self.torque_step != DEFAULT_TORQUE_STEP:
            record["torque_step"] = self.torque_step
        return record


def served_hand(hands: Mapping[str, Hand], name: object) -> Hand:
    """Return the hand that a setup names.

    Args:
        hands: the served hands by name.
        name: the value of the field `hand`.

    Raises:
        InvalidInput: not text.
        UnknownName: the hand is not served.
    """
    known = fields.check_text(name, "hand")
    if known not in hands:
        raise UnknownName("hand", known, hands, "" if hands else "the name of a served hand; this server has none")
    return hands[known]


def read_external(value: object) -> Array | None:
    """Return the external wrench of a record, (6,) N and N·m in O, or None.

    Args:
        value: six numbers of at most 1e6, or None.

    Raises:
        InvalidInput: not six finite numbers, or too large ones.
    """
    return None if value is None else arrays.check_array(value, "external", (6,), limit=LARGEST_MOTION)


def _read_settings(value: object) -> ControlSettings:
    """Return the controller settings of a record; the defaults for None."""
    return ControlSettings() if value is None else ControlSettings.from_dict(value, "settings")


def _read_offset(value: object) -> PoseOffset:
    """Return the offset of a record."""
    p, R, _ = pose_from_dict(value, "offset")
    return PoseOffset(p, R)


def _read_memory(value: object, grasp: Grasp) -> ControlMemory | None:
    """Return the memory of a record, or None."""
    return None if value is None else ControlMemory.from_dict(value, grasp.contacts, "memory")
