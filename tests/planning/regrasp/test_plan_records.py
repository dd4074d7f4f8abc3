"""Goals and plans of regrasps survive JSON, and wrong fields are named."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from support.regrasp_plans import CONTROL, plan_with_one_step

from graspforce.core.errors import InvalidInput
from graspforce.planning.regrasp import FingerStage, RegraspGoal
from graspforce.planning.regrasp.plan_records import goal_from_dict, goal_to_dict, plan_from_dict, plan_to_dict


def goal_of(plan) -> RegraspGoal:
    """Return the goal at the end of a plan."""
    path = plan.task.path
    return RegraspGoal(plan.task.grasp, path.p_HO[-1], path.R_HO[-1], CONTROL)


def sent(plan):
    """Return the record of a plan after JSON."""
    return json.loads(json.dumps(plan_to_dict(plan)))


def test_plan_survives_json():
    plan = plan_with_one_step()
    again = plan_from_dict(sent(plan), goal_of(plan))
    assert plan_to_dict(again) == plan_to_dict(plan)
    assert (again.step_count, again.duration, again.margin) == (plan.step_count, plan.duration, plan.margin)


def test_contacts_of_the_read_plan_have_model_and_place():
    plan = plan_with_one_step()
    again = plan_from_dict(sent(plan), goal_of(plan))
    for one, other in zip(plan.stages, again.stages, strict=True):
        for name in ("p_OC", "R_OC", "mu", "gamma", "min_normal", "max_normal"):
            found, expected = getattr(other.end.contacts, name), getattr(one.end.contacts, name)
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
        assert other.end.contacts.models == one.end.contacts.models
        if isinstance(one, FingerStage):
            np.testing.assert_allclose(other.contact.position, one.contact.position, atol=1e-15)


def test_goal_survives_json():
    goal = goal_of(plan_with_one_step())
    record = json.loads(json.dumps(goal_to_dict(goal)))
    again = goal_from_dict(record, goal.grasp.hand)
    assert goal_to_dict(again) == goal_to_dict(goal)


@pytest.mark.parametrize(
    ("place", "value", "field"),
    [
        (("schema",), "graspforce/plan/1", "plan.schema"),
        (("hand",), "leap_right", "plan.hand"),
        (("path", 1, "position"), [0.0, 0.0], "plan.path[1].position"),
        (("stages",), [], "plan.stages"),
        (("stages", 0, "kind"), "walk", "plan.stages[0].kind"),
        (("stages", 0, "states", 1, "u"), -1.0, "plan.stages[0].states[1].u"),
        (("stages", 0, "states", 1, "fingers", 2), "thumb", "plan.stages[0].states[1].fingers[2]"),
        (("stages", 0, "states", 1, "posture"), [0.0] * 3, "plan.stages[0].states[1].posture"),
        (("stages", 1, "finger"), "thumb", "plan.stages[1].finger"),
        (("stages", 1, "duration"), 0.0, "plan.stages[1].duration"),
        (("stages", 1, "end", "normals"), [[0.0, 0.0, 1.0]], "plan.stages[1].end.normals"),
        (("stages", 2, "margin"), "wide", "plan.stages[2].margin"),
    ],
)
def test_wrong_fields_are_named(place, value, field):
    plan = plan_with_one_step()
    record = copy.deepcopy(sent(plan))
    target = record
    for step in place[:-1]:
        target = target[step]
    target[place[-1]] = value
    with pytest.raises(InvalidInput) as caught:
        plan_from_dict(record, goal_of(plan))
    assert caught.value.field == field
