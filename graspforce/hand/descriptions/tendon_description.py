"""Tendons and clutches in a hand's description file."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

TendonKind = Literal["differential", "breakaway"]

Positive = Annotated[float, Meta(gt=0)]


class TendonDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One motor that drives two joints, of which the second follows the first until one of them stops; see `Tendon`.

    Attributes:
        joints: leader and follower of a coupling. The leader has the motor.
        kind: ``differential`` for a tendon over a pulley at each joint, ``breakaway`` for a clutch at the first joint.
        source: where the numbers come from.
        radii: of a differential: radii of the pulleys, in any unit.
        threshold: of a breakaway: torque of the first joint at which the clutch opens, N·m.
        free_ratio: of a breakaway: turns of the second joint per turn of the first joint's coordinate after it has opened.
    """

    joints: tuple[str, str]
    kind: TendonKind
    source: str
    radii: tuple[Positive, Positive] = (1.0, 1.0)
    threshold: Positive | None = None
    free_ratio: Positive | None = None
