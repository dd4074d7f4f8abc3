"""What planning is asked over the wire, how far it is, and what it answers: moves, progress, plans, refusals.

Frames: H hand base, O object. Every reader names what is wrong by its path from the outermost record.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from graspforce import arrays, fields
from graspforce.arrays import Array
from graspforce.contact import ContactSet
from graspforce.errors import InvalidInput
from graspforce.hand import EARTH, Hand
from graspforce.planning import ANYWHERE, Check, Effort, Motion, Obstacle, Plan, Progress, Refusal, Room, Task
from graspforce.planning.move import FingersMove, FreeMove, Move, PathMove
from graspforce.planning.plan import SCHEMA
from graspforce.planning.progress import STAGES
from graspforce.service.holds import (
    known_fingers,
    read_body,
    read_contacts,
    read_pose,
    read_shape,
    write_body,
    write_contacts,
    write_pose,
    write_shape,
)
from graspforce.solution import Infeasibility

METHODS: dict[str, type[PathMove | FreeMove | FingersMove]] = {"path": PathMove, "free": FreeMove, "fingers": FingersMove}
_LIMITS = {"torque": "torque_upper", "speed": "velocity_limit", "lower": "q_lower", "upper": "q_upper"}  # a hand's, by joint
_TASK = ("gravity", "slip_margin", *_LIMITS)
_OBJECT = ("body", "contacts", "poses")
_OWN = {"path": ("way", "posture", "rolling"), "free": ("posture", "room", "rolling"), "fingers": ("apart", "obstacles")}
_ALL = ("intervals", "tolerance")
_WORDS = {"p_HO": "poses", "q_start": "posture"}  # the others are spelt on the wire as in Python


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
    method = fields.choice(record["method"], "method", METHODS)
    needed = ("postures",) if method == "fingers" else _OBJECT
    values = fields.record(record, "", required=["method", *needed], optional=[*_TASK, *_OWN[method], *_ALL])
    given = {name: value for name, value in values.items() if value is not None}
    rest: dict[str, Any] = {name: given[name] for name in ("way", "apart", "intervals", "tolerance") if name in given}
    try:
        task = _read_task(hand, given, method != "fingers")
        if method == "fingers":
            obstacles = fields.sequence(given.get("obstacles", ()), "obstacles")
            rest["obstacles"] = tuple(_read_obstacle(item, f"obstacles[{i}]") for i, item in enumerate(obstacles))
            return FingersMove(task, given["postures"], **rest)
        poses = fields.sequence(given["poses"], "poses", at_least=2)
        p_HO, R_HO = zip(*(read_pose(pose, f"poses[{i}]")[:2] for i, pose in enumerate(poses)), strict=True)
        if method == "path":
            return PathMove(task, np.array(p_HO), np.array(R_HO), q_start=given.get("posture"), **rest)
        rest["room"] = _read_room(given.get("room"), "room")
        return FreeMove(task, np.array(p_HO), np.array(R_HO), q_start=given.get("posture"), **rest)
    except InvalidInput as error:
        name, bracket, place = error.field.partition("[")
        raise type(error)(_WORDS.get(name, name) + bracket + place, error.value, error.allowed) from None


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
        obstacles = [{"shape": write_shape(each.shape), **write_pose(each.p_HO, each.R_HO)} for each in move.obstacles]
        return {**record, "postures": move.postures.tolist(), "apart": move.apart, "obstacles": obstacles}
    assert task.body is not None  # these moves are an object's
    assert task.contacts is not None
    record["body"], record["rolling"] = write_body(task.body), task.rolling
    record["contacts"] = write_contacts(task.contacts.contacts, task.fingers)
    record["poses"] = [write_pose(p, R) for p, R in zip(move.p_HO, move.R_HO, strict=True)]
    if move.q_start is not None:
        record["posture"] = move.q_start.tolist()
    return {**record, "way": move.way} if isinstance(move, PathMove) else {**record, "room": _write_room(move.room)}


def _read_task(hand: Hand, given: Mapping[str, Any], held: bool) -> Task:
    """``body`` and ``contacts``, ``gravity``, ``slip_margin``, ``rolling``, and of each joint what the move may use:
    ``torque``, N·m, ``speed``, rad/s, and its range from ``lower`` to ``upper``, rad."""
    limited = _limited(hand, given)
    gravity_H = arrays.array(given.get("gravity", EARTH), "gravity", (3,))
    rest: dict[str, Any] = {"gravity_H": gravity_H, "slip_margin": given.get("slip_margin", 0.0)}
    rest["rolling"] = given.get("rolling", True)
    if not held:
        return Task(limited, **rest)
    contacts, fingers = read_contacts(given["contacts"], "contacts")
    known_fingers(hand, fingers, "contacts")
    return Task(limited, read_body(given["body"], "body"), ContactSet.stack(contacts), fingers, **rest)


def _limited(hand: Hand, given: Mapping[str, Any]) -> Hand:
    """The hand with motors that give less and joints that go less far and fast; itself where they keep all."""
    own = {name: getattr(hand, limit) for name, limit in _LIMITS.items()}
    asked = {name: arrays.array(given.get(name, own[name]), name, (hand.n,)) for name in _LIMITS}
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
    return _weaker(hand, tuple(tuple(asked[name].tolist()) for name in _LIMITS))


@lru_cache(maxsize=16)
def _weaker(hand: Hand, limits: tuple[tuple[float, ...], ...]) -> Hand:
    """The same hand every time: the planner keeps the equations of each that it has seen."""
    joints = [
        dataclasses.replace(joint, torque=torque, velocity=speed, lower=lower, upper=upper)
        for joint, torque, speed, lower, upper in zip(hand.joints, *limits, strict=True)
    ]
    return dataclasses.replace(hand, joints=tuple(joints))


def _read_obstacle(value: Any, field: str) -> Obstacle:
    """``shape``, and where it stands in H."""
    p_HO, R_HO, values = read_pose(value, field, ("shape",))
    if "shape" not in values:
        raise InvalidInput(f"{field}.shape", None, "given: this field is required")
    try:
        return Obstacle(read_shape(values["shape"], "shape"), p_HO, R_HO)
    except InvalidInput as error:
        raise error.inside(field) from None


def _read_room(value: Any, field: str) -> Room:
    """``lower`` and ``upper`` (m in H) and ``turn`` (rad); null for no bound."""
    if value is None:
        return ANYWHERE
    values = fields.record(value, field, optional=["lower", "upper", "turn"])
    bounds = (("lower", -np.inf), ("upper", np.inf))
    lower, upper = (arrays.limits(values.get(name), f"{field}.{name}", 3, missing) for name, missing in bounds)
    turn = values.get("turn")
    return Room(lower, upper, np.inf if turn is None else arrays.number(turn, f"{field}.turn", minimum=0.0))


def _write_room(room: Room) -> dict[str, Any]:
    lower, upper = ([x if np.isfinite(x) else None for x in bounds.tolist()] for bounds in (room.lower, room.upper))
    return {"lower": lower, "upper": upper, "turn": room.turn if np.isfinite(room.turn) else None}


# ── progress ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


_PROGRESS = ("stage", "fraction", "iteration", "best", "seconds")  # the plan itself comes with the answer


def write_progress(id: str, now: Progress) -> dict[str, Any]:
    """The record of how far a plan is."""
    return {"id": id, **{name: getattr(now, name) for name in _PROGRESS}}


def read_progress(record: Any) -> Progress:
    """How far a plan is.

    Raises:
        InvalidInput: not such a record.
    """
    values = fields.record(record, "", required=["id", *_PROGRESS])
    return Progress(
        fields.choice(values["stage"], "stage", STAGES),
        arrays.number(values["fraction"], "fraction", minimum=0.0),
        fields.whole(values["iteration"], "iteration", minimum=0, maximum=2**31),
        None if values["best"] is None else arrays.number(values["best"], "best", above=0.0),
        arrays.number(values["seconds"], "seconds", minimum=0.0),
    )


# ── answers ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def write_answer(id: str, answer: Plan | Refusal) -> dict[str, Any]:
    """The record of an answer: ``plan``, or ``refusal``; the other is null."""
    if isinstance(answer, Refusal):
        return {"id": id, "plan": None, "refusal": answer.to_dict()}
    return {"id": id, "plan": {**answer.to_dict(), "effort": dataclasses.asdict(answer.effort)}, "refusal": None}


def read_answer(move: Move, record: Any) -> Plan | Refusal:
    """The answer to a move.

    Args:
        move: what was asked.
        record: the answer, without its envelope.

    Raises:
        InvalidInput: not such an answer, or one to another move.
    """
    values = fields.record(record, "", required=["id", "plan", "refusal"])
    if values["plan"] is None:
        return _read_refusal(values["refusal"], "refusal")
    return _read_plan(move.task, values["plan"], "plan")


def _read_refusal(value: Any, field: str) -> Refusal:
    values = fields.record(value, field, required=["kind", "reason", "s", "joint", "infeasibility"])
    why = values["infeasibility"]
    return Refusal(
        fields.text(values["kind"], f"{field}.kind"),
        fields.text(values["reason"], f"{field}.reason"),
        None if values["s"] is None else arrays.number(values["s"], f"{field}.s"),
        None if values["joint"] is None else fields.text(values["joint"], f"{field}.joint"),
        None if why is None else Infeasibility.from_dict(why, f"{field}.infeasibility"),
    )


def _read_plan(task: Task, value: Any, field: str) -> Plan:
    about = ["schema", "hand", "joints", "fingers", "contacts", "duration"]
    values = fields.record(value, field, required=[*about, "check", "gap", "effort", "s", "stopped", "knots"])
    fields.choice(values["schema"], f"{field}.schema", [SCHEMA])
    names = [] if task.hand is None else [joint.name for joint in task.hand.joints]
    if values["joints"] != names or values["fingers"] != list(task.fingers):
        raise InvalidInput(f"{field}.joints", values["joints"], "those of the hand that was asked for")
    if not isinstance(values["stopped"], bool):
        raise InvalidInput(f"{field}.stopped", values["stopped"], "true or false")
    knots = _read_motion(task, values["knots"], f"{field}.knots")
    s = arrays.array(values["s"], f"{field}.s", (len(knots.times) if values["s"] else 0,))
    gap = np.nan if values["gap"] is None else arrays.number(values["gap"], f"{field}.gap")
    check = _read_check(values["check"], f"{field}.check")
    return Plan(task, knots, check, gap, _read_effort(values["effort"], f"{field}.effort"), s, values["stopped"])


def _read_motion(task: Task, value: Any, field: str) -> Motion:
    values = fields.record(value, field, required=Motion.__slots__)
    times = arrays.array(values["times"], f"{field}.times", (None,))
    if len(times) < 2 or times[0] != 0.0 or (np.diff(times) <= 0.0).any():
        raise InvalidInput(f"{field}.times", times, "at least two, rising from 0")
    K, n, k = len(times), task.joints, task.components
    M = 0 if task.body is None else K
    shapes = dict.fromkeys(("q", "v", "a", "tau"), (K, n)) | {"f": (K, k), "p_HO": (M, 3), "R_HO": (M, 3, 3)}
    N = 0 if task.contacts is None else len(task.contacts)
    shapes |= {"twist": (M, 6), "acceleration": (M, 6), "p_OC": (M, N, 3), "R_OC": (M, N, 3, 3), "p_OC_d": (M, N, 3)}
    return Motion(times, **{name: _table(values[name], f"{field}.{name}", shape) for name, shape in shapes.items()})


def _table(value: Any, field: str, shape: tuple[int, ...]) -> Array:
    """An array of a shape; where nothing is in it, lists do not say how wide it is."""
    if 0 in shape and not any(fields.sequence(value, field)):
        return arrays.frozen(np.zeros(shape))
    return arrays.array(value, field, shape)


def _read_check(value: Any, field: str) -> Check:
    names = list(Check.__slots__)
    values = fields.record(value, field, required=["verified", *names])
    parts = {name: -np.inf if values[name] is None else arrays.number(values[name], f"{field}.{name}") for name in names}
    counts = _counts(values, field, "samples")
    return Check(**{**parts, **counts})  # type: ignore[arg-type]  # the count is whole


def _read_effort(value: Any, field: str) -> Effort:
    names = [each.name for each in dataclasses.fields(Effort)]
    values = fields.record(value, field, required=names)
    numbers = {name: arrays.number(values[name], f"{field}.{name}", minimum=0.0) for name in names}
    counts = _counts(values, field, "solves", "iterations")
    return Effort(**{**numbers, **counts})  # type: ignore[arg-type]  # the counts are whole


def _counts(values: Mapping[str, Any], field: str, *names: str) -> dict[str, int]:
    return {name: fields.whole(values[name], f"{field}.{name}", minimum=0, maximum=2**31) for name in names}
