"""Setups of streams of all kinds: control of a held object, the phases of a grasp, joint-space laws."""

from __future__ import annotations

from collections.abc import Mapping

from graspforce.core import fields
from graspforce.hand.hand import Hand
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.joint_records import JOINTS, JointStreamSetup
from graspforce.service.wire.phase_records import PHASES, PhaseStreamSetup

CONTROL = "control"
"""The `kind` of a setup of a held object, and that of a setup without `kind`."""

AnySetup = StreamSetup | PhaseStreamSetup | JointStreamSetup


def read_setup(hands: Mapping[str, Hand], record: object) -> AnySetup:
    """Read a setup of any kind from its record.

    Args:
        hands: the served hands by name.
        record: the record; its `kind` is ``control`` (default), ``phases`` or ``joints``.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
        UnknownName: the hand is not served.
    """
    kind = record.get("kind", CONTROL) if isinstance(record, Mapping) else CONTROL
    fields.check_choice(kind, "kind", (CONTROL, PHASES, JOINTS))
    if kind == PHASES:
        return PhaseStreamSetup.from_dict(hands, record)
    if kind == JOINTS:
        return JointStreamSetup.from_dict(hands, record)
    without = {name: value for name, value in record.items() if name != "kind"} if isinstance(record, Mapping) else record
    return StreamSetup.from_dict(hands, without)
