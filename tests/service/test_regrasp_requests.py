"""Regrasps by request: plans, progress, budgets, cancellation, and errors that name the field."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.hands import load

from graspforce.control import ControlSettings
from graspforce.planning import PlanFailure
from graspforce.planning.failure import STOPPED
from graspforce.planning.regrasp import RegraspPlan, RegraspSettings, goal_from_steps
from graspforce.service.wire import protocol
from graspforce.service.wire.regrasp_records import RegraspRequest, read_regrasp
from graspforce.service.workers.jobs import PROGRESS, REGRASP, PlanningJob
from graspforce.service.workers.planning_process import run_job

CONTROL = ControlSettings(slip_margin=0.05)
GOAL = goal_from_steps(named_grasp("four_finger sphere"), [0.0, 0.0, 0.0], [0.0, 0.0, 0.5], CONTROL)  # needs finger steps
NEAR = goal_from_steps(named_grasp("four_finger sphere"), [0.0, 0.0, 0.0], [0.0, 0.0, 0.05], CONTROL)
BUDGET = 300.0  # s: the search must not depend on the speed of the machine


def run(record, remaining=BUDGET, cancelled=lambda: False, send=lambda message: None):
    """Return outcome and decoded reply of a job."""
    job = PlanningJob("a", "four_finger", record, protocol.JSON, 7, BUDGET, remaining, task=REGRASP)
    message = run_job(job, load("four_finger"), send, cancelled)
    return message.outcome, json.loads(message.reply.payload)


def answer(goal, record):
    """Return the plan or the failure of a reply."""
    return read_regrasp(goal, {name: record[name] for name in ("id", "plan", "refusal")})


def test_request_survives_its_record():
    for request in (
        RegraspRequest(GOAL),
        RegraspRequest(NEAR, RegraspSettings(margin=0.2, candidates=5, branches=2, seed=4, joint_rate=1.0)),
    ):
        record = json.loads(json.dumps(request.to_dict()))
        again = RegraspRequest.from_dict(load("four_finger"), record)
        assert again.to_dict() == record
        assert asdict(again.search) == asdict(request.search)


def test_job_finds_a_plan_with_finger_steps_and_sends_progress():
    sent = []
    outcome, record = run(RegraspRequest(GOAL).to_dict(), send=sent.append)
    assert outcome == "ok"
    assert (record["id"], record["sequence"], record["refusal"]) == ("a", 7, None)
    found = answer(GOAL, record)
    assert found.step_count > 0
    assert found.margin >= RegraspSettings().least_margin(CONTROL)
    end = found.task.path.motion(found.stages[-1].end.u)
    np.testing.assert_allclose(end.R_HO, GOAL.R_HO, atol=1e-9)
    assert sent
    assert all(message.kind == PROGRESS for message in sent)


def test_spent_budget_and_cancellation_are_refusals():
    for arguments, words in (({"remaining": 0.0}, "budget"), ({"cancelled": lambda: True}, "stopped")):
        outcome, record = run(RegraspRequest(GOAL).to_dict(), **arguments)
        assert outcome == "ok"
        failure = answer(GOAL, record)
        assert isinstance(failure, PlanFailure)
        assert failure.kind == STOPPED
        assert words in failure.reason


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"hold": None}, "hold"),
        ({"goal": {"position": [0.0, 0.0], "rotation": np.eye(3).tolist()}}, "goal.position"),
        ({"goal": NEAR.grasp.to_dict()["object"]}, "goal"),
        ({"settings": {"slip_margin": -1.0}}, "settings.slip_margin"),
        ({"search": {"margin": 0.0}}, "search.margin"),
        ({"search": {"budget": 1.0}}, "search.budget"),
        ({"search": {"seed": 1.5}}, "search.seed"),
        ({"collisions": {"margin": -1.0}}, "collisions.margin"),
        ({"moves": 3}, "moves"),
        ({"hold": {**NEAR.grasp.to_dict(), "body": {"mass": 0.1, "inertia": np.eye(3).tolist()}}}, "hold.body.shape"),
    ],
)
def test_wrong_fields_are_named(change, field):
    outcome, record = run({**RegraspRequest(NEAR).to_dict(), **change})
    assert outcome == record["error"] == "invalid"
    assert record["field"] == field


def test_client_gets_plans_and_refusals(client):
    assert "regrasp_search" in client.status().capabilities
    plan = client.plan_regrasp(RegraspRequest(NEAR), budget=60.0)
    assert isinstance(plan, RegraspPlan)
    assert plan.step_count == 0
    seen = []
    refusal = client.plan_regrasp(RegraspRequest(GOAL), budget=60.0, callback=lambda now: seen.append(now) or False)
    assert isinstance(refusal, PlanFailure)
    assert refusal.kind == STOPPED
    assert seen
