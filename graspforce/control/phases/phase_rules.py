"""The phases of a grasp cycle: names on the wire, entry, exit and abort conditions, and safe stops.

`PHASE_RULES` states them once. The controller takes time limits and safe stops from it, and the guide prints it as a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

PhaseName = Literal["approach", "close", "squeeze", "lift", "move", "place", "release", "retract", "reopen", "done", "stopped"]
SafeStop = Literal["hold joints", "hold object", "none"]

PHASE_NAMES: tuple[PhaseName, ...] = get_args(PhaseName)


@dataclass(frozen=True, slots=True)
class PhaseRule:
    """Conditions that begin and end a phase, its time limit and its safe stop.

    Attributes:
        name: name of the phase, as on the wire.
        entry: condition on which it begins.
        exit: condition on which the next phase begins.
        aborts: conditions on which the cycle stops, beside the time limit and a pause of the measurements. After those in
            `RETRIED` the fingers open and close again while attempts are left.
        time_limit: longest time of the phase, s.
        safe_stop: command after an abort: "hold joints" keeps the posture with bounded tip forces, "hold object" keeps the
            object where it is with the object controller.
    """

    name: PhaseName
    entry: str
    exit: str
    aborts: tuple[str, ...]
    time_limit: float
    safe_stop: SafeStop


TIME_LIMIT = "time limit"
NO_CONTACT = "a finger finds no contact"
WRONG_OBJECT = "the touched places do not fit the object"
NO_FORCES = "no forces hold the object"
LOST_CONTACT = "a fingertip left the object"
LATE_TOUCH = "a finger touched late"
MOVED = "the fingers move the object"
PAUSED = "the measurements paused"
NOT_REACHED = "the joints do not reach the posture"
PHASE_ORDER: tuple[PhaseName, ...] = ("approach", "close", "squeeze", "lift", "move", "place", "release", "retract")

RETRIED: tuple[tuple[PhaseName, str], ...] = (
    ("close", WRONG_OBJECT),
    ("close", NO_CONTACT),
    ("close", TIME_LIMIT),
    ("squeeze", NO_FORCES),
    ("squeeze", LOST_CONTACT),
    ("squeeze", LATE_TOUCH),
    ("squeeze", MOVED),
    ("squeeze", TIME_LIMIT),
)

_HOLD_ABORTS = (NO_FORCES, LOST_CONTACT)

PHASE_RULES: dict[PhaseName, PhaseRule] = {
    rule.name: rule
    for rule in (
        PhaseRule("approach", "start", "the joints are at the pre-grasp posture", (NOT_REACHED,), 10.0, "hold joints"),
        PhaseRule("close", "end of approach", "every fingertip touches", (NO_CONTACT, WRONG_OBJECT), 8.0, "hold joints"),
        PhaseRule(
            "squeeze",
            "end of close",
            "the planned forces carry the weight",
            (*_HOLD_ABORTS, LATE_TOUCH, MOVED),
            3.0,
            "hold joints",
        ),
        PhaseRule("lift", "end of squeeze", "the hand is at the lift height", _HOLD_ABORTS, 10.0, "hold object"),
        PhaseRule("move", "end of lift", "the hand is above the goal", _HOLD_ABORTS, 30.0, "hold object"),
        PhaseRule("place", "end of move", "the table carries the weight", _HOLD_ABORTS, 10.0, "hold object"),
        PhaseRule("release", "end of place", "the fingers are open", (), 5.0, "hold joints"),
        PhaseRule("retract", "end of release", "the joints are at the start posture", (NOT_REACHED,), 10.0, "hold joints"),
        PhaseRule("reopen", "failed close or squeeze", "the hand is open over the object", (NOT_REACHED,), 10.0, "hold joints"),
    )
}
