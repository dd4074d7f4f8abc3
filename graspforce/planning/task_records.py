"""Fields of the records of tasks, and the values of those that several tasks share."""

from __future__ import annotations

from graspforce.core import arrays, fields
from graspforce.core.json_text import JsonRecord
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.planning.acceleration_limits import AccelerationLimits
from graspforce.planning.hand_limits import LIMIT_FIELDS

OBJECT_FIELDS = ("body", "contacts")  # required fields of records of tasks with an object
FINGER_TASK_FIELDS = ("gravity", "collisions", "acceleration_limits", *LIMIT_FIELDS)  # optional fields of each task's record
IDEAL_TASK_FIELDS = ("gravity", "slip_margin", "acceleration_limits")
GRASP_TASK_FIELDS = (*IDEAL_TASK_FIELDS, "rolling", "collisions", *LIMIT_FIELDS)


def given_fields(record: object, optional: tuple[str, ...], required: tuple[str, ...] = ()) -> JsonRecord:
    """Return the fields of a record that are not null.

    Args:
        record: the record.
        optional: names of the fields that may be given.
        required: names of the fields that must be given.

    Raises:
        InvalidInput: a field is missing or unknown; names it.
    """
    values = fields.check_record(record, "", required=required, optional=optional)
    given = {name: value for name, value in values.items() if value is not None}
    return fields.check_record(given, "", required=required, optional=optional)


def gravity_of_record(values: JsonRecord) -> JsonRecord:
    """Return gravity as an argument of a task, if it is given.

    Args:
        values: fields of the task's record.

    Raises:
        InvalidInput: not three finite numbers.
    """
    return {"gravity_H": arrays.check_array(values["gravity"], "gravity", (3,))} if "gravity" in values else {}


def acceleration_limits_of_record(values: JsonRecord) -> JsonRecord:
    """Return the limits of accelerations as an argument of a task, if they are given.

    Args:
        values: fields of the task's record.

    Raises:
        InvalidInput: a limit out of range.
    """
    if "acceleration_limits" not in values:
        return {}
    return {"acceleration_limits": AccelerationLimits.from_dict(values["acceleration_limits"], "acceleration_limits")}


def acceleration_limits_to_record(limits: AccelerationLimits) -> JsonRecord:
    """Return the field `acceleration_limits` of a task's record; no field without limits.

    Args:
        limits: limits of the task.
    """
    record = limits.to_dict()
    return {"acceleration_limits": record} if record else {}


def collisions_of_record(values: JsonRecord) -> JsonRecord:
    """Return the collision settings as an argument of a task, if they are given; false stands for no checks.

    Args:
        values: fields of the task's record.

    Raises:
        InvalidInput: neither false nor settings in their range.
    """
    record = values.get("collisions")
    if record is None:
        return {}
    return {"collisions": None if record is False else CollisionSettings.from_dict(record, "collisions")}


def collisions_to_record(settings: CollisionSettings | None) -> JsonRecord:
    """Return the field `collisions` of a task's record; no field for the default settings.

    Args:
        settings: settings of the task; None for no checks.
    """
    if settings is None:
        return {"collisions": False}
    record = settings.to_dict()
    return {} if record == CollisionSettings().to_dict() else {"collisions": record}
