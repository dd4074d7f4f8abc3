"""The reason why a move cannot be planned: its kind, a sentence, and the place, joint or certificate that explains it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from graspforce.core import arrays, fields
from graspforce.force.infeasibility import Infeasibility
from graspforce.hand.kinematics.coordinates import JointInfo

UNREACHABLE = "unreachable"  # a fingertip cannot reach its contact, or only beyond a joint's limits
SINGULAR = "singular"  # a finger cannot move its tip in the direction that the path requires
IMMOVABLE = "immovable"  # no contact forces accelerate the object
UNHOLDABLE = "unholdable"  # the object cannot be held still there
COLLISION = "collision"  # links, object or obstacles come too near
OVERLOADED = "overloaded"  # gravity alone exceeds a motor's torque limit
UNSOLVED = "unsolved"  # no plan was found, which does not prove that there is none
STOPPED = "stopped"  # the callback or the budget ended planning before there was a plan
KINDS = (UNREACHABLE, SINGULAR, IMMOVABLE, UNHOLDABLE, COLLISION, OVERLOADED, UNSOLVED, STOPPED)

_FIELDS = ("kind", "reason", "s", "joint", "infeasibility")  # of every record


@dataclass(frozen=True, eq=False, slots=True)
class PlanFailure:
    """The result of a planner that made no plan.

    Args:
        kind: one of `KINDS`.
        reason: the reason as a sentence.
        s: path parameter of the place, 0 to 1; None if there is no single place.
        joint: name of the joint that causes the failure, if there is one.
        infeasibility: certificate that the object cannot be held there, with remedies; None for other kinds.
        links: names of two links that collide, "object" or an obstacle among them; None for other kinds.
        point: (x, y, z) of the collision in H, m; None for other kinds.
    """

    kind: str
    reason: str
    s: float | None = None
    joint: str | None = None
    infeasibility: Infeasibility | None = None
    links: tuple[str, str] | None = None
    point: tuple[float, float, float] | None = None
    found: ClassVar[bool] = False

    def __repr__(self) -> str:
        return f"<PlanFailure: {self.kind}. {self.reason}>"

    def __str__(self) -> str:
        return self.reason

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> PlanFailure:
        """Return the failure of a record.

        Args:
            record: mapping that `to_dict` made.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        path = f"{field}." if field else ""
        values = fields.check_record(record, field, required=_FIELDS, optional=["links", "point"])
        s, joint, infeasibility = values["s"], values["joint"], values["infeasibility"]
        links, point = values.get("links"), values.get("point")
        return cls(
            fields.check_text(values["kind"], f"{path}kind"),
            fields.check_text(values["reason"], f"{path}reason"),
            None if s is None else arrays.check_number(s, f"{path}s"),
            None if joint is None else fields.check_text(joint, f"{path}joint"),
            None if infeasibility is None else Infeasibility.from_dict(infeasibility, f"{path}infeasibility"),
            None if links is None else _two_names(links, f"{path}links"),
            None if point is None else tuple(arrays.check_array(point, f"{path}point", (3,)).tolist()),
        )

    def to_dict(self) -> dict[str, object]:
        """Return the failure as a record for JSON."""
        infeasibility = None if self.infeasibility is None else self.infeasibility.to_dict()
        record: dict[str, object] = {
            "kind": self.kind,
            "reason": self.reason,
            "s": self.s,
            "joint": self.joint,
            "infeasibility": infeasibility,
        }
        if self.links is not None and self.point is not None:
            record |= {"links": list(self.links), "point": list(self.point)}
        return record


def _two_names(value: object, field: str) -> tuple[str, str]:
    first, second = fields.check_sequence(value, field, at_least=2)[:2]
    return fields.check_text(first, f"{field}[0]"), fields.check_text(second, f"{field}[1]")


def no_other_path_failure(straight: PlanFailure) -> PlanFailure:
    """Return the failure of a search that found no path instead of an infeasible straight one.

    Args:
        straight: the failure of the straight path.
    """
    reason = f"No motion was found, which does not prove that there is none. Along the straight path: {straight.reason}"
    return replace(straight, kind=UNSOLVED, reason=reason)


def joint_limit_failure(s: float, joint: JointInfo, q: float) -> PlanFailure:
    """Return the failure of a joint that exceeds its position limits.

    Args:
        s: path parameter of the place.
        joint: the joint.
        q: the position that the path requires, rad.
    """
    limits = f"[{joint.lower:.4g}, {joint.upper:.4g}] rad"
    reason = f"At s = {s:.3f} joint {joint.name} needs the position {q:.4g} rad, outside its limits {limits}."
    return PlanFailure(UNREACHABLE, reason, s, joint.name)
