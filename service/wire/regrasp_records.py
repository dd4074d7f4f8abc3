"""Request and answer of `hands/<hand>/regrasp`: a goal pose of a held object, which may be out of reach of one grasp."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from graspforce.core import fields as record_fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand
from graspforce.planning import PlanFailure
from graspforce.planning.regrasp import RegraspGoal, RegraspPlan, RegraspSettings
from graspforce.planning.regrasp.plan_records import goal_from_dict, goal_to_dict, plan_from_dict, plan_to_dict

_SEARCH = tuple(each.name for each in fields(RegraspSettings) if each.name != "budget")


@dataclass(frozen=True, eq=False, slots=True)
class RegraspRequest:
    """A goal pose of a held object, and settings of the search.

    Args:
        goal: grasp, goal pose and settings of the controller.
        search: margins and speeds; the budget is that of the request.
    """

    goal: RegraspGoal
    search: RegraspSettings = field(default_factory=RegraspSettings)

    @classmethod
    def from_dict(cls, hand: Hand, record: object) -> RegraspRequest:
        """Read the request from its record.

        Args:
            hand: the hand.
            record: as `to_dict` returns it; `settings`, `collisions` and `search` may be absent or null.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = ["settings", "collisions", "search"]
        values = record_fields.check_record(record, "", required=["hold", "goal"], optional=optional)
        search = values.pop("search", None)
        given = record_fields.check_record({} if search is None else search, "search", optional=_SEARCH)
        try:
            settings = RegraspSettings(**{name: value for name, value in given.items() if value is not None})
        except InvalidInput as error:
            raise error.with_prefix("search") from None
        return cls(goal_from_dict(values, hand), settings)

    def to_dict(self) -> JsonRecord:
        """Return the plain record: `hold`, `goal`, `settings`, `search`, and `collisions` unless they are the default.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be sent.
        """
        search = {name: getattr(self.search, name) for name in _SEARCH}
        return {**goal_to_dict(self.goal), "search": {name: value for name, value in search.items() if value is not None}}


def write_regrasp(id: str, result: RegraspPlan | PlanFailure) -> JsonRecord:
    """Return the record of an answer: exactly one of ``plan`` and ``refusal`` is null.

    Args:
        id: id of the search.
        result: the plan, or the reason why none was found.
    """
    if isinstance(result, PlanFailure):
        return {"id": id, "plan": None, "refusal": result.to_dict()}
    return {"id": id, "plan": plan_to_dict(result), "refusal": None}


def read_regrasp(goal: RegraspGoal, record: object) -> RegraspPlan | PlanFailure:
    """Return the answer to a request.

    Args:
        goal: the goal of the request.
        record: the answer without the service's own fields.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    values = record_fields.check_record(record, "", required=["id", "plan", "refusal"])
    if values["plan"] is None:
        return PlanFailure.from_dict(values["refusal"], "refusal")
    return plan_from_dict(values["plan"], goal)
