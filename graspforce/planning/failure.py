"""Why a move cannot be planned: a place, a joint or a contact, and words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from graspforce.force.solution import Infeasibility
from graspforce.hand.coordinates import JointInfo

UNREACHABLE = "unreachable"  # a fingertip cannot be where its contact is, or only beyond a joint's limits
SINGULAR = "singular"  # a finger has lost the direction in which its tip must go
IMMOVABLE = "immovable"  # no forces at the contacts set the object going
UNHOLDABLE = "unholdable"  # the object cannot be held still there
OVERLOADED = "overloaded"  # a motor that nothing relieves bears more than its limit
UNSOLVED = "unsolved"  # no plan was found, and no proof that there is none
STOPPED = "stopped"  # whoever watches said stop, or the budget ended, before there was a plan


@dataclass(frozen=True, eq=False, slots=True)
class PlanFailure:
    """An answer that is no plan.

    Args:
        kind: one of the words above.
        reason: the same in plain words.
        s: where along the path, 0 to 1; None where no single place is to blame.
        joint: the joint's name, where one is to blame.
        infeasibility: the proof that the object cannot be held there, and what would help; None for other kinds.
    """

    kind: str
    reason: str
    s: float | None = None
    joint: str | None = None
    infeasibility: Infeasibility | None = None
    found: ClassVar[bool] = False

    def to_dict(self) -> dict[str, Any]:
        """As a record that JSON can hold."""
        why = None if self.infeasibility is None else self.infeasibility.to_dict()
        return {"kind": self.kind, "reason": self.reason, "s": self.s, "joint": self.joint, "infeasibility": why}


def joint_limit_failure(s: float, joint: JointInfo, q: float) -> PlanFailure:
    """A joint that would have to stand at q rad, outside its limits, at s."""
    reason = (
        f"At s = {s:.3f} joint {joint.name} would have to stand at {q:.4g} rad, outside its limits "
        f"[{joint.lower:.4g}, {joint.upper:.4g}] rad."
    )
    return PlanFailure(UNREACHABLE, reason, s, joint.name)
