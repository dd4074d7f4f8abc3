"""Records of planning on the wire: envelopes with the plan's id around progress, plans and failures.

Moves have no envelope of their own: they are sent as `Move.to_dict` writes them and read by `planning.move_from_dict`.
"""

from __future__ import annotations

from collections.abc import Mapping

from graspforce.core import fields
from graspforce.core.errors import MissingField
from graspforce.core.json_text import JsonRecord
from graspforce.planning import Move, Plan, PlanFailure, Progress


def write_progress(id: str, progress: Progress) -> JsonRecord:
    """Return the record of a plan's progress.

    Args:
        id: id of the plan.
        progress: the progress; its plan is not sent.
    """
    return {"id": id, **progress.to_dict()}


def read_progress(record: object) -> Progress:
    """Return the progress of a record.

    Args:
        record: mapping that `write_progress` made.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    if not isinstance(record, Mapping) or "id" not in record:
        raise MissingField("id")
    return Progress.from_dict({name: value for name, value in record.items() if name != "id"})


def write_answer(id: str, answer: Plan | PlanFailure) -> JsonRecord:
    """Return the record of an answer: exactly one of ``plan`` and ``refusal`` is null.

    Args:
        id: id of the plan.
        answer: the plan, or the reason why there is none.
    """
    is_plan = isinstance(answer, Plan)
    return {"id": id, "plan": answer.to_dict() if is_plan else None, "refusal": None if is_plan else answer.to_dict()}


def read_answer(move: Move, record: object) -> Plan | PlanFailure:
    """Return the answer to a move.

    Args:
        move: the move that was requested.
        record: the answer without the service's own fields.

    Raises:
        InvalidInput: a field is missing, unknown or out of range, or the plan is of another move; names the field.
    """
    values = fields.check_record(record, "", required=["id", "plan", "refusal"])
    if values["plan"] is None:
        return PlanFailure.from_dict(values["refusal"], "refusal")
    return Plan.from_dict(values["plan"], move.task, "plan")
