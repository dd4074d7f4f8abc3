"""What planning is asked over the wire, how far it is, and what it answers: moves, progress, plans, refusals.

Frames: H hand base, O object. Every reader names what is wrong by its path from the outermost record.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.force.solution import Infeasibility
from graspforce.geometry import Solid
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import check_contact_fingers, contacts_from_dicts, contacts_to_dicts
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.planning import (
    UNBOUNDED,
    Obstacle,
    Plan,
    PlanCheck,
    PlanFailure,
    PlanningStatistics,
    Progress,
    Task,
    Trajectory,
    WorkspaceBounds,
)
from graspforce.planning.moves import FingersMove, FreeMove, Move, PathMove
from graspforce.planning.plan import SCHEMA
from graspforce.planning.progress import STAGES

METHODS: dict[str, type[PathMove | FreeMove | FingersMove]] = {"path": PathMove, "free": FreeMove, "fingers": FingersMove}
_LIMITS = {"torque": "torque_upper", "speed": "velocity_limit", "lower": "q_lower", "upper": "q_upper"}  # a hand's, by joint
_TASK_FIELDS = ("gravity", "slip_margin", *_LIMITS)
_OBJECT_FIELDS = ("body", "contacts", "poses")
_METHOD_FIELDS = {
    "path": ("way", "posture", "rolling"),
    "free": ("posture", "room", "rolling"),
    "fingers": ("apart", "obstacles"),
}
_COMMON_FIELDS = ("intervals", "tolerance")
# Python name of a move's field: its name on the wire, where the two differ
_WIRE_NAMES = {"p_HO": "poses", "q_start": "posture", "path_type": "way", "clearance": "apart", "workspace": "room"}
_MOVE_FIELDS = {"way": "path_type", "apart": "clearance", "intervals": "intervals", "tolerance": "tolerance"}  # wire: Python


# ── moves ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def read_move(hand: Hand, record: Any) -> Move:
    """A move of a hand: its ``method``, what it is about, and from where to where.

    Args:
        hand: the hand.
        record: the request without its envelope and its id.

    Raises:
        InvalidInput: a field that is missing, unknown, or holds what it may not; named with its path.
    """
    if not isinstance(record, Mapping) or "method" not in record:
        raise InvalidInput("method", None, "one of " + ", ".join(METHODS))
    method = fields.check_choice(record["method"], "method", METHODS)
    needed = ("postures",) if method == "fingers" else _OBJECT_FIELDS
    values = fields.check_record(
        record, "", required=["method", *needed], optional=[*_TASK_FIELDS, *_METHOD_FIELDS[method], *_COMMON_FIELDS]
    )
    given = {name: value for name, value in values.items() if value is not None}
    rest: dict[str, Any] = {_MOVE_FIELDS[name]: given[name] for name in _MOVE_FIELDS if name in given}
    try:
        task = _read_task(hand, given, method != "fingers")
        if method == "fingers":
            obstacles = fields.check_sequence(given.get("obstacles", ()), "obstacles")
            rest["obstacles"] = tuple(_read_obstacle(item, f"obstacles[{i}]") for i, item in enumerate(obstacles))
            return FingersMove(task, given["postures"], **rest)
        poses = fields.check_sequence(given["poses"], "poses", at_least=2)
        p_HO, R_HO = zip(*(pose_from_dict(pose, f"poses[{i}]")[:2] for i, pose in enumerate(poses)), strict=True)
        if method == "path":
            return PathMove(task, np.array(p_HO), np.array(R_HO), q_start=given.get("posture"), **rest)
        rest["workspace"] = _read_workspace(given.get("room"), "room")
        return FreeMove(task, np.array(p_HO), np.array(R_HO), q_start=given.get("posture"), **rest)
    except InvalidInput as error:
        name, bracket, place = error.field.partition("[")
        raise error.with_field(_WIRE_NAMES.get(name, name) + bracket + place) from None


def write_move(move: Move) -> dict[str, Any]:
    """The record of a move, without its hand.

    Raises:
        InvalidInput: a task without a hand, which no service plans for.
    """
    task = move.task
    if task.hand is None:
        raise InvalidInput("task.hand", None, "a hand, which the service knows by name")
    record: dict[str, Any] = {
        "method": next(name for name, kind in METHODS.items() if isinstance(move, kind)),
        "gravity": task.gravity_H.tolist(),
        "slip_margin": task.slip_margin,
        **{name: getattr(task.hand, limit).tolist() for name, limit in _LIMITS.items()},
        "intervals": move.intervals,
        "tolerance": move.tolerance,
    }
    if isinstance(move, FingersMove):
        obstacles = [{"shape": each.shape.to_dict(), **pose_to_dict(each.p_HO, each.R_HO)} for each in move.obstacles]
        return {**record, "postures": move.postures.tolist(), "apart": move.clearance, "obstacles": obstacles}
    assert task.body is not None  # these moves are an object's
    assert task.contacts is not None
    record["body"], record["rolling"] = task.body.to_dict(), task.rolling
    record["contacts"] = contacts_to_dicts(task.contacts.contacts, task.fingers)
    record["poses"] = [pose_to_dict(p, R) for p, R in zip(move.p_HO, move.R_HO, strict=True)]
    if move.q_start is not None:
        record["posture"] = move.q_start.tolist()
    return (
        {**record, "way": move.path_type}
        if isinstance(move, PathMove)
        else {**record, "room": _write_workspace(move.workspace)}
    )


def _read_task(hand: Hand, given: Mapping[str, Any], has_object: bool) -> Task:
    """``body`` and ``contacts``, ``gravity``, ``slip_margin``, ``rolling``, and of each joint what the move may use:
    ``torque``, N·m, ``speed``, rad/s, and its range from ``lower`` to ``upper``, rad."""
    limited = _limit_hand(hand, given)
    gravity_H = arrays.check_array(given.get("gravity", GRAVITY_PALM_UP), "gravity", (3,))
    rest: dict[str, Any] = {"gravity_H": gravity_H, "slip_margin": given.get("slip_margin", 0.0)}
    rest["rolling"] = given.get("rolling", True)
    if not has_object:
        return Task(limited, **rest)
    contacts, fingers = contacts_from_dicts(given["contacts"], "contacts")
    check_contact_fingers(hand, fingers, "contacts")
    return Task(limited, Body.from_dict(given["body"], "body"), ContactSet.stack(contacts), fingers, **rest)


def _limit_hand(hand: Hand, given: Mapping[str, Any]) -> Hand:
    """The hand with motors that give less and joints that go less far and fast; itself where they keep all."""
    own = {name: getattr(hand, limit) for name, limit in _LIMITS.items()}
    asked = {name: arrays.check_array(given.get(name, own[name]), name, (hand.n,)) for name in _LIMITS}
    for name, unit in (("torque", "N·m"), ("speed", "rad/s")):
        for i, (value, most) in enumerate(zip(asked[name], own[name], strict=True)):
            if not 0.0 < value <= most:
                allowed = f"above 0 and at most {most:g} {unit}, {hand.joints[i].name}'s own"
                raise InvalidInput(f"{name}[{i}]", float(value), allowed)
    for i, joint in enumerate(hand.joints):
        if not joint.lower <= asked["lower"][i] <= asked["upper"][i] <= joint.upper:
            allowed = f"a range within [{joint.lower:g}, {joint.upper:g}] rad, {joint.name}'s own"
            raise InvalidInput(f"lower[{i}]", [float(asked["lower"][i]), float(asked["upper"][i])], allowed)
    if all((asked[name] == own[name]).all() for name in _LIMITS):
        return hand
    return _hand_with_limits(hand, tuple(tuple(asked[name].tolist()) for name in _LIMITS))


@lru_cache(maxsize=16)
def _hand_with_limits(hand: Hand, limits: tuple[tuple[float, ...], ...]) -> Hand:
    """The same hand every time: the planner keeps the equations of each that it has seen."""
    joints = [
        dataclasses.replace(joint, torque=torque, velocity=speed, lower=lower, upper=upper)
        for joint, torque, speed, lower, upper in zip(hand.joints, *limits, strict=True)
    ]
    return dataclasses.replace(hand, joints=tuple(joints))


def _read_obstacle(value: Any, field: str) -> Obstacle:
    """``shape``, and where it stands in H."""
    p_HO, R_HO, values = pose_from_dict(value, field, ("shape",))
    if "shape" not in values:
        raise MissingField(f"{field}.shape")
    try:
        return Obstacle(Solid.from_dict(values["shape"], "shape"), p_HO, R_HO)
    except InvalidInput as error:
        raise error.with_prefix(field) from None


def _read_workspace(value: Any, field: str) -> WorkspaceBounds:
    """``lower`` and ``upper`` (m in H) and ``turn`` (rad); null for no bound."""
    if value is None:
        return UNBOUNDED
    values = fields.check_record(value, field, optional=["lower", "upper", "turn"])
    bounds = (("lower", -np.inf), ("upper", np.inf))
    lower, upper = (arrays.check_limits(values.get(name), f"{field}.{name}", 3, missing) for name, missing in bounds)
    turn = values.get("turn")
    return WorkspaceBounds(lower, upper, np.inf if turn is None else arrays.check_number(turn, f"{field}.turn", minimum=0.0))


def _write_workspace(workspace: WorkspaceBounds) -> dict[str, Any]:
    lower, upper = ([x if np.isfinite(x) else None for x in bounds.tolist()] for bounds in (workspace.lower, workspace.upper))
    return {"lower": lower, "upper": upper, "turn": workspace.turn if np.isfinite(workspace.turn) else None}


# ── progress ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


_PROGRESS_FIELDS = ("stage", "fraction", "iteration", "best", "seconds")  # the plan itself comes with the answer


def write_progress(id: str, now: Progress) -> dict[str, Any]:
    """The record of how far a plan is."""
    return {"id": id, **{name: getattr(now, name) for name in _PROGRESS_FIELDS}}


def read_progress(record: Any) -> Progress:
    """How far a plan is.

    Raises:
        InvalidInput: not such a record.
    """
    values = fields.check_record(record, "", required=["id", *_PROGRESS_FIELDS])
    return Progress(
        fields.check_choice(values["stage"], "stage", STAGES),
        arrays.check_number(values["fraction"], "fraction", minimum=0.0),
        fields.check_integer(values["iteration"], "iteration", minimum=0, maximum=2**31),
        None if values["best"] is None else arrays.check_number(values["best"], "best", above=0.0),
        arrays.check_number(values["seconds"], "seconds", minimum=0.0),
    )


# ── answers ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def write_answer(id: str, answer: Plan | PlanFailure) -> dict[str, Any]:
    """The record of an answer: ``plan``, or ``refusal``; the other is null."""
    if isinstance(answer, PlanFailure):
        return {"id": id, "plan": None, "refusal": answer.to_dict()}
    return {"id": id, "plan": {**answer.to_dict(), "effort": dataclasses.asdict(answer.statistics)}, "refusal": None}


def read_answer(move: Move, record: Any) -> Plan | PlanFailure:
    """The answer to a move.

    Args:
        move: what was asked.
        record: the answer, without its envelope.

    Raises:
        InvalidInput: not such an answer, or one to another move.
    """
    values = fields.check_record(record, "", required=["id", "plan", "refusal"])
    if values["plan"] is None:
        return _read_refusal(values["refusal"], "refusal")
    return _read_plan(move.task, values["plan"], "plan")


def _read_refusal(value: Any, field: str) -> PlanFailure:
    values = fields.check_record(value, field, required=["kind", "reason", "s", "joint", "infeasibility"])
    why = values["infeasibility"]
    return PlanFailure(
        fields.check_text(values["kind"], f"{field}.kind"),
        fields.check_text(values["reason"], f"{field}.reason"),
        None if values["s"] is None else arrays.check_number(values["s"], f"{field}.s"),
        None if values["joint"] is None else fields.check_text(values["joint"], f"{field}.joint"),
        None if why is None else Infeasibility.from_dict(why, f"{field}.infeasibility"),
    )


def _read_plan(task: Task, value: Any, field: str) -> Plan:
    about = ["schema", "hand", "joints", "fingers", "contacts", "duration"]
    values = fields.check_record(value, field, required=[*about, "check", "gap", "effort", "s", "stopped", "knots"])
    fields.check_choice(values["schema"], f"{field}.schema", [SCHEMA])
    names = [] if task.hand is None else [joint.name for joint in task.hand.joints]
    if values["joints"] != names or values["fingers"] != list(task.fingers):
        raise InvalidInput(f"{field}.joints", values["joints"], "those of the hand that was asked for")
    if not isinstance(values["stopped"], bool):
        raise InvalidInput(f"{field}.stopped", values["stopped"], "true or false")
    knots = _read_motion(task, values["knots"], f"{field}.knots")
    s = arrays.check_array(values["s"], f"{field}.s", (len(knots.times) if values["s"] else 0,))
    optimality_gap = np.nan if values["gap"] is None else arrays.check_number(values["gap"], f"{field}.gap")
    check = _read_check(values["check"], f"{field}.check")
    return Plan(task, knots, check, optimality_gap, _read_effort(values["effort"], f"{field}.effort"), s, values["stopped"])


def _read_motion(task: Task, value: Any, field: str) -> Trajectory:
    values = fields.check_record(value, field, required=Trajectory.__slots__)
    times = arrays.check_array(values["times"], f"{field}.times", (None,))
    if len(times) < 2 or times[0] != 0.0 or (np.diff(times) <= 0.0).any():
        raise InvalidInput(f"{field}.times", times, "at least two, rising from 0")
    K, n, k = len(times), task.joints, task.force_size
    M = 0 if task.body is None else K
    shapes = dict.fromkeys(("q", "v", "a", "tau"), (K, n)) | {"f": (K, k), "p_HO": (M, 3), "R_HO": (M, 3, 3)}
    N = 0 if task.contacts is None else len(task.contacts)
    shapes |= {"twist": (M, 6), "acceleration": (M, 6), "p_OC": (M, N, 3), "R_OC": (M, N, 3, 3), "p_OC_d": (M, N, 3)}
    return Trajectory(times, **{name: _read_table(values[name], f"{field}.{name}", shape) for name, shape in shapes.items()})


def _read_table(value: Any, field: str, shape: tuple[int, ...]) -> Array:
    """An array of a shape; where nothing is in it, lists do not say how wide it is."""
    if 0 in shape and not any(fields.check_sequence(value, field)):
        return arrays.freeze(np.zeros(shape))
    return arrays.check_array(value, field, shape)


def _read_check(value: Any, field: str) -> PlanCheck:
    names = list(PlanCheck.__slots__)
    values = fields.check_record(value, field, required=["verified", *names])
    parts = {name: -np.inf if values[name] is None else arrays.check_number(values[name], f"{field}.{name}") for name in names}
    counts = _read_counts(values, field, "samples")
    return PlanCheck(**{**parts, **counts})  # type: ignore[arg-type]  # the count is whole


def _read_effort(value: Any, field: str) -> PlanningStatistics:
    names = [each.name for each in dataclasses.fields(PlanningStatistics)]
    values = fields.check_record(value, field, required=names)
    numbers = {name: arrays.check_number(values[name], f"{field}.{name}", minimum=0.0) for name in names}
    counts = _read_counts(values, field, "solves", "iterations")
    return PlanningStatistics(**{**numbers, **counts})  # type: ignore[arg-type]  # the counts are whole


def _read_counts(values: Mapping[str, Any], field: str, *names: str) -> dict[str, int]:
    return {name: fields.check_integer(values[name], f"{field}.{name}", minimum=0, maximum=2**31) for name in names}
