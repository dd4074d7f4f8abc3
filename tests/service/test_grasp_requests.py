"""Grasps by request: the grasp of Python, budgets, cancellation, and errors that name the field."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.hands import load

from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, find_grasp, measure_grasp, relax_idle_fingers
from graspforce.service.wire import protocol
from graspforce.service.wire.grasp_records import GraspRequest, read_grasp, read_grasps
from graspforce.service.workers.jobs import GRASP, PlanningJob
from graspforce.service.workers.planning_process import run_job

BALL = Body.solid(Sphere(0.03), 0.05)
DOWN = (0.0, 0.0, -9.81)  # m/s²
QUICK = GraspRequest(BALL, 0.7, DOWN, ("finger_1", "finger_2", "finger_4"), options=GraspSearchOptions(travel=0.0))


def job(record, remaining=60.0):
    return PlanningJob("a", "four_finger", record, protocol.JSON, 7, 60.0, remaining, task=GRASP)


def run(record, remaining=60.0, cancelled=lambda: False):
    """Return outcome and decoded reply of a job."""
    message = run_job(job(record, remaining), load("four_finger"), lambda message: None, cancelled)
    return message.outcome, json.loads(message.reply.payload)


def test_request_survives_its_record():
    box = Body.solid(Box([0.05, 0.04, 0.06]), 0.2)
    options = GraspSearchOptions(max_normal=9.0, slip_margin=0.1, travel=0.002, clearance=0.001, palm_normal_H=(0, 0, 2))
    style = GraspSearchOptions(grasp_class="tip-pinch", approach_O=(0, -2, 0), up_O=(0, 0, 1), pad_friction=0.004)
    for request in (
        QUICK,
        GraspRequest(BALL),
        GraspRequest(box, 0.5, np.eye(3), None, 3, options),
        GraspRequest(BALL, options=style, count=3),
    ):
        record = json.loads(json.dumps(request.to_dict()))
        again = GraspRequest.from_dict(record)
        assert again.to_dict() == record
        assert again.fingers == request.fingers


def test_job_finds_the_grasp_of_python():
    hand = load("four_finger")
    outcome, record = run(QUICK.to_dict())
    assert outcome == "ok"
    assert (record["id"], record["sequence"]) == ("a", 7)
    found = read_grasp(hand, {name: record[name] for name in ("id", "hold", "grasps")})
    expected = relax_idle_fingers(find_grasp(hand, BALL, QUICK.fingers, friction=0.7, gravity_H=DOWN, options=QUICK.options))
    assert found.to_dict() == json.loads(json.dumps(expected.to_dict()))


def test_several_grasps_of_a_class_have_their_measures():
    hand, options = load("four_finger"), GraspSearchOptions(travel=0.0, grasp_class="tripod")
    request = GraspRequest(BALL, 0.7, DOWN, options=options, count=2, rank="robustness")
    outcome, record = run(request.to_dict())
    assert outcome == "ok"
    found = read_grasps(hand, {name: record[name] for name in ("id", "hold", "grasps")})
    assert len(found) == 2
    assert all(len(each.grasp.fingers) == 3 for each in found)
    assert found[0].measures.robustness >= found[1].measures.robustness > 0.0
    assert found[0].grasp.to_dict() == record["hold"]
    for each in found:
        again = measure_grasp(each.grasp)
        assert (again.margin, again.robustness) == pytest.approx((each.measures.margin, each.measures.robustness), rel=1e-6)
        assert again.clearance == pytest.approx(each.measures.clearance, abs=1e-6)  # m


def test_spent_budget_and_cancellation_are_deadlines():
    for arguments in ({"remaining": 0.0}, {"remaining": 1e-6}):
        outcome, record = run({**QUICK.to_dict(), "travel": 0.2}, **arguments)  # no hand moves a ball that far
        assert outcome == record["error"] == "deadline"
        assert "budget" in record["message"]
    outcome, record = run({**QUICK.to_dict(), "travel": 0.2}, cancelled=lambda: True)
    assert outcome == record["error"] == "deadline"
    assert "cancelled" in record["message"]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"body": None}, "body"),
        ({"body": {"mass": -1, "shape": {"type": "sphere", "radius": 0.03}}}, "body.mass"),
        ({"friction": 0.0}, "friction"),
        ({"friction": "much"}, "friction"),
        ({"gravity": [0, 0]}, "gravity"),
        ({"gravity": [[0, 0, 1]] * 65}, "gravity"),
        ({"fingers": "finger_1"}, "fingers"),
        ({"fingers": ["finger_1", "finger_2", "finger_9"]}, "finger"),
        ({"seed": 1.5}, "seed"),
        ({"travel": -1.0}, "travel"),
        ({"hold": {}}, "hold"),
        ({"count": 0}, "count"),
        ({"count": 17}, "count"),
        ({"rank": "beauty"}, "rank"),
        ({"grasp_class": "tripot"}, "grasp_class"),
        ({"approach_O": [0, 0, 0]}, "approach_O"),
        ({"up_O": [0, 0]}, "up_O"),
        ({"pad_friction": 0}, "pad_friction"),
    ],
)
def test_wrong_fields_are_named(change, field):
    outcome, record = run({**QUICK.to_dict(), **change})
    assert outcome == record["error"]
    assert outcome in ("invalid", "unknown")
    assert (record["field"] or "").startswith(field)


def test_object_that_cannot_be_held_is_invalid_input():
    huge = GraspRequest(Body.solid(Sphere(0.3), 0.05), 0.7, DOWN, QUICK.fingers, options=QUICK.options)
    outcome, record = run(huge.to_dict())
    assert (outcome, record["field"]) == ("invalid", "body")


def test_arguments_are_checked_in_python():
    with pytest.raises(InvalidInput, match="gravity"):
        GraspRequest(BALL, gravity=np.zeros((0, 3)))
    with pytest.raises(InvalidInput, match="budget"):
        GraspSearchOptions(budget=0.0)
