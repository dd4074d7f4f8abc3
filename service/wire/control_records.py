"""What control is asked over the wire: a request that stands for itself, and a stream's opening.

Frames: H hand base, O object.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from graspforce.control import (
    ControlMemory,
    ControlSettings,
    DesiredMotion,
    GraspState,
    desired_from_dict,
)
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import UnknownName
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

DEFAULT_VALIDITY = 0.02  # s: by default a command is good for twenty periods of a kilohertz


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
            state=GraspState.from_dict(values["state"], hand.n, "state"),
            desired=desired_from_dict(values["desired"], hand.n, "desired"),
            settings=_read_settings(values.get("settings")),
            external=read_external(values.get("external")),
            memory=None
            if values.get("memory") is None
            else ControlMemory.from_dict(values["memory"], grasp.contacts, "memory"),
        )

    def to_dict(self) -> dict[str, Any]:
        """The request as it is on the wire."""
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
            raise UnknownName("hand", name, hands, "" if hands else "the name of a served hand; this server has none")
        grasp = Grasp.from_dict(values["hold"], hands[name], "hold")
        return cls(
            grasp=grasp,
            settings=_read_settings(values.get("settings")),
            validity=DEFAULT_VALIDITY if values.get("validity") is None else values["validity"],
            memory=None
            if values.get("memory") is None
            else ControlMemory.from_dict(values["memory"], grasp.contacts, "memory"),
        )

    def to_dict(self) -> dict[str, Any]:
        """The opening as it is on the wire."""
        record = {
            "hand": self.grasp.hand.name,
            "hold": self.grasp.to_dict(),
            "settings": self.settings.to_dict(),
            "validity": self.validity,
        }
        return record if self.memory is None else {**record, "memory": self.memory.to_dict()}


def _read_settings(value: Any) -> ControlSettings:
    """Return the controller's settings; the defaults for None."""
    return ControlSettings() if value is None else ControlSettings.from_dict(value, "settings")


def read_external(value: Any) -> Array | None:
    """The estimate of an external wrench; None where there is none."""
    return None if value is None else arrays.check_array(value, "external", (6,))
