"""Moves, progress and plans on the wire."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields as fields_of
from typing import Any

import numpy as np
import pytest
from support.plan_requests import assert_same_plan, hand, moves, unreachable_move

from graspforce.core.errors import InvalidInput
from graspforce.planning import FingersMove, FreeMove, GraspTask, PathMove, Plan, PlanFailure, Progress, move_from_dict
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_answer, read_progress, write_answer, write_progress

CODECS = pytest.mark.parametrize("codec", [protocol.JSON, protocol.MSGPACK])
KINDS = pytest.mark.parametrize("kind", ["path", "spline", "free", "fingers", "postures"])


def on_the_wire(record: Any, codec: str) -> Any:
    """Return a record after encoding and decoding."""
    return protocol.decode(protocol.encode(record, codec), codec)


@CODECS
@KINDS
def test_move_survives_the_wire(kind: str, codec: str) -> None:
    move = moves()[kind]
    read = move_from_dict(on_the_wire(move.to_dict(), codec), hand())
    assert type(read) is type(move)
    for each in fields_of(move):
        one, other = getattr(move, each.name), getattr(read, each.name)
        if each.name == "workspace":
            np.testing.assert_equal((one.lower, one.upper, one.turn), (other.lower, other.upper, other.turn))
        elif each.name == "obstacles":
            assert [item.shape.radius for item in one] == [item.shape.radius for item in other]
            np.testing.assert_equal([(x.p_HO, x.R_HO) for x in one], [(x.p_HO, x.R_HO) for x in other])
        elif each.name != "task":
            np.testing.assert_array_equal(one, other)
    task, mine = read.task, move.task
    assert type(task) is type(mine)
    np.testing.assert_array_equal(task.gravity_H, mine.gravity_H)
    np.testing.assert_array_equal(task.hand.torque_upper, mine.hand.torque_upper)
    if isinstance(mine, GraspTask):
        assert task.fingers == mine.fingers
        assert task.slip_margin == mine.slip_margin
        assert task.body.mass == mine.body.mass
        np.testing.assert_array_equal(task.body.inertia, mine.body.inertia)
        np.testing.assert_array_equal(task.body.p_OM, mine.body.p_OM)
        np.testing.assert_array_equal(task.contacts.R_OC, mine.contacts.R_OC)
        for name in ("p_OC", "mu", "max_normal", "min_normal"):
            np.testing.assert_array_equal(getattr(task.contacts, name), getattr(mine.contacts, name))


def test_equal_limits_give_the_same_hand_object() -> None:
    record = moves()["path"].to_dict()
    assert move_from_dict(record, hand()).task.hand is move_from_dict(record, hand()).task.hand
    record["torque"] = hand().torque_upper.tolist()
    assert move_from_dict(record, hand()).task.hand is hand()


def test_pickled_hand_computes_the_same_in_any_thread() -> None:
    derated = hand().derated(0.9)
    sent_on = pickle.loads(pickle.dumps(derated))
    np.testing.assert_array_equal(sent_on.torque_upper, derated.torque_upper)
    assert sent_on.describe() == derated.describe()
    with ThreadPoolExecutor(2) as threads:
        for mass in threads.map(sent_on.mass_matrix, [hand().neutral] * 4):
            np.testing.assert_array_equal(mass, hand().mass_matrix(hand().neutral))


@CODECS
@KINDS
def test_plan_survives_the_wire_at_and_between_knots(kind: str, codec: str) -> None:
    move = moves()[kind]
    plan = move.plan()
    assert isinstance(plan, Plan)
    read = read_answer(move, on_the_wire(write_answer("me", plan), codec))
    assert_same_plan(read, plan)
    assert isinstance(read, Plan)
    assert read.statistics == plan.statistics
    times = np.linspace(0.0, plan.duration, 17)
    for name in plan.knots.__slots__:
        np.testing.assert_array_equal(getattr(read.at(times), name), getattr(plan.at(times), name))
    assert read.to_dict() == plan.to_dict()


@CODECS
def test_plan_failure_survives_the_wire(codec: str) -> None:
    move = unreachable_move()
    refused = move.plan()
    assert isinstance(refused, PlanFailure)
    read = read_answer(move, on_the_wire(write_answer("me", refused), codec))
    assert isinstance(read, PlanFailure)
    assert read.to_dict() == refused.to_dict()
    assert read.s is not None


@CODECS
def test_progress_survives_the_wire(codec: str) -> None:
    for best in (None, 0.0371):
        now = Progress("search", 0.42, 17, best, 0.5)
        read = read_progress(on_the_wire(write_progress("me", now), codec))
        assert [getattr(read, name) for name in Progress.__slots__] == [getattr(now, name) for name in Progress.__slots__]


PATH, FREE, FINGERS = (moves()[kind].to_dict() for kind in ("path", "free", "fingers"))
POSE = PATH["poses"][0]
BAD = [
    ("method", 7.0),
    ("method", {}),
    ("method", [PATH]),
    ("method", None),
    ("method", {**PATH, "method": "magic"}),
    ("way", {**PATH, "way": "round"}),
    ("way", {**FREE, "way": "straight"}),
    ("room", {**PATH, "room": None}),
    ("room.lower", {**FREE, "room": {"lower": [0.0]}}),
    ("room.upper[1]", {**FREE, "room": {"upper": [1.0, float("nan"), 1.0]}}),
    ("room.turn", {**FREE, "room": {"turn": -1.0}}),
    ("room.size", {**FREE, "room": {"size": 1.0}}),
    ("poses", {**PATH, "poses": []}),
    ("poses", {**PATH, "poses": [POSE]}),
    ("poses", {**FREE, "poses": [POSE] * 3}),
    ("poses", {**PATH, "poses": [POSE] * 3}),
    ("poses[1].position", {**PATH, "poses": [POSE, {**POSE, "position": [0.0, 0.0]}]}),
    ("poses[0].rotation", {**PATH, "poses": [{**POSE, "rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}, POSE]}),
    ("poses", {name: value for name, value in PATH.items() if name != "poses"}),
    ("postures", {**FINGERS, "postures": [[0.0] * 3] * 2}),
    ("postures", {**FINGERS, "postures": FINGERS["postures"][:1]}),
    ("body", {**FINGERS, "body": PATH["body"]}),
    ("obstacles[0].shape", {**FINGERS, "obstacles": [{"position": [0, 0, 0], "quaternion": [1, 0, 0, 0]}]}),
    ("obstacles[0].shape.radius", {**FINGERS, "obstacles": [{**POSE, "shape": {"type": "sphere", "radius": -1.0}}]}),
    ("obstacles", {**FINGERS, "obstacles": 5}),
    ("apart", {**FINGERS, "apart": -1.0}),
    ("torque", {**PATH, "torque": [1.0]}),
    ("torque[2]", {**PATH, "torque": [*PATH["torque"][:2], 1e3, *PATH["torque"][3:]]}),
    ("torque[0]", {**PATH, "torque": [0.0, *PATH["torque"][1:]]}),
    ("posture", {**PATH, "posture": [0.0]}),
    ("gravity", {**PATH, "gravity": "down"}),
    ("slip_margin", {**PATH, "slip_margin": -1.0}),
    ("contacts[0].finger", {**PATH, "contacts": [{**PATH["contacts"][0], "finger": "toe"}, *PATH["contacts"][1:]]}),
    ("contacts[1].friction", {**PATH, "contacts": [PATH["contacts"][0], {**PATH["contacts"][1], "friction": -1.0}]}),
    ("body.mass", {**PATH, "body": {**PATH["body"], "mass": 0.0}}),
    ("hand", {**PATH, "hand": "mine"}),
]


@pytest.mark.parametrize(("field", "record"), BAD)
def test_invalid_move_names_its_field(field: str, record: Any) -> None:
    with pytest.raises(InvalidInput) as caught:
        move_from_dict(record, hand())
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("plan.knots.times", {"times": [0.0]}),
        ("plan.knots.times", {"times": [0.0, 0.2, 0.1]}),
        ("plan.knots.q", {"q": [[0.0]]}),
        ("plan.knots.R_HO", {"R_HO": []}),
        ("plan.knots.jerk", {"jerk": []}),
    ],
)
def test_answer_that_does_not_fit_the_move_is_rejected(field: str, change: dict[str, Any]) -> None:
    move = moves()["path"]
    record = write_answer("me", move.plan())
    record["plan"]["knots"].update(change)
    with pytest.raises(InvalidInput) as caught:
        read_answer(move, record)
    assert caught.value.field == field


def test_plan_of_other_fingers_is_rejected() -> None:
    record = write_answer("me", moves()["path"].plan())
    with pytest.raises(InvalidInput, match=r"plan\.fingers"):
        read_answer(moves()["fingers"], record)


def test_moves_are_validated_on_construction() -> None:
    path, fingers = moves()["path"], moves()["fingers"]
    assert isinstance(path, PathMove)
    assert isinstance(fingers, FingersMove)
    for make in (PathMove, FreeMove):
        with pytest.raises(InvalidInput, match="FingersMove moves fingers alone"):
            make(fingers.task, path.p_HO, path.R_HO)
        with pytest.raises(InvalidInput, match="at least two poses"):
            make(path.task, path.p_HO[:1], path.R_HO[:1])
        with pytest.raises(InvalidInput, match="two poses, start and goal"):
            make(path.task, path.p_HO[[0, 1, 0]], path.R_HO[[0, 1, 0]])
    with pytest.raises(InvalidInput, match="path_type"):
        PathMove(path.task, path.p_HO, path.R_HO, "round")
