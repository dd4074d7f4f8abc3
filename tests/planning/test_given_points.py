"""Poses, postures and settings that moves are given: each value out of range is refused with its field, before planning."""

from __future__ import annotations

import copy
import importlib
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.hands import load
from support.plan_requests import hand, moves
from support.planning_cases import AXES, star_grasp

from graspforce.contact import Contact, ContactSet
from graspforce.core.errors import InvalidInput
from graspforce.grasp.body import Body
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.planning import (
    FingersMove,
    FingerTask,
    FreeMove,
    IdealTask,
    PathMove,
    Plan,
    PlanFailure,
    PlanSettings,
    StraightPath,
    WorkspaceBounds,
    move_from_dict,
    plan_along,
    plan_fingers,
    plan_free,
)
from graspforce.planning.failure import IMMOVABLE, SINGULAR, UNSOLVED
from graspforce.planning.path.paths import JointPath, SplinePath

plan_free_module = importlib.import_module("graspforce.planning.free.plan_free")

# Values of wrong types, out of range, or so large and small that they overflow
STRANGE: list[Any] = ["abc", -1, 0, 1e9, 1e300, -1e300, 1e-300, 1e-12, float("nan"), float("inf"), True, None, [], {}, [None]]


def places_of(record: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the places of all values in a record; of a list only the first two and the last."""
    if place:
        yield place
    if isinstance(record, dict):
        for name, value in record.items():
            yield from places_of(value, (*place, name))
    elif isinstance(record, list):
        for i in sorted({0, min(1, len(record) - 1), len(record) - 1} if record else ()):
            yield from places_of(record[i], (*place, i))


def changed(record: dict[str, Any], place: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """Return a copy of a record with another value at a place."""
    result = copy.deepcopy(record)
    inner: Any = result
    for step in place[:-1]:
        inner = inner[step]
    inner[place[-1]] = value
    return result


def planned(record: dict[str, Any]) -> Plan | PlanFailure | InvalidInput:
    """Return the answer to the move of a record, or the error of a field that is not allowed."""
    try:
        return move_from_dict(record, hand()).plan(budget=0.02)
    except InvalidInput as error:
        return error


@pytest.mark.parametrize("kind", ["path", "spline", "free", "fingers", "postures"])
def test_strange_values_in_a_move_record_are_refused_with_their_field(kind: str) -> None:
    """A seventh of all changes, chosen by a seed. Changes that are allowed are planned without an exception."""
    obstacle = {"shape": {"type": "sphere", "radius": 0.01}, "position": [0.3, 0, 0], "quaternion": [1, 0, 0, 0]}
    record = {"collisions": {"margin": 1e-3, "obstacles": [obstacle]}, **moves()[kind].to_dict()}
    changes = [(place, value) for place in places_of(record) for value in STRANGE]
    chosen = np.random.default_rng(7).permutation(len(changes))[: len(changes) // 7]
    refused = 0
    for place, value in (changes[i] for i in chosen):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # overflow in numbers that are allowed
            answer = planned(changed(record, place, value))
        assert isinstance(answer, Plan | PlanFailure) or answer.field, (place, value)
        refused += isinstance(answer, InvalidInput)
    assert refused > len(chosen) // 3


@pytest.mark.parametrize("tolerance", ["abc", -1, 0, 1e9, 0.2, 1e-12, float("nan"), float("inf"), True])
def test_tolerance_out_of_range_is_refused(tolerance: Any) -> None:
    with pytest.raises(InvalidInput) as caught:
        PlanSettings(tolerance=tolerance)
    assert caught.value.field == "tolerance"
    for kind in ("path", "free", "fingers"):
        with pytest.raises(InvalidInput) as caught:
            move_from_dict({**moves()[kind].to_dict(), "tolerance": tolerance}, hand())
        assert caught.value.field == "tolerance"


def test_move_to_where_the_object_is_is_refused() -> None:
    path, free = moves()["path"], moves()["free"]
    assert isinstance(path, PathMove)
    assert isinstance(free, FreeMove)
    p, R, near = path.p_HO[[0, 0]], path.R_HO[[0, 0]], path.p_HO[[0, 0]] + np.array([[0.0, 0, 0], [1e-9, 0, 0]])
    for make in (PathMove, FreeMove):
        for goal in (p, near):
            with pytest.raises(InvalidInput, match=r"p_HO\[1\] .* nothing moves"):
                make(path.task, goal, R)
    for kind, way in (("path", {"way": "spline"}), ("path", {"way": "screw"}), ("free", {})):
        record = moves()[kind].to_dict()
        with pytest.raises(InvalidInput, match=r"poses\[1\] .* nothing moves"):
            move_from_dict({**record, **way, "poses": [record["poses"][0]] * 2}, hand())
    with pytest.raises(InvalidInput, match=r"path = .* along which something moves"):
        plan_along(path.task, StraightPath(p[0], R[0], p[0], R[0]))
    with pytest.raises(InvalidInput, match=r"p_HO\[1\]"):
        plan_free(path.task, p, R)
    with pytest.raises(InvalidInput, match=r"p_HO\[2\]"):
        SplinePath.through(np.array([p[0], p[0] + 0.01, p[0] + 0.01]), R[[0, 0, 0]])


def test_equal_postures_are_refused() -> None:
    move = moves()["postures"]
    assert isinstance(move, FingersMove)
    q = move.postures
    with pytest.raises(InvalidInput, match=r"postures\[2\] .* nothing moves"):
        replace(move, postures=q[[0, 1, 1]])
    with pytest.raises(InvalidInput, match=r"postures\[1\]"):
        JointPath.through(q[[0, 0]])
    with pytest.raises(InvalidInput, match=r"postures\[1\]"):
        plan_fingers(move.task, q[0], q[0] + 1e-10)


def test_posture_beyond_the_joint_limits_is_refused() -> None:
    fingers, path, free = moves()["fingers"], moves()["path"], moves()["free"]
    assert isinstance(fingers, FingersMove)
    assert isinstance(path, PathMove)
    assert isinstance(free, FreeMove)
    joints = hand().joints
    for excess in (0.01, 1e9):
        q = np.array(fingers.postures)
        q[1, 2] = joints[2].upper + excess
        with pytest.raises(InvalidInput, match=r"postures\[1\]\[2\] = .* the limits of finger_1_joint_3"):
            replace(fingers, postures=q)
        with pytest.raises(InvalidInput, match=r"q_goal\[2\]"):
            plan_fingers(fingers.task, *q)
        for move in (path, free):
            with pytest.raises(InvalidInput, match=r"q_start\[2\]"):
                replace(move, q_start=q[1])
            with pytest.raises(InvalidInput, match=r"posture\[2\]"):
                move_from_dict({**move.to_dict(), "posture": q[1].tolist()}, hand())


def test_workspace_that_excludes_an_end_is_refused() -> None:
    free = moves()["free"]
    assert isinstance(free, FreeMove)
    above = free.p_HO[0, 2] + 1e-3
    with pytest.raises(InvalidInput, match=r"workspace\.lower = .* the position of the start"):
        replace(free, workspace=WorkspaceBounds([-1.0, -1.0, above]))
    with pytest.raises(InvalidInput, match=r"room\.upper = .* the position of the goal"):
        move_from_dict({**free.to_dict(), "room": {"upper": [1.0, 1.0, above]}}, hand())


def test_wrong_types_in_python_are_refused() -> None:
    task = moves()["path"].task
    for make, field in (
        (lambda: PlanSettings(compiled="yes"), "compiled"),  # type: ignore[arg-type]
        (lambda: CollisionSettings(obstacles=5), "obstacles"),  # type: ignore[arg-type]
        (lambda: CollisionSettings(obstacles=[5]), "obstacles[0]"),  # type: ignore[list-item]
        (lambda: replace(task, collisions=True), "collisions"),
        (lambda: FingerTask(hand(), collisions=0.01), "collisions"),  # type: ignore[arg-type]
        (lambda: replace(moves()["fingers"], obstacles=[1]), "obstacles[0]"),
        (lambda: replace(moves()["free"], workspace=None), "workspace"),
    ):
        with pytest.raises(InvalidInput) as caught:
            make()  # type: ignore[no-untyped-call]
        assert caught.value.field == field


def test_object_that_nothing_can_move_is_immovable() -> None:
    """Contacts without any force hold a floating object still; no motion is possible, however slow."""
    held, middle, q = star_grasp(load("four_finger"))
    powerless = [replace(contact, max_normal=0.0) for contact in held.contacts.contacts]
    floating = replace(held, gravity_H=np.zeros(3), slip_margin=0.0, contacts=ContactSet.stack(powerless))
    answer = plan_along(floating, StraightPath(middle, AXES, middle + 0.002 * AXES[2], AXES), q)
    assert isinstance(answer, PlanFailure)
    assert answer.kind == IMMOVABLE


@pytest.mark.parametrize(
    ("side", "s", "words"), [(-1.0, 1.0, "brake it at the goal"), (1.0, 0.0, "accelerate it at the start")]
)
def test_object_that_contacts_push_from_one_side_only_is_immovable(side: float, s: float, words: str) -> None:
    """A frictionless contact behind the object cannot brake it, one in front of it cannot accelerate it."""
    push = Contact(0.02 * side * AXES[0], -side * AXES[0], model="frictionless", max_normal=5.0)
    task = IdealTask(Body(0.1, 1e-5 * AXES), ContactSet.stack([push]), gravity_H=np.zeros(3))
    answer = plan_along(task, StraightPath(np.zeros(3), AXES, 0.01 * AXES[0], AXES))
    assert isinstance(answer, PlanFailure)
    assert (answer.kind, answer.s) == (IMMOVABLE, s)
    assert words in answer.reason
    assert answer.infeasibility is not None
    assert answer.infeasibility.verified


def test_free_search_does_not_claim_that_its_failure_is_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    """The straight path is infeasible halfway, and the search finds no other: that proves nothing about other paths."""
    free = moves()["free"]
    assert isinstance(free, FreeMove)
    halfway = PlanFailure(SINGULAR, "At s = 0.500 a finger is singular.", 0.5)
    monkeypatch.setattr(plan_free_module, "plan_along", lambda *_, **__: halfway)
    monkeypatch.setattr(plan_free_module, "find_faster_plan", lambda *_, **__: None)
    answer = free.plan()
    assert isinstance(answer, PlanFailure)
    assert answer.kind == UNSOLVED
    assert "does not prove" in answer.reason
    assert halfway.reason in answer.reason
