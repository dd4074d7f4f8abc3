"""Goals and plans of regrasps as plain records.

A state is stored with the places of its contacts only. Models, friction and force limits of each finger's contact are those of
the grasp at the start.
"""

from __future__ import annotations

from dataclasses import replace

from graspforce.contact.contact import Contact, ContactSet
from graspforce.control.settings import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.planning.regrasp.goal_paths import RegraspGoal
from graspforce.planning.regrasp.pose_path import PosePath
from graspforce.planning.regrasp.records import FingerStage, ObjectStage, RegraspPlan, RegraspTask, Stage
from graspforce.planning.regrasp.rolling_motion import HeldObject
from graspforce.planning.task_records import collisions_of_record, collisions_to_record

SCHEMA = "graspforce/regrasp/1"
_STATE = ("u", "posture", "fingers", "positions", "normals", "tangents")
_OBJECT_STAGE = ("kind", "duration", "margin", "states")
_FINGER_STAGE = ("kind", "duration", "margin", "finger", "postures", "end")
_PLAN = ("schema", "hand", "duration", "margin", "path", "stages")


def goal_to_dict(goal: RegraspGoal) -> JsonRecord:
    """Return the record of a goal: `hold`, `goal`, `settings` of the controller, and `collisions` unless they are the default.

    Args:
        goal: the goal.

    Raises:
        InvalidInput: the object's shape is an implicit surface, whose function cannot be stored.
    """
    return {
        "hold": goal.grasp.to_dict(),
        "goal": pose_to_dict(goal.p_HO, goal.R_HO),
        "settings": goal.control.to_dict(),
        **collisions_to_record(goal.collisions),
    }


def goal_from_dict(record: JsonRecord, hand: Hand) -> RegraspGoal:
    """Read a goal from a record whose fields are known.

    Args:
        record: as `goal_to_dict` returns it; `settings` and `collisions` may be absent or null.
        hand: the hand.

    Raises:
        InvalidInput: a field is out of range, or the object is at the goal already; names it with its path.
    """
    grasp = Grasp.from_dict(record["hold"], hand, "hold")
    if grasp.body.shape is None:
        raise InvalidInput("hold.body.shape", None, "a shape, because fingers need other places to touch")
    p_HO, R_HO = pose_from_dict(record["goal"], "goal")[:2]
    settings = record.get("settings")
    control = ControlSettings() if settings is None else ControlSettings.from_dict(settings, "settings")
    try:
        return RegraspGoal(grasp, p_HO, R_HO, control, **collisions_of_record(record))
    except InvalidInput as error:
        raise error.with_field("goal" if error.field in ("p_HO", "R_HO") else error.field) from None


def plan_to_dict(plan: RegraspPlan) -> JsonRecord:
    """Return the record of a plan.

    Args:
        plan: the plan.
    """
    path = plan.task.path
    return {
        "schema": SCHEMA,
        "hand": plan.task.grasp.hand.name,
        "duration": plan.duration,
        "margin": plan.margin,
        "path": [pose_to_dict(p, R) for p, R in zip(path.p_HO, path.R_HO, strict=True)],
        "stages": [_stage_to_dict(stage) for stage in plan.stages],
    }


def plan_from_dict(record: object, goal: RegraspGoal, field: str = "plan") -> RegraspPlan:
    """Read a plan from its record.

    Args:
        record: as `plan_to_dict` returns it.
        goal: the goal of the plan, with the grasp at its start and the settings of the controller.
        field: path of the record, for errors.

    Raises:
        InvalidInput: a field is missing, unknown or out of range, or the plan is of another hand; names it with its path.
    """
    values = fields.check_record(record, field, required=_PLAN)
    fields.check_choice(values["schema"], f"{field}.schema", (SCHEMA,))
    fields.check_choice(values["hand"], f"{field}.hand", (goal.grasp.hand.name,))
    poses = [
        pose_from_dict(pose, f"{field}.path[{i}]")
        for i, pose in enumerate(fields.check_sequence(values["path"], f"{field}.path", at_least=2))
    ]
    path = PosePath(freeze([pose[0] for pose in poses]), freeze([pose[1] for pose in poses]))
    task = RegraspTask(goal.grasp, path, goal.control, goal.collisions)
    stages = fields.check_sequence(values["stages"], f"{field}.stages", at_least=1)
    return RegraspPlan(
        task, tuple(_stage_from_dict(stage, goal.grasp, f"{field}.stages[{i}]") for i, stage in enumerate(stages))
    )


def _stage_to_dict(stage: Stage) -> JsonRecord:
    """Return the record of a stage; its `kind` is "object" or "finger"."""
    common = {"duration": stage.duration, "margin": stage.margin}
    if isinstance(stage, ObjectStage):
        return {"kind": "object", **common, "states": [_state_to_dict(state) for state in stage.states]}
    postures, end = stage.postures.tolist(), _state_to_dict(stage.end)
    return {"kind": "finger", **common, "finger": stage.finger, "postures": postures, "end": end}


def _stage_from_dict(record: object, grasp: Grasp, field: str) -> Stage:
    """Return the stage of a record."""
    kind = record.get("kind") if isinstance(record, dict) else None
    kind = fields.check_choice(kind, f"{field}.kind", ("object", "finger"))
    values = fields.check_record(record, field, required=_OBJECT_STAGE if kind == "object" else _FINGER_STAGE)
    duration = arrays.check_number(values["duration"], f"{field}.duration", above=0.0)
    margin = arrays.check_number(values["margin"], f"{field}.margin")
    if kind == "object":
        states = fields.check_sequence(values["states"], f"{field}.states", at_least=2)
        read = tuple(_state_from_dict(state, grasp, f"{field}.states[{i}]") for i, state in enumerate(states))
        return ObjectStage(read, duration, margin)
    end = _state_from_dict(values["end"], grasp, f"{field}.end")
    finger = fields.check_choice(values["finger"], f"{field}.finger", end.fingers)
    postures = arrays.check_array(values["postures"], f"{field}.postures", (None, grasp.hand.n))
    return FingerStage(finger, end.contacts.contacts[end.fingers.index(finger)], postures, end, duration, margin)


def _state_to_dict(state: HeldObject) -> JsonRecord:
    """Return the record of a state."""
    R_OC = state.contacts.R_OC
    places = {"positions": state.contacts.p_OC, "normals": R_OC[:, :, 2], "tangents": R_OC[:, :, 0]}
    arrays_of = {"posture": state.q, **places}
    return {"u": state.u, "fingers": list(state.fingers), **{name: value.tolist() for name, value in arrays_of.items()}}


def _state_from_dict(record: object, grasp: Grasp, field: str) -> HeldObject:
    """Return the state of a record, with the contact models of a grasp."""
    values = fields.check_record(record, field, required=_STATE)
    names = fields.check_sequence(values["fingers"], f"{field}.fingers", at_least=1)
    fingers = tuple(fields.check_choice(name, f"{field}.fingers[{i}]", grasp.fingers) for i, name in enumerate(names))
    places = [arrays.check_array(values[name], f"{field}.{name}", (len(fingers), 3)) for name in _STATE[3:]]
    contacts = [
        _placed(grasp.contacts.contacts[grasp.fingers.index(name)], *each) for name, *each in zip(fingers, *places, strict=True)
    ]
    u = arrays.check_number(values["u"], f"{field}.u", minimum=0.0)
    q = arrays.check_array(values["posture"], f"{field}.posture", (grasp.hand.n,))
    return HeldObject(u, q, fingers, ContactSet.stack(contacts))


def _placed(contact: Contact, position: Array, normal: Array, tangent: Array) -> Contact:
    """Return a contact at another place."""
    return replace(contact, position=position, normal=normal, tangent=tangent)
